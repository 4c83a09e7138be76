"""Identification of an axis from its experiment, and the fits that are worth trying on the machine. Pure."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from friction_hil import friction as models
from friction_hil.config import Configuration
from friction_hil.errors import FrictionHilError, RecordingError, internal_error
from friction_hil.identification import Fit, Identification, IdentificationSettings, identify
from friction_hil.identification.choice import by_likelihood, choose, is_determined
from friction_hil.identification.data import Data, prepare
from friction_hil.identification.fine import is_presliding_excited
from friction_hil.identification.modifiers import with_ripple
from friction_hil.identification.refine import is_dynamic
from friction_hil.identification.scales import estimate_scales
from friction_hil.identification.settings import FitStep, chosen_families
from friction_hil.identification.structures import build
from friction_hil.identification.structures import starts as first_values
from friction_hil.numerics.filtering import lowpass, lowpass_padding
from friction_hil.recordings import Recording
from friction_hil.replay.verify import facts_of
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.closed_loop import Start
from friction_hil.tuning.cogging import PositionTorque
from friction_hil.tuning.motions import experiment_of, sliding_part

CandidateFit = tuple[Identification, Fit]
"""A fit that is to be tried, with the identification that it belongs to."""


@dataclass(frozen=True, slots=True, eq=False)
class ExperimentPart:
    """A part of an experiment, complete in itself."""

    recording: Recording  # of a run of `friction_hil.tuning.motions.experiment_run`, with a torque
    duration_s: float  # length that was given to it


_LUGRE, _GMS, _CURVE = "lugre", "gms", "stribeck"
_NO_PRESLIDING = (
    "the recording does not show presliding: its stiffness and damping (sigma0, sigma1) are not determined by the "
    "torque, to which only static models are fitted; --models lugre fits one nevertheless"
)


def identified(
    parts: Sequence[ExperimentPart],  # all parts of the experiment of an axis
    configuration: Configuration,  # from which these runs were made
    families: Sequence[str],  # to fit; empty: all
    *,
    on_fit: Callable[[FitStep], None],  # called before each fit
    # called with a sentence on what cannot be identified, or what an internal error has cost
    on_problem: Callable[[str], None],
    whole: PositionTorque | None = None,  # what depends on the position, if it is identified over all of the travel
) -> list[Identification]:
    """Identify dynamic models from all of an experiment, and static ones from where the axis slides.

    Raises `RecordingError`: nothing can be identified.
    """
    found: list[Identification] = []
    problem: RecordingError | None = None
    name = parts[0].recording.axis
    travel = experiment_of(name, configuration.axes[name]).travel
    for recordings, settings in _parts(parts, configuration, tuple(families), on_problem):
        if whole is not None:
            recordings = [*recordings, *whole.recordings]
            settings = replace(settings, orders=whole.orders, refine=not settings.sliding_s or None)
        kind = "dynamic"
        if settings.sliding_s:
            kind, settings = "static", replace(settings, sliding_distance=_sliding_distance(found, travel))
        try:
            found.append(_identified(recordings, settings, on_fit))
        except RecordingError as error:  # e.g. an axis that hardly slides
            problem = problem or error
            on_problem(f"no {kind} model: {error}")
    if problem is not None and not found:
        raise problem
    for text in dict.fromkeys(text for each in found for text in each.failures):
        on_problem(text)
    return found


def _identified(
    recordings: Sequence[Recording], settings: IdentificationSettings, on_fit: Callable[[FitStep], None]
) -> Identification:
    """Identify; an error of the program costs the families of these settings, not the experiment.

    Raises `RecordingError`: nothing can be identified.
    """
    try:
        return identify(recordings, settings, progress=on_fit)
    except FrictionHilError:
        raise
    except Exception as error:
        raise RecordingError(f"{', '.join(settings.families)}: {internal_error(error)}") from error


def closed_loop_starts(
    found: Sequence[Identification],  # of `identified`
    parts: Sequence[ExperimentPart],
    configuration: Configuration,
    families: Sequence[str],  # to fit; empty: all
) -> list[Start]:
    """Return where searches in closed loop begin: the family that predicts the torque best, LuGre and GMS.

    They begin at their fits to the torque, LuGre on the steady curve of the slow sweeps. If the recording shows no
    presliding, only LuGre begins, with a deflection of a count, at all and at half of the hump; if it shows no hump
    either, none does.
    """
    first, curve = found[0], _steady_curve(parts, configuration)
    wanted = {name for name in chosen_families(tuple(families)) if not models.describe(name).is_static}
    if not is_dynamic(first.best.structure):
        wanted &= {_LUGRE} if curve else set()
    data = Data(list(first.records))
    scales = estimate_scales(data, ("inertia", "offset"))
    one_sided = first.best if curve is None else curve
    # where the axis sticks and slips, a fit to all of the torque makes ripple up
    static = [each for each in found if not is_dynamic(each.best.structure)]
    rippled = [first.best] if first.settings.orders else [each.best for each in static]
    orders = tuple(each["order"] for fit in rippled for each in fit.friction[1].get("ripple", ()))
    starts = []
    for family in dict.fromkeys((first.best.structure.family, _LUGRE, _GMS)):
        if family not in wanted:
            continue
        fits = by_likelihood([each for each in first.fits if each.structure.family == family])
        structure = build(
            family,
            scales,
            first.settings.axis,
            data.records[0].dt,
            is_directed="direction" in one_sided.structure.modifiers,
        )
        structure = with_ripple(structure, orders) if orders else structure
        values = next(first_values(structure, scales, 0, 0)) | dict.fromkeys(structure.linear, 0.0)
        values["inertia"] = (first.best if curve is None else curve).mechanics["inertia"]
        for fit in rippled:
            values |= {name: x for name, x in fit.values.items() if name in values and name.startswith("ripple[")}
        for fit in fits[:1]:
            _take(values, {name: x for name, x in fit.values.items() if not name.startswith("ripple[")})
        if curve is not None and (family == _LUGRE or not fits or fits[0].structure.is_flat):
            _take(values, {_of_family(name, family): value for name, value in curve.values.items()})
        if family == _LUGRE and not fits:
            level = float(np.sqrt(np.mean(first.best.curves.friction**2)))
            values["sigma0"] = level / facts_of(parts[0].recording.metadata, parts[0].recording).position_resolution
        if "sigma1" in values:  # a fit to the torque makes up for a state that it does not resolve by damping
            most = math.sqrt(values["sigma0"] * values["inertia"])
            values["sigma1"] = min(values["sigma1"], most) if fits else most
        starts.append(Start(first, fits[0] if fits else first.best, structure, values))
        if not fits and family == _LUGRE:  # slow sweeps alone hardly show how high the hump is
            lower = {
                name: 0.5 * (value + values[name.replace("static", "coulomb")])
                for name, value in values.items()
                if name.rpartition(".")[2] == "static"
            }
            starts.append(replace(starts[-1], values={**values, **lower}))
    return starts


def _take(values: dict[str, float], known: Mapping[str, float]) -> None:
    """Set values that are known by the same name, or by that of the other side or of both."""
    plain = {name.rpartition(".")[2]: value for name, value in known.items()}
    for name in values:
        value = known.get(name, plain.get(name.rpartition(".")[2]))
        if value is not None:
            values[name] = value


def _of_family(name: str, family: str) -> str:
    """Return the name in another family of a parameter of Stribeck's model."""
    is_renamed = any(each.name == "sigma2" for each in models.describe(family).parameters)
    return f"{name.removesuffix('viscous')}sigma2" if is_renamed and name.endswith("viscous") else name


