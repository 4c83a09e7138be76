"""What a hand finds of a simulated joint: break-away, work, drift, passivity, with laws in use and `fh.Compensator`."""

import functools
import json
import re
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from friction_hil import recordings
from friction_hil.config.examples import examples
from friction_hil.replay.verify import verify
from tools.benchmarks import guiding

PAGE = (Path(guiding.__file__).parents[2] / "friction_hil/own_loop/guiding.md").read_text(encoding="utf-8")
FINE, COARSE = guiding.FEEDBACKS  # the second with a velocity of 12 bits
LEFT = 1.0 - guiding.GAIN  # of the friction, where the compensation is perfect
measure = functools.cache(guiding.measure)
everywhere = pytest.mark.parametrize(
    ("feedback", "period_s"),
    [
        (FINE, 1e-3),
        (COARSE, 4e-3),
        pytest.param(FINE, 4e-3, marks=pytest.mark.deep),
        pytest.param(COARSE, 1e-3, marks=pytest.mark.deep),
    ],
)


def bare():
    """A joint without compensation, whose feedback does not matter."""
    return measure("none", FINE, 4e-3)


def steps_of(feedback):
    """Resolution of a position, rad."""
    return guiding.FEEDBACKS[feedback].resolution


def test_the_joint_has_its_friction_and_holds_an_error_of_gravity():
    one = bare()
    assert one.break_away == pytest.approx(guiding.PARAMETERS["static"], rel=0.05)
    assert one.work == pytest.approx(0.6 * guiding.PARAMETERS["coulomb"], rel=0.2)  # of the way to and fro
    assert (one.drift < 1e-9, one.pushing == 0.0, one.travel < 3e-3) == (True, True, True)


@everywhere
def test_with_the_compensator_the_hand_has_less_to_do_and_the_joint_rests(feedback, period_s):
    one = measure("fh.Compensator", feedback, period_s)
    assert one.break_away < 0.85 * bare().break_away
    assert one.turn < 1.02 * bare().turn
    assert LEFT < one.work / bare().work < 0.2
    assert one.drift < 0.1 * steps_of(feedback)
    assert one.pushing < 1e-6


def test_with_what_is_used_today_the_joint_drifts_or_sticks():
    for law in ("c*sign(dq)", "c*tanh(k*dq)"):
        fine, coarse = measure(law, FINE, 1e-3), measure(law, COARSE, 4e-3)
        assert fine.break_away < 0.5 * bare().break_away
        assert fine.drift > 100.0 * steps_of(FINE)
        assert fine.pushing > 1e-3
        assert coarse.break_away > bare().break_away
    assert measure("c*sign(dq)", COARSE, 4e-3).break_away > 1.5 * bare().break_away


def test_a_filter_takes_the_steps_of_a_coarse_position_away():
    plain, filtered = (measure(law, COARSE, 1e-3) for law in ("fh.Compensator", "smoothing: 0.2"))
    assert filtered.step < 0.3 * plain.step
    assert filtered.work < 0.2 * bare().work


def test_a_coarse_velocity_that_is_believed_holds_a_joint_but_does_not_move_it():
    one = measure("velocity: drive", COARSE, 4e-3)
    assert one.break_away > bare().break_away  # the page says: leave that
    assert one.work < 0.2 * bare().work
    assert one.drift < 0.1 * steps_of(COARSE)
    assert one.pushing < 1e-6


@pytest.mark.parametrize(("feedback", "period_s"), [(FINE, 1e-3), (COARSE, 1e-3), (COARSE, 4e-3)])
@pytest.mark.parametrize(("amplitude", "frequency_hz"), [(0.003, 1.0), (0.01, 2.0), (0.1, 2.0)])
def test_no_cycle_of_a_hand_gains_energy(feedback, period_s, amplitude, frequency_hz):
    """And none costs it more than without compensation, but for turns that a coarse position shows some steps late."""
    kind, lead = guiding.FEEDBACKS[feedback], guiding.swing(amplitude, frequency_hz)
    works = []
    for law in ("fh.Compensator", "none"):
        run = guiding.guide(guiding.make_law(law, kind, period_s), kind, period_s, lead, 2.0)
        works.append(run.work(run.hand, 1.0))
    compensated, without = works
    assert 0.0 < compensated <= without + 6.0 * kind.resolution * guiding.PARAMETERS["coulomb"]


def test_a_joint_that_is_let_go_holds_what_the_compensation_leaves_of_its_friction():
    """The page's rule: (1 - gain) times the Coulomb friction above the error of gravity."""
    coulomb, error = guiding.PARAMETERS["coulomb"], guiding.GRAVITY_ERROR
    assert (1.0 - 0.9) * coulomb < error < (1.0 - 0.7) * coulomb
    assert measure("fh.Compensator", COARSE, 4e-3).travel > 1.0
    assert measure("fh.Compensator", COARSE, 4e-3, 0.7).travel < 0.03


def test_the_benchmark_of_guiding_prints_every_law(monkeypatch):
    """The command ./tools/bench guiding --gain."""
    monkeypatch.setattr(guiding, "PERIODS_S", (4e-3,))
    monkeypatch.setattr(guiding, "FEEDBACKS", {COARSE: guiding.FEEDBACKS[COARSE]})
    monkeypatch.setattr(guiding, "measure", lambda law, feedback, period_s, gain: measure("none", FINE, 4e-3))
    shown = CliRunner().invoke(guiding.command, ["--gain", "0.7"], catch_exceptions=False).stdout
    assert shown.count("none") == len(guiding.LAWS)
    given = json.loads(CliRunner().invoke(guiding.command, ["--json"], catch_exceptions=False).stdout)
    assert len(given["rows"]) == len(guiding.LAWS)


def test_the_program_of_the_page_takes_work_from_the_hand_and_its_recording_verifies(tmp_path, monkeypatch, capsys):
    shutil.copy(examples()["own_loop"], tmp_path / "own_loop.yaml")
    monkeypatch.chdir(tmp_path)
    program = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)[-1]
    exec(compile(program, "guiding.md", "exec"), {})
    (without, before), (compensated, after) = (
        map(float, each.split(",")) for each in re.findall(r"\(([^)]*)\)", capsys.readouterr().out)
    )
    assert compensated < 0.2 * without
    assert (before, after) == (0.0, 0.0)
    recording = recordings.read(tmp_path / "guided.mcap")
    assert abs(recording["compensation"]).max() > 0.3
    assert verify(recording).is_verified
