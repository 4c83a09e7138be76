"""The daemon against simulated drives on serial lines: real processes on pseudo-terminals and the loopback.

Where it can be, time is simulated. Where it has to be real (a watchdog, a line that goes away and comes back), all that
is waited for is certain to happen, and the limits are far wider than any machine is slow.
"""

import contextlib
import os
import re
import select
import signal
import socket
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml
from friction_hil_drivers.serial_line.line import Line, LineGoneError
from friction_hil_drivers.serial_line.options import LineOptions

import friction_hil as fh
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState
from tests.peers.serial_processes import (
    DRIVES,
    process,
    program,
    wait_until,
    write_serial_configuration,
)
from tests.processes import run, run_daemon, simulated_drives, start_daemon

KINDS = list(DRIVES)
IN_REAL_TIME = ("--pace", "real")
# bridges two seconds, and so does the drive
LIMITS = {"torque": 0.3, "torque_slew": 300.0, "velocity": 30.0, "following_error": 2.0}
SLOW = {"period_s": 0.01, "realtime": {"priority": 0, "max_missed": 200}, "watchdog_s": 2.0, "limits": LIMITS}
MODERATE = {"corrupt": 0.02, "drop": 0.02, "delay": 0.02, "delay_s": 0.02, "split": 0.05, "noise": 0.05, "seed": 7}


@contextlib.contextmanager
def daemon(configuration: Path, recording: Path, *options: str):
    """The daemon in the background, in motion: a good part of the recording is written."""
    running = start_daemon(configuration, "--record", recording, *options)
    try:
        wait_until(
            lambda: running.poll() is not None or (recording.exists() and recording.stat().st_size > 20_000),
            "the daemon's recording",
            60.0,
        )
        assert running.poll() is None, running.communicate()
        yield running
    finally:
        running.kill()
        running.communicate()


def is_whole(recording: Path) -> bool:
    """Whether a recording is undamaged and ended, whatever cycles a busy machine has missed."""
    return all("cycles are missing" in problem for problem in fh.recordings.read(recording).problems)


def port_in(configuration: Path) -> str:
    return yaml.safe_load(configuration.read_text())["axes"]["x"]["line"]["port"]


def ended(running) -> str:
    """Standard error of a daemon that ends by itself, with exit status 1 and without a traceback."""
    _, errors = running.communicate(timeout=60)
    assert running.returncode == 1, errors
    assert "Traceback" not in errors
    return errors


def refused(configuration: Path, *options: str) -> tuple[int, str]:
    """Exit status of a run that does not begin, and the one line that it says about it."""
    done = run("run", configuration, "--pace", "sync", "--duration", 0.1, *options, check=False)
    assert done.returncode in (1, 2), done.stdout
    assert "Traceback" not in done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    return done.returncode, done.stderr


# A good line


@pytest.mark.deep
@pytest.mark.parametrize("kind", ["modbus rtu", "odrive"])
def test_friction_is_taken_out_the_same_way_each_time(tmp_path, kind):
    recordings, errors = [], []
    for name, is_enabled in (("first", True), ("second", True), ("without", False)):
        compensation = {"enabled": is_enabled, "fade_s": 0.1}
        configuration = write_serial_configuration(tmp_path, kind, name=name, compensation=compensation)
        path = tmp_path / f"{name}.mcap"
        with simulated_drives(configuration):
            result, _ = run_daemon(configuration, "--duration", 2.0, "--record", path)
        assert result["faults"] == []
        assert result["axes"]["x"]["stale"] == 0
        recordings.append(fh.recordings.read(path))
        errors.append(result["axes"]["x"]["rms"])
    assert errors[0] <= 0.5 * errors[2]
    first, second, _ = recordings
    assert np.abs(first["compensation"]).max() > 0.05
    assert first["command"][-1] == 0.0
    assert not DriveState(first["drive_state"][-1]).is_powered
    for column, values in first.columns.items():
        np.testing.assert_array_equal(values, second.columns[column], err_msg=column)
    assert "verified" in run("replay", tmp_path / "first.mcap", "--verify").stdout


# The daemon dies


