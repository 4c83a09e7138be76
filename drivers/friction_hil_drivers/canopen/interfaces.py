"""The CAN interfaces of a machine, as its kernel tells them; nothing is opened for it.

Functions take the root of the file system, so that a test can lay out a machine of its own.
"""

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from friction_hil.drive.finding import NOT_TOLD, Finding, system_text

_ROOT = Path("/")
_ARPHRD_CAN = "280"
_IFF_UP = 1
_USUAL_BITRATE = 1_000_000
_IP_TIMEOUT_S = 5.0
_SICK_STATES = ("ERROR-WARNING", "ERROR-PASSIVE")
_DEAD_STATE = "BUS-OFF"


@dataclass(frozen=True, slots=True)
class Link:
    """What ``ip`` tells of a CAN interface; empty or None where it does not."""

    kind: str = ""  # can, vcan, slcan
    bitrate: int | None = None  # bit/s
    state: str = ""  # of the controller: ERROR-ACTIVE is the good one


def there(root: Path = _ROOT) -> list[str]:
    """Names of the CAN interfaces."""
    types = sorted(root.glob("sys/class/net/*/type"))
    return [file.parent.name for file in types if system_text(file) == _ARPHRD_CAN]


def is_up(name: str, root: Path = _ROOT) -> bool | None:
    """Whether an interface is up; None where the system does not tell."""
    flags = system_text(root / "sys/class/net" / name / "flags")
    return None if flags is None else bool(int(flags, 16) & _IFF_UP)


def how_to_bring_up(name: str, bitrate: int | None, *, is_there: bool = True) -> str:
    """Command that makes an interface usable; a virtual one that is not there is made first."""
    if name.startswith("vcan"):
        made = "" if is_there else f"ip link add dev {name} type vcan && "
        return f"{made}ip link set {name} up"
    return f"ip link set {name} up type can bitrate {bitrate or _USUAL_BITRATE}"


def ask_ip(name: str) -> Link:
    """Ask the program ``ip``, because the kernel's files have no bit rate."""
    path = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
    program = shutil.which("ip", path=path)
    if program is None:
        return Link()
    words = [program, "-json", "-details", "link", "show", "dev", name]
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=_IP_TIMEOUT_S)
    except (OSError, subprocess.TimeoutExpired):
        return Link()
    return parse(done.stdout)


def parse(text: str) -> Link:
    """Understand the JSON that ``ip -json -details link show`` prints of one interface."""
    try:
        info = json.loads(text)[0]["linkinfo"]
        data = info.get("info_data", {})
        # an adapter with a fixed set of bit rates tells it otherwise
        bitrate = data.get("bittiming", {}).get("bitrate") or data.get("bittiming_bitrate")
        return Link(str(info.get("info_kind", "")), bitrate, str(data.get("state", "")))
    except (ValueError, LookupError, TypeError, AttributeError):
        return Link()


def check_machine(root: Path, ask: Callable[[str], Link] = ask_ip) -> Iterator[Finding]:
    """Tell which CAN interfaces there are, and how they are."""
    names = there(root)
    if not names:
        yield Finding(
            "CAN interfaces",
            "warn",
            "none, which only CANopen drives on SocketCAN need",
            f"plug the adapter in; for a try: modprobe vcan && {how_to_bring_up('vcan0', None, is_there=False)}",
        )
    for name in names:
        found = check_interface(name, ask(name), None, root)
        yield replace(found, result="warn") if found.result == "fail" else found  # nobody needs it yet


def check_interface(name: str, link: Link, bitrate: int | None, root: Path = _ROOT) -> Finding:
    """Tell how an interface is, beside the ``bitrate`` that a configuration says of it."""
    check = f"CAN interface {name}"
    if not is_up(name, root):
        return Finding(check, "warn", "it is down", how_to_bring_up(name, link.bitrate or bitrate))
    if link.state == _DEAD_STATE:
        detail = "BUS-OFF: after too many errors the controller takes no part in the bus"
        return Finding(check, "fail", detail, f"see to wires and bit rate; then: ip link set {name} type can restart")
    if bitrate and link.bitrate and link.bitrate != bitrate:
        return Finding(
            check,
            "fail",
            f"it runs at {link.bitrate} bit/s, the configuration says {bitrate}",
            f"correct bus.bitrate, or: ip link set {name} down && {how_to_bring_up(name, bitrate)}",
        )
    facts = ["up"]
    if link.kind != "vcan":
        facts.append(f"{link.bitrate} bit/s" if link.bitrate else f"bit rate {NOT_TOLD}")
    facts += [link.state] if link.state else []
    detail = ", ".join(facts)
    if link.state in _SICK_STATES:
        return Finding(check, "warn", detail, "see to wires, terminating resistors and the bit rate of all nodes")
    if link.kind != "vcan" and link.bitrate is None:
        return Finding(check, "warn", detail, f"install iproute2, and compare: ip -details link show {name}")
    return Finding(check, "pass", detail)
