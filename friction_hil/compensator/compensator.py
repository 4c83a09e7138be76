"""The compensator as an object: made from a model and settings, it gives one torque a cycle."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from friction_hil.compensator import adaptation, kernel, prediction, records, reference
from friction_hil.compensator.change import carry_over
from friction_hil.compensator.kernel import RESULTS
from friction_hil.compensator.records import place
from friction_hil.compensator.reference import SOURCES
from friction_hil.compensator.velocity import VelocityEstimator
from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel, network
from friction_hil.numerics.jit import Array, StructuredArray, ready


class CompensatorInputs(NamedTuple):
    """Inputs of one cycle, in the order of `Compensator.step`."""

    cycle: float
    position: float
    velocity: float
    torque: float
    position_demand: float
    velocity_demand: float
    velocity_demand_ahead: float
    is_fresh: bool
    is_enabled: bool
    acceleration_demand_ahead: float = math.nan
    temperature: float = math.nan
    load_torque: float = math.nan


INPUTS = CompensatorInputs._fields
_UNCERTAIN_FRACTION = 0.2  # of the friction level, standard deviation of the torque unknown to the Kalman observer
_UNCERTAIN_S = 0.01  # correlation time of that torque
_RESTING_COUNTS, _RESTING_DEFLECTIONS = 3.0, 1.5  # encoder counts, or presliding deflections, that count as rest
_LEAST_ADAPTATION_S = 5.0 * adaptation.FILTER_S  # adaptation must be slower than its own filter


@dataclass(frozen=True, slots=True)
class ThermalObserver:
    """Lumped thermal model of motor and transmission; see `friction_hil.compensator.temperature`."""

    capacity: float  # heat capacity, J/K
    resistance: float  # thermal, to the surroundings, K/W
    ambient: float  # temperature of the surroundings, deg C
    initial: float  # temperature of the axis in the first cycle, deg C
    # heat per square of torque, W/(N m)^2: winding resistance over the square of the torque constant
    copper_loss: float = 0.0


@dataclass(frozen=True, slots=True)
class CompensatorSettings:
    """Settings of the compensator."""

    period_s: float  # of the loop
    position_resolution: float  # smallest step of the position, SI; sets what counts as noise
    torque_limit: float  # bound on the absolute compensation, N m
    # from sampling the position until the torque acts; position-dependent friction is that of the position reached by
    # then
    lead_s: float = 0.0
    inertia: float = 0.0  # for the Kalman observer and for adaptation, kg m^2; 0 where unknown
    # torque that the drive reports, over the torque commanded, which is that of the model: the reported torque is
    # divided by it
    torque_ratio: float = 1.0
    # load torque over position q, constant + sine sin(q) + cosine cos(q), N m, for load-dependent friction
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque_slew: float = math.inf  # bound on the rate of the compensation, N m/s; infinity for none
    gain: float = 0.9  # on the model's torque; below 1 it guards against over-compensation
    gain_negative: float | None = None  # for negative torque; None: the same as `gain`
    source: str = "auto"  # velocity that the model is given: `auto`, `measured` or `demand`
    fade_s: float = 0.5  # in and out, above zero
    # estimator of the measured velocity: `difference`, `tracking`, `kalman` or `drive`, see
    # `friction_hil.compensator.velocity`
    velocity: str = "difference"
    # coefficient of the one-pole filter of `difference` and `drive`, 0 < smoothing <= 1; 1 filters nothing
    smoothing: float = 1.0
    acceleration: float = math.nan  # that `tracking` has to follow, SI
    # a position that would need more than this is ignored as a glitch, SI; infinity: none is, and none is taken for
    # late
    max_acceleration: float = math.inf
    dead_band: float = 0.0  # velocity below which the compensation is reduced in proportion, SI; 0 for none
    adaptation_s: float = 0.0  # over which the level is adapted to the measured torque, at least 0.1; 0: no adaptation
    adaptation_bound: float = 0.3  # largest relative change of the level by adaptation
    # part of `inertia` behind the transmission, kg m^2; None where it is not known by itself: then all of it loads the
    # transmission
    load_inertia: float | None = None
    # part of the friction level behind the transmission, N m; None where it is not known by itself
    load_friction: float | None = None
    thermal: ThermalObserver | None = None  # used where no temperature is measured
    # whole gap of the transmission that the position offset crosses, SI; 0 for none; it needs `load_friction` above
    # zero, because the side of contact depends on it
    backlash: float = 0.0
    # of the transmission whose twist the position offset takes up, N m/rad; infinity for none
    stiffness: float = math.inf
    offset_acceleration: float = 0.0  # bound on the motion of that offset, SI; 0: there is no offset
    offset_velocity: float = math.inf  # bound on the same, SI
    offset_limit: float = math.inf  # bound on its absolute value, SI
    velocity_limit: float = math.inf  # that demand and offset together stay below, SI
    setpoint_delay_s: float = 0.0  # from sending a set-point until the drive's demand equals it


class Compensator:
    """Compensate the friction of one axis with a model.

    Raises `UsageError`: a setting is out of range, or one that another setting needs is missing.
    """

    __slots__ = ("_flat", "_former", "_settings", "_state", "_whole_step", "estimator", "model", "settings")

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
        _check_offset(settings)
        if model.network is not None:
            model.network.require(True, True, settings.period_s)
        self.model = model
        self.settings = settings
        self.estimator = _estimator(model, settings)
        delay = self.estimator.delay_cycles
        longest = reference.HISTORY - 2
        if delay > longest:
            cause = f"smoothing = {settings.smoothing:g}"
            advice = f"take {1.0 / longest:.2g} or more"
            if settings.velocity not in ("difference", "drive"):
                cause, advice = settings.velocity, "let it follow a greater acceleration, or take velocity: difference"
            raise UsageError(f"{cause} delays the velocity by {delay:.1f} cycles, more than {longest}; {advice}")
        self._settings = _record(model, settings, self.estimator)
        self._whole_step = kernel.whole_step
        self._state = np.zeros(1, records.STATE)
        records.begin(self._settings, self._state, model.initial_state())
        self._flat: Array = self._state.view(np.float64)
        self._former: tuple[StructuredArray, StructuredArray] | None = None  # settings and state before a change

    def step(
        self,
        cycle: float,  # a whole number from zero; a missed cycle leaves a gap
        position: float,  # feedback, SI; only the Kalman observer and adaptation use the torque
        velocity: float,
        torque: float,
        position_demand: float,  # when the position was sampled; demands are NaN where there is no set-point
        velocity_demand: float,  # when the position was sampled
        velocity_demand_ahead: float,  # when this torque will act
        is_fresh: bool,  # the feedback is of this cycle; otherwise the velocity is predicted
        # True to fade in, False to fade out; the model runs in both cases, so that its state is right when it is needed
        is_enabled: bool,
        # when this torque will act: load of load-dependent friction and side of the backlash follow from it
        acceleration_demand_ahead: float = math.nan,
        temperature: float = math.nan,  # measured, deg C; NaN where none is measured
        # all that the load puts on the axis, N m, positive if it opposes positive motion; NaN: that of the settings'
        # gravity and inertia. Load-dependent friction depends on it; it is no part of the compensation
        load_torque: float = math.nan,
    ) -> float:
        """Compute one cycle and return the compensation, N m."""
        if self._former is not None:
            self.finish_change(
                cycle,
                position,
                velocity,
                torque,
                position_demand,
                velocity_demand,
                velocity_demand_ahead,
                is_fresh,
                is_enabled,
                acceleration_demand_ahead,
                temperature,
                load_torque,
            )
        return self._whole_step(
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
            acceleration_demand_ahead,
            temperature,
            load_torque,
        )

    def compile(self) -> None:
        """Compile `step`, so that the first cycle is as fast as the later ones; the state stays as it is."""
        self._whole_step = ready(kernel.whole_step)
        state = self.state.copy()
        for cycle in range(3):
            self.step(float(cycle), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, True, False, 0.0, math.nan)
        self.state[:] = state

    def finish_change(self, *inputs: float) -> None:
        """Compute what the former settings command in the first cycle after `adopt`; the new ones begin there.

        `step` does this too. A caller that records the state before a step does it first: then the state is whole. The
        inputs are the `INPUTS` of the cycle, in their order.
        """
        if self._former is not None:
            settings, state = self._former
            self._former = None
            self._state[0]["bridge"]["fixed"] = kernel.whole_step(settings, state, *map(float, inputs))

    def replay(self, inputs: Sequence[Array]) -> tuple[Array, Array]:
        """Compute many cycles at once; return compensation and velocity estimate, (n,).

        ``inputs``: the `INPUTS`, (n,) each, in their order.
        """
        results = self.replay_all(inputs)
        return results["compensation"], results["velocity_estimate"]

    def replay_all(self, inputs: Sequence[Array]) -> dict[str, Array]:
        """Compute many cycles at once, as `replay`; returns an (n,) array for each of `RESULTS`, by name."""
        results = np.empty((len(RESULTS), inputs[0].size))
        if inputs[0].size:
            self.finish_change(*(each[0] for each in inputs))
        kernel.replay(self._settings, self._state, *inputs, results)  # type: ignore[call-arg]
        return dict(zip(RESULTS, results, strict=True))

    def adopt(self, record: StructuredArray, friction: Array | None) -> None:
        """Go on with other settings from the next `step` on, without a step of torque.

        ``model``, ``settings`` and ``estimator`` stay those of the start; ``record`` is what counts.

        ``record``, that of a compensator made for these settings and model, is kept. ``friction``, (n,): state in which
        another model begins; None: the model stays.
        """
        if self._former is None:
            self._former = self._settings, self._state.copy()
        carry_over(self._settings, record, self._state, friction)
        self._settings = record

    def use(self, record: StructuredArray) -> None:
        """Take settings that belong to a `state` that is assigned: nothing is carried over."""
        self._settings, self._former = record, None

    def move_to(self, settings: StructuredArray, state: StructuredArray) -> None:
        """Keep settings and state in these rows of arrays, (1,) each, from now on; a compiled call may step all rows.

        The room for parameters of a model may be larger there.
        """
        records.copy(self._settings, settings)
        state[:] = self._state
        self._settings, self._state, self._flat = settings, state, state.view(np.float64)

    @property
    def is_changing(self) -> bool:
        """True from `adopt` to the next `step` or `finish_change`."""
        return self._former is not None

    @property
    def record(self) -> StructuredArray:
        """Settings and model as a record for the compiled `step`."""
        return self._settings

    @property
    def state(self) -> Array:
        """Whole state as a flat array, a live view: copy it to keep it, assign to it to restore it."""
        return self._flat

    @property
    def friction_state(self) -> Array:
        """State of the friction model, a copy."""
        state: Array = self._state[0]["friction"].copy()
        return state

    @property
    def velocity_estimate(self) -> float:
        """Estimated velocity, SI; older than the position by ``estimator.delay_cycles``."""
        return self._flat.item(_VELOCITY)

    @property
    def load_estimate(self) -> float:
        """Load torque that the model was given in the last cycle, N m."""
        return self._flat.item(_LOAD)

    @property
    def temperature_estimate(self) -> float:
        """Temperature that the model was given in the last cycle, deg C; NaN if it does not depend on it."""
        return self._flat.item(_TEMPERATURE)

    @property
    def offset_now(self) -> tuple[float, float]:
        """Position and velocity by which the motor is to deviate from the demand now, SI; see `transmission`."""
        return self._flat.item(_OFFSET_NOW), self._flat.item(_OFFSET_NOW + 1)

    @property
    def offset_sent(self) -> tuple[float, float]:
        """The same for the set-point that is sent in this cycle."""
        return self._flat.item(_OFFSET_SENT), self._flat.item(_OFFSET_SENT + 1)

    @property
    def is_faded_out(self) -> bool:
        """True if no compensation is left."""
        return self._flat.item(_FADE) == 0.0 and self._flat.item(_COMPENSATION) == 0.0

    @property
    def is_faulty(self) -> bool:
        """True if the model's torque was not finite in the last cycle; zero was used instead."""
        return bool(self._flat.item(_IS_FAULTY))

    @property
    def learned_s(self) -> float:
        """Time in which adaptation has learned, s; 0 without adaptation."""
        return self._flat.item(_LEARNED_S)

    @property
    def slowest_learning(self) -> float:
        """Velocity below which adaptation learns nothing, because it is no more than noise, SI."""
        return adaptation.MOVING_NOISES * float(self.record[0]["noise"])

    @property
    def sliding_travel(self) -> float:
        """Travel in one direction before adaptation learns: the presliding of a reversal is behind, rad or m."""
        return float(self.record[0]["sliding_travel"])

    @property
    def trained_speed(self) -> float:
        """Speed up to which the model's network was trained, SI; infinity without one."""
        p = self._settings[0]["friction"]
        begin = int(p[3])
        return float(p[begin + network.SPEED_LIMIT]) if begin else math.inf

    @property
    def has_residual(self) -> bool:
        """True if the model's network adds to a base model."""
        p = self._settings[0]["friction"]
        begin = int(p[3])
        return begin > 0 and p[begin + network.IS_RESIDUAL] != 0.0

    @property
    def gain_factor(self) -> float:
        """Factor on the gain: 1, and less after each limit cycle that was detected."""
        return self._flat.item(_GAIN_FACTOR)


