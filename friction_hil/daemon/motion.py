"""The demanded motion of one axis: set-points now, ahead and as sent, and the check of the path against the limits."""

import math
from typing import TYPE_CHECKING, TypeAlias

from friction_hil.daemon.assembly import largest_offset, make_path
from friction_hil.daemon.safety import MOVING, LoopState, SafetyLimits
from friction_hil.drive import AxisFacts
from friction_hil.drive.codes import FaultCode
from friction_hil.errors import UsageError
from friction_hil.motion.trajectory import PathTime, Setpoint, Trajectory, extent, largest_acceleration

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig

# position and velocity now, velocity and acceleration when this cycle's torque acts
Demand: TypeAlias = tuple[float, float, float, float]
NO_DEMAND: Demand = (math.nan, math.nan, math.nan, math.nan)

_MARGIN = 0.01  # of the path's own extent, kept from the position limits: an axis overshoots a little
_EXTENT_HZ = 1000.0  # rate at which a motion without a period is sampled for its extent


class AxisMotion:
    """Set-points of one axis.

    ``path_time`` is shared by all axes, so that they stay on their common path. Raises `UsageError`: the encoder is too
    coarse for an experiment.
    """

    __slots__ = (
        "_extent",
        "_is_path_of_positions",
        "_limits",
        "_name",
        "_setpoint_delay_s",
        "_trajectory",
        "_unit",
        "has_setpoint",
        "lead_s",
    )

    def __init__(
        self,
        name: str,
        unit: str,
        config: "AxisConfig",
        limits: SafetyLimits,
        facts: AxisFacts,
        period_s: float,
        lead_s: float,
        path_time: PathTime,
    ) -> None:
        self._name, self._unit, self._limits = name, unit, limits
        self.lead_s = lead_s  # from sampling the position until the torque acts; another model may need another one
        self._setpoint_delay_s = facts.setpoint_delay_s
        self._is_path_of_positions = config.mode == "csp"
        given = config.trajectory
        self.has_setpoint = given.kind != "none"  # False with ``trajectory: {kind: none}``
        try:
            path = make_path(config, facts.position_resolution, period_s)
        except UsageError as error:
            raise UsageError(f"{name}: {error}") from None
        if given.kind in ("experiment", "multisine", "sequence"):
            duration_s = given.duration_s
            self._extent = extent(path, duration_s, round(_EXTENT_HZ * duration_s))
        else:
            duration_s = 1.0 / getattr(given, "frequency", 1.0)
            self._extent = extent(path, duration_s)
        offset = largest_offset(config)
        self._extent = (self._extent[0] - offset, self._extent[1] + offset, self._extent[2])
        path_time.keep_within(limits.velocity, self._extent[2], largest_acceleration(path, duration_s))
        self._trajectory = Trajectory(path, path_time)

    @property
    def stops_without_setpoints(self) -> bool:
        """True if the drive stops where set-points are missing (csp); velocity or torque would be kept."""
        return self._is_path_of_positions and self.distance > 0.0

    @property
    def distance(self) -> float:
        """Largest distance of the path from its beginning, SI; 0 without a path that moves."""
        return max(abs(self._extent[0]), abs(self._extent[1])) if self.has_setpoint else 0.0

    def begin_at(self, position: float) -> None:
        """Let the path begin at ``position``."""
        self._trajectory.begin_at(position)

    def check(self, start: float) -> None:
        """Check that the path from ``start`` stays inside the limits.

        Raises `UsageError`: the path leaves the position limits or is faster than the velocity limit.
        """
        low, high, speed = start + self._extent[0], start + self._extent[1], self._extent[2]
        limits, unit = self._limits, self._unit
        margin = _MARGIN * (high - low)
        if not limits.position_low + margin <= low <= high <= limits.position_high - margin:
            raise UsageError(
                FaultCode.PATH_BEYOND_LIMITS.append_to(
                    f"{self._name}: from {start:.4g} {unit} the trajectory would go from {low:.4g} to {high:.4g} "
                    f"{unit}, outside the position limits [{limits.position_low:g}, {limits.position_high:g}] or "
                    f"within {_MARGIN:.0%} of its own extent from them"
                )
            )
        if speed > limits.velocity:
            raise UsageError(
                FaultCode.PATH_BEYOND_LIMITS.append_to(
                    f"{self._name}: the trajectory needs {speed:.4g} {unit}/s, beyond the velocity limit of "
                    f"{limits.velocity:g} {unit}/s"
                )
            )

    def demand(self, time_s: float, state: LoopState) -> tuple[Setpoint | None, Demand]:
        """Return the set-point at ``time_s``, None outside of the motion, and the demand for the compensator."""
        if not self.has_setpoint or state not in MOVING:
            return None, NO_DEMAND
        setpoint = self._trajectory.at(time_s)
        _, velocity_ahead, acceleration_ahead = self._trajectory.at(time_s + self.lead_s)
        return setpoint, (setpoint.position, setpoint.velocity, velocity_ahead, acceleration_ahead)

    def to_send(self, time_s: float) -> Setpoint:
        """Return the set-point to send at ``time_s``, ahead by the time until the drive's demand equals it."""
        return self._trajectory.at(time_s + self._setpoint_delay_s)