def _steady_curve(parts: Sequence[ExperimentPart], configuration: Configuration) -> Fit | None:
    """Return Stribeck's model of the slow sweeps, if they show its hump and the inertia."""
    slow, settings = slow_sweeps(parts, configuration, (_CURVE,))
    try:
        found = _identified(slow, replace(settings, has_modifiers=False), lambda _: None)
    except RecordingError:  # the axis hardly slides
        return None
    fits = [fit for fit in found.fits if not fit.structure.is_flat and fit.mechanics["inertia"] > 0.0]
    return choose(fits)[0] if by_likelihood(fits) else None


def candidates(found: Sequence[Identification]) -> list[CandidateFit]:
    """Return the best sound static fit and the best sound dynamic one, in the order in which they were identified.

    If no fit is sound, it is the best one of the first identification.
    """
    fits: dict[bool, CandidateFit] = {}
    for identification in found:
        for fit in identification.fits:
            if math.isfinite(fit.held_out.rmse) and _is_sound(fit):
                fits.setdefault(is_dynamic(fit.structure), (identification, fit))
    return list(fits.values()) or [(found[0], found[0].best)]


def _sliding_distance(found: Sequence[Identification], travel: float) -> float:
    """Return the distance after a reversal in which the friction turns, by the dynamic model that was found first."""
    if not found:
        return 0.0
    fit = found[0].best
    parameters, modifiers = fit.friction
    model = models.create(fit.structure.family, modifiers=modifiers, axis=fit.structure.axis, **parameters)
    stiffness = model.presliding_stiffness
    turned = th.TURNING * model.level / stiffness if stiffness > 0.0 else 0.0
    return min(turned, th.MOST_TURNING * travel)


