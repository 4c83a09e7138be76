"""The daemon against simulated drives: real processes, a real (virtual) bus, simulated time."""

import signal
import struct

import numpy as np
import pytest
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects, profile

import friction_hil as fh
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState
from friction_hil.recordings import read_all
from friction_hil.replay.verify import verify
from tests.processes import (
    listening,
    run,
    run_daemon,
    simulated_drives,
    start_daemon,
    wait_for_frames,
    write_configuration,
)
from tests.servo_drives import TRUE_FRICTION

SYNC, TPDO1, RPDO1 = cia301.SYNC_ID, cia301.TPDO_BASES[0], cia301.RPDO_BASES[0]
MISMATCH = {"coulomb": 0.068, "static": 0.135, "sigma0": 2400.0, "sigma2": 1.7e-3, "stribeck_velocity": 0.23}
TWO_AXES = {
    "x": {"trajectory": {"kind": "circle", "radius": 0.5, "frequency": 1.0, "phase": 0.0, "ramp_s": 0.5}},
    "y": {
        "node": 2,
        "trajectory": {"kind": "circle", "radius": 0.5, "frequency": 1.0, "phase": -1.5708, "ramp_s": 0.5},
    },
}


def model_with(**changes):
    parameters = {**TRUE_FRICTION, **changes}
    return {
        "axis": "rotary",
        "friction": {"model": "lugre", "parameters": parameters},
        "mechanics": {"inertia": 2.2e-4, "torque_lag_s": 3e-4},
    }


def following_error(recording):
    moving = (recording["state"] == LoopState.RUNNING) & (recording["is_fresh"] == 1.0)
    return (recording["position_demand"] - recording["position"])[moving]


def test_compensation_takes_the_friction_out_of_two_axes(tmp_path):
    axes = {name: {**axis, "model": model_with(**MISMATCH)} for name, axis in TWO_AXES.items()}
    for axis in axes.values():
        axis["compensation"] = {"fade_s": 0.2, "baseline_s": 1.8}
    configuration = write_configuration(tmp_path, **axes)
    with simulated_drives(configuration):
        result, _ = run_daemon(configuration, "--duration", 3.8, "--record", tmp_path / "run.mcap")
    assert result["faults"] == []
    assert result["missed"] == 0
    assert result["recording"] == str(tmp_path / "run.mcap")
    assert set(result["axes"]) == {"x", "y"}
    for recording in read_all(tmp_path / "run.mcap").values():
        error = following_error(recording)
        before, after = error[700:1700], error[2700:3700]  # one lap each, in steady motion
        assert np.sqrt(np.mean(after**2)) < np.sqrt(np.mean(before**2)) / 3.0
        assert np.abs(after).max() < np.abs(before).max() / 2.0


def test_the_recording_replays_bit_for_bit_and_two_runs_are_the_same(tmp_path):
    configuration = write_configuration(tmp_path, **TWO_AXES)
    recordings = []
    for name in ("first.mcap", "second.mcap"):
        with simulated_drives(configuration):
            run_daemon(configuration, "--duration", 0.8, "--record", tmp_path / name)
        recordings.append(read_all(tmp_path / name))
    for axis, first in recordings[0].items():
        assert verify(first).is_verified
        for column, values in first.columns.items():
            np.testing.assert_array_equal(values, recordings[1][axis].columns[column], err_msg=column)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_brings_the_axis_to_rest_and_closes_the_recording(tmp_path, number):
    configuration = write_configuration(tmp_path)
    with simulated_drives(configuration), listening(configuration) as bus:
        daemon = start_daemon(configuration, "--record", tmp_path / "run.mcap")
        wait_for_frames(bus, SYNC, 800)
        daemon.send_signal(number)
        _, errors = daemon.communicate(timeout=60)
    assert daemon.returncode == 0, errors
    recording = fh.recordings.read(tmp_path / "run.mcap")
    assert recording.problems == [] or "finite" in recording.problems[0]
    states = recording["state"]
    assert states[-1] == LoopState.DISABLING
    assert LoopState.STOPPING in states
    assert recording["compensation"][-1] == 0.0
    assert abs(recording["velocity_estimate"][-1]) < 0.05  # at full speed it was 1.9 rad/s
    assert len(recording) >= 800


