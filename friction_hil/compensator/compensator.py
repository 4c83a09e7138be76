"""The compensator as an object: settings and model in, one torque a cycle out."""

import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_hil.compensator import adaptation, intent, kernel, velocity
from friction_hil.compensator.intent import SOURCES
from friction_hil.compensator.velocity import VelocityEstimator
from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel
from friction_hil.numerics.jit import Array, StructuredArray

INPUTS = (
    "cycle",
    "position",
    "velocity",
    "torque",
    "position_demand",
    "velocity_demand",
    "velocity_demand_ahead",
    "is_fresh",
    "is_enabled",
)
_PACKED_INPUTS = struct.Struct(f"<{len(INPUTS)}d")
_UNKNOWN_SHARE = 0.2  # of the friction level is not known to the model, for the Kalman observer
_UNKNOWN_S = 0.01  # and changes within this time
_RESTING_COUNTS, _RESTING_DEFLECTIONS = 3.0, 1.5  # counts, or deflections of the presliding spring, that are rest
_LEAST_ADAPTATION_S = 5.0 * adaptation.FILTER_S  # slower than its own filter


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
        Smallest step of the position, SI; sets what counts as noise.
    torque_limit : float
        Bound on the absolute compensation, N m.
    lead_s : float
        From sampling the position to the torque's acting; position-dependent friction is that of the place
        reached by then.
    inertia : float
        For the estimators that know the torque, and for adaptation, kg m^2; 0 where unknown.
    gravity : tuple of float
        Load torque over position q, constant + sine sin(q) + cosine cos(q), N m, for load-dependent friction.
    torque_slew : float
        Bound on the rate of the compensation, N m/s; infinity for none.
    gain : float
        Share of the model's torque that is commanded; below 1 it insures against over-compensation.
    gain_negative : float or None
        The same for negative torque; None: as ``gain``.
    source : str
        ``auto``, ``measured`` or ``demand``: the velocity that feeds the model.
    fade_s : float
        Time for fading in and out, s, above zero.
    velocity : str
        ``difference``, ``tracking``, ``kalman`` or ``drive``: how the measured velocity is estimated, see
        `friction_hil.compensator.velocity`.
    smoothing : float
        Coefficient of the one-pole filter of ``difference`` and ``drive``, 0 < smoothing <= 1; 1 filters nothing.
    acceleration : float
        That ``tracking`` has to follow, SI.
    max_acceleration : float
        A position that would need more is passed over as a glitch, SI.
    dead_band : float
        Velocity below which the compensation is reduced in proportion, SI; 0 for none.
    adaptation_s : float
        Time over which the level is adapted to what the torque shows, s, from 0.1; 0: never.
    adaptation_bound : float
        Largest relative change of the level by adaptation.
    """

    period_s: float
    position_resolution: float
    torque_limit: float
    lead_s: float = 0.0
    inertia: float = 0.0
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque_slew: float = math.inf
    gain: float = 0.9
    gain_negative: float | None = None
    source: str = "auto"
    fade_s: float = 0.5
    velocity: str = "difference"
    smoothing: float = 1.0
    acceleration: float = math.nan
    max_acceleration: float = math.inf
    dead_band: float = 0.0
    adaptation_s: float = 0.0
    adaptation_bound: float = 0.3


class Compensator:
    """A friction model at work on one axis.

    Raises
    ------
    UsageError
        A setting is out of range, or missing for what another one asks.
    """

    __slots__ = ("_flat", "_settings", "_state", "estimator", "model", "settings")

    def __init__(self, model: FrictionModel, settings: CompensatorSettings) -> None:
        if not 0.0 < settings.position_resolution < math.inf:
            raise UsageError(f"position_resolution = {settings.position_resolution:g} must be finite and above zero")
        if settings.adaptation_s > 0.0 and not 0.0 < settings.inertia < math.inf:
            raise UsageError("adaptation needs the inertia (mechanics of the model file)")
        if 0.0 < settings.adaptation_s < _LEAST_ADAPTATION_S:
            raise UsageError(
                f"adaptation_s = {settings.adaptation_s:g} must be 0, for none, or at least "
                f"{_LEAST_ADAPTATION_S:g} s, several times its filter"
            )
        if model.network is not None:
            model.network.require(True, True, settings.period_s)
        self.model = model
        self.settings = settings
        self.estimator = _estimator(model, settings)
        delay = self.estimator.delay_cycles
        longest = intent.HISTORY - 2
        if delay > longest:
            way = f"smoothing = {settings.smoothing:g}"
            advice = f"take {1.0 / longest:.2g} or more"
            if settings.velocity not in ("difference", "drive"):
                way, advice = settings.velocity, "let it follow a greater acceleration, or take velocity: difference"
            raise UsageError(f"{way} delays the velocity by {delay:.1f} cycles, more than {longest}; {advice}")
        self._settings = _record(model, settings, self.estimator)
        self._state = np.zeros(1, kernel.STATE)
        kernel.begin(self._settings, self._state, model.initial_state())
        self._flat: Array = self._state.view(np.float64)

    def step(
        self,
        cycle: float,
        position: float,
        velocity: float,
        torque: float,
        position_demand: float,
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
        position, velocity, torque : float
            Feedback, SI. The torque is used by the Kalman observer and by adaptation alone.
        position_demand, velocity_demand, velocity_demand_ahead : float
            Demanded position and velocity when the position was sampled, and the velocity when this torque will
            act; NaN where no set-point is known.
        is_fresh : bool
            Whether the feedback is of this cycle; otherwise the velocity is predicted.
        is_enabled : bool
            Fade in, or out. The model runs all the time, so that it is right when it is needed.
        """
        return kernel.step(
            self._settings,
            self._state,
            cycle,
            position,
            velocity,
            torque,
            position_demand,
            velocity_demand,
            velocity_demand_ahead,
            1.0 if is_fresh else 0.0,
            1.0 if is_enabled else 0.0,
        )

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
        kernel.replay(self._settings, self._state, *inputs, compensation, estimate)  # type: ignore[call-arg]
        return compensation, estimate

    @property
    def record(self) -> StructuredArray:
        """Settings and model as the compiled `step` takes them."""
        return self._settings

    @property
    def state(self) -> Array:
        """The whole state as a flat array, a live view: copy to keep it, assign to restore it."""
        return self._flat

    @property
    def velocity_estimate(self) -> float:
        """Estimated velocity, SI; older than the position by ``estimator.delay_cycles``."""
        return self._flat.item(_VELOCITY)

    @property
    def is_faded_out(self) -> bool:
        """Whether no torque is left."""
        return self._flat.item(_FADE) == 0.0 and self._flat.item(_COMPENSATION) == 0.0

    @property
    def is_faulty(self) -> bool:
        """Whether the model's torque was not finite in the last cycle, and so was not used."""
        return bool(self._flat.item(_IS_FAULTY))

    @property
    def reduction(self) -> float:
        """What the gain is multiplied by since limit cycles were seen; 1 as long as none was."""
        return self._flat.item(_REDUCTION)


