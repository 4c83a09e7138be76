"""Stopping and resetting serial drives: what a fault needs, and what a drive does against it."""

from pathlib import Path

import pytest
import yaml
from friction_hil_drivers.dynamixel.description import DESCRIPTIONS
from friction_hil_drivers.serial_line.simulated import RefusedError, SimulatedDrive

from friction_hil.drive import DriveState
from friction_hil.drive.inventory import Stop
from tests.serial_rig import Bench


def drive_of(bench: Bench) -> SimulatedDrive:
    (line,) = bench.simulated._lines
    (drive,) = line._drives
    return drive


def served(bench: Bench, method: str) -> Stop:
    (found,) = getattr(bench._driver, method)(bench.config, bench.config.axes).stops
    return found


def without_reset(folder: Path, source: Path) -> str:
    data = yaml.safe_load(source.read_text())
    data["reset_fault"] = []
    path = folder / "changed.yaml"
    path.write_text(yaml.safe_dump(data))
    return str(path)


def test_a_servo_whose_fault_needs_a_reboot_is_rebooted(tmp_path: Path) -> None:
    with Bench("dynamixel", tmp_path, description=without_reset(tmp_path, DESCRIPTIONS / "xl330.yaml")) as bench:
        drive_of(bench).fail()
        found = served(bench, "reset_axes")
        assert (found.result, found.before, found.after) == ("reset", DriveState.FAULT, DriveState.SWITCH_ON_DISABLED)
        assert found.fault
        assert drive_of(bench).is_on


def test_a_fault_that_nothing_resets_is_reported_with_what_to_do(tmp_path: Path) -> None:
    source = DESCRIPTIONS.parents[1] / "ascii/descriptions/odrive.yaml"
    with Bench("odrive", tmp_path, description=without_reset(tmp_path, source)) as bench:
        drive_of(bench).fail()
        found = served(bench, "reset_axes")
        assert (found.result, found.after, found.is_proved) == ("fault", DriveState.FAULT, False)
        assert "watchdog timer expired" in found.fault
        assert "switch the drive off and on" in found.detail


@pytest.mark.parametrize("kind", ["odrive", "rtu, function 23"])
def test_a_drive_that_does_not_give_up_its_power_is_not_called_stopped(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(drive: SimulatedDrive, name: str, number: float) -> None:
        raise RefusedError("not this one")

    with Bench(kind, tmp_path) as bench:
        drive_of(bench)._enter(DriveState.OPERATION_ENABLED)
        monkeypatch.setattr(SimulatedDrive, "write", refuse)
        found = served(bench, "stop_axes")
        assert (found.result, found.after, found.is_proved) == ("powered", DriveState.OPERATION_ENABLED, False)
        assert "refuses" in found.detail or "unknown command" in found.detail


def test_a_servo_is_not_left_with_a_watchdog_that_would_be_its_next_fault(tmp_path: Path) -> None:
    with Bench("dynamixel", tmp_path) as bench:
        drive_of(bench).fail()
        assert served(bench, "reset_axes").result == "reset"
        assert drive_of(bench).read("watchdog") == 0.0
