"""The daemon beside another master that moves the drive: it looks, and touches nothing."""

import contextlib
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest
import yaml

from tests.durand_process import durand_configuration, durand_drives
from tests.launcher import start
from tests.peers.plc_master import PlcMaster
from tests.processes import listening, run, write_configuration
from tests.recorded_bus import recorded
from tools.campaigns.frame_recorder import Frame

NMT, SYNC = 0x000, 0x080


@contextlib.contextmanager
def simulated_in_real_time(configuration: Path) -> Iterator[Any]:
    with start("simulate", configuration, "--exit-with-stdin", stdin=-1, stdout=-1, stderr=-1) as process:
        assert process.stdout.readline().startswith("ready:")
        try:
            yield process
        finally:
            process.stdin.close()
            process.wait(30)


def writes(frames: list[Frame]) -> list[str]:
    """Frames that change something: NMT, and SDO downloads."""
    return [
        str(frame)
        for frame in frames
        if frame.can_id == NMT or (frame.can_id & 0x780 == 0x600 and frame.data[0] >> 5 in (0, 1, 6))
    ]


@pytest.mark.deep
@pytest.mark.parametrize(
    ("is_ours", "is_event_driven"),
    [
        pytest.param(False, False, id="durand, sync"),
        pytest.param(False, True, id="durand, events"),
        pytest.param(True, True, id="simulated, events"),
    ],
)
def test_a_drive_that_a_plc_moves_is_left_alone(tmp_path: Path, is_ours: bool, is_event_driven: bool) -> None:
    """Neither a dry run nor a run changes the drive's objects or takes it from its master."""
    if is_ours:
        configuration = write_configuration(tmp_path)
        drives = simulated_in_real_time(configuration)
    else:
        configuration = durand_configuration(tmp_path)
        drives = durand_drives(configuration)
    bus = yaml.safe_load(configuration.read_text())["bus"]
    ended: list[subprocess.CompletedProcess[str]] = []
    with drives, PlcMaster(bus, 1, is_event_driven=is_event_driven) as plc:
        before = plc.dictionary()
        with recorded(configuration) as frames:
            for options in (("--dry-run", "--duration", 0.2), ("--duration", 0.2)):
                ended.append(run("run", configuration, *options, check=False))
                assert plc.is_in_command, ended[-1].stderr
        after = plc.dictionary()
        count = len(plc.feedback)
    assert writes(frames) == []
    assert after == before
    assert ended[1].returncode == 1, "a drive that somebody else moves is refused"
    assert "another master" in ended[1].stderr
    if is_event_driven:
        assert not any(frame.can_id == SYNC for frame in frames), "nobody but the daemon would send it"
    assert count > 20


@pytest.mark.deep
@pytest.mark.parametrize(
    ("changes", "wanted"),
    [
        pytest.param({}, [bytes((0x01, 1)), bytes((0x80, 1)), bytes((0x01, 1))], id="dry run"),
        pytest.param({"identity": {"vendor_id": 99}}, [], id="refused"),
    ],
)
def test_a_silent_node_is_left_operational(tmp_path: Path, changes: dict[str, Any], wanted: list[bytes]) -> None:
    """A node without heartbeat does not tell its NMT state by itself."""
    configuration = durand_configuration(tmp_path, **changes)
    with durand_drives(configuration):
        with listening(configuration) as bus:
            bus.send(can.Message(arbitration_id=NMT, data=bytes((0x01, 1)), is_extended_id=False))
        with recorded(configuration) as frames:
            ended = run("run", configuration, "--dry-run", "--duration", 0.1, check=False)
    assert [bytes(frame.data) for frame in frames if frame.can_id == NMT] == wanted
    assert "FH-222" not in ended.stderr
