"""The identified axis as a simulated servo."""

import math

import numpy as np
import pytest

from friction_hil.identification.drive_loop import DriveLoops
from friction_hil.models.model_file import ModelFile
from friction_hil.recordings import Recording
from friction_hil.tuning.rehearsed import simulated_axis

LOOPS = DriveLoops(80.0, 0.1, 6.0, 1.0, 2e-4, 3e-4, 0.99)
COULOMB = {"version": 1, "axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": 0.1}}}


def servo(inertia: float, loops: DriveLoops | None):
    recording = Recording("x.mcap", "x", {"torque": np.array([0.1, -0.2])}, {})
    return simulated_axis(ModelFile.model_validate(COULOMB), inertia, loops, recording, 1e-3, math.tau / 2**20)


@pytest.mark.parametrize(("inertia", "expected"), [(0.0, 2e-4), (math.nan, 2e-4), (1e-4, 1e-4)])
def test_an_inertia_that_the_motion_does_not_show_is_that_of_the_feed_forward(inertia: float, expected: float) -> None:
    simulated = servo(inertia, LOOPS)
    assert simulated.mechanics.inertia == expected
    assert simulated.loops.inertia_feedforward * simulated.mechanics.inertia == pytest.approx(LOOPS.inertia)


def test_without_any_inertia_there_is_no_simulation() -> None:
    assert servo(0.0, None) is None
