"""Set-up of one drive on an open line, before the loop: each step is checked. It may wait."""

import time
from collections.abc import Sequence

from friction_hil.errors import DriveError
from friction_hil_drivers.serial_line import codes
from friction_hil_drivers.serial_line.axis import SerialAxis
from friction_hil_drivers.serial_line.bus import SerialBus
from friction_hil_drivers.serial_line.description import Description, Step
from friction_hil_drivers.serial_line.protocol import Exchange
from friction_hil_drivers.serial_line.read_back import contradiction

_ATTEMPTS = 5  # a bad line disturbs one, a drive that refuses a step refuses it each time


def read_state(bus: SerialBus, axis: SerialAxis) -> None:
    """Read the signals that show the state of a drive. Raises `DriveError`: the drive does not answer."""
    for name in axis.state_signals:
        bus.transact(axis.name, bus.read_exchange(axis.name, name))


def write_step(bus: SerialBus, axis: SerialAxis, description: Description, step: Step) -> None:
    """Write one step, wait for the state that it leads to, and read back what the drive's watchdog depends on.

    Raises `DriveError`: the drive refuses the step, does not reach the state, or holds another value than was written.
    """
    exchange = bus.write_exchange(axis.name, step.write)
    disturbance = ""
    for _ in range(_ATTEMPTS):
        axis.image.values.update(step.write)
        disturbance = _write(bus, axis, exchange)
        if not disturbance:
            break
    else:
        text = f"{axis.name}: {exchange.label} was followed by what is no reply: {disturbance}"
        fix = "if the drive refuses the request, correct its description; otherwise check the line"
        raise DriveError(text, fix, code=codes.SETUP_REFUSED)
    _await_state(bus, axis, step)
    _read_back(bus, axis, description, step)


def arm_watchdog(bus: SerialBus, axis: SerialAxis, description: Description, steps: Sequence[Step]) -> str:
    """Write the steps that set a drive's watchdog; return what is known of it then, in words.

    Raises `DriveError`: the drive refuses a step, or holds another value than was written.
    """
    watchdog = description.watchdog
    assert watchdog is not None
    for step in steps:
        write_step(bus, axis, description, step)
    now = {name for step in steps for name in step.write}
    later = sorted(description.watchdog_signals - now)  # written by `enable`
    for name in later:
        _read(bus, axis, description, name)
    time_s = axis.image.values[watchdog.signal] * description.units()[watchdog.signal].scale
    if unread := sorted(description.watchdog_signals - axis.read_back):
        what = f"{' and '.join(unread)} {'is' if len(unread) == 1 else 'are'}"
        return (
            f"{time_s * 1e3:g} ms without a command are to end the drive's torque, but {what} written, not read back: "
            "it is not known that the drive watches the daemon"
        )
    also = f"; {' and '.join(later)} when it is enabled" if later else ""
    return f"the drive watches the daemon: {time_s * 1e3:g} ms without a command end its torque (read back{also})"


def _write(bus: SerialBus, axis: SerialAxis, exchange: Exchange) -> str:
    """Write once; return what came that is no reply, "" if nothing did.

    Raises `DriveError`: the drive refuses, or does not answer.
    """
    scheduler = bus.scheduler
    refusals, scheduler.last_error = scheduler.refusals.count, ""
    bus.transact(axis.name, exchange)
    if exchange.is_acknowledged:
        return ""
    read_state(bus, axis)  # what the drive has to say about the request comes before the reply to the next one
    if scheduler.refusals.count > refusals:
        text = f"{axis.name}: the drive refuses its set-up: {scheduler.last_error}"
        raise DriveError(text, code=codes.SETUP_REFUSED)
    return scheduler.last_error


def _await_state(bus: SerialBus, axis: SerialAxis, step: Step) -> None:
    end = time.monotonic() + step.timeout_s
    while step.until is not None:
        read_state(bus, axis)
        state = axis.read_state()
        if state.name.lower() == step.until:
            return
        if time.monotonic() > end:
            text = (
                f"{axis.name}: {dict(step.write)} should lead to {step.until} within {step.timeout_s:g} s; "
                f"the drive is in {state.name.lower()}"
            )
            raise DriveError(text, code=codes.SETUP_WITHOUT_EFFECT)


def _read_back(bus: SerialBus, axis: SerialAxis, description: Description, step: Step) -> None:
    """Read the written signals of the watchdog, and compare them with what was written."""
    for name in sorted(description.watchdog_signals & step.write.keys()):
        if not _read(bus, axis, description, name):
            axis.image.values.update(step.write)
        elif text := contradiction(description, step.write, axis.image.values, (name,)):
            fix = "give a watchdog_s that the drive can hold, or correct its description"
            raise DriveError(f"{axis.name}: the drive does not hold its watchdog: {text}", fix, codes.WATCHDOG_NOT_HELD)


def _read(bus: SerialBus, axis: SerialAxis, description: Description, name: str) -> bool:
    """Read a signal; return False, and note it in the axis, if the drive does not let it be read."""
    axis.read_back -= {name}
    if not description.can_be_read(name):
        return False
    try:
        bus.transact(axis.name, bus.read_exchange(axis.name, name))
    except DriveError:  # some registers can only be written
        return False
    axis.read_back |= {name}
    return True
