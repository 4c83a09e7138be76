"""Content of the files that make a service of the daemon."""

from importlib import resources
from string import Template

UNIT = "friction-hil@.service"
USER = "friction-hil"

# A USB adapter with an FTDI chip holds what it has received for 16 ms unless it is told otherwise, which is longer than
# a cycle of most serial lines. cpu_dma_latency keeps processors out of deep sleep; by default it is root's alone.
UDEV_RULES = f"""\
# Written by: friction-hil service install
ACTION=="add", SUBSYSTEM=="usb-serial", DRIVERS=="ftdi_sio", ATTR{{latency_timer}}="1"
KERNEL=="cpu_dma_latency", GROUP="{USER}", MODE="0660"
"""

SYSUSERS = f"""\
# Written by: friction-hil service install
u {USER} - "friction_hil daemon" /var/lib/{USER}
m {USER} dialout
"""


def unit(executable: str, configurations: str) -> str:
    """Return the template of the unit.

    ``executable``: absolute path of the command ``friction-hil``. ``configurations``: their directory, one folder for
    each service.
    """
    text = resources.files(__package__).joinpath(UNIT).read_text(encoding="utf-8")
    return Template(text).substitute(executable=executable, configurations=configurations)


def network_device(interface: str) -> str:
    """Return the unit of a network interface such as ``can0``; see systemd.device(5)."""
    return f"sys-subsystem-net-devices-{escape(interface)}.device"


def file_device(path: str) -> str:
    """Return the unit of a device file such as ``/dev/ttyUSB0``; see systemd.device(5)."""
    return f"{escape(path.strip('/'))}.device"


def escape(name: str) -> str:
    r"""Escape a name, or a path without its first slash, as systemd-escape(1) does: ``a/b-c`` to ``a-b\x2dc``."""
    text = "".join(
        "-" if each == "/" else each if _is_plain(each) else "".join(f"\\x{byte:02x}" for byte in each.encode())
        for each in name
    )
    return "\\x2e" + text[1:] if text.startswith(".") else text


def _is_plain(character: str) -> bool:
    return character.isascii() and (character.isalnum() or character in ":_.")


def drop_in(devices: list[str]) -> str:
    """Return the drop-in of one service: it starts after its devices, and stops when one of them goes."""
    lines = [f"BindsTo={each}\nAfter={each}\n" for each in devices]
    return "# Written by: friction-hil service install\n[Unit]\n" + "".join(lines)
