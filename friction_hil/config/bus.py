"""Configuration of the CAN bus."""

import ipaddress
import math
import re
from collections.abc import Iterator
from typing import Any, Literal, Self

from pydantic import ConfigDict, model_validator

from friction_hil.checked_yaml.messages import Mistake, refuse, show
from friction_hil.checked_yaml.section import Section, key
from friction_hil.errors import choices

# Interfaces whose keys are all known, with their keys besides interface and channel.
_BUS_KEYS = {
    "udp_multicast": ("port", "hop_limit", "bitrate"),
    "virtual": ("bitrate",),
    "socketcan": ("bitrate",),
    "slcan": ("bitrate",),
}
# Identifiers that CiA 301 lets no object have, because they belong to NMT, SDO, LSS and heartbeats of the nodes
_RESERVED = (
    range(0x80),
    range(0x101, 0x181),
    range(0x581, 0x600),
    range(0x601, 0x680),
    range(0x6E0, 0x700),
    range(0x701, 0x800),
)
MULTICAST = "239.74.163.2"  # of the examples


class BusConfig(Section):
    """A CAN bus of python-can."""

    # further keys of other interfaces are passed to python-can unchanged
    model_config = ConfigDict(extra="allow")

    interface: str = key("interface of python-can: socketcan, slcan, udp_multicast, virtual, pcan, kvaser, ...")
    channel: int | str = key("channel of the interface: can0, /dev/ttyACM0, 239.74.163.2, ...")
    role: Literal["master", "sidecar"] = key(
        "master: the daemon moves the drives. sidecar: another controller does, and the daemon only listens and adds "
        "the compensation as torque offset",
        default="master",
    )
    sync_cob_id: int = key(
        "identifier of SYNC (1005h): a master sends it, and sets drives that have another; a sidecar locks to it",
        default=0x80,
        ge=1,
        le=0x7FF,
    )
    bitrate: int | None = key(
        "bit rate, used to compute the bus load; for socketcan the rate set by 'ip link'",
        "bit/s",
        default=None,
        ge=1_000,
        le=20_000_000,
    )
    port: int | None = key("UDP port of udp_multicast", default=None, ge=1, le=65535)
    hop_limit: int | None = key(
        "number of routers that udp_multicast may pass; 0: only this machine", default=None, ge=0, le=255
    )

    @model_validator(mode="before")
    @classmethod
    def _stay_on_this_machine(cls, value: Any) -> Any:
        if isinstance(value, dict) and value.get("interface") == "udp_multicast":
            return {**value, "hop_limit": 0 if value.get("hop_limit") is None else value["hop_limit"]}
        return value

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(self, _mistakes(self))
        return self

    @property
    def further(self) -> dict[str, Any]:
        """Keys that are not declared here, for python-can."""
        return dict(self.model_extra or {})


def _mistakes(bus: BusConfig) -> Iterator[Mistake]:
    """Check the given keys against those of the interface."""
    for name, value in bus.further.items():
        if isinstance(value, dict | list):
            yield (name,), "must be a single value, because it is passed to python-can unchanged"
        elif isinstance(value, float) and not math.isfinite(value):
            yield (name,), f"must be a finite number, not {show(value)}"
    if bus.role == "master" and any(bus.sync_cob_id in identifiers for identifiers in _RESERVED):
        yield ("sync_cob_id",), f"must not be {bus.sync_cob_id:#x}: CiA 301 reserves that for NMT, SDO or heartbeats"
    yield from _channel_mistakes(bus)
    allowed = _BUS_KEYS.get(bus.interface)
    if allowed is None:
        return
    for name in bus.further:
        yield (name,), f"is not a key here; {choices(name, ('interface', 'channel', 'role', *allowed))}"
    for name in ("bitrate", "port", "hop_limit"):
        if getattr(bus, name) is not None and name not in allowed:
            yield (name,), f"has no meaning for the interface {bus.interface}: remove it"


def _channel_mistakes(bus: BusConfig) -> Iterator[Mistake]:
    """Check that the channel is of the kind that the interface has."""
    try:
        address = ipaddress.ip_address(bus.channel) if isinstance(bus.channel, str) else None
    except ValueError:
        address = None
    if bus.interface == "udp_multicast" and (address is None or not address.is_multicast):
        text = f"must be a multicast address such as {MULTICAST}, not {show(bus.channel)}"
        is_can = isinstance(bus.channel, str) and re.fullmatch(r"v?s?l?can[0-9]+", bus.channel)
        yield ("channel",), f"{text}; {bus.channel} is a channel of interface: socketcan" if is_can else text
    elif bus.interface == "socketcan" and address is not None:
        yield ("channel",), f"must be a CAN interface such as can0; {bus.channel} is one for interface: udp_multicast"
    elif bus.interface == "socketcan" and not isinstance(bus.channel, str):
        yield ("channel",), f"must be the name of a CAN interface such as can0, not {show(bus.channel)}"
