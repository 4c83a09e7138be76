"""Configuration of a drive that was just switched on, until it is ready for the cyclic phase."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from friction_hil.drive import AxisFacts, DriveState, Mode
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.eds import EdsObjects, load_eds
from friction_hil_drivers.canopen.connect.mapping import MappedPdo, PdoRecord, switch_off
from friction_hil_drivers.canopen.connect.negotiation import Negotiated, PdoNegotiator, grouped
from friction_hil_drivers.canopen.connect.watchdog_times import WatchdogTimes
from friction_hil_drivers.canopen.connect.watchdogs import NOT_WATCHED, Watch, arm
from friction_hil_drivers.canopen.cycle import delays
from friction_hil_drivers.canopen.options import CanopenOptions, canopen_options
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects, preparation, profile
from friction_hil_drivers.cia402.load_encoder import LoadEncoderOptions, require_object, with_scale
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.scales import (
    polarity_notes,
    read_scales,
    require_agreement,
    require_velocity_unit,
    resolution_notes,
    unit_rows,
)
from friction_hil_drivers.cia402.temperature import TemperatureOptions, read_first
from friction_hil_drivers.cia402.units import PER_MILLE, DriveUnits

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig
    from friction_hil_drivers.canopen.sdo.client import SdoClient

_SYNC_BITS = 0x600007FF  # of 1005h: identifier, 29 bits, and that the drive itself sends SYNC; the others are its own


@dataclass(frozen=True, slots=True)
class ConfiguredDrive:
    """Result of the configuration, as the cyclic phase needs it."""

    facts: AxisFacts
    units: DriveUnits
    mode: Mode
    tpdos: tuple[MappedPdo, ...]
    rpdos: tuple[MappedPdo, ...]  # empty: the drive is only listened to
    error: str  # why the drive is in fault; empty where it is not
    period_s: float
    watch: Watch = NOT_WATCHED
    axis_number: int = 0  # in a node with several axes
    temperature: TemperatureOptions | None = None
    first_temperature: float = math.nan  # deg C
    load_encoder: LoadEncoderOptions | None = None


def configure(
    access: "SdoClient",
    name: str,
    axis: "AxisConfig",
    period_s: float,
    times: WatchdogTimes,
    *,
    dry_run: bool,
    taken: set[int] | None = None,
    before_writing: Callable[[], None] = lambda: None,
    sync_id: int = cia301.SYNC_ID,
) -> ConfiguredDrive:
    """Check a drive's identity and modes, read its units, map its PDOs and set its watchdogs.

    A dry run reads, and sets up TPDOs; nothing else is written.

    ``name``: name of the axis. ``period_s``: period of the cycle, s. ``taken``: identifiers that PDOs of other axes
    have; those of this axis are added. ``before_writing``: called when everything has been read and compared, before
    the first write. ``sync_id``: identifier of SYNC.

    Raises `DriveError`: something is missing or not as configured; nothing has been enabled then.
    """
    options = canopen_options(axis)
    mode = Mode[axis.mode.upper()]
    taken = set() if taken is None else taken
    identity = preparation.identify(access, options.identity)
    notes = preparation.check_mode(access, mode, is_required=options.is_mode_check_required)
    feedback, absent = preparation.feedback_objects(access)
    given, is_by_velocity = axis.compensation, axis.compensation.is_by_velocity
    commands, without = preparation.command_objects(
        access, mode, is_compensated=given.enabled, is_by_velocity=is_by_velocity, is_by_position=given.is_by_position
    )
    notes += absent + without
    load_encoder = options.load_encoder
    if load_encoder is not None:
        feedback.append(require_object(access, load_encoder))
        load_encoder, note = with_scale(access, load_encoder, axis.model.axis)
        notes.append(note)
    if options.eds is not None:
        _check_eds(options, access, (*feedback, *commands))
    scales = read_scales(access, options, axis.model.axis)
    require_agreement(access, options, scales)
    if mode is Mode.CSV or is_by_velocity:
        require_velocity_unit(access, options)
    units = scales.units(is_inverted=options.is_inverted, inverted_torque=options.inverted_torque)
    notes += resolution_notes(scales, axis)
    notes += polarity_notes(access.find(objects.POLARITY), options.inverted_torque)
    first = math.nan if options.temperature is None else read_first(access, options.temperature)
    state = profile.drive_state(access.read(objects.STATUSWORD))
    rpdos: tuple[MappedPdo, ...] = ()
    watch = NOT_WATCHED
    if not dry_run:
        preparation.require_unpowered(access, state)
    before_writing()
    if not access.is_read_only:
        notes += _set_sync_id(access, sync_id)
    if not dry_run:
        rpdos, watch, of_commands = _set_up_commands(access, options, mode, commands, period_s, times, taken)
        notes += of_commands
    tpdos, of_feedback = _set_up_feedback(access, options, feedback, taken, dry_run=dry_run)
    notes += of_feedback
    has_torque = any(objects.TORQUE_ACTUAL in pdo.entries for pdo in tpdos)
    facts = AxisFacts(
        name=name,
        identity=identity,
        position_resolution=1.0 / abs(units.counts_per_unit),
        torque_resolution=abs(units.rated_torque) / PER_MILLE,
        setpoint_delay_s=_setpoint_delay_cycles(options, mode, rpdos) * period_s,
        actuation_delay_s=_actuation_delay_cycles(rpdos) * period_s,
        notes=tuple(notes),
        torque_delay_s=0.0 if has_torque else None,
        velocity_resolution=1.0 / abs(units.velocity_per_unit),
        units=unit_rows(scales, axis.limits, mode, axis.model.axis)
        + (() if dry_run else (watch.row(times.max_missed),)),
        has_load_encoder=load_encoder is not None,
        takes_torque=not without,
        takes_velocity_offset=is_by_velocity and not without,
    )
    code = access.find(objects.ERROR_CODE) if state is DriveState.FAULT else None
    error = profile.error_text(code) if code else ""
    return ConfiguredDrive(
        facts,
        units,
        mode,
        tpdos,
        rpdos,
        error,
        period_s,
        watch,
        options.axis_number,
        options.temperature,
        first,
        load_encoder,
    )


def with_notes(drive: ConfiguredDrive, notes: Sequence[str]) -> ConfiguredDrive:
    """Return the drive with further notes for the user."""
    further = tuple(note for note in notes if note not in drive.facts.notes)
    return replace(drive, facts=replace(drive.facts, notes=drive.facts.notes + further))


def _actuation_delay_cycles(rpdos: Sequence[MappedPdo]) -> float:
    """Return the periods from a sample to the middle of the time for which the torque computed from it acts."""
    is_at_sync = all(pdo.is_synchronous for pdo in rpdos)
    return delays.ACTUATION_CYCLES if is_at_sync else delays.ACTUATION_ON_ARRIVAL_CYCLES


def _setpoint_delay_cycles(options: CanopenOptions, mode: Mode, rpdos: Sequence[MappedPdo]) -> float:
    if options.setpoint_delay_cycles is not None:
        return options.setpoint_delay_cycles
    earlier = delays.ACTUATION_CYCLES - _actuation_delay_cycles(rpdos)
    return delays.SETPOINT_CYCLES[mode] - earlier


def _check_eds(options: CanopenOptions, access: "SdoClient", entries: Sequence[Object]) -> None:
    """Compare the widths in the EDS with those that the drive has."""
    assert options.eds is not None
    file = EdsObjects(load_eds(options.eds, options.node), options.axis_number)
    for entry in entries:
        found, stated = access.width(entry), file.width(entry)
        if stated is None:
            text = f"{options.eds} has no object {entry}, which is needed"
        elif found not in (None, stated):
            text = f"{entry} has {found} bits in {access.where} but {stated} in {options.eds}"
            text = f"{text}: this EDS is not this drive's"
        else:
            continue
        raise DriveError(f"{access.axis}: {text}", code=codes.WRONG_EDS)


def _set_sync_id(access: "SdoClient", sync_id: int) -> list[str]:
    """Let the drive take SYNC by its identifier, else raise a `DriveError`; return a note where that is not known."""
    found = access.find(cia301.SYNC_COB_ID)
    if found is None:
        if sync_id == cia301.SYNC_ID:
            return []
        return [f"the drive {access.why_absent(cia301.SYNC_COB_ID)} {cia301.SYNC_COB_ID}: is it {sync_id:03X}h?"]
    if found & _SYNC_BITS == sync_id or access.try_write(cia301.SYNC_COB_ID, sync_id):
        return []
    text = (
        f"{access.axis}: {access.where} takes SYNC as {found & 0x7FF:03X}h ({cia301.SYNC_COB_ID} = {found:08X}h, "
        f"{access.why_not_written(cia301.SYNC_COB_ID)}), and the daemon sends it as {sync_id:03X}h"
    )
    fix = f"bus: {{sync_cob_id: {found & 0x7FF:#x}}}, for all drives of the bus"
    raise DriveError(text, fix, code=codes.SYNC_ID_FIXED)


def _set_up_commands(
    access: "SdoClient",
    options: CanopenOptions,
    mode: Mode,
    entries: Sequence[Object],
    period_s: float,
    times: WatchdogTimes,
    taken: set[int],
) -> tuple[tuple[MappedPdo, ...], Watch, list[str]]:
    """Prepare the mode, map the RPDOs, switch the others off, set the watchdogs; return RPDOs, watchdogs and notes."""
    notes = preparation.prepare_mode(access, mode, period_s)
    negotiator = PdoNegotiator(access, is_receive=True, node=options.node, axis=options.axis_number, taken=taken)
    values = {objects.MODE: int(mode).to_bytes(1, "little")}
    result = negotiator.negotiate(entries, values=values)
    notes += result.notes
    for pdo in result.unused:
        switch_off(access, pdo.record)  # one that stays on is not sent
    if not all(pdo.is_synchronous for pdo in result.pdos):
        notes.append("RPDOs of the drive take effect when they arrive and not at SYNC")
    number = next(number for number, pdo in enumerate(result.pdos) if objects.CONTROLWORD in pdo.entries)
    command = result.pdos[number]
    record = PdoRecord(True, command.number, options.node, options.axis_number)
    # RPDOs that a watchdog may use, each with an identifier that no other PDO has
    unused = ((pdo.record, pdo.record.default_identifier or pdo.cob_id & 0x7FF) for pdo in result.unused)
    free = [(each, identifier) for each, identifier in unused if identifier and identifier not in taken]
    armed = arm(access, options, times, (record, command.cob_id), free)
    taken.add(armed.watch.rpdo_id)
    pdos = list(result.pdos)
    pdos[number] = replace(command, is_synchronous=command.is_synchronous and not armed.is_command_event_driven)
    return tuple(pdos), armed.watch, notes + armed.notes


def _set_up_feedback(
    access: "SdoClient", options: CanopenOptions, entries: Sequence[Object], taken: set[int], *, dry_run: bool
) -> tuple[tuple[MappedPdo, ...], list[str]]:
    """Map the TPDOs of the feedback and, unless it is a dry run, switch the others off."""
    temperature = None if options.temperature is None or dry_run else options.temperature.entry
    result = _negotiate_feedback(access, options, entries, taken, temperature)
    notes = list(result.notes)
    if not dry_run:
        on = [pdo.record.name for pdo in result.unused if not switch_off(access, pdo.record)]
        if on:
            notes.append(f"the drive does not let {', '.join(on)} be switched off: they load the bus for nothing")
    return result.pdos, notes


def _negotiate_feedback(
    access: "SdoClient", options: CanopenOptions, entries: Sequence[Object], taken: set[int], spare: Object | None
) -> Negotiated:
    """Map the feedback, and ``spare`` beside it where that costs no further frame in each cycle."""

    def negotiated(wanted: Sequence[Object], optional: Sequence[Object], identifiers: set[int]) -> Negotiated:
        node, axis = options.node, options.axis_number
        negotiator = PdoNegotiator(access, is_receive=False, node=node, axis=axis, taken=identifiers)
        return negotiator.negotiate(wanted, optional=optional)

    if spare is not None:
        bits = {entry: access.width(entry) or entry.type.bits for entry in (*entries, spare)}
        count = len(grouped(entries, bits))
        if len(grouped((*entries, spare), bits)) == count:
            identifiers = set(taken)
            result = negotiated((*entries, spare), (spare, *preparation.OPTIONAL_FEEDBACK), identifiers)
            if len(result.pdos) <= count:
                taken |= identifiers
                return result
    return negotiated(entries, tuple(preparation.OPTIONAL_FEEDBACK), taken)
