"""Exports that lose torque: the fit is the best there is, and the loss is what it says."""

import csv
import json
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.errors import UsageError
from friction_hil.export.lossy import fit_stribeck, fit_viscous
from friction_hil.export.points import points
from friction_hil.models.files import load_model_file, model_from_argument

LUGRE = "lugre:sigma0=1800,sigma1=0.1,sigma2=2e-3,coulomb=0.07,static=0.105,stribeck_velocity=0.22"
STRIBECK = "stribeck:coulomb=0.07,static=0.105,stribeck_velocity=0.22,viscous=2e-3"


def written(tmp_path, **content):
    """A model file with a range of validity."""
    path = tmp_path / "axis.yaml"
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.1, "viscous": 0.01}}
    path.write_text(yaml.safe_dump({"axis": "rotary", "friction": friction, **content}))
    return path


EXAMPLES = Path("config").resolve()
CONFIG = str(EXAMPLES / "single_axis_csp.yaml")
LINEAR = str(EXAMPLES / "machines" / "ball_screw.yaml")


def with_kalman(folder):
    """A configuration whose estimator needs the inertia."""
    text = Path(CONFIG).read_text().replace("velocity: difference ", "velocity: kalman ")
    path = folder / "kalman.yaml"
    path.write_text(text.replace("models/", f"{EXAMPLES}/models/"))
    return path


def recorded(path, time, velocity):
    rows = {"time_s": time, "velocity": velocity, "position": np.cumsum(velocity) * 1e-3, "torque": 0.0 * time}
    np.savetxt(path, np.column_stack([*rows.values()]), delimiter=",", header=",".join(rows), comments="")
    return path


def test_another_search_finds_no_better_coulomb_level_and_damping():
    file = model_from_argument(STRIBECK)
    at = points(file, speed=2.0)
    torque = at.torque(file.friction_model)

    def squares(p):
        return float(at.weight @ (torque - np.abs(p[0]) * np.sign(at.velocity) - np.abs(p[1]) * at.velocity) ** 2)

    fit = fit_viscous(at, torque)
    own = squares([fit.coulomb, *fit.viscous])
    assert own <= minimize(squares, [0.05, 0.005], method="Powell", options={"xtol": 1e-12}).fun * (1 + 1e-6)
    assert own < 0.9 * squares([0.07, 2e-3])  # parameters of like name lose more


@given(st.floats(1e-3, 1e3), st.floats(0.0, 10.0), st.floats(1e-2, 1e2))
def test_what_the_form_holds_is_not_lost(coulomb, viscous, speed):
    converted = fh.export.convert(f"coulomb:coulomb={coulomb!r},viscous={viscous!r}", "ax8000", speed=speed)
    assert converted.loss.relative < 1e-9
    assert converted.parameters["3144:02"] == pytest.approx(coulomb, rel=1e-6, abs=1e-6 * viscous * speed)
    assert converted.parameters["3144:03"] == pytest.approx(viscous, rel=1e-6, abs=1e-6 * coulomb / speed)


@given(st.floats(0.01, 10.0), st.floats(0.05, 3.0), st.floats(0.01, 0.3), st.floats(1.2, 3.0))
def test_a_stribeck_curve_is_found_again(coulomb, hump, velocity, exponent):
    file = model_from_argument(
        f"stribeck:coulomb={coulomb!r},static={(1 + hump) * coulomb!r},stribeck_velocity={velocity!r},"
        f"stribeck_exponent={exponent!r},viscous={0.1 * coulomb!r}"
    )
    at = points(file, speed=1.0)
    torque = at.torque(file.friction_model)
    fit = fit_stribeck(at, torque, exponents=(1.0, 10.0))
    np.testing.assert_allclose(fit.torque(at.velocity), torque, rtol=0.0, atol=1e-5 * coulomb)
    assert fit.velocity == pytest.approx(velocity, rel=1e-2)


