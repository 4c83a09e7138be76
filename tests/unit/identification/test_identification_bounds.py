"""Scales and bounds from which searches begin: whatever the axis, its encoder and its period, they are usable.

And errors of the program in the fit of one family: they cost that family.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.errors import FrictionHilError, RecordingError
from friction_hil.identification import IdentificationSettings, identify, structures
from friction_hil.identification.candidates import CandidateFitter
from friction_hil.identification.least_squares import FitError
from friction_hil.identification.regression import Regression
from friction_hil.identification.structures import Coordinate, InitialScales
from friction_hil.learning.coordinates import value_of
from friction_hil.learning.estimate import Mechanics, first_belief
from friction_hil.recordings import Recording
from tests.compensators import quantised
from tests.unit.identification.test_identification import recorded

ROWS = 4000
DECADES = st.floats(-3.0, 3.0)


@st.composite
def recordings(draw: st.DrawFn) -> tuple[Recording, str]:
    """Slow and fast strokes with rests of an axis of any size, as its encoder and its drive show them."""
    axis = draw(st.sampled_from(["rotary", "linear"]))
    period_s = 10.0 ** draw(st.floats(math.log10(2.5e-4), -2.0))
    turn = math.tau if axis == "rotary" else draw(st.sampled_from([1e-3, 0.01, 0.1]))  # per revolution of the encoder
    count = turn / 2.0 ** draw(st.integers(12, 24))
    stroke = turn * 10.0 ** draw(st.floats(-1.5, 1.0))
    level, inertia = 0.1 * 10.0 ** draw(DECADES), 1e-3 * 10.0 ** draw(DECADES)
    strokes = draw(st.integers(2, 12))
    time = np.arange(ROWS) * period_s
    phase = strokes * np.linspace(0.0, 1.0, ROWS) ** draw(st.sampled_from([0.5, 1.0, 3.0]))
    swing = np.sin(math.tau * phase) * (0.02 + np.abs(np.sin(math.pi * phase / strokes)))
    if draw(st.booleans()):  # rests, in which a coarse encoder shows no motion
        swing = np.clip(swing, -0.6, 0.6)
    position = stroke * swing
    velocity = np.gradient(position, period_s)
    stiffness = level / (stroke * 10.0 ** draw(st.floats(-5.0, -1.0)))
    top = float(np.max(np.abs(velocity)))
    model = fh.models.create("lugre", sigma0=stiffness, coulomb=level, static=1.5 * level, stribeck_velocity=0.05 * top)
    torque = model.simulate(velocity, period_s) + inertia * np.gradient(velocity, period_s)
    torque += draw(st.sampled_from([0.0, 0.02])) * level * np.random.default_rng(0).standard_normal(ROWS)
    columns = {"time_s": time, "position": quantised(position, count), "torque": torque}
    if draw(st.booleans()):  # the drive's velocity is the difference of counts
        columns["velocity"] = np.diff(columns["position"], prepend=columns["position"][0]) / period_s
    return Recording("made.csv", "x", columns), axis


@settings(max_examples=25, deadline=None, phases=(Phase.reuse, Phase.generate))  # minutes to shrink, and it says little
@given(recordings(), st.booleans())
def test_every_search_has_finite_ordered_bounds_and_begins_within_them(made, is_slow_left_out) -> None:
    recording, axis = made
    position = recording["position"]
    if len(np.unique(position)) < 20:
        return  # the encoder shows no motion
    span = float(np.ptp(position)) / (recording["time_s"][-1] - recording["time_s"][0])
    least_speed = 0.01 * span if is_slow_left_out else 0.0
    try:
        wanted = IdentificationSettings(axis=axis, least_speed=least_speed)
        fitter = CandidateFitter([recording], (), wanted, lambda _: None)
    except RecordingError:  # told in words: nothing to identify from
        return
    scales = fitter.scales
    assert scales.least_sliding_speed <= scales.speed
    assert np.all(np.diff(scales.speeds) > 0.0)
    for family in structures.families():
        for is_directed in (False, True):
            structure = fitter.build(family, is_directed=is_directed)
            regression = Regression(fitter.data, structure, ["inertia", "offset"])
            assert np.all(np.isfinite([regression.lower, regression.upper]))
            assert np.all(regression.lower < regression.upper)
            for values in structures.starts(structure, scales, seed=0, further=3):
                at = np.array([each.inner(values[each.name]) for each in structure.coordinates])
                assert np.all((regression.lower <= at) & (at <= regression.upper))
                structure.model(structure.values(at))  # raises if the family refuses them
    lugre = fitter.build("lugre", is_directed=False)
    [first, *_] = structures.starts(lugre, scales, 0, 0)
    model = lugre.model({**first, "sigma2": 0.0})
    belief = first_belief(model, Mechanics(1.0), {name: value_of(model, name) for name in model.free})
    assert 0.0 < belief.model.level < math.inf
    assert np.all((belief.first > 0.0) & np.isfinite(belief.first))


def test_an_axis_at_rest_while_it_should_slide_still_has_a_narrowest_hump() -> None:
    """Half of the rows show no speed, as a coarse encoder does: that is not the slowest sliding."""
    time = np.arange(8000) * 2e-3
    position = np.round(0.5 * np.sin(0.8 * time) / 4e-3) * 4e-3
    velocity = np.diff(position, prepend=0.0) / 2e-3
    columns = {"time_s": time, "position": position, "velocity": velocity, "torque": np.sign(np.cos(0.8 * time))}
    fitter = CandidateFitter([Recording("made.csv", "x", columns)], (), IdentificationSettings(), lambda _: None)
    assert fitter.scales.least_sliding_speed > 0.0
    assert np.isfinite(Regression(fitter.data, fitter.build("stribeck", is_directed=False), ["inertia"]).lower).all()


@given(st.floats(), st.floats(), st.booleans())
def test_bounds_that_no_search_can_use_are_refused_where_they_arise(lower, upper, is_log) -> None:
    if -math.inf < lower <= upper < math.inf and not (is_log and lower <= 0.0):
        low, high = Coordinate(("sigma0",), lower, upper, is_log).bounds
        assert -math.inf < low <= high < math.inf
    else:
        with pytest.raises(FitError, match="the bounds of sigma0 are "):
            Coordinate(("sigma0",), lower, upper, is_log)


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("name", ["level", "least_sliding_speed", "deflections", "speeds"])
def test_a_scale_that_is_not_positive_is_named(name, wrong) -> None:
    scales: dict[str, Any] = {
        **dict.fromkeys(("level", "static_level", "speed", "travel", "least_sliding_speed", "largest"), 1.0),
        **dict.fromkeys(("deflections", "stribeck_velocities", "speeds"), (0.5, 1.0)),
    }
    scales[name] = (0.5, wrong) if isinstance(scales[name], tuple) else wrong
    with pytest.raises(RecordingError, match=f"{name.replace('_', ' ')} is"):
        InitialScales(**scales)


@pytest.mark.parametrize("where", ["build", "starts"])
def test_an_error_of_the_program_costs_one_family_and_is_named(where, monkeypatch):
    right = getattr(structures, where)

    def broken(given: Any, *rest: Any, **options: Any) -> Any:
        if getattr(given, "family", given) == "stribeck":
            raise ValueError("math domain error")
        return right(given, *rest, **options)

    monkeypatch.setattr(structures, where, broken)
    wanted = IdentificationSettings(families=("coulomb", "stribeck"), gravity="none", has_modifiers=False)
    result = identify([recorded("coulomb")], wanted)
    assert {each.structure.family for each in result.fits} == {"coulomb"}
    [failure] = result.failures
    assert failure.startswith("stribeck")
    assert "ValueError: math domain error" in failure
    assert failure in result.notes
    only = replace(wanted, families=("stribeck",))
    with pytest.raises(FrictionHilError, match=r"no candidate.*stribeck"):
        identify([recorded("coulomb")], only)
