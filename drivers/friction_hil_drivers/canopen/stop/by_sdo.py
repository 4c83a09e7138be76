"""Stopping drives by SDO, as `friction_hil.drive.stop` says: it works in Pre-operational too, and needs no RPDO.

One step a cycle in a run (`SdoStop`), or as a script that waits for each answer: for a drive that was left enabled, one
whose fault is reset, and drives at rest at the end of a run. Set-points that would act once somebody enables the drive
are set to zero. Nothing here can enable a drive.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

from friction_hil.drive import DriveState
from friction_hil.drive.codes import coded
from friction_hil.drive.inventory import Stop, result_of
from friction_hil.drive.stop import DriveStop, StopState
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.sdo.conversation import Pause, Script
from friction_hil_drivers.canopen.sdo.dialogue import Download, Transfer, Upload
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.access import ABSENT
from friction_hil_drivers.cia402.units import COUNTER_BITS

_POLL_S = 0.02
_FAULT_POLLS = 50  # 1 s, for the end of a reaction to a fault, and of the fault
_RELAPSE_S = 0.3  # in which a master that commands the drive still would have enabled it again
STANDSTILL_COUNTS = 2.0  # noise of an encoder
_AXES = 8  # of a multi-axis node (CiA 402-3: the objects of axis k are those of axis 0 plus k * 800h)


def stop_drive(node: int) -> "Script[list[Stop]]":
    """Stop every axis of a node; return what was read back of each."""
    stops: list[Stop] = []
    for axis in range(_AXES):
        status = Upload(objects.STATUSWORD.of_axis(axis))
        yield status
        if axis and status.value is None:
            break
        stop = yield from _stop_axis(node, axis, status)
        stops.append(replace(stop, detail=f"axis {axis + 1}: {stop.detail}".rstrip(": ")) if axis else stop)
        if status.is_silent or status.value is None:
            break
    return stops


def stop_axes(node: int, axes: Sequence[int]) -> "Script[list[Stop]]":
    """Stop some axes of a node; return what was read back of each."""
    stops: list[Stop] = []
    for axis in axes:
        status = Upload(objects.STATUSWORD.of_axis(axis))
        yield status
        stops.append((yield from _stop_axis(node, axis, status)))
    return stops


def reset_axes(node: int, axes: Sequence[int]) -> "Script[list[Stop]]":
    """Reset the faults of some axes of a node, and leave them without power; return what was read back of each."""
    stops: list[Stop] = []
    for axis in axes:
        stop = yield from _reset_axis(node, axis)
        stops.append(stop)
    return stops


def disable_axes(axes: Sequence[int]) -> "Script[dict[int, DriveState]]":
    """Disable some axes of a node that are at rest; return the state of each as read back, UNKNOWN where it was not."""
    states = {}
    for axis in axes:
        states[axis], _ = yield from _carry_out(axis, StopState.DISABLE)
    return states


class SdoStop(DriveStop):
    """Stop by SDO: the steps as transfers."""

    __slots__ = ()

    def __init__(self, standstill: float = STANDSTILL_COUNTS) -> None:
        super().__init__(standstill, counter_range=2.0**COUNTER_BITS)

    def request(self, now_ns: int) -> Transfer | None:
        """Return the transfer that is due, None for none."""
        step = self.step(now_ns)
        if step is None:
            return None
        if step.reads_state:
            return Upload(objects.STATUSWORD)
        if step is StopState.STANDSTILL:
            return Upload(objects.POSITION_ACTUAL)
        return Download(objects.CONTROLWORD, self.word)

    @property
    def word(self) -> int:
        """Controlword of the command that is due."""
        return profile.QUICK_STOP if self.at is StopState.QUICK_STOP else profile.DISABLE_VOLTAGE

    def take(self, transfer: Transfer, now_ns: int) -> None:
        """Take the transfer that was due, once it is over."""
        if transfer.is_silent:
            self.take_silence()
        elif self.at.reads_state:
            self.take_state(_state(transfer), now_ns)
        elif self.at is StopState.STANDSTILL:
            self.take_position(transfer.value, now_ns)
        else:
            self.take_command(now_ns)


def _carry_out(axis: int, at: StopState = StopState.QUICK_STOP) -> "Script[tuple[DriveState, str]]":
    """Stop an axis; return its state as read back last, and why a command was not taken, "" if all were."""
    stop, refused = SdoStop(), ""
    stop.begin(time.monotonic_ns(), at)
    while not stop.is_over(time.monotonic_ns()):
        transfer = stop.request(time.monotonic_ns())
        if transfer is not None:
            transfer.entry = transfer.entry.of_axis(axis)
            yield transfer
            if isinstance(transfer, Download):
                refused = _failure(transfer, f"controlword {stop.word:04X}h") or refused
            stop.take(transfer, time.monotonic_ns())
        if not isinstance(transfer, Download):
            yield Pause(_POLL_S)
    if stop.state is DriveState.UNKNOWN:  # of a drive that takes no command either
        return (yield from _read_state(axis)), refused
    return stop.state, refused


def _stop_axis(node: int, axis: int, status: Upload) -> "Script[Stop]":
    before = _state(status)
    if status.is_silent:
        # a drive that does not answer may still receive: the commands are sent anyway
        yield from _command(axis, profile.QUICK_STOP)
        yield from _command(axis, profile.DISABLE_VOLTAGE)
        return _no_drive(node, status)
    if status.value is None:
        return _no_drive(node, status)
    if before.is_unpowered:
        return Stop(node, before, before, "unpowered", leftover=(yield from _clear(axis)))
    after, refused = yield from _carry_out(axis)
    if after.is_unpowered:
        yield Pause(_RELAPSE_S)
        after = yield from _read_state(axis)
    result = result_of(after, "stopped")
    return Stop(node, before, after, result, _reason(result, refused), leftover=(yield from _clear(axis)))


def _reset_axis(node: int, axis: int) -> "Script[Stop]":
    status = Upload(objects.STATUSWORD.of_axis(axis))
    yield status
    if status.value is None:
        return _no_drive(node, status)
    before = _state(status)
    for _ in range(_FAULT_POLLS):  # it ends in a fault by itself
        if before is not DriveState.FAULT_REACTION_ACTIVE:
            break
        yield Pause(_POLL_S)
        before = yield from _read_state(axis)
    if before is not DriveState.FAULT:
        result = result_of(before, "unpowered")
        detail = {"powered": "it has no fault", "unknown": "its statusword shows no state"}.get(result, "")
        return Stop(node, before, before, result, detail, leftover=(yield from _clear_if_off(axis, before)))
    fault = yield from _fault(axis)
    refused = yield from _command(axis, profile.DISABLE_VOLTAGE)  # the drive needs a rising edge
    refused = (yield from _command(axis, profile.FAULT_RESET)) or refused
    after = yield from _read_state(axis)
    for _ in range(_FAULT_POLLS):
        if after is not DriveState.FAULT:
            break
        yield Pause(_POLL_S)
        after = yield from _read_state(axis)
    refused = (yield from _command(axis, profile.DISABLE_VOLTAGE)) or refused
    yield Pause(_RELAPSE_S)
    after = yield from _read_state(axis)
    left = yield from _clear_if_off(axis, after)
    if after is DriveState.FAULT:
        now = yield from _fault(axis)
        return Stop(
            node, before, after, "fault", refused or f"after the reset it reports {now}", fault=fault, leftover=left
        )
    result = result_of(after, "reset")
    return Stop(node, before, after, result, _reason(result, refused), fault=fault, leftover=left)


def _no_drive(node: int, status: Upload) -> Stop:
    """Return the result for what answers no SDO request, or has no statusword."""
    why = "it answers no SDO request" if status.is_silent else "it has no statusword 6041h: not a drive"
    return Stop(node, DriveState.UNKNOWN, DriveState.UNKNOWN, "unknown", why)


def _fault(axis: int) -> "Script[str]":
    """Return the drive's error code in words."""
    code = Upload(objects.ERROR_CODE.of_axis(axis))
    yield code
    return "a fault without an error code (603Fh)" if not code.value else profile.error_text(code.value)


