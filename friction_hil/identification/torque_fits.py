"""One mass or two, with or without backlash: which form the torque of recordings over the time supports. Pure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from friction_hil import friction as models
from friction_hil.friction import FrictionModel
from friction_hil.identification import thresholds as th
from friction_hil.identification.compliance import ComplianceFitter, TorqueFit
from friction_hil.identification.data import RegressionSegment
from friction_hil.identification.fits import Fit
from friction_hil.identification.identify import Identification
from friction_hil.identification.motor_motion import Force, MotorMotion, motor_motion
from friction_hil.identification.refine import is_dynamic
from friction_hil.numerics.jit import Array
from friction_hil.recordings.quality import acceleration_noise


@dataclass(frozen=True, slots=True, eq=False)
class TorqueFits:
    """Fits to the torque over time: rigid, what was accepted beside it, and all that they need."""

    motions: list[MotorMotion]
    rigid: TorqueFit
    tried: TorqueFit | None
    two: TorqueFit | None
    has_gap: bool


def torque_fits(records: Sequence[RegressionSegment], result: Identification) -> TorqueFits | None:
    """Fit one mass and two masses to the torque over time; None if no record is long and fine enough."""
    model = _dynamic_model(result)
    motions = _motions(records, result, model)
    if not motions:
        return None
    inertia, level = _rough(result)
    plain = ComplianceFitter(motions, inertia, level, has_model=False)
    with_model = ComplianceFitter(motions, inertia, level, has_model=True) if model is not None else None
    rigid = min((each.rigid() for each in (plain, with_model) if each is not None), key=lambda each: each.rmse)
    if rigid.rmse <= th.TORQUE_FIT_NOISE * math.hypot(_noise(motions), _noise_of_counts(motions, records, inertia)):
        return TorqueFits(motions, rigid, None, None, has_gap=False)
    tried = None
    for fitter in (plain, with_model):
        found = None if fitter is None else fitter.compliant(rigid)
        if fitter is None or found is None:
            continue
        if tried is None or found.rmse < tried.rmse:
            tried = found
        # backlash without its own term looks like a soft or damped coupling: it is tried before anything is refused
        wide = fitter.with_backlash(found)
        has_gap = _has_gap(fitter, wide, found, records)
        best = wide if has_gap else found
        if not _is_clear(fitter, best, rigid):
            continue
        two = _checked(fitter, best, records, result, model)
        if _is_clear(fitter, two, rigid):  # in a band that shows it alone, it is noise of the encoder or of the model
            return TorqueFits(motions, rigid, best, two, has_gap=has_gap)
    return TorqueFits(motions, rigid, tried, None, has_gap=False)


def _motions(
    records: Sequence[RegressionSegment],
    result: Identification,
    model: FrictionModel | None,
    cutoff_hz: float | None = None,
) -> list[MotorMotion]:
    """Return the records that are long and fine enough, up to a number of rows."""
    found, rows = [], 0
    mechanics = result.best.mechanics
    swinging = [name for name in mechanics if name.startswith("gravity.") and mechanics[name]]
    delay_s, is_mean = _age(result, records[0].dt)

    def force(velocity: Array, dt: float) -> Array:
        return np.zeros_like(velocity) if model is None else model.simulate(velocity, dt)

    friction: Force = force
    for each in _excerpts(records):
        waves = {"gravity.constant": np.ones_like(each.position)}
        waves |= {"gravity.sine": np.sin(each.position), "gravity.cosine": np.cos(each.position)}
        gravity = sum((mechanics[name] * waves[name] for name in swinging), start=np.zeros_like(each.position))
        swing = np.array([waves[name] for name in swinging if name != "gravity.constant"])
        motion = motor_motion(
            each,
            gravity=gravity,
            swing=swing.reshape(-1, len(each.position)).T,
            delay_s=delay_s,
            is_mean=is_mean,
            inertia=_rough(result)[0],
            friction=friction,
            cutoff_hz=cutoff_hz,
        )
        if motion is not None and rows < th.MOST_ROWS:
            found.append(motion)
            rows += len(each.position)
    return found


def _excerpts(records: Sequence[RegressionSegment]) -> list[RegressionSegment]:
    """Return parts of long records, evenly spread: a search through all of them would take minutes."""
    total = sum(len(each.position) for each in records)
    if total <= th.MOST_ROWS:
        return list(records)
    found = []
    for each in records:
        count = len(each.position)
        part = int(th.MOST_ROWS * count / total / th.PARTS)
        if part * each.dt < th.LEAST_PART_S:  # as a whole, until there are enough rows
            found.append(each)
            continue
        for begin in np.linspace(0, count - part, th.PARTS).astype(int).tolist():
            rows = slice(begin, begin + part)
            found.append(
                replace(each, encoder=each.encoder[rows], torque=each.torque[rows], position=each.position[rows])
            )
    return found


def _age(result: Identification, period_s: float) -> tuple[float, bool]:
    """Return the age of the measured torque, and whether it is a mean over the period."""
    timing = result.torque
    meaning = result.settings.torque if timing is None else (timing.meaning or timing.assumed)
    if meaning == "instant":
        return 0.0, False
    if meaning == "late" and timing is not None:
        return timing.delay_s, False
    return 0.5 * period_s, True


def _dynamic_model(result: Identification) -> FrictionModel | None:
    """Return the best dynamic friction that was fitted."""
    dynamic = [each for each in result.fits if is_dynamic(each.structure)]
    return None if not dynamic else model_of(dynamic[0], result)


def model_of(fit: Fit, result: Identification) -> FrictionModel:
    """Return the friction model of a fit, without what depends on the position or the load."""
    parameters, modifiers = fit.friction
    own = {name: content for name, content in modifiers.items() if name in ("direction", "viscous")}
    return models.create(fit.structure.family, modifiers=own or None, axis=result.settings.axis, **parameters)


def _rough(result: Identification) -> tuple[float, float]:
    """Return a rough inertia and a rough level of friction, both above zero."""
    curves = result.best.curves
    torque = float(np.sqrt(np.mean(curves.measured**2)))
    acceleration = float(np.sqrt(np.mean(curves.acceleration**2)))
    inertia = result.best.mechanics["inertia"]
    level = float(np.quantile(np.abs(curves.friction), 0.95))
    least = 1e-2 * torque / acceleration if acceleration > 0.0 else 1.0
    return max(inertia, least, 1e-12), max(level, 1e-3 * torque, 1e-12)


def _noise(motions: Sequence[MotorMotion]) -> float:
    """Return the RMS of the torque's noise below the cut-off, as far as it is white: by what is above the cut-off."""
    found = []
    for each in motions:
        rate = 1.0 / each.dt
        spectrum = np.abs(np.fft.rfft(each.torque * np.hanning(len(each.torque)))) ** 2
        frequency = np.fft.rfftfreq(len(each.torque), each.dt)
        high = spectrum[frequency > max(0.5 * rate - 0.1 * rate, each.cutoff_hz)]
        window = float(np.sum(np.hanning(len(each.torque)) ** 2))
        power = 2.0 * float(np.median(high)) / math.log(2.0) / (rate * window)
        found.append(math.sqrt(0.5 * power * 2.0 * each.cutoff_hz))
    return float(np.median(found))


