"""The compensator: measured and demanded velocity -> friction model -> gain, fading, limits -> torque.

Pure: one compiled step over one flat state record, the same in the daemon and in replay. What it does and
why:

* *Lead*: the torque acts later than the velocity was measured, so the velocity is advanced along the demand,
  u = v_filtered + [v_demand(t + lead) - v_demand(t - filter delay)].
* *Split*: a feed-forward cannot damp the falling part of a Stribeck curve, and cancelling the presliding
  spring through a late measurement takes away the axis's own stability. So the friction level follows the
  measured deviation from the demand, and the model's state only half of it.
* *Gate*: the deviation d is admitted as far as it is real, by the share r = S / (S + S_noise), with S its
  smoothed square, as a Wiener filter would.
"""

import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.jit import Array, Record, compiled
from friction_hil.models import FrictionModel, kernel

AUTO, MEASURED, DEMAND = 0, 1, 2
SOURCES = {"auto": AUTO, "measured": MEASURED, "demand": DEMAND}

HISTORY = 16  # cycles of demanded velocity kept, which bounds the filter delay
_GATE_CYCLES = 50.0
_GATE_STRIBECK_SHARE = 0.05
_STATE_DEVIATION_SHARE = 0.5
MAX_GAP_CYCLES = 10  # after a longer gap the velocity estimate starts anew

SETTINGS = np.dtype(
    [
        ("kind", "f8"),
        ("friction", "f8", (kernel.PARAMETER_ROOM,)),
        ("gravity_constant", "f8"),
        ("gravity_sine", "f8"),
        ("gravity_cosine", "f8"),
        ("lead_s", "f8"),
        ("period_s", "f8"),
        ("source", "f8"),
        ("uses_drive_velocity", "f8"),
        ("smoothing", "f8"),
        ("filter_delay_cycles", "f8"),
        ("epsilon", "f8"),
        ("gate_square", "f8"),
        ("gain", "f8"),
        ("fade_s", "f8"),
        ("torque_limit", "f8"),
        ("torque_slew", "f8"),
    ]
)

STATE = np.dtype(
    [
        ("cycle", "f8"),  # of the last step; negative before the first
        ("position_cycle", "f8"),  # of the last fresh position
        ("position", "f8"),
        ("velocity", "f8"),
        ("deviation_square", "f8"),
        ("demands", "f8", (HISTORY,)),  # newest first
        ("friction", "f8", (kernel.STATE_ROOM,)),
        ("fade", "f8"),
        ("compensation", "f8"),
        ("is_faulty", "f8"),  # the model gave a torque that is not finite
    ]
)


assert STATE.fields is not None
_VELOCITY, _FADE, _COMPENSATION, _IS_FAULTY = (
    STATE.fields[name][1] // 8 for name in ("velocity", "fade", "compensation", "is_faulty")
)  # places in the flat view


@compiled
def _restart(r: Any, cycle: float, position: float, velocity: float, demand: float) -> None:
    r.position_cycle = cycle
    r.position = position
    r.velocity = velocity
    r.deviation_square = 0.0
    for k in range(HISTORY):
        r.demands[k] = demand


@compiled
def _estimate_velocity(c: Any, r: Any, cycle: float, position: float, velocity: float) -> None:
    """One-pole filter on the encoder difference, or on the drive's own velocity."""
    raw = velocity
    if c.uses_drive_velocity == 0.0:
        raw = (position - r.position) / ((cycle - r.position_cycle) * c.period_s)
    r.velocity += c.smoothing * (raw - r.velocity)
    r.position = position
    r.position_cycle = cycle


@compiled
def _model_velocities(c: Any, r: Any, ahead: float) -> tuple[float, float]:
    """Velocities for the model's state and for its level; NaN ``ahead`` means that no demand is known."""
    if not math.isfinite(ahead):
        return r.velocity, r.velocity
    whole = int(c.filter_delay_cycles)
    part = c.filter_delay_cycles - whole
    delayed = (1.0 - part) * r.demands[whole] + part * r.demands[whole + 1]
    deviation = r.velocity - delayed
    r.deviation_square += (deviation * deviation - r.deviation_square) / _GATE_CYCLES
    if c.source == MEASURED:
        return ahead + deviation, ahead + deviation
    if c.source == DEMAND:
        return ahead, ahead
    admitted = deviation * r.deviation_square / (r.deviation_square + c.gate_square)
    return ahead + _STATE_DEVIATION_SHARE * admitted, ahead + admitted


