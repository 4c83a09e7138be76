"""One axis in the loop: feedback and set-point in, command and a row of the recording out. No bus, no clock."""

import math
import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING

from friction_hil.compensator import input_checksum
from friction_hil.daemon.assembly import lead_s, make_compensator, make_controller, make_limits, make_path, make_shadows
from friction_hil.daemon.safety import MAX_STALE_CYCLES, LoopState, SlewLimiter, Supervisor
from friction_hil.drive import AxisFacts, Command, DriveState, Feedback, Mode
from friction_hil.errors import OptionError, UsageError
from friction_hil.motion.controller import cascade
from friction_hil.motion.trajectory import PathTime, Setpoint, Trajectory, extent
from friction_hil.numerics.jit import Array
from friction_hil.recordings import columns

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig

_MOVING = (LoopState.RUNNING, LoopState.STOPPING)
_COLUMNS = struct.Struct(f"={len(columns.NAMES)}d")
_PATH_MARGIN = 0.01
_EXTENT_HZ = 1000.0  # at which an experiment is looked at
_STANDSTILL_SHARE = 1e-3  # of the velocity limit counts as standing


class AxisLoop:
    """What happens to one axis in a cycle.

    Parameters
    ----------
    name : str
    config : AxisConfig
    facts : AxisFacts
        What the driver found: resolution and delays.
    period_s : float
    path_time : PathTime
        Shared by the axes, so that they stay on their common path.
    shadow_names : sequence of str
        Shadow models of all axes: the rows of all axes have the same columns.
    max_stale_cycles : int
        Cycles in a row without usable feedback that are still bridged.
    """

    def __init__(
        self,
        name: str,
        config: "AxisConfig",
        facts: AxisFacts,
        period_s: float,
        path_time: PathTime,
        shadow_names: Sequence[str] = (),
        max_stale_cycles: int = MAX_STALE_CYCLES,
    ) -> None:
        self.name = name
        _check_torque(name, config, facts)
        self.compensator = make_compensator(config, config.model, facts, period_s)
        self.shadows = make_shadows(config, facts, period_s)
        self.stats = FollowingError()
        self._mode = Mode[config.mode.upper()]
        self._is_enabled = config.compensation.enabled
        self._baseline_s = config.compensation.baseline_s
        self._period_s = period_s
        self.setpoint_delay_s = facts.setpoint_delay_s
        self.lead_s = lead_s(config.model, facts, period_s)
        self._limits = make_limits(config)
        self._unit = "rad" if config.model.axis == "rotary" else "m"
        self.supervisor = Supervisor(
            name, self._limits, period_s, facts.position_resolution, self._unit, max_stale_cycles
        )
        self._total = SlewLimiter(self._limits.torque, self._limits.torque_slew, period_s)
        self.standstill = max(_STANDSTILL_SHARE * self._limits.velocity, 2.0 * facts.position_resolution / period_s)
        self._has_setpoint = config.trajectory.kind != "none"
        try:
            path = make_path(config, facts.position_resolution, period_s)
        except UsageError as error:
            raise UsageError(f"{name}: {error}") from None
        motion = config.trajectory
        if motion.kind == "experiment":
            self._extent = extent(path, motion.duration_s, round(_EXTENT_HZ * motion.duration_s))
        else:
            self._extent = extent(path, 1.0 / getattr(motion, "frequency", 1.0))
        self._trajectory = Trajectory(path, path_time)
        self._controller, self._integral = make_controller(config), 0.0
        self._held = math.nan
        self._reduction = 1.0
        self._network = self.compensator.model.network
        self._trained_speed = math.inf if self._network is None else self._network.speed_limit
        self.stale = 0  # cycles without usable feedback, bridged by prediction
        self.notice = ""  # what the user should know; whoever tells it empties it

        self._shadow_columns = [columns.NAMES.index("exchange_us") + 1 + shadow_names.index(n) for n in self.shadows]
        self.row_width = len(columns.NAMES) + len(shadow_names)
        self._states = [c.state for c in (self.compensator, *self.shadows.values())]

    @property
    def state_width(self) -> int:
        """How many numbers the states of the compensator and the shadows are."""
        return sum(state.size for state in self._states)

    @property
    def is_standing(self) -> bool:
        """Whether the axis is at rest, as far as its encoder tells; without feedback nobody knows."""
        return self.supervisor.is_current and abs(self.compensator.velocity_estimate) <= self.standstill

    def enter_path(self) -> None:
        """Let the path begin where the axis is held now."""
        self._trajectory.begin_at(self._held)

    def check_path(self) -> None:
        """See that the path from here stays inside the limits.

        Raises
        ------
        UsageError
            The path leaves the position limits or is faster than the velocity limit.
        """
        start = self.supervisor.position
        low, high, speed = start + self._extent[0], start + self._extent[1], self._extent[2]
        limits, unit = self._limits, self._unit
        margin = _PATH_MARGIN * (high - low)  # an axis that follows its set-point overshoots a little
        if not limits.position_low + margin <= low <= high <= limits.position_high - margin:
            raise UsageError(
                f"{self.name}: from {start:.4g} {unit} the trajectory would go from {low:.4g} to "
                f"{high:.4g} {unit}, outside the position limits [{limits.position_low:g}, {limits.position_high:g}] "
                f"or within {_PATH_MARGIN:.0%} of its own extent from them"
            )
        if speed > limits.velocity:
            raise UsageError(
                f"{self.name}: the trajectory needs {speed:.4g} {unit}/s, beyond the velocity limit of "
                f"{limits.velocity:g} {unit}/s"
            )

    def warm_up(self) -> None:
        """Compile everything that a cycle runs, so that the first cycles are as fast as the later ones."""
        for compensator in (self.compensator, *self.shadows.values()):
            state = compensator.state.copy()
            for cycle in range(3):
                compensator.step(float(cycle), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, True, False)
            compensator.state[:] = state
        cascade(self._controller, 0.0, 0.0, 0.0, 0.0, 0.0, self._period_s, self._limits.torque)

    def update(
        self,
        cycle: int,
        state: LoopState,
        running_s: float,
        feedback: Feedback,
        command: Command,
        row: Array,
    ) -> str | None:
        """Work out one cycle.

        Parameters
        ----------
        cycle : int
            Number of the cycle.
        state : LoopState
            Where the run stands.
        running_s : float
            Time since the run began to move, or, of a run that only listens, since it began; NaN before.
        feedback : Feedback
            From the drive, this cycle.
        command : Command
            Filled with the set-point and torque of this cycle.
        row : (width + state_width,) array
            Filled with the columns of the recording and the states before this cycle.

        Returns
        -------
        str or None
            What is wrong with the axis.
        """
        time_s = cycle * self._period_s
        is_usable = self.supervisor.is_usable(feedback)
        self.stale += not is_usable
        position = self.supervisor.position
        has_demand = self._has_setpoint and state in _MOVING
        now = self._trajectory.at(time_s) if has_demand else None
        ahead = self._trajectory.at(time_s + self.lead_s).velocity if has_demand else math.nan
        velocity_demand = math.nan if now is None else now.velocity
        position_demand = math.nan if now is None else now.position
        is_enabled = self._is_enabled and state in (LoopState.IDLE, LoopState.RUNNING) and running_s >= self._baseline_s

        place = self.row_width
        for saved in self._states:
            row[place : place + saved.size] = saved
            place += saved.size
        velocity = feedback.velocity if is_usable else self.compensator.velocity_estimate
        measured = float(cycle), position, velocity, feedback.torque
        inputs = (*measured, position_demand, velocity_demand, ahead, is_usable, is_enabled)
        compensation = self.compensator.step(*inputs)
        if self.compensator.gain_factor != self._reduction:
            self._reduction = self.compensator.gain_factor
            self.notice = (
                f"{self.name}: the compensation swings by itself (limit cycle, over-compensation): its gain is now "
                f"{self._reduction:.0%} of the configured one"
            )
        elif self._network is not None and abs(self.compensator.velocity_estimate) > self._trained_speed:
            self.notice = (
                f"{self.name}: faster than the {self._trained_speed:g} {self._unit}/s that the network was trained "
                f"for; beyond, {self._network.beyond}"
            )
            self._trained_speed = math.inf  # told once
        fault = self.supervisor.fault(feedback, state, self.compensator.velocity_estimate, position_demand)
        if self.compensator.is_faulty:
            fault = fault or f"{self.name}: the friction model gave a torque that is not finite"

        is_powered = feedback.state is DriveState.OPERATION_ENABLED
        self._fill(command, state, time_s, position, now, compensation, is_powered)
        if now is not None and is_usable and state is LoopState.RUNNING:
            self.stats.add(now.position - position)
        _COLUMNS.pack_into(
            row.data,
            0,
            time_s,
            cycle,
            position,
            velocity,
            feedback.torque,
            position_demand,
            velocity_demand,
            ahead,
            math.nan,
            math.nan,
            math.nan,
            self.compensator.velocity_estimate,
            compensation,
            command.torque,
            state,
            feedback.state,
            is_usable,
            is_enabled,
            input_checksum(*inputs),
            0.0,
            0.0,
        )
        for index, shadow in zip(self._shadow_columns, self.shadows.values(), strict=True):
            row[index] = shadow.step(*inputs)
        return fault

    def _fill(
        self,
        command: Command,
        state: LoopState,
        time_s: float,
        position: float,
        now: Setpoint | None,
        compensation: float,
        is_powered: bool,
    ) -> None:
        """Write set-point and torque; outside of the moving states the axis holds where it is, without torque."""
        command.velocity = 0.0
        if state not in _MOVING:
            if not (is_powered and state is LoopState.ENABLING and self._mode is Mode.CSP):
                self._held = position
            # a powered axis that waits for the others is held at one place: following itself, it would sink
            command.position = self._held
            self._integral = 0.0
            command.torque = self._total.limit(compensation) if state is LoopState.FAULT_STOPPING else 0.0
            self._total.torque = command.torque
            return
        if self._mode is Mode.CST:
            command.torque = self._total.limit(self._own_control(now, position) + compensation)
            return
        command.torque = self._total.limit(compensation)
        if now is not None:
            sent = self._trajectory.at(time_s + self.setpoint_delay_s)
            command.position = sent.position
            command.velocity = sent.velocity
            if self._mode is Mode.CSV:
                wanted = sent.velocity + self._controller[0]["position_gain"] * (now.position - position)
                command.velocity = min(max(wanted, -self._limits.velocity), self._limits.velocity)

    def _own_control(self, now: Setpoint | None, position: float) -> float:
        """Torque of the loop's own position and velocity control (CST)."""
        if now is None:
            return 0.0
        torque, self._integral = cascade(
            self._controller,
            self._integral,
            now.position - position,
            now.velocity,
            now.acceleration,
            self.compensator.velocity_estimate,
            self._period_s,
            self._limits.torque,
        )
        return torque


def _check_torque(name: str, config: "AxisConfig", facts: AxisFacts) -> None:
    """Refuse what needs the torque of a drive that does not tell it."""
    if facts.torque_delay_s is not None:
        return
    given = config.compensation
    key = "velocity" if given.velocity == "kalman" else "adaptation" if given.adaptation is not None else None
    if key:
        raise OptionError(name, f"compensation.{key}", "needs the torque, which this drive does not tell")


class FollowingError:
    """RMS and peak of the following error, gathered cycle by cycle."""

    __slots__ = ("_count", "_sum", "peak")

    def __init__(self) -> None:
        self._count = 0
        self._sum = 0.0
        self.peak = 0.0

    def add(self, error: float) -> None:
        """Take one cycle's error."""
        self._count += 1
        self._sum += error * error
        self.peak = max(self.peak, abs(error))

    @property
    def rms(self) -> float:
        """Root mean square; NaN without any cycle."""
        return math.sqrt(self._sum / self._count) if self._count else math.nan
