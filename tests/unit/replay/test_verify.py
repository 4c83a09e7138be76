"""Verification of the daemon's own recordings: the same bits again, and every single one that is not."""

import math
import struct
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil import __version__, recordings
from friction_hil.compensator import INPUTS, RESULTS
from friction_hil.config import from_dict, self_contained
from friction_hil.daemon.axis import AxisLoop
from friction_hil.daemon.loop import Loop
from friction_hil.daemon.realtime import SteppedClock
from friction_hil.daemon.run import LoopSettings
from friction_hil.daemon.stop import StopRequest
from friction_hil.errors import RecordingError
from friction_hil.motion.trajectory import PathTime
from friction_hil.recordings import columns
from friction_hil.recordings.columns import input_checksum
from friction_hil.recordings.fingerprint import fingerprint
from friction_hil.recordings.mcap_writer import McapWriter
from friction_hil.replay.verify import verify
from tests.loop_run import LateClock
from tests.servo_drives import TRUE_FRICTION, Rows, ServoDrives, axis_dict, configuration

CHECKED = (*RESULTS, "shadow_dahl")
# Written by real runs against simulated drives with --pace sync: one axis with Kalman filter, load, temperature,
# ripple, transmission, adaptation and a shadow, and one axis of the first version.
GOLDEN = Path(__file__).parent / "golden"
MODEL = axis_dict()["model"]
MODIFIERS = {"load": {"motoring": 0.1, "driven": 0.05}, "temperature": {"reference": 40.0, "coefficient": -0.004}}
MODIFIED = MODEL | {
    "friction": MODEL["friction"] | {"modifiers": MODIFIERS},
    "mechanics": {"inertia": 2e-4, "torque_lag_s": 3e-4, "gravity": {"sine": 0.02}}
    | {"backlash": 1e-3, "load": {"inertia": 1e-4, "friction": 0.03, "stiffness": 200.0}},
    "thermal": {"capacity": 100.0, "resistance": 1.0, "copper_loss": 50.0},
}
DAHL = {"model": "dahl", "parameters": {"sigma0": 2000.0, "coulomb": 0.08, "exponent": 1.5}}
SHADOW = {"name": "dahl", "model": {"axis": "rotary", "friction": DAHL}}
STRIBECK = {"model": "stribeck", "parameters": {"coulomb": 0.07, "static": 0.1, "stribeck_velocity": 0.2}}
OTHER = {"axis": "rotary", "friction": STRIBECK, "mechanics": {"inertia": 2e-4}}


def quick(**changes):
    motion = {"kind": "sine", "amplitude": 0.3, "frequency": 2.0, "ramp_s": 0.1}
    return axis_dict(**{"trajectory": motion, "compensation": {"fade_s": 0.05}} | changes)


class Made:
    """What a run of two axes, one with a shadow model, gave; it can be written again with changes."""

    def __init__(self, clock=None):
        compensation = {"fade_s": 0.05, "transmission": {"acceleration": 300.0}}
        whole = quick(shadows=[SHADOW], model=MODIFIED, compensation=compensation)  # it uses everything
        loop = {"velocity_gain": 0.2, "integral_hz": 16.0, "limit": 5.0, "slew": 5e3}
        by_velocity = {"fade_s": 0.05, "velocity_offset": loop}
        self.config = configuration(x=whole, y=quick(node=2, model=OTHER, compensation=by_velocity))

        def flaky(cycle, feedback):
            feedback[0].is_fresh = not 420 <= cycle < 424
            feedback[0].temperature = 45.0 if 200 < cycle < 800 else math.nan

        drives = ServoDrives(self.config, disturb=flaky)
        facts = drives.connect()
        time = PathTime(0.1)
        axes = [AxisLoop(f.name, self.config.axes[f.name], f, 1e-3, time, ["dahl"]) for f in facts]
        rows = Rows(self.config)
        settings = LoopSettings(1e-3, duration_s=1.3)
        loop = Loop(drives, axes, time, clock or SteppedClock(), rows, settings, StopRequest())
        assert loop.run().faults == []
        self.rows = np.array(rows.rows)
        self.columns = [*columns.NAMES, "shadow_dahl"]
        self.state_width = max(axis.state_width for axis in axes)
        self.metadata = {"configuration": self_contained(self.config), "fingerprint": fingerprint()}
        self.metadata["facts"] = [asdict(f) for f in facts]

    def place(self, name, axis=0):
        return axis * (len(self.columns) + self.state_width) + self.columns.index(name)

    def write(self, path, rows=None, **metadata):
        """A recording as the companion writes it; returns it read again, one an axis."""
        about = self.metadata | metadata
        given = {"state_width": self.state_width, "metadata": about, "overwrite": True}
        writer = McapWriter(path, ["x", "y"], self.columns, **given)
        writer.write(self.rows if rows is None else rows)
        writer.close()
        return recordings.read_all(path)


