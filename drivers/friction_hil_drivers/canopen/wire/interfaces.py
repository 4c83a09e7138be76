"""CAN interfaces of a machine, as its kernel reports them; no interface is opened.

Functions take the root of the file system, so that a test can imitate a machine with a folder.
"""

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.drive.finding import NOT_REPORTED, Finding, system_text

if TYPE_CHECKING:
    from friction_hil.config import BusConfig

_ROOT = Path("/")
_ARPHRD_CAN = "280"
_IFF_UP = 1
_USUAL_BITRATE = 1_000_000
_IP_TIMEOUT_S = 5.0
_SICK_STATES = ("ERROR-WARNING", "ERROR-PASSIVE")
_DEAD_STATE = "BUS-OFF"


@dataclass(frozen=True, slots=True)
class Link:
    """Properties of a CAN interface as ``ip`` reports them; empty or None where it does not."""

    kind: str = ""  # can, vcan, slcan
    bitrate: int | None = None  # bit/s
    state: str = ""  # of the controller: ERROR-ACTIVE is the good one


def bus_name(config: "BusConfig") -> str:
    """Return the name of a bus for messages: ``udp_multicast 239.74.163.2:43113``."""
    port = "" if config.port is None else f":{config.port}"
    return f"{config.interface} {config.channel}{port}"


def can_interfaces(root: Path = _ROOT) -> list[str]:
    """Return the names of the CAN interfaces."""
    types = sorted(root.glob("sys/class/net/*/type"))
    return [file.parent.name for file in types if system_text(file) == _ARPHRD_CAN]


def is_up(name: str, root: Path = _ROOT) -> bool | None:
    """True if an interface is up; None where the system does not report it."""
    flags = system_text(root / "sys/class/net" / name / "flags")
    return None if flags is None else bool(int(flags, 16) & _IFF_UP)


def how_to_bring_up(name: str, bitrate: int | None, *, is_present: bool = True) -> str:
    """Return the command that brings an interface up; a virtual one that does not exist is created first."""
    if name.startswith("vcan"):
        made = "" if is_present else f"ip link add dev {name} type vcan && "
        return f"{made}ip link set {name} up"
    return f"ip link set {name} up type can bitrate {bitrate or _USUAL_BITRATE}"


def ask_ip(name: str) -> Link:
    """Ask the program ``ip`` for an interface: the kernel's files have no bit rate."""
    program = shutil.which("ip", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")
    if program is None:
        return Link()
    words = [program, "-json", "-details", "link", "show", "dev", name]
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=_IP_TIMEOUT_S)
    except (OSError, subprocess.TimeoutExpired):
        return Link()
    return parse(done.stdout)


def parse(text: str) -> Link:
    """Parse the JSON that ``ip -json -details link show`` prints for one interface."""
    try:
        info = json.loads(text)[0]["linkinfo"]
        data = info.get("info_data", {})
        # an adapter with a fixed set of bit rates has it under another key
        bitrate = data.get("bittiming", {}).get("bitrate") or data.get("bittiming_bitrate")
        return Link(str(info.get("info_kind", "")), bitrate, str(data.get("state", "")))
    except (ValueError, LookupError, TypeError, AttributeError):
        return Link()


def check_machine(root: Path, ask: Callable[[str], Link] = ask_ip) -> Iterator[Finding]:
    """Yield the state of each CAN interface."""
    names = can_interfaces(root)
    if not names:
        detail = "none; only CANopen drives on SocketCAN need one"
        fix = f"plug the adapter in; to try one: modprobe vcan && {how_to_bring_up('vcan0', None, is_present=False)}"
        yield Finding("CAN interfaces", "warn", detail, fix, "FH-431")
    for name in names:
        found = check_interface(name, ask(name), None, root)
        # no configuration needs it yet
        yield replace(found, result="warn") if found.result == "fail" else found


def check_interface(name: str, link: Link, bitrate: int | None, root: Path = _ROOT) -> Finding:
    """Return the state of an interface; ``bitrate`` is that of the configuration, None for none."""
    check = f"CAN interface {name}"
    if not is_up(name, root):
        return Finding(check, "warn", "it is down", how_to_bring_up(name, link.bitrate or bitrate), "FH-432")
    if link.state == _DEAD_STATE:
        detail = "BUS-OFF: the controller left the bus after too many errors"
        fix = f"check wires and bit rate; then: ip link set {name} type can restart"
        return Finding(check, "fail", detail, fix, "FH-433")
    if bitrate and link.bitrate and link.bitrate != bitrate:
        detail = f"it runs at {link.bitrate} bit/s, the configuration says {bitrate}"
        fix = f"correct bus.bitrate, or: ip link set {name} down && {how_to_bring_up(name, bitrate)}"
        return Finding(check, "fail", detail, fix, "FH-434")
    facts = ["up"]
    if link.kind != "vcan":
        facts.append(f"{link.bitrate} bit/s" if link.bitrate else f"bit rate {NOT_REPORTED}")
    facts += [link.state] if link.state else []
    detail = ", ".join(facts)
    if link.state in _SICK_STATES:
        fix = "check the wires, the terminating resistors and the bit rate of all nodes"
        return Finding(check, "warn", detail, fix, "FH-435")
    if link.kind != "vcan" and link.bitrate is None:
        fix = f"install iproute2, then compare: ip -details link show {name}"
        return Finding(check, "warn", detail, fix, "FH-436")
    return Finding(check, "pass", detail)
