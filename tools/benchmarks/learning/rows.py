"""The rows of the benchmark of learning: what goes wrong with a model, and what learning makes of it."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from friction_hil import friction
from friction_hil.compensator import Compensator
from friction_hil.friction import FrictionModel
from friction_hil.learning.coordinates import value_of, with_values
from friction_hil.learning.layer import REVERSAL, SPEED, Layer, pairs
from friction_hil.learning.thresholds import LAYER_SHARE as SHARE
from tools.benchmarks.compensation.grid import DriveLoops, Grid, Plant
from tools.benchmarks.compensation.motions import GridMotion
from tools.benchmarks.compensation.numbers import geometric_mean
from tools.benchmarks.learning.axis import Axis, Sensors
from tools.benchmarks.learning.case import Event, Followed, Setup, follow, setup, without

AFTER_S = 60.0  # of the axis's own motion, then the error is scored
SCORED_S = 4.0
LONG_SCORED_S = 20.0  # stick-slip varies by a tenth from a few strokes to the next
WRONG = ("mismatch_a", "mismatch_b")
_LEVELS = ("coulomb", "static", "sigma2", "viscous")
_DRIFT_S = 600.0
_DRIFT = 0.4
_LOAD_S, _LOAD = 400.0, 1.5  # time and factor of the change of load
_DRIFT_SCORED_S = 20.0
_SLOW = GridMotion(amplitude=0.02, frequency=0.5)
_CHANGING = (
    (60.0, GridMotion(amplitude=0.2, frequency=0.5)),
    (60.0, GridMotion(amplitude=3.0, frequency=1.0)),
    (60.0, _SLOW),
    (60.0, GridMotion(kind="dwell", amplitude=0.2, frequency=0.5)),
    (60.0, GridMotion(amplitude=1.0, frequency=1.0)),
)
_NOISE = 0.05  # of the rated torque: standard deviation of the torque feedback
_COGGING = {7.0: 0.05, 24.0: 0.065}  # amplitude in friction levels, by order
# Maxwell-slip elements: shares of the stiffness and of the level
_SLIP_STIFFNESS, _SLIP = (0.4, 0.3, 0.2, 0.1), {"weight": [0.25] * 4, "attraction": 20.0}
_HUMP = {0.02: 0.0, 0.05: 0.05, 0.15: 0.08, 0.5: 0.05, 2.0: 0.0}  # in friction levels, by speed in rad/s
_WEIGHT, _LOAD_FACTORS, _LEAST_LOAD = 2.0, {"motoring": 0.15, "driven": 0.1}, 0.3  # friction levels
_WRONG_S, _WRONG_LAYERS = 8.0, 6
_FAMILIES = (
    ("gms", "lugre"),
    ("gms", "gms"),
    ("elasto_plastic", "lugre"),
    ("elasto_plastic", "elasto_plastic"),
    ("lugre", "stribeck"),
    ("lugre", "coulomb"),
    ("lugre", "lugre"),
)  # of the axis, and of its model file
_FAMILY_MOTIONS = (0, 2)
FAMILY_S = 150.0  # of motion: a family is judged by eight windows of six seconds, after those it learns from
_HAPPENS_S = 30.0
_STOP_S = 1.0


@dataclass(frozen=True, slots=True)
class Figure:
    """One measured case.

    Attributes
    ----------
    row, case : str
    values : dict
        What was measured; names end in their unit or are ratios.
    """

    row: str
    case: str
    values: dict[str, float]


def cases_of(grid: Grid, row: str) -> list[tuple[str, Callable[[], Figure]]]:
    """Return the cases of a row with their names."""
    return [(name, partial(_figure, row, name, work)) for name, work in _ROWS[row](grid)]


def names() -> list[str]:
    """Return the names of the rows."""
    return list(_ROWS)


def summary(row: str, figures: list[Figure]) -> dict[str, float]:
    """Return geometric means and worst cases of a row."""
    found: dict[str, float] = {"cases": float(len(figures))}
    for name in figures[0].values:
        values = [each.values[name] for each in figures]
        if name.endswith(("_rms", "_peak", "_ratio")):
            found |= {f"{name} geomean": geometric_mean(values), f"{name} worst": min(values)}
        elif name.endswith("_s"):
            found |= {f"{name} most": max(values)}
        else:
            found |= {f"{name} sum": math.fsum(values)}
    return found


def _figure(row: str, case: str, work: Callable[[], dict[str, float]]) -> Figure:
    return Figure(row, case, work())


Cases = Iterator[tuple[str, Callable[[], dict[str, float]]]]


def _combinations(grid: Grid, conditions: tuple[str, ...], seconds: float) -> Iterator[tuple[str, Setup]]:
    for plant in grid.plants:
        for drive in grid.drives_of(plant):
            for motion in range(len(grid.motions)):
                for condition in conditions:
                    name = f"{plant} {drive} {grid.motions[motion].name} {condition}"
                    yield name, setup(grid, plant, drive, motion, condition, seconds)


def _reductions(of: Setup, *, scored_s: float | None = None, is_fixed_from_start: bool = False) -> dict[str, float]:
    """Return the reduction of the following error with the model file, and after learning for `AFTER_S`."""
    scored_s = SCORED_S if scored_s is None else scored_s
    period_s, end = of.settings.period_s, AFTER_S + scored_s
    short = end if is_fixed_from_start else 2.0 * scored_s + 2.0
    none = without(of, short).error(short - scored_s, short, period_s)
    fixed = follow(of, short, is_learning=False).error(short - scored_s, short, period_s)
    learned = follow(of, end, is_learning=True)
    after = learned.error(AFTER_S, end, period_s)
    assert learned.learner is not None
    figures = learned.learner.figures
    return {
        "file_rms": none.rms / fixed.rms,
        "file_peak": none.peak / fixed.peak,
        "learned_rms": none.rms / after.rms,
        "learned_peak": none.peak / after.peak,
        "kept_ratio_rms": fixed.rms / after.rms,
        "cpu_share": learned.busy_s / end,
        "kept": figures.re_identified,
        "taken_back": figures.taken_back,
    }


def _off(grid: Grid) -> Cases:
    for name, of in _combinations(grid, WRONG, AFTER_S):
        yield name, partial(_reductions, of)


def _late(grid: Grid) -> Cases:
    for name, of in _combinations(grid, WRONG, AFTER_S):
        yield name, partial(_reductions, replace(of, missed_until_s=AFTER_S))


def _noisy(grid: Grid) -> Cases:
    for name, of in _combinations(grid, WRONG, AFTER_S):
        sensors = replace(of.sensors, torque_noise=_NOISE * of.plant.rated_torque)
        yield name, partial(_reductions, replace(of, sensors=sensors))


def _exact(grid: Grid) -> Cases:
    for name, of in _combinations(grid, ("exact",), AFTER_S):
        yield name, partial(_reductions, of, scored_s=LONG_SCORED_S, is_fixed_from_start=True)


def _poor(grid: Grid) -> Cases:
    for name, of in _combinations(grid, ("exact", *WRONG), AFTER_S):
        for factor in (0.9, 1.1):
            noise = 0.01 * of.believed.level
            sensors = Sensors(bits=14, delay_cycles=2, torque_noise=noise, torque_factor=factor)
            settings = replace(
                of.settings, position_resolution=math.tau / 2**14, lead_s=of.lead_s + of.settings.period_s
            )
            changed = replace(of, sensors=sensors, settings=settings, lead_s=settings.lead_s)
            yield (
                f"{name} torque x {factor}",
                partial(_reductions, changed, scored_s=LONG_SCORED_S, is_fixed_from_start=True),
            )


def _residual(grid: Grid) -> Cases:
    for name, of in _combinations(grid, ("exact",), AFTER_S):
        level = of.believed.level
        ripple = [{"order": order, "cosine": 0.0, "sine": share * level} for order, share in _COGGING.items()]
        friction = of.plant.friction.model_copy(update={"modifiers": {**of.believed.modifiers, "ripple": ripple}})
        plant = of.plant.model_copy(update={"friction": friction})
        yield f"{name} cogging", partial(_layered, replace(of, plant=plant, settings=replace(of.settings, gain=0.9)))
    yield from _residual_others(grid)


def _residual_others(grid: Grid) -> Cases:
    """Return cases of friction beside cogging that LuGre does not express."""
    for name, of in _combinations(grid, ("exact",), AFTER_S):
        own, level = of.believed, of.believed.level
        of = replace(of, settings=replace(of.settings, gain=0.9))
        slip = dict(_SLIP, **{key: own.parameters[key] for key in ("coulomb", "static", "stribeck_velocity")})
        slip["viscous"] = own.parameters["sigma2"]
        slip["stiffness"] = [share * own.parameters["sigma0"] for share in _SLIP_STIFFNESS]
        yield f"{name} slip", partial(_layered, _with_friction(of, model="gms", parameters=slip))
        hump = {"velocity": list(_HUMP), "positive": [share * level for share in _HUMP.values()]}
        modifiers = {**own.modifiers, "speed": hump}
        yield f"{name} hump", partial(_layered, _with_friction(of, modifiers=modifiers))
    for name, of in _combinations(grid, ("exact",), AFTER_S):
        weight = _WEIGHT * of.believed.level
        if weight * math.sin(of.motions[0][1].amplitude) < _LEAST_LOAD * of.believed.level:
            continue
        of = _with_friction(of, modifiers={**of.believed.modifiers, "load": _LOAD_FACTORS})
        settings = replace(of.settings, gain=0.9, gravity=(0.0, weight, 0.0))
        yield f"{name} load", partial(_layered, replace(of, settings=settings))


def _with_friction(of: Setup, **changes: Any) -> Setup:
    """Return a setup with another true friction."""
    return replace(of, plant=of.plant.model_copy(update={"friction": of.plant.friction.model_copy(update=changes)}))


def _layered(of: Setup) -> dict[str, float]:
    """Return the reduction of the following error with the model file, and after learning without and with a layer."""
    period_s, end = of.settings.period_s, AFTER_S + SCORED_S
    short = 2.0 * SCORED_S + 2.0
    none = without(of, short).error(short - SCORED_S, short, period_s)
    fixed = follow(of, short, is_learning=False).error(short - SCORED_S, short, period_s)
    found = {"file_rms": none.rms / fixed.rms, "file_peak": none.peak / fixed.peak}
    for name in ("learned", "layer"):
        run = follow(of, end, is_learning=True, has_layer=name == "layer")
        after = run.error(AFTER_S, end, period_s)
        found |= {f"{name}_rms": none.rms / after.rms, f"{name}_peak": none.peak / after.peak}
    assert run.learner is not None
    layer = run.learner.figures.residual_layer
    return {
        **found,
        "layer_ratio_rms": found["layer_rms"] / found["learned_rms"],
        "cpu_share": run.busy_s / end,
        "tried": layer.tried,
        "on": float(layer.state == "on"),
    }


def _wrong(grid: Grid) -> Cases:
    """Return cases of layers that are wrong and at their bound, on axes whose friction the model expresses."""
    for name, of in _combinations(grid, ("exact",), _WRONG_S):
        for seed in range(_WRONG_LAYERS):
            yield f"{name} layer {seed}", partial(_wrongly_layered, of, seed)


def _wrongly_layered(of: Setup, seed: int) -> dict[str, float]:
    """Return the error with the same torque along the demand, which knows nothing of the axis, over that with a layer.

    Of the second half of the time, in which an instability would have grown.
    """
    random, model = np.random.default_rng(seed), of.believed
    distance, top = model.level / model.presliding_stiffness, of.motions[0][1].amplitude * math.tau
    reversal = pairs(REVERSAL, (distance * 2.0 ** np.arange(-3.0, 6.0)).tolist())
    speed = pairs(SPEED, (top * 2.0 ** np.arange(-6.0, 1.0)).tolist())
    features = ((*reversal, *speed), speed, reversal)[seed % 3]
    signs = random.choice([-1.0, 1.0], len(features) if seed % 2 else 1) * np.ones(len(features))
    layered = Layer(features, tuple((model.level * signs).tolist())).limited(SHARE * model.level).on(model)
    on_demand = replace(of.settings, source="demand")

    def add(axis: Axis) -> None:
        axis.beside = [(1.0, Compensator(layered, on_demand)), (-1.0, Compensator(model, on_demand))]

    runs = [
        follow(of, _WRONG_S, is_learning=False, events={0.0: add}),
        follow(replace(of, believed=layered), _WRONG_S, is_learning=False),
    ]
    errors = [run.error(0.5 * _WRONG_S, _WRONG_S, of.settings.period_s) for run in runs]
    return {"error_ratio": errors[0].rms / errors[1].rms, "error_ratio_peak": errors[0].peak / errors[1].peak}


def _family(grid: Grid) -> Cases:
    """Yield axes of one family of friction with model files of another, and of the same one."""
    plant = next(iter(grid.plants))
    drives = grid.drives_of(plant)
    own = grid.plants[plant].friction_model
    for true, believed in _FAMILIES:
        given = {"model": true, "parameters": dict(friction.describe(true).example if true != own.name else own.given)}
        other = grid.plants[plant].model_copy(
            update={"friction": grid.plants[plant].friction.model_copy(update={**given, "modifiers": {}})}
        )
        model = _of_family(other.friction_model, believed)
        for drive in (drives[0], drives[-1]):
            for motion in _FAMILY_MOTIONS:
                of = setup(grid, plant, drive, motion, "gain_0.9", FAMILY_S)
                name = f"{true} {drive} {grid.motions[motion].name}, file {believed}"
                yield name, partial(_with_families, replace(of, plant=other, believed=model))


def _of_family(true: FrictionModel, name: str) -> FrictionModel:
    """Return a model of a family with the levels and the stiffness of the true one."""
    if name == true.name:
        return true
    given = {key: true.parameters[key] for key in ("coulomb", "static", "stribeck_velocity")}
    viscous = true.parameters.get("sigma2", true.parameters.get("viscous"))
    if name == "lugre":
        return friction.create(name, **given, sigma0=true.presliding_stiffness, sigma2=viscous)
    known = {each.name for each in friction.describe(name).parameters}
    return friction.create(name, **{key: value for key, value in given.items() if key in known}, viscous=viscous)


def _with_families(of: Setup) -> dict[str, float]:
    """Return the reduction of the following error with the file, and after learning with its family and with others."""
    period_s, end = of.settings.period_s, FAMILY_S + SCORED_S
    short = 2.0 * SCORED_S + 2.0
    none = without(of, short).error(short - SCORED_S, short, period_s)
    fixed = follow(of, short, is_learning=False).error(short - SCORED_S, short, period_s)
    found = {"file_rms": none.rms / fixed.rms, "file_peak": none.peak / fixed.peak}
    for name in ("learned", "family"):
        run = follow(of, end, is_learning=True, has_families=name == "family")
        after = run.error(FAMILY_S, end, period_s)
        found |= {f"{name}_rms": none.rms / after.rms, f"{name}_peak": none.peak / after.peak}
    assert run.learner is not None
    family = run.learner.figures.family
    return {
        **found,
        "family_ratio_rms": found["family_rms"] / found["learned_rms"],
        "cpu_share": run.busy_s / end,
        "tried": family.tried,
        "changed": float(family.in_use != family.of_file),
    }


def _drift(grid: Grid) -> Cases:
    for plant in grid.plants:
        for drive in grid.drives_of(plant):
            for condition in ("exact",):
                of = setup(grid, plant, drive, 2, condition, _DRIFT_S)
                of = replace(of, settings=replace(of.settings, gain=0.9))
                yield f"{plant} {drive}", partial(_drifting, of)


def _drifting(of: Setup) -> dict[str, float]:
    """Return the reductions while the friction level changes by heat and load, over those of a model tuned by hand."""
    period_s = of.settings.period_s

    def factor(at: float) -> float:
        return (1.0 + _DRIFT * math.sin(math.tau * at / _DRIFT_S)) * (_LOAD if at >= _LOAD_S else 1.0)

    def plant_at(at: float) -> Plant:
        return _with_level(of.plant, factor(at))

    ticks = np.arange(0.0, _DRIFT_S, 1.0)
    events: dict[float, Event] = {at: partial(_change_plant, plant=plant_at(at)) for at in ticks}

    def retuned(at: float) -> Any:
        return plant_at(at).friction_model if at % 1.0 == 0.0 else None

    none = without(of, _DRIFT_S, events)
    fixed = follow(of, _DRIFT_S, is_learning=False, events=events)
    by_hand = follow(of, _DRIFT_S, is_learning=False, events=events, retuned=retuned)
    learned = follow(of, _DRIFT_S, is_learning=True, events=events)
    shares: dict[str, list[float]] = {"file_ratio": [], "learned_ratio": []}
    for begin in np.arange(AFTER_S, _DRIFT_S, _DRIFT_SCORED_S):
        part = (begin, begin + _DRIFT_SCORED_S, period_s)
        best = none.error(*part).rms / by_hand.error(*part).rms
        for name, run in (("file_ratio", fixed), ("learned_ratio", learned)):
            shares[name].append(min(none.error(*part).rms / run.error(*part).rms / best, 1.0))
    return {
        "file_mean_ratio": geometric_mean(shares["file_ratio"]),
        "learned_mean_ratio": geometric_mean(shares["learned_ratio"]),
        "learned_least_ratio": min(shares["learned_ratio"]),
        "cpu_share": learned.busy_s / _DRIFT_S,
    }


def _changing(grid: Grid) -> Cases:
    seconds = sum(each for each, _ in _CHANGING)
    for plant in grid.plants:
        for drive in grid.drives_of(plant):
            for condition in (*WRONG, "exact"):
                of = replace(setup(grid, plant, drive, 0, condition, seconds), motions=_CHANGING)
                yield f"{plant} {drive} {condition}", partial(_minutes, of, seconds)


def _minutes(of: Setup, seconds: float) -> dict[str, float]:
    """Return the least ratio of the errors with the fixed model and with learning, of all minutes."""
    period_s = of.settings.period_s
    fixed, learned = (follow(of, seconds, is_learning=each) for each in (False, True))
    ratios, at = [], 0.0
    for length, _ in of.motions:
        both = [run.error(at + 1.0, at + length, period_s) for run in (fixed, learned)]
        ratios.append((both[0].rms / both[1].rms, both[0].peak / both[1].peak))
        at += length
    return {
        "least_minute_rms": min(rms for rms, _ in ratios),
        "least_minute_peak": min(peak for _, peak in ratios),
        "mean_minute_rms": geometric_mean([rms for rms, _ in ratios]),
    }


def _catastrophes(grid: Grid) -> Cases:
    plant = next(iter(grid.plants))
    own = grid.plants[plant]
    drives = grid.drives_of(plant)
    soft, stiff = grid.drives[drives[0]], grid.drives[drives[-1]]

    def slip(axis: Axis) -> None:
        axis.sensors.slip += 0.01

    def freeze(axis: Axis) -> None:
        axis.sensors.is_frozen = True

    removed = own.model_copy(update={"inertia": 0.5 * own.inertia})
    happening: dict[str, tuple[DriveLoops, Event]] = {
        "encoder slips": (stiff, slip),
        "load removed": (stiff, partial(_change_plant, plant=_with_level(removed, 0.5))),
        "drive retuned softly": (stiff, partial(_change_plant, plant=own, drive=soft)),
        "drive retuned stiffly": (soft, partial(_change_plant, plant=own, drive=stiff)),
        "torque frozen": (stiff, freeze),
    }
    for name, (drive, event) in happening.items():
        of = setup(grid, plant, drives[-1], 2, WRONG[0], 2.0 * AFTER_S)
        yield name, partial(_catastrophe, replace(of, drive=drive), event)


def _catastrophe(of: Setup, event: Event) -> dict[str, float]:
    events = {_HAPPENS_S: event}
    end, period_s = _HAPPENS_S + 30.0, of.settings.period_s
    learned = follow(of, end, is_learning=True, events=events)
    fixed = follow(of, end, is_learning=False, events=events)
    stops = [at for at, note in learned.notes if at > _HAPPENS_S and note.startswith("learning stops")]
    after = (_HAPPENS_S, end, period_s)
    most = float(np.max(np.abs(learned.compensation))) / float(np.max(np.abs(fixed.compensation)))
    return {
        "stops_after_s": stops[0] - _HAPPENS_S if stops else math.inf,
        "peak_ratio": fixed.error(*after).peak / learned.error(*after).peak,
        "torque_factor_s": most,
    }


def _with_level(plant: Plant, factor: float) -> Plant:
    """Return a plant whose levels and viscous friction are multiplied."""
    own = plant.friction_model
    scaled = {name: factor * value_of(own, name) for name in own.free if name.rpartition(".")[2] in _LEVELS}
    model = with_values(own, scaled)
    friction = plant.friction.model_copy(update={"parameters": dict(model.given), "modifiers": dict(model.modifiers)})
    return plant.model_copy(update={"friction": friction})


def _change_plant(axis: Axis, plant: Plant, drive: DriveLoops | None = None) -> None:
    axis.change_plant(plant, drive)


_ROWS: dict[str, Callable[[Grid], Cases]] = {
    "off": _off,
    "late": _late,
    "noisy": _noisy,
    "exact": _exact,
    "drift": _drift,
    "changing": _changing,
    "poor": _poor,
    "residual": _residual,
    "wrong_layers": _wrong,
    "family": _family,
    "catastrophes": _catastrophes,
}
__all__ = ["AFTER_S", "Figure", "Followed", "cases_of", "names", "summary"]
