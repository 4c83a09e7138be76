"""Comparing an EDS with the mode of an axis, without the drive."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from friction_hil.drive import Mode
from friction_hil_drivers.canopen.connect.eds import load_eds
from friction_hil_drivers.canopen.connect.mapping import PdoRecord
from friction_hil_drivers.canopen.connect.negotiation import FoundPdo, covering, grouped
from friction_hil_drivers.canopen.options import CanopenOptions, canopen_options
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.codec import COMMANDS
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.units import Measure, decode_position_unit

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
    dictionary: "ObjectDictionary", mode: Mode, options: CanopenOptions, *, is_compensated: bool
) -> Iterator[str]:
    """Yield the reasons for which a drive with this EDS cannot be driven as configured.

    ``is_compensated``: the mode needs the torque offset, where it uses one.
    """
    yield from _compare_modes(dictionary, mode, options)
    yield from _compare_counts(dictionary, options)
    commands = list(COMMANDS[mode])
    if mode is not Mode.CST and not is_compensated and _variable(dictionary, objects.TORQUE_OFFSET, options) is None:
        commands.remove(objects.TORQUE_OFFSET)
    for entry in (objects.MODE, *commands, *_FEEDBACK):
        variable = _variable(dictionary, entry, options)
        if variable is None:
            hint = _without_offset(dictionary, options) if entry is objects.TORQUE_OFFSET else ""
            yield f"has no object {entry}, which mode {mode.name.lower()} needs{hint}"
        elif len(variable) < entry.type.bits:
            yield f"gives {entry} {len(variable)} bits and not {entry.type.bits}"
    yield from _compare_pdos(dictionary, options, commands, is_receive=True)
    yield from _compare_pdos(dictionary, options, _FEEDBACK, is_receive=False)


def _without_offset(dictionary: "ObjectDictionary", options: CanopenOptions) -> str:
    """Return how a drive without the torque offset can be used, as far as the file shows."""
    has_target = _variable(dictionary, objects.TARGET_TORQUE, options) is not None
    variable = _variable(dictionary, objects.SUPPORTED_MODES, options)
    bits = None if variable is None else _value(variable)
    if has_target and (not bits or Mode.CST in profile.supported_modes(bits) or not options.is_mode_check_required):
        return " (mode cst does without it)"
    return " (without it, and without cst, compensation: {enabled: false})"


def necessary_keys(
    dictionary: "ObjectDictionary", options: CanopenOptions, kind: Literal["rotary", "linear"]
) -> Iterator[tuple[str, str]]:
    """Yield the keys that a drive with this EDS needs and the configuration does not have: (key, reason)."""

    def has(entry: Object) -> bool:
        return _variable(dictionary, entry, options) is not None

    feed = _variable(dictionary, objects.FEED, options)
    is_counted = has(objects.ENCODER_INCREMENTS) or (feed is not None and (_value(feed) or 1) != 1)
    is_known = _has_unit(dictionary, options, kind) or (kind == "rotary" and is_counted)
    if options.counts_per_unit is None and not is_known:
        per = "rad of the motor" if kind == "rotary" else "m"
        yield "counts_per_unit", f"has no object {objects.ENCODER_INCREMENTS}: give the counts per {per}"
    if options.rated_torque is None and not has(objects.RATED_TORQUE):
        yield "rated_torque", f"has no object {objects.RATED_TORQUE}: give the torque at 1000 per mille"
    if options.is_watchdog_required and (reason := _unwatched(dictionary, options, has)):
        text = "if the daemon dies, its torque stays; false accepts that, with an emergency stop at hand"
        yield "is_watchdog_required", f"{reason}: {text}"


def _has_unit(dictionary: "ObjectDictionary", options: CanopenOptions, kind: Literal["rotary", "linear"]) -> bool:
    """Return True if 60A8h may say what a count is; a file without its value leaves that open."""
    variable = _variable(dictionary, objects.POSITION_UNIT, options)
    if variable is None:
        return False
    if (value := _value(variable)) is None:
        return True
    try:
        unit = decode_position_unit(value)
    except ValueError:
        return False
    return unit is not None and unit.measure is (Measure.ANGLE if kind == "rotary" else Measure.LENGTH)


def _unwatched(dictionary: "ObjectDictionary", options: CanopenOptions, has: Callable[[Object], bool]) -> str:
    """Return why a drive with this EDS cannot watch the daemon, "" where it can."""
    has_reaction = has(objects.ABORT_CONNECTION_OPTION)
    if not has_reaction and not has(cia301.COMMUNICATION_ERROR_BEHAVIOUR):
        return "has neither 6007h nor 1029h, which would say what the loss of the daemon does"
    consumer = _find(dictionary, cia301.CONSUMER_HEARTBEAT)
    has_consumer = consumer is not None and (not consumer.max or consumer.max >= options.master_node << 16)
    has_guarding = has(cia301.GUARD_TIME) and has(cia301.LIFE_TIME_FACTOR)
    rpdos = (PdoRecord(True, number, options.node, options.axis_number) for number in range(cia301.PDOS_PER_AXIS))
    has_timer = has_reaction and any(_find(dictionary, rpdo.event_timer) is not None for rpdo in rpdos)
    if has_consumer or has_guarding or has_timer:
        return ""
    limit = (
        "" if consumer is None else f" (the HighLimit of 1016h:01, {consumer.max}, leaves no room for a node number)"
    )
    return f"has no RPDO with a timer that acts, no usable 1016h{limit} and no node guarding 100Ch"


def _compare_modes(dictionary: "ObjectDictionary", mode: Mode, options: CanopenOptions) -> Iterator[str]:
    variable = _variable(dictionary, objects.SUPPORTED_MODES, options)
    bits = None if variable is None else _value(variable)
    if not bits or not options.is_mode_check_required or mode in profile.supported_modes(bits):
        return  # many files give no value
    names = ", ".join(profile.mode_names(bits)) or "no mode of the profile"
    yield (
        f"lists {names} as the drive's modes ({objects.SUPPORTED_MODES}), not {mode.name.lower()} "
        "(is_mode_check_required: false if that is wrong)"
    )


def _compare_counts(dictionary: "ObjectDictionary", options: CanopenOptions) -> Iterator[str]:
    for record in _records(options):
        entry = record.mapping(0)
        variable = _find(dictionary, entry)
        count = None if variable is None else _value(variable)
        if count is not None and not 0 <= count <= _MOST_MAPPED and count not in _MULTIPLEXED:
            yield f"gives {count} as the {entry}; there are at most {_MOST_MAPPED}"


def _compare_pdos(
    dictionary: "ObjectDictionary", options: CanopenOptions, entries: Sequence[Object], *, is_receive: bool
) -> Iterator[str]:
    variables = {entry: _variable(dictionary, entry, options) for entry in entries}
    if any(variable is None for variable in variables.values()):
        return  # told already
    found = list(_pdos(dictionary, options, is_receive=is_receive))
    direction = "RPDO" if is_receive else "TPDO"
    if not found:
        yield f"has no {direction}"
        return
    if covering(found, entries) is not None:
        return
    writable = [pdo for pdo in found if _is_writable(dictionary, pdo)]
    access = _RECEIVABLE if is_receive else _TRANSMITTABLE
    fixed = [
        str(entry)
        for entry, variable in variables.items()
        if variable is not None and not (variable.pdo_mappable and variable.access_type in access)
    ]
    if not writable:
        wanted = ", ".join(map(str, entries))
        yield f"has {direction}s with fixed mappings only, and those do not contain {wanted}"
    elif fixed:
        yield f"does not let {', '.join(fixed)} be mapped into any {direction}"
    else:
        most = max(_most_entries(dictionary, pdo) for pdo in writable)
        bits = {entry: len(variable) for entry, variable in variables.items() if variable is not None}
        needed = len(grouped(entries, bits, most))
        if needed > len(writable):
            yield f"has {len(writable)} {direction}s of {most} entries that can be mapped; {needed} are needed"


def _pdos(dictionary: "ObjectDictionary", options: CanopenOptions, *, is_receive: bool) -> Iterator[FoundPdo]:
    """Yield the PDOs of one direction, with the mappings that the file gives them."""
    for record in _records(options):
        if record.is_receive is not is_receive:
            continue
        cob_id, count = (_find(dictionary, entry) for entry in (record.cob_id, record.mapping(0)))
        if cob_id is None or count is None:
            continue
        most = value if (value := _value(count) or 0) <= _MOST_MAPPED else 0
        mapped = [_find(dictionary, record.mapping(position)) for position in range(1, most + 1)]
        words = tuple(_value(word) or 0 for word in mapped if word is not None)
        yield FoundPdo(record, _value(cob_id) or 0, None, words)


def _records(options: CanopenOptions) -> Iterator[PdoRecord]:
    for is_receive in (True, False):
        for number in range(cia301.PDOS_PER_AXIS):
            yield PdoRecord(is_receive, number, options.node, options.axis_number)


def _is_writable(dictionary: "ObjectDictionary", pdo: FoundPdo) -> bool:
    entries = [_find(dictionary, pdo.record.mapping(position)) for position in (0, 1)]
    return all(entry is not None and entry.access_type in _WRITABLE for entry in entries)


def _most_entries(dictionary: "ObjectDictionary", pdo: FoundPdo) -> int:
    return sum(_find(dictionary, pdo.record.mapping(position)) is not None for position in range(1, 9))


def _variable(dictionary: "ObjectDictionary", entry: Object, options: CanopenOptions) -> Any:
    index = objects.axis_index(entry.index, options.axis_number)
    return _find(dictionary, Object(index, entry.name, entry.type, entry.subindex))


def _find(dictionary: "ObjectDictionary", entry: Object) -> Any:
    """Return an entry of the canopen library's dictionary, None where there is none."""
    try:
        return dictionary.get_variable(entry.index, entry.subindex)
    except KeyError:
        return None


def _value(variable: Any) -> int | None:
    value = variable.default if variable.value is None else variable.value
    return value if isinstance(value, int) else None


def read_eds(axis: "AxisConfig") -> None:
    """Read the EDS that an axis names, if any, to find out early that it is invalid."""
    options = canopen_options(axis)
    if options.eds is not None:
        load_eds(options.eds, options.node)


def compare_axis(path: Path, axis: "AxisConfig") -> list[tuple[str, str]]:
    """Return the reasons for which a drive with this EDS cannot be driven as configured, each with its key."""
    options = canopen_options(axis)
    dictionary = load_eds(path, options.node)
    reasons = compare_eds(dictionary, Mode[axis.mode.upper()], options, is_compensated=axis.compensation.enabled)
    found = [("eds", reason) for reason in reasons]
    return found if options.sidecar is not None else [*found, *necessary_keys(dictionary, options, axis.model.axis)]
