"""What a driver can find out about the drives on a bus without a configuration of axes, and stopping them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from friction_hil.drive.port import DriveState


@dataclass(frozen=True, slots=True)
class DriveEntry:
    """One node that a scan has found."""

    node: int
    answers: bool  # otherwise it was only heard
    name: str = ""  # that the device gives itself, "" for none
    profile: int | None = None  # number of its device profile: 402 for drives
    vendor_id: int | None = None
    product_code: int | None = None
    revision: int | None = None
    serial: int | None = None
    nmt: str = ""  # state of the network management, as heard, "" where it was not
    state: DriveState | None = None  # None: it is no drive
    mode: str = ""  # of operation, in force, "" where the device reports none
    modes: tuple[str, ...] = ()  # that it supports
    problem: str = ""  # why it must not be used as it is, "" for none: two nodes have this number


@dataclass(frozen=True, slots=True)
class Stop:
    """Result of stopping one drive, or of resetting its fault."""

    node: int | None  # its number; None for a drive on a serial line
    before: DriveState  # as read back; `DriveState.UNKNOWN` where it could not be read
    after: DriveState  # the same
    # ``stopped`` (it was powered, and is read back without power), ``reset`` (it was in fault, and is read back without
    # the fault and without power), ``unpowered`` (there was nothing to do), ``powered``, ``fault`` (of a reset: the
    # fault is still there) or ``unknown``
    result: str
    detail: str = ""  # reason, "" for none
    axis: str = ""  # its name in the configuration; "" without one
    address: str = ""  # where its drive is; "" without a configuration
    fault: str = ""  # what the drive reported as its fault before a reset, "" for none
    # set-points that could not be set to zero and would act once somebody enables the drive, "" for none
    leftover: str = ""

    @property
    def is_proved(self) -> bool:
        """True if the drive has been read back without power or set-points, and after a reset without a fault."""
        return self.result in ("stopped", "reset", "unpowered") and not self.leftover

    @property
    def reason(self) -> str:
        """`detail` and `leftover` in one text."""
        return "; ".join(filter(None, (self.detail, self.leftover)))


def result_of(after: DriveState, done: str) -> str:
    """Return the result that a state proves: ``done`` without power, else ``powered`` or ``unknown``."""
    return done if after.is_unpowered else "powered" if after.is_powered else "unknown"


@dataclass(frozen=True, slots=True)
class StopReport:
    """Results for the axes of a configuration, in their order, and notes for the user."""

    stops: tuple[Stop, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Scan:
    """Result of a scan: the nodes, and what other masters do on the bus."""

    drives: tuple[DriveEntry, ...]
    notes: tuple[str, ...] = field(default=())


class Inventory(Protocol):
    """Drives on a bus; made by ``open_inventory`` of a driver, closed by its user."""

    notes: tuple[str, ...]  # what other masters do on the bus

    def scan(self) -> Scan:
        """Find the drives; reads only."""
        ...

    def show(self, node: int) -> dict[str, Any]:
        """Return all that a drive says of itself, by section; reads only."""
        ...

    def stop(self, nodes: Sequence[int]) -> list[Stop]:
        """Stop drives (all that are found, for none given) and read their states back."""
        ...

    def close(self) -> None:
        """Leave the bus."""
        ...
