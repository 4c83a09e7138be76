"""What recordings show of the mechanics behind the motor: masses, coupling, backlash, friction of either side. Pure.

Three methods that know nothing of each other: the frequency response of the parts in which the axis slides
(`frequency_response`, `resonance`), the torque over the whole recordings with reversals (`torque_fits`), and the motion
of the load where it was recorded (`load_side`). The smallest standard error counts. What none of them determines is
named together with the motion that would show it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from friction_hil.errors import FrictionHilError, internal_error
from friction_hil.identification import thresholds as th
from friction_hil.identification.data import RegressionSegment, prepare
from friction_hil.identification.encoder_error import EncoderError, find_encoder_error
from friction_hil.identification.frequency_response import FrequencyResponse, frequency_response
from friction_hil.identification.identify import Identification
from friction_hil.identification.load_dependence import find_load_dependence
from friction_hil.identification.load_side import LoadSide, find_load_side
from friction_hil.identification.quantities import Quantity, Units, undetermined
from friction_hil.identification.refine import is_dynamic
from friction_hil.identification.resonance import Resonance, fit_resonance
from friction_hil.identification.sliding import LOW_HZ, sliding_mechanics
from friction_hil.identification.torque_fits import TorqueFits, model_of, swings, torque_fits
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording

_UNEXCITED = "the recording excites no band of frequencies while the axis slides"
_SHAKEN = (
    "friction-hil tune --mechanics records such a motion, or trajectory {kind: multisine}, with higher high_hz and a "
    "shorter period_s for stiffer axes"
)
_LOADED = (
    "let friction-hil tune --mechanics find the inertia of the load, whose acceleration is a load, or record the same "
    "motion with another weight or against a force, with its torque in the column load_torque"
)
_REVERSALS = "reversals at several speeds, faster ones with oscillations above 8 Hz: trajectory {kind: experiment}"
_STROKES = "record strokes with rests, trajectory {kind: strokes}, on a load that nothing pulls to one side"


@dataclass(frozen=True, slots=True, eq=False)
class Mechanics:
    """Mechanics that were found."""

    quantities: tuple[Quantity, ...]  # all of them, determined or not
    # ``inertia``, ``stiffness`` and ``damping`` of the load, as in a model file; None: no coupling was found
    load: dict[str, float] | None = None
    inertia: float | None = None  # of motor and load, that belongs to ``load``
    backlash: float = 0.0  # whole width of the gap, rad or m; 0: none was found
    flags: tuple[str, ...] = ()  # what speaks against the friction model that was identified
    notes: tuple[str, ...] = ()  # what the methods take for granted
    response: FrequencyResponse | None = None
    resonance: Resonance | None = None  # of the frequency response

    @property
    def missing(self) -> list[str]:
        """One line for each reason why quantities are not determined."""
        reasons: dict[str, list[str]] = {}
        for each in self.quantities:
            if each.value is None and each.missing:
                reasons.setdefault(each.missing, []).append(each.label)
        return [f"{', '.join(labels)}: not determined: {why}" for why, labels in reasons.items()]

    @property
    def lines(self) -> list[str]:
        """What was found, a line for each quantity, and then `missing`, for a log."""
        known = [each for each in self.quantities if each.value is not None and each.error is not None]
        found = [f"{each.label}: {each.value:.4g} {each.unit} (standard error {each.error:.2g})" for each in known]
        return [*(each.replace("  ", " ") for each in found), *self.missing]


def find_mechanics(
    # that ``result`` was fitted to; a column ``load_position`` is used where it exists
    recordings: Sequence[Recording],
    result: Identification,
    *,
    # of an axis that is shaken while it slides: the frequency response is then theirs alone
    shaken: Sequence[Recording] = (),
    # other axes of the run in which the axis was shaken, by name: loops that hold them give way
    held: Mapping[str, Recording] | None = None,
    # why the torque is not that of this axis alone (`friction_hil.identification.moving_beside`): nothing is then
    # determined; empty if it is
    disturbed: str = "",
    report: Callable[[str], None] = lambda _: None,  # called with the name of each step
) -> Mechanics:
    """Find the mechanics behind the motor."""
    units = Units.of(result)
    try:
        return _found(recordings, result, shaken, held or {}, disturbed, report)
    except FrictionHilError:
        raise
    except Exception as error:  # noqa: BLE001  it costs the mechanics, not the friction that is known already
        why = f"{internal_error(error)} ended the search for it"
        return Mechanics(tuple(replace(each, missing=why) for each in undetermined(units)))


def _found(
    recordings: Sequence[Recording],
    result: Identification,
    shaken: Sequence[Recording],
    held: Mapping[str, Recording],
    disturbed: str,
    report: Callable[[str], None],
) -> Mechanics:
    """Return what `find_mechanics` finds."""
    units = Units.of(result)
    if disturbed or result.settings.has_unknown_gain:
        why = disturbed or "it needs a torque of known gain"
        return Mechanics(tuple(replace(each, missing=why) for each in undetermined(units)))
    records = [each for each in result.records if not each.is_thinned] or list(result.records)
    report("frequency response")
    excited = [segment for each in shaken for segment in prepare(each)] or records
    beside = [_beside(each, held) for each in excited] if shaken else None
    response = frequency_response(excited, beside=beside) if _one_rate(excited) else None
    resonance, why = (None, _UNEXCITED) if response is None else fit_resonance(response)
    report("two masses")
    torques = torque_fits(records, result)
    report("load side")
    side = find_load_side(recordings, records)
    errors: tuple[EncoderError, ...] = ()
    if torques is not None:
        report("encoder")
        accepted = torques.two or torques.rigid
        inertia = accepted.values["motor_inertia"]
        errors = find_encoder_error(
            torques.motions, accepted.residual, inertia, is_linear=result.settings.axis == "linear"
        )
    return _assembled(result, units, records, response, resonance, why, torques, side, errors)


def _beside(record: RegressionSegment, held: Mapping[str, Recording]) -> Array:
    """Return the positions of other axes (n, k) at the rows of a segment; an axis that was not read is left out."""
    found = [np.empty((len(record.time_s), 0))]
    for each in held.values():
        known = np.isfinite(each["position"])
        if np.any(known):
            found.append(np.interp(record.time_s, each["time_s"][known], each["position"][known])[:, None])
    return np.hstack(found)


def _one_rate(records: Sequence[RegressionSegment]) -> bool:
    rates = [each.rate_hz for each in records]
    return max(rates) - min(rates) < 1e-3 * max(rates)


# ------------------------------------------------------------------------------------------------------- what is shown


def _assembled(
    result: Identification,
    units: Units,
    records: Sequence[RegressionSegment],
    response: FrequencyResponse | None,
    resonance: Resonance | None,
    why: str,
    torques: TorqueFits | None,
    side: LoadSide | None,
    encoder_errors: tuple[EncoderError, ...],
) -> Mechanics:
    known = {each.key: each for each in undetermined(units)}
    methods = _methods(resonance, torques, side)
    for key in known:
        there = [(values[key], errors[key], name) for values, errors, name in methods if key in values]
        there = [each for each in there if math.isfinite(each[1])]
        if there:
            value, error, name = min(there, key=lambda each: each[1])
            known[key] = replace(known[key], value=value, error=error, source=name)
    missing = _missing(why, torques, _held_against(result, units, records))
    known |= {key: replace(known[key], missing=why) for key, why in missing.items() if known[key].value is None}
    if known["inertia"].value is None:
        known["inertia"] = _rigid_inertia(known["inertia"], result, records)
    known["cogging"] = _cogging(known["cogging"], result)
    known["load_dependence"] = _per_load(known, result, records)
    if encoder_errors:
        first = encoder_errors[0]
        label = f"encoder error, order {first.order:g} (amplitude)"
        own = replace(known["encoder_error"], label=label, value=first.amplitude, error=first.error)
        known["encoder_error"] = replace(own, source="torque over time", missing="")
    load = {
        name: known[key].value
        for name, key in (("inertia", "load_inertia"), ("stiffness", "stiffness"), ("damping", "damping"))
    }
    has_load = all(value is not None for value in load.values())
    backlash = known["backlash"].value or 0.0
    return Mechanics(
        tuple(known.values()),
        {name: float(value or 0.0) for name, value in load.items()} if has_load else None,
        known["inertia"].value if has_load else None,
        backlash,
        _flags(result, units, known, torques),
        _notes(response, methods, known),
        response,
        resonance,
    )


_Method = tuple[Mapping[str, float], Mapping[str, float], str]


def _methods(resonance: Resonance | None, torques: TorqueFits | None, side: LoadSide | None) -> list[_Method]:
    """Return values, standard errors and name of each method that found something."""
    found: list[_Method] = []
    if resonance is not None:
        found.append((resonance.values, resonance.errors, "frequency response"))
    if torques is not None and torques.two is not None:
        values, errors = dict(torques.two.values), dict(torques.two.errors)
        for name, level in (("motor_friction", "motor_level"), ("load_friction", "load_level")):
            values[name], errors[name] = values[level], errors[level]
        if not torques.has_gap:
            del values["backlash"]
        _add_frequencies(values, errors)
        errors = {
            name: math.hypot(error, th.MECHANICS_FORM * abs(values[name]))
            for name, error in errors.items()
            if name in values
        }
        found.append((values, errors, "torque over time"))
    if side is not None:
        values, errors = dict(side.values), dict(side.errors)
        if {"stiffness", "motor_inertia", "load_inertia"} <= set(values):
            _add_frequencies(values, errors)
            values["inertia"] = values["motor_inertia"] + values["load_inertia"]
            errors["inertia"] = math.hypot(errors["motor_inertia"], errors["load_inertia"])
        found.append((values, errors, "load position"))
    return found


def _add_frequencies(values: dict[str, float], errors: dict[str, float]) -> None:
    """Add anti-resonance and resonance with errors as of independent inertias and stiffness."""
    k, motor, load = (values[name] for name in ("stiffness", "motor_inertia", "load_inertia"))
    dk, dm, dl = (errors[name] for name in ("stiffness", "motor_inertia", "load_inertia"))
    low, high = math.sqrt(k / load), math.sqrt(k / load + k / motor)
    values["antiresonance_hz"], values["resonance_hz"] = low / math.tau, high / math.tau
    errors["antiresonance_hz"] = 0.5 * low / math.tau * math.hypot(dk / k, dl / load)
    slopes = (dk * high**2 / k, dl * k / load**2, dm * k / motor**2)
    errors["resonance_hz"] = 0.5 / high / math.tau * math.hypot(*slopes)


def _rigid_inertia(quantity: Quantity, result: Identification, records: Sequence[RegressionSegment]) -> Quantity:
    best = result.best
    error = best.inference.standard_errors.get("inertia", math.nan)
    value = best.mechanics["inertia"]
    if not math.isfinite(error) and "inertia" not in result.settings.held:  # held at that of slow motion
        swings = any(best.mechanics[each] for each in ("gravity.sine", "gravity.cosine"))
        slow = sliding_mechanics(records, can_swing=swings)
        if slow is not None and 0.0 < slow.inertia_error < th.VAGUE * slow.inertia:
            source = f"motion below {LOW_HZ:g} Hz"
            return replace(quantity, value=slow.inertia, error=slow.inertia_error, source=source)
    if not math.isfinite(error) or not error < th.VAGUE * abs(value):
        return replace(quantity, missing="record motions with larger accelerations")
    return replace(quantity, value=value, error=error, source="friction model")


def _per_load(known: Mapping[str, Quantity], result: Identification, records: Sequence[RegressionSegment]) -> Quantity:
    """Return friction per load: of the chosen model if a load was recorded, else by weight and inertia of the load."""
    best, quantity = result.best, known["load_dependence"]
    factors = {name: value for name, value in best.values.items() if name.startswith("load.")}
    if factors and any(each.load_torque is not None for each in records):
        name, value = max(factors.items(), key=lambda each: abs(each[1]))
        error = best.inference.standard_errors.get(name, math.nan)
        return replace(quantity, label=f"friction per load ({name})", value=value, error=error, source="friction model")
    load_inertia, load_friction = known["load_inertia"].value, known["load_friction"].value
    turn = 1.0 if result.settings.axis == "linear" else math.tau
    orders = [each["order"] * math.tau / turn for each in best.friction[1].get("ripple", [])]
    found = find_load_dependence(records, best.mechanics, load_inertia, orders, load_friction=load_friction)
    if found is not None and found.is_clear:
        return replace(quantity, value=found.factor, error=found.error, source="weight and inertia of the load")
    if found is not None and found.is_excluded:
        figures = f"{found.factor:.2g}, standard error {found.error:.1g}"
        return replace(quantity, missing=f"the load changes, and friction hardly grows with it ({figures})")
    if found is None:
        return replace(quantity, missing=f"the axis slides in too few rows, or nothing loads it; {_LOADED}")
    if not found.is_shown:
        why = "with friction of the load that would hold it against one side, it looks like inertia and weight"
        return replace(quantity, missing=f"{why}; {_LOADED}")
    why = "the load hardly changes, or its inertia and friction are not known well enough"
    return replace(quantity, missing=f"{why}; {_LOADED}")


def _cogging(cogging: Quantity, result: Identification) -> Quantity:
    """Return cogging, from the ripple of the chosen model."""
    best, errors = result.best, result.best.inference.standard_errors
    harmonics = best.friction[1].get("ripple", [])
    if harmonics:
        sizes = [math.hypot(each["cosine"], each["sine"]) for each in harmonics]
        index = int(np.argmax(sizes))
        own = [errors.get(f"ripple[{index}].{part}", math.nan) for part in ("cosine", "sine")]
        label = f"cogging, order {harmonics[index]['order']:g} (amplitude)"
        cogging = replace(cogging, label=label, value=sizes[index], error=max(own), source="friction model")
    else:
        cogging = replace(
            cogging, missing="none stands out: slow motion over at least two periods of it would show a smaller one"
        )
    return cogging


def _held_against(result: Identification, units: Units, records: Sequence[RegressionSegment]) -> str:
    """Return what a constant pull does to a gap, and the motion that would open it; empty if there is hardly any."""
    mechanics = result.best.mechanics
    swing = math.hypot(mechanics.get("gravity.sine", 0.0), mechanics.get("gravity.cosine", 0.0))
    pull = abs(mechanics.get("offset", 0.0) + mechanics.get("gravity.constant", 0.0)) - swing
    if pull < th.PULL * math.sqrt(float(np.mean(np.concatenate([each.torque for each in records]) ** 2))):
        return ""
    return (
        f"a constant pull of {pull:.3g} {units.torque}, such as a weight, holds the load against one side of a gap; "
        "only accelerations above this pull over the inertia of the load open it"
    )


def _missing(why: str, torques: TorqueFits | None, held: str) -> dict[str, str]:
    """Return why quantities are not determined, each with the motion that would show it.

    ``why`` is the reason of the frequency response, empty if it shows a resonance; ``held`` that of a gap that does not
    open.
    """
    if torques is None:
        other = "is too short, or the encoder is too coarse for its accelerations"
    else:
        other = "is explained by one mass as well as by two"
    stiff = f"{why or _UNEXCITED}; the recording {other}; {_SHAKEN}"
    keys = ("motor_inertia", "load_inertia", "antiresonance_hz", "resonance_hz", "stiffness", "damping")
    found = dict.fromkeys(keys, stiff)
    if torques is None or torques.two is None:
        found["backlash"] = f"the torque of the reversals shows no coupling in which it could be; {_STROKES}"
        found["motor_friction"] = found["load_friction"] = (
            f"only their sum is known, because the torque of the reversals shows no coupling between them; {_REVERSALS}"
        )
    else:
        found["backlash"] = f"none stands out from the coupling's own twist; a smaller one: {_STROKES}"
    if held:
        found["backlash"] = f"{held}; take it off, or {_STROKES}"
    found["encoder_error"] = (
        f"none stands out among the {th.MOST_ORDERS} orders from the lowest on that a stroke covers: it shows at high "
        "constant speed and half of it, over several periods of the error"
    )
    return found


def _flags(
    result: Identification, units: Units, known: dict[str, Quantity], torques: TorqueFits | None
) -> tuple[str, ...]:
    """Return what speaks against the friction model: a bristle that is the spring of the coupling."""
    if not is_dynamic(result.best.structure):
        return ()
    bristle = model_of(result.best, result).presliding_stiffness
    stiffness = known["stiffness"].value
    said = f"the stiffness of presliding, {bristle:.3g} {units.stiffness}, "
    if not bristle > 0.0:
        return ()
    if stiffness is not None and 1.0 / th.LIKE < bristle / stiffness < th.LIKE:
        return (
            f"{said}may be the coupling's: the load swings on {stiffness:.3g} {units.stiffness} at "
            f"{known['antiresonance_hz'].value:.3g} Hz; mechanics.load has the coupling, and the friction model is "
            "right for slow motion of the motor only",
        )
    tried = None if torques is None else torques.tried
    if tried is None or torques is None or torques.two is not None:
        return ()
    alike = 1.0 / th.LIKE < bristle / tried.values["stiffness"] < th.LIKE
    if alike and swings(tried, torques.rigid):
        return (
            f"{said}may be the bristles' or a coupling's: a load behind a spring explains the torque as well; "
            f"{_SHAKEN}",
        )
    return ()


def _notes(
    response: FrequencyResponse | None, methods: Sequence[_Method], known: dict[str, Quantity]
) -> tuple[str, ...]:
    found = []
    if response is not None and not response.has_instrument:
        found.append(
            "the recording has no position_demand: the frequency response is right only if the torque did not come "
            "from the measured position, as it does in a control loop"
        )
    if response is not None and len(response.beside):
        found.append(
            "another axis, which its drive holds, moves with this one; its motion is fitted too, so that a coupling at "
            "the frequency of its loops is hardly seen"
        )
    values = [
        (each[0]["antiresonance_hz"], each[1]["antiresonance_hz"], each[2])
        for each in methods
        if "antiresonance_hz" in each[0]
    ]
    if len(values) > 1:
        (one, da, name), (other, db, second) = values[:2]
        if abs(one - other) > max(5.0 * math.hypot(da, db), 0.1 * one):
            found.append(f"the anti-resonance is {one:.4g} Hz by {name} and {other:.4g} Hz by {second}: doubt both")
    return tuple(found)