def test_a_killed_daemon_leaves_no_torque_behind(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    configuration = write_configuration(tmp_path)
    with simulated_drives(configuration), listening(configuration) as bus:
        daemon = start_daemon(configuration)
        wait_for_frames(bus, SYNC, 1000)
        daemon.kill()
        daemon.communicate(timeout=60)
        while bus.recv(0.1) is not None:  # unread frames would fill the socket and push answers out
            pass
        emergencies = []
        for _ in range(400):  # somebody goes on with SYNC, by which the drive's time passes
            bus.send(fh_message(SYNC))
            statusword = read_object(bus, 1, objects.STATUSWORD, emergencies)
        assert emergencies[0] in (0x8250, 0x8130)
        assert profile.drive_state(statusword) is DriveState.FAULT
        assert read_object(bus, 1, objects.TORQUE_DEMAND) == 0

        refused, done = run_daemon(configuration, "--duration", 0.3, check=False)
        assert done.returncode == 1
        assert "fault" in refused["faults"][0]
        assert "--reset-fault" in done.stderr
        result, _ = run_daemon(configuration, "--duration", 0.3, "--reset-fault")
        assert (result["faults"], result["black_boxes"]) == ([], [])
    boxes = sorted((tmp_path / "friction-hil").iterdir())  # of the killed daemon, and of the run that was refused
    assert refused["black_boxes"] == [str(boxes[1])]
    assert f"black box: the minute before the fault is in {boxes[1]}" in done.stderr
    events = [[event.name for event in fh.recordings.read(path).events] for path in boxes]
    assert ("abandoned" in events[0], "fault" in events[1]) == (True, True)


def test_the_second_daemon_on_an_axis_is_refused(tmp_path):
    configuration = write_configuration(tmp_path)
    with simulated_drives(configuration), listening(configuration) as bus:
        first = start_daemon(configuration)
        try:
            wait_for_frames(bus, SYNC, 100)
            _, second = run_daemon(configuration, "--duration", 0.3, check=False)
            assert second.returncode == 2
            assert "a daemon called 'axes' runs already" in second.stderr
            _, second = run_daemon(configuration, "--duration", 0.3, "--name", "second", check=False)
            assert second.returncode == 1
            assert "another daemon" in second.stderr
            assert "Traceback" not in second.stderr
            wait_for_frames(bus, SYNC, 100)  # the first one goes on
        finally:
            first.send_signal(signal.SIGINT)
            _, errors = first.communicate(timeout=60)
    assert first.returncode == 0, errors


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"identity": {"vendor_id": 0xABC}}, "0xabc"),
        ({"limits": {"torque": 0.3, "velocity": 30.0, "position": [-0.1, 10.0]}}, "position limits"),
    ],
)
def test_a_drive_that_does_not_fit_is_refused(tmp_path, changes, message):
    configuration = write_configuration(tmp_path, x=changes)
    with simulated_drives(configuration), listening(configuration) as bus:
        _, done = run_daemon(configuration, "--duration", 0.5, check=False)
        assert done.returncode == 1
        assert message in done.stderr
        assert "Traceback" not in done.stderr
        assert not profile.drive_state(read_object(bus, 1, objects.STATUSWORD)).is_powered


def test_nobody_answers(tmp_path):
    configuration = write_configuration(tmp_path)
    _, done = run_daemon(configuration, "--duration", 0.5, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("Error: x: no drive answers as node 1")
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("changes", "words", "message"),
    [
        ({}, ["--record", "run.csv"], "run.csv: recordings are written as .mcap"),
        ({}, ["--record", "."], ". is a folder"),
        ({"eds": "drive.eds"}, [], "drive.eds cannot be read: No such file"),
        ({"eds": "noise.eds"}, [], "noise.eds is no valid EDS: File contains no section headers.\n"),
    ],
)
def test_wrong_files_are_told_before_any_drive_is_asked(tmp_path, changes, words, message):
    (tmp_path / "noise.eds").write_bytes(b"\x1b[2J\x07 noise\n" * 9)
    configuration = write_configuration(tmp_path, x=changes)
    done = run("run", configuration, "--pace", "sync", *words, check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_run_that_ends_before_its_first_cycle_prints_no_nan(tmp_path):
    limits = {"torque": 0.3, "velocity": 30.0, "position": [-0.1, 10.0]}
    configuration = write_configuration(tmp_path, x={"limits": limits})
    with simulated_drives(configuration):
        done = run("run", configuration, "--pace", "sync", check=False)
    assert done.returncode == 1
    assert "0 cycles of 1 ms; in simulated time\n" in done.stdout
    assert "nan" not in done.stdout


def test_a_bus_that_does_not_open(tmp_path):
    configuration = write_configuration(tmp_path, bus={"interface": "socketcan", "channel": "nocan7"})
    done = run("run", configuration, "--duration", 0.5, check=False)
    assert done.returncode == 1
    assert "nocan7" in done.stderr
    assert "ip link" in done.stderr
    assert "Traceback" not in done.stderr


def fh_message(can_id, data=b""):
    import can

    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


def read_object(bus, node, entry, emergencies=None):
    """Expedited SDO upload, by its bytes; error codes of emergencies that pass by are added to ``emergencies``."""
    request = struct.pack("<BHBI", 0x40, entry.index, entry.subindex, 0)
    bus.send(fh_message(cia301.SDO_REQUEST_BASE + node, request))
    while True:
        message = bus.recv(10.0)
        assert message is not None, f"{entry} was not answered"
        if message.arbitration_id == cia301.EMERGENCY_BASE + node and emergencies is not None:
            emergencies.append(struct.unpack_from("<H", message.data)[0])
        is_answer = message.arbitration_id == cia301.SDO_RESPONSE_BASE + node
        if is_answer and struct.unpack_from("<HB", message.data, 1) == entry.address:
            assert message.data[0] & 0xE0 == 0x40, bytes(message.data).hex()
            size = 4 - (message.data[0] >> 2 & 3)
            return int.from_bytes(message.data[4 : 4 + size], "little", signed=entry.type.name.startswith("INT"))
