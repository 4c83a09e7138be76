"""Comparing an EDS with the mode of an axis, without the drive."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.drive import Mode
from friction_hil_drivers.canopen.connect.eds import EdsObjects, load_eds
from friction_hil_drivers.canopen.connect.mapping import PdoRecord
from friction_hil_drivers.canopen.connect.negotiation import FoundPdo, covering, grouped
from friction_hil_drivers.canopen.options import CanopenOptions, canopen_options
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.codec import command_entries
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.units import Kind, Measure, decode_position_unit

if TYPE_CHECKING:
    from canopen import ObjectDictionary

    from friction_hil.config import AxisConfig

_FEEDBACK = (objects.STATUSWORD, objects.POSITION_ACTUAL)  # the drive may lack the rest
_MOST_MAPPED = 64  # objects in a PDO, of a bit each
_MULTIPLEXED = (254, 255)  # in the place of their number
_WRITABLE = ("rw", "rww", "rwr", "wo")
_RECEIVABLE = ("rw", "rww", "wo")
_TRANSMITTABLE = ("ro", "rw", "rwr", "const")


def compare_eds(
    dictionary: "ObjectDictionary",
    mode: Mode,
    options: CanopenOptions,
    *,
    is_compensated: bool,
    is_by_velocity: bool = False,
) -> Iterator[str]:
    """Yield the reasons for which a drive with this EDS cannot be driven as configured.

    ``is_compensated``: the mode needs the torque offset, where it uses one, or with ``is_by_velocity`` the velocity
    offset in its place.
    """
    file = EdsObjects(dictionary, options.axis_number)
    yield from _compare_modes(file, mode, options)
    yield from _compare_counts(file, options)
    commands = command_entries(mode, is_by_velocity=is_by_velocity)
    if mode is not Mode.CST and not is_compensated and not file.has(commands[-1]):
        commands.pop()
    for entry in (objects.MODE, *commands, *_FEEDBACK):
        bits = file.width(entry)
        if bits is None:
            hint = _without_offset(file, options) if entry is objects.TORQUE_OFFSET else ""
            yield f"has no object {entry}, which mode {mode.name.lower()} needs{hint}"
        elif bits < entry.type.bits:
            yield f"gives {entry} {bits} bits and not {entry.type.bits}"
    yield from _compare_pdos(file, options, commands, is_receive=True)
    yield from _compare_pdos(file, options, _FEEDBACK, is_receive=False)


def _without_offset(file: EdsObjects, options: CanopenOptions) -> str:
    """Return how a drive without the torque offset can be used, as far as the file shows."""
    bits = file.value(objects.SUPPORTED_MODES)
    may_be_cst = not bits or Mode.CST in profile.supported_modes(bits) or not options.is_mode_check_required
    if file.has(objects.TARGET_TORQUE) and may_be_cst:
        return " (mode cst does without it)"
    other = "compensation.velocity_offset or " if file.has(objects.VELOCITY_OFFSET) else ""
    return f" (without it, and without cst, {other}compensation: {{enabled: false}})"


def necessary_keys(dictionary: "ObjectDictionary", options: CanopenOptions, kind: Kind) -> Iterator[tuple[str, str]]:
    """Yield the keys that a drive with this EDS needs and the configuration does not have: (key, reason)."""
    file = EdsObjects(dictionary, options.axis_number)
    is_counted = file.has(objects.ENCODER_INCREMENTS) or (file.value(objects.FEED) or 1) != 1
    is_known = _has_unit(file, kind) or (kind == "rotary" and is_counted)
    if options.counts_per_unit is None and not is_known:
        per = "rad of the motor" if kind == "rotary" else "m"
        yield "counts_per_unit", f"has no object {objects.ENCODER_INCREMENTS}: give the counts per {per}"
    if options.rated_torque is None and not file.has(objects.RATED_TORQUE):
        yield "rated_torque", f"has no object {objects.RATED_TORQUE}: give the torque at 1000 per mille"
    if options.is_watchdog_required and (reason := _unwatched(file, options)):
        text = "if the daemon dies, its torque stays; false accepts that, with an emergency stop at hand"
        yield "is_watchdog_required", f"{reason}: {text}"


def _has_unit(file: EdsObjects, kind: Kind) -> bool:
    """Return True if 60A8h may say what a count is; a file without its value leaves that open."""
    if (value := file.value(objects.POSITION_UNIT)) is None:
        return file.has(objects.POSITION_UNIT)
    try:
        unit = decode_position_unit(value)
    except ValueError:
        return False
    return unit is not None and unit.measure is (Measure.ANGLE if kind == "rotary" else Measure.LENGTH)


def _unwatched(file: EdsObjects, options: CanopenOptions) -> str:
    """Return why a drive with this EDS cannot watch the daemon, "" where it can."""
    has_reaction = file.has(objects.ABORT_CONNECTION_OPTION)
    if not has_reaction and not file.has(cia301.COMMUNICATION_ERROR_BEHAVIOUR):
        return "has neither 6007h nor 1029h, which would say what the loss of the daemon does"
    consumer = file.variable(cia301.CONSUMER_HEARTBEAT)
    has_consumer = consumer is not None and (not consumer.max or consumer.max >= options.master_node << 16)
    has_guarding = file.has(cia301.GUARD_TIME) and file.has(cia301.LIFE_TIME_FACTOR)
    has_timer = has_reaction and any(file.has(rpdo.event_timer) for rpdo in _records(options, is_receive=True))
    if has_consumer or has_guarding or has_timer:
        return ""
    limit = (
        "" if consumer is None else f" (the HighLimit of 1016h:01, {consumer.max}, leaves no room for a node number)"
    )
    return f"has no RPDO with a timer that acts, no usable 1016h{limit} and no node guarding 100Ch"


def _compare_modes(file: EdsObjects, mode: Mode, options: CanopenOptions) -> Iterator[str]:
    bits = file.value(objects.SUPPORTED_MODES)
    if not bits or not options.is_mode_check_required or mode in profile.supported_modes(bits):
        return  # many files give no value
    names = ", ".join(profile.mode_names(bits)) or "no mode of the profile"
    yield (
        f"lists {names} as the drive's modes ({objects.SUPPORTED_MODES}), not {mode.name.lower()} "
        "(is_mode_check_required: false if that is wrong)"
    )


def _compare_counts(file: EdsObjects, options: CanopenOptions) -> Iterator[str]:
    for record in (*_records(options, is_receive=True), *_records(options, is_receive=False)):
        entry = record.mapping(0)
        count = file.value(entry)
        if count is not None and not 0 <= count <= _MOST_MAPPED and count not in _MULTIPLEXED:
            yield f"gives {count} as the {entry}; there are at most {_MOST_MAPPED}"


def _compare_pdos(
    file: EdsObjects, options: CanopenOptions, entries: Sequence[Object], *, is_receive: bool
) -> Iterator[str]:
    variables = {entry: file.variable(entry) for entry in entries}
    if any(variable is None for variable in variables.values()):
        return  # told already
    found = list(_pdos(file, options, is_receive=is_receive))
    direction = "RPDO" if is_receive else "TPDO"
    if not found:
        yield f"has no {direction}"
        return
    if covering(found, entries) is not None:
        return
    writable = [pdo for pdo in found if _is_writable(file, pdo)]
    access = _RECEIVABLE if is_receive else _TRANSMITTABLE
    fixed = [
        str(entry)
        for entry, variable in variables.items()
        if not (variable.pdo_mappable and variable.access_type in access)
    ]
    if not writable:
        wanted = ", ".join(map(str, entries))
        yield f"has {direction}s with fixed mappings only, and those do not contain {wanted}"
    elif fixed:
        yield f"does not let {', '.join(fixed)} be mapped into any {direction}"
    else:
        most = max(sum(file.has(pdo.record.mapping(position)) for position in range(1, 9)) for pdo in writable)
        bits = {entry: len(variable) for entry, variable in variables.items()}
        needed = len(grouped(entries, bits, most))
        if needed > len(writable):
            yield f"has {len(writable)} {direction}s of {most} entries that can be mapped; {needed} are needed"


def _pdos(file: EdsObjects, options: CanopenOptions, *, is_receive: bool) -> Iterator[FoundPdo]:
    """Yield the PDOs of one direction, with the mappings that the file gives them."""
    for record in _records(options, is_receive=is_receive):
        count = record.mapping(0)
        if not (file.has(record.cob_id) and file.has(count)):
            continue
        most = value if (value := file.value(count) or 0) <= _MOST_MAPPED else 0
        mapped = filter(file.has, (record.mapping(position) for position in range(1, most + 1)))
        yield FoundPdo(record, file.value(record.cob_id) or 0, None, tuple(file.value(entry) or 0 for entry in mapped))


def _records(options: CanopenOptions, *, is_receive: bool) -> Iterator[PdoRecord]:
    for number in range(cia301.PDOS_PER_AXIS):
        yield PdoRecord(is_receive, number, options.node, options.axis_number)


def _is_writable(file: EdsObjects, pdo: FoundPdo) -> bool:
    entries = [file.variable(pdo.record.mapping(position)) for position in (0, 1)]
    return all(entry is not None and entry.access_type in _WRITABLE for entry in entries)


def read_eds(axis: "AxisConfig") -> None:
    """Read the EDS that an axis names, if any, to find out early that it is invalid."""
    options = canopen_options(axis)
    if options.eds is not None:
        load_eds(options.eds, options.node)


def compare_axis(path: Path, axis: "AxisConfig") -> list[tuple[str, str]]:
    """Return the reasons for which a drive with this EDS cannot be driven as configured, each with its key."""
    options = canopen_options(axis)
    dictionary = load_eds(path, options.node)
    reasons = compare_eds(
        dictionary,
        Mode[axis.mode.upper()],
        options,
        is_compensated=axis.compensation.enabled and not axis.compensation.is_by_position,
        is_by_velocity=axis.compensation.is_by_velocity,
    )
    found = [("eds", reason) for reason in reasons]
    return found if options.sidecar is not None else [*found, *necessary_keys(dictionary, options, axis.model.axis)]
