"""Configuration of a drive that was just switched on, until it is ready for the cyclic phase."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from friction_hil.drive import AxisFacts, DriveState, Mode
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes, objects
from friction_hil_drivers.canopen.eds import load_eds
from friction_hil_drivers.canopen.mapping import COMMANDS, FEEDBACK, MappedPdo, PdoRecord, map_pdo, switch_off
from friction_hil_drivers.canopen.monitor import HEARTBEATS_TO_LOSS
from friction_hil_drivers.canopen.objects import Object
from friction_hil_drivers.canopen.options import CanopenOptions, canopen_options
from friction_hil_drivers.canopen.scales import read_scales, require_agreement
from friction_hil_drivers.canopen.unit_table import resolution_notes, unit_rows
from friction_hil_drivers.canopen.units import PER_MILLE, CanopenUnits
from friction_hil_drivers.cia402 import profile

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig
    from friction_hil_drivers.canopen.sdo import SdoClient

_ACTUATION_DELAY_CYCLES = 1.5  # sampled at one SYNC, in force from the next, for one period: by its middle
_SETPOINT_DELAY_CYCLES = {Mode.CSP: 2.5, Mode.CSV: 2.0, Mode.CST: 1.5}
_STAY_IN_QUICK_STOP = 6  # 605Ah
_TO_FAULT = 1  # 6007h
_RPDO_PERIODS_TO_LOSS = 20
_SHORTEST_RPDO_TIMER_MS = 20


@dataclass(frozen=True, slots=True)
class ConfiguredDrive:
    """Result of the configuration, as the cyclic phase needs it."""

    facts: AxisFacts
    units: CanopenUnits
    mode: Mode
    tpdos: tuple[MappedPdo, ...]
    rpdos: tuple[MappedPdo, ...]  # empty: the drive is only listened to
    error: str  # why the drive is in fault; empty where it is not
    period_s: float


def configure(access: "SdoClient", name: str, axis: "AxisConfig", period_s: float, *, dry_run: bool) -> ConfiguredDrive:
    """Check a drive's identity and modes, read its units, map its PDOs and set its watchdogs.

    A dry run reads, and sets up TPDOs; nothing else is written.

    Raises
    ------
    DriveError
        Something is missing or not as configured; nothing has been enabled then.
    """
    options = canopen_options(axis)
    mode = Mode[axis.mode.upper()]
    identity = _identify(access, options)
    notes = _check_mode(access, mode)
    if options.eds is not None:
        _check_eds(options, access, (*FEEDBACK[0], *FEEDBACK[1], *COMMANDS[mode]))
    scales = read_scales(access, options, axis.model.axis)
    require_agreement(access, options, scales)
    units = scales.units(is_inverted=options.is_inverted)
    notes += resolution_notes(scales, axis)
    state = profile.drive_state(access.read(objects.STATUSWORD))
    rpdos: tuple[MappedPdo, ...] = ()
    if not dry_run:
        _require_unpowered(access, state)
        rpdos, watchdogs = _set_up_commands(access, options, mode, period_s)
        notes += watchdogs
    tpdos = _set_up_feedback(access, options.node, dry_run=dry_run)
    delay_cycles = options.setpoint_delay_cycles
    facts = AxisFacts(
        name=name,
        identity=identity,
        position_resolution=1.0 / abs(units.counts_per_unit),
        torque_resolution=abs(units.rated_torque) / PER_MILLE,
        setpoint_delay_s=(_SETPOINT_DELAY_CYCLES[mode] if delay_cycles is None else delay_cycles) * period_s,
        actuation_delay_s=_ACTUATION_DELAY_CYCLES * period_s,
        notes=tuple(notes),
        velocity_resolution=1.0 / abs(units.velocity_per_unit),
        units=unit_rows(scales, axis.limits, mode, axis.model.axis),
    )
    code = access.find(objects.ERROR_CODE) if state is DriveState.FAULT else None
    return ConfiguredDrive(facts, units, mode, tpdos, rpdos, profile.error_text(code) if code else "", period_s)


def _identify(access: "SdoClient", options: CanopenOptions) -> str:
    """Read 1018h and compare it with the identity in the configuration."""
    vendor = access.read(objects.VENDOR_ID)
    product = access.find(objects.PRODUCT_CODE) or 0
    serial = access.find(objects.SERIAL_NUMBER)
    for entry, found, wanted in (
        (objects.VENDOR_ID, vendor, options.identity.vendor_id),
        (objects.PRODUCT_CODE, product, options.identity.product_code),
    ):
        if wanted is not None and wanted != found:
            text = (
                f"{access.axis}: {access.where} says {entry} = {found:#x}, but the configuration's identity "
                f"demands {wanted:#x}"
            )
            raise DriveError(text, code=codes.WRONG_IDENTITY)
    text = f"vendor {vendor:#x}, product {product:#x}"
    return text if serial is None else f"{text}, serial number {serial}"


def _check_mode(access: "SdoClient", mode: Mode) -> list[str]:
    """Refuse a mode that the drive does not support; return a note where the drive does not report its modes."""
    bits = access.find(objects.SUPPORTED_MODES)
    if bits is None:
        return [
            f"the drive has no {objects.SUPPORTED_MODES}: a mode {mode.name} that it lacks shows when it is enabled"
        ]
    modes = profile.supported_modes(bits)
    if mode not in modes:
        supported = ", ".join(m.name.lower() for m in modes) or "none of csp, csv, cst"
        text = f"{access.axis}: {access.where} does not support mode {mode.name.lower()}; it supports {supported}"
        raise DriveError(text, code=codes.MODE_NOT_SUPPORTED)
    return []


def _check_eds(options: CanopenOptions, access: "SdoClient", entries: Sequence[Object]) -> None:
    """Compare the widths in the EDS with those that the drive has."""
    assert options.eds is not None
    dictionary = load_eds(options.eds, options.node)
    for entry in entries:
        found = access.width(entry)
        try:
            variable = dictionary.get_variable(entry.index, entry.subindex)
        except KeyError:
            variable = None
        if variable is None:
            text = f"{access.axis}: {options.eds} has no object {entry}, which is needed"
            raise DriveError(text, code=codes.WRONG_EDS)
        if found is not None and len(variable) != found:
            text = (
                f"{access.axis}: {entry} has {found} bits in {access.where} but {len(variable)} in {options.eds}: "
                "this EDS is not this drive's"
            )
            raise DriveError(text, code=codes.WRONG_EDS)


def _require_unpowered(access: "SdoClient", state: DriveState) -> None:
    if state.is_powered:
        text = (
            f"{access.axis}: {access.where} is in state {state.words} already: "
            "another master is driving it, or a former one left it enabled; disable it first"
        )
        raise DriveError(text, code=codes.ALREADY_POWERED)


def _set_up_commands(
    access: "SdoClient", options: CanopenOptions, mode: Mode, period_s: float
) -> tuple[tuple[MappedPdo, ...], list[str]]:
    """Prepare the mode, map RPDO 1, switch the others off, set the watchdogs; return the PDO and notes."""
    _prepare_mode(access, mode, period_s)
    records = [PdoRecord(True, number, options.node) for number in range(objects.PDO_COUNT)]
    timer_ms = max(_SHORTEST_RPDO_TIMER_MS, math.ceil(_RPDO_PERIODS_TO_LOSS * period_s * 1e3))
    rpdo = map_pdo(access, records[0], COMMANDS[mode], timer_ms)
    for record in records[1:]:
        switch_off(access, record)
    return (rpdo,), _set_watchdogs(access, options, records[0].event_timer, timer_ms)


def _set_up_feedback(access: "SdoClient", node: int, *, dry_run: bool) -> tuple[MappedPdo, ...]:
    """Map the TPDOs of the feedback and, unless it is a dry run, switch the others off."""
    records = [PdoRecord(False, number, node) for number in range(objects.PDO_COUNT)]
    tpdos = tuple(map_pdo(access, record, entries) for record, entries in zip(records, FEEDBACK, strict=False))
    if not dry_run:
        for record in records[len(FEEDBACK) :]:
            switch_off(access, record)
    return tpdos


def _prepare_mode(access: "SdoClient", mode: Mode, period_s: float) -> None:
    """Set zero torque, the present position as target, the mode and the interpolation period."""
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
    # where the drive can: it holds its position after a quick stop, until the loop has seen standstill
    access.try_write(objects.QUICK_STOP_OPTION, _STAY_IN_QUICK_STOP)


def _interpolation_period(axis: str, period_s: float) -> tuple[int, int]:
    """Return value and exponent of 60C2h: value times 10^exponent seconds."""
    for exponent in (-3, -4, -5, -6):
        value = period_s * 10.0**-exponent
        if 1.0 <= round(value) <= 255.0 and abs(value - round(value)) < 1e-6:
            return round(value), exponent
    text = (
        f"{axis}: a drive cannot be given a period of {period_s:g} s ({objects.INTERPOLATION_PERIOD} is 1 to 255 "
        "times a power of ten)"
    )
    raise DriveError(text, code=codes.PERIOD_NOT_EXPRESSIBLE)


def _set_watchdogs(access: "SdoClient", options: CanopenOptions, rpdo_timer: Object, timer_ms: int) -> list[str]:
    """Let the drive watch the daemon; return a note that says by what.

    Raises
    ------
    DriveError
        The drive has neither watchdog, and the configuration does not accept that.
    """
    loss_ms = round(HEARTBEATS_TO_LOSS * options.heartbeat_s * 1e3)
    has_heartbeat = access.try_write(objects.CONSUMER_HEARTBEAT, options.master_node << 16 | loss_ms)
    has_reaction = access.try_write(objects.ABORT_CONNECTION_OPTION, _TO_FAULT)
    has_timer = access.find(rpdo_timer) == timer_ms
    access.try_write(objects.PRODUCER_HEARTBEAT, round(options.heartbeat_s * 1e3))
    watchdogs = []
    if has_heartbeat and has_reaction:
        watchdogs.append(f"heartbeat consumer {loss_ms} ms")
    if has_timer and has_reaction:
        watchdogs.append(f"RPDO timer {timer_ms} ms")
    if watchdogs:
        return [f"the drive watches the daemon: {', '.join(watchdogs)}"]
    if options.is_watchdog_required:
        text = (
            f"{access.axis}: {access.where} cannot watch the daemon (no heartbeat consumer 1016h or RPDO timer with "
            "6007h): if the daemon dies, its torque stays. Set is_watchdog_required: false to accept that"
        )
        raise DriveError(text, code=codes.NO_WATCHDOG)
    return ["the drive does NOT watch the daemon: if the daemon dies, its last torque stays"]