def test_the_speeds_of_a_recording_weigh_the_fit(tmp_path):
    time = np.arange(8000) * 1e-3
    velocity = np.where(time < 6.0, 0.1, 1.5) * np.sin(np.pi * time)
    path = recorded(tmp_path / "slow.csv", time, velocity)
    weighed = fh.export.convert(STRIBECK, "mjcf", recording=path)
    uniform = fh.export.convert(STRIBECK, "mjcf", speed=1.5)
    moving = velocity[np.abs(velocity) > 2e-4]
    steady = model_from_argument(STRIBECK).friction_model.steady_state(moving)

    def rms(parameters):  # over the samples themselves
        fitted = parameters["frictionloss"] * np.sign(moving) + parameters["damping"] * moving
        return np.sqrt(np.mean((fitted - steady) ** 2))

    assert rms(weighed.parameters) < 0.8 * rms(uniform.parameters)
    assert weighed.loss.rms == pytest.approx(rms(weighed.parameters), rel=0.01)
    assert "slow.csv" in weighed.loss.origin
    slow = written(tmp_path, fit={"range": {"velocity": [-0.5, 0.5]}})
    origin = fh.export.convert(slow, "mjcf", recording=path).loss.origin
    assert "identified at -0.5 to 0.5 rad/s only" in origin
    with pytest.raises(UsageError, match="the axis does not move"):
        fh.export.convert(STRIBECK, "mjcf", recording=recorded(tmp_path / "rest.csv", time, 0.0 * time))


def test_the_loss_is_that_of_the_difference_between_the_directions():
    """A level of 1.1 forward and 0.9 backward loses 0.1 everywhere."""
    file = load_model_file("config/models/ball_screw.yaml")
    sides = {"positive": {"coulomb": 1.1}, "negative": {"coulomb": 0.9}}
    own = {"model": "coulomb", "parameters": {"coulomb": 1.0}, "modifiers": {"direction": sides}}
    file = file.model_copy(update={"friction": file.friction.model_copy(update=own)})
    converted = fh.export.convert(file, "mjcf", name="x", speed=1.0)
    loss = converted.loss
    assert (loss.rms, loss.between_directions, abs(loss.largest)) == pytest.approx((0.1, 0.1, 0.1))
    assert loss.relative == pytest.approx(0.1 / np.sqrt(0.5 * (1.1**2 + 0.9**2)))  # of the RMS of the torque
    assert converted.parameters["frictionloss"] == pytest.approx(1.0)
    assert fh.export.convert(file, "csv", name="x").loss.rms < 1e-9


def test_the_part_between_the_directions_is_one_of_the_loss(tmp_path):
    """A range that is longer on one side has no mirror there, and a table holds each direction by itself."""
    sides = {"direction": {"positive": {"coulomb": 0.11}, "negative": {"coulomb": 0.09}}}
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.1}, "modifiers": sides}
    path = written(tmp_path, friction=friction, fit={"range": {"velocity": [-0.1, 3.0]}})
    loss = fh.export.convert(path, "mjcf").loss
    assert 0.0 < loss.between_directions <= loss.rms < 0.01
    assert fh.export.convert(path, "csv").loss.between_directions == 0.0
    forward = written(tmp_path, friction=friction, fit={"range": {"velocity": [0.0, 3.0]}})
    assert fh.export.convert(forward, "mjcf").loss.rms == pytest.approx(0.0, abs=1e-12)


def test_what_an_export_holds_is_not_said_to_be_lost(tmp_path):
    ripple = [{"order": 7, "cosine": 0.001, "sine": 0.002}]
    parameters = {"sigma0": 1800.0, "sigma1": 1.0, "coulomb": 0.07, "static": 0.105, "stribeck_velocity": 0.22}

    def lost(to, more=(), **changed):
        friction = {"model": "lugre", "parameters": parameters | changed, "modifiers": {"ripple": [*ripple, *more]}}
        return "\n".join(fh.export.convert(written(tmp_path, friction=friction), to).loss.lost)

    assert lost("mjcf_lugre") == ""
    assert "other harmonics of up to 0.0005 N m" in lost("mjcf_lugre", [{"order": 3, "cosine": 0.0, "sine": 0.0005}])
    assert "damping of the bristles falls with the velocity" in lost("mjcf_lugre", damping_velocity=0.1)
    assert "0.00224 N m" in lost("mjcf")
    assert "after a reversal" in lost("mjcf")
    assert "not its shape" in lost("ax8000")
    assert "after a reversal" not in lost("ax8000")
    added = "\n".join(fh.export.convert(STRIBECK, "mjcf_lugre").loss.lost)
    assert "has no presliding; in MuJoCo the torque builds up over 0.00022 rad" in added


