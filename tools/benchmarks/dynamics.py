"""Time of an arm's inverse dynamics from Python, compared with mj_inverse of MuJoCo; at most half of it is wanted."""

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

import friction_hil as fh
from tools.benchmarks.report import Row, compare, rounds

JOINTS = 6
CALLS = 10_000
ROUNDS = 15
LINK = (
    '<body pos="0 0.1 0.3"><joint axis="{axis}"/><inertial pos="0.02 0.01 0.15" mass="2" '
    'fullinertia="0.02 0.03 0.015 0.001 0.002 0.0005"/>{inner}</body>'
)


def run() -> list[Row]:
    """Measure both alternately, each with a state that is copied in and a result that is read."""
    text = ""
    for k in reversed(range(JOINTS)):
        text = LINK.format(axis=("0 0 1", "0 1 0", "1 0 0")[k % 3], inner=text)
    text = f"<mujoco><worldbody>{text}</worldbody></mujoco>"
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        path.write_text(text, encoding="utf-8")
        arm = fh.dynamics.load(path)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    q, dq, ddq = np.random.default_rng(1).normal(size=(3, JOINTS))
    tau = np.empty(JOINTS)

    def of_mujoco() -> None:
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)

    works: dict[str, Callable[[], object]] = {
        "mujoco": of_mujoco,
        "ours": lambda: arm.inverse_dynamics(q, dq, ddq, tau),
        "gravity": lambda: arm.gravity(q, tau),
    }
    of_mujoco()
    if not np.allclose(data.qfrc_inverse, arm.inverse_dynamics(q, dq, ddq), rtol=1e-9):
        raise AssertionError("the two do not compute the same")
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in rounds(ROUNDS, "inverse dynamics"):
        for name, work in works.items():
            began = time.perf_counter()
            for _ in range(CALLS):
                work()
            times[name].append((time.perf_counter() - began) / CALLS * 1e6)
    return [
        compare(f"inverse dynamics, {JOINTS} joints (mj_inverse)", "us", times["ours"], times["mujoco"]),
        compare("gravity alone (mj_inverse)", "us", times["gravity"], times["mujoco"]),
    ]
