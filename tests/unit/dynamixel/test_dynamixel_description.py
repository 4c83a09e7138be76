"""Control tables in YAML files: the ready ones, and what is said of mistakes."""

import pytest
from dynamixel_easy_sdk.control_table import ControlTable
from friction_hil_drivers.dynamixel.description import DESCRIPTIONS, DynamixelDescription
from friction_hil_drivers.dynamixel.options import DynamixelOptions
from friction_hil_drivers.serial_line.description import load_description, ready
from friction_hil_drivers.serial_line.sequences import state_of
from pydantic import ValidationError

from friction_hil.drive import DriveState
from tests.unit.dynamixel.test_dynamixel_codec import SIGNALS, described

MODELS = {"xm430": (1020, 1030), "xm540": (1120, 1130), "xl330": (1190, 1200)}  # numbers that the vendor gave them
ITEMS = {
    "model_number": "Model Number",
    "firmware": "Firmware Version",
    "temperature": "Present Temperature",
    "return_delay": "Return Delay Time",
    "operating_mode": "Operating Mode",
    "status": "Torque Enable",
    "error": "Hardware Error Status",
    "watchdog": "Bus Watchdog",
    "torque_command": "Goal Current",
    "torque": "Present Current",
    "velocity": "Present Velocity",
    "position": "Present Position",
}


def load(name):
    return load_description(name, None, DESCRIPTIONS, DynamixelDescription)


def options(**keys):
    return DynamixelOptions.model_validate({"line": {"port": "/dev/ttyUSB0"}, "description": "xm430", "id": 1} | keys)


def test_there_is_a_test_for_each_ready_description():
    assert ready(DESCRIPTIONS).keys() == MODELS.keys()


@pytest.mark.parametrize("name", MODELS)
def test_addresses_are_those_of_the_vendors_control_tables(name):
    signals = load(name).signals
    for number in MODELS[name]:
        table = ControlTable.getControlTable(number)
        assert {key: (signals[key].address, signals[key].size) for key in signals} == {
            key: (table[item].address, table[item].size) for key, item in ITEMS.items()
        }


@pytest.mark.parametrize("name", MODELS)
def test_the_simulated_servo_is_one_that_there_is_and_no_fault_is_left_without_a_watchdog(name):
    description = load(name)
    assert description.signals["model_number"].simulated in MODELS[name]
    assert description.fast_sync_read is False
    assert 38 <= description.signals["firmware"].simulated < 46, "it has the bus watchdog, and no Fast Sync Read"
    written = [step.write["watchdog"] for step in description.reset_fault if "watchdog" in step.write]
    assert written[0] == 0  # clears the error
    assert written[-1] > 0


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize(
    ("numbers", "state"),
    [
        ({"status": 0, "error": 0, "watchdog": 0}, DriveState.SWITCH_ON_DISABLED),
        ({"status": 1, "error": 0, "watchdog": 5}, DriveState.OPERATION_ENABLED),
        ({"status": 1, "error": 0, "watchdog": -1}, DriveState.FAULT),
        ({"status": 0, "error": 32, "watchdog": 5}, DriveState.FAULT),
        ({"status": 0, "error": 0}, DriveState.UNKNOWN),
    ],
)
def test_states(name, numbers, state):
    assert state_of(load(name), numbers) is state


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"signals": {**SIGNALS, "load": {"address": 134, "size": 2}}}, r"position \(4 bytes at 132\) .*load"),
        ({"signals": {**SIGNALS, "last": {"address": 65535, "size": 2}}}, "last .*65536"),
        ({"signals": {**SIGNALS, "odd": {"address": 0, "size": 3}}}, r"signals\.odd\.size"),
        ({"enable": [{"write": {"torque_command": 0, "status": 1}}]}, r"enable\.0\s+writes torque_command, status"),
        ({"enable": [{"write": {"torque_command": 40000}}]}, r"enable\.0\.write\.torque_command\s"),
    ],
)
def test_mistakes_are_told(keys, message):
    with pytest.raises(ValidationError, match=message):
        described(**keys)


@pytest.mark.parametrize("keys", [{"id": 253}, {"id": -1}, {"watchdog_s": 0.009}, {"watchdog_s": 3.0}])
def test_options_have_bounds(keys):
    with pytest.raises(ValidationError, match=next(iter(keys))):
        options(**keys)


def test_the_baud_rate_is_that_of_a_new_servo():
    assert options().line.baud == 57600
    assert options().address == "id 1"
