"""A wrong unit or sign of a recording that a model betrays, and a position that is integrated from the velocity."""

from pathlib import Path

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.errors import UsageError
from friction_hil.identification import IdentificationSettings, identify
from friction_hil.identification.data import Data
from friction_hil.identification.plausibility import _one_way
from friction_hil.models.files import load_model_file, model_from_argument
from friction_hil.recordings import Recording
from friction_hil.recordings.segments import with_position
from friction_hil.replay.comparison import replay

TIME = np.arange(3000) * 5e-3
RANDOM = np.random.default_rng(5)
VELOCITY = 1.5 * np.cos(2.0 * TIME) + np.cos(5.3 * TIME)
POSITION = 0.75 * np.sin(2.0 * TIME) + np.sin(5.3 * TIME) / 5.3
TORQUE = 0.3 * np.sign(VELOCITY) + 0.12 * VELOCITY + 0.004 * RANDOM.normal(size=len(TIME))
MODEL = "coulomb:coulomb=0.3,viscous=0.12"


def recording(**columns: np.ndarray) -> Recording:
    return Recording("x.csv", "x", {"time_s": TIME, **columns})


@pytest.mark.parametrize(
    ("position", "torque", "said"),
    [
        (1.0, 1.0, ""),
        (180.0 / np.pi, 1.0, "--column 'position=position*pi/180'"),
        (1000.0, 1.0, "--column 'position=position*0.001'"),
        (1.0, 1000.0, "--column 'torque=torque*0.001'"),
        (1.0, 0.001, "--column 'torque=torque*1000'"),
        (1.0, -1.0, "*-1'"),
        (1.0, 1.4, ""),  # another friction
    ],
)
def test_replay_names_the_unit_that_a_model_betrays(position: float, torque: float, said: str) -> None:
    found = replay(recording(position=position * POSITION, torque=torque * TORQUE), {"m": model_from_argument(MODEL)})
    problems = [each for each in found.problems if each.startswith("m has an error")]
    assert len(problems) == bool(said)
    assert said in "".join(problems)


def test_speed_and_torque_without_position_are_identified_and_replayed(tmp_path: Path) -> None:
    fh.recordings.write(tmp_path / "x.csv", recording(velocity=VELOCITY, torque=TORQUE))
    assert main(["identify", str(tmp_path / "x.csv"), "--models", "coulomb", "--output", str(tmp_path / "m.yaml")]) == 0
    model = load_model_file(tmp_path / "m.yaml")
    assert model.friction.parameters["coulomb"] == pytest.approx(0.3, rel=0.03)
    assert model.friction.parameters["viscous"] == pytest.approx(0.12, rel=0.05)
    assert model.mechanics.gravity.sine == model.mechanics.gravity.cosine == 0.0
    found = replay(fh.recordings.read(tmp_path / "x.csv"), {"m": model})
    assert found.predictions[0].relative_error < 0.1
    assert any("no position: integrated from the velocity" in each for each in found.problems)
    with pytest.raises(UsageError, match="a pendulum needs a measured position"):
        identify([recording(velocity=VELOCITY, torque=TORQUE)], IdentificationSettings(gravity="pendulum"))


def test_a_position_is_integrated_over_gaps_and_holes_of_the_velocity() -> None:
    velocity = VELOCITY.copy()
    velocity[100] = np.nan
    read = with_position(recording(velocity=velocity, torque=TORQUE))
    assert np.flatnonzero(np.isnan(read.columns["position"])).tolist() == [100]
    moved = read["position"][2000] - read["position"][200]
    assert moved == pytest.approx(POSITION[2000] - POSITION[200], abs=1e-3)
    assert with_position(read) is read
    kept = np.r_[0:1000, 1500:3000]
    gapped = with_position(Recording("x.csv", "x", {"time_s": TIME[kept], "velocity": VELOCITY[kept]}))
    assert gapped["position"][1000] == gapped["position"][999]  # nobody knows how far it went


@pytest.mark.parametrize(("lowest", "held", "count"), [(0.2, {}, 1), (0.2, {"offset": 0.0}, 0), (-2.0, {}, 0)])
def test_a_motion_in_one_direction_determines_no_friction(lowest: float, held: dict[str, float], count: int) -> None:
    velocity = np.maximum(VELOCITY, lowest) if lowest > 0.0 else VELOCITY
    position = np.cumsum(velocity) * 5e-3
    torque = 0.3 * np.sign(velocity) + 0.12 * velocity
    settings = IdentificationSettings(families=("coulomb",), has_modifiers=False, held=held, gravity="none")
    result = identify([recording(position=position, velocity=velocity, torque=torque)], settings)
    found = _one_way(result, Data(result.records))
    assert len(found) == count
    assert all(each.is_fatal and "--fix offset=0" in each.text for each in found)
