"""The daemon with servo drives that nobody here wrote the CANopen stack of: `tests/peers/durand_servo.py`."""

import contextlib
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from friction_hil.recordings import read_all
from tests.durand_process import CONTROLLER, DurandDrives, Event, durand_configuration, durand_drives
from tests.processes import listening, run_daemon, simulated_drives, start, write_configuration
from tests.recorded_bus import recorded
from tools.campaigns.frame_recorder import Recorder

# A busy machine may be late by 0.3 s.
IN_REAL_TIME: dict[str, Any] = {
    "period_s": 10e-3,
    "max_missed": 30,
    "controller": {"position_gain": 5.0, "velocity_gain": 5e-3, "integral_hz": 0.5},
}
MODES = ("csp", "csv", "cst")
AT_SYNC = ["--timer-at-sync-only"]
UP = ["READY_TO_SWITCH_ON", "SWITCHED_ON", "OPERATION_ENABLED"]


def states(drives: DurandDrives) -> list[str]:
    """States of the drive in the order in which it went through them."""
    found: list[str] = []
    for what in drives.told():
        state = what.split()[0]
        if state.isupper() and state != "NMT" and found[-1:] != [state]:
            found.append(state)
    return found


def is_torque_gone(event: Event) -> bool:
    return event.what.endswith("no torque")


@contextlib.contextmanager
def started(configuration: Path, drives: DurandDrives) -> Iterator[Any]:
    """Start the daemon in real time, and wait until the drive has had torque for a while.

    On a machine too busy for real time the daemon ends before that; it is started again then.
    """
    for _ in range(5):
        began = len(drives.events)
        with start("run", configuration, "--json", stdout=-1, stderr=-1) as daemon:
            while daemon.poll() is None and not any("ENABLED torque" in event.what for event in drives.events[began:]):
                time.sleep(0.01)
            time.sleep(0.2)
            if daemon.poll() is None:
                yield daemon
                return
            said = "".join(daemon.communicate())
    raise AssertionError(said)


@pytest.mark.deep
@pytest.mark.parametrize("mode", MODES)
def test_a_run_moves_the_drive_and_ends_in_order(tmp_path: Path, mode: str) -> None:
    configuration = durand_configuration(tmp_path, mode=mode)
    file = tmp_path / "run.mcap"
    with durand_drives(configuration, is_paced_by_sync=True) as drives:
        result, _ = run_daemon(configuration, "--duration", 1.5, "--record", file)
        assert result["faults"] == []
        walked = states(drives)
    assert walked[:4] == ["SWITCH_ON_DISABLED", *UP]
    assert walked[-1] == "SWITCH_ON_DISABLED"
    assert walked.count("OPERATION_ENABLED") == 1
    recording = read_all(file)["x1"]
    position = recording["position"]
    assert np.ptp(position) == pytest.approx(0.6, abs=0.1), "the sine of 0.3 rad"
    assert abs(recording["velocity"][-1]) < 0.05, "disabled at rest"


@pytest.mark.deep
@pytest.mark.parametrize(("mode", "manner"), [("csp", []), ("csv", AT_SYNC), ("cst", AT_SYNC)])
def test_a_killed_daemon_leaves_no_torque(tmp_path: Path, mode: str, manner: list[str]) -> None:
    configuration = durand_configuration(tmp_path, mode=mode, **IN_REAL_TIME)
    with durand_drives(configuration, *manner) as drives:
        with started(configuration, drives) as daemon:
            killed_ns = time.monotonic_ns()
            daemon.send_signal(signal.SIGKILL)
            daemon.wait(10.0)
        drives.wait_for(lambda event: event.ns > killed_ns and is_torque_gone(event))
        assert drives.is_free, drives.told()


@pytest.mark.deep
def test_pre_operational_in_mid_run_stops_the_drive_at_once(tmp_path: Path) -> None:
    configuration = durand_configuration(tmp_path, mode="csv", **IN_REAL_TIME)
    with durand_drives(configuration) as drives, listening(configuration) as bus:
        with started(configuration, drives) as daemon:
            bus.send(can.Message(arbitration_id=0, data=[0x80, 1], is_extended_id=False))
            now_ns = time.monotonic_ns() - 1_000_000_000
            lost = drives.wait_for(lambda event: event.what == "NMT PRE_OPERATIONAL" and event.ns > now_ns)
            gone = drives.wait_for(lambda event: event.ns > lost.ns and is_torque_gone(event))
            output, errors = daemon.communicate(timeout=30.0)
        assert daemon.returncode == 1, errors
        assert drives.is_free
    assert gone.ns - lost.ns < 1e9
    assert "Operational" in output


def test_the_peer_imports_nothing_of_the_product() -> None:
    """It would not be a second opinion."""
    import ast

    seen = set()
    pending = ["tests.peers.durand_servo"]
    while pending:
        name = pending.pop()
        seen.add(name)
        tree = ast.parse((Path(__file__).parents[2] / (name.replace(".", "/") + ".py")).read_text())
        for node in ast.walk(tree):
            if isinstance(node, ast.Import | ast.ImportFrom):
                modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else [n.name for n in node.names]
                assert not any(module.startswith("friction_hil") for module in modules), modules
                pending += [each for each in modules if each.startswith("tests.") and each not in seen]
    assert len(seen) == 3


@pytest.mark.deep
@pytest.mark.parametrize(("mode", "is_ours"), [("csp", False), ("csv", False), ("cst", False), ("csp", True)])
def test_the_frames_of_a_whole_run_keep_to_the_standards(tmp_path: Path, mode: str, is_ours: bool) -> None:
    nodes = (1, 2)
    if is_ours:
        keys = {"mode": mode, **({"controller": CONTROLLER} if mode == "cst" else {})}
        configuration = write_configuration(tmp_path, **{f"x{node}": {"node": node, **keys} for node in nodes})
        drives = simulated_drives(configuration)
    else:
        configuration = durand_configuration(tmp_path, mode=mode, nodes=nodes)
        drives = durand_drives(configuration, is_paced_by_sync=True)
    with drives, recorded(configuration) as frames:
        run_daemon(configuration, "--duration", 0.5)
    recorder = Recorder(has_clock=False).take_all(frames)
    assert recorder.counts["sync"] > 500
    assert recorder.counts["tpdo"] >= recorder.counts["rpdo"] > 1000
    assert recorder.of() == []
