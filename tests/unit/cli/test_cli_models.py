"""The command ``models``: list, description, example, errors, JSON; and the picture of a model."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.errors import UsageError
from friction_hil.friction.steady_curve import velocity_range
from friction_hil.models.files import load_model_file
from friction_hil.reports.model_picture import ripple, slow_cycle
from tests.friction_models import DYNAMIC, NAMES, STATIC_MAPS, models

LINEAR_AXIS = """\
version: 1
axis: linear
friction:
  model: lugre
  parameters: {sigma0: 2e6, sigma1: 300.0, sigma2: 60.0, coulomb: 25.0, stribeck_velocity: 2e-3}
  modifiers:
    direction: {positive: {coulomb: 28.0}, negative: {coulomb: 20.0, static: 18.0}}
    load: {motoring: 0.1, driven: 0.05}
    temperature: {reference: 40.0, coefficient: -0.004}
    ripple: [{order: 100, cosine: 1.0, sine: 2.0}, {order: 300, cosine: 0.5}]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A current directory with a model file."""
    (tmp_path / "axis.yaml").write_text(LINEAR_AXIS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(autouse=True)
def page(monkeypatch):
    """The width of the page; pytest's workers come with one of their own."""
    monkeypatch.setenv("COLUMNS", "100")


def output_of(capsys, *words):
    assert main(["models", *words]) == 0
    return capsys.readouterr().out


def example(name):
    return fh.models.create(name, **fh.models.describe(name).example)


@pytest.mark.parametrize("columns", [None, "80", "120"])
def test_list(columns, capsys, monkeypatch):
    if columns:
        monkeypatch.setenv("COLUMNS", columns)
    else:
        monkeypatch.delenv("COLUMNS", raising=False)
    lines = output_of(capsys).splitlines()
    assert max(map(len, lines)) <= int(columns or 100)
    assert all(line == line.rstrip() and line.isprintable() for line in lines)
    names = [line.split(" ")[0] for line in lines if line and line[0] != " "]
    assert [name for name in names if name in NAMES] == [*sorted(STATIC_MAPS), *sorted(DYNAMIC)]
    modifiers = ["direction", "viscous", "load", "temperature", "ripple", "reversal", "speed"]
    assert [name for name in names[names.index("modifier") :] if name in modifiers] == modifiers
    words = " ".join(" ".join(lines).split())
    for text in ("coulomb, static (=coulomb), viscous (=0)", "(=.inf)", "(=monotone)", "[N m s^2/rad^2]"):
        assert text in words or columns == "80"  # where cells are wrapped


def test_list_as_json(capsys):
    listed = json.loads(output_of(capsys, "--json"))
    assert sorted(model["name"] for model in listed["models"]) == sorted(NAMES)
    assert {model["name"] for model in listed["models"] if model["is_static"]} == set(STATIC_MAPS)
    keys = {modifier["name"]: [key["name"] for key in modifier["parameters"]] for modifier in listed["modifiers"]}
    assert keys == {
        "direction": ["positive", "negative"],
        "viscous": ["quadratic", "cubic"],
        "load": ["motoring", "driven"],
        "temperature": ["reference", "coefficient"],
        "ripple": ["order", "cosine", "sine"],
        "reversal": ["distance", "positive", "negative"],
        "speed": ["velocity", "positive", "negative"],
    }
    assert [modifier["name"] for modifier in listed["modifiers"] if modifier["is_list"]] == ["ripple"]
    for model in listed["models"]:
        modifiers = {each["name"]: each["example"] for each in listed["modifiers"]}
        if "coulomb" not in model["example"]:
            del modifiers["direction"]
        made = fh.models.create(model["name"], **model["example"], modifiers=modifiers)
        assert set(made.modifiers) == set(modifiers)


def test_modifiers_of_the_list_can_be_pasted_below_an_example(folder, capsys):
    listed = output_of(capsys).splitlines()
    start = listed.index("  modifiers:")
    block = listed[start : listed.index("", start)]
    text = "version: 1\naxis: rotary\n" + pasted(output_of(capsys, "lugre")) + "\n".join(block) + "\n"
    (folder / "made.yaml").write_text(text)
    model = fh.models.load("made.yaml")
    assert sorted(model.modifiers) == ["direction", "load", "reversal", "ripple", "speed", "temperature", "viscous"]
    assert model.modifiers["direction"] == {"positive": {"coulomb": 0.09}, "negative": {"coulomb": 0.07}}


