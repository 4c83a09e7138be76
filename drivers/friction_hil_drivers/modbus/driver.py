"""Driver for Modbus RTU and TCP: exchanges of a cycle on one line, and the drive port."""

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any, ClassVar

from friction_hil_drivers.modbus.codec import ModbusExchange
from friction_hil_drivers.modbus.description import DESCRIPTIONS, ModbusDescription
from friction_hil_drivers.modbus.framing import Framing, RtuFraming, TcpFraming
from friction_hil_drivers.modbus.options import ModbusOptions
from friction_hil_drivers.modbus.registers import RegisterBlock
from friction_hil_drivers.serial_line.drives import SerialDrives
from friction_hil_drivers.serial_line.protocol import CycleSignals, Image, Plan, only
from friction_hil_drivers.serial_line.wire import character_s

_SILENCE_CHARS = 3.5


class ModbusLine:
    """Modbus exchanges with the axes on one line; see `LineProtocol`."""

    def __init__(
        self,
        descriptions: Mapping[str, ModbusDescription],
        options: Mapping[str, ModbusOptions],
        images: Mapping[str, Image],
    ) -> None:
        self._descriptions = descriptions
        self._options = options
        self._images = images
        line = next(iter(options.values())).line
        self._framing: Framing = TcpFraming() if line.is_tcp else RtuFraming()
        silence_s = max(description.silence_s for description in descriptions.values())
        self.numbers_replies = line.is_tcp
        self.names_drives = True
        self.reply_form, self.show = self._framing.reply_form, self._framing.show
        self.ahead_chars = 0
        self.silence_chars = 0.0 if line.is_tcp else max(_SILENCE_CHARS, silence_s / character_s(line))

    def plan(self, wanted: Mapping[str, CycleSignals]) -> Plan:
        """Plan a cycle with as few requests as possible, for the axes by name.

        Slow signals are read with the fast ones if that costs no request. If the drive has function 23, the poll writes
        all commands: each block with a block that is read, and blocks that are left over in requests of their own,
        so that all commands of one computation are written in the same cycle.
        """
        poll: list[ModbusExchange] = []
        background: list[ModbusExchange] = []
        push: list[ModbusExchange] = []
        for axis, needs in wanted.items():
            description = self._descriptions[axis]
            fast, slow = _reads(description, needs)
            writes = description.write_blocks(needs.commands)
            background += [self._request(axis, read=block) for block in slow]
            joining = [block for block in fast if block.table == "holding"] if description.read_write_multiple else []
            if writes and joining and all(block.table == "holding" for block in writes[: len(joining)]):
                poll += [self._request(axis, read=r, write=w) for r, w in zip_longest(joining, writes)]
                poll += [self._request(axis, read=block) for block in fast if block not in joining]
            else:
                poll += [self._request(axis, read=block) for block in fast]
                push += [self._request(axis, write=block) for block in writes]
        return Plan(tuple(poll), tuple(background), tuple(push))

    def read(self, axis: str, names: Sequence[str]) -> ModbusExchange:
        """Return the exchange that reads some signals of an axis.

        Raises `ValueError`: one request cannot read them all.
        """
        return self._request(axis, read=only(self._descriptions[axis].read_blocks(tuple(names)), "read", names))

    def write(self, axis: str, names: Sequence[str]) -> ModbusExchange:
        """Return the exchange that writes some signals of an axis.

        Raises `ValueError`: one request cannot write them all.
        """
        return self._request(axis, write=only(self._descriptions[axis].write_blocks(tuple(names)), "write", names))

    def reboot(self, axis: str) -> None:
        """See `LineProtocol`: there is no request for it."""

    def _request(
        self, axis: str, read: RegisterBlock | None = None, write: RegisterBlock | None = None
    ) -> ModbusExchange:
        return ModbusExchange(
            self._framing,
            self._options[axis].unit,
            self._images[axis],
            read=read,
            write=write,
            write_functions=self._descriptions[axis].write_functions,
        )


def _reads(description: ModbusDescription, needs: CycleSignals) -> tuple[list[RegisterBlock], list[RegisterBlock]]:
    """Return the blocks that every cycle reads, and the blocks of the background reads."""
    slow_names = tuple(name for name in needs.slow if name not in needs.fast)
    together = description.read_blocks((*needs.fast, *slow_names))
    fast = [block for block in together if not set(block.names).isdisjoint(needs.fast)]
    if len(fast) > len(description.read_blocks(needs.fast)):  # slow signals filled a block
        return description.read_blocks(needs.fast), description.read_blocks(slow_names)
    return fast, [block for block in together if block not in fast]


class ModbusDrives(SerialDrives):
    """Drives with Modbus RTU or TCP."""

    Options = ModbusOptions
    description_type = ModbusDescription
    descriptions = DESCRIPTIONS
    protocol = ModbusLine
    address_key = "unit"
    simulated: ClassVar[Mapping[str, Any]] = {
        "description": "generic_cia402",
        "counts_per_unit": 166886.05,
        "rated_torque": 0.64,
        "baud": 230400,
    }
