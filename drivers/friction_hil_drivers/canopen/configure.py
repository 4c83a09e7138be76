"""From a drive that was just switched on to one that is ready for the cyclic phase."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from friction_hil.drive import AxisFacts, DriveState, Mode
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import objects
from friction_hil_drivers.canopen.eds import load_eds
from friction_hil_drivers.canopen.mapping import COMMANDS, FEEDBACK, MappedPdo, map_pdo, switch_off
from friction_hil_drivers.canopen.objects import Object
from friction_hil_drivers.canopen.options import CanopenOptions
from friction_hil_drivers.canopen.sdo import ObjectAccess
from friction_hil_drivers.canopen.units import CanopenUnits
from friction_hil_drivers.cia402 import profile

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig

_ACTUATION_DELAY_CYCLES = 1.5  # sampled at one SYNC, in force from the next, for one period: by its middle
_SETPOINT_DELAY_CYCLES = {Mode.CSP: 2.5, Mode.CSV: 2.0, Mode.CST: 1.5}
_STAY_IN_QUICK_STOP = 6
_TO_FAULT = 1
_HEARTBEATS_TO_LOSS = 3
_RPDO_PERIODS_TO_LOSS = 20


@dataclass(frozen=True, slots=True)
class ConfiguredDrive:
    """What the cyclic phase needs to know of a drive."""

    facts: AxisFacts
    units: CanopenUnits
    mode: Mode
    tpdos: tuple[MappedPdo, ...]
    rpdo: MappedPdo | None  # None: the drive is only listened to
    error: str  # why the drive is in fault, if it is


def configure(
    access: ObjectAccess, name: str, axis: "AxisConfig", period_s: float, *, dry_run: bool
) -> ConfiguredDrive:
    """Check a drive's identity and abilities, read its units, map its PDOs and arm its watchdogs.

    A dry run reads, and sets up TPDOs; nothing else is written.

    Raises
    ------
    DriveError
        Something is missing or not as configured; nothing has been enabled then.
    """
    options = axis.options
    assert isinstance(options, CanopenOptions)
    mode = Mode[axis.mode.upper()]
    identity = _identify(access, options)
    notes: list[str] = []
    _check_mode(access, mode, notes)
    if options.eds is not None:
        _check_eds(options, access, (*FEEDBACK[0], *FEEDBACK[1], *COMMANDS[mode]))
    units = read_units(access, options, axis.model.axis)
    state = profile.drive_state(access.read(objects.STATUSWORD))
    if state.is_powered and not dry_run:
        raise DriveError(
            f"{name}: {access.where} is in state {state.words} already: "
            "another master is driving it, or a former one left it enabled; disable it first"
        )
    rpdo = None
    if not dry_run:
        _prepare(access, mode, period_s)
        timer_ms = max(20, math.ceil(_RPDO_PERIODS_TO_LOSS * period_s * 1e3))
        rpdo = map_pdo(access, is_receive=True, number=0, node=options.node, entries=COMMANDS[mode], event_ms=timer_ms)
        for number in range(1, objects.PDO_COUNT):
            switch_off(access, is_receive=True, number=number, node=options.node)
        notes += _arm_watchdogs(access, options, timer_ms)
    tpdos = tuple(
        map_pdo(access, is_receive=False, number=number, node=options.node, entries=entries)
        for number, entries in enumerate(FEEDBACK)
    )
    if not dry_run:
        for number in range(len(FEEDBACK), objects.PDO_COUNT):
            switch_off(access, is_receive=False, number=number, node=options.node)
    delay = options.setpoint_delay_cycles
    facts = AxisFacts(
        name=name,
        identity=identity,
        position_resolution=1.0 / abs(units.counts_per_unit),
        torque_resolution=abs(units.rated_torque) / 1000.0,
        setpoint_delay_s=(_SETPOINT_DELAY_CYCLES[mode] if delay is None else delay) * period_s,
        actuation_delay_s=_ACTUATION_DELAY_CYCLES * period_s,
        notes=tuple(notes),
    )
    code = access.find(objects.ERROR_CODE) if state is DriveState.FAULT else None
    return ConfiguredDrive(facts, units, mode, tpdos, rpdo, profile.error_text(code) if code else "")


def _identify(access: ObjectAccess, options: CanopenOptions) -> str:
    """Read 1018h and compare it with what the configuration demands."""
    vendor = access.read(objects.VENDOR_ID)
    product = access.find(objects.PRODUCT_CODE) or 0
    serial = access.find(objects.SERIAL_NUMBER)
    for entry, found, wanted in (
        (objects.VENDOR_ID, vendor, options.identity.vendor_id),
        (objects.PRODUCT_CODE, product, options.identity.product_code),
    ):
        if wanted is not None and wanted != found:
            raise DriveError(
                f"{access.axis}: {access.where} says {entry} = {found:#x}, but the configuration's identity "
                f"demands {wanted:#x}"
            )
    text = f"vendor {vendor:#x}, product {product:#x}"
    return text if serial is None else f"{text}, serial number {serial}"


def _check_eds(options: CanopenOptions, access: ObjectAccess, entries: Sequence[Object]) -> None:
    """Compare the widths that the drive's EDS promises with those that the drive has."""
    assert options.eds is not None
    dictionary = load_eds(options.eds, options.node)
    for entry in entries:
        found = access.width(entry)
        try:
            variable = dictionary.get_variable(entry.index, entry.subindex)
        except KeyError:
            variable = None
        if variable is None:
            raise DriveError(f"{access.axis}: {options.eds} has no object {entry}, which is needed")
        if found is not None and len(variable) != found:
            raise DriveError(
                f"{access.axis}: {entry} has {found} bits in {access.where} but {len(variable)} in {options.eds}: "
                "this EDS is not this drive's"
            )


