"""Example: the contract of the drive port, kept by a driver of your own."""

from collections.abc import Iterator, Sequence

import pytest

from friction_hil.config import from_dict
from friction_hil.drive import AxisFacts, Command, DriveState, Feedback, Request
from friction_hil.errors import DriveError
from tests.contract.drives import DrivesContract
from tests.contract.rig import FRICTION, INERTIA, PERIOD_S, NotApplicableError, Rig

AXIS = {
    "driver": "canopen",  # yours, once it has an entry point
    "node": 1,
    "mode": "cst",
    "limits": {"torque": 0.3, "velocity": 1000.0},
    "model": {"axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": FRICTION}}},
    "trajectory": {"kind": "none"},
}


class Motor:
    """A motor with its drive: what you have on the bench, or simulate."""

    def __init__(self) -> None:
        self.state = DriveState.SWITCH_ON_DISABLED
        self.position = self.velocity = self.torque = 0.0
        self.is_silent = False
        self.writes = 0

    def advance(self) -> None:
        push = self.torque if self.state is DriveState.OPERATION_ENABLED else 0.0
        braked = max(abs(self.velocity) - FRICTION / INERTIA * PERIOD_S, 0.0)
        self.velocity = braked * (1.0 if self.velocity > 0.0 else -1.0) + push / INERTIA * PERIOD_S
        self.position += self.velocity * PERIOD_S

    def write(self, request: Request, torque: float) -> None:
        self.writes += 1
        self.torque = torque
        if self.state is DriveState.FAULT and request is not Request.RESET_FAULT:
            return
        is_enabled = request is Request.ENABLE
        self.state = DriveState.OPERATION_ENABLED if is_enabled else DriveState.SWITCH_ON_DISABLED


class MyDrives:
    """The driver; it implements `friction_hil.drive.Drives`."""

    def __init__(self, motors: dict[str, Motor], *, dry_run: bool) -> None:
        self._motors, self._dry_run = motors, dry_run
        self._is_open = False

    def connect(self) -> Sequence[AxisFacts]:
        for name, motor in self._motors.items():
            if motor.state.is_powered and not self._dry_run:
                raise DriveError(f"{name}: the motor has power already: another master drives it")
        self._is_open = True
        return [AxisFacts(name, "my motor", 1e-6, 1e-3, PERIOD_S, 1.5 * PERIOD_S) for name in self._motors]

    def start(self) -> None:
        pass

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        for filled, motor in zip(feedback, self._motors.values(), strict=True):
            filled.is_fresh, filled.missing = not motor.is_silent, "no reply" if motor.is_silent else ""
            if not motor.is_silent:
                motor.advance()
                filled.position, filled.velocity, filled.torque = motor.position, motor.velocity, motor.torque
                filled.state = motor.state

    def send(self, commands: Sequence[Command]) -> None:
        for command, motor in zip(commands, self._motors.values(), strict=True):
            if command.request is not Request.LISTEN and not self._dry_run:
                motor.write(command.request, command.torque)

    def warm_caches(self) -> None:
        pass

    def close(self) -> Sequence[DriveState]:
        for motor in self._motors.values():
            if self._is_open and motor.state.is_powered and not self._dry_run:
                motor.write(Request.DISABLE, 0.0)
        self._is_open = False
        return [motor.state for motor in self._motors.values()]


class MyRig(Rig):
    """Two motors, and what a contract test wants of them."""

    def __init__(self) -> None:
        axes = {"x": AXIS, "y": {**AXIS, "node": 2}}
        bus = {"interface": "virtual", "channel": "unused"}
        super().__init__(from_dict({"version": 1, "period_s": PERIOD_S, "bus": bus, "axes": axes}, "example"))
        self.motors = {name: Motor() for name in self.configuration.axes}

    def make_drives(self, *, dry_run: bool = False) -> MyDrives:
        return MyDrives(self.motors, dry_run=dry_run)

    def count_commands(self) -> int:
        return sum(motor.writes for motor in self.motors.values())

    def silence(self) -> None:
        for motor in self.motors.values():
            motor.is_silent = True

    def trip(self) -> None:
        self.motors["x"].state = DriveState.FAULT

    def has_power(self, axis: int) -> bool:
        return list(self.motors.values())[axis].state.is_powered

    def leave_enabled(self) -> None:
        for motor in self.motors.values():
            motor.state = DriveState.OPERATION_ENABLED

    def detach(self) -> None:
        raise NotApplicableError("a motor that is called directly takes every command")

    def kill(self) -> None:
        raise NotApplicableError("these motors have no watchdog")

    def close(self) -> None:
        """Nothing runs here that would have to be ended."""


class TestMyDrives(DrivesContract):
    @pytest.fixture
    def rig(self) -> Iterator[MyRig]:
        rig = MyRig()
        yield rig
        rig.close()