def _parts(
    parts: Sequence[ExperimentPart],
    configuration: Configuration,
    wanted: tuple[str, ...],
    on_problem: Callable[[str], None],
) -> Iterator[tuple[list[Recording], IdentificationSettings]]:
    """Yield recordings with the families to identify from them: dynamic ones from all, static ones from slow sweeps."""
    recordings = [each.recording for each in parts]
    kind = configuration.axes[recordings[0].axis].model.axis
    families = chosen_families(wanted)
    static = tuple(family for family in families if models.describe(family).is_static)
    dynamic = tuple(family for family in families if family not in static)
    if dynamic and not wanted and not shows_presliding(recordings):
        on_problem(_NO_PRESLIDING)
        dynamic = ()
    if dynamic:
        is_noisy = any(map(_is_velocity_noisy, recordings))
        lowpass_hz = _lowpass_hz(configuration.period_s) if is_noisy else None
        yield recordings, IdentificationSettings(families=dynamic, axis=kind, lowpass_hz=lowpass_hz)
    if static:
        yield slow_sweeps(parts, configuration, static)


def slow_sweeps(
    parts: Sequence[ExperimentPart], configuration: Configuration, families: tuple[str, ...]
) -> tuple[list[Recording], IdentificationSettings]:
    """Return the slow sweeps, with the settings for static families."""
    slow = [sliding_part(each.recording, configuration, each.duration_s) for each in parts]
    return slow, sliding_settings(parts[0].recording, configuration, families)


def shows_presliding(recordings: Sequence[Recording]) -> bool:
    """Return True if all of these recordings of experiments show presliding."""
    return all(is_presliding_excited(segment) for each in recordings for segment in prepare(each))


def sliding_settings(
    recording: Recording, configuration: Configuration, families: tuple[str, ...]
) -> IdentificationSettings:
    """Return the settings for models without presliding: only rows count about which the axis slides.

    The velocity is the derivative of the position, which has no delay, and whose noise is that of the counts. An
    axis that takes longer for a count than the low-pass averages has no known velocity.
    """
    name, period_s = recording.axis, configuration.period_s
    axis = configuration.axes[name]
    [facts] = (each for each in recording.metadata["facts"] if each["name"] == name)
    lowpass_hz = _lowpass_hz(period_s)
    seen = facts["position_resolution"] * lowpass_hz / th.COUNT_PERIODS
    return IdentificationSettings(
        families=families,
        axis=axis.model.axis,
        least_speed=max(th.LEAST_SPEED_RATIO * experiment_of(name, axis).velocity, seen),
        sliding_s=th.SLIDING_PERIODS / lowpass_hz,
        lowpass_hz=lowpass_hz,
        decimation=max(1, round(1.0 / (period_s * th.ROWS_HZ))),
    )


def _lowpass_hz(period_s: float) -> float:
    """Return the cut-off of the position, Hz."""
    return min(th.LOWPASS_HZ, th.LOWPASS_RATIO / period_s)


def _is_velocity_noisy(recording: Recording) -> bool:
    """Return True if the drive's velocity jumps with the counts of the encoder, more than the axis can.

    What is faster than the low-pass of the position is mostly noise in both; an axis that moves leaves little there.
    """
    velocity = recording["velocity"]
    known = velocity[np.isfinite(velocity)]
    if len(known) <= lowpass_padding() or not known.any():
        return False
    rest = known - lowpass(known, _lowpass_hz(recording.period_s), 1.0 / recording.period_s)
    return float(np.std(rest)) > th.NOISY_RATIO * float(np.std(known))


def _is_sound(fit: Fit) -> bool:
    """True if the data determine a fit and, for a static one, no parameter is at a bound.

    Around a reversal, presliding looks like a level near zero at standstill. A model without presliding that was
    fitted to it would take the compensation away just where the axis reverses.
    """
    return is_determined(fit) and (is_dynamic(fit.structure) or not _at_bound(fit))


def _at_bound(fit: Fit) -> list[str]:
    return [each.name for each in fit.structure.coordinates if each.name in fit.estimate.at_bound]
