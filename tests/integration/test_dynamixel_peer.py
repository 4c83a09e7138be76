"""The vendor's own tool, which knows nothing of friction_hil, on a simulated servo: a process on a pseudo-terminal."""

from pathlib import Path

from dynamixel_easy_sdk import Connector
from dynamixel_easy_sdk.dynamixel_error import DxlRuntimeError

from tests.peers.serial_processes import wait_until, write_serial_configuration
from tests.processes import simulated_drives

SERVO = {"driver": "dynamixel", "description": "xl330", "id": 1, "torque_constant": 0.2, "unit": None, "mode": "cst"}
CONTROLLER = {"position_gain": 1.0, "velocity_gain": 0.1}


def test_the_vendors_tool_knows_moves_and_reboots_a_simulated_servo(tmp_path: Path) -> None:
    changes = {**SERVO, "counts_per_unit": None, "rated_torque": None, "controller": CONTROLLER}
    configuration = write_serial_configuration(tmp_path, "modbus rtu", **changes)
    with simulated_drives(configuration, pace="real"):
        tool = Connector(str(tmp_path / "line"), 921600)
        motor = tool.createMotor(1)
        assert motor.model_name == "xl330_m288.model"
        motor.enableTorque()
        assert motor.isTorqueOn()
        before = motor.getPresentPosition()
        motor.setGoalCurrent(800)
        wait_until(lambda: abs(motor.getPresentPosition() - before) > 50, "motion")
        tool.reboot(1)

        def is_up() -> bool:
            try:
                return tool.ping(1) == motor.model_number
            except DxlRuntimeError:  # it answers nothing meanwhile
                return False

        assert not is_up(), "it takes a moment"
        wait_until(is_up, "the servo")
        assert not motor.isTorqueOn()
        tool.closePort()
