"""The work of ``friction-hil drives``."""

import contextlib
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import click
from pydantic import ValidationError

from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import new_table, number, print_table, say
from friction_hil.config import BusConfig, Configuration, load
from friction_hil.config.drivers import driver_names, load_driver
from friction_hil.config.new_file import Wanted, parse_bus
from friction_hil.drive.inventory import DriveEntry, Inventory, Stop
from friction_hil.errors import UsageError

_WHERE = "give a configuration with a bus, or --bus CHANNEL, such as can0, or INTERFACE:CHANNEL[:PORT]"


def scan_bus(*, config: str | None, bus: str | None, bitrate: int | None, may_disturb: bool, as_json: bool) -> int:
    """Print the nodes on a bus; return 1 if there is none, or something is wrong with one."""
    with _inventory(config, bus, bitrate, may_disturb=may_disturb) as (inventory, _):
        found = inventory.scan()
    if as_json:
        print_json({"drives": [_entry_json(each) for each in found.drives], "notes": found.notes})
    else:
        print_scan(found.drives)
        _print_notes(found.notes)
        _print_next(found.drives, config, bus)
    return 0 if found.drives and not any(each.problem for each in found.drives) else 1


def show_drive(*, words: Sequence[str], bus: str | None, bitrate: int | None, may_disturb: bool, as_json: bool) -> int:
    """Print what one drive says of itself."""
    config, nodes = _sort(words)
    if len(nodes) != 1:
        raise UsageError(
            "drives show needs the number of one node, e.g. friction-hil drives show --bus socketcan:can0 1"
        )
    with _inventory(config, bus, bitrate, may_disturb=may_disturb) as (inventory, _):
        shown = inventory.show(nodes[0])
        notes = inventory.notes
    if as_json:
        print_json({**shown, "notes": notes})
    else:
        _print_drive(shown)
        _print_notes(notes)
    return 0


def stop_drives(*, words: Sequence[str], bus: str | None, bitrate: int | None, as_json: bool) -> int:
    """Stop drives; return 1 unless each has been read back without power."""
    config, nodes = _sort(words)
    with _inventory(config, bus, bitrate) as (inventory, of_axes):
        stops = inventory.stop(nodes or of_axes)
        notes = inventory.notes
    if as_json:
        print_json({"drives": [_stop_json(each) for each in stops], "notes": notes})
    else:
        for each in stops:
            say(_stop_line(each), stderr=False)
        _print_notes(notes)
    return 0 if all(each.is_proved for each in stops) else 1


def _sort(words: Sequence[str]) -> tuple[str | None, list[int]]:
    """Tell a configuration from node numbers."""
    nodes = [int(word) for word in words if word.isdecimal()]
    files = [word for word in words if not word.isdecimal()]
    if len(files) > 1:
        raise UsageError(f"one configuration at a time, not {' and '.join(files)}; nodes are given by their numbers")
    for node in nodes:
        if not 1 <= node <= 127:
            raise UsageError(f"there is no node {node}: node numbers are 1 to 127")
    return (files[0] if files else None), nodes


@contextlib.contextmanager
def _inventory(
    config: str | None, bus: str | None, bitrate: int | None, *, may_disturb: bool = False
) -> Iterator[tuple[Inventory, list[int]]]:
    """Open a bus; also return the nodes of the axes in the configuration."""
    nodes: list[int] = []
    if config is not None and bus is None:
        configuration = load(config, needs_models=False)
        driver, nodes = _driver_of(config, configuration)
        section = configuration.bus
        if section is None:
            raise UsageError(f"{config} has no bus: {_WHERE}")
    elif bus is not None and config is None:
        driver, section = _driver_for_buses(), _parse(bus, bitrate)
    else:
        raise UsageError(_WHERE if bus is None else f"either a configuration or --bus, not both: {_WHERE}")
    inventory: Inventory = driver.open_inventory(section, may_disturb=may_disturb)
    try:
        yield inventory, nodes
    finally:
        inventory.close()