@pytest.fixture(scope="module")
def made():
    return Made()


def flipped(value, bit):
    (word,) = struct.unpack("<Q", struct.pack("<d", value))
    return struct.unpack("<d", struct.pack("<Q", word ^ 1 << bit))[0]


def test_an_unaltered_recording_comes_out_bit_for_bit(made, tmp_path):
    for name, recording in made.write(tmp_path / "run.mcap").items():
        result = verify(recording)
        assert (result.axis, result.is_verified, result.reason) == (name, True, "")
        assert (result.rows, result.tolerance, result.differences) == (len(made.rows), 0.0, ())
        assert len(recording.restarts) >= 2  # one a chunk
        assert np.abs(recording["compensation"]).max() > 0.03
    whole, by_velocity = made.write(tmp_path / "run.mcap").values()
    assert np.abs(by_velocity["velocity_offset"]).max() > 0.3
    assert not by_velocity["command"].any()
    assert np.ptp(whole["load_estimate"]) > 8e-3
    assert np.ptp(whole["motor_offset"]) == pytest.approx(1.4e-3, abs=0.2e-3)
    assert np.ptp(whole["temperature_estimate"]) > 0.4  # from the observer's 20 deg C towards the measured 45


def test_a_recording_with_missed_periods_comes_out_bit_for_bit(tmp_path):
    """The set-points that catch up are in the recording, and nothing else is needed to repeat the compensation."""
    made = Made(LateClock({300: 5_000_000, 310: 9_000_000, 600: 1_000_000}))
    for recording in made.write(tmp_path / "run.mcap").values():
        result = verify(recording)
        assert (result.is_verified, result.rows, result.differences) == (True, len(made.rows), ())
        assert np.nanmax(recording["path_lag_s"]) == pytest.approx(14e-3, abs=1e-3)


@pytest.mark.deep
@pytest.mark.parametrize(("bit", "row"), [(0, 0), (51, 777), (63, 1200)])
@pytest.mark.parametrize("name", INPUTS)
def test_one_flipped_bit_of_one_input_names_its_cycle(made, tmp_path, name, bit, row):
    """In the file itself; rows 0 and 1200 lie at the beginning and within the second chunk."""
    rows = made.rows.copy()
    place = made.place(name)
    rows[row, place] = flipped(rows[row, place], bit)
    result = verify(made.write(tmp_path / "run.mcap", rows)["x"])
    assert not result.is_verified
    assert result.reason.startswith(f"cycle {row}: the recorded inputs are not those that the daemon saw")


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 1200), st.integers(0, 63), st.sampled_from(CHECKED))
def test_one_flipped_bit_of_a_result_names_its_cycle(made, tmp_path_factory, row, bit, name):
    rows = made.rows.copy()
    place = made.place(name)
    before = rows[row, place]
    rows[row, place] = flipped(before, bit)
    result = verify(made.write(tmp_path_factory.mktemp("flip") / "run.mcap", rows)["x"])
    cycle = int(rows[row, made.place("cycle")])
    assert result.reason.startswith(f"cycle {cycle}: {name} was ")
    assert repr(float(before)) in result.reason


def test_an_altered_input_with_a_matching_checksum_is_found_by_what_follows_from_it(made, tmp_path):
    rows = made.rows.copy()
    rows[700, made.place("position")] += 1e-6
    rows[700, made.place("checksum")] = input_checksum(*(rows[700, made.place(name)] for name in INPUTS))
    result = verify(made.write(tmp_path / "run.mcap", rows)["x"])
    assert result.reason.startswith("cycle 700: compensation was")


@pytest.mark.parametrize("axis", ["x", "y"])
def test_it_starts_again_after_lost_rows(made, tmp_path, axis):
    rows = np.delete(made.rows, np.r_[300:340, 500:501, 900:1100], axis=0)
    recording = made.write(tmp_path / "run.mcap", rows)[axis]
    assert "cycles are missing in 3 gaps" in recording.problems[0]
    result = verify(recording)
    assert (result.is_verified, result.rows) == (True, len(rows))
    # without the states after the gaps it could not come out
    recording.restarts = recording.restarts[:1]
    assert verify(recording).reason.startswith("cycle 340: ")


def test_a_restart_in_the_wrong_state_is_found(made, tmp_path):
    rows = np.delete(made.rows, np.r_[300:340], axis=0)
    recording = made.write(tmp_path / "run.mcap", rows)["x"]
    row, state = recording.restarts[1]
    recording.restarts[1] = (row, state + 1e-9)
    assert verify(recording).reason.startswith(f"cycle {recording['cycle'][row]:.0f}: ")