@pytest.mark.deep
@pytest.mark.parametrize("kind", ["modbus tcp", "odrive"])
def test_a_killed_daemon_leaves_no_torque_behind(tmp_path, kind):
    configuration = write_serial_configuration(tmp_path, kind, **SLOW)
    with simulated_drives(configuration, *IN_REAL_TIME):
        with daemon(configuration, tmp_path / "killed.mcap", *IN_REAL_TIME) as running:
            running.kill()
            running.communicate()
        # somebody who only listens does not feed the watchdog
        listening = (configuration, *IN_REAL_TIME, "--dry-run", "--duration", 30)
        seen, done = run_daemon(*listening, check=False)
        assert done.returncode == 1
        reason = "watchdog timer expired" if kind == "odrive" else "8100h communication error"
        assert re.search(f"the drive is in fault: .*{reason}; --reset-fault leaves it", seen["faults"][0])
        run_daemon(*listening, "--record", tmp_path / "after.mcap", check=False)
        after = fh.recordings.read(tmp_path / "after.mcap")
        assert set(after["drive_state"]) == {DriveState.FAULT}
        assert np.all(after["velocity"] == 0.0)
        _, done = run_daemon(configuration, *IN_REAL_TIME, "--duration", 0.2, check=False)
        assert done.returncode == 1
        result, _ = run_daemon(configuration, *IN_REAL_TIME, "--duration", 0.2, "--reset-fault")
        assert result["faults"] == []
    wait_until(lambda: is_whole(tmp_path / "killed.mcap"), "the recording's end")
    before = fh.recordings.read(tmp_path / "killed.mcap")
    assert before["drive_state"][-1] == DriveState.OPERATION_ENABLED
    assert abs(before["command"][-1]) > 0.0


# The line goes


def test_an_adapter_that_was_unplugged_is_noticed_without_writing(tmp_path):
    """Reading from a terminal that was hung up tells nothing by itself: it gives what a quiet line gives."""
    master, slave = os.openpty()
    line = Line(LineOptions(port=os.ttyname(slave)))
    line.open()
    os.close(slave)
    assert line.read() == b""
    os.write(master, b"last words")
    assert line.read() == b"last words"
    os.close(master)
    with pytest.raises(LineGoneError, match="is gone"):
        line.read()
    assert not line.is_open
    assert not line.reopen()


@pytest.mark.parametrize(("host", "shown"), [("127.0.0.1", "127.0.0.1"), ("::1", "[::1]"), ("127.0.0.1", "localhost")])
def test_a_connection_is_made_again_to_the_same_peer(host, shown):
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, 0), family=family)
    except OSError as error:
        pytest.skip(f"no listening at {host}: {error}")
    with listener:
        line = Line(LineOptions(port=f"tcp://{shown}:{listener.getsockname()[1]}"))
        line.open()
        listener.accept()[0].close()
        wait_until(lambda: select.select([line.descriptor], [], [], 0.0)[0], "the end of the connection")
        with pytest.raises(LineGoneError, match="the peer closed the connection"):
            line.read()
        wait_until(line.reopen, "the connection")
        listener.accept()[0].close()
        line.close()


@pytest.mark.deep
@pytest.mark.parametrize("kind", KINDS)
def test_drives_that_are_gone_end_the_run(tmp_path, kind):
    configuration = write_serial_configuration(tmp_path, kind)
    with simulated_drives(configuration) as drives, daemon(configuration, tmp_path / "run.mcap") as running:
        drives.kill()
        errors = ended(running)
    port = port_in(configuration)
    assert f"fault: x: no usable feedback for more than 10 cycles: {port} is gone: " in errors
    recording = fh.recordings.read(tmp_path / "run.mcap")
    assert recording["command"][-1] == 0.0
    assert recording["is_fresh"][-1] == 0.0


@pytest.mark.deep
def test_drives_that_are_gone_end_a_run_in_real_time(tmp_path):
    configuration = write_serial_configuration(tmp_path, "modbus rtu", **SLOW)
    with (
        simulated_drives(configuration, *IN_REAL_TIME) as drives,
        daemon(configuration, tmp_path / "run.mcap", *IN_REAL_TIME) as running,
    ):
        drives.kill()
        errors = ended(running)
    assert re.search(r"fault: x: no usable feedback for more than 200 cycles: \S*line is gone: ", errors)


