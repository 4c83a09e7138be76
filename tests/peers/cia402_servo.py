"""A servo by CiA 402 and by mechanics, written from the standard alone: the second opinion about our driver.

Nothing here or in `durand_servo` imports the product (`test_durand_servo.py` asserts that), so that a mistake of the
product about the standard is not repeated here. Sources: IEC 61800-7-201 (CiA 402-2), state machine and bits of
controlword and statusword; mechanics of a rigid inertia with Coulomb friction.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

STEP_NS = 250_000
STEP_S = STEP_NS * 1e-9
CSP, CSV, CST = 8, 9, 10
QUICK_STOP_DISABLES = (1, 2)  # 605Ah: after the ramp the drive goes to Switch On Disabled by itself


class State(Enum):
    """State of the drive, with the bits 6, 5, 3, 2, 1 and 0 of its statusword."""

    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT = 0x08


@dataclass
class Machine:
    """CiA 402's state machine: controlwords in, states out."""

    quick_stop_option: int = 6
    state: State = State.SWITCH_ON_DISABLED
    previous: int = 0  # controlword before

    def take(self, word: int) -> None:
        """Take a controlword."""
        rising = word & ~self.previous
        self.previous = word
        enable_voltage, quick_stop_inactive = word & 0x02, word & 0x04
        if self.state is State.FAULT:
            if rising & 0x80:
                self.state = State.SWITCH_ON_DISABLED
        elif not enable_voltage:  # transitions 7, 9, 10, 12
            self.state = State.SWITCH_ON_DISABLED
        elif not quick_stop_inactive:
            self._quick_stop()
        elif not word & 0x01:
            self._shutdown()
        elif word & 0x08:
            self._enable()
        else:
            self._switch_on()

    def _quick_stop(self) -> None:
        if self.state is State.OPERATION_ENABLED:
            self.state = State.QUICK_STOP_ACTIVE  # 11
        elif self.state in (State.READY_TO_SWITCH_ON, State.SWITCHED_ON):
            self.state = State.SWITCH_ON_DISABLED  # 7, 10

    def _shutdown(self) -> None:
        if self.state is not State.QUICK_STOP_ACTIVE:
            self.state = State.READY_TO_SWITCH_ON  # 2, 6, 8

    def _switch_on(self) -> None:
        if self.state in (State.READY_TO_SWITCH_ON, State.OPERATION_ENABLED):
            self.state = State.SWITCHED_ON  # 3, 5

    def _enable(self) -> None:
        if self.state is State.SWITCHED_ON:
            self.state = State.OPERATION_ENABLED  # 4
        elif self.state is State.READY_TO_SWITCH_ON:
            self.state = State.SWITCHED_ON  # one transition for one controlword
        elif self.state is State.QUICK_STOP_ACTIVE and self.quick_stop_option not in QUICK_STOP_DISABLES:
            self.state = State.OPERATION_ENABLED  # 16

    def quick_stop_ended(self) -> None:
        """Take note that the quick stop ramp has come to rest."""
        if self.state is State.QUICK_STOP_ACTIVE and self.quick_stop_option in QUICK_STOP_DISABLES:
            self.state = State.SWITCH_ON_DISABLED

    def fail(self) -> None:
        """Go to Fault, without power at once (605Eh = 0)."""
        self.state = State.FAULT

    @property
    def is_powered(self) -> bool:
        return self.state in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)


@dataclass
class Mechanics:
    """A rigid inertia with Coulomb friction: J dv/dt = torque - F sign(v); at rest friction holds up to F."""

    inertia: float = 2e-4  # kg m^2
    friction: float = 0.02  # N m
    position: float = 0.0  # rad
    velocity: float = 0.0  # rad/s

    def advance(self, torque: float) -> None:
        """Advance by `STEP_S` under a torque, N m."""
        free = self.velocity + torque / self.inertia * STEP_S
        braking = self.friction / self.inertia * STEP_S
        after = math.copysign(max(abs(free) - braking, 0.0), free)
        self.position += 0.5 * (self.velocity + after) * STEP_S
        self.velocity = after


@dataclass
class Targets:
    """What the master has written, SI."""

    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0
    offset: float = 0.0  # 60B2h


