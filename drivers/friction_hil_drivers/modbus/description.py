"""Description of a Modbus drive: its register map, read from a YAML file."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from friction_hil.checked_yaml.messages import Mistake
from friction_hil_drivers.modbus.registers import (
    BIT_TABLES,
    BOUNDS,
    WIDTHS,
    WRITABLE_TABLES,
    Kind,
    Order,
    RegisterBlock,
    RegisterField,
    Table,
    merged,
)
from friction_hil_drivers.serial_line.description import Description, Signal

DESCRIPTIONS = Path(__file__).parent / "descriptions"
_LAST_ADDRESS = 0xFFFF


class ModbusSignal(Signal):
    """Value of the drive and the registers that hold it."""

    address: Annotated[int, Field(ge=0, le=_LAST_ADDRESS)] = Field(
        description="address of the first register, as on the wire: from 0 (40001 of older manuals is address 0)"
    )
    function: Table = Field("holding", description="holding or input registers, coils or discrete inputs")
    type: Kind = Field("int16", description="type of the number; bool for coils and discrete inputs")
    word_order: Order | None = Field(None, description="word_order of this signal, if it differs from the drive's")
    byte_order: Order | None = Field(None, description="byte_order of this signal, if it differs from the drive's")

    @property
    def counter_bits(self) -> int | None:
        """Width of the drive's number if that is an integer, which wraps; else None."""
        return None if self.type in ("float32", "bool") else 16 * WIDTHS[self.type]

    @property
    def bounds(self) -> tuple[int, int] | None:
        """Least and greatest number of the drive if its numbers are integers; else None."""
        return BOUNDS.get(self.type)

    @property
    def has_sign(self) -> bool:
        """True if the drive's number can be negative."""
        return self.type in ("int16", "int32", "float32")


class ModbusDescription(Description):
    """Drive that speaks Modbus."""

    protocol: Literal["modbus"]
    signals: dict[str, ModbusSignal]
    word_order: Order | None = Field(None, description="big: the high word of 32 bits has the lower address")
    byte_order: Order = Field("big", description="order of the bytes in a register; big is the standard's")
    write_functions: tuple[Literal[5, 6, 15, 16], ...] = Field(
        (6, 16), min_length=1, description="functions for writing that the drive has"
    )
    read_write_multiple: bool = Field(False, description="the drive has function 23: write and read in one exchange")
    max_read_registers: int = Field(125, ge=2, le=125, description="most registers that one request reads")
    max_write_registers: int = Field(121, ge=2, le=121, description="most registers that one request writes")
    max_gap_registers: int = Field(
        0,
        ge=0,
        le=120,
        description="most unused registers in a row that a request may read; 0 if the drive refuses to read them",
    )
    alignment: Literal[1, 2] = Field(1, description="2: every access begins at an even address and has an even length")
    silence_s: Annotated[float, Field(ge=0.0, le=0.1)] = Field(
        0.0, description="silence before and after each frame if 3.5 characters do not suffice, s"
    )

    def units(self) -> dict[str, Signal]:
        """Return the signals by name."""
        return dict(self.signals)

    def field(self, name: str) -> RegisterField:
        """Return the registers of a signal."""
        signal = self.signals[name]
        word_order = signal.word_order or self.word_order or "big"
        return RegisterField(
            name, signal.function, signal.address, signal.type, word_order, signal.byte_order or self.byte_order
        )

    def read_blocks(self, names: tuple[str, ...]) -> list[RegisterBlock]:
        """Return the fewest blocks of registers that hold the signals."""
        return merged(
            map(self.field, names),
            max_gap=self.max_gap_registers,
            max_count=self.max_read_registers,
            alignment=self.alignment,
        )

    def write_blocks(self, names: tuple[str, ...]) -> list[RegisterBlock]:
        """Return the fewest blocks of registers that hold the signals and no other register."""
        fields = [self.field(name) for name in names]
        blocks: list[RegisterBlock] = []
        for table, joining in (("holding", 16), ("coil", 15)):
            of_table = [field for field in fields if field.table == table]
            max_count = self.max_write_registers if joining in self.write_functions else 1
            blocks += merged(of_table, max_gap=0, max_count=max_count, alignment=self.alignment)
        return blocks

    @property
    def written(self) -> dict[str, None]:
        """Signals that commands, steps or the watchdog write, in the order of their first mention."""
        names = [name for part in self.modes.values() for name in part.commands]
        names += [name for steps in self.sequences.values() for step in steps for name in step.write]
        names += [self.watchdog.signal] if self.watchdog is not None else []
        names += ["control"] if self.state_machine == "cia402" else []
        return dict.fromkeys(name for name in names if name in self.signals)

    def _mistakes(self) -> Iterator[Mistake]:
        yield from super()._mistakes()
        for name, signal in self.signals.items():
            if (signal.type == "bool") != (signal.function in BIT_TABLES):
                text = (
                    f"{name} is {signal.type} in {signal.function}: coils and discrete inputs, and only these, are bool"
                )
                yield ("signals", name), text
            if signal.address + WIDTHS[signal.type] - 1 > _LAST_ADDRESS:
                yield ("signals", name), f"{name} does not end before address FFFFh"
            if WIDTHS[signal.type] == 2 and (signal.word_order or self.word_order) is None:
                text = f"{name} has 32 bits: give word_order (which word comes first differs between drives)"
                yield ("signals", name), text
            if name == "position" and signal.type == "float32" and signal.resolution is None:
                text = "position is a float32: give its resolution, which is the encoder's"
                yield ("signals", name), text
        yield from self._divided_numbers()
        yield from self._writing_mistakes()
        yield from self._scattered_steps(self.write_blocks)

    def _divided_numbers(self) -> Iterator[Mistake]:
        """Yield numbers of 32 bits in which another signal begins."""
        fields = [self.field(name) for name in self.signals]
        for wide in fields:
            for other in fields:
                if other.table == wide.table and wide.address < other.address < wide.end:
                    at = f"at {wide.address:04X}h"
                    yield ("signals", wide.name), f"{wide.name} (2 registers {at}) reaches into {other.name}"

    def _writing_mistakes(self) -> Iterator[Mistake]:
        fields = [self.field(name) for name in self.signals]
        for name in self.written:
            field = self.field(name)
            if field.table not in WRITABLE_TABLES:
                text = f"{name} is written, so it can be a holding register or a coil, not {field.table}"
                yield ("signals", name), text
                continue
            width = field.end - field.address
            joining, single = (15, 5) if field.table == "coil" else (16, 6)
            is_wide = width > 1 or self.alignment > 1
            if joining not in self.write_functions and (is_wide or single not in self.write_functions):
                needed = f"{joining}" if is_wide else f"{single} or {joining}"
                text = f"{name} is written, which takes function {needed}; write_functions does not have it"
                yield ("signals", name), text
            start, end = field.address - field.address % self.alignment, field.end + -field.end % self.alignment
            for other in fields:
                if other.name != name and other.table == field.table and other.address < end and start < other.end:
                    at = f"{other.name} ({other.address:04X}h)"
                    yield ("signals", name), f"writing {name} ({field.address:04X}h) would overwrite {at}"