@compiled
def step(
    settings: Record,
    state: Record,
    cycle: float,
    position: float,
    velocity: float,
    velocity_demand: float,
    velocity_demand_ahead: float,
    is_fresh: float,
    is_enabled: float,
) -> float:
    """One cycle; see `Compensator.step`."""
    c, r = settings[0], state[0]
    demand = velocity_demand if math.isfinite(velocity_demand) else 0.0
    elapsed = cycle - r.cycle
    is_gap = is_fresh > 0.0 and cycle - r.position_cycle > MAX_GAP_CYCLES
    if r.cycle < 0.0 or elapsed <= 0.0 or is_gap:
        elapsed = 1.0
        _restart(r, cycle, position, velocity, demand)
    else:
        for _ in range(min(int(elapsed), HISTORY)):
            for k in range(HISTORY - 1, 0, -1):
                r.demands[k] = r.demands[k - 1]
            r.demands[0] = demand
        if is_fresh > 0.0:
            _estimate_velocity(c, r, cycle, position, velocity)
    r.cycle = cycle
    dt = elapsed * c.period_s

    state_velocity, level_velocity = _model_velocities(c, r, velocity_demand_ahead)
    reached = r.position + c.lead_s * level_velocity  # where the torque will act
    load_torque = c.gravity_constant + c.gravity_sine * math.sin(reached) + c.gravity_cosine * math.cos(reached)
    torque = kernel.step(
        int(c.kind),
        c.friction,
        r.friction,
        state_velocity,
        level_velocity,
        dt,
        reached,
        load_torque,
        math.nan,
        0.0,
        c.epsilon,
    )

    change = dt / c.fade_s
    r.fade = min(r.fade + change, 1.0) if is_enabled > 0.0 else max(r.fade - change, 0.0)
    wanted = c.gain * r.fade * torque
    r.is_faulty = 0.0
    if not math.isfinite(wanted):
        r.is_faulty = 1.0
        wanted = 0.0
    wanted = min(max(wanted, -c.torque_limit), c.torque_limit)
    slew = c.torque_slew * dt
    r.compensation = min(max(wanted, r.compensation - slew), r.compensation + slew)
    return r.compensation


@compiled
def replay(
    settings: Record,
    state: Record,
    cycle: Array,
    position: Array,
    velocity: Array,
    velocity_demand: Array,
    velocity_demand_ahead: Array,
    is_fresh: Array,
    is_enabled: Array,
    compensation: Array,
    velocity_estimate: Array,
) -> None:
    """Run `step` over recorded inputs, each (n,); fills ``compensation`` and ``velocity_estimate``, (n,)."""
    for k in range(cycle.shape[0]):
        compensation[k] = step(
            settings,
            state,
            cycle[k],
            position[k],
            velocity[k],
            velocity_demand[k],
            velocity_demand_ahead[k],
            is_fresh[k],
            is_enabled[k],
        )
        velocity_estimate[k] = state[0].velocity


INPUTS = ("cycle", "position", "velocity", "velocity_demand", "velocity_demand_ahead", "is_fresh", "is_enabled")
_PACKED_INPUTS = struct.Struct("<7d")


def input_checksum(*inputs: float) -> float:
    """CRC-32 of one cycle's `INPUTS`, in their order."""
    return float(zlib.crc32(_PACKED_INPUTS.pack(*inputs)))


@dataclass(frozen=True, slots=True)
class CompensatorSettings:
    """Everything beside the model that decides what the compensator does.

    Attributes
    ----------
    period_s : float
        Period of the loop.
    position_resolution : float
        Smallest step of the position, SI; sets what counts as velocity noise.
    lead_s : float
        From sampling the position to the torque's acting; position-dependent friction is that of the place
        reached by then.
    gravity : tuple of float
        Load torque over position q, constant + sine sin(q) + cosine cos(q), N m, for load-dependent friction.
    torque_limit : float
        Bound on the absolute compensation, N m.
    torque_slew : float
        Bound on its rate, N m/s; infinity for none.
    gain : float
        Share of the model's torque that is commanded; below 1 it insures against over-compensation.
    source : str
        ``auto``, ``measured`` or ``demand``: the velocity that feeds the model.
    fade_s : float
        Time for fading in and out, s, above zero.
    uses_drive_velocity : bool
        Take the drive's velocity instead of differences of the position.
    smoothing : float
        Coefficient of the one-pole velocity filter, 0 < smoothing <= 1; 1 filters nothing.
    """

    period_s: float
    position_resolution: float
    torque_limit: float
    lead_s: float = 0.0
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque_slew: float = math.inf
    gain: float = 0.9
    source: str = "auto"
    fade_s: float = 0.5
    uses_drive_velocity: bool = False
    smoothing: float = 0.5

    @property
    def filter_delay_cycles(self) -> float:
        """Age of the velocity estimate: half a cycle for a difference, and the one-pole filter's delay."""
        return (0.0 if self.uses_drive_velocity else 0.5) + (1.0 - self.smoothing) / self.smoothing