_VELOCITY, _FADE, _COMPENSATION = place("motion.velocity"), place("fade"), place("compensation")
_LOAD, _TEMPERATURE, _IS_FAULTY = place("load_torque"), place("temperature.given"), place("is_faulty")
_OFFSET_NOW, _OFFSET_SENT = place("transmission.offset_now"), place("transmission.offset_sent")
_GAIN_FACTOR, _LEARNED_S = place("limit_cycle.gain_factor"), place("adaptation.learned_s")


def _check_offset(settings: CompensatorSettings) -> None:
    if not 0.0 <= settings.offset_acceleration < math.inf:
        raise UsageError(f"offset_acceleration = {settings.offset_acceleration:g} must be finite, zero or above")
    if not 0.0 <= settings.backlash < math.inf:
        raise UsageError(f"backlash = {settings.backlash:g} must be a width, zero or above")
    if settings.offset_acceleration == 0.0:
        return
    for name in ("stiffness", "offset_velocity", "offset_limit"):
        if not getattr(settings, name) > 0.0:
            raise UsageError(f"{name} = {getattr(settings, name):g} must be above zero")
    if settings.load_inertia is None or settings.load_friction is None:
        raise UsageError("an offset of the motor needs load_inertia and load_friction")
    if settings.backlash > 0.0 and not settings.load_friction > 0.0:
        raise UsageError("crossing a backlash needs load_friction above zero")


