"""Options that all serial drivers have in common: the keys of an axis and of its line."""

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from friction_hil.drive.driver import OptionChecks
from friction_hil_drivers.serial_line.units import AxisUnits
from friction_hil_drivers.torque_sign import INVERTED_TORQUE, InvertedTorque

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, BusConfig

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
_MOST_COUNTS = 1e15  # per rad or m; with the next one far beyond any drive
_MOST_TORQUE = 1e7  # N m or N
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
TCP = "tcp://"


def tcp_address(port: str) -> tuple[str, int]:
    """Return host and port number of ``tcp://HOST:PORT``. Raises `ValueError`: the text has another form."""
    host, _, number = port.removeprefix(TCP).rpartition(":")
    if not (port.startswith(TCP) and host and number.isascii() and number.isdigit() and 0 < int(number) < 0x10000):
        raise ValueError(f"is no {TCP}HOST:PORT, e.g. {TCP}192.168.0.5:502")
    return host.strip("[]"), int(number)


class LineOptions(BaseModel):
    """Serial line or TCP connection; the keys must be equal for all axes on one line."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field(min_length=1, description="device (/dev/ttyUSB0) or tcp://HOST:PORT")
    baud: int = Field(115200, ge=300, le=20_000_000, description="bits per second")
    parity: Literal["none", "even", "odd"] = Field("none", description="parity bit")
    stop_bits: Literal[1, 2] = Field(1, description="stop bits")
    is_rs485: bool = Field(False, description="let the kernel switch the direction of an RS-485 line by RTS")
    turnaround_s: NotNegative = Field(
        0.0, le=0.1, description="time that the drive needs to answer, without the time on the wire, s"
    )
    reply_limit_s: Positive | None = Field(
        None,
        le=5.0,
        description="time after which an outstanding reply cannot come any more, s; by default 0.05, or 0.4 times the "
        "duration of realtime.max_missed periods if that is shorter",
    )

    @field_validator("port")
    @classmethod
    def _can_be_opened(cls, port: str) -> str:
        if not port.isprintable():
            raise ValueError("must be printable: the path of a device, or tcp://HOST:PORT")
        if "://" in port:
            tcp_address(port)
        return port

    @property
    def is_tcp(self) -> bool:
        """True if the line is a TCP connection."""
        return self.port.startswith(TCP)

    @property
    def bits_per_character(self) -> int:
        """Number of bits of a byte on the wire."""
        return 9 + (self.parity != "none") + self.stop_bits


class SerialOptions(BaseModel, OptionChecks):
    """Options of an axis on a serial line."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    line: LineOptions
    description: str = Field(
        min_length=1, description="name of a description that comes with the driver, or path of a YAML file"
    )
    counts_per_unit: Positive | None = Field(
        None, le=_MOST_COUNTS, description="position counts per rad of the motor (per m)"
    )
    rated_torque: Positive | None = Field(
        None, le=_MOST_TORQUE, description="torque at 100 %, N m (N on a linear axis)"
    )
    torque_constant: Positive | None = Field(
        None, le=_MOST_TORQUE, description="N m (N) per ampere, if the drive uses current instead of torque"
    )
    is_inverted: bool = Field(False, description="true to reverse the sign of position, velocity and torque")
    inverted_torque: InvertedTorque = Field("none", description=INVERTED_TORQUE)
    setpoint_delay_cycles: NotNegative | None = Field(
        None,
        le=10.0,
        description="periods from sending a set-point until the drive's demand reaches it; by default the delay of the "
        "exchange and of a drive that interpolates (csp 1.5, csv 1); give 1 less (csp) or 0.5 less (csv) for a drive "
        "that does not interpolate",
    )
    watchdog_s: Positive | None = Field(
        None, le=10.0, description="time after which the drive drops its torque; 20 periods, at least 0.1 s, by default"
    )
    is_watchdog_required: bool = Field(True, description="true to refuse a drive without a communication watchdog")

    @property
    def units(self) -> AxisUnits:
        """Units of the axis; NaN for those that are not given."""
        given = (self.counts_per_unit, self.rated_torque, self.torque_constant)
        return AxisUnits(*(math.nan if value is None else value for value in given))

    @property
    def address(self) -> str:
        """Address of this axis on its line."""
        raise NotImplementedError

    @classmethod
    def check(cls, axes: "Mapping[str, AxisConfig]", bus: "BusConfig | None") -> Iterator[tuple[str, str, str]]:
        """Yield mistakes that concern several axes: (axis, field, message)."""
        lines: dict[str, tuple[str, LineOptions]] = {}
        owners: dict[tuple[str, str], str] = {}
        for name, axis in axes.items():
            options = axis.options
            assert isinstance(options, SerialOptions)
            first, line = lines.setdefault(options.line.port, (name, options.line))
            if line != options.line:
                yield name, "line", f"{line.port} has other options for axis {first!r}"
            address = options.line.port, options.address
            if address in owners:
                yield name, "line", f"{options.address} on {line.port} is axis {owners[address]!r} already"
            owners.setdefault(address, name)