def test_elsewhere_a_billionth_of_the_break_away_level_is_allowed_and_no_more(made, tmp_path):
    elsewhere = {"fingerprint": fingerprint() | {"cpu": "another", "numpy": "0.1"}}
    level = TRUE_FRICTION["static"]
    for share, is_verified in ((0.9e-9, True), (1.1e-9, False)):
        rows = made.rows.copy()
        rows[:, made.place("compensation")] += share * level
        result = verify(made.write(tmp_path / "run.mcap", rows, **elsewhere)["x"])
        assert result.is_verified is is_verified
        assert result.tolerance == pytest.approx(1e-9 * level)
        names = (f"cpu: another, here {fingerprint()['cpu']}", f"numpy: 0.1, here {np.__version__}")
        assert result.differences == names
    rows[:, made.place("compensation")] = np.nan
    rows[5, made.place("compensation")] = 0.0
    assert not verify(made.write(tmp_path / "run.mcap", rows, **elsewhere)["x"]).is_verified
    assert not verify(made.write(tmp_path / "run.mcap", np.where(rows == 0.0, 1e-6, rows))["x"]).is_verified


def test_the_tolerance_is_that_of_the_axis(made, tmp_path):
    recording = made.write(tmp_path / "run.mcap", fingerprint={})["y"]
    assert verify(recording).tolerance == pytest.approx(1e-9 * 0.1)
    assert "not reported" in verify(recording).differences[0]


def test_a_configuration_beside_it_is_taken_instead(made, tmp_path):
    recording = made.write(tmp_path / "run.mcap")["y"]
    assert verify(recording, made.config).is_verified
    other = self_contained(made.config)
    other["axes"]["y"]["compensation"]["gain"] = 0.8
    result = verify(recording, from_dict(other, "other"))
    assert not result.is_verified
    assert "compensation was" in result.reason
    del other["axes"]["y"]
    with pytest.raises(RecordingError, match="its axis 'y' is not in the configuration, which has x"):
        verify(recording, from_dict(other, "other"))


def test_a_configuration_with_other_models_does_not_fit(made, tmp_path):
    recording = made.write(tmp_path / "run.mcap")["x"]
    other = self_contained(made.config)
    other["axes"]["x"]["shadows"].append(SHADOW | {"name": "more"})
    with pytest.raises(RecordingError, match="shadow_more"):
        verify(recording, from_dict(other, "other"))
    recording.restarts = [(row, state[:-30]) for row, state in recording.restarts]
    with pytest.raises(RecordingError, match="the recorded state has"):
        verify(recording)


@pytest.mark.parametrize("missing", ["configuration", "facts", "states", "checksum", "axis"])
def test_what_is_not_the_daemons_own_is_refused(made, tmp_path, missing):
    recording = made.write(tmp_path / "run.mcap")["x"]
    if missing == "states":
        recording.restarts = []
    elif missing == "checksum":
        recording.columns["checksum"][:] = np.nan
    elif missing == "axis":
        recording.metadata["facts"] = []
    else:
        del recording.metadata[missing]
    with pytest.raises(RecordingError):
        verify(recording)


def test_an_altered_velocity_offset_is_found(made, tmp_path):
    recording = made.write(tmp_path / "run.mcap")["y"]
    recording.columns["velocity_offset"][700] *= 1.0 + 1e-15
    assert verify(recording).reason.startswith("cycle 700: velocity_offset was ")


def test_a_csv_of_it_and_a_recording_of_a_version_with_other_columns_are_refused(made, tmp_path):
    recording = made.write(tmp_path / "run.mcap")["x"]
    recordings.write(tmp_path / "run.csv", recording)
    with pytest.raises(RecordingError, match="the daemon's own MCAP recording"):
        verify(recordings.read(tmp_path / "run.csv"))
    del recording.columns["load_estimate"]
    with pytest.raises(RecordingError, match="no column load_estimate; another version of friction_hil"):
        verify(recording)


def test_a_recording_of_an_earlier_build_comes_out_bit_for_bit():
    """Its states are laid out as that build laid them out, and its torque was computed by that build's code."""
    recording = recordings.read_all(GOLDEN / "0.3.0.dev0.mcap")["x"]
    recording.metadata["fingerprint"]["friction_hil"] = __version__  # a later version allows no difference, either
    result = verify(recording)
    assert (result.is_verified, result.reason, result.rows) == (True, "", 285)
    assert (result.tolerance == 0.0) is (result.differences == ())  # on another machine, a billionth


def test_a_recording_of_the_first_version_is_read_and_only_that_version_verifies_it():
    """It has neither the columns nor the states of what the compensator has learned to do since."""
    recording = recordings.read_all(GOLDEN / "0.1.0.mcap")["x"]
    assert len(recording) == 161
    assert np.abs(recording["compensation"]).max() == pytest.approx(0.08, abs=0.01)
    with pytest.raises(RecordingError, match=r"no column acceleration_demand_ahead, .*another version of friction_hil"):
        verify(recording)
