"""What the commands say of a drive without a torque input: limits that are too small, and the gains of its loops."""

from dataclasses import asdict

import numpy as np
import pytest

from friction_hil.checked_yaml.text import dump
from friction_hil.cli.work.config import _short_limits
from friction_hil.config import load, self_contained
from friction_hil.recordings import Recording
from friction_hil.servo.config import Loops, ServoConfig
from friction_hil.tuning.simulated import recorded_loops
from tests.servo_drives import axis_dict, configuration, run

LOOP = {"velocity_gain": 0.1, "integral_hz": 10.0, "slew": 1e4}
NAMES = ("time_s", "position", "position_demand", "velocity_demand", "torque", "state", "is_enabled", "compensation")


@pytest.mark.parametrize(("limit", "is_short"), [(1.0, True), (5.0, False)])
def test_a_limit_that_is_too_small_for_a_reversal_is_told_with_its_line(tmp_path, limit, is_short):
    config = configuration(x=axis_dict(compensation={"velocity_offset": LOOP | {"limit": limit}}))
    (tmp_path / "x.yaml").write_text(dump(self_contained(config)))
    notes = _short_limits(str(tmp_path / "x.yaml"), load(tmp_path / "x.yaml"))
    assert [note.field for note in notes] == ["axes.x.compensation.velocity_offset.limit"] * is_short
    assert all(note.line is not None and "is 1, and the friction" in str(note) for note in notes)


def test_the_gains_of_the_loops_are_found_in_the_part_without_compensation():
    loops = Loops(position_gain=100.0, velocity_gain=0.1, integral_hz=6.0)
    motion = {"kind": "experiment", "velocity": 4.0, "travel": 0.8, "duration_s": 10.0, "ramp_s": 0.25}
    of_axis = {"fade_s": 0.1, "baseline_s": 9.0}
    config = configuration(x=axis_dict(compensation=of_axis, trajectory=motion))
    _, rows, drives = run(config, servo=ServoConfig(loops=loops), duration_s=11.0)
    columns = {name: np.array(rows.column("x", name)) for name in NAMES}
    assert columns["compensation"].any()
    facts = [asdict(fact) for fact in drives.connect()]
    about = {"configuration": self_contained(config), "facts": facts}
    found, _ = recorded_loops([Recording("other", "x", columns), Recording("run.mcap", "x", columns, metadata=about)])
    assert found.velocity_gain == pytest.approx(0.1, rel=0.1)
    assert found.integral_hz == pytest.approx(6.0, rel=0.3)
    columns["is_enabled"][:] = 1.0
    assert recorded_loops([Recording("run.mcap", "x", columns, metadata=about)]) == (None, "")
