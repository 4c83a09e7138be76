"""Everything that a drive says of itself, for ``friction-hil drives show``: read, not written."""

from typing import Any

from friction_hil_drivers.canopen.connect.mapping import PdoRecord
from friction_hil_drivers.canopen.sdo.conversation import Script
from friction_hil_drivers.canopen.sdo.dialogue import Upload
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.objects import DataType, Object
from friction_hil_drivers.cia402.scales import polarity_text

_MODES = {1: "pp", 2: "vl", 3: "pv", 4: "tq", 6: "hm", 7: "ip", 8: "csp", 9: "csv", 10: "cst", 11: "cstca"}
_REACTIONS = {0: "none", 1: "fault", 2: "disable voltage", 3: "quick stop"}  # 6007h
_RATED_CURRENT = Object(0x6075, "motor rated current", DataType.UNSIGNED32)


def mode_name(mode: int) -> str:
    """Return the abbreviation of a mode of operation, its number where the standard has none."""
    return _MODES.get(mode, "none" if mode == 0 else str(mode))


def mode_names(bits: int) -> list[str]:
    """Return the abbreviations of the modes in object 6502h: mode n has bit n - 1."""
    return [name for mode, name in _MODES.items() if bits >> (mode - 1) & 1]


def describe(node: int, nmt: str) -> "Script[dict[str, Any]]":
    """Read a drive; return its description by section. What it lacks is None."""
    pdos = yield from _pdos(node)
    watchdogs = yield from _watchdogs(pdos)
    return {
        "node": node,
        "identity": (yield from _identity()),
        "state": {"nmt": nmt or None, **(yield from _state())},
        "units": (yield from _units()),
        "mapping": pdos,
        "watchdogs": watchdogs,
        "compensation": (yield from _compensation(pdos)),
    }


def _read(entry: Object) -> "Script[int | None]":
    (value,) = yield from _values(entry)
    return value


def _values(*entries: Object) -> "Script[list[int | None]]":
    uploads = [Upload(entry) for entry in entries]
    yield from uploads
    return [upload.value for upload in uploads]


def _text(entry: Object) -> "Script[str | None]":
    upload = Upload(entry)
    yield upload
    return None if upload.data is None else upload.data.decode("latin-1").rstrip("\0 ")


def _identity() -> "Script[dict[str, Any]]":
    device = yield from _read(objects.DEVICE_TYPE)
    return {
        "name": (yield from _text(objects.DEVICE_NAME)),
        "hardware": (yield from _text(objects.HARDWARE_VERSION)),
        "software": (yield from _text(objects.SOFTWARE_VERSION)),
        "profile": None if device is None else device & 0xFFFF,
        "vendor_id": (yield from _read(objects.VENDOR_ID)),
        "product_code": (yield from _read(objects.PRODUCT_CODE)),
        "revision": (yield from _read(objects.REVISION_NUMBER)),
        "serial": (yield from _read(objects.SERIAL_NUMBER)),
    }


def _state() -> "Script[dict[str, Any]]":
    status, mode, modes, error = yield from _values(
        objects.STATUSWORD, objects.MODE_DISPLAY, objects.SUPPORTED_MODES, objects.ERROR_CODE
    )
    state = None if status is None else profile.drive_state(status)
    return {
        "drive": None if state is None else state.words,
        "is_powered": None if state is None else state.is_powered,
        "error": profile.error_text(error) if error else None,
        "mode": None if mode is None else mode_name(mode),
        "modes": None if modes is None else mode_names(modes),
    }


def _units() -> "Script[dict[str, Any]]":
    increments, revolutions = yield from _values(objects.ENCODER_INCREMENTS, objects.MOTOR_REVOLUTIONS)
    torque, velocity, polarity = yield from _values(objects.RATED_TORQUE, objects.VELOCITY_UNIT, objects.POLARITY)
    value, exponent = yield from _values(objects.INTERPOLATION_PERIOD, objects.INTERPOLATION_EXPONENT)
    gear = yield from _values(objects.GEAR_MOTOR_REVOLUTIONS, objects.GEAR_SHAFT_REVOLUTIONS)
    known = {objects.COUNTS_PER_SECOND: "counts/s", objects.REVOLUTIONS_PER_MINUTE: "1/min"}
    return {
        "counts_per_revolution": increments / (revolutions or 1) if increments else None,
        "gear": gear,
        "feed": (yield from _read(objects.FEED)),
        "velocity_unit": None if velocity is None else known.get(velocity, f"{velocity:08X}h"),
        "polarity": None if polarity is None else polarity_text(polarity),
        "rated_torque_Nm": None if torque is None else torque / 1000.0,
        "rated_current_mA": (yield from _read(_RATED_CURRENT)),
        "interpolation_period_s": value * 10.0**exponent if value is not None and exponent is not None else None,
    }