def _estimator(model: FrictionModel, settings: CompensatorSettings) -> VelocityEstimator:
    return VelocityEstimator(
        kind=settings.velocity,
        period_s=settings.period_s,
        resolution=settings.position_resolution,
        smoothing=settings.smoothing,
        acceleration=settings.acceleration,
        inertia=settings.inertia if settings.inertia > 0.0 else math.nan,
        torque_uncertainty=_UNCERTAIN_FRACTION * model.level,
        uncertainty_time_s=_UNCERTAIN_S,
        max_acceleration=settings.max_acceleration,
    )


def _record(model: FrictionModel, settings: CompensatorSettings, estimator: VelocityEstimator) -> StructuredArray:
    record = np.zeros(1, records.settings_type(model.values.size))
    c = record[0]
    step_velocity = 2.0 * settings.position_resolution / settings.period_s
    stribeck_velocity = model.parameters.get("stribeck_velocity")
    gate = step_velocity if stribeck_velocity is None else reference.GATE_STRIBECK_RATIO * stribeck_velocity
    c["kind"] = model.kind
    c["is_static"] = model.family.is_static
    c["friction"] = model.values
    c["level"] = model.level
    c["inertia"] = settings.inertia
    c["torque_ratio"] = settings.torque_ratio
    c["gravity_constant"], c["gravity_sine"], c["gravity_cosine"] = settings.gravity
    c["load_inertia"] = settings.inertia if settings.load_inertia is None else settings.load_inertia
    c["load_friction"] = 0.0 if settings.load_friction is None else settings.load_friction
    c["reference_temperature"] = model.reference_temperature
    thermal = settings.thermal
    if thermal is not None:
        c["heat_capacity"], c["thermal_resistance"] = thermal.capacity, thermal.resistance
        c["ambient"], c["first_temperature"] = thermal.ambient, thermal.initial
        c["copper_loss"] = thermal.copper_loss
    c["gap"], c["compliance"] = settings.backlash, 1.0 / settings.stiffness
    is_wound_up = c["compliance"] > 0.0 and c["load_friction"] > 0.0 and model.level > 0.0
    c["load_share"] = min(c["load_friction"] / model.level, 1.0) if is_wound_up else 0.0
    c["offset_velocity"], c["offset_acceleration"] = settings.offset_velocity, settings.offset_acceleration
    c["offset_limit"] = settings.offset_limit
    c["velocity_limit"] = settings.velocity_limit
    c["setpoint_cycles"] = settings.setpoint_delay_s / settings.period_s
    c["lead_s"] = settings.lead_s
    ahead_cycles = settings.lead_s / settings.period_s + estimator.delay_cycles
    c["ahead_s"] = ahead_cycles * settings.period_s
    c["ahead_cycles"] = min(ahead_cycles, prediction.HORIZON)
    c["judged_cycles"] = min(max(round(ahead_cycles), 1), reference.HORIZON)
    predicted_noise = max(1.0, reference.SLOPE_COEFFICIENT * ahead_cycles) * estimator.noise
    c["ahead_noise_square"] = reference.NOISE_RATIO * predicted_noise**2
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
    c["epsilon_of_demand"] = reference.RECOVERY * settings.position_resolution
    c["gate_square"] = gate * gate
    c["guided_coefficient"] = min(1.0, 2.0 * (gate / estimator.noise) ** 2)  # filters the noise down to the gate
    c["gain_positive"] = settings.gain
    c["gain_negative"] = settings.gain if settings.gain_negative is None else settings.gain_negative
    c["dead_band"] = settings.dead_band
    c["fade_s"] = settings.fade_s
    c["torque_limit"] = settings.torque_limit
    c["torque_slew"] = settings.torque_slew
    c["adaptation_s"] = settings.adaptation_s
    c["adaptation_bound"] = settings.adaptation_bound
    c["sliding_travel"] = adaptation.DEFLECTIONS * deflection
    return record