class Servo:
    """Mechanics under the drive's loops.

    Parameters
    ----------
    report : callable
        Called with a time (ns) and a text at each change of the state or of whether there is torque.
    """

    POSITION_GAIN = 60.0  # 1/s
    VELOCITY_GAIN = 300.0  # 1/s, times the inertia
    INTEGRAL_GAIN = 60.0  # 1/s
    BRAKING = 200.0  # rad/s^2, 6085h

    def __init__(self, report: Callable[[int, str], None], rated_torque: float) -> None:
        self.report = report
        self.rated_torque = rated_torque
        self.machine = Machine()
        self.mechanics = Mechanics()
        self.targets = Targets()
        self.mode = 0
        self.period_s = 1e-3  # 60C2h
        self.torque = 0.0
        self.now_ns = 0
        self._is_new_target = False
        self._demand, self._slope, self._left = 0.0, 0.0, 0.0  # csp: interpolated demand
        self._velocity_demand = 0.0  # of the quick stop
        self._integral = 0.0
        self._reported: tuple[State, bool] | None = None

    def control(self, word: int) -> None:
        """Take a controlword."""
        before = self.machine.state
        self.machine.take(word)
        if self.machine.state is not before:
            self._begin(before)
        self._tell()

    def fail(self) -> None:
        """Go to Fault."""
        self.machine.fail()
        self._cut()

    def disable(self) -> None:
        """Take the power away, as "disable voltage" does."""
        self.machine.take(0)
        self._cut()

    def quick_stop(self) -> None:
        self.control(0x02)

    def _cut(self) -> None:
        if not self.machine.is_powered:
            self.torque = 0.0
        self._tell()

    def target_position(self, position: float) -> None:
        """Set a target position; the demand goes there within one period."""
        self.targets.position = position
        self._is_new_target = True

    def _begin(self, before: State) -> None:
        """Prepare the loops for a state just entered."""
        if self.machine.state is State.OPERATION_ENABLED and before is not State.QUICK_STOP_ACTIVE:
            self._demand, self._left, self._integral = self.mechanics.position, 0.0, 0.0
        if self.machine.state is State.QUICK_STOP_ACTIVE:
            self._velocity_demand = self.mechanics.velocity
        if not self.machine.is_powered:
            self.torque = 0.0

    def advance_to(self, now_ns: int) -> None:
        """Integrate up to a time, in whole steps."""
        while self.now_ns + STEP_NS <= now_ns:
            self.now_ns += STEP_NS
            self.torque = self._commanded()
            self.mechanics.advance(self.torque)
            self._tell()

    def _commanded(self) -> float:
        state = self.machine.state
        if state is State.QUICK_STOP_ACTIVE:
            return self._brake()
        if state is not State.OPERATION_ENABLED:
            return 0.0
        targets = self.targets
        if self.mode == CST:
            wanted = targets.torque + targets.offset
        elif self.mode == CSV:
            wanted = self._velocity_loop(targets.velocity) + targets.offset
        elif self.mode == CSP:
            slope = self._interpolate()
            error = self._demand - self.mechanics.position
            wanted = self._velocity_loop(slope + self.POSITION_GAIN * error) + targets.offset
        else:
            wanted = 0.0
        return max(-self.rated_torque, min(self.rated_torque, wanted))  # 6072h: 1000 per mille

    def _interpolate(self) -> float:
        """Move the demand towards the target; return its slope."""
        if self._is_new_target:
            self._is_new_target = False
            self._left = self.period_s
            self._slope = (self.targets.position - self._demand) / self.period_s
        if self._left <= 0.0:
            return 0.0
        self._demand += self._slope * min(STEP_S, self._left)
        self._left -= STEP_S
        return self._slope

    def _velocity_loop(self, demand: float) -> float:
        error = demand - self.mechanics.velocity
        gain = self.VELOCITY_GAIN * self.mechanics.inertia
        limit = self.rated_torque
        self._integral = max(-limit, min(limit, self._integral + gain * self.INTEGRAL_GAIN * error * STEP_S))
        return gain * error + self._integral

    def _brake(self) -> float:
        change = self.BRAKING * STEP_S
        self._velocity_demand = math.copysign(max(abs(self._velocity_demand) - change, 0.0), self._velocity_demand)
        torque = self._velocity_loop(self._velocity_demand)
        if self._velocity_demand == 0.0 and abs(self.mechanics.velocity) < 1e-3:
            self.machine.quick_stop_ended()
        return torque if self.machine.is_powered else 0.0

    def _tell(self) -> None:
        now = self.machine.state, self.torque != 0.0
        if now != self._reported:
            self._reported = now
            self.report(self.now_ns, f"{now[0].name} {'torque' if now[1] else 'no torque'}")

    @property
    def statusword(self) -> int:
        """Content of 6041h."""
        word = self.machine.state.value | 0x0200  # remote
        if self.machine.state is not State.FAULT:
            word |= 0x0010  # voltage enabled
        if self.machine.state is State.SWITCH_ON_DISABLED:
            word |= 0x0020  # no quick stop
        if self.machine.state is State.OPERATION_ENABLED and self.mode in (CSP, CSV, CST):
            word |= 0x1000  # the drive follows the command
        return word
