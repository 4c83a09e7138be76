"""Other families of an axis's model: conversion, evidence, trial, and what is kept for the next run."""

import json
from copy import deepcopy
from dataclasses import asdict

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.daemon import learning_words
from friction_hil.daemon.learning_board import LayerFigures, first_report
from friction_hil.learning.conversion import ALTERNATIVES, Form, alternatives, converted, form_of
from friction_hil.learning.proposal import Step, described
from friction_hil.learning.proven import Proven, recall, store
from tests.compensators import LUGRE, MODELS
from tests.learning_records import Driven

MAP = fh.models.create("stribeck", coulomb=0.08, static=0.12, stribeck_velocity=0.2, viscous=2e-3)
SIDES = {"positive": {"coulomb": 0.09, "static": 0.14}}
FAST = np.array([-20.0, -2.0, 1.0, 5.0])
WINDOW = 24  # ticks


ADDED = {"viscous": {"cubic": 1e-5}, "ripple": [{"order": 4.0, "cosine": 0.01}]}


@pytest.mark.parametrize(
    ("of", "name", "modifiers"),
    [
        *((of, name, added) for of, names in ALTERNATIVES.items() for name in names for added in ({}, ADDED)),
        ("lugre", "gms", {"direction": SIDES}),
    ],
)
def test_another_family_has_the_same_levels_and_the_same_presliding_stiffness(of, name, modifiers):
    model = fh.models.create(of, modifiers=modifiers, **MODELS[of].given)
    other = converted(model, Form(name, "direction" in modifiers), speed=1.0, deflection=1e-4)
    assert other.name == name
    expected = model.presliding_stiffness or model.level / 1e-4
    assert other.presliding_stiffness == pytest.approx(expected, rel=1e-4)
    np.testing.assert_allclose(other.steady_state(FAST), model.steady_state(FAST), rtol=1e-9)
    assert other.modifiers == model.modifiers


@pytest.mark.parametrize("of", sorted(ALTERNATIVES.keys() - {"bouc_wen"}))  # which has no level of its own
def test_a_form_with_directions_begins_as_the_model_in_both(of):
    model = MODELS[of]
    form = alternatives(model)[0]
    other = converted(model, form, speed=1.0, deflection=1e-4)
    assert form_of(other) == form
    assert str(form).endswith(" + direction")
    np.testing.assert_allclose(other.steady_state(FAST), model.steady_state(FAST), rtol=1e-9)
    assert {"direction.positive.coulomb", "direction.negative.coulomb"} <= set(other.free)


def test_elements_slip_like_a_bristle():
    """Closed form of LuGre's torque over a slow deflection x: static (1 - exp(-stiffness x / static))."""
    model = converted(LUGRE, Form("gms"), speed=1.0, deflection=1e-4)
    scale = 0.12 / 2000.0
    x = np.linspace(0.01, 6.0, 200) * scale
    speed = 1e-9
    torque = model.simulate(np.full(x.size, speed), np.diff(x, prepend=0.0) / speed)
    np.testing.assert_allclose(torque, 0.12 * (1.0 - np.exp(-x / scale)), atol=0.08 * 0.12)


@pytest.fixture(scope="module")
def handed_over():
    """A learner that has just handed over another family; the axis has presliding, its model file a map without."""
    driven = Driven(MAP, gain=1.0)
    driven.take(17 * WINDOW, until=Step.FAMILY, error=1e-4, amplitude=0.02)
    return driven


@pytest.fixture
def asked(handed_over):
    return deepcopy(handed_over)


@pytest.mark.deep
def test_a_family_is_tried_after_eight_windows_that_it_explained_better(asked):
    when, proposal = asked.proposals[-1]
    assert proposal.step is Step.FAMILY
    assert when >= 10 * WINDOW  # two to learn, eight of evidence
    assert (proposal.model.name, asked.learner.figures.family.in_use) == ("lugre", "lugre")
    assert proposal.gain == asked.learner.figures.gain
    assert proposal.text.startswith("the family lugre in place of stribeck: explains ")
    assert asked.learner.belief.coordinates.model.name == "lugre"  # its errors are recorded with the model
    text = described(proposal, {"viscous": 1.0}, asked.learner.in_use, "x", is_tried=True)
    assert text == f"learning tries {proposal.text}"


@pytest.mark.parametrize("model", [MAP, LUGRE], ids=["map", "lugre"])
def test_directions_that_differ_are_tried_after_a_few_windows(model):
    levels = {"positive": {"coulomb": 0.14, "static": 0.19}, "negative": {"coulomb": 0.04, "static": 0.055}}
    true = fh.models.create("lugre", **LUGRE.given, modifiers={"direction": levels})
    driven = Driven(model, gain=1.0).take(9 * WINDOW, until=Step.FAMILY, error=1e-4, true=true)
    _, proposal = driven.proposals[-1]
    assert (proposal.step, proposal.model.name) == (Step.FAMILY, "lugre")
    sides = proposal.model.modifiers["direction"]
    assert sides["positive"]["coulomb"] > 2.0 * sides["negative"]["coulomb"]  # so early the levels are not exact
    assert driven.learner.figures.family.in_use == "lugre + direction"


