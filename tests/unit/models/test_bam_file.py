"""Files of BAM: the torque of its law, written again here and, where its package runs, by the package itself."""

import json
import re
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

import friction_hil as fh
from friction_hil.errors import UsageError
from friction_hil.models import bam_file, foreign
from friction_hil.models.model_file import ModelFile

KINDS = sorted(bam_file.FRICTION)
BOUNDS = {
    "friction_base": (1e-3, 0.3),
    "dtheta_stribeck": (0.1, 4.0),
    "alpha": (0.6, 9.0),
    "friction_viscous": (0.0, 1.0),
}
# as bam.fit writes them: the largest file of the package has these shares
LARGEST = {"load_friction_motor": 0.4, "load_friction_motor_stribeck": 0.3, "load_friction_base": 0.4}


@st.composite
def files(draw, kinds=KINDS):
    kind = draw(st.sampled_from(kinds))
    found = {"model": kind, "actuator": "xl330", "kt": 0.366, "R": 2.81, "q_offset": -0.02, "armature": 0.002}
    for name in bam_file.FRICTION[kind]:
        low, high = BOUNDS.get(name, (0.0, LARGEST.get(name, 0.3)))
        found[name] = draw(st.floats(low, high))
    if kind == "m6":
        found |= {f"load_friction_{side}_quad": draw(st.floats(0.0, 0.01)) for side in ("motor", "external")}
    return found


def written_again(p):
    """Frictionloss and damping: equations 4 to 9 of Duclusaud et al., arXiv 2410.08650."""

    def law(motor, external, velocity):
        def get(name):
            return p.get(name, 0.0)

        s = np.exp(-(abs(velocity / p["dtheta_stribeck"]) ** p["alpha"])) if "alpha" in p else 0.0
        loss = get("friction_base") + s * get("friction_stribeck")
        loss += (get("load_friction_base") + s * get("load_friction_stribeck")) * abs(motor - external)
        for share, end in ((1.0, ""), (s, "_stribeck")):
            parts = [get(f"load_friction_{side}{end}") for side in ("motor", "external")]
            loss += share * abs(parts[0] * motor - parts[1] * external)
        if np.sign(motor) != np.sign(external):
            side, other = ("external", external) if abs(external) < abs(motor) else ("motor", motor)
            loss += s * get(f"load_friction_{side}_quad") * other**2 * (abs(external) != abs(motor))
        return loss, get("friction_viscous")

    return law


def of_the_package(p):
    return sys.modules["bam.model"].load_model_from_dict(p).compute_frictions


@pytest.fixture(params=[written_again, of_the_package], scope="module")
def law_of(request):
    if request.param is of_the_package:
        reason = "better-actuator-models is not installed: pip install better-actuator-models, with Python 3.12"
        pytest.importorskip("bam.model", reason=reason)
    return request.param


def steady(law, velocity, load=0.0):
    """Friction at a constant speed against a load: what the motor has to give, less the load."""

    def left(friction):
        loss, damping = law(friction + load, -load, velocity)
        return friction - loss - damping * velocity

    return brentq(left, 0.0, 1e4, xtol=1e-14, rtol=1e-14)


def read(folder, content, joint=None):
    path = folder / "m.json"
    path.write_text(json.dumps(content))
    return foreign.read(path, "bam", joint)


def off_by(found):
    """Largest relative difference without load that the import states."""
    return max(
        (float(each[1]) / 100.0 for each in map(re.compile(r"BAM's by (\S+) %").search, found.notes) if each),
        default=0.0,
    )


@given(files())
@settings(max_examples=60)
def test_the_model_has_the_torque_of_bam(law_of, tmp_path_factory, p):
    """Without load within what the notes state; under a load never more, and the same while it slides fast."""
    found = read(tmp_path_factory.mktemp("bam"), p)
    model, law = ModelFile.model_validate(found.content).friction_model, law_of(p)
    hump = p.get("dtheta_stribeck", 0.1)
    for velocity in (1e-6, 0.3 * hump, hump, 2.0 * hump, 1000.0 * hump):
        bam = steady(law, velocity)
        ours = model.steady_state([velocity], load_torque=0.0)[0]
        assert ours == pytest.approx(bam, rel=1.01 * off_by(found) + 1e-9, abs=1e-12)
        loaded = model.steady_state([velocity], load_torque=2.0)[0]
        assert loaded <= steady(law, velocity, 2.0) * (1.01 * off_by(found) + 1.0 + 1e-9)
    assert loaded == pytest.approx(steady(law, 1000.0 * hump, 2.0), rel=1e-6)
    assert found.content["mechanics"]["inertia"] == 0.002


