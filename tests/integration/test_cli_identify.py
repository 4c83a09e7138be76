"""``friction-hil identify``: a made axis from file to model file, and a real one with published figures."""

import json
from pathlib import Path

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.models.files import load_model_file
from friction_hil.recordings import Recording

EMPS = Path(__file__).parents[3] / "shared" / "data" / "emps" / "DATA_EMPS.mat"
needs_emps = pytest.mark.skipif(not EMPS.exists(), reason="the shared data are not here")
GTAU, KP, KV = 35.15065188, 160.18, 243.45  # N/V, 1/s, V/(m/s): from the data
MAPPING = ["time_s=t", "position=qm", f"torque=vir*{GTAU}", "position_demand=qg"]
WORDS = ["--linear", "--lowpass", "100", "--decimate", "10", *(word for each in MAPPING for word in ("--column", each))]


@pytest.fixture
def swing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An axis with Coulomb friction 0.3, viscous 0.05 and inertia 0.02, as swing.csv in the current directory."""
    time = np.arange(6000) * 2e-3
    velocity = np.cos(2.0 * np.pi * 0.9 * time) + 0.4 * np.cos(2.0 * np.pi * 2.3 * time + 1.0)
    torque = 0.3 * np.sign(velocity) + 0.05 * velocity + 0.02 * np.gradient(velocity, 2e-3) + 0.04
    torque += 0.01 * np.random.default_rng(0).normal(size=len(time))
    columns = {"time_s": time, "position": np.cumsum(velocity) * 2e-3, "velocity": velocity, "torque": torque}
    fh.recordings.write(tmp_path / "swing.csv", Recording("swing.csv", "x", columns))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_model_file_loads_and_predicts(swing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["identify", "swing.csv", "--models", "coulomb,dahl", "--output", "axis.yaml", "-v"]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "Chosen: coulomb" in text
    assert "No closed-loop simulation: the controller is not known" in text
    model = load_model_file("axis.yaml")
    assert model.friction.parameters["coulomb"] == pytest.approx(0.3, rel=0.02)
    assert model.mechanics.inertia == pytest.approx(0.02, rel=0.02)
    assert model.fit is not None
    assert model.fit["recordings"] == [{"path": "swing.csv", "rows": 6000}]
    assert main(["replay", "swing.csv", "--model", "axis.yaml", "--json"]) == 0
    (recording,) = json.loads(capsys.readouterr().out)["recordings"]
    assert recording["models"][0]["relative_error"] < 0.04


def test_json_is_one_object_without_nan(swing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [
        "identify",
        "swing.csv",
        "--models",
        "coulomb",
        "--validate",
        "swing.csv",
        "--fix",
        "inertia=0.02",
        "--json",
    ]
    assert main(words) == 0
    document = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert document["best"] == document["fits"][0]["label"]
    assert document["fits"][0]["mechanics"]["inertia"] == 0.02
    assert "inertia" not in document["fits"][0]["standard_errors"]
    assert document["fits"][0]["validation"]["relative_error"] > 0.0


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (["--models", "coulom"], 2, "did you mean 'coulomb'"),
        (["--models", "coulomb", "--fix", "mass=1"], 2, "no candidate has a parameter 'mass'"),
        (["--fix", "inertia"], 2, "does not have the form 'name=1.5'"),
        (["--fix", "inertia=1", "--fix", "inertia=2"], 2, "given twice"),
        (["--output", "axis.json"], 2, "ends in .yaml"),
        (["--report", "axis.pdf"], 2, "ends in .html"),
        (["--seed", "-1"], 2, "x>=0"),
        (["--column", "torque=curent"], 2, "curent"),
        (["--models", "coulomb", "--controller", "kp=3"], 2, "--controller takes position_gain and velocity_gain"),
        (["--models", "coulomb", "--controller", "position_gain=3"], 2, "also needs velocity_gain"),
    ],
)
def test_mistakes(swing: Path, capsys: pytest.CaptureFixture[str], words: list[str], status: int, message: str) -> None:
    assert main(["identify", "swing.csv", *words]) == status
    assert message in capsys.readouterr().err


@pytest.mark.deep
@needs_emps
def test_emps_published_parameters_to_the_printed_digits(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["identify", str(EMPS), "--models", "coulomb", *WORDS, "--json"]) == 0
    fits = {each["label"]: each for each in json.loads(capsys.readouterr().out)["fits"]}
    fit = fits["coulomb"]
    assert fit["mechanics"]["inertia"] == pytest.approx(95.1089, abs=6e-5)
    assert fit["parameters"]["viscous"] == pytest.approx(203.5034, abs=6e-5)
    assert fit["parameters"]["coulomb"] == pytest.approx(20.3935, abs=6e-5)
    assert fit["mechanics"]["offset"] == pytest.approx(-3.1648, abs=6e-5)
    assert fit["train"]["relative_error"] == pytest.approx(0.04083, abs=6e-6)
    assert fits["coulomb + direction"]["train"]["relative_error"] == pytest.approx(0.03112, abs=6e-6)


@pytest.mark.deep
@needs_emps
def test_emps_lugre_explains_and_moves_the_axis(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "axis.yaml"
    gains = ["--controller", f"position_gain={KP}", "--controller", f"velocity_gain={GTAU * KV}"]
    assert main(["identify", str(EMPS), "--models", "lugre", *WORDS, *gains, "--output", str(model), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    best = document["fits"][0]
    assert best["train"]["relative_error"] <= 0.0287
    assert best["cross_validation"]["relative_error"] <= 0.029
    assert document["free_run"]["relative_error"] <= 0.036
    sides = load_model_file(model).friction.modifiers["direction"]
    assert sides["positive"]["static"] < sides["positive"]["coulomb"]  # this axis has no Stribeck hump
