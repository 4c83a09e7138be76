"""State machines of simulated drives: states reached by written numbers, and numbers that show a state. Pure."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

from friction_hil.drive import DriveState
from friction_hil.errors import UsageError
from friction_hil_drivers.cia402 import profile
from friction_hil_drivers.cia402.simulated.power import requested_state
from friction_hil_drivers.serial_line.description import STATES, Description, Rule, Step

_DISABLED, _ENABLED = DriveState.SWITCH_ON_DISABLED, DriveState.OPERATION_ENABLED
_STOPPING, _FAULT = DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT
_UNPOWERED = (_DISABLED, DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON, DriveState.NOT_READY)
_COMMUNICATION_ERROR = 0x8100
_SIGNS_OF_SILENCE = ("watchdog", "heartbeat", "communication", "time")
_ANY_BITS = 0xFF  # bits that are tried if a number only has to differ


class StateMachine(Protocol):
    """State machine of a simulated drive."""

    disabled: DriveState  # without power and ready to be enabled, as after power-on
    fault: DriveState
    after_stop: DriveState  # once the quick stop has brought the axis to rest

    def wanted(self, name: str, values: Mapping[str, float], state: DriveState) -> DriveState:
        """Return the state that follows ``state`` when the signal ``name`` was written.

        ``values``: numbers of all signals as written last, including this one.
        """
        ...

    def shown(self, state: DriveState) -> Mapping[str, float]:
        """Return the numbers of the signals that show the state."""
        ...

    def fail(self) -> None:
        """Note that a fault begins: only numbers written from now on can reset it."""
        ...

    def forget(self) -> None:
        """Return to the state after power-on."""
        ...


def state_machine(description: Description) -> StateMachine:
    """Return the state machine of a description.

    Raises `UsageError`: a sequence waits for a state that no numbers of the drive show.
    """
    return Cia402States(description) if description.state_machine == "cia402" else DescribedStates(description)


class Cia402States:
    """Control- and statusword of CiA 402; the quick stop ends in Switch On Disabled (605Ah = 2)."""

    disabled, fault, after_stop = _DISABLED, _FAULT, _DISABLED

    def __init__(self, description: Description) -> None:
        self._before = 0
        error = _error_number(description) if description.errors else _COMMUNICATION_ERROR
        self._shown = {
            state: {"status": float(_statusword(state)), "error": float(error if state is _FAULT else 0)}
            for state in DriveState
        }

    def wanted(self, name: str, values: Mapping[str, float], state: DriveState) -> DriveState:
        """See `StateMachine`."""
        if name != "control":
            return state
        word, before = int(values["control"]), self._before
        self._before = word
        if state is _FAULT:
            return _DISABLED if word & ~before & profile.FAULT_RESET else state
        for _ in range(2):  # from Ready To Switch On one word causes two transitions
            following = requested_state(state, word)
            if state is not _STOPPING or following is not _ENABLED:
                state = following
        return state

    def shown(self, state: DriveState) -> Mapping[str, float]:
        """See `StateMachine`."""
        return self._shown[state]

    def fail(self) -> None:
        """See `StateMachine`; a reset bit that is set already is no rising edge."""

    def forget(self) -> None:
        """See `StateMachine`."""
        self._before = 0


class DescribedStates:
    """States reached by the steps of a description's sequences, and shown by the numbers of its rules.

    A step takes effect when all its signals have been written and the step before it is done. Each sequence takes
    effect only in certain states: ``reset_fault`` in a fault, ``quick_stop`` under power, the others in any state but
    a fault.
    """

    def __init__(self, description: Description) -> None:
        d = description
        self._sequences = {
            name: steps
            for name, steps in (
                ("reset_fault", d.reset_fault),
                ("disable", d.disable),
                ("quick_stop", () if _writes(d.quick_stop) == _writes(d.disable) else d.quick_stop),
                ("enable", d.enable),
            )
            if steps
        }
        self._done: dict[str, int] = {}  # index of the last done step, by sequence
        shown = {STATES[rule.state] for rule in d.states}
        ends = [STATES[step.until] for step in d.disable if step.until is not None]
        self.disabled = ends[-1] if ends else next((state for state in _UNPOWERED if state in shown), _DISABLED)
        self.fault = _FAULT if _FAULT in shown else self.disabled
        self.after_stop = self.disabled

        error = _error_number(d)
        fault_rule = next((rule for rule in d.states if STATES[rule.state] is _FAULT), None)
        is_told_by_rule = fault_rule is not None and bool(fault_rule.meaning)  # a lost master is no error then
        is_fault_shown_by_error = any(rule.signal == "error" and STATES[rule.state] is _FAULT for rule in d.states)
        needed = {self.disabled, self.fault, _ENABLED} | ({_STOPPING} & shown)
        needed |= {STATES[step.until] for steps in self._sequences.values() for step in steps if step.until}
        self._shown: dict[DriveState, Mapping[str, float]] = {}
        for state in sorted(needed):
            preferred = {"error": (error,)} if state is _FAULT and not is_told_by_rule else {}
            numbers = telling_numbers(d.states, state, preferred)
            if numbers is None:
                raise UsageError(
                    f"the description {d.name!r} waits for the state {state.name.lower()}, but by its rules (states) "
                    "no numbers of the drive show it"
                )
            # a fault that another signal shows still has the number of a lost master as its error
            number = error if state is _FAULT and not is_fault_shown_by_error else 0
            self._shown[state] = {"error": float(number)} | numbers

    def wanted(self, name: str, values: Mapping[str, float], state: DriveState) -> DriveState:
        """See `StateMachine`."""
        found = state
        for key, steps in self._sequences.items():
            if not _takes_effect(key, state):
                continue
            index = self._matching(key, steps, name, values, state)
            if index is None:
                continue
            is_repeated = self._done.get(key) == index
            self._done[key] = index
            target = self._target(key, index)
            if key == "quick_stop" and target is not None:
                if state is _ENABLED:
                    self.after_stop, target = target, _STOPPING
                elif is_repeated:
                    target = None
            if found is state and target is not None:
                found = target
        return found

    def shown(self, state: DriveState) -> Mapping[str, float]:
        """See `StateMachine`."""
        return self._shown.get(state) or self._shown[_ENABLED if state.is_powered else self.disabled]

    def fail(self) -> None:
        """See `StateMachine`."""
        self._done.clear()

    def forget(self) -> None:
        """See `StateMachine`."""
        self._done.clear()

    def _matching(
        self, key: str, steps: Sequence[Step], name: str, values: Mapping[str, float], state: DriveState
    ) -> int | None:
        """Return the index of the step that was written last; the next one due is preferred. None: no step was."""
        last = self._done.get(key, -1)
        for index in sorted(range(len(steps)), key=lambda index: (index != last + 1, index)):
            if name not in steps[index].write or not matches(steps[index].write, values):
                continue
            if index == 0 or last in (index - 1, index) or self._is_at(steps[index - 1], state):
                return index
        return None

    def _is_at(self, step: Step, state: DriveState) -> bool:
        return step.until is not None and STATES[step.until] is state

    def _target(self, key: str, index: int) -> DriveState | None:
        """Return the state in which a step ends; for a last step without ``until``, that of the sequence."""
        steps = self._sequences[key]
        until = steps[index].until
        if until is not None:
            return STATES[until]
        if index < len(steps) - 1:
            return None
        return _ENABLED if key == "enable" else self.disabled


def matches(wanted: Mapping[str, float], values: Mapping[str, float]) -> bool:
    """Return True if all ``wanted`` numbers are among ``values``, within the precision of 32-bit floats."""
    return all(
        name in values and math.isclose(values[name], number, rel_tol=1e-6, abs_tol=1e-9)
        for name, number in wanted.items()
    )


def telling_numbers(
    rules: Sequence[Rule], state: DriveState, preferred: Mapping[str, Iterable[int]]
) -> dict[str, float] | None:
    """Return numbers of the rules' signals for which the first rule that fits gives ``state``; None if none do.

    ``preferred``: numbers to prefer, by signal.
    """
    signals = {rule.signal for rule in rules}
    for index, rule in enumerate(rules):
        if STATES[rule.state] is not state:
            continue
        # a rule has one signal, so that the number of each signal can be found separately
        demands = [*((before, False) for before in rules[:index]), (rule, True)]
        numbers = {
            signal: _number([demand for demand in demands if demand[0].signal == signal], preferred.get(signal, ()))
            for signal in signals
        }
        if None not in numbers.values():
            return {signal: float(number) for signal, number in numbers.items() if number is not None}
    return None


def _number(demands: Sequence[tuple[Rule, bool]], preferred: Iterable[int]) -> int | None:
    """Return a number that fits the rules demanded with True and none of the others; None if none is found."""
    for number in (*preferred, 0):
        if _meets(number, demands):
            return number
    base, fixed, free = 0, 0, 0
    for rule, is_wanted in demands:
        mask = -1 if rule.mask is None else rule.mask
        if (rule.value is not None) is is_wanted:  # the bits must have this value
            value = rule.value if rule.value is not None else rule.value_not
            assert value is not None
            base, fixed = base & ~mask | value & mask, fixed | mask
        else:  # the bits must differ
            free |= _ANY_BITS if rule.mask is None else rule.mask
    bits = [1 << k for k in range(free.bit_length()) if free & ~fixed & 1 << k]
    # one flipped bit is enough for each rule that must differ
    for count in range(len(demands) + 1):
        for flips in itertools.combinations(bits, count):
            if _meets(base ^ sum(flips), demands):
                return base ^ sum(flips)
    return None


def _meets(number: int, demands: Sequence[tuple[Rule, bool]]) -> bool:
    return all(rule.fits(number) is is_wanted for rule, is_wanted in demands)


def _takes_effect(key: str, state: DriveState) -> bool:
    if key == "reset_fault":
        return state is _FAULT
    if key == "quick_stop":
        return state in (_ENABLED, _STOPPING)
    return state is not _FAULT


def _writes(steps: Sequence[Step]) -> list[dict[str, float]]:
    return [step.write for step in steps]


def _statusword(state: DriveState) -> int:
    word = profile.STATE_BITS.get(state, 0) | profile.VOLTAGE_ENABLED | profile.REMOTE
    return word | profile.FOLLOWS_COMMAND if state is _ENABLED else word


def _error_number(description: Description) -> int:
    """Return the error number of a lost master; another one if the description has none."""
    errors = description.errors
    for sign in _SIGNS_OF_SILENCE:
        for number, text in errors.items():
            if number and sign in text.lower():
                return number
    return next((number for number in errors if number), 1)
