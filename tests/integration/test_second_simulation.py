"""A second simulation of the same drives is refused: two drives would answer each request."""

import json
import re
from pathlib import Path

import pytest
import yaml

from tests.durand_process import durand_configuration, durand_drives
from tests.peers.serial_processes import write_serial_configuration
from tests.processes import run, simulated_drives, write_configuration


def refused(configuration: Path) -> str:
    """Standard error of a simulation that does not begin."""
    done = run("simulate", configuration, "--pace", "sync", check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert "Traceback" not in done.stderr
    return done.stderr


@pytest.mark.parametrize("kind", ["canopen", "modbus rtu"])
def test_a_second_simulation_of_the_same_drives_is_refused(tmp_path: Path, kind: str) -> None:
    is_canopen = kind == "canopen"
    configuration = write_configuration(tmp_path) if is_canopen else write_serial_configuration(tmp_path, kind)
    with simulated_drives(configuration):
        said = refused(configuration)
        assert ("FH-245" if is_canopen else "another process simulates drives there") in said
        assert json.loads(run("stop", configuration, "--json").stdout)["axes"][0]["result"] == "unpowered"
    with simulated_drives(configuration):  # the name is free again
        pass


def test_a_node_of_somebody_else_is_found_by_its_answer(tmp_path: Path) -> None:
    """Another number on the same bus may be simulated beside it."""
    configuration = durand_configuration(tmp_path)
    data = yaml.safe_load(configuration.read_text())
    data["axes"]["x1"]["simulation"] = {}
    same, other = tmp_path / "same.yaml", tmp_path / "other.yaml"
    same.write_text(yaml.safe_dump(data))
    data["axes"]["x1"]["node"] = 2
    other.write_text(yaml.safe_dump(data))
    with durand_drives(configuration):
        said = refused(same)
        assert re.search(r"node 1 on udp_multicast .* answers already.*FH-245", said)
        with simulated_drives(other):
            found = json.loads(run("drives", "scan", other, "--json").stdout)
    assert [drive["node"] for drive in found["drives"]] == [1, 2]