def _place(name: str) -> int:
    """Index of a field in the flat view of the state."""
    assert kernel.STATE.fields is not None
    return int(kernel.STATE.fields[name][1]) // 8


def _place_of_velocity() -> int:
    assert velocity.STATE.fields is not None
    return _place("motion") + int(velocity.STATE.fields["velocity"][1]) // 8


_VELOCITY = _place_of_velocity()
_FADE, _COMPENSATION, _IS_FAULTY = _place("fade"), _place("compensation"), _place("is_faulty")
_REDUCTION = _place("reduction")


def _estimator(model: FrictionModel, settings: CompensatorSettings) -> VelocityEstimator:
    return VelocityEstimator(
        kind=settings.velocity,
        period_s=settings.period_s,
        resolution=settings.position_resolution,
        smoothing=settings.smoothing,
        acceleration=settings.acceleration,
        inertia=settings.inertia if settings.inertia > 0.0 else math.nan,
        torque_uncertainty=_UNKNOWN_SHARE * model.level,
        uncertainty_time_s=_UNKNOWN_S,
        max_acceleration=settings.max_acceleration,
    )


def _record(model: FrictionModel, settings: CompensatorSettings, estimator: VelocityEstimator) -> StructuredArray:
    record = np.zeros(1, kernel.settings_type(model.values.size))
    c = record[0]
    step_velocity = 2.0 * settings.position_resolution / settings.period_s
    stribeck_velocity = model.parameters.get("stribeck_velocity")
    gate = step_velocity if stribeck_velocity is None else intent.GATE_STRIBECK_SHARE * stribeck_velocity
    c["kind"] = model.kind
    c["is_static"] = model.family.is_static
    c["friction"] = model.values
    c["level"] = model.level
    c["inertia"] = settings.inertia
    c["gravity_constant"], c["gravity_sine"], c["gravity_cosine"] = settings.gravity
    c["lead_s"] = settings.lead_s
    ahead_cycles = settings.lead_s / settings.period_s + estimator.delay_cycles
    c["ahead_s"] = ahead_cycles * settings.period_s
    c["judged_cycles"] = min(max(round(ahead_cycles), 1), intent.HORIZON)
    predicted_noise = max(1.0, intent.SLOPE_SHARE * ahead_cycles) * estimator.noise
    c["ahead_noise_square"] = intent.NOISE_SHARE * predicted_noise**2
    c["period_s"] = settings.period_s
    c["resolution"] = settings.position_resolution
    c["motion"] = estimator.record[0]
    c["uses_torque"] = settings.velocity == "kalman"
    c["delay_cycles"] = estimator.delay_cycles
    c["noise"] = estimator.noise
    stiffness = model.presliding_stiffness
    deflection = model.level / stiffness if stiffness > 0.0 else 0.0
    c["rest"] = max(_RESTING_COUNTS * settings.position_resolution, _RESTING_DEFLECTIONS * deflection)
    c["source"] = SOURCES[settings.source]
    c["epsilon"] = step_velocity
    c["epsilon_of_demand"] = intent.RECOVERY * settings.position_resolution
    c["gate_square"] = gate * gate
    c["guided_share"] = min(1.0, 2.0 * (gate / estimator.noise) ** 2)  # what is left of the noise is the gate
    c["gain_positive"] = settings.gain
    c["gain_negative"] = settings.gain if settings.gain_negative is None else settings.gain_negative
    c["dead_band"] = settings.dead_band
    c["fade_s"] = settings.fade_s
    c["torque_limit"] = settings.torque_limit
    c["torque_slew"] = settings.torque_slew
    c["adaptation_s"] = settings.adaptation_s
    c["adaptation_bound"] = settings.adaptation_bound
    c["sliding_velocity"] = 0.0 if stribeck_velocity is None else 2.0 * stribeck_velocity
    return record