def test_what_helps_is_kept_for_this_motion_and_the_next_run_and_no_other_is_looked_for(asked):
    asked.take(WINDOW + 6, error=3e-5, amplitude=0.02)
    assert asked.notes[-1].startswith("learning keeps the family lugre: error 70.")
    figures = asked.learner.figures.family
    assert (figures.state, figures.tried) == ("kept", 1)
    parameters, _, content = asked.learner.proven
    assert content["model"] == "lugre"
    # another motion has the model file; this one, when it comes back, has what was kept
    asked.take(6, error=3e-5, amplitude=0.3)
    assert (asked.proposals[-1][1].model.name, figures.in_use) == ("stribeck", "stribeck")
    asked.take(6, error=3e-5, amplitude=0.02)
    assert (asked.proposals[-1][1].step, asked.proposals[-1][1].model.name) == (Step.KNOWN, "lugre")
    # the next run
    other = Driven(MAP, gain=0.9)
    other.learner.resume(parameters, 0.95, content)
    other.take(1, error=3e-5, amplitude=0.02)
    _, first = other.proposals[0]
    assert (first.model.name, first.gain) == ("lugre", 0.95)
    assert other.learner.in_use == pytest.approx(parameters)
    assert other.learner.proven[2] == content


def test_what_does_not_help_is_taken_back_and_not_tried_again_soon(asked):
    driven, taken_back = asked, asked.learner.figures.taken_back
    driven.take(8, until=Step.BACK, error=1.05e-4, amplitude=0.02)
    _, back = driven.proposals[-1]
    assert (back.step, back.model.name) == (Step.BACK, "stribeck")
    np.testing.assert_array_equal(back.model.values, MAP.values)
    assert (driven.learner.figures.family.state, driven.learner.figures.taken_back) == ("no gain", taken_back)
    tried = len(driven.proposals)
    driven.take(6 * WINDOW, error=1e-4, amplitude=0.02)
    assert not any(each.step is Step.FAMILY for _, each in driven.proposals[tried:])
    assert driven.learner.figures.family.explained == {}


@pytest.mark.deep
def test_a_family_that_explains_no_more_is_not_tried():
    driven = Driven(MAP, gain=1.0).take(15 * WINDOW, error=1e-4, amplitude=0.3, true=MAP)
    assert not any(each.step is Step.FAMILY for _, each in driven.proposals)
    assert driven.learner.figures.family.state == "none explains more"


CONTENT = {"model": "lugre", "parameters": dict(LUGRE.given)}


def test_the_file_of_an_earlier_version_is_that_of_the_model_file_s_own_family(tmp_path):
    path = tmp_path / "x.json"
    known = Proven("digest", {"coulomb": 0.07}, 0.97, 1000.0, None, CONTENT)
    store(path, known)
    assert recall(path, "digest", None, 2000.0) == (known, "")
    values = json.loads(path.read_text()) | {"version": 1}
    del values["friction"]
    path.write_text(json.dumps(values))
    assert recall(path, "digest", None, 2000.0)[0] == Proven("digest", {"coulomb": 0.07}, 0.97, 1000.0, None)


@pytest.mark.parametrize("content", [{}, {"model": "none", "parameters": {}}, {"model": "lugre", "parameters": {}}, 1])
def test_a_stored_family_that_does_not_exist_is_named_and_not_used(tmp_path, content):
    store(tmp_path / "x.json", Proven("digest", {}, 0.97, 1000.0, None, content))
    found, why = recall(tmp_path / "x.json", "digest", None, 2000.0)
    assert found is None
    assert "cannot be read" in why


INSTEAD = "; family gms in place of lugre"
GMS = {"text": "gms", "tried": 1}
BETTER = {"error_before": 2e-5, "error_after": 1e-5}
RIPPLE = "ripple of order 7"


@pytest.mark.parametrize(
    ("family", "layer", "words"),
    [
        ({}, (), ""),
        ({"state": "on trial", "in_use": "gms", **GMS}, (), "; family gms: on trial"),
        ({"state": "no gain", **GMS}, (), "; family gms: no gain, off"),
        ({"state": "kept", "in_use": "gms", **GMS, **BETTER}, (), f"{INSTEAD}, error 20.0 µrad -> 10.0 µrad"),
        ({"state": "kept", **GMS}, (), "; family gms: not proven for this motion, off"),
        ({"in_use": "gms"}, (), INSTEAD),
        ({}, ("no gain", 0.4, 2, 5e-3, None, RIPPLE), "; residual layer: no gain, off"),
        ({}, ("on", 0.4, 1, 5.1e-3, 1.9e-3, RIPPLE), f"; residual layer: {RIPPLE}, error 5.10 mrad -> 1.90 mrad, on"),
    ],
)
def test_the_last_line_of_a_run_names_the_family_where_it_changed_and_the_layer(family, layer, words):
    report = first_report("on", "rad", 0.9)
    assert report["residual_layer"] == asdict(LayerFigures()), "before anything was learned"
    report["family"] |= {"of_file": "lugre", "in_use": "lugre", **family}
    report["residual_layer"] = asdict(LayerFigures(*layer))
    assert learning_words.result(report) == f"re-identified 0 times{words}"
