"""Two buses on one port: a daemon with its drives on each of two multicast groups, side by side."""

import json
import random
import re
from pathlib import Path

import numpy as np
import pytest

import friction_hil as fh
from tests.processes import free_port, run, simulated_drives, start_daemon, write_configuration

ROOT = Path(__file__).parents[2]
DURATION_S = 1.0


@pytest.fixture
def pair(tmp_path: Path) -> list[Path]:
    """Two configurations that differ in the group alone."""
    port, last = free_port(), random.SystemRandom().randrange(3, 250)
    found = []
    for octet in (last, last + 1):
        folder = tmp_path / str(octet)
        folder.mkdir()
        bus = {"interface": "udp_multicast", "channel": f"239.74.163.{octet}", "port": port, "hop_limit": 0}
        found.append(write_configuration(folder, bus=bus))
    return found


@pytest.mark.deep
def test_two_daemons_on_two_groups_of_one_port_do_not_hear_each_other(pair: list[Path]) -> None:
    """With SYNC as the only clock, one frame of the other pair would change every bit that follows it."""
    first, second = pair
    with simulated_drives(first), simulated_drives(second):
        for configuration in pair:
            found = json.loads(run("drives", "scan", configuration, "--json").stdout)
            assert [drive["node"] for drive in found["drives"]] == [1]
        daemons = [
            start_daemon(
                path, "--duration", DURATION_S, "--record", path.parent / "run.mcap", "--name", path.parent.name
            )
            for path in pair
        ]
        ended = [(*daemon.communicate(timeout=120), daemon.returncode) for daemon in daemons]
    for output, errors, status in ended:
        assert status == 0, errors
        result = json.loads(output)
        assert (result["faults"], result["warnings"], result["notices"]) == ([], [], [])
        assert result["axes"]["x"]["stale"] == 0
    alone, beside = (fh.recordings.read(path.parent / "run.mcap") for path in pair)
    assert len(alone["position"]) >= DURATION_S / 1e-3
    for column in ("time_s", "position", "velocity", "torque", "command", "compensation", "drive_state", "is_fresh"):
        np.testing.assert_array_equal(alone[column], beside[column], err_msg=column)


def test_a_simulator_hears_no_frame_of_another_group(pair: list[Path]) -> None:
    first, second = pair
    with simulated_drives(second):
        found = run("drives", "scan", first, "--json", check=False)
    assert json.loads(found.stdout)["drives"] == []
    assert found.returncode == 1


def test_every_can_bus_is_opened_in_one_place() -> None:
    """That is where a bus is kept to its group."""
    sources = [path for folder in ("drivers", "friction_hil", "tools") for path in (ROOT / folder).rglob("*.py")]
    opening = re.compile(r"\b(can\.(Bus|ThreadSafeBus)|UdpMulticastBus|MulticastBus)\(")
    found = {path.name for path in sources if opening.search(path.read_text(encoding="utf-8"))}
    assert found <= {"bus.py", "multicast.py"}
    assert "bus.py" in found
