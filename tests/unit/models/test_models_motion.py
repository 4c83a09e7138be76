"""Pictures of models along a motion: the motions themselves, what is drawn, and mistakes in a sentence."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil import models
from friction_hil.cli import main
from friction_hil.reports.model_motion import KINDS, Motion, draw_motion, make_motion
from tests.networks import alone, random_network

LUGRE = "lugre:sigma0=2000,sigma1=1,coulomb=0.08,static=0.12,stribeck_velocity=0.2"
DAHL = "dahl:sigma0=2000,coulomb=0.08"


def first(name: str = "lugre") -> dict[str, models.FrictionModel]:
    return {name: models.create(name, **models.describe(name).example)}


@given(st.sampled_from(sorted(KINDS)), st.floats(0.01, 100.0), st.integers(1, 4))
def test_a_motion_is_its_velocity_and_goes_from_rest(kind, frequency, periods) -> None:
    motion = make_motion(kind, {"frequency": frequency, "periods": float(periods)}, first())
    start = motion.position[0] - motion.velocity[0] * motion.dt
    np.testing.assert_allclose(start + np.cumsum(motion.velocity) * motion.dt, motion.position, atol=1e-9)
    assert len(motion.velocity) == 4000 * periods
    assert abs(motion.velocity[0]) <= 0.02 * np.max(np.abs(motion.velocity))


def test_small_reversals_reverse_on_the_way_and_steps_jump() -> None:
    def turns(kind: str, **given_: float) -> int:
        velocity = make_motion(kind, {"periods": 2.0, **given_}, first()).velocity
        signs = np.sign(velocity[np.abs(velocity) > 1e-9 * np.max(np.abs(velocity))])
        return int(np.count_nonzero(np.diff(signs)))

    assert turns("sine") == 3
    assert turns("reversals", small=0.3, times=8.0) > 10
    assert set(np.round(make_motion("steps", {"velocity": 0.5}, first()).velocity, 9)) == {-0.5, 0.0, 0.5}


def test_a_network_is_drawn_at_the_period_of_its_training(tmp_path) -> None:
    narx = alone(random_network("narx", period_s=2e-3))
    chosen = {**first(), "net": narx}
    motion = make_motion("sine", {"amplitude": 0.1, "periods": 1.0}, chosen)
    left = draw_motion(chosen, motion, tmp_path / "net.png", "net")
    wanted = chosen["lugre"].simulate(motion.velocity, motion.dt)
    error = narx.simulate(motion.velocity, 2e-3) - wanted
    assert left["net"] == pytest.approx(np.sqrt(np.mean(error**2) / np.mean(wanted**2)))
    assert (tmp_path / "net.png").stat().st_size > 10_000
    still = Motion(1e-3, np.zeros(10), np.zeros(10))  # where there is no friction, there is no difference to name
    assert draw_motion({**first(), **first("dahl")}, still, tmp_path / "still.png", "still") == {"dahl": 0.0}


def test_the_command_draws_models_beside_each_other(tmp_path, capsys) -> None:
    picture, log = tmp_path / "both.png", tmp_path / "log.csv"
    time = np.arange(2000) * 1e-3
    np.savetxt(log, np.column_stack([time, 1e-3 * np.sin(time)]), header="time_s,position", delimiter=",", comments="")
    assert main(["models", DAHL, "--beside", LUGRE, "--motion", str(log), "--draw", str(picture), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["picture"] == str(picture)
    assert 0.2 < found["differences"][LUGRE] < 1.0
    assert main(["models", DAHL, "--beside", "coulomb:coulomb=0.08", "--draw", str(tmp_path / "steady.svg")]) == 0
    assert (tmp_path / "steady.svg").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--motion", "sine"], "--draw"),
        (["--draw", "a.png", "--motion", "sin"], "'sine'?"),
        (["--draw", "a.png", "--motion", "sine:amplitud=1"], "'amplitude'?"),
        (["--draw", "a.png", "--motion", "sine:amplitude=0"], "amplitude is 0"),
        (["--draw", "a.png", "--motion", "sine:amplitude=x"], "KEY=NUMBER"),
        (["--draw", "a.png", "--motion", "sine:periods=1e9"], "samples of"),
        (["--draw", "gone/a.png", "--motion", "sine"], "there is no folder gone"),
    ],
)
def test_mistakes_are_reported_in_a_sentence(words, message, capsys, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["models", DAHL, *words]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
