"""Driver for Dynamixel Protocol 2.0: exchanges of a cycle on one line, and the drive port."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from friction_hil_drivers.dynamixel.codec import Member, Order, Read, Reboot, SyncWrite, Write, alike, read_exchange
from friction_hil_drivers.dynamixel.description import DESCRIPTIONS, DynamixelDescription
from friction_hil_drivers.dynamixel.options import DynamixelOptions
from friction_hil_drivers.dynamixel.packets import Packets
from friction_hil_drivers.serial_line.drives import SerialDrives
from friction_hil_drivers.serial_line.protocol import CycleSignals, Image, Plan, in_hex, only


class DynamixelLine:
    """Dynamixel exchanges with the axes on one line; see `LineProtocol`.

    Raises `UsageError`: the vendor's SDK is not installed.
    """

    numbers_replies = False
    names_drives = True
    ahead_chars = 0
    reply_form = "a packet begins with ff ff fd 00 and ends in a CRC-16"
    show = staticmethod(in_hex)
    silence_chars = 0.0  # packets begin with a header and need no silence between them

    def __init__(
        self,
        descriptions: Mapping[str, DynamixelDescription],
        options: Mapping[str, DynamixelOptions],
        images: Mapping[str, Image],
    ) -> None:
        self._packets = Packets()
        self._order = Order()
        self._descriptions = descriptions
        self._options = options
        self._images = images

    def plan(self, wanted: Mapping[str, CycleSignals]) -> Plan:
        """Plan a cycle: one request reads or writes the items that several servos have at the same addresses.

        Slow signals are read with the fast ones if they lie beside them, else by background reads.
        """
        fast: list[Member] = []
        slow: list[Member] = []
        commands: list[Member] = []
        for axis, needs in wanted.items():
            for member in self._members(axis, (*needs.fast, *needs.slow)):
                is_fast = any(item.name in needs.fast for item in member.block.items)
                (fast if is_fast else slow).append(member)
            commands += self._members(axis, needs.commands)
        poll = tuple(read_exchange(self._packets, group, self._order) for group in alike(fast))
        background = tuple(read_exchange(self._packets, group, self._order) for group in alike(slow))
        return Plan(poll, background, tuple(SyncWrite(self._packets, group) for group in alike(commands)))

    def read(self, axis: str, names: Sequence[str]) -> Read:
        """Return the exchange that reads some signals of an axis.

        Raises `ValueError`: one request cannot read them all.
        """
        return Read(self._packets, [only(self._members(axis, names), "read", names)], self._order)

    def write(self, axis: str, names: Sequence[str]) -> Write:
        """Return the exchange that writes some signals of an axis.

        Raises `ValueError`: one request cannot write them all.
        """
        return Write(self._packets, only(self._members(axis, names), "write", names))

    def reboot(self, axis: str) -> Reboot:
        """Return the exchange that restarts the servo of an axis: it ends a hardware error."""
        (member, *_) = self._members(axis, ("position",))
        return Reboot(self._packets, member)

    def _members(self, axis: str, names: Sequence[str]) -> list[Member]:
        servo, image, description = self._options[axis].id, self._images[axis], self._descriptions[axis]
        return [Member(servo, image, block, description.fast_sync_read) for block in description.blocks(names)]


class DynamixelDrives(SerialDrives):
    """Servos with Dynamixel Protocol 2.0."""

    Options = DynamixelOptions
    description_type = DynamixelDescription
    descriptions = DESCRIPTIONS
    protocol = DynamixelLine
    address_key = "id"
    simulated: ClassVar[Mapping[str, Any]] = {
        "description": "xl330",
        "counts_per_unit": 651.9,
        "torque_constant": 0.146,
        "baud": 1_000_000,
    }
