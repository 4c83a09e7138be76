"""Keys of an axis that belong to the CANopen driver."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field

from friction_hil.drive.driver import OptionChecks
from friction_hil_drivers.canopen.connect.watchdog_times import WatchdogTimes, contradictions, watchdog_times
from friction_hil_drivers.canopen.sidecar.options import SidecarOptions
from friction_hil_drivers.cia402.options import DriveOptions

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, BusConfig


class CanopenOptions(DriveOptions, OptionChecks):
    """Options of an axis with ``driver: canopen``."""

    node: int = Field(ge=1, le=127, description="CANopen node number of the drive")
    axis_number: int = Field(
        0, ge=0, le=7, description="which axis of a node with several: 0 has its objects at 6000h, 1 at 6800h and so on"
    )
    eds: Path | None = Field(None, description="EDS or DCF of the drive; widths of mapped objects are checked")
    setpoint_delay_cycles: float | None = Field(
        None,
        ge=0.0,
        le=10.0,
        description="periods from sending a set-point to the drive's demand reaching it; 2.5 (csp) or 2 (csv) "
        "when not given: one for the exchange, the rest for the drive's interpolation",
    )
    heartbeat_s: float | None = Field(
        None,
        ge=0.005,
        le=10.0,
        description="period of heartbeats in both directions, or of node guarding; three missing ones are a loss; 0.02 "
        "when not given, or longer as realtime.max_missed needs it, and shorter where no RPDO of the drive has a timer",
    )
    watchdog_s: float | None = Field(
        None,
        ge=0.002,
        le=60.0,
        description="time without commands after which the drive stops, by the timer of an RPDO; 0.02 when not given, "
        "or longer as realtime.max_missed needs it",
    )
    master_node: int = Field(126, ge=1, le=127, description="node number under which the daemon sends its heartbeat")
    is_watchdog_required: bool = Field(
        True, description="refuse a drive that cannot watch the daemon (RPDO timer, heartbeat, node guarding)"
    )
    sidecar: SidecarOptions | None = Field(
        None, description="PDOs as the master of the drive has mapped them; needed with bus.role: sidecar"
    )

    @classmethod
    def check(cls, axes: "Mapping[str, AxisConfig]", bus: "BusConfig | None") -> Iterator[tuple[str, str, str]]:
        """Yield mistakes that concern several axes, or an axis and the bus: (axis, field, message)."""
        owners: dict[tuple[int, int], str] = {}
        for name, axis in axes.items():
            options = canopen_options(axis)
            if bus is None:
                yield name, "driver", "the canopen driver needs a bus: section (interface, channel)"
            owner = owners.setdefault((options.node, options.axis_number), name)
            if owner != name:
                which = f" (axis_number {options.axis_number})" if options.axis_number else ""
                yield name, "node", f"node {options.node}{which} is axis {owner!r} already"
            if options.node == options.master_node:
                yield name, "node", f"node {options.node} is master_node, the daemon's own number"
            first = canopen_options(next(iter(axes.values())))
            if options.master_node != first.master_node:
                text = f"must be the same for all axes: the daemon sends one heartbeat, as node {first.master_node}"
                yield name, "master_node", text
            if axis.model.axis == "linear":
                for field in ("counts_per_unit", "rated_torque"):
                    if getattr(options, field) is None:
                        yield name, field, "must be given for a linear axis: drives do not report it per metre"
        if bus is not None:
            yield from _sidecar_mistakes(axes, is_sidecar=bus.role == "sidecar")

    @classmethod
    def check_timing(
        cls, axes: "Mapping[str, AxisConfig]", period_s: float, max_missed: int
    ) -> Iterator[tuple[str, str, str]]:
        """Yield watchdogs that would trip while the loop bridges missed periods: (axis, field, message)."""
        for name, axis in axes.items():
            if canopen_options(axis).sidecar is not None:
                continue  # a sidecar arms no watchdog
            times = canopen_options(axis).times(period_s, max_missed)
            for field, message in contradictions(period_s, max_missed, times):
                yield name, field, message

    def times(self, period_s: float, max_missed: int) -> WatchdogTimes:
        """Return the times of the watchdogs for a period, s, and the periods that the loop bridges."""
        return watchdog_times(period_s, max_missed, self.heartbeat_s, self.watchdog_s)


def canopen_options(axis: "AxisConfig") -> CanopenOptions:
    """Return the options of an axis of this driver."""
    assert isinstance(axis.options, CanopenOptions)
    return axis.options


def _sidecar_mistakes(axes: "Mapping[str, AxisConfig]", *, is_sidecar: bool) -> Iterator[tuple[str, str, str]]:
    """Yield what a sidecar lacks, which asks the drive nothing, and what belongs to a sidecar alone."""
    identifiers: dict[int, str] = {}
    for name, axis in axes.items():
        options = canopen_options(axis)
        if not is_sidecar:
            if options.sidecar is not None:
                yield name, "sidecar", "is only for bus.role: sidecar"
            continue
        for field in ("temperature", "load_encoder"):
            if getattr(options, field) is not None:
                yield name, field, "is not possible with bus.role: sidecar, which does not ask the drive"
        for field, reason in (
            ("sidecar", "must list the PDOs as the master has mapped them"),
            ("counts_per_unit", "must be given with bus.role: sidecar, which does not ask the drive"),
            ("rated_torque", "must be given with bus.role: sidecar, which does not ask the drive"),
        ):
            if getattr(options, field) is None:
                yield name, field, reason
        given = options.sidecar
        for pdo in () if given is None else (*given.tpdos, *given.rpdos, given.offset):
            if pdo.cob_id in identifiers:
                yield name, "sidecar", f"cob_id {pdo.cob_id:#x} belongs to axis {identifiers[pdo.cob_id]!r} already"
        if given is not None:
            identifiers |= {pdo.cob_id: name for pdo in (*given.tpdos, *given.rpdos, given.offset)}
