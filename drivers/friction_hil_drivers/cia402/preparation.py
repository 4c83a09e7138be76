"""Preparation of a drive before its first cycle: who it is, what it can do, its mode with harmless set-points."""

import math

from friction_hil.drive import DriveState, Mode
from friction_hil.errors import DriveError
from friction_hil_drivers.cia402 import codes, objects, profile
from friction_hil_drivers.cia402.access import RefusedError
from friction_hil_drivers.cia402.client import ObjectClient
from friction_hil_drivers.cia402.codec import FEEDBACK, command_entries
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.options import Identity

_STAY_IN_QUICK_STOP = 6  # 605Ah
# Feedback that a drive may lack, in the order in which it is done without, and what follows
OPTIONAL_FEEDBACK = {
    objects.MODE_DISPLAY: "that it takes the mode is not confirmed",
    objects.TORQUE_ACTUAL: "no torque is recorded, so nothing can be identified from it",
    objects.VELOCITY_ACTUAL: "the velocity is derived from the position, and has its resolution per period",
}


def identify(access: ObjectClient, expected: Identity) -> str:
    """Read 1018h and compare it with the identity in the configuration."""
    vendor = access.read(objects.VENDOR_ID)
    product = access.find(objects.PRODUCT_CODE) or 0
    serial = access.find(objects.SERIAL_NUMBER)
    for entry, found, wanted in (
        (objects.VENDOR_ID, vendor, expected.vendor_id),
        (objects.PRODUCT_CODE, product, expected.product_code),
    ):
        if wanted is not None and wanted != found:
            text = (
                f"{access.axis}: {access.where} says {entry} = {found:#x}, but the configuration's identity "
                f"demands {wanted:#x}"
            )
            raise DriveError(text, code=codes.WRONG_IDENTITY)
    text = f"vendor {vendor:#x}, product {product:#x}"
    return text if serial is None else f"{text}, serial number {serial}"


def check_mode(access: ObjectClient, mode: Mode, *, is_required: bool) -> list[str]:
    """Refuse a mode that the drive does not support; return a note where that is not known."""
    bits = access.find(objects.SUPPORTED_MODES)
    if bits is None:
        return [
            f"the drive has no {objects.SUPPORTED_MODES}: a mode {mode.name} that it lacks shows when it is enabled"
        ]
    if mode in profile.supported_modes(bits):
        return []
    names = ", ".join(profile.mode_names(bits)) or "no mode of the profile at all"
    text = f"does not support mode {mode.name.lower()}; it supports {names}"
    if not profile.supported_modes(bits):
        text = f"supports none of csp, csv, cst, one of which is needed for cyclic commands; it supports {names}"
    if is_required:
        raise DriveError(f"{access.axis}: {access.where} {text}", code=codes.MODE_NOT_SUPPORTED)
    return [f"the drive says that it {text} ({objects.SUPPORTED_MODES}); it is tried, as is_mode_check_required says"]


def feedback_objects(access: ObjectClient) -> tuple[list[Object], list[str]]:
    """Return the objects of the feedback that the drive has, and what it means that it lacks others."""
    notes = []
    entries = [entry for group in FEEDBACK for entry in group]
    for entry, consequence in OPTIONAL_FEEDBACK.items():
        if access.width(entry) is None:
            entries.remove(entry)
            notes.append(f"the drive has no {entry}: {consequence}")
    return entries, notes


def command_objects(
    access: ObjectClient,
    mode: Mode,
    *,
    is_compensated: bool,
    is_by_velocity: bool = False,
    is_by_position: bool = False,
) -> tuple[list[Object], list[str]]:
    """Return the objects of a command; raises a `DriveError` if there is no offset to compensate by."""
    entries = command_entries(mode, is_by_velocity=is_by_velocity)
    offset = objects.VELOCITY_OFFSET if is_by_velocity else objects.TORQUE_OFFSET
    if mode is Mode.CST or _has(access, offset):
        return entries, []
    if is_by_position:
        entries.remove(offset)
        return entries, []
    if is_compensated:
        others = "take mode cst, which compensates without it"
        if mode is Mode.CSP:
            others = f"give compensation.velocity_offset with position_gain, which needs no offset, {others}"
        if not is_by_velocity and _has(access, objects.VELOCITY_OFFSET):
            others = f"give compensation.velocity_offset, as it has {objects.VELOCITY_OFFSET}, {others}"
        text = (
            f"{access.axis}: {access.where} lacks object {offset}, by which mode {mode.name.lower()} is "
            f"compensated{' (compensation.velocity_offset)' if is_by_velocity else ''}: {others}, or let the axis run "
            "without compensation (compensation: {enabled: false})"
        )
        raise DriveError(text, code=codes.NO_TORQUE_OFFSET)
    entries.remove(offset)
    return entries, [f"the drive has no {offset}: it runs without compensation"]