def pasted(out):
    """What a user copies: from ``friction:`` to the next empty line."""
    return out[out.index("friction:\n") :].partition("\n\n")[0] + "\n"


@pytest.mark.parametrize("columns", ["60", "80", "120"])
@pytest.mark.parametrize("name", NAMES)
def test_example_is_a_whole_model_file_and_can_be_pasted_into_one(name, columns, folder, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    out = output_of(capsys, name)
    text = pasted(out)
    assert max(map(len, text.splitlines())) <= int(columns)
    whole = out[out.index("version: 1\n") :].partition("\n\n")[0]
    for content in (whole, f"version: 1\naxis: rotary\n{text}mechanics: {{inertia: 2e-4}}\n"):
        (folder / "made.yaml").write_text(content)
        assert load_model_file("made.yaml").friction_model.parameters == example(name).parameters


@pytest.mark.parametrize("name", NAMES)
def test_description(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    out = output_of(capsys, name)
    family = fh.models.describe(name)
    assert out.startswith(f"{name}: {family.summary}\n")
    for text in (*family.formula.split(";  "), *family.states, family.note, family.source):
        assert text in " ".join(out.split())
    table = {line.split(" ")[0]: line for line in out.splitlines()}
    for parameter in family.parameters:
        assert parameter.symbol in table[parameter.name]
        assert f" {parameter.unit} " in f"{table[parameter.name]} "
        assert parameter.meaning.split()[0] in table[parameter.name]


def test_kinds_of_parameters_print_well(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    for model, *rows in (
        ("table", "points (v, F) rad/s, N m 1 to 128 pairs of numbers", "interpolation monotone or linear monotone"),
        ("gms", "stiffness k_i N m/rad 2 to 20 numbers, each > 0 stiffness"),
        ("lugre", "static Fs N m > 0 coulomb break-away level", "damping_velocity vd rad/s > 0 or .inf .inf velocity"),
        ("coulomb:coulomb=0.08,viscous=2e-3", "coulomb Fc N m >= 0 0.08 Coulomb", "static Fs N m >= 0 0.08 break-away"),
        ("table:points=[[0.1, 1.0], [1.0, 0.8]]", "1 to 128 pairs of numbers 2 pairs speed"),
    ):
        words = " ".join(output_of(capsys, model).split())
        for row in rows:
            assert row in words, model


def test_description_as_json(capsys):
    model = json.loads(output_of(capsys, "lugre", "--json"))
    assert model["name"] == "lugre"
    assert model["is_static"] is False
    assert model["formula"][0] == "dz/dt = v - sigma0 |v| / g(v) z"
    assert model["states"] == ["bristle deflection z [rad]"]
    assert "Canudas de Wit" in model["source"]
    assert model["example"]["sigma0"] == 2000.0
    parameters = {parameter.pop("name"): parameter for parameter in model["parameters"]}
    assert parameters["static"].pop("meaning")
    facts = {"symbol": "Fs", "unit": "N m", "bounds": "> 0", "default": "coulomb", "is_required": False}
    assert parameters["static"] == facts
    assert parameters["sigma0"]["is_required"] is True
    # infinity has no form in JSON; that there is a default is told all the same
    assert (parameters["damping_velocity"]["default"], parameters["damping_velocity"]["is_required"]) == (None, False)


def test_model_file_of_a_linear_axis(folder, capsys):
    out = output_of(capsys, "axis.yaml")
    words = " ".join(out.split())
    assert "sigma0 sigma0 N/m > 0 2e+06 bristle stiffness" in words
    assert "stribeck_velocity vs m/s > 0 0.002 velocity" in words
    assert "damping_velocity vd m/s > 0 or .inf .inf velocity" in words
    assert "State: bristle deflection z [m]" in words
    assert "Note: static is below coulomb" in words
    for rotary in ("rad", "N m"):
        assert rotary not in out
    # what it shows is the file again: static follows the coulomb of each direction, as in the file
    (folder / "again.yaml").write_text("version: 1\naxis: linear\n" + pasted(out))
    first, second = fh.models.load("axis.yaml"), fh.models.load("again.yaml")
    assert second.modifiers == first.modifiers
    np.testing.assert_array_equal(second.values, first.values)


def test_model_file_as_json(folder, capsys):
    model = json.loads(output_of(capsys, "axis.yaml", "--json"))
    values = {parameter["name"]: parameter["value"] for parameter in model["parameters"]}
    levels = {"coulomb": 25.0, "static": 25.0, "stribeck_velocity": 2e-3, "damping_velocity": None}
    assert values == {"sigma0": 2e6, "sigma1": 300.0, "sigma2": 60.0, **levels}
    assert (model["axis"], Path(model["file"]).name) == ("linear", "axis.yaml")
    assert model["modifiers"]["ripple"][1] == {"order": 300.0, "cosine": 0.5, "sine": 0.0}
    assert "static is below coulomb" in model["notes"][0]


def test_name_of_a_model_wins_over_a_file_of_that_name(folder, capsys):
    (folder / "dahl").write_text(LINEAR_AXIS)
    assert output_of(capsys, "dahl").startswith("dahl: ")


STIFF = (
    "armstrong:coulomb=0.08,static_released=0.1,static_rested=0.13,stribeck_velocity=0.2,lag_s=0.005,rise_s=1,"
    "stiffness={}"
)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["lugr"], "'lugre'"),
        (["lugre:sigma0=1"], "lugre needs coulomb"),
        (["coulomb:coulomb=-1"], "coulomb = -1 is not allowed"),
        (["coulomb:coulomb=1e60"], "coulomb = 1e+60 is not allowed: it is beyond 1e+50"),
        (["lugre:sigma0=1e300,coulomb=1e-300,stribeck_velocity=1", "--draw", "a.png"], "sigma0 = 1e+300"),
        (["stribeck:coulomb=1,static=2,stribeck_velocity=1e160"], "stribeck_velocity = 1e+160"),
        ([STIFF.format("5e-324")], "stiffness = 4.94066e-324 is not allowed: it is below 1e-50"),
        (["table:points=[[0.1, 1e60]]"], "points[0] is [0.1, 1e+60]"),
        (["coulomb:coulomb={"], "not YAML"),
        (["nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["broken.yaml"], "broken.yaml:4: friction.parameters.coulomb: coulomb: coulomb = -1"),
        (["--draw", "a.png"], "--draw needs a model"),
        (["--draw", "a.png", "--json"], "--draw needs a model"),
        (["lugre", "--draw", "a.jpgg"], "'.jpgg'; did you mean 'jpg'?"),
        (["lugre", "--draw", "nowhere/a.png"], "no folder nowhere"),
    ],
)
def test_mistakes_are_reported_in_a_sentence(words, message, folder, capsys):
    broken = "axis: rotary\nfriction:\n  model: coulomb\n  parameters: {coulomb: -1}\n"
    (folder / "broken.yaml").write_text(broken)
    assert main(["models", *words]) == 2
    out, error = capsys.readouterr()
    assert (list(json.loads(out)) == ["error"]) if "--json" in words else out == ""
    assert message in " ".join(error.split())
    assert "Traceback" not in error
    assert "--model" not in error


def test_draws_the_example_and_a_model_file(folder, capsys):
    out = output_of(capsys, "dahl", "--draw", "dahl.png")
    assert out.startswith("dahl: ")
    assert out.endswith("picture: dahl.png\n")
    assert (folder / "dahl.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads(output_of(capsys, "axis.yaml", "--draw", "axis.svg", "--json"))["axis"] == "linear"
    assert b"<svg" in (folder / "axis.svg").read_bytes()


@pytest.mark.parametrize("name", DYNAMIC)
def test_slow_cycle_shows_presliding(name):
    model = example(name)
    cycle = slow_cycle(model)
    end = cycle.position[cycle.leg == 0][-1]
    assert cycle.position.min() == pytest.approx(-end)
    # presliding is seen, and over well before the end
    assert 1.5 < end / (model.level / model.presliding_stiffness) < 20.0
    at_end = cycle.torque[cycle.leg == 1][-1]
    assert model.steady_state([-cycle.velocity])[0] == pytest.approx(at_end, rel=0.25)
    # the loop encloses work: friction on the way there and back
    outer = np.isin(cycle.leg, (1, 2, 5))
    work = np.sum(cycle.torque[outer] * np.diff(cycle.position, prepend=0.0)[outer])
    assert work > 0.3 * 4.0 * end * model.level
    # torque follows the position without a jump
    assert np.abs(np.diff(cycle.torque)).max() < 0.1 * model.level


@pytest.mark.parametrize("name", ["dahl", "gms", "lugre"])
def test_loop_inside_closes_with_non_local_memory_only(name):
    cycle = slow_cycle(example(name))
    before, after = cycle.torque[cycle.leg == 2][-1], cycle.torque[cycle.leg == 4][-1]
    assert cycle.position[cycle.leg == 4][-1] == pytest.approx(cycle.position[cycle.leg == 2][-1])
    assert (abs(after - before) < 1e-3 * before) == (name == "gms")


@pytest.mark.parametrize("name", STATIC_MAPS)
def test_slow_cycle_of_a_static_map_jumps_where_it_stands(name):
    cycle = slow_cycle(example(name))
    turning = np.sign(cycle.torque[1:]) * np.sign(cycle.torque[:-1]) < 0.0
    assert np.count_nonzero(turning) == 4
    np.testing.assert_array_equal(cycle.position[1:][turning], cycle.position[:-1][turning])
    moving = np.diff(cycle.position) != 0.0
    sliding = np.abs(cycle.torque[1:][moving])
    assert np.ptp(sliding) < 1e-9
    if name == "coulomb":  # it breaks away at 0.12 N m and slides at 0.08
        assert cycle.torque.max() == pytest.approx(0.12)
        assert sliding[0] == pytest.approx(0.08, rel=1e-3)


def test_what_vanishes_beside_the_level_is_not_drawn():
    values = {"coulomb": 0.08, "static_released": 0.1, "static_rested": 1e-50, "stribeck_velocity": 0.2}
    model = fh.models.create("armstrong", **values, viscous=0.0, lag_s=1e-50, rise_s=1e-30, stiffness=1e-30)
    with pytest.raises(UsageError, match="cannot be drawn: its stiffness vanishes beside its level"):
        slow_cycle(model)


@settings(deadline=None, max_examples=25)
@given(models())
def test_slow_cycle_of_any_model(model):
    cycle = slow_cycle(model)
    assert np.all(np.isfinite(cycle.position))
    assert np.all(np.isfinite(cycle.torque))
    assert cycle.torque[cycle.leg == 1][-1] < 0.0 < cycle.torque[-1]
    assert cycle.position[cycle.leg == 3][-1] < cycle.position[cycle.leg == 2][-1] <= cycle.position.max()


def test_ripple_is_drawn_by_itself(folder):
    smooth = LINEAR_AXIS[: LINEAR_AXIS.index("    ripple:")]
    (folder / "smooth.yaml").write_text(smooth)
    rough = fh.models.load("axis.yaml")
    np.testing.assert_allclose(slow_cycle(rough).torque, slow_cycle(fh.models.load("smooth.yaml")).torque, atol=1e-11)
    position = np.array([0.0, 0.0013, 0.004])
    angle = 2.0 * math.pi * position  # an order of a linear axis counts per metre
    expected = np.cos(100 * angle) + 2.0 * np.sin(100 * angle) + 0.5 * np.cos(300 * angle)
    np.testing.assert_allclose(ripple(rough, position), expected, atol=1e-12)


def test_velocity_range_shows_the_shape():
    assert velocity_range(example("lugre")) == pytest.approx(2.0)  # ten Stribeck velocities
    assert velocity_range(example("table")) == pytest.approx(11.0)  # past the last point
    assert velocity_range(example("dahl")) == pytest.approx(20.0, rel=0.02)  # viscous part half of the level
    assert velocity_range(fh.models.create("coulomb", coulomb=0.1)) == 1.0
    assert velocity_range(fh.models.create("coulomb", coulomb=0.0, viscous=1.0)) == 1.0