def test_what_no_steady_curve_shows_is_named():
    loss = fh.export.convert("config/models/ball_screw.yaml", "mjcf").loss
    text = "\n".join(loss.lines())
    for each in ("0.08 (motoring)", "harmonics of up to 0.5 N", "5 to 45 deg C", "which no recording states"):
        assert each in text
    assert loss.temperature in (5.0, 45.0)
    assert "after a reversal" in "\n".join(fh.export.convert(LUGRE, "urdf").loss.lines())


def test_the_range_is_that_of_the_model_file_and_the_comment_repeats_the_fit(tmp_path):
    fit = {"software": "friction_hil 9", "range": {"velocity": [-3.0, 5.0]}, "recordings": [{"path": "a--b.mcap"}]}
    path = written(tmp_path, fit=fit, mechanics={"inertia": 2e-4})
    (text,) = fh.export.files(path, to="mjcf").values()
    for each in ("friction_hil 9", "a- -b.mcap", "-3 to 5 rad/s", "Torque lost: none"):
        assert each in text
    joint, expected = ET.fromstring(text).find(".//joint"), {"frictionloss": 0.1, "damping": 0.01, "armature": 2e-4}
    assert {name: float(joint.get(name)) for name in expected} == pytest.approx(expected)


def test_a_table_read_between_its_rows_gives_the_torque():
    converted = fh.export.convert(STRIBECK, "csv", speed=1.0)
    lines = [line for line in converted.files["stribeck.csv"].splitlines() if not line.startswith("#")]
    table = np.array([[float(each) for each in row] for row in csv.reader(lines[1:])])
    v = np.linspace(-1.0, 1.0, 999)
    v = v[np.abs(v) > 1e-3]
    expected = model_from_argument(STRIBECK).friction_model.steady_state(v)
    difference = np.abs(np.interp(v, table[:, 0], table[:, 1]) - expected)
    assert difference.max() < 5e-3 * 0.105
    assert difference.max() <= 1.1 * abs(converted.loss.largest) + 1e-9


@given(st.floats(0.0, 2.0), st.floats(0.05, 0.5), st.floats(1.0, 3.0))
def test_bam_reads_the_torque_of_a_stribeck_model(hump, velocity, exponent):
    """The formula of BAM's ``compute_frictions`` without load: frictionloss + damping |v|."""
    model = (
        f"stribeck:coulomb=0.1,static={0.1 * (1 + hump)!r},stribeck_velocity={velocity!r},"
        f"stribeck_exponent={exponent!r},viscous=0.02"
    )
    converted = fh.export.convert(model, "bam", name="x", speed=2.0)
    p = json.loads(converted.files["x.json"])
    v = np.linspace(0.05, 2.0, 40)
    loss = p["friction_base"] + p["friction_viscous"] * v
    if p["model"] == "m2":
        loss = loss + p["friction_stribeck"] * np.exp(-((v / p["dtheta_stribeck"]) ** p["alpha"]))
    expected = model_from_argument(model).friction_model.steady_state(v)
    np.testing.assert_allclose(loss, expected, rtol=0.0, atol=1e-5)
    assert p["model"] == ("m1" if hump < 1e-8 else "m2")


def test_isaac_lab_gets_two_levels_for_physx_and_one_for_newton():
    content = json.loads(fh.export.convert(STRIBECK, "isaaclab", name="x", speed=1.0).files["x.json"])
    assert content["physx"]["friction"] == pytest.approx(0.105)  # break-away
    assert content["physx"]["dynamic_friction"] == content["newton"]["friction"] < 0.105
    assert any(line.startswith("Torque lost:") for line in content["comment"])


