"""Two buses on one port: a daemon with its drives on each of two multicast groups, side by side."""

import json
import random
import re
from pathlib import Path

import pytest

from tests.processes import free_port, run, simulated_drives, write_configuration

ROOT = Path(__file__).parents[2]


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
