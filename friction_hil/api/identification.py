"""`identify`: friction and mechanics of an axis from recordings; the work of ``friction-hil identify`` too."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from friction_hil import __version__
from friction_hil.api.arguments import (
    Progress,
    check_choice,
    check_numbers,
    families,
    read,
    require_recording,
    shown_by,
)
from friction_hil.api.result import Result
from friction_hil.errors import UsageError
from friction_hil.identification import Identification, IdentificationSettings, free_run
from friction_hil.identification import identify as identified_from
from friction_hil.identification.drive_loop import DriveLoops
from friction_hil.identification.export import (
    add_mechanics,
    as_json,
    as_model_file,
    mechanics_as_json,
    model_file,
    standard_errors,
)
from friction_hil.identification.mechanics import Mechanics, find_mechanics
from friction_hil.identification.moving_beside import moving_beside
from friction_hil.identification.plausibility import Finding, check_result
from friction_hil.identification.static_map import StaticFit, StaticMap, fit_map
from friction_hil.recordings import Recording, read_all
from friction_hil.recordings.given import Given, kind_of
from friction_hil.recordings.segments import with_position
from friction_hil.tuning.settings import ShowStep
from friction_hil.tuning.simulated import recorded_loops

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CONTROLLER = {"position_gain", "velocity_gain"}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Identified(Result):
    """Result of `identify`.

    Attributes
    ----------
    found : Identification or StaticMap
        All candidates, the chosen one as ``found.fits[0]``.
    findings : tuple of Finding
        What speaks against the result; a fatal one makes it unusable.
    mechanics : Mechanics or None
        What was found behind the motor.
    loops : DriveLoops or None
        Loops of the drive, if a recording of the daemon shows them.
    no_loops : str
        Why a recording of the daemon does not show them; empty if it does, and of other recordings.
    """

    found: Identification | StaticMap
    findings: tuple[Finding, ...] = ()
    mechanics: Mechanics | None = None
    loops: DriveLoops | None = None
    no_loops: str = ""

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw friction over velocity, measured and of the model; see `Result.plot`."""
        from friction_hil.reports.result_pictures import draw_identified  # imported here: it needs matplotlib

        return draw_identified(self.found, self.label, ax)