class Compensator:
    """A friction model at work on one axis.

    Raises
    ------
    UsageError
        The velocity filter is slower than the demand history can follow, or the position has no resolution.
    """

    __slots__ = ("_flat", "_settings", "_state", "model", "settings")

    def __init__(self, model: FrictionModel, settings: CompensatorSettings) -> None:
        if settings.filter_delay_cycles > HISTORY - 2:
            raise UsageError(
                f"smoothing = {settings.smoothing:g} delays the velocity by "
                f"{settings.filter_delay_cycles:.1f} cycles, more than {HISTORY - 2}; "
                f"take {1.0 / (HISTORY - 2):.2g} or more"
            )
        if not 0.0 < settings.position_resolution < math.inf:
            raise UsageError(f"position_resolution = {settings.position_resolution:g} must be finite and above zero")
        self.model = model
        self.settings = settings
        noise = 2.0 * settings.position_resolution / settings.period_s
        stribeck_velocity = model.parameters.get("stribeck_velocity")
        gate = noise if stribeck_velocity is None else _GATE_STRIBECK_SHARE * stribeck_velocity
        self._settings = np.zeros(1, SETTINGS)
        c = self._settings[0]
        c["kind"] = model.kind
        c["friction"] = model.values
        c["gravity_constant"], c["gravity_sine"], c["gravity_cosine"] = settings.gravity
        c["lead_s"] = settings.lead_s
        c["period_s"] = settings.period_s
        c["source"] = SOURCES[settings.source]
        c["uses_drive_velocity"] = settings.uses_drive_velocity
        c["smoothing"] = settings.smoothing
        c["filter_delay_cycles"] = settings.filter_delay_cycles
        c["epsilon"] = noise
        c["gate_square"] = gate * gate
        c["gain"] = settings.gain
        c["fade_s"] = settings.fade_s
        c["torque_limit"] = settings.torque_limit
        c["torque_slew"] = settings.torque_slew
        self._state = np.zeros(1, STATE)
        self._state[0]["cycle"] = -1.0
        self._flat: Array = self._state.view(np.float64)

    def step(
        self,
        cycle: float,
        position: float,
        velocity: float,
        velocity_demand: float,
        velocity_demand_ahead: float,
        is_fresh: bool,
        is_enabled: bool,
    ) -> float:
        """Take one cycle's inputs and return the compensation, N m.

        Parameters
        ----------
        cycle : float
            Number of the cycle, whole, from zero; a missed cycle leaves a gap.
        position, velocity : float
            Feedback, SI, finite.
        velocity_demand, velocity_demand_ahead : float
            Demanded velocity when the position was sampled, and when this torque will act; NaN where no
            set-point is known.
        is_fresh : bool
            Whether the feedback is of this cycle; otherwise the last velocity is kept.
        is_enabled : bool
            Fade in, or out. The model runs all the time, so that it is right when it is needed.
        """
        torque: float = step(
            self._settings,
            self._state,
            cycle,
            position,
            velocity,
            velocity_demand,
            velocity_demand_ahead,
            float(is_fresh),
            float(is_enabled),
        )
        return torque

    def replay(self, inputs: Sequence[Array]) -> tuple[Array, Array]:
        """Take many cycles at once.

        Parameters
        ----------
        inputs : sequence of (n,) arrays
            The `INPUTS`, in their order.

        Returns
        -------
        compensation, velocity_estimate : (n,) arrays
        """
        compensation, estimate = np.empty_like(inputs[0]), np.empty_like(inputs[0])
        replay(self._settings, self._state, *inputs, compensation, estimate)  # type: ignore[call-arg]
        return compensation, estimate

    @property
    def record(self) -> Record:
        """Settings and model as the compiled `step` takes them."""
        return self._settings

    @property
    def state(self) -> Array:
        """The whole state as a flat array, a live view: copy to keep it, assign to restore it."""
        return self._flat

    @property
    def velocity_estimate(self) -> float:
        """Filtered velocity, SI; older than the position by the filter delay."""
        return self._flat.item(_VELOCITY)

    @property
    def is_faded_out(self) -> bool:
        """Whether no torque is left."""
        return self._flat.item(_FADE) == 0.0 and self._flat.item(_COMPENSATION) == 0.0

    @property
    def is_faulty(self) -> bool:
        """Whether the model's torque was not finite in the last cycle, and so was not used."""
        return bool(self._flat.item(_IS_FAULTY))
