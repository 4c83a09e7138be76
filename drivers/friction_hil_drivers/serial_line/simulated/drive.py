"""Simulated servo with the signals of a description, in the drive's own numbers."""

import dataclasses
import math
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

from friction_hil.drive import DriveState, Mode
from friction_hil.errors import DriveError, UsageError
from friction_hil_drivers.serial_line.description import Description
from friction_hil_drivers.serial_line.protocol import COMMANDS
from friction_hil_drivers.serial_line.simulated.states import matches, state_machine
from friction_hil_drivers.serial_line.units import NEEDS, UNITS, AxisUnits

if TYPE_CHECKING:
    from friction_hil.servo.servo import Servo

_NO_MODE = 0
_PIECE_S = 1e-3  # longest time between two checks of watchdog and quick stop
_ENABLED, _STOPPING, _OFF = DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE, DriveState.NOT_READY


class RefusedError(Exception):
    """The drive refuses a value. The message names the accepted ones."""


class RequestError(Exception):
    """A request is answered by an error with this number of its protocol."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class SimulatedDrive:
    """Signals, states and watchdog of a drive, and the servo that it drives.

    Numbers of positions do not wrap: the protocol's responder wraps the numbers that it sends to the width of the
    signal, and unwraps received ones to the number nearest to the present position. Raises `UsageError`: a signal has a
    unit for which the configuration gives no factor, or no number of the drive shows a state.
    """

    def __init__(
        self,
        name: str,
        description: Description,
        servo: "Servo",  # its set-point period is the master's
        mode: Mode,  # a torque command is the total torque in CST and an offset otherwise
        units: AxisUnits,  # NaN for counts and rated torque means those of the servo
        # integration steps by which each `sample` advances the servo; None: `advance_to` advances it
        sync_steps: int | None = None,
    ) -> None:
        self.description = description
        self.servo = servo
        self.is_on = True  # the drive has its supply
        self.samples = 0
        self._mode = mode
        self._sync_steps = sync_steps
        self._si = _scales(name, description, servo, units)
        part = description.modes.get(mode.name.lower())  # type: ignore[call-overload]
        if part is None:
            raise UsageError(
                f"{name}: {description.name} has no mode {mode.name.lower()}; it has {', '.join(description.modes)}"
            )
        self._commands = frozenset(part.commands)
        self._takes = _accepted_numbers(description)
        watchdog = description.watchdog
        self._watchdog = None if watchdog is None else watchdog.signal
        self._watchdog_needs: dict[str, float] = {}
        for step in () if watchdog is None else watchdog.enable:
            self._watchdog_needs |= step.write
        self._watchdog_switches = () if watchdog is None else watchdog.read_back
        # where disabling switches it off, it would run out without power, too
        disabling = {name for step in description.disable for name in step.write}
        self._is_watched_idle = not disabling.isdisjoint(self._watchdog_switches)

        motor, inertia = servo.config.motor, servo.config.mechanics.total_inertia
        self._deceleration = 0.5 * motor.rated_torque / inertia
        self._per_second = servo.steps_per_second
        self._piece = max(1, round(_PIECE_S * self._per_second))
        self._steps = 0  # integration steps done
        self._states = state_machine(description)
        self._values: dict[str, float] = {}
        self.switch_on()

    # Time

    @property
    def time_s(self) -> float:
        """Simulated time since the start, s."""
        return self._steps / self._per_second

    @property
    def is_paced_by_requests(self) -> bool:
        """True with pace sync: without requests that read the position, time stands still."""
        return self._sync_steps is not None

    def sample(self) -> None:
        """Note a request that reads the position; with pace sync, advance by one period.

        Must be called once for each such request, before its signals are written and read.
        """
        self.samples += 1
        if self._sync_steps is not None:
            self._advance(self._sync_steps)

    def advance_to(self, now_ns: int) -> None:
        """Advance to the time ``now_ns`` after the start; with pace sync, do nothing.

        Raises `DriveError`: the simulated servo diverged.
        """
        if self._sync_steps is None:
            self._advance(now_ns * self._per_second // 1_000_000_000 - self._steps)

    def _advance(self, steps: int) -> None:
        while steps > 0:
            piece = min(steps, self._piece)
            if self._is_watched:
                piece = min(piece, max(1, self._silent_at - self._steps))
            self.servo.advance(piece)
            self._steps += piece
            steps -= piece
            if self._is_watched and self._steps >= self._silent_at:
                self.fail()
            elif self.state is _STOPPING and self._states.after_stop is not _STOPPING and self._has_stopped:
                self.enter(self._states.after_stop)
        if not math.isfinite(self.servo.true_position):
            raise DriveError("the simulated servo diverged: look at mechanics, friction and loops under simulation")

    # Signals

    def read(self, name: str) -> float:
        """Return the present number of a signal, not rounded; of a signal that is written, the last number (first 0).

        With pace real, the number belongs to the time to which the drive was advanced: the end of the request.
        """
        if name == "position":
            return self.servo.position / self._si[name]
        if name == "velocity":
            return self.servo.velocity / self._si[name]
        if name == "torque":
            return self.servo.torque / self._si[name]
        if name == self._watchdog and self.state is not self._states.fault:
            return self._values.get(name, 0.0)  # some drives show in the same register that it has tripped
        shown = self._states.shown(self.state)
        return shown[name] if name in shown else self._values.get(name, 0.0)

    def write(self, name: str, number: float) -> None:
        """Write a signal: a command, a number of a sequence or the time of the watchdog.

        A number written while the drive has no supply is lost. Commands take effect while the drive is enabled, once
        all commands of its mode have come; until then it holds its position, or gives no torque. Raises `RefusedError`:
        the signal cannot be written, or not with this number.
        """
        if name not in self._takes:
            raise RefusedError(f"{name} cannot be written")
        accepted = self._takes[name]
        if not math.isfinite(number) or (name == self._watchdog and number * self._si[name] < 0.0):
            raise RefusedError(f"{name} cannot be {number:g}")
        if accepted and not any(matches({name: known}, {name: number}) for known in accepted):
            raise RefusedError(f"{name} cannot be {number:g}; it accepts {', '.join(f'{n:g}' for n in accepted)}")
        if not self.is_on:
            return
        self._values[name] = number
        if name in COMMANDS:
            self.fed()
            self._command(name, number)
        if name == self._watchdog or name in self._watchdog_needs or name in self._watchdog_switches:
            self._set_watchdog()
        wanted = self._states.wanted(name, self._values, self.state)
        if wanted is not self.state:
            self.enter(wanted)

    def fed(self) -> None:
        """Reset the watchdog: a command came, or another request that resets it."""
        self._silent_at = self._steps + self._watchdog_steps

    def fail(self) -> None:
        """Enter the fault state: no power until the fault is reset."""
        self._states.fail()
        self.enter(self._states.fault)

    # Supply

    def switch_off(self) -> None:
        """Switch the supply off: the drive loses power and settings; the mechanics keeps moving."""
        self.is_on = False
        self.enter(_OFF)

    def switch_on(self, kept: Collection[str] = ()) -> None:
        """Switch the supply on, and enter the state after power-on; the signals ``kept`` have their last numbers."""
        self.is_on = True
        self._values = {name: number for name, number in self._values.items() if name in kept}
        self._targets: dict[str, float] = {}  # commands that came since the drive was enabled, SI
        self._pending: set[str] = set()  # commands that were not handed to the servo yet
        self._watchdog_steps = 0  # integration steps without a command that trip the watchdog; 0: it is off
        self._silent_at = 0  # integration step at which it trips
        self._states.forget()
        self.enter(self._states.disabled)

    # Consequences

    @property
    def _is_watched(self) -> bool:
        is_due = self.state is _ENABLED or (self._is_watched_idle and self.state is not self._states.fault)
        return self._watchdog_steps > 0 and is_due

    @property
    def _has_stopped(self) -> bool:
        is_standing = self.servo.velocity_demand == 0.0 and self.servo.is_at_rest
        return is_standing or self._steps >= self._give_up_at

    def _set_watchdog(self) -> None:
        assert self._watchdog is not None
        time_s = self._values.get(self._watchdog, 0.0) * self._si[self._watchdog]
        is_on = all(self._values.get(name, 0.0) for name in self._watchdog_switches)
        is_armed = time_s > 0.0 and is_on and matches(self._watchdog_needs, self._values)
        self._watchdog_steps = max(1, round(time_s * self._per_second)) if is_armed else 0
        self.fed()

    def enter(self, state: DriveState) -> None:
        """Enter a state, whatever led there."""
        self.state = state
        self._targets = {}
        self._pending = set()
        if state is _ENABLED:
            self.fed()
            self.servo.command(self._mode, self.servo.position if self._mode is Mode.CSP else 0.0)
        elif state is _STOPPING:
            self.servo.quick_stop(self._deceleration)
            # a blocked or externally driven axis must not stay powered: it may take twice the time of the ramp
            ramp_s = abs(self.servo.velocity_demand) / self._deceleration
            self._give_up_at = self._steps + round((0.5 + 2.0 * min(ramp_s, 30.0)) * self._per_second)
        else:
            self.servo.command(_NO_MODE, 0.0)

    def _command(self, name: str, number: float) -> None:
        """Hand the commands to the servo once all have come, in one request or in several."""
        if self.state is not _ENABLED or name not in self._commands:
            return
        self._targets[name] = number * self._si[name]
        is_repeated = name in self._pending  # the master does not write all of them
        self._pending.add(name)
        if not is_repeated and self._pending != self._commands:
            return
        self._pending = {name} if is_repeated else set()
        torque = self._targets.get("torque_command", 0.0)
        velocity = self._targets.get("velocity_command", 0.0)
        if self._mode is Mode.CSP:
            position = self._targets.get("position_command", self.servo.position_demand)
            self.servo.command(self._mode, position, velocity, torque)
        elif self._mode is Mode.CSV:
            self.servo.command(self._mode, velocity, 0.0, torque)
        else:
            self.servo.command(self._mode, torque)


def _scales(name: str, description: Description, servo: "Servo", units: AxisUnits) -> dict[str, float]:
    """Return the SI value of one step of each signal that the drive itself uses."""
    if math.isnan(units.counts_per_unit):
        units = dataclasses.replace(units, counts_per_unit=servo.counts_per_unit)
    if math.isnan(units.rated_torque):
        units = dataclasses.replace(units, rated_torque=servo.config.motor.rated_torque)
    signals = description.units()
    used = {"position", "velocity", "torque", *COMMANDS} & signals.keys()
    if description.watchdog is not None:
        used.add(description.watchdog.signal)
    scales = {key: UNITS[signals[key].unit](units) * signals[key].scale for key in used}
    for key, scale in scales.items():
        if math.isnan(scale):
            unit = signals[key].unit
            raise UsageError(f"{name}: {description.name} has its {key} in {unit}: {NEEDS[unit]} must be given")
    return scales


def _accepted_numbers(description: Description) -> Mapping[str, frozenset[float]]:
    """Return the accepted numbers of each signal that can be written; an empty set: all numbers."""
    found: dict[str, set[float]] = {}
    for steps in description.sequences.values():
        for step in steps:
            for name, number in step.write.items():
                found.setdefault(name, set()).add(number)
    accepted = {name: frozenset(numbers) for name, numbers in found.items()}
    everything: frozenset[float] = frozenset()
    free = [name for name in COMMANDS if name in description.units()]
    if description.watchdog is not None:
        free.append(description.watchdog.signal)
    if description.state_machine == "cia402":
        free.append("control")
    return accepted | dict.fromkeys(free, everything)
