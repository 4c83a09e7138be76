"""Static friction from maps of speed and torque."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.errors import RecordingError, UsageError
from friction_hil.identification.static_map import fit_map
from friction_hil.models.files import load_model_file
from friction_hil.recordings import Recording

SPEEDS = np.geomspace(0.5, 300.0, 14)
TRUTH = {"coulomb": 0.16, "static": 0.2, "stribeck_velocity": 6.0, "viscous": 3e-4}


def points(velocity: np.ndarray, offset: float = 0.0, **truth: float) -> Recording:
    torque = fh.models.create("stribeck", **{**TRUTH, **truth}).steady_state(velocity) + offset
    return Recording("map.csv", "map", {"velocity": velocity, "torque": torque})


@pytest.mark.deep
@settings(max_examples=15, deadline=None)
@given(st.floats(1e-3, 1e3), st.floats(0.1, 30.0))
def test_a_map_gives_back_its_friction_at_any_scale(level: float, speed: float) -> None:
    units = {"coulomb": level, "static": level, "stribeck_velocity": speed, "viscous": level / speed}
    truth = {name: unit * TRUTH[name] for name, unit in units.items()}
    velocity = speed * np.concatenate([-SPEEDS, SPEEDS])
    best = fit_map([points(velocity, 0.01 * level, **truth)]).fits[0]
    assert best.family == "stribeck"
    assert best.parameters == pytest.approx(truth, rel=1e-2)
    assert best.offset == pytest.approx(0.01 * level, rel=1e-2)


def test_the_command_writes_a_model_file_and_the_preview_names_it(tmp_path, capsys):
    path, output = tmp_path / "map.csv", tmp_path / "map.yaml"
    rows = [f"{v * 30 / np.pi:.6f},{1e3 * t:.6f}" for v, t in zip(*points(SPEEDS).columns.values(), strict=True)]
    path.write_text("speed [rpm],torque (mNm)\n" + "\n".join(rows) + "\n")
    assert main(["convert", str(path), "--info", "--json"]) == 0
    suggestion = json.loads(capsys.readouterr().out)["axes"]["map"]["suggestion"]
    assert "--static" in suggestion["command"]
    words = [word for name, source in suggestion["columns"].items() for word in ("--column", f"{name}={source}")]
    words += ["--fix", "inertia=1e-4", "--output", str(output), "--json"]
    assert main(["identify", str(path), "--static", *words]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["best"] == "stribeck"
    model = load_model_file(output)
    assert model.friction.parameters["coulomb"] == pytest.approx(0.16, rel=0.01)
    assert (model.mechanics.inertia, model.mechanics.offset) == (1e-4, 0.0)


@pytest.mark.parametrize(
    ("columns", "families", "error", "message"),
    [
        ({"velocity": SPEEDS, "torque": -1.0 - SPEEDS}, [], RecordingError, "--scale torque=-1"),
        ({"velocity": np.arange(3.0), "torque": np.ones(3)}, [], RecordingError, "2 speeds.*at least 3"),
        ({"velocity": SPEEDS, "torque": 1.0 + SPEEDS}, ["lugre"], UsageError, "'lugre'.*coulomb, power_law, stribeck"),
        ({"velocity": SPEEDS}, [], RecordingError, "column torque"),
    ],
)
def test_what_is_no_map_is_refused(columns, families, error, message):
    with pytest.raises(error, match=message):
        fit_map([Recording("m", "m", columns)], families)
