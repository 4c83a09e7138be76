"""`arm:` in the configuration of a loop of one's own: the load is the arm's where the loop gives none."""

import math

import numpy as np
import pytest

import friction_hil as fh
from friction_hil import recordings
from friction_hil.checked_yaml.text import dump
from friction_hil.compensator import INPUTS
from friction_hil.errors import UsageError
from friction_hil.numerics.jit import ready
from friction_hil.own_loop import kernel
from friction_hil.replay.verify import verify
from tests.arm_machine import ARM, URDF, gravity
from tests.own_loops import LOADED, axis, motion, steps

PERIOD_S, LEAD_S, CYCLES = 2e-3, 2e-3, 400
FRICTION = {"model": "coulomb", "parameters": {"coulomb": 0.05}, "modifiers": LOADED}
LIMITS = {"torque": 20.0, "velocity": 50.0}


def loop(folder, joints=None, arm=ARM, **of_shoulder):
    """Shoulder and elbow, and a gripper that is in no arm."""
    (folder / "arm.urdf").write_text(URDF)
    one = axis(FRICTION, limits=LIMITS, compensation={"fade_s": 1e-3, "gain": 1.0})
    names = ("gripper", "shoulder", "elbow")
    axes = {"axes": dict.fromkeys(names, one) | {"shoulder": one | of_shoulder}}
    (folder / "own.yaml").write_text(dump({"version": 1, "period_s": PERIOD_S, **axes, "arm": arm}))
    return fh.Compensator.load(folder / "own.yaml", joints=joints, record_s=5.0)


def swing():
    """Demands of the three joints, positions that follow them, and no load."""
    given = motion(CYCLES, 3)
    del given["load"], given["dq"]
    return given


def recorded(comp):
    """The loads with which the joints of a loop were computed, (n, joints)."""
    return comp._memory.rows[:CYCLES, :, INPUTS.index("load_torque")]


def test_its_dynamics_have_the_order_of_the_loop(tmp_path):
    comp = loop(tmp_path, ["elbow", "gripper", "shoulder"])
    assert comp.dynamics.joints == ("joint2", "joint1")
    assert comp.dynamics.gravity([0.9, 0.4]) == pytest.approx(gravity(0.4, 0.9)[::-1])
    assert fh.Compensator.load("config/own_loop.yaml", period_s=0.004).dynamics is None


def test_the_load_of_demanded_motion_is_what_the_gears_carry(tmp_path):
    """Weight, coupling and inertia of the links at the demand ahead, without the rotors, which no gear carries."""
    comp, given = loop(tmp_path), swing()
    steps(comp, CYCLES, **given)
    found = recorded(comp)
    assert np.isnan(found[:, 0]).all(), "the gripper is in no arm"
    q, dq, ddq = (given[name][:, 1:] for name in ("q_des", "dq_des", "ddq_des"))
    ahead = dq + LEAD_S * ddq
    expected = comp.dynamics.inverse_dynamics(q + LEAD_S * ahead, ahead, ddq) - comp.dynamics.armatures * ddq
    assert found[:, 1:] == pytest.approx(expected, rel=1e-9)
    assert np.ptp(found[:, 1:] - gravity(*q.T).T) > 0.5, "more than weight"


def test_the_friction_follows_it_and_it_is_no_part_of_the_output(tmp_path):
    comp, given = loop(tmp_path), swing()
    found = steps(comp, CYCLES, **given)[10:]
    load = recorded(comp)[10:]
    assert np.abs(found[:, 1:]).max() < 0.05 + 0.1 * np.abs(load[:, 1:]).max() + 1e-9
    assert np.corrcoef(np.abs(found[:, 1]), np.abs(load[:, 1]))[0, 1] > 0.7
    assert np.abs(found[:, 0]).max() < 0.051


def test_what_the_loop_gives_goes_before_it_joint_by_joint(tmp_path):
    comp, given = loop(tmp_path), swing()
    load = np.full((CYCLES, 3), math.nan)
    load[:, 2] = 1.25
    load[50:60, 2] = math.nan
    load[60:70, 2] = 1e300  # more than any torque
    steps(comp, CYCLES, **given, load=load)
    found = recorded(comp)
    assert np.isfinite(found[:, 1:]).all()
    assert set(found[:50, 2]) == {1.25}
    assert np.abs(found[50:70, 2]).max() < 10.0
    assert not set(found[50:70, 2]) & {1.25}


