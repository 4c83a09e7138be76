"""Opening the CAN bus, for the drives and for their simulated counterparts."""

import logging
import socket
from typing import TYPE_CHECKING, Any

import can
from can.interfaces import VALID_INTERFACES

from friction_hil.errors import BusError, UsageError, choices
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.wire import interfaces
from friction_hil_drivers.canopen.wire.frames import FrameBus, frame_bus
from friction_hil_drivers.canopen.wire.interfaces import bus_name
from friction_hil_drivers.canopen.wire.multicast import MulticastBus, connected_to

if TYPE_CHECKING:
    from friction_hil.config import BusConfig

_WITHOUT_BITRATE = ("udp_multicast", "virtual", "socketcan")

# Without a handler Python prints what these libraries log; the errors raised here say the same, once.
for _library in ("can", "canopen"):
    logging.getLogger(_library).addHandler(logging.NullHandler())


def open_frame_bus(config: "BusConfig", bus: can.BusABC | None = None) -> FrameBus:
    """Open the bus that the configuration names, or take the open one given, for raw frames; see `open_bus`."""
    return frame_bus(bus or open_bus(config), config, bus_name(config))


def open_bus(config: "BusConfig") -> can.BusABC:
    """Open the bus that the configuration names.

    With udp_multicast a process may receive its own frames too (`FrameBus.is_echoing`), and every interface delivers
    frames for other nodes. Raises `BusError` if it does not open, with what to do about it, and `UsageError` if
    python-can has no such interface.
    """
    if text := unknown_interface(config.interface):
        raise UsageError(f"bus.interface: {text}")
    try:
        if config.interface == "udp_multicast":
            # fails early where multicast has no route; python-can fails only when it sends
            connected_to(str(config.channel), config.port or 1).close()
            return MulticastBus(str(config.channel), **_arguments(config))
        if config.interface == "socketcan":
            _require_interface(str(config.channel))
        # ignore_config: a ~/.canrc must not change what the configuration file says
        return can.Bus(interface=config.interface, channel=config.channel, ignore_config=True, **_arguments(config))
    except (can.CanError, OSError, ValueError, TypeError, ImportError) as error:
        reason = str(error) or type(error).__name__
        text = f"the bus {bus_name(config)} does not open: {reason}"
        raise BusError(text, advice(config), code=codes.BUS_NOT_OPENED) from error


def _arguments(config: "BusConfig") -> dict[str, Any]:
    """Return the keyword arguments of `can.Bus` beside interface and channel."""
    arguments: dict[str, Any] = dict(config.further)
    if config.port is not None:
        arguments["port"] = config.port
    if config.hop_limit is not None:
        arguments["hop_limit"] = config.hop_limit
    if config.bitrate is not None and config.interface not in _WITHOUT_BITRATE:
        arguments["bitrate"] = config.bitrate
    if config.interface == "udp_multicast":
        arguments["fd"] = False
    return arguments


def unknown_interface(name: str) -> str:
    """Return a message that lists python-can's interfaces if it has none of this name, else ""."""
    if name in VALID_INTERFACES:
        return ""
    return f"python-can has no interface {name!r}; {choices(name, VALID_INTERFACES)}"


def _require_interface(name: str) -> None:
    """Fail early where a CAN interface is down; the kernel opens it all the same and delivers nothing."""
    if name not in (each for _, each in socket.if_nameindex()):
        present = ", ".join(interfaces.can_interfaces()) or "none"
        raise OSError(f"there is no interface {name}; CAN interfaces of this machine: {present}")
    if interfaces.is_up(name) is False:
        raise OSError(f"the interface {name} is down")


def advice(config: "BusConfig") -> str:
    """Return what to do about a bus that does not open, "" where that is not known."""
    if config.interface == "udp_multicast":
        return "where only the loopback interface is up, give multicast a route: ip route add 239.0.0.0/8 dev lo"
    if config.interface == "socketcan":
        name = str(config.channel)
        is_present = name in interfaces.can_interfaces()
        first = "bring it up with" if is_present or name.startswith("vcan") else "plug the adapter in, then"
        return f"{first}: {interfaces.how_to_bring_up(name, config.bitrate, is_present=is_present)}"
    return ""