def _driver_of(path: str, configuration: Configuration) -> tuple[Any, list[int]]:
    """Return the driver of a configuration that can list drives, and the nodes of its axes."""
    others = []
    for name in sorted({axis.driver for axis in configuration.axes.values()}):
        driver = load_driver(name)
        if driver.has_inventory:
            axes = [axis for axis in configuration.axes.values() if axis.driver == name]
            return driver, [driver.inventory_node(axis) for axis in axes]
        others.append(name)
    raise UsageError(
        f"{path}: drives of {', '.join(others)} are not found, shown or stopped here; this is for CANopen. "
        f"friction-hil stop {path} stops drives of any driver"
    )


def _driver_for_buses() -> Any:
    for name in driver_names():
        driver = load_driver(name)
        if driver.has_inventory:
            return driver
    raise UsageError("no installed driver can list the drives of a bus")


def _parse(text: str, bitrate: int | None) -> BusConfig:
    """Return the bus that ``can0`` or ``INTERFACE:CHANNEL[:PORT]`` names, as for a new configuration."""
    section = parse_bus(Wanted(bus=text, bitrate=bitrate))
    try:
        return BusConfig.model_validate({key: value for key, value in section.items() if value is not None})
    except ValidationError as error:
        reasons = "; ".join(f"{'.'.join(map(str, each['loc'])) or 'bus'}: {each['msg']}" for each in error.errors())
        raise UsageError(f"--bus {text}: {reasons}") from error


# Printing


def _entry_json(entry: DriveEntry) -> dict[str, Any]:
    found = asdict(entry)
    found["state"] = None if entry.state is None else entry.state.words
    found["is_powered"] = None if entry.state is None or not entry.state else entry.state.is_powered
    return found


def _stop_json(stop: Stop) -> dict[str, Any]:
    before, after = stop.before.words, stop.after.words
    return {"node": stop.node, "before": before, "after": after, "result": stop.result, "detail": stop.reason}


def print_scan(entries: Sequence[DriveEntry]) -> None:
    """Print the drives that were found on a bus."""
    if not entries:
        click.echo("no node answers: is the bus the right one, with the right bit rate, and are the drives on?")
        return
    table = new_table(number("node"), "name", "identity", "profile", "NMT", "state", "mode", "modes")
    for each in entries:
        numbers = (each.vendor_id, each.product_code, each.serial)
        identity = " ".join("-" if number is None else f"{number:#x}" for number in numbers)
        state = "answers no SDO request" if not each.answers else "no drive" if each.state is None else each.state.words
        table.add_row(
            *(str(each.node), each.name or "-", identity, "-" if each.profile is None else str(each.profile)),
            *(each.nmt or "-", state, each.mode or "-", " ".join(each.modes) or "-"),
        )
    print_table(table)
    for each in entries:
        if each.problem:
            say(f"error: {each.problem}", stderr=False)


def _print_next(entries: Sequence[DriveEntry], config: str | None, bus: str | None) -> None:
    """Print how many drives there are, whether one has power, and what to do with the first one."""
    drives = [each for each in entries if each.state is not None]
    if not drives or any(each.problem for each in entries):
        return
    powered = [str(each.node) for each in drives if each.state is not None and each.state.is_powered]
    power = f"with power: node {', '.join(powered)}" if powered else "none has power"
    say(f"{len(drives)} {'drive' if len(drives) == 1 else 'drives'}; {power}", stderr=False)
    node = str(drives[0].node)
    if config is not None:
        words = ["drives", "show", config, node]
    else:
        words = ["config", "new", "machine.yaml", "--bus", str(bus), "--node", node]
    say(f"next: {shlex.join(['friction-hil', *words])}", stderr=False)


def _print_notes(notes: Sequence[str]) -> None:
    for note in notes:
        say(f"note: {note}", stderr=False)


