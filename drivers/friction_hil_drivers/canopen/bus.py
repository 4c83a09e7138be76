"""Opening the CAN bus, for the drives and for their simulated counterparts."""

import logging
import socket
from typing import TYPE_CHECKING, Any

from friction_hil.errors import BusError, UsageError, choices
from friction_hil_drivers.canopen import interfaces

if TYPE_CHECKING:
    import can

    from friction_hil.config import BusConfig

_WITHOUT_BITRATE = ("udp_multicast", "virtual", "socketcan")

# What these libraries log, Python prints where nobody handles it; our own errors say it, once and in full.
for _library in ("can", "canopen"):
    logging.getLogger(_library).addHandler(logging.NullHandler())


def bus_name(config: "BusConfig") -> str:
    """Name of a bus for people: ``udp_multicast 239.74.163.2:43113``."""
    port = "" if config.port is None else f":{config.port}"
    return f"{config.interface} {config.channel}{port}"


def open_bus(config: "BusConfig") -> "can.BusABC":
    """Open the bus that the configuration names.

    Note what a caller has to expect of python-can: udp_multicast delivers a node's own frames to itself, and
    every interface delivers frames that are addressed to nobody here.

    Raises
    ------
    BusError
        It does not open; the message says what to do about it.
    UsageError
        python-can has no such interface.
    """
    import can

    require_known(config)
    arguments: dict[str, Any] = dict(config.further)
    if config.port is not None:
        arguments["port"] = config.port
    if config.hop_limit is not None:
        arguments["hop_limit"] = config.hop_limit
    if config.bitrate is not None and config.interface not in _WITHOUT_BITRATE:
        arguments["bitrate"] = config.bitrate
    if config.interface == "udp_multicast":
        arguments["fd"] = False
    try:
        if config.interface == "udp_multicast":
            _require_route(str(config.channel), config.port or 0)
        elif config.interface == "socketcan":
            _require_interface(str(config.channel))
        # ignore_config: a ~/.canrc must not change what the configuration file says
        return can.Bus(interface=config.interface, channel=config.channel, ignore_config=True, **arguments)
    except (can.CanError, OSError, ValueError, TypeError, ImportError) as error:
        reason = str(error) or type(error).__name__
        raise BusError(f"the bus {bus_name(config)} does not open: {reason}", advice(config)) from error


def require_known(config: "BusConfig") -> None:
    """See that python-can has the interface.

    Raises
    ------
    UsageError
        It has not; the message has those that there are.
    """
    from can.interfaces import VALID_INTERFACES

    if config.interface not in VALID_INTERFACES:
        raise UsageError(
            f"bus.interface: python-can has no interface {config.interface!r}",
            choices(config.interface, VALID_INTERFACES),
        )


def _require_route(group: str, port: int) -> None:
    """Fail early where multicast frames would have nowhere to go; python-can notices only when sending."""
    family, _, _, _, address = socket.getaddrinfo(group, port or 1, type=socket.SOCK_DGRAM)[0]
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect(address)


def _require_interface(name: str) -> None:
    """Fail early where a CAN interface is down; the kernel lets it be opened and then delivers nothing."""
    if name not in (each for _, each in socket.if_nameindex()):
        there = ", ".join(interfaces.there()) or "none"
        raise OSError(f"there is no interface {name}; CAN interfaces of this machine: {there}")
    if interfaces.is_up(name) is False:
        raise OSError(f"the interface {name} is down")


def advice(config: "BusConfig") -> str:
    """Say what to do about a bus that does not open; nothing where that is not known."""
    if config.interface == "udp_multicast":
        return "where only the loopback interface is up, give multicast a route: ip route add 239.0.0.0/8 dev lo"
    if config.interface == "socketcan":
        name = str(config.channel)
        is_there = name in interfaces.there()
        first = "bring it up with" if is_there or name.startswith("vcan") else "plug the adapter in, then"
        return f"{first}: {interfaces.how_to_bring_up(name, config.bitrate, is_there=is_there)}"
    return ""
