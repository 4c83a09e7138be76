"""``tools/bench learning``: the rows, shortened, and the simulated axis that changes while it moves."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from friction_hil.compensator import Compensator
from friction_hil.learning.proposal import Step
from friction_hil.learning.record import TICK_S
from friction_hil.learning.window import RECORDED
from tests.compensation_grids import TINY, grid_of
from tools.benchmarks.learning import command, rows
from tools.benchmarks.learning.axis import Axis
from tools.benchmarks.learning.case import follow, setup

pytestmark = pytest.mark.deep  # of the tools, not of the product


@pytest.fixture
def short(tmp_path, monkeypatch):
    """Path of a tiny grid; rows take 14 s of motion."""
    monkeypatch.setattr(rows, "AFTER_S", 13.0)
    monkeypatch.setattr(rows, "SCORED_S", 1.0)
    monkeypatch.setattr(rows, "WRONG", ("off",))
    grid_of(tmp_path, TINY)
    return tmp_path / "grid.yaml"


def test_the_axis_records_what_the_learner_takes(short):
    """Missed periods leave rows out, and no others."""
    of = setup(grid_of(short.parent, TINY), "servo", "stiff", 0, "off", 8.0)
    axis = Axis(of.plant, of.drive, Compensator(of.believed, of.settings), of.sensors, of.settings.period_s, of.seed)
    cycles = round(TICK_S / of.settings.period_s)
    rest = tuple(np.zeros(cycles * axis.samples) for _ in range(3)), tuple(np.zeros(cycles) for _ in range(2))
    for missed in ((), (3, 4), ()):
        recorded, errors = axis.move(*rest, missed)
        assert recorded.keys() == set(RECORDED)
        there = np.setdiff1d(np.arange(cycles), missed) + axis.cycle - cycles
        np.testing.assert_array_equal(recorded["cycle"], there)
        assert errors.shape == (2, cycles)


def test_the_benchmark_of_learning_prints_one_json_object(short):
    words = ["--only", "off", "--most", "1", "--grid", str(short), "--json"]
    done = CliRunner().invoke(command, words, catch_exceptions=False)
    found = json.loads(done.stdout)["rows"]["off"]
    values = found["cases"][0]["values"]
    assert values["learned_rms"] > 2.0 * values["file_rms"] > 2.0
    assert found["summary"]["learned_rms worst"] == values["learned_rms"]


@pytest.mark.deep
def test_learning_is_deterministic(short):
    of = setup(grid_of(short.parent, TINY), "servo", "stiff", 0, "off", 8.0)
    runs = [follow(of, 8.0, is_learning=True) for _ in range(2)]
    assert [proposal.step for _, proposal in runs[0].hand_overs] == 2 * [Step.PARAMETERS]
    np.testing.assert_array_equal(runs[0].errors, runs[1].errors)