def _stop_line(stop: Stop) -> str:
    words = {
        "stopped": f"stopped: {stop.before.words} before, {stop.after.words} read back",
        "unpowered": f"had no power: {stop.after.words}",
        "powered": f"STILL POWERED: {stop.after.words} read back",
        "unknown": "UNKNOWN: it is not known whether it has power",
    }
    return f"node {stop.node}: {words[stop.result]}{f' ({stop.reason})' if stop.reason else ''}"


_HEX = ("vendor_id", "product_code", "revision")


def _print_drive(shown: dict[str, Any]) -> None:
    """Print what a drive says of itself, one section after the other."""
    click.echo(f"node {shown['node']}")
    for section in ("identity", "state", "units"):
        cells = [f"{name} {_cell(name, value)}" for name, value in shown[section].items()]
        say(f"  {section}: {', '.join(cells)}", stderr=False)
    click.echo("  PDOs:")
    for pdo in shown["mapping"]:
        say(f"    {_pdo_line(pdo)}", stderr=False)
    say(f"  watchdogs: {_watchdog_line(shown['watchdogs'])}", stderr=False)
    click.echo("  compensation:")
    for mode, way in shown["compensation"].items():
        say(f"    {mode}: {_way(way)}", stderr=False)


def _pdo_line(pdo: dict[str, Any]) -> str:
    kind = pdo["transmission_type"]
    manner = "type -" if kind is None else f"type {kind} ({'synchronous' if kind <= 240 else 'event-driven'})"
    timer = f", timer {pdo['event_timer_ms']} ms" if pdo["event_timer_ms"] else ""
    objects = ", ".join(_mapped(entry) for entry in pdo["entries"]) or "nothing mapped"
    return f"{pdo['pdo']} {pdo['cob_id']:03X}h {'on' if pdo['is_valid'] else 'off'}, {manner}{timer}: {objects}"


def _mapped(entry: dict[str, Any]) -> str:
    subindex = f":{entry['subindex']:02X}" if entry["subindex"] else ""
    name = f" {entry['name']}" if entry["name"] else ""
    return f"{entry['index']:04X}h{subindex}{name} ({entry['bits']} bits)"


def _watchdog_line(found: dict[str, Any]) -> str:
    consumer = found["heartbeat_consumer"]
    words = []
    if consumer is None:
        words.append("no heartbeat consumer 1016h")
    elif not consumer["node"] or not consumer["ms"]:
        words.append("heartbeat consumer 1016h off")
    else:
        words.append(f"heartbeat of node {consumer['node']} within {consumer['ms']} ms")
    guarding = found["node_guarding_ms"]
    words.append("no node guarding 100Ch" if guarding is None else f"node guarding {guarding or 'off'}")
    for timer in found["rpdo_timers"]:
        trap = ", which some drives look at only when a SYNC comes" if timer["needs_sync"] else ""
        words.append(f"{timer['pdo']} within {timer['ms']} ms{trap}")
    words.append(f"reaction 6007h: {_cell('', found['reaction'])}")
    own_ms = found["heartbeat_producer_ms"]
    words.append(f"own heartbeat every {own_ms} ms" if own_ms else "own heartbeat 1017h off")
    return "; ".join(words)


def _way(way: dict[str, Any]) -> str:
    if way["object"] is None:
        return "no object for it in this drive"
    support = "; 6502h does not list the mode" if way["is_supported"] is False else ""
    where = f"in {', '.join(way['mapped_in'])}" if way["mapped_in"] else "in no RPDO now"
    return f"{way['object']} ({way['bits']} bits), {where}{support}"


def _cell(name: str, value: Any) -> str:
    if value is None or value == "":
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return " ".join(_cell("", each) for each in value) or "none"
    return f"{value:#x}" if name in _HEX else f"{value:.10g}" if isinstance(value, float) else str(value)
