"""CiA 402 device of a simulated node: device control, modes of operation, supervision."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from friction_hil.drive import DriveState, Mode
from friction_hil.errors import DriveError
from friction_hil.servo.servo import Servo
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.access import Abort, AbortError
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary
from friction_hil_drivers.cia402.simulated.emergency import Emergencies
from friction_hil_drivers.cia402.simulated.manners import DriveManners
from friction_hil_drivers.cia402.simulated.power import requested_state
from friction_hil_drivers.cia402.simulated.setpoints import NO_MODE, Setpoints
from friction_hil_drivers.cia402.simulated.units import SimulatedUnits, VelocityUnit
from friction_hil_drivers.cia402.simulated.values import (
    connect_live_values,
    file_resolution,
    file_velocity_unit,
    set_defaults,
)

PARAMETER_ERROR, FOLLOWING_ERROR = 0x6320, 0x8611
_UNSUPERVISED = 0xFFFFFFFF  # following error window that switches the supervision off
_MS, _S = 1_000_000, 1_000_000_000  # ns

_DISABLED, _ENABLED = DriveState.SWITCH_ON_DISABLED, DriveState.OPERATION_ENABLED
_STOPPING, _FAULT = DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT
_CSP = Mode.CSP

# Option codes
_ABORT_FAULT, _ABORT_DISABLE, _ABORT_QUICK_STOP = 1, 2, 3  # 6007h; 0: no reaction
_COAST, _PROFILE_RAMP, _QUICK_STOP_RAMP = 0, 1, 2  # 605Ah to 605Eh
_PROFILE_RAMP_AND_STAY, _QUICK_STOP_RAMP_AND_STAY = 5, 6  # 605Ah


@dataclass(frozen=True, slots=True)
class _Stop:
    """A ramp to standstill, and the state that follows it (None: stay and hold the position)."""

    then: DriveState | None
    give_up_ns: int


def _units(servo: Servo, manners: DriveManners, dictionary: Dictionary) -> SimulatedUnits:
    """Return the units of the drive: those of the configuration, else of a vendor's file, else of the servo."""
    unit = manners.velocity_unit
    return SimulatedUnits(
        servo,
        resolution=file_resolution(dictionary) if servo.config.mechanics.axis == "rotary" else None,
        rated_torque=dictionary.given(objects.RATED_TORQUE) or None,
        velocity=file_velocity_unit(dictionary) if unit is None else VelocityUnit.parse(unit),
        is_inverted=manners.is_inverted,
    )


