"""All joints of a loop in C do, compiled, what `friction_hil.Compensator` does."""

import ctypes
import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.checked_yaml.text import dump
from friction_hil.cli import main
from friction_hil.errors import UsageError
from friction_hil.export import c_joints
from tests.c_exports import shared
from tests.own_loops import LIMITS, PERIOD_S, STRIBECK, axis, motion, steps

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
AXES = {"shoulder": axis(), "elbow": axis(STRIBECK), "wrist": axis(compensation={"velocity": "drive", "fade_s": 0.1})}
NUMBERS = ("q", "dq", "tau", "q_des", "dq_des", "ddq_des", "load", "temperature")


@pytest.fixture
def path(tmp_path):
    (tmp_path / "arm.yaml").write_text(dump({"version": 1, "period_s": PERIOD_S, "axes": AXES}))
    return tmp_path / "arm.yaml"


def compiled_steps(folder, path, inputs, *, single=False):
    """Output of every cycle, (cycles, 3)."""
    content = fh.export.joint_files(path, name="arm")
    fh.export.save(content, folder)
    options = [f"-DARM_{name.upper()}_SINGLE" for name in AXES] if single else []
    library = ctypes.CDLL(
        str(shared(folder, [folder / file for file in content if file.endswith(".c")], "-O1", *options))
    )
    real = ctypes.c_float if single else ctypes.c_double

    class Input(ctypes.Structure):
        _fields_ = (
            ("cycles", ctypes.c_uint32),
            *((name, (ctypes.c_double if name in ("q", "q_des") else real) * 3) for name in NUMBERS),
            ("is_fresh", ctypes.c_bool * 3),
            ("is_enabled", ctypes.c_bool * 3),
        )

    state, out, given = ctypes.create_string_buffer(1 << 16), (real * 3)(), Input()
    library.arm_compensators_init(state)
    found = []
    for k in range(len(inputs["q"])):
        given.cycles = round(inputs["dt"][k] / PERIOD_S)
        for name in NUMBERS:
            getattr(given, name)[:] = inputs[name][k] if name in inputs else [math.nan] * 3
        given.is_fresh[:], given.is_enabled[:] = inputs["fresh"][k].tolist(), [True] * 3
        library.arm_compensators_step(state, ctypes.byref(given), out)
        found.append(list(out))
    return np.array(found)


@pytest.mark.parametrize(("single", "tolerance"), [(False, 1e-12), (True, 1e-4)])
def test_all_joints_give_the_torque_of_python(path, tmp_path, single, tolerance):
    """With demands that are known in part, missed periods and stale joints."""
    inputs = motion(600, 3)
    inputs["ddq_des"][::3] = math.nan
    inputs["dq_des"][200:300, 1] = math.nan
    inputs["q_des"][400:, 2] = inputs["dq_des"][400:, 2] = math.nan
    inputs["load"][:, 0] = math.nan
    inputs["dt"] = PERIOD_S * np.where(np.arange(600) % 41, 1, 3)
    inputs["dt"][0] = PERIOD_S
    inputs["fresh"] = np.random.default_rng(3).random((600, 3)) > 0.02
    inputs["fresh"][0] = True
    one = fh.Compensator.load(path)
    wanted = steps(one, 600, **inputs)
    assert one.fault is None
    assert np.abs(wanted).max(axis=0).min() > 0.03
    for name in ("q", "dq"):  # a joint that is stale has the last position, and its drive's velocity is not known
        for k in range(1, 600):
            inputs[name][k] = np.where(inputs["fresh"][k], inputs[name][k], inputs[name][k - 1])
    error = np.abs(compiled_steps(tmp_path, path, inputs, single=single) - wanted) / LIMITS["torque"]
    assert np.quantile(error, 0.97 if single else 1.0) < tolerance


def test_the_command_writes_them_and_says_what_is_missing(path, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    assert main(["export", "--to", "c", "--config", str(path), "--output", f"{out}/"]) == 0
    names = {f"arm{part}.{suffix}" for part in ("", "_shoulder", "_elbow", "_wrist") for suffix in "ch"}
    assert {each.name for each in out.iterdir()} == names
    assert main(["export", "--to", "c", "--config", str(path), "--output", f"{out}/two", "--axis", "elbow"]) == 0
    assert (out / "two_elbow.c").exists()
    for wrong, word in ((["--to", "c"], "MODEL"), (["--to", "st", "--config", str(path)], "MODEL"),
                        (["--to", "c", "--config", str(path), "--delay", "0"], "--delay")):  # fmt: skip
        capsys.readouterr()
        assert main(["export", *wrong]) == 2
        assert word in capsys.readouterr().err
    path.write_text(dump({"version": 1, "axes": AXES}))
    with pytest.raises(UsageError, match="no period_s"):
        fh.export.joint_files(path)


@pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
def test_the_class_of_the_page_compiles(path, tmp_path):
    fh.export.save(fh.export.joint_files(path, name="arm"), tmp_path)
    page = (Path(fh.__file__).parent / "own_loop/ros2_control.md").read_text()
    (tmp_path / "friction.cpp").write_text(re.findall(r"^```cpp\n(.*?)^```", page, re.MULTILINE | re.DOTALL)[0])
    command = ["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", tmp_path / "friction.cpp"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stderr == ""


def test_the_inputs_in_c_are_those_of_python():
    assert tuple(name for _, name, _ in c_joints._INPUTS[:-2]) == NUMBERS