def _check_mode(access: ObjectAccess, mode: Mode, notes: list[str]) -> None:
    bits = access.find(objects.SUPPORTED_MODES)
    if bits is None:
        notes.append(f"the drive has no {objects.SUPPORTED_MODES}; whether it can {mode.name} shows when it is set")
        return
    modes = profile.supported_modes(bits)
    if mode not in modes:
        able = ", ".join(m.name.lower() for m in modes) or "none of csp, csv, cst"
        raise DriveError(f"{access.axis}: {access.where} does not support mode {mode.name.lower()}; it supports {able}")


def read_units(access: ObjectAccess, options: CanopenOptions, kind: str) -> CanopenUnits:
    """Scales of a drive: as the options give them, else as the drive tells them.

    Raises
    ------
    DriveError
        Neither does, or the unit is not known here.
    """
    counts = options.counts_per_unit
    if counts is None:
        increments = access.find(objects.ENCODER_INCREMENTS)
        if not increments:
            raise DriveError(
                f"{access.axis}: {access.where} does not tell its encoder resolution "
                f"({objects.ENCODER_INCREMENTS}): give counts_per_unit (counts per rad)"
            )
        revolutions = access.find(objects.MOTOR_REVOLUTIONS) or 1
        counts = increments / revolutions / (2.0 * math.pi)
    rated = options.rated_torque
    if rated is None:
        millis = access.find(objects.RATED_TORQUE)
        if not millis:
            raise DriveError(
                f"{access.axis}: {access.where} does not tell its rated torque ({objects.RATED_TORQUE}): "
                "give rated_torque in N m (rated current times torque constant)"
            )
        rated = millis / 1000.0
    sign = -1.0 if options.is_inverted else 1.0
    velocity = counts
    unit = access.find(objects.VELOCITY_UNIT)
    if unit == objects.REVOLUTIONS_PER_MINUTE:
        if kind == "linear":
            raise DriveError(f"{access.axis}: {access.where} reports velocity in 1/min; a linear axis needs counts/s")
        velocity = 60.0 / (2.0 * math.pi)
    elif unit not in (None, 0, objects.COUNTS_PER_SECOND):
        raise DriveError(
            f"{access.axis}: {access.where} reports velocity in a unit that is not known here "
            f"({objects.VELOCITY_UNIT} = {unit:08X}h; counts/s is 00B50300h, 1/min is 00B44700h)"
        )
    return CanopenUnits(sign * counts, sign * velocity, sign * rated)


def _prepare(access: ObjectAccess, mode: Mode, period_s: float) -> None:
    """Zero torque, hold the present position, set mode and interpolation period."""
    access.write(objects.CONTROLWORD, profile.DISABLE_VOLTAGE)
    if access.find(objects.INTERPOLATION_PERIOD) is not None:
        value, exponent = _interpolation_period(access.axis, period_s)
        access.write(objects.INTERPOLATION_EXPONENT, exponent)
        access.write(objects.INTERPOLATION_PERIOD, value)
    for entry in (objects.TARGET_TORQUE, objects.TORQUE_OFFSET, objects.TARGET_VELOCITY):
        bits = access.width(entry)
        if bits is not None:
            access.write(entry, 0, bits)
    if mode is Mode.CSP:
        access.write(objects.TARGET_POSITION, access.read(objects.POSITION_ACTUAL))
    access.write(objects.MODE, mode)
    # holding torque until the loop has seen standstill, where the drive offers that
    access.try_write(objects.QUICK_STOP_OPTION, _STAY_IN_QUICK_STOP)


def _interpolation_period(axis: str, period_s: float) -> tuple[int, int]:
    """Value and exponent of 60C2h: value times 10^exponent seconds."""
    for exponent in (-3, -4, -5, -6):
        value = period_s * 10.0**-exponent
        if 1.0 <= round(value) <= 255.0 and abs(value - round(value)) < 1e-6:
            return round(value), exponent
    raise DriveError(
        f"{axis}: a period of {period_s:g} s cannot be told to a drive ({objects.INTERPOLATION_PERIOD} is 1 to 255 "
        "times a power of ten)"
    )


def _arm_watchdogs(access: ObjectAccess, options: CanopenOptions, timer_ms: int) -> list[str]:
    """Let the drive watch the daemon; say what is armed.

    Raises
    ------
    DriveError
        The drive can do neither, and the configuration does not accept that.
    """
    loss_ms = round(_HEARTBEATS_TO_LOSS * options.heartbeat_s * 1e3)
    heartbeat = access.try_write(objects.CONSUMER_HEARTBEAT, options.master_node << 16 | loss_ms)
    reaction = access.try_write(objects.ABORT_CONNECTION_OPTION, _TO_FAULT)
    timer = access.find(
        objects.Object(
            objects.RPDO_PARAMETER,
            "event timer of RPDO 1",
            objects.DataType.UNSIGNED16,
            objects.PDO_EVENT_TIMER,
        )
    )
    access.try_write(objects.PRODUCER_HEARTBEAT, round(options.heartbeat_s * 1e3))
    armed = []
    if heartbeat and reaction:
        armed.append(f"heartbeat consumer {loss_ms} ms")
    if timer == timer_ms and reaction:
        armed.append(f"RPDO timer {timer_ms} ms")
    if armed:
        return [f"the drive watches the daemon: {', '.join(armed)}"]
    if options.is_watchdog_required:
        raise DriveError(
            f"{access.axis}: {access.where} cannot watch the daemon (no heartbeat consumer 1016h or RPDO timer with "
            "6007h): if the daemon dies, its torque stays. Set is_watchdog_required: false to accept that"
        )
    return ["the drive does NOT watch the daemon: if the daemon dies, its last torque stays"]
