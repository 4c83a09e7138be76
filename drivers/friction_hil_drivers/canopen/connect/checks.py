"""Checks of a CAN bus and its drives. All that is sent asks each node who it is, where no other master is at work."""

import contextlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.drive import Mode
from friction_hil.drive.finding import Finding, failure
from friction_hil.errors import DriveError, FrictionHilError
from friction_hil_drivers.canopen.commands.service import CanopenService
from friction_hil_drivers.canopen.connect.mapping import MappedPdo, check_bus_load, expected_pdos
from friction_hil_drivers.canopen.connect.watchdog_times import REACTION_MS
from friction_hil_drivers.canopen.connect.watchdogs import watchdog_pdos
from friction_hil_drivers.canopen.options import canopen_options
from friction_hil_drivers.canopen.sidecar.options import mapped
from friction_hil_drivers.canopen.wire import interfaces
from friction_hil_drivers.canopen.wire.exclusive import AxisLock
from friction_hil_drivers.canopen.wire.interfaces import bus_name

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, BusConfig, Configuration

_SILENT = ("socketcan", "udp_multicast", "virtual")  # opening one of these disturbs no other node
_USUAL = (*_SILENT, "slcan", "pcan", "kvaser")


def check_bus(config: "BusConfig") -> Iterator[tuple[str, str]]:
    """Check that python-can has the interface; see `friction_hil.drive.Driver`."""
    if config.interface in _USUAL:
        return
    # imported here: python-can takes 0.5 s, and the usual interfaces are known
    from friction_hil_drivers.canopen.wire.bus import unknown_interface

    if text := unknown_interface(config.interface):
        yield "interface", text


def check_connection(configuration: "Configuration", axes: "Mapping[str, AxisConfig]") -> Iterator[Finding]:
    """Yield the state of the bus, its load and the owner of each drive; see `friction_hil.drive.Driver`."""
    config = configuration.bus
    assert config is not None  # the driver's options have checked it
    is_open = False
    if not any(check_bus(config)):  # else that is a mistake of the configuration, which has been reported
        opened = _opened(config)
        is_open = opened.result == "pass"
        yield opened
    if config.interface == "socketcan" and is_open:
        name = str(config.channel)
        yield interfaces.check_interface(name, interfaces.ask_ip(name), config.bitrate)
    if config.bitrate is not None:
        yield _load(config.bitrate, configuration, axes)
    for name, axis in axes.items():
        yield _owner(config, name, axis)
        yield _units(name, axis)
        if config.role == "master":
            yield _watchdog(name, axis, configuration)
    if is_open and config.role == "master":
        yield from _numbers(config, {name: canopen_options(axis).node for name, axis in axes.items()})


def _opened(config: "BusConfig") -> Finding:
    # imported here: python-can takes 0.5 s, and reading a configuration does not need it
    from friction_hil_drivers.canopen.wire.bus import open_bus

    check = "bus"
    try:
        if config.interface in _SILENT:
            open_bus(config).shutdown()
            return Finding(check, "pass", f"{bus_name(config)} can be opened")
    except FrictionHilError as error:
        return failure(check, error, "FH-437")
    device = Path(str(config.channel))
    if device.is_absolute() and not os.access(device, os.R_OK | os.W_OK):
        reason = "permission denied" if device.exists() else "there is no such device"
        fix = "plug the adapter in, and see who may open it: ls -l /dev"
        return Finding(check, "fail", f"{device}: {reason}", fix, "FH-438")
    detail = f"{bus_name(config)} is not opened here: such an adapter takes part in the bus as soon as it is open"
    return Finding(check, "warn", detail, "friction-hil run with --dry-run opens it and commands nothing", "FH-439")


def _load(bitrate: int, configuration: "Configuration", axes: "Mapping[str, AxisConfig]") -> Finding:
    period_s, max_missed = configuration.period_s, configuration.realtime.max_missed
    pdos = [pdo for axis in axes.values() for pdo in _pdos(axis)]
    masters = [options for options in map(canopen_options, axes.values()) if options.sidecar is None]
    pdos += watchdog_pdos(options.times(period_s, max_missed).feed_cycles for options in masters)
    try:
        return Finding("bus load", "pass", check_bus_load(bitrate, period_s, pdos))
    except DriveError as error:
        return failure("bus load", error, "FH-440")


def _pdos(axis: "AxisConfig") -> list[MappedPdo]:
    """Return the PDOs of an axis: those that the driver maps, or those that the keys of a sidecar state."""
    sidecar = canopen_options(axis).sidecar
    if sidecar is None:
        return expected_pdos(Mode[axis.mode.upper()])
    return [mapped(pdo) for pdo in (*sidecar.tpdos, *sidecar.rpdos, sidecar.offset)]


def _owner(config: "BusConfig", name: str, axis: "AxisConfig") -> Finding:
    """Check that no other daemon of this machine drives the axis."""
    node = canopen_options(axis).node
    check = f"{name}: node {node}"
    try:
        AxisLock(config, node, name).release()
    except DriveError as error:
        return failure(check, error, "FH-441")
    return Finding(check, "pass", "no other daemon of this machine drives it")


def _numbers(config: "BusConfig", nodes: Mapping[str, int]) -> Iterator[Finding]:
    """Check that no two drives have one number; a drive that is off says nothing."""
    with contextlib.closing(CanopenService.open_inventory(config)) as inventory:
        met = inventory.meet(sorted(set(nodes.values())))
    for name, node in nodes.items():
        if node in met:
            check, refusal = f"{name}: number {node}", met[node]
            yield Finding(check, "pass", "one drive has it") if refusal is None else failure(check, refusal)


def _watchdog(name: str, axis: "AxisConfig", configuration: "Configuration") -> Finding:
    """Say within which time a drive has no torque if the daemon dies; which watchdogs it has, is not read here."""
    times = canopen_options(axis).times(configuration.period_s, configuration.realtime.max_missed)
    timer_ms, loss_ms = times.timer_ms + REACTION_MS, times.loss_ms + REACTION_MS
    detail = (
        f"if the daemon dies, a drive has no torque within {timer_ms} ms of its last frame by an RPDO's timer, and "
        f"without one within {loss_ms} ms by heartbeat or node guarding, if it takes these times: run shows which one "
        "acts, and --try-watchdog tries it"
    )
    return Finding(f"{name}: watchdog", "pass", detail)


def _units(name: str, axis: "AxisConfig") -> Finding:
    """Say which units are configured, and which the drive must report; nothing is read from the drive here."""
    options, per, force = canopen_options(axis), "rad", "N m"
    if axis.model.axis == "linear":
        per, force = "m", "N"
    counts, torque = options.counts_per_unit, options.rated_torque
    given = [
        "position as 608Fh says" if counts is None else f"position {counts:.7g} counts per {per} (counts_per_unit)",
        f"velocity {options.velocity_unit} (velocity_unit)" if options.velocity_unit else "velocity as 60A9h says",
        "torque as 6076h says" if torque is None else f"torque {torque:g} {force} at 1000 per mille (rated_torque)",
    ]
    trusted = f"; trusted whatever the drive says: {', '.join(options.trust)}" if options.trust else ""
    detail = (
        f"{', '.join(given)}{trusted}; run with --dry-run compares them with the drive and shows the limits in them"
    )
    return Finding(f"{name}: units", "pass", detail)