def _noise_of_counts(motions: Sequence[MotorMotion], records: Sequence[RegressionSegment], inertia: float) -> float:
    """Return the RMS of the torque that counts of the encoder make below the cut-off.

    A load behind a soft coupling does not feel them: two masses would leave less of it, on a rigid axis too.
    """
    count = max((each.resolution or 0.0) for each in records)
    return inertia * max(acceleration_noise(count, each.cutoff_hz, 1.0 / each.dt) for each in motions)


def _is_clear(fitter: ComplianceFitter, two: TorqueFit, rigid: TorqueFit) -> bool:
    """True if two masses fit clearly better than one, and swing."""
    values, errors = two.values, two.errors
    load, motor = values["load_inertia"], values["motor_inertia"]
    return (
        swings(two, rigid)
        and fitter.evidence(two, rigid) > th.TORQUE_FIT_BETTER
        and motor > max(th.TORQUE_FIT_LEAST_SHARE * (load + motor), th.TORQUE_FIT_CLEAR * errors["motor_inertia"])
    )


def swings(two: TorqueFit, rigid: TorqueFit) -> bool:
    """True if two masses leave less than one, and the load is a mass that swings on its spring."""
    values, load = two.values, two.values["load_inertia"]
    damping = 0.5 * values["damping"] / math.sqrt(values["stiffness"] * load)
    return (
        two.rmse < th.FALL * rigid.rmse
        and load
        > max(
            th.TORQUE_FIT_LEAST_SHARE * (load + values["motor_inertia"]),
            th.TORQUE_FIT_CLEAR * two.errors["load_inertia"],
        )
        and damping < th.MOST_DAMPED
    )


def _has_gap(
    fitter: ComplianceFitter, wide: TorqueFit, without: TorqueFit, records: Sequence[RegressionSegment]
) -> bool:
    count = max((each.resolution or 0.0) for each in records)
    gap, error = wide.values["backlash"], wide.errors["backlash"]
    return (
        wide.rmse < th.FALL * without.rmse
        and fitter.evidence(wide, without) > th.TORQUE_FIT_BETTER
        and gap > max(th.TORQUE_FIT_CLEAR * error, th.LEAST_COUNTS * count)
        and wide.free > th.LEAST_FREE
    )


def _checked(
    fitter: ComplianceFitter,
    fit: TorqueFit,
    records: Sequence[RegressionSegment],
    result: Identification,
    model: FrictionModel | None,
) -> TorqueFit:
    """Return a fit whose standard errors include how far it depends on the band that is compared."""
    low = [_motions([each], result, model, cutoff_hz=th.NARROW * _cutoff(each, result, model)) for each in records]
    motions = [motion for each in low for motion in each]
    if not motions:
        return fit
    inertia, level = _rough(result)
    again = ComplianceFitter(motions, inertia, level, has_model=fitter.has_model).near(fit)
    errors = {name: math.hypot(error, again.values[name] - fit.values[name]) for name, error in fit.errors.items()}
    return replace(fit, errors=errors)


def _cutoff(record: RegressionSegment, result: Identification, model: FrictionModel | None) -> float:
    found = _motions([record], result, model)
    return found[0].cutoff_hz if found else 0.1 * record.rate_hz