class SimulatedCia402Drive:
    """Power stage, loops and motor behind their objects.

    ``update`` is to be called after every frame and regularly between frames: it follows the controlword, ends
    ramps, activates new set-points and supervises the following error.
    """

    def __init__(
        self,
        servo: Servo,
        dictionary: Dictionary,
        emergencies: Emergencies,
        modes: Iterable[Mode] | None,
        manners: DriveManners | None = None,
    ) -> None:
        self.servo = servo
        self.state = _DISABLED
        self._mode = NO_MODE
        self._controlword = 0
        self._stop: _Stop | None = None
        self._stop_was_commanded = False  # the quick stop, by the master's controlword
        self._exceeded_since_ns: int | None = None
        self._has_following_error = False
        self._emergencies = emergencies
        manners = DriveManners() if manners is None else manners
        self._manners = manners
        self._units = _units(servo, manners, dictionary)
        told = dictionary.given(objects.SUPPORTED_MODES)
        if modes is None:
            self._modes = frozenset(mode for mode in Mode if not told or told >> (mode - 1) & 1)
        else:
            self._modes = frozenset(modes)
        # those without a model here give no torque
        other = {number for number in range(1, 33) if told >> (number - 1) & 1 and number not in set(Mode)}
        self._accepted = self._modes | other | {NO_MODE, dictionary.of(objects.MODE).value}
        set_defaults(dictionary, servo, self._units, self._modes, are_modes_given=modes is not None)
        for preset in manners.values:
            dictionary.preset(preset.index, preset.subindex, preset.value)
        connect_live_values(dictionary, servo, self._units)

        self._controlword_wanted, self._mode_wanted = dictionary.entries(objects.CONTROLWORD, objects.MODE)
        self._mode_wanted.on_write = self._check_mode
        if manners.controlword == "twice":
            self._controlword_wanted.on_write = self._count_controlword
        self._abort_option, self._quick_stop_option = dictionary.entries(
            objects.ABORT_CONNECTION_OPTION, objects.QUICK_STOP_OPTION
        )
        self._quick_stop_option.on_write = self._check_quick_stop_option
        self._shutdown_option, self._disable_option, self._fault_option = dictionary.entries(
            objects.SHUTDOWN_OPTION, objects.DISABLE_OPERATION_OPTION, objects.FAULT_REACTION_OPTION
        )
        self._profile_deceleration, self._quick_stop_deceleration = dictionary.entries(
            objects.PROFILE_DECELERATION, objects.QUICK_STOP_DECELERATION
        )
        self._window, self._timeout = dictionary.entries(
            objects.FOLLOWING_ERROR_WINDOW, objects.FOLLOWING_ERROR_TIMEOUT
        )
        dictionary.of(objects.STATUSWORD).connect(lambda: self.statusword, objects.STATUSWORD)
        dictionary.of(objects.MODE_DISPLAY).connect(lambda: self._mode, objects.MODE_DISPLAY)

        self._repeats = 0  # of the controlword in a row
        self._transition: DriveState | None = None  # that takes time, and is under way
        self._transition_ends_ns = 0
        self._faults: set[int] = set()
        self._setpoints = Setpoints(servo, self._units, dictionary, is_reversed=manners.is_reversed)
        self.reset()

    def reset(self) -> None:
        """Start from the dictionary's values, as after power-on; the mechanics keeps moving."""
        self._setpoints.load()
        self._faults.clear()
        self._controlword = 0
        self._repeats = 0
        self._mode = self._mode_wanted.value
        self._has_following_error = False
        self._stop_was_commanded = False
        self._enter(_DISABLED)

    @property
    def statusword(self) -> int:
        """Value of 6041h."""
        bits = profile.STATE_BITS[self.state] | profile.VOLTAGE_ENABLED | profile.REMOTE
        if self._has_following_error:
            bits |= profile.FOLLOWING_ERROR
        if self._emergencies.are_present and not self._faults:
            bits |= profile.WARNING
        if self._stop is not None:
            if self._is_standing():
                bits |= profile.TARGET_REACHED
        elif self.state is _ENABLED and self._mode != NO_MODE:
            bits |= profile.FOLLOWS_COMMAND
            if self._setpoints.are_limited or self.servo.is_torque_limited:
                bits |= profile.INTERNAL_LIMIT
        return bits

    def advance(self, steps: int) -> None:
        """Let time pass.

        Raises `DriveError`: the simulated servo left all bounds.
        """
        self.servo.advance(steps)
        if not math.isfinite(self.servo.true_position):
            raise DriveError("the simulated servo diverged: check mechanics, friction and loops under simulation")

    def update(self, now_ns: int) -> None:
        """Follow the controlword, activate new set-points, supervise the following error."""
        self._follow_controlword(now_ns)
        if self._stop is not None:
            self._continue_stop(self._stop, now_ns)
        if self._mode != self._mode_wanted.value:
            self._mode = self._mode_wanted.value
            self._setpoints.forget()
        if self.state is not _ENABLED or self._stop is not None:
            return
        if self._mode == _CSP and self._setpoints.jumps_beyond(self._window.value):
            self._fail_to_follow(now_ns)
            return
        if self._setpoints.are_new:
            self._setpoints.activate(self._mode)
        elif self._setpoints.are_offsets_new:
            self._setpoints.activate_offsets()
        if self._mode == _CSP:
            self._supervise(now_ns)

    def connection_lost(self, code: int, now_ns: int) -> None:
        """Report that the master is missing and, while powered, react as 6007h says."""
        reaction = self._abort_option.value
        if not self.state.is_powered:
            if self._manners.faults_without_power and reaction == _ABORT_FAULT:
                self.fault(code, now_ns)
            self._emergencies.report(code)
            return
        if reaction == _ABORT_FAULT:
            self.fault(code, now_ns)
            return
        self._emergencies.report(code)
        if reaction == _ABORT_DISABLE:
            self._enter(_DISABLED)
        elif reaction == _ABORT_QUICK_STOP and self.state is _ENABLED:
            self._quick_stop(now_ns)

    def disable(self) -> None:
        """Lose the power stage, as by STO: Switch on Disabled without a ramp."""
        if self.state not in (_FAULT, DriveState.FAULT_REACTION_ACTIVE):
            self._enter(_DISABLED)

    def connection_restored(self, *codes: int) -> None:
        """Take back what `connection_lost` reported; a fault stays until it is reset."""
        self._emergencies.clear(*(code for code in codes if code not in self._faults))

    def fault(self, code: int, now_ns: int) -> None:
        """Enter the fault state through the fault reaction (605Eh)."""
        self._faults.add(code)
        self._emergencies.report(code)
        if self.state in (_FAULT, DriveState.FAULT_REACTION_ACTIVE):
            return
        reaction = self._fault_option.value
        if reaction == _COAST or not self.state.is_powered:
            self._enter(_FAULT)
            return
        self.state = DriveState.FAULT_REACTION_ACTIVE
        self._ramp_down(_FAULT, now_ns, is_quick=reaction == _QUICK_STOP_RAMP)

    # Device control

    def _follow_controlword(self, now_ns: int) -> None:
        word, before = self._controlword_wanted.value, self._controlword
        self._controlword = word
        if self.state is _FAULT:
            if word & ~before & profile.FAULT_RESET:
                self._reset_fault()
            return
        if not self._is_heeded(word, before):
            return
        wanted = requested_state(self.state, word)
        if self.state is _STOPPING:
            self._stop_was_commanded |= not word & 0x04
            if wanted is _ENABLED and not self._may_resume():
                return
        if wanted is not self._transition:
            self._transition = None  # the command that had begun it was revoked
        if wanted is not self.state:
            self._change(wanted, now_ns)
        elif self.state is _ENABLED and self._stop is not None:
            self._enter(wanted)  # the command that had started a ramp was revoked

    def _is_heeded(self, word: int, before: int) -> bool:
        """True if the drive looks at a controlword; ``before`` is the one of the update before."""
        if self._manners.controlword == "edge":
            return word != before or self._transition is not None
        return self._manners.controlword == "level" or self._repeats >= 2

    def _count_controlword(self, word: int) -> None:
        self._repeats = self._repeats + 1 if word == self._controlword_wanted.value else 1

    def _takes_time(self, wanted: DriveState, now_ns: int) -> bool:
        """True until a transition towards Operation Enabled has taken its time."""
        duration_s = {
            DriveState.SWITCHED_ON: self._manners.switch_on_s if self.state is not _ENABLED else 0.0,
            _ENABLED: self._manners.enable_s,
        }.get(wanted, 0.0)
        if duration_s == 0.0:
            return False
        if self._transition is not wanted:
            self._transition, self._transition_ends_ns = wanted, now_ns + round(duration_s * _S)
        return now_ns < self._transition_ends_ns

    def _reset_fault(self) -> None:
        self._emergencies.clear(*self._faults)
        self._faults.clear()
        self._has_following_error = False
        self._enter(_DISABLED)

    def _may_resume(self) -> bool:
        """True if transition 16 is allowed: the controlword asked for the stop, and 605Ah keeps the drive in it."""
        may_stay = (_PROFILE_RAMP_AND_STAY, _QUICK_STOP_RAMP_AND_STAY)
        return self._stop_was_commanded and self._quick_stop_option.value in may_stay

    def _change(self, wanted: DriveState, now_ns: int) -> None:
        """Make a transition that the controlword asks for, with the ramp of its option code."""
        if wanted is _ENABLED and not self._setpoints.has_period:
            self.fault(PARAMETER_ERROR, now_ns)
            return
        if self._takes_time(wanted, now_ns):
            return
        option = None
        if self.state is _ENABLED:
            if wanted is _STOPPING:
                self._quick_stop(now_ns)
                return
            if wanted is DriveState.SWITCHED_ON:
                option = self._disable_option
            elif wanted is DriveState.READY_TO_SWITCH_ON:
                option = self._shutdown_option
        if option is None or option.value == _COAST:
            self._enter(wanted)
        elif self._stop is None or self._stop.then is not wanted:
            self._ramp_down(wanted, now_ns, is_quick=False)

    def _quick_stop(self, now_ns: int) -> None:
        option = self._quick_stop_option.value
        if option == _COAST:
            self._enter(_DISABLED)
            return
        self.state = _STOPPING
        self._stop_was_commanded = False
        then = _DISABLED if option in (_PROFILE_RAMP, _QUICK_STOP_RAMP) else None
        self._ramp_down(then, now_ns, is_quick=option in (_QUICK_STOP_RAMP, _QUICK_STOP_RAMP_AND_STAY))

    def _ramp_down(self, then: DriveState | None, now_ns: int, *, is_quick: bool) -> None:
        deceleration = self._quick_stop_deceleration if is_quick else self._profile_deceleration
        rate = max(1, deceleration.value) / self._units.increments
        self.servo.quick_stop(rate)
        # a blocked axis, or one driven from outside, must not stay powered: the ramp is given up after twice its time
        patience_s = min(0.5 + 2.0 * abs(self.servo.velocity_demand) / rate, 60.0)
        self._stop = _Stop(then, now_ns + round(patience_s * _S))

    def _continue_stop(self, stop: _Stop, now_ns: int) -> None:
        if stop.then is not None and (self._is_standing() or now_ns >= stop.give_up_ns):
            self._enter(stop.then)

    def _is_standing(self) -> bool:
        return self.servo.velocity_demand == 0.0 and self.servo.is_at_rest

    def _enter(self, state: DriveState) -> None:
        """Enter a state at once, without a ramp; without power unless it is Operation Enabled."""
        self.state = state
        self._transition = None
        self._stop = None
        self._exceeded_since_ns = None
        self._setpoints.forget()
        if not state.is_powered:
            self.servo.command(NO_MODE, 0.0, 0.0, 0.0)

    # Supervision and checks

    def _supervise(self, now_ns: int) -> None:
        """Fault when the following error stays beyond its window (6065h) for longer than 6066h."""
        excess = abs(self.servo.following_error) * self._units.counts > self._window.value
        if not excess or self._window.value == _UNSUPERVISED:
            self._exceeded_since_ns = None
            return
        if self._exceeded_since_ns is None:
            self._exceeded_since_ns = now_ns
        if now_ns - self._exceeded_since_ns >= self._timeout.value * _MS:
            self._fail_to_follow(now_ns)

    def _fail_to_follow(self, now_ns: int) -> None:
        self._has_following_error = True
        self.fault(FOLLOWING_ERROR, now_ns)

    def _check_mode(self, value: int) -> None:
        if value not in self._accepted:
            raise AbortError(Abort.VALUE)

    def _check_quick_stop_option(self, value: int) -> None:
        if value in (3, 4):
            raise AbortError(Abort.VALUE)
