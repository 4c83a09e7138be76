"""Leaving a drive: without power, and as it was found."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from friction_hil.drive import DriveState
from friction_hil.drive.codes import coded
from friction_hil.errors import BusError, DriveError
from friction_hil_drivers.canopen import codes, objects
from friction_hil_drivers.cia402 import profile

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.sdo import SdoClient

PATIENCE_S = 0.5  # for a drive that may be gone: the others wait meanwhile
_POWER_OFF_S = 0.5
_POLL_S = 0.01


def disable(client: "SdoClient", now: Callable[[], float] = time.monotonic) -> DriveState:
    """Write controlword 0 and return the state that the drive reports then, UNKNOWN where it does not answer."""
    try:
        with client.patience(PATIENCE_S):
            client.write(objects.CONTROLWORD, profile.DISABLE_VOLTAGE)
            return _settled_state(client, now)
    except (DriveError, BusError):
        return DriveState.UNKNOWN


def _settled_state(client: "SdoClient", now: Callable[[], float]) -> DriveState:
    """Return the state of a drive that was told to disable, once it has done so or too long has passed."""
    end = now() + _POWER_OFF_S
    while (state := profile.drive_state(client.read(objects.STATUSWORD))).is_powered and now() < end:
        time.sleep(_POLL_S)
    return state


def read_state(client: "SdoClient") -> DriveState:
    """Return the state that a drive reports, UNKNOWN where it does not answer."""
    try:
        with client.patience(PATIENCE_S):
            return profile.drive_state(client.read(objects.STATUSWORD))
    except (DriveError, BusError):
        return DriveState.UNKNOWN


def has_no_power(state: DriveState) -> bool:
    """Return True for a state that is known, and in which the drive gives no torque."""
    return state is not DriveState.UNKNOWN and not state.is_powered


def restore(client: "SdoClient") -> list[str]:
    """Write back what a drive held before; return what could not be restored, in messages.

    A drive that has power, or whose state is not known, is left as it is: its watchdogs among others must not be
    switched off.
    """
    journal = client.journal
    if not journal or not journal.what_is_left():
        return []
    try:
        state = read_state(client)
        if has_no_power(state):
            return [_message(client, text) for text in journal.restore()]
        reason = "the drive does not answer" if state is DriveState.UNKNOWN else f"its state is {state.words}"
    except (DriveError, BusError) as error:
        reason = error.detail.removeprefix(f"{client.axis}: ")
    return [_message(client, f"{', '.join(journal.what_is_left())}: {reason}")]


def _message(client: "SdoClient", text: str) -> str:
    return coded(f"{client.axis}: not restored in {client.where}: {text}", codes.NOT_RESTORED)
