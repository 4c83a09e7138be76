"""The way to the state that is wanted, one step a cycle: what to write next. No line, no clock."""

from collections.abc import Mapping, Sequence

from friction_hil.drive import DriveState, Request
from friction_hil_drivers.cia402 import profile
from friction_hil_drivers.serial_line.description import STATES, Description, Step

_OFF = (
    DriveState.NOT_READY,
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY_TO_SWITCH_ON,
    DriveState.SWITCHED_ON,
    DriveState.FAULT,
)


def state_signals(description: Description) -> tuple[str, ...]:
    """Signals that tell the state."""
    if description.state_machine == "cia402":
        return ("status",)
    return tuple(dict.fromkeys(rule.signal for rule in description.states))


def state_of(description: Description, values: Mapping[str, float]) -> DriveState:
    """State that the drive's numbers tell; unknown while it has not told all that is needed."""
    if description.state_machine == "cia402":
        return profile.drive_state(int(values["status"])) if "status" in values else DriveState.UNKNOWN
    for rule in description.states:
        if rule.signal not in values:
            return DriveState.UNKNOWN
        if rule.fits(values[rule.signal]):
            return STATES[rule.state]
    return DriveState.UNKNOWN


class Sequencer:
    """Leads one drive from state to state.

    Parameters
    ----------
    description : Description
    before : sequence of Step
        Written before the drive is enabled, each time: its mode and its watchdog, which a restart of the drive or the
        reset of a fault may have changed.

    Attributes
    ----------
    trouble : str
        The step that the drive does not follow, in words; empty while it does.
    """

    def __init__(self, description: Description, before: Sequence[Step] = ()) -> None:
        self._description = description
        self._before = tuple(before)
        self._request = Request.LISTEN
        self._steps: tuple[Step, ...] = ()
        self._index = 0
        self._is_written = False  # the step at hand, and the drive has acknowledged it
        self._since_s = 0.0
        self._word = 0  # cia402: the controlword that the drive took last
        self._next_word = 0  # cia402: the one that it is given; it may have to wait for its turn on the line
        self.trouble = ""

    def acknowledge(self) -> None:
        """Note that the drive took what `next_write` gave."""
        self._is_written, self._word = True, self._next_word

    def next_write(self, request: Request, state: DriveState, time_s: float) -> Mapping[str, float]:
        """Values to write in this cycle, by signal; none where nothing is left to be done.

        Parameters
        ----------
        request : Request
            What the drive shall be; never `Request.LISTEN`.
        state : DriveState
            What it was last heard to be.
        time_s : float
            For time-outs.
        """
        self._next_word = self._word
        if request is not self._request:
            self._request, self._index, self._is_written, self._since_s = request, 0, False, time_s
            self._steps, self.trouble = self._sequence(request), ""
        while self._index < len(self._steps):
            step = self._steps[self._index]
            is_reached = step.until is None or state is STATES[step.until]
            if not (self._is_written and is_reached):
                if time_s - self._since_s > step.timeout_s and not self.trouble:
                    self.trouble = _not_followed(step, state)
                # a step that waits for a state is repeated: some drives need it twice
                return step.write
            self._index, self._is_written, self._since_s = self._index + 1, False, time_s
        return self._controlword(request, state) if self._description.state_machine == "cia402" else {}

    def _sequence(self, request: Request) -> tuple[Step, ...]:
        description = self._description
        return {
            Request.ENABLE: (*self._before, *description.enable),
            Request.DISABLE: description.disable,
            Request.QUICK_STOP: description.quick_stop or description.disable,
            Request.RESET_FAULT: description.reset_fault,
        }[request]

    def _controlword(self, request: Request, state: DriveState) -> Mapping[str, float]:
        if request is Request.RESET_FAULT:
            word = profile.reset_controlword(state, self._word)
        else:
            word = profile.next_controlword(state, request)
        is_there = {
            Request.ENABLE: state is DriveState.OPERATION_ENABLED,
            Request.QUICK_STOP: state is DriveState.QUICK_STOP_ACTIVE or state in _OFF,
        }.get(request, state in _OFF)
        if word == self._word and self._is_written and is_there:
            return {}
        self._next_word = word
        return {"control": word}


def watchdog_steps(description: Description, time_s: float) -> tuple[Step, ...]:
    """Steps that make the drive watch the daemon; none where it cannot.

    Raises
    ------
    ValueError
        So short or so long a time is none for the drive.
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
    """All there is to write, in turn, so that a drive is disabled, whatever it answers."""
    if description.state_machine == "cia402":
        return [{"control": profile.DISABLE_VOLTAGE}]
    return [step.write for step in description.disable]


def _not_followed(step: Step, state: DriveState) -> str:
    written = ", ".join(f"{name} = {value:g}" for name, value in step.write.items())
    wanted = "acknowledge it" if step.until is None else f"lead to {step.until.replace('_', ' ')}"
    return f"the drive does not follow: {written} should {wanted} within {step.timeout_s:g} s; it is in {state.words}"