@pytest.mark.deep
def test_torque_goes_on_when_the_adapter_is_back(tmp_path):
    """The adapter is a pair of pseudo-terminals by socat, between the daemon and the simulated drive."""
    socat = program("socat")
    adapter, drive_end = tmp_path / "adapter", tmp_path / "drive_end"
    changes = {
        "limits": LIMITS,
        "watchdog_s": 10.0,
        "period_s": 0.02,
        "realtime": {"priority": 0, "max_missed": 400},  # bridges eight seconds
        "compensation": {"fade_s": 0.1, "baseline_s": 0.0},
    }
    there = write_serial_configuration(
        tmp_path, "modbus rtu", name="there", line={"port": str(drive_end), "baud": 921600}, **changes
    )
    here = write_serial_configuration(
        tmp_path, "modbus rtu", name="here", line={"port": str(adapter), "baud": 921600}, **changes
    )
    words = (socat, f"pty,raw,echo=0,link={adapter}", f"{drive_end},raw,echo=0")
    path = tmp_path / "run.mcap"
    with simulated_drives(there, *IN_REAL_TIME), contextlib.ExitStack() as stack:
        with process(*words):
            wait_until(adapter.exists, "socat's pseudo-terminal")
            running = stack.enter_context(daemon(here, path, *IN_REAL_TIME))
        size = path.stat().st_size
        wait_until(lambda: path.stat().st_size > size, "rows of cycles without feedback")
        adapter.unlink(missing_ok=True)
        with process(*words):
            wait_until(adapter.exists, "socat's pseudo-terminal")
            size = path.stat().st_size
            wait_until(lambda: path.stat().st_size > size + 20_000, "rows after the return")
            running.send_signal(signal.SIGINT)
            _, errors = running.communicate(timeout=60)
    assert running.returncode == 0, errors
    recording = fh.recordings.read(path)
    running_states = recording["state"] == LoopState.RUNNING
    fresh = np.flatnonzero(running_states & (recording["is_fresh"] != 0.0))
    longest = int(np.argmax(np.diff(fresh)))  # a busy computer may lose single answers besides
    assert fresh[longest + 1] - fresh[longest] > 5
    after = fresh[longest + 1 :]
    assert len(after) > 20
    assert np.all(recording["drive_state"][after] == DriveState.OPERATION_ENABLED)
    assert np.abs(recording["command"][after]).max() > 0.05
    assert np.ptp(recording["position"][after]) > 0.1  # it moves by them


# A bad line


@pytest.mark.deep
@pytest.mark.parametrize("kind", ["modbus rtu", "odrive"])
def test_faults_on_the_line_are_bridged_and_counted(tmp_path, kind):
    configuration = write_serial_configuration(tmp_path, kind, simulation={"line": MODERATE}, **SLOW)
    with simulated_drives(configuration, *IN_REAL_TIME):
        result, done = run_daemon(
            configuration, *IN_REAL_TIME, "--duration", 3.0, "--record", tmp_path / "run.mcap", check=False
        )
    assert result["faults"] == []
    assert done.returncode == 0
    recording = fh.recordings.read(tmp_path / "run.mcap")
    lost = int(np.count_nonzero(recording["is_fresh"] == 0.0))
    assert 5 <= lost <= 0.5 * len(recording)
    figures = result["axes"]["x"]
    assert figures["stale"] == lost
    assert 0 < figures["bridged"] <= lost
    assert sum(figures["bridged_reasons"].values()) == figures["bridged"]
    moving = recording["state"] == LoopState.RUNNING
    assert np.abs(recording["position"][moving]).max() < 0.4  # no lie by a broken reply: of 0.3
    assert np.ptp(recording["position"][moving]) > 0.4


@pytest.mark.parametrize("kind", ["odrive"])
def test_more_silence_than_is_bridged_is_a_fault_that_says_why(tmp_path, kind):
    line = {"port": str(tmp_path / "line"), "baud": 921600, "reply_limit_s": 0.05}  # more than ten cycles
    simulation = {"line": {"drop": 0.05, "seed": 3}}
    configuration = write_serial_configuration(tmp_path, kind, line=line, watchdog_s=2.0, simulation=simulation)
    with simulated_drives(configuration, *IN_REAL_TIME):
        done = run("run", configuration, *IN_REAL_TIME, "--duration", 60, check=False)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    reasons = "no reply in time|no time was left|came in reply to"  # the last of more than ten: which one, chance says
    lost = f"fault: x: no usable feedback for more than 10 cycles: (late, )?(read|write) .*({reasons})"
    assert re.search(lost, done.stderr), done.stderr


@pytest.mark.parametrize(
    ("kind", "faults", "reason"),
    [
        ("modbus rtu", {"drop": 1.0}, r"of unit 3: no reply in time \(5 attempts\)"),
        ("modbus rtu", {"corrupt": 1.0}, "CRC is wrong|no reply of unit 3 to function 3|unit [0-9]+ answered instead"),
        ("odrive", {"drop": 1.0}, r"read position and velocity of x: no reply in time \(5 attempts\)"),
        ("odrive", {"corrupt": 1.0}, "came in reply to|no whole reply in time, only '|is no"),
    ],
)
def test_a_line_on_which_nothing_comes_right_is_told_with_its_reason(tmp_path, kind, faults, reason):
    configuration = write_serial_configuration(tmp_path, kind, simulation={"line": faults})
    with simulated_drives(configuration):
        status, text = refused(configuration)
    assert status == 1
    assert text.startswith("Error: x: read ")
    assert re.search(reason, text), text
    if "drop" in faults:
        assert "Right address, port and baud rate (921600)?" in text
    else:
        form = "a reply begins with the unit and the function, and ends in a CRC-16"
        if kind == "odrive":
            form = r"by the description a reply ends in '\r\n', with a checksum (xor)"
        right = "Right baud rate 921600, parity none, 1 stop bits, protocol and description?"
        assert f"(5 attempts). Bytes arrive, but no valid reply ({form}). {right}" in text