def test_the_objects_of_the_ax8000_are_level_factor_and_spring():
    converted = fh.export.convert("dahl:sigma0=500,coulomb=0.1", "ax8000", name="x", speed=1.0)
    lines = [line for line in converted.files["x.csv"].splitlines() if not line.startswith("#")]
    rows = {f"{row['index']}:{row['subindex']}": (float(row["value"]), row["unit"]) for row in csv.DictReader(lines)}
    assert rows["3144:01"] == (pytest.approx(500.0, rel=1e-3), "N m/rad")
    assert rows["3144:02"] == (pytest.approx(0.1), "N m")
    assert rows["3144:03"] == (pytest.approx(0.0, abs=1e-9), "N m s/rad")
    assert "3144:01" not in fh.export.convert(STRIBECK, "ax8000", name="x").parameters


def test_the_command_prints_and_writes_the_loss(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["export", STRIBECK, "--to", "urdf", "--output", "axis_x.urdf", "--speed", "2"]) == 0
    printed = capsys.readouterr().out
    assert "Torque lost:" in printed
    loss_line = next(line for line in printed.splitlines() if line.startswith("Torque lost:"))
    assert loss_line in (tmp_path / "axis_x.urdf").read_text()
    assert main(["export", STRIBECK, "--to", "csv", "--output", "t.csv", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["written"] == ["t.csv"]
    assert set(answer["loss"]) >= {"rms", "largest", "velocity", "temperature", "lost"}


def test_the_formats_share_no_file(tmp_path, capsys, monkeypatch):
    """By default, that is; a name that is given is taken as it is."""
    monkeypatch.chdir(tmp_path)
    for to in ("st", *fh.export.LOSSY):
        assert main(["export", STRIBECK, "--to", to]) == 0, to
    expected = {"stribeck.st", "stribeck.xml", "stribeck.urdf", "stribeck.csv", "stribeck_ax8000.csv"}
    expected |= {"stribeck_bam.json", "stribeck_isaaclab.json", "stribeck_mjcf.xml", "stribeck_mjcf_lugre.xml"}
    assert {path.name for path in tmp_path.iterdir()} == expected
    assert ET.parse("stribeck_mjcf.xml").find(".//joint").get("name") == "stribeck"
    assert "physx: friction 0.105, dynamic_friction" in capsys.readouterr().out
    assert main(["export", STRIBECK, "--to", "ax8000", "--output", "drive.csv"]) == 0
    assert (tmp_path / "drive.csv").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--to", "urdf", "--output", "firmware/"], "there is no folder firmware"),
        (["--to", "c", "--output", "firmware/axis.c"], "there is no folder firmware"),
        (["--to", "c", "--output", "Axis.c"], "such as axis"),
        (["--to", "urdf", "--speed", "0"], "above zero"),
        (["--to", "urdf", "--speed", "nan"], "above zero"),
        (["--to", "urdf", "--speed", "1e200"], "too wide a range"),
        (["--to", "c", "--config", CONFIG, "--resolution", "1e-300"], "--resolution 1e-300"),
        (["--to", "c", "--config", with_kalman, "--resolution", "1e-5"], "kalman needs mechanics.inertia"),
        (["--to", "c", "--config", LINEAR, "--resolution", "1e-5"], "is for a rotary axis, and"),
        (["--to", "urdf", "--axis", "x"], "--axis belongs to --recording"),
        (["--to", "urdf", "--config", "a.yaml"], "does not hold"),
        (["--to", "c", "--speed", "1"], "loses none"),
        (["--to", "modelica"], "there is no format 'modelica'; export with --to fmu"),
    ],
)
def test_mistakes_are_answered(words, message, capsys, tmp_path, tmp_path_factory, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = [str(made(tmp_path_factory.mktemp("config"))) if callable(made) else made for made in words]
    assert main(["export", STRIBECK, *words]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert main(["export", "strybeck", "--to", "c"]) == 2
    assert capsys.readouterr().err.startswith("Error: strybeck: neither a file nor")