@given(files(["m1", "m2", "m3"]), st.floats(0.0, 0.5))
@settings(max_examples=30)
def test_a_file_that_was_read_is_written_again(law_of, tmp_path_factory, p, load):
    """With its motor, so that BAM's own reader takes it as it is; and what it says of a load comes back."""
    folder = tmp_path_factory.mktemp("bam")
    content = read(folder, p).content
    if p["model"] != "m3":
        content["friction"]["modifiers"] = {"load": {"motoring": load}}
    file = ModelFile.model_validate(content)
    converted = fh.export.convert(file, "bam", name="x", speed=5.0)
    again, lost = json.loads(converted.files["x.json"]), 1.1 * abs(converted.loss.largest) + 1e-6
    law, model = law_of(again), file.friction_model
    assert {name: again[name] for name in ("actuator", "kt", "R", "q_offset")} == {
        "actuator": "xl330",
        "kt": 0.366,
        "R": 2.81,
        "q_offset": -0.02,
    }
    for velocity in (0.05, 0.7, 4.0):
        for outside in (0.0, 0.4):
            ours = model.steady_state([velocity], load_torque=outside)[0]
            assert steady(law, velocity, outside) == pytest.approx(ours, abs=lost)
    back = ModelFile.model_validate(read(folder, again).content).friction_model
    assert back.steady_state([2.0], load_torque=1.0)[0] == pytest.approx(
        model.steady_state([2.0], load_torque=1.0)[0], abs=lost
    )


M1 = {"model": "m1", "friction_base": 0.1, "friction_viscous": 0.02, "actuator": "mx64", "kt": 1.6}
SEVERAL = {
    "hip": {"dofs": ["left", "right"], "error_gain": 0.16, "max_pwm": 0.9, "model": M1},
    "knee": {"dofs": ["knee"], "error_gain": 0.16, "max_pwm": 0.9, "model": {**M1, "friction_base": 0.3}},
}


def test_a_configuration_of_several_actuators_is_known_by_its_content(tmp_path):
    found = read(tmp_path, SEVERAL, "knee").content
    assert found["friction"]["parameters"]["coulomb"] == 0.3
    assert found["fit"]["imported"]["motor"] == {"actuator": "mx64", "kt": 1.6, "error_gain": 0.16, "max_pwm": 0.9}
    assert read(tmp_path, {"hip": SEVERAL["hip"]}).content["friction"]["parameters"]["coulomb"] == 0.1
    for joint, message in ((None, "several joints.*hip.*knee"), ("ankle", "no joint 'ankle'.*hip")):
        with pytest.raises(UsageError, match=message):
            read(tmp_path, SEVERAL, joint)


def test_what_is_not_known_is_named(tmp_path):
    notes = read(tmp_path, {**M1, "load_friction_base": 0.1, "wear": 3.0}).notes
    assert any("m1" in each and "load_friction_base 0.1, wear 3.0" in each for each in notes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wear": float("nan")}, "wear must be a finite number"),
        ({"limits": [1.0, float("inf")]}, r"limits\.1 must be a finite number"),
        ({"friction_base": -0.1}, "friction_base must be a finite number, not below zero"),
        ({"kt": float("inf")}, "kt must be a finite"),
        ({"model": "m3"}, "load_friction_base is missing"),
        ({"model": "m3", "load_friction_base": 1.0}, "never move it"),
        ({"model": "m7"}, "no model m1 to m6"),
    ],
)
def test_a_number_that_makes_no_friction_is_refused(tmp_path, change, message):
    for content, joint in (({**M1, **change}, None), ({"hip": {"model": {**M1, **change}}}, "hip")):
        with pytest.raises(UsageError, match=message):
            read(tmp_path, content, joint)
