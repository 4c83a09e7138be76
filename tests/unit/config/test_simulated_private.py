"""Configurations moved to a bus or lines of their own, for `run --simulate`: nothing of the real ones is left."""

import json
from pathlib import Path

import pytest
import yaml
from friction_hil_drivers.modbus.description import DESCRIPTIONS

from friction_hil.checked_yaml.text import dump
from friction_hil.config import file_problems, load, self_contained
from friction_hil.config.drivers import SIMULATED_DRIVES, load_driver
from friction_hil.errors import UsageError
from tests.servo_drives import axis_dict

EXAMPLES = sorted((Path(__file__).parents[3] / "config").glob("*.yaml"))
CAN0 = {"interface": "socketcan", "channel": "can0", "bitrate": 500_000}


def moved(path, folder):
    """The private configuration of a file, read back from the file that the simulated drives get."""
    configuration = load(path, needs_models=False)
    driver = next(iter(configuration.axes.values())).driver
    private, former = load_driver(driver, SIMULATED_DRIVES).make_private(configuration, folder)
    file = folder / "simulated.yaml"
    file.write_text(dump(self_contained(private)))
    again = load(file)
    assert file_problems(file, again) == []
    assert self_contained(again) == self_contained(private)
    return configuration, private, former


def written(folder, *, bus=CAN0, **axes):
    """A configuration on a real bus, without simulated drives."""
    path = folder / "machine.yaml"
    path.write_text(yaml.safe_dump({"version": 1, "period_s": 1e-3, "bus": bus, "axes": axes}))
    return path


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_each_example_moves_to_a_place_of_its_own(path, tmp_path):
    if load(path).lacks_period:
        pytest.skip("axes of a loop of one's own have no drives")
    configuration, private, former = moved(path, tmp_path)
    for name, axis in private.axes.items():
        assert axis.simulation is not None
        assert axis.limits == configuration.axes[name].limits
    if configuration.bus is None:
        ports = {axis.options.line.port for axis in private.axes.values()}
        assert former == "/tmp/friction_hil_modbus"
        assert ports == {str(tmp_path / "line1")}
        return
    bus = private.bus
    assert (bus.interface, bus.hop_limit, bus.bitrate) == ("udp_multicast", 0, None)
    assert (bus.port, bus.channel) != (configuration.bus.port, configuration.bus.channel)
    assert (bus.role, bus.sync_cob_id) == (configuration.bus.role, configuration.bus.sync_cob_id)
    assert str(configuration.bus.channel) in former


def test_two_of_them_do_not_meet(tmp_path):
    path = written(tmp_path, x=axis_dict())
    buses = [moved(path, tmp_path)[1].bus for _ in range(4)]
    assert len({(bus.channel, bus.port) for bus in buses}) == 4


def test_the_simulated_drive_is_the_one_that_the_file_expects(tmp_path):
    identity = {"vendor_id": 0x123, "product_code": 7}
    expected = {"identity": identity, "counts_per_unit": 4000.0, "rated_torque": 1.5, "velocity_unit": "rpm"}
    path = written(tmp_path, x=axis_dict(**expected, model={**axis_dict()["model"], "axis": "linear"}))
    simulation = moved(path, tmp_path)[1].axes["x"].simulation
    drive = simulation.canopen
    assert (drive.vendor_id, drive.product_code, drive.velocity_unit) == (0x123, 7, "rpm")
    assert (simulation.mechanics.axis, simulation.encoder.counts) == ("linear", 4000)
    assert simulation.motor.rated_torque == 1.5


def test_what_the_file_says_of_the_simulated_drive_stays(tmp_path):
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.1}}
    given = {"encoder": {"counts": 5000}, "canopen": {"vendor_id": 9}, "friction": friction}
    path = written(tmp_path, x=axis_dict(identity={"vendor_id": 1}, counts_per_unit=4000.0, simulation=given))
    simulation = moved(path, tmp_path)[1].axes["x"].simulation
    assert (simulation.encoder.counts, simulation.canopen.vendor_id, simulation.friction.model) == (5000, 9, "coulomb")


def test_a_node_with_two_axes_has_no_simulated_drive(tmp_path):
    path = written(tmp_path, x=axis_dict(), y=axis_dict(axis_number=1))
    with pytest.raises(UsageError, match="node 1 has 2 axes"):
        moved(path, tmp_path)


def test_axes_of_one_line_stay_together_and_a_description_is_found_from_elsewhere(tmp_path):
    values = yaml.safe_load((EXAMPLES[0].parent / "serial_modbus.yaml").read_text())
    values["period_s"] = 2e-2
    axis = values["axes"].pop("x")
    axis["model"] = axis_dict()["model"]
    own = tmp_path / "there"
    own.mkdir()
    (own / "mine.yaml").write_text((DESCRIPTIONS / "generic_cia402.yaml").read_text())
    tcp = {**axis, "line": {"port": "tcp://192.168.0.5:502"}, "unit": 3}
    values["axes"] = {"x": {**axis, "description": "mine.yaml"}, "y": {**axis, "unit": 2}, "z": tcp}
    path = own / "machine.yaml"
    path.write_text(json.dumps(values))
    _, private, former = moved(path, tmp_path)
    x, y, z = (one.options.line.port for one in private.axes.values())
    assert x == y == str(tmp_path / "line1")
    assert z.startswith("tcp://127.0.0.1:")
    assert former == "/tmp/friction_hil_modbus, tcp://192.168.0.5:502"