def _pdos(node: int) -> "Script[list[dict[str, Any]]]":
    found: list[dict[str, Any]] = []
    for is_receive in (True, False):
        for number in range(cia301.PDO_COUNT):
            pdo = yield from _pdo(PdoRecord(is_receive, number, node))
            if pdo is not None:
                found.append(pdo)
    return found


def _pdo(record: PdoRecord) -> "Script[dict[str, Any] | None]":
    cob_id = yield from _read(record.cob_id)
    if cob_id is None:
        return None
    kind = yield from _read(record.transmission_type)
    timer = yield from _read(record.event_timer)
    count = (yield from _read(record.mapping(0))) or 0
    entries = []
    for position in range(1, min(count, 8) + 1):
        word = yield from _read(record.mapping(position))
        if word is not None:
            entries.append(_entry(word))
    return {
        "pdo": record.name,
        "cob_id": cob_id & 0x7FF,
        "is_valid": not cob_id & cia301.PDO_INVALID,
        "transmission_type": kind,
        "event_timer_ms": timer,
        "entries": entries,
    }


def _entry(word: int) -> dict[str, Any]:
    index, subindex, bits = word >> 16, word >> 8 & 0xFF, word & 0xFF
    known = cia301.TABLE.get((index, subindex))
    return {"index": index, "subindex": subindex, "bits": bits, "name": known.name if known else None}


def _watchdogs(pdos: list[dict[str, Any]]) -> "Script[dict[str, Any]]":
    consumer = yield from _read(cia301.CONSUMER_HEARTBEAT)
    watched, time_ms = cia301.watched_node(consumer or 0)
    reaction = yield from _read(objects.ABORT_CONNECTION_OPTION)
    guard, factor = yield from _values(cia301.GUARD_TIME, cia301.LIFE_TIME_FACTOR)
    most = cia301.LARGEST_SYNCHRONOUS
    timers = [
        {"pdo": pdo["pdo"], "ms": pdo["event_timer_ms"], "needs_sync": (pdo["transmission_type"] or 0) <= most}
        for pdo in pdos
        if pdo["pdo"].startswith("RPDO") and pdo["is_valid"] and pdo["event_timer_ms"]
    ]
    return {
        "heartbeat_consumer": None if consumer is None else {"node": watched, "ms": time_ms},
        "heartbeat_producer_ms": (yield from _read(cia301.PRODUCER_HEARTBEAT)),
        "node_guarding_ms": None if guard is None or factor is None else guard * factor,
        "rpdo_timers": timers,  # needs_sync: some drives look at it only when a SYNC comes
        "reaction": None if reaction is None else _REACTIONS.get(reaction, str(reaction)),
        "communication_error_behaviour": (yield from _read(cia301.COMMUNICATION_ERROR_BEHAVIOUR)),
        "quick_stop_option": (yield from _read(objects.QUICK_STOP_OPTION)),
    }


def _compensation(pdos: list[dict[str, Any]]) -> "Script[dict[str, Any]]":
    """Say how a torque could reach the drive beside its loops: an object that exists, and an RPDO that has it now."""
    modes = yield from _read(objects.SUPPORTED_MODES)
    ways: dict[str, Any] = {}
    for names, entry in ((("csp", "csv"), objects.TORQUE_OFFSET), (("cst",), objects.TARGET_TORQUE)):
        upload = Upload(entry)
        yield upload
        carriers = [
            pdo["pdo"]
            for pdo in pdos
            if pdo["pdo"].startswith("RPDO") and any(each["index"] == entry.index for each in pdo["entries"])
        ]
        way: dict[str, Any] = {"object": None, "bits": None, "mapped_in": []}
        if upload.data is not None:
            way = {"object": str(entry), "bits": 8 * len(upload.data), "mapped_in": carriers}
        for name in names:
            ways[name] = {"is_supported": None if modes is None else name in mode_names(modes), **way}
    return ways