def test_guided_by_hand_it_is_the_weight_where_the_arm_was_measured(tmp_path):
    comp, given = loop(tmp_path), swing()
    steps(comp, CYCLES, q=given["q"], tau=given["tau"])
    found = recorded(comp)[20:, 1:]
    q, dq = given["q"][20:, 1:], given["dq_des"][20:, 1:]
    assert found == pytest.approx(gravity(*(q + LEAD_S * dq).T).T, abs=0.05)


def test_a_stale_joint_counts_where_it_was_and_nothing_is_ever_nan(tmp_path):
    comp, given = loop(tmp_path), swing()
    q = given["q"].copy()
    q[100:105, 2] = math.nan
    q[200:203] = 1e300
    out = steps(comp, CYCLES, q=q, tau=given["tau"])
    found = recorded(comp)[:, 1:]
    assert comp.fault is None
    assert np.isfinite(out).all()
    assert np.isfinite(found).all()
    assert np.abs(np.diff(found[50:], axis=0)).max() < 1.0


def test_replay_repeats_it_without_the_file(tmp_path):
    comp = loop(tmp_path)
    steps(comp, CYCLES, **swing())
    path = comp.save(tmp_path / "run.mcap")
    (tmp_path / "arm.urdf").unlink()
    results = [verify(each) for each in recordings.read_all(path).values()]
    assert [(each.reason, each.rows) for each in results] == [("", CYCLES)] * 3


def test_arrays_of_another_kind_give_the_same_and_wrong_ones_a_fault(tmp_path):
    given = swing()
    kinds = (np.asarray, np.ndarray.tolist, lambda each: np.stack([each, each], axis=1)[:, 0])
    found = []
    for kind in kinds:
        comp = loop(tmp_path)
        rows = (dict(zip(given, row, strict=True)) for row in zip(*given.values(), strict=True))
        found.append([comp.step(**{n: kind(v) for n, v in row.items()}, dt=PERIOD_S).tolist() for row in rows])
    assert found[0] == found[1] == found[2]
    comp.step([0.0, 0.0], dt=PERIOD_S)
    assert "(3,)" in comp.fault


def test_a_loop_without_a_joint_of_the_arm_is_refused(tmp_path):
    with pytest.raises(UsageError, match="shoulder is missing"):
        loop(tmp_path, ["elbow", "gripper"])
    assert loop(tmp_path, ["shoulder", "elbow"]).dynamics is not None


def test_settings_are_changed_beside_an_arm_and_what_it_excludes_is_not(tmp_path):
    comp, given = loop(tmp_path), swing()
    (tmp_path / "arm.urdf").unlink()
    comp.set("elbow", gain=0.5)
    with pytest.raises(UsageError, match=r"elbow\.adaptation: must be off"):
        comp.set("elbow", adaptation={})
    steps(comp, CYCLES, **given)
    assert np.isfinite(recorded(comp)[:, 1:]).all()


def test_nothing_is_compiled_in_the_loop(tmp_path):
    comp, given = loop(tmp_path), swing()
    before = [len(ready(each).signatures) for each in (kernel.step, kernel.find_loads)]
    steps(comp, 50, **given)
    assert before == [len(ready(each).signatures) for each in (kernel.step, kernel.find_loads)]


def test_whatever_it_is_given_nothing_raises_and_the_output_and_the_loads_are_numbers(tmp_path):
    comp, given, random = loop(tmp_path), swing(), np.random.default_rng(4)
    steps(comp, 60, **given)
    odd = (math.nan, math.inf, -1e300, 1e9, 0.0)
    for k in range(300):
        row = {name: value[60 + k].copy() for name, value in given.items()} | {"load": np.full(3, math.nan)}
        for name in random.choice(list(row), 3):
            row[name] = random.choice(odd, 3) if random.random() < 0.9 else [None, "x", [1.0]][k % 3]
        out = comp.step(**row, dt=PERIOD_S)
        assert np.isfinite(out).all()
        assert (np.abs(out) <= LIMITS["torque"]).all()
    loads = recorded(comp)[:360, 1:]
    assert not np.isinf(loads).any()
    assert np.abs(np.nan_to_num(loads)).max() <= 1e7  # `MOST_TORQUE`