def _reason(result: str, refused: str) -> str:
    if result in ("stopped", "reset", "unpowered"):
        return ""
    if refused:
        return refused
    if result == "powered":
        return "the controlword was accepted, but the drive has power: does another master command it?"
    return "the state could not be read back"


def _state(status: Transfer) -> DriveState:
    return DriveState.UNKNOWN if status.value is None else profile.drive_state(status.value)


def _command(axis: int, word: int) -> "Script[str]":
    """Write a controlword; return why it was not taken, "" if it was."""
    download = Download(objects.CONTROLWORD.of_axis(axis), word)
    yield download
    return _failure(download, f"controlword {word:04X}h")


def _clear_if_off(axis: int, state: DriveState) -> "Script[str]":
    """Set the acting set-points of a drive without power to zero, as `_clear` does; a moving axis keeps them."""
    return (yield from _clear(axis)) if state.is_unpowered else ""


def _clear(axis: int) -> "Script[str]":
    """Set the acting set-points that the drive has to zero; return those of which that was not read back, in words."""
    left = []
    for entry in objects.ACTING_SETPOINTS:
        found = Upload(entry.of_axis(axis))
        yield found
        if found.value == 0 or found.abort_code in ABSENT:
            continue
        refused = ""
        if not found.is_silent:
            size = min(len(found.data or b"") or entry.type.bits // 8, 4)  # 60B2h has 32 bits in some drives
            download = Download(found.entry, 0, size)
            yield download
            refused = _failure(download, "writing 0")
            found = Upload(found.entry)
            yield found
        if found.value != 0:
            held = "cannot be read back" if found.value is None else f"stays {found.value}"
            left.append(f"{found.entry} {held}{f' ({refused})' if refused else ''}")
    return coded(", ".join(left), codes.NOT_RESTORED) if left else ""


def _failure(transfer: Transfer, what: str) -> str:
    if transfer.is_silent:
        return f"{what}: no answer"
    return f"{what}: refused, SDO abort {transfer.abort_code:08X}h" if transfer.abort_code else ""


def _read_state(axis: int) -> "Script[DriveState]":
    status = Upload(objects.STATUSWORD.of_axis(axis))
    yield status
    return _state(status)
