"""Sequences of steps from one drive state to another, one step per cycle. No line, no clock."""

from collections.abc import Mapping, Sequence

from friction_hil.drive import DriveState, Request
from friction_hil_drivers.cia402 import profile
from friction_hil_drivers.serial_line.description import STATES, Description, Rule, Step

_OFF = (
    DriveState.NOT_READY,
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY_TO_SWITCH_ON,
    DriveState.SWITCHED_ON,
    DriveState.FAULT,
)


def state_signals(description: Description) -> tuple[str, ...]:
    """Return the signals that show the state."""
    if description.state_machine == "cia402":
        return ("status",)
    return tuple(dict.fromkeys(rule.signal for rule in description.states))


def state_of(description: Description, values: Mapping[str, float]) -> DriveState:
    """Return the state that the drive's numbers show; unknown until the needed ones were read."""
    if description.state_machine == "cia402":
        return profile.drive_state(int(values["status"])) if "status" in values else DriveState.UNKNOWN
    rule = _rule(description, values)
    return DriveState.UNKNOWN if rule is None else STATES[rule.state]


def meaning_of(description: Description, values: Mapping[str, float]) -> str:
    """Return why the drive is in the state that `state_of` returns; empty if its description does not say it."""
    rule = None if description.state_machine == "cia402" else _rule(description, values)
    return "" if rule is None else rule.meaning


def _rule(description: Description, values: Mapping[str, float]) -> Rule | None:
    """Return the rule that gives the state; None if it needs a number that was not read, or none fits."""
    for rule in description.states:
        if rule.signal not in values:
            return None
        if rule.fits(values[rule.signal]):
            return rule
    return None


class Sequencer:
    """Takes one drive from state to state."""

    def __init__(self, description: Description, before: Sequence[Step] = ()) -> None:
        self._description = description
        # written each time before the drive is enabled: its mode and its watchdog, which a restart of the drive or the
        # reset of a fault may have changed
        self._before = tuple(before)
        self._request = Request.LISTEN
        self._steps: tuple[Step, ...] = ()
        self._index = 0
        self._is_written = False  # the drive has acknowledged the present step
        self._differing = ""  # what the drive holds instead of what this step wrote
        self._since_s = 0.0
        self._word = 0  # cia402: the controlword that the drive accepted last
        self._next_word = 0  # cia402: the one to write; it may have to wait on the line
        self.problem = ""  # about the step that the drive does not follow; empty if there is none

    @property
    def is_enabling(self) -> bool:
        """True while the drive is taken to power."""
        return self._request is Request.ENABLE

    def acknowledge(self, differing: str = "") -> None:
        """Note that the drive accepted the values of `next_write`.

        ``differing``: what the drive reports instead of these values, "" if nothing; if it does, the step is written
        again.
        """
        self._differing = differing
        self._is_written, self._word = not differing, self._next_word

    def next_write(self, request: Request, state: DriveState, time_s: float) -> Mapping[str, float]:
        """Return the values to write in this cycle, by signal; none if nothing is left to do.

        ``request`` is never `Request.LISTEN`; ``state``: as reported last; ``time_s``: of the cycle, for the time-outs
        of steps.
        """
        self._next_word = self._word
        if request is not self._request:
            self._request, self._index, self._is_written, self._since_s = request, 0, False, time_s
            self._differing = ""
            self._steps, self.problem = self._sequence(request), ""
        while self._index < len(self._steps):
            step = self._steps[self._index]
            is_reached = step.until is None or state is STATES[step.until]
            if not (self._is_written and is_reached):
                if time_s - self._since_s > step.timeout_s and not self.problem:
                    self.problem = _not_followed(step, state, self._differing)
                # a step that waits for a state is repeated: some drives need it twice
                return step.write
            self._index, self._is_written, self._since_s = self._index + 1, False, time_s
        if self._description.state_machine != "cia402":
            return {}
        word = profile.next_controlword(state, request, self._word)
        is_reached = {
            Request.ENABLE: state is DriveState.OPERATION_ENABLED,
            Request.QUICK_STOP: state is DriveState.QUICK_STOP_ACTIVE or state in _OFF,
        }.get(request, state in _OFF)
        if word == self._word and self._is_written and is_reached:
            return {}
        self._next_word = word
        return {"control": word}

    def _sequence(self, request: Request) -> tuple[Step, ...]:
        description = self._description
        return {
            Request.ENABLE: (*self._before, *description.enable),
            Request.DISABLE: description.disable,
            Request.QUICK_STOP: description.quick_stop or description.disable,
            Request.RESET_FAULT: description.reset_fault,
        }[request]


def watchdog_steps(description: Description, time_s: float) -> tuple[Step, ...]:
    """Return the steps that enable the drive's watchdog; none if its description has no watchdog.

    Raises `ValueError`: the time is too short or too long for the drive.
    """
    watchdog = description.watchdog
    if watchdog is None:
        return ()
    signal = description.units()[watchdog.signal]
    number = time_s / signal.scale
    if signal.counter_bits is not None:
        number = round(number)
    if number <= 0.0:
        raise ValueError(
            f"{description.name} counts the time of its watchdog in steps of {signal.scale:g} s: {time_s:g} s would "
            "switch it off; give a longer watchdog_s"
        )
    if signal.bounds is not None and number > signal.bounds[1]:
        longest_s = signal.bounds[1] * signal.scale
        raise ValueError(f"the watchdog of {description.name} takes at most {longest_s:g} s, not {time_s:g} s")
    return Step(write={watchdog.signal: number}), *watchdog.enable


def disable_writes(description: Description) -> list[Mapping[str, float]]:
    """Return the values that disable a drive even if it does not answer, in the order in which they are written."""
    if description.state_machine == "cia402":
        return [{"control": profile.DISABLE_VOLTAGE}]
    return [step.write for step in description.disable]


def _not_followed(step: Step, state: DriveState, differing: str) -> str:
    if differing:
        return f"the drive does not hold what was written to it: {differing}"
    written = ", ".join(f"{name} = {value:g}" for name, value in step.write.items())
    wanted = "acknowledge it" if step.until is None else f"lead to {step.until.replace('_', ' ')}"
    return f"the drive does not follow: {written} should {wanted} within {step.timeout_s:g} s; it is in {state.words}"