def _has(access: ObjectClient, entry: Object) -> bool:
    return bool(access.width(entry) or access.hidden_width(entry))


def why_powered(state: DriveState) -> str:
    """Return why a drive in ``state`` must not be touched, as the verb of a sentence; "" for one without power."""
    if not state.is_powered:
        return ""
    return (
        f"is in state {state.words} already: another master is driving it, or a former one left it enabled; stop that "
        "master, or take the drive's power by friction-hil stop CONFIG"
    )


def require_unpowered(access: ObjectClient, state: DriveState) -> None:
    """Refuse a drive that has power already."""
    if reason := why_powered(state):
        raise DriveError(f"{access.axis}: {access.where} {reason}", code=codes.ALREADY_POWERED)


def prepare_mode(access: ObjectClient, mode: Mode, period_s: float) -> list[str]:
    """Set offsets to zero, the present position as target, the mode and the interpolation period; return notes."""
    access.write(objects.CONTROLWORD, profile.DISABLE_VOLTAGE)
    notes = _set_interpolation_period(access, mode, period_s)
    for entry in objects.ACTING_SETPOINTS:
        bits = access.width(entry) or access.hidden_width(entry)
        if bits is not None:
            access.ensure(entry, 0, bits)
    if mode is Mode.CSP:
        access.write(objects.TARGET_POSITION, access.read(objects.POSITION_ACTUAL))
    access.ensure(objects.MODE, mode)
    # where the drive can: it holds its position after a quick stop, until the loop has seen standstill
    access.try_write(objects.QUICK_STOP_OPTION, _STAY_IN_QUICK_STOP)
    return notes


def _set_interpolation_period(access: ObjectClient, mode: Mode, period_s: float) -> list[str]:
    """Set 60C2h, where the drive has it; return a note where it stays different, in csp raise a `DriveError`."""
    found = access.find(objects.INTERPOLATION_PERIOD)
    if found is None:
        return []
    value, exponent = _interpolation_period(access.axis, period_s)
    try:
        access.ensure(objects.INTERPOLATION_EXPONENT, exponent)
        access.ensure(objects.INTERPOLATION_PERIOD, value)
    except RefusedError as error:
        found = _with_present_exponent(access, period_s)
        power = access.find(objects.INTERPOLATION_EXPONENT)
        present_s = found * 10.0 ** (-3 if power is None else power)
        if math.isclose(present_s, period_s):
            return []
        text = f"{objects.INTERPOLATION_PERIOD} stays at {present_s:g} s and not {period_s:g} s: {error.detail}"
        if mode is Mode.CSP:
            fix = f"take period_s: {present_s:g}, or mode csv or cst" if present_s > 0.0 else "take mode csv or cst"
            raise DriveError(f"{access.axis}: {text}", fix, code=codes.PERIOD_NOT_EXPRESSIBLE) from error
        return [text]
    return []


def _with_present_exponent(access: ObjectClient, period_s: float) -> int:
    """Write the value of 60C2h that fits the exponent in it, if one does; return the value in it then."""
    power = access.find(objects.INTERPOLATION_EXPONENT)
    if value := _value_of_period(period_s, -3 if power is None else power):
        access.try_write(objects.INTERPOLATION_PERIOD, value)
    return access.read(objects.INTERPOLATION_PERIOD)


def _value_of_period(period_s: float, exponent: int) -> int:
    """Return the value that gives 60C2h a period with an exponent, 0 for none."""
    value = period_s * 10.0**-exponent
    return round(value) if 1.0 <= round(value) <= 255.0 and abs(value - round(value)) < 1e-6 else 0


def _interpolation_period(axis: str, period_s: float) -> tuple[int, int]:
    """Return value and exponent of 60C2h: value times 10^exponent seconds."""
    for exponent in (-3, -4, -5, -6):
        if value := _value_of_period(period_s, exponent):
            return value, exponent
    text = (
        f"{axis}: a drive cannot be given a period of {period_s:g} s ({objects.INTERPOLATION_PERIOD} is 1 to 255 "
        "times a power of ten)"
    )
    raise DriveError(text, code=codes.PERIOD_NOT_EXPRESSIBLE)
