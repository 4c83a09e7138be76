"""`run --simulate` with `arm:`: better than with the gravity of each axis, no sag in a fault, repeated bit for bit."""

import numpy as np
import pytest
import yaml

import friction_hil as fh
from friction_hil.config import load, self_contained
from friction_hil.daemon.safety import LoopState
from tests.arm_machine import ARM, DRIVE_INERTIA, MACHINE, NAMES, gravity, write
from tests.processes import run

PERIOD = 2500  # cycles of the motion
QUICK = {f"axes__{name}__compensation": {"gain": 1.0, "fade_s": 0.1} for name in NAMES}


def recorded(folder, path, duration_s, *, status=0):
    """What `run` said, and the recordings of both joints."""
    record = folder / f"{path.stem}.mcap"
    words = ("run", path, "--simulate", "--pace", "sync", "--duration", str(duration_s), "--record", record, "--json")
    done = run(*words, check=False)
    assert done.returncode == status, done.stderr
    return done, record, fh.recordings.read_all(record)


def columns(found, name):
    return np.stack([found[axis][name] for axis in NAMES], axis=1)


@pytest.mark.deep
def test_an_arm_lowers_the_following_error(tmp_path):
    alone = tmp_path / "alone.yaml"
    values = self_contained(load(MACHINE))
    for name in NAMES:
        values["axes"][name]["compensation"] |= QUICK[f"axes__{name}__compensation"] | {"baseline_s": 0.0}
    alone.write_text(yaml.safe_dump(values))
    with_arm = write(tmp_path, ARM | {"drive_inertia": DRIVE_INERTIA}, **QUICK)
    errors = []
    for path in (alone, with_arm):
        done, _, found = recorded(tmp_path, path, 3.3)
        running = columns(found, "state")[:, 0] == LoopState.RUNNING
        error = (columns(found, "position_demand") - columns(found, "position"))[running]
        errors.append(np.sqrt(np.mean(error[-PERIOD:] ** 2, axis=0)))
    assert (errors[1] < np.array([0.7, 0.4]) * errors[0]).all()
    assert "elbow: inertia and coupling of the arm, and its weight, up to 6.24 N m, are fed forward" in done.stderr


def test_after_a_fault_in_motion_the_drives_have_the_weight_and_it_is_repeated_bit_for_bit(tmp_path):
    """Uncompensated, the arm leaves its limit at a reversal, bent and in motion."""
    tight = {f"axes__{name}__compensation": {"enabled": True, "baseline_s": 9.0} for name in NAMES}
    path = write(tmp_path, **tight, axes__elbow__limits__following_error=1e-3)
    done, record, found = recorded(tmp_path, path, 4.0, status=1)
    assert "FH-109" in done.stdout + done.stderr
    state, position = columns(found, "state")[:, 0], columns(found, "position")
    stopped = np.isin(state, (LoopState.FAULT_STOPPING, LoopState.DISABLING))
    assert stopped.sum() > 20
    weight = gravity(*position[stopped].T).T
    assert np.abs(weight).max() > 5.0, "it has a weight there"
    assert columns(found, "feedforward")[stopped] == pytest.approx(weight, abs=0.3)
    disabling = state == LoopState.DISABLING
    assert np.ptp(position[disabling], axis=0).max() < 1e-3
    powered = stopped & (columns(found, "drive_state")[:, 0] != columns(found, "drive_state")[-1, 0])
    assert columns(found, "command")[powered][-1] == pytest.approx(weight[powered[stopped]][-1], abs=0.3)
    (tmp_path / "arm.urdf").unlink()
    assert "2 of 2 verified" in run("replay", "--verify", record).stdout