# What cannot be run at all


def test_the_second_daemon_on_a_line_is_refused(tmp_path):
    configuration = write_serial_configuration(tmp_path, "modbus rtu")
    with simulated_drives(configuration), daemon(configuration, tmp_path / "run.mcap") as first:
        status, text = refused(configuration, "--name", "second")
        assert status == 1
        assert text.startswith(f"Error: {port_in(configuration)} cannot be opened: another process has it")
        first.send_signal(signal.SIGINT)
        _, errors = first.communicate(timeout=60)
    assert first.returncode == 0, errors


def test_the_second_simulation_on_a_line_is_refused(tmp_path):
    configuration = write_serial_configuration(tmp_path, "odrive")
    with simulated_drives(configuration):
        done = run("simulate", configuration, check=False, stdin=subprocess.DEVNULL)
        assert done.returncode == 1
        assert done.stderr.startswith(f"Error: {port_in(configuration)}: another process simulates drives there")
        result, _ = run_daemon(configuration, "--duration", 0.1)  # the first one goes on
    assert result["faults"] == []


def test_a_port_that_is_not_there(tmp_path):
    status, text = refused(write_serial_configuration(tmp_path, "odrive"))
    assert status == 1
    assert text.startswith(f"Error: {tmp_path}/line cannot be opened: there is no such port; serial ports of this")


def test_a_tcp_port_at_which_nobody_listens(tmp_path):
    configuration = write_serial_configuration(tmp_path, "modbus tcp")
    status, text = refused(configuration)
    assert status == 1
    assert text.startswith(
        f"Error: {port_in(configuration)}: no connection: Connection refused; check that the drive is on"
    )


def test_a_period_that_the_wire_does_not_allow_is_refused_with_the_arithmetic(tmp_path):
    configuration = write_serial_configuration(
        tmp_path, "modbus rtu", period_s=1e-3, line={"port": str(tmp_path / "line"), "baud": 9600}
    )
    status, text = refused(configuration)
    assert status == 2
    assert "a period of 1 ms is too short for" in text
    assert "at 9600 baud: a cycle takes" in text
    # function 23 reads 7 registers and writes 3: unit, function, 9 of address and counts, 6 of data, CRC; 14 of data
    assert ": 19 + 19 characters, " in text
    assert "Take a longer period or a higher baud rate" in text


def test_a_description_that_nobody_knows(tmp_path):
    status, text = refused(write_serial_configuration(tmp_path, "modbus rtu", description="generic_cia404"))
    assert status == 2
    assert "no drive is described as 'generic_cia404'; did you mean 'generic_cia402'?" in text


@pytest.mark.deep
@pytest.mark.parametrize("kind", ["modbus rtu", "modbus tcp"])
def test_a_unit_that_nobody_has(tmp_path, kind):
    there = write_serial_configuration(tmp_path, kind, name="there")
    line = yaml.safe_load(there.read_text())["axes"]["x"]["line"]
    here = write_serial_configuration(tmp_path, kind, name="here", line=line, unit=4)
    with simulated_drives(there):
        status, text = refused(here)
        assert status == 1
        assert "of unit 4: " in text
        assert "no reply in time (5 attempts)" in text
        result, _ = run_daemon(there, "--duration", 0.1)  # the line is free again
    assert result["faults"] == []


def test_an_axis_of_the_odrive_that_nobody_has(tmp_path):
    there = write_serial_configuration(tmp_path, "odrive", name="there")
    here = write_serial_configuration(tmp_path, "odrive", name="here", axis="1")
    with simulated_drives(there):
        status, text = refused(here)
    assert status == 1
    assert "Error: x: read position and velocity of x: " in text


@pytest.mark.deep
@pytest.mark.parametrize("driver", ["modbus", "ascii"])
def test_a_simulated_serial_drive_runs_from_a_new_file(driver, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    port = str(tmp_path / "line")
    run("config", "new", "trial", "--driver", driver, "--simulated", "--bus", port)
    with simulated_drives("trial.yaml"):
        run("run", "trial.yaml", "--pace", "sync", "--duration", "0.5", "--record", "run.mcap")
    assert fh.recordings.read("run.mcap")["position"].size > 20