def identify(
    recording: Given,
    *,
    models: str | Sequence[str] = "all",
    validate: Given = (),
    fix: Mapping[str, float] | None = None,
    linear: bool = False,
    static: bool = False,
    gravity: Literal["auto", "none", "constant", "pendulum"] = "auto",
    unknown_gain: bool = False,
    min_speed: float = 0.0,
    group_by: str | None = None,
    torque_is: Literal["auto", "mean", "instant"] = "auto",
    refine: bool | None = None,
    axis: str | None = None,
    column: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    rate: float | None = None,
    where: str | None = None,
    lowpass: float | None = None,
    decimate: int | None = None,
    loss: Literal["squares", "huber"] = "squares",
    controller: Mapping[str, float] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Identified:
    """Identify the friction model of an axis, its parameters with errors, inertia, offset and gravity.

    ``friction-hil identify`` does the same with the options of these names; its help says more of each.

    Parameters
    ----------
    recording : path, Recording, dict of arrays, data frame, or a list of these
        Motion and torque of the axis: position, or velocity, in rad (or m) and torque in N m (or N) over ``time_s``.
    models : str or sequence of str
        Families of models to try, by name.
    validate : as recording
        Recordings to judge by, not to fit to; without any, parts of the others are held out.
    fix : dict of str to float
        Parameters held at a value, SI.
    linear : bool
        True for a linear axis: m, N, kg.
    static : bool
        True if the recordings are maps of velocity and torque at constant speeds, without time and position.
    gravity : str
        ``auto``, ``none``, ``constant`` (a vertical axis) or ``pendulum``.
    unknown_gain : bool
        True if the column torque is a signal of unknown gain; ``fix`` then sets the scale.
    min_speed : float
        Rows at which the axis is slower are ignored, rad/s or m/s.
    group_by : str, optional
        Entry of the metadata by which recordings are held out together.
    torque_is : str
        ``auto``, ``mean`` since the last sample or ``instant``: what the drive reports.
    refine : bool, optional
        True to fit the chosen dynamic model again with the full bandwidth; by default if presliding shows.
    axis : str, optional
        Axis to read from a recording that has several.
    column : dict of str, optional
        friction_hil's name of a column to the file's, with a factor: ``{"torque": "current*0.16"}``.
    scale : dict of str to float, optional
        Factors to SI by friction_hil's names of columns.
    rate : float, optional
        Sampling rate of a recording without time stamps, Hz.
    where : str, optional
        Column that is zero where the torque does not count.
    lowpass : float, optional
        The velocity is derived from the position, low-passed at this frequency without delay, Hz.
    decimate : int, optional
        Every n-th sample is compared.
    loss : str
        ``squares`` or ``huber``, which gives outliers less weight.
    controller : dict of str to float, optional
        ``position_gain`` (1/s) and ``velocity_gain`` (torque per velocity) of the loop that made the motion: the axis
        is simulated in closed loop too, from ``position_demand``.
    seed : int
        Seed of the random starting values: the same one gives the same result.
    progress : callable, optional
        Called with the stage and the done share of its steps, 0 to 1, or None where their number is not known.

    Returns
    -------
    Identified

    Raises
    ------
    RecordingError
        A recording cannot be read, lacks a column or is too short, or the axis does not move.
    UsageError
        An argument is wrong.

    Examples
    --------
    An axis with Coulomb friction 0.3 N m, viscous friction 0.05 N m s/rad and inertia 0.02 kg m^2:

    >>> import numpy as np
    >>> import friction_hil as fh
    >>> t = np.arange(3000) * 0.004
    >>> v = np.cos(5.0 * t) + 0.4 * np.cos(13.0 * t + 1.0)
    >>> torque = 0.3 * np.sign(v) + 0.05 * v + 0.02 * np.gradient(v, t)
    >>> found = fh.identify({"time_s": t, "position": np.cumsum(v) * 0.004, "velocity": v, "torque": torque},
    ...                     models="coulomb")
    >>> found.label, f"{found.model.friction.parameters['coulomb']:.2f}"
    ('coulomb', '0.30')
    """
    return identified(
        recording,
        shown_by(progress),
        models=models,
        validate=validate,
        fix=fix,
        linear=linear,
        static=static,
        gravity=gravity,
        unknown_gain=unknown_gain,
        min_speed=min_speed,
        group_by=group_by,
        torque_is=torque_is,
        refine=refine,
        reading={"axis": axis, "column": column, "scale": scale, "rate": rate, "where": where},
        lowpass=lowpass,
        decimate=decimate,
        loss=loss,
        controller=controller,
        seed=seed,
    )


def identified(
    given: Given,
    show: ShowStep,
    *,
    models: str | Sequence[str],
    validate: Given,
    fix: Mapping[str, float] | None,
    linear: bool,
    static: bool,
    gravity: Any,
    unknown_gain: bool,
    min_speed: float,
    group_by: str | None,
    torque_is: Any,
    refine: bool | None,
    reading: Mapping[str, Any],  # axis, column, scale, rate and where
    lowpass: float | None,
    decimate: int | None,
    loss: str,
    controller: Mapping[str, float] | None,
    seed: int,
) -> Identified:
    """Identify an axis; see `identify`. ``show`` is told of the steps."""
    require_recording(given)
    held, controller = dict(fix or {}), dict(controller or {})
    check_numbers(**{f"fix: {name}": value for name, value in held.items()})
    if static:
        return _identified_map(given, families(models), held, is_linear=linear, reading=reading)
    settings = settings_of(models, gravity, min_speed, group_by, torque_is, refine, lowpass, decimate, loss, seed)
    _check_controller(controller)
    if unknown_gain and controller:
        raise UsageError("--controller needs a measured torque: not with --unknown-gain")
    recordings = list(map(with_position, read(given, **reading)))
    validation = list(map(with_position, read(validate, **reading)))
    kind = kind_of([*recordings, *validation], is_linear=linear)
    settings = replace(settings, axis=kind, held=held, has_unknown_gain=unknown_gain)
    return identified_axis(recordings, validation, settings, show, _beside(recordings), controller)


def settings_of(
    models: str | Sequence[str],
    gravity: Any,
    min_speed: float,
    group_by: str | None,
    torque_is: Any,
    refine: bool | None,
    lowpass: float | None,
    decimate: int | None,
    loss: str,
    seed: int,
) -> IdentificationSettings:
    """Return the settings of arguments that one axis and all joints of a log have in common; check them."""
    check_choice("gravity", gravity, ("auto", "none", "constant", "pendulum"))
    check_choice("torque_is", torque_is, ("auto", "mean", "instant"))
    check_choice("loss", loss, ("squares", "huber"))
    check_numbers(0.0, min_speed=min_speed, seed=seed)
    check_numbers(1, decimate=decimate)
    return IdentificationSettings(
        families=families(models),
        gravity=gravity,
        is_robust=loss == "huber",
        least_speed=min_speed,
        group_by=group_by,
        seed=seed,
        lowpass_hz=lowpass,
        decimation=decimate,
        refine=refine,
        torque=torque_is,
    )


def identified_axis(
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    settings: IdentificationSettings,
    show: ShowStep,
    beside: Mapping[str, Mapping[str, Recording]],  # recordings of other axes, by path and name
    controller: Mapping[str, float],
    *,
    has_mechanics: bool = True,  # what is behind the motor is looked for
    prefer: Callable[[Identification], Identification] = lambda found: found,
) -> Identified:
    """Identify an axis from recordings of it alone, and judge the result."""
    result = prefer(
        identified_from(
            recordings,
            settings,
            validation=validation,
            progress=lambda step: show(f"{step.stage}: {step.label}", step.number, step.count),
        )
    )
    disturbed = moving_beside(result, beside)
    findings = [*check_result(result, recordings), *([Finding(disturbed)] if disturbed else [])]
    texts = [each.text for each in findings]
    content = mechanics = None
    free: dict[str, Any] = {"relative_error": None, "reason": "no usable model"}
    if not any(each.is_fatal for each in findings):
        if has_mechanics:
            mechanics = find_mechanics(
                recordings, result, disturbed=disturbed, report=lambda step: show(f"mechanics: {step}")
            )
        free = _free_run(result, controller)
        content = as_model_file(result, signal=recordings[0].sources.get("torque", "torque"))
        content["fit"]["flags"] += texts
        if mechanics is not None:
            add_mechanics(content, mechanics)
    loops, no_loops = recorded_loops(recordings)
    facts = {
        **as_json(result),
        "mechanics": None if mechanics is None else mechanics_as_json(mechanics),
        "drive_loops": None if loops is None else asdict(loops),
        "is_usable": content is not None,
        "findings": texts,
        "free_run": free,
        "output": None,
        "report": None,
    }
    return Identified(
        label=result.best.label,
        reason=result.reason,
        flags=(*texts, *result.best.flags, *(() if mechanics is None else mechanics.flags), *facts["problems"]),
        standard_errors=standard_errors(result.best),
        content=content,
        facts=facts,
        found=result,
        findings=tuple(findings),
        mechanics=mechanics,
        loops=loops,
        no_loops=no_loops,
    )


def _beside(recordings: Sequence[Recording]) -> dict[str, dict[str, Recording]]:
    """Return the motion of the other axes that the daemon recorded in the same files, by path and name."""
    found = {}
    for each in recordings:
        if len(each.metadata.get("facts", ())) > 1:
            there = read_all(each.path, only=("time_s", "position"))
            found[each.path] = {name: other for name, other in there.items() if name != each.axis}
    return found


def _check_controller(controller: Mapping[str, float]) -> None:
    if unknown := set(controller) - _CONTROLLER:
        raise UsageError(f"--controller takes position_gain and velocity_gain, not {', '.join(sorted(unknown))}")
    if controller and set(controller) != _CONTROLLER:
        raise UsageError(f"--controller also needs {', '.join(sorted(_CONTROLLER - set(controller)))}")
    check_numbers(**controller)


def _free_run(result: Identification, controller: Mapping[str, float]) -> dict[str, Any]:
    """Simulate the chosen model in closed loop; return its relative error, or the reason why there is none."""
    if not controller:
        return {"relative_error": None, "reason": "the controller is not known: give --controller"}
    record = result.records[0]
    if record.demand is None:
        return {"relative_error": None, "reason": f"{record.path} has no position_demand"}
    loop = free_run.cascade(record.demand, controller["position_gain"], controller["velocity_gain"])
    run = free_run.simulate_axis(
        model_file(result),
        loop,
        len(record.demand),
        record.dt,
        position=float(record.position[0]),
        velocity=float(record.velocity[0]),
    )
    return {"relative_error": run.relative_error(record.torque, record.begin), "reason": None}


def _identified_map(
    given: Given, models: Sequence[str], held: dict[str, float], *, is_linear: bool, reading: Mapping[str, Any]
) -> Identified:
    """Fit static friction to points of speed and torque."""
    if set(held) - {"inertia"}:
        raise UsageError("--static takes --fix inertia=VALUE alone, which a map does not show")
    recordings = read(given, is_preview=True, **reading)
    result = fit_map(recordings, models)
    best = result.fits[0]
    notes = list(result.notes)
    if "inertia" not in held:
        notes.append("a map shows no inertia: --fix inertia=VALUE writes it into the model file")
    problems = list(dict.fromkeys(problem for each in recordings for problem in each.problems))
    named = [{"path": each.path, "rows": len(each)} for each in recordings]
    reason = "lowest information criterion (AICc)"
    facts = {
        "best": best.family,
        "reason": reason,
        "recordings": named,
        "fits": [_fit_as_json(each) for each in result.fits],
        "output": None,
        "problems": problems,
        "notes": notes,
        "is_usable": True,
        "findings": [],
        "report": None,
    }
    errors = {name: error if math.isfinite(error) else None for name, error in best.standard_errors.items()}
    content = {
        "version": 1,
        "axis": "linear" if is_linear else "rotary",
        "friction": {"model": best.family, "parameters": best.parameters},
        "mechanics": {"inertia": held.get("inertia", 0.0), "offset": best.offset},
        "fit": {
            "software": f"friction_hil {__version__}",
            "recordings": named,
            "chosen": "static map of speeds and torques, lowest AICc",
            "train": {"rmse": best.rmse, "relative_error": best.relative_error},
            "standard_errors": {name: error for name, error in errors.items() if error is not None},
            "range": {"velocity": [float(result.velocity.min()), float(result.velocity.max())]},
        },
    }
    return Identified(
        label=best.family,
        reason=reason,
        flags=(*notes, *problems),
        standard_errors=errors,
        content=content,
        facts=facts,
        found=result,
    )


def _fit_as_json(fit: StaticFit) -> dict[str, Any]:
    return {
        "model": fit.family,
        "label": fit.family,
        "parameters": fit.parameters,
        "modifiers": {},
        "standard_errors": fit.standard_errors,
        "mechanics": {"offset": fit.offset},
        "train": {"rmse": fit.rmse, "relative_error": fit.relative_error},
    }
