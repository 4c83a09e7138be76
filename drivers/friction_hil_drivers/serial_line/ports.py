"""Serial ports of a machine, as its kernel lists them; none is opened.

Functions take the root of the file system, so that a test can give them another machine's files.
"""

import contextlib
import os
import re
from collections.abc import Iterator
from pathlib import Path

from friction_hil.drive.finding import Finding, system_text

_ROOT = Path("/")
_GOOD_LATENCY_MS = 1
_USUAL_GROUPS = ("dialout", "uucp")
_PSEUDO_TERMINAL = re.compile(r"/dev/pts/(\d+)")


def serial_ports(root: Path = _ROOT) -> list[str]:
    """Return the devices of the serial ports of this machine: ``/dev/ttyUSB0``."""
    return [
        f"/dev/{entry.name}"
        for entry in sorted(root.glob("sys/class/tty/*"))
        # consoles have no device; a port that the kernel reserves without hardware has type 0
        if (entry / "device").exists() and system_text(entry / "type") != "0"
    ]


def name_of(port: str) -> str:
    """Return the kernel's name of a port or of a link to it: ``ttyUSB0``."""
    return Path(port).resolve().name


def latency_s(name: str, root: Path = _ROOT) -> float | None:
    """Return the time by which the USB adapter ``name`` delays short replies, s; None if it has no timer."""
    text = system_text(_timer(name, root))
    return 1e-3 * int(text) if text and text.isdecimal() else None


def latency(name: str, root: Path = _ROOT) -> Finding | None:
    """Check the latency timer of the USB adapter ``name``; None if it has none."""
    held_s = latency_s(name, root)
    if held_s is None:
        return None
    check, latency_ms = f"latency of {name}", round(1e3 * held_s)
    detail = f"the USB adapter {name} holds short replies back for {latency_ms} ms"
    if latency_ms <= _GOOD_LATENCY_MS:
        return Finding(check, "pass", detail)
    return Finding(check, "warn", detail, f"as root: echo {_GOOD_LATENCY_MS} > {_timer(name, _ROOT)}", "FH-415")


def _timer(name: str, root: Path) -> Path:
    return root / "sys/bus/usb-serial/devices" / name / "latency_timer"


def permission_remedy(device: Path | None = None) -> str:
    """Return the remedy for a missing permission to open a port; it names the group of ``device``."""
    import grp  # imported here: Windows has none, and configurations are checked there too

    group = _USUAL_GROUPS[0]
    with contextlib.suppress(OSError, KeyError):
        if device is not None:
            group = grp.getgrgid(device.stat().st_gid).gr_name
    if group == "root":
        return f"let a udev rule give {device} to the group {_USUAL_GROUPS[0]}, and add the user to it"
    return f"add the user to the group {group} (and log in again)"


def check_machine(root: Path) -> Iterator[Finding]:
    """Report the serial ports, the permission to open them, and settings that slow them down."""
    devices = serial_ports(root)
    missing = [device for device in devices if not (root / device.removeprefix("/")).exists()]
    if missing:  # a container sees the host's kernel, not its devices
        detail = f"{', '.join(devices)}; but /dev has no {', '.join(missing)}"
        yield Finding("serial ports", "warn", detail, f"a container needs --device {missing[0]}", "FH-411")
    elif devices:
        yield Finding("serial ports", "pass", ", ".join(devices))
    else:
        yield Finding(
            "serial ports",
            "warn",
            "none, which only drives on serial lines need",
            "plug the adapter in (a container needs --device /dev/ttyUSB0); dmesg shows whether it was recognised",
            "FH-412",
        )
    yield _permission([root / device.removeprefix("/") for device in devices if device not in missing])
    for device in devices:
        if (found := latency(name_of(device), root)) is not None:
            yield found


def _permission(devices: list[Path]) -> Finding:
    import grp  # imported here: Windows has none, and configurations are checked there too

    check = "right to open serial ports"
    closed = [device for device in devices if not os.access(device, os.R_OK | os.W_OK)]
    if closed:
        listed = ", ".join(f"/dev/{device.name}" for device in closed)
        return Finding(check, "warn", f"permission denied: {listed}", permission_remedy(closed[0]), "FH-413")
    if devices:
        return Finding(check, "pass", "the user may open all of them")
    if os.geteuid() == 0:
        return Finding(check, "pass", "the user is root")
    groups = {entry.gr_name for entry in grp.getgrall() if entry.gr_gid in (*os.getgroups(), os.getegid())}
    own = [group for group in _USUAL_GROUPS if group in groups]
    if own:
        return Finding(check, "pass", f"the user is in the group {own[0]}")
    return Finding(check, "warn", "the user is not in the group dialout", permission_remedy(), "FH-414")


def holders(port: str) -> list[str]:
    """Return the processes that have a port open, as far as this user may see them: ``process 4711, minicom``.

    A process with the other end of a pseudo-terminal is a drive, not another master.
    """
    device = os.path.realpath(port)
    pseudo = _PSEUDO_TERMINAL.fullmatch(device)
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has ended, or belongs to another user
            opened = {entry.name: os.readlink(entry) for entry in (process / "fd").iterdir()}
            if device in opened.values() and not (pseudo and _has_master(process, opened, pseudo[1])):
                found.append(f"process {process.name}, {system_text(process / 'comm') or 'unknown'}")
    return found


def _has_master(process: Path, opened: dict[str, str], index: str) -> bool:
    """Return True if a process has the other end of the pseudo-terminal number ``index``."""
    masters = [number for number, target in opened.items() if target.endswith("/ptmx")]
    info = [system_text(process / "fdinfo" / number) or "" for number in masters]
    return any(re.search(rf"^tty-index:\s*{index}$", text, re.MULTILINE) for text in info)
