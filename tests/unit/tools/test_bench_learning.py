"""``tools/bench learning``: the rows, shortened, and the simulated axis that changes while it moves."""

import json

import pytest
from click.testing import CliRunner

from tests.compensation_grids import TINY, grid_of
from tools.benchmarks.learning import command, rows

pytestmark = pytest.mark.deep  # of the tools, not of the product


@pytest.fixture
def short(tmp_path, monkeypatch):
    """Path of a tiny grid; rows take 14 s of motion."""
    monkeypatch.setattr(rows, "AFTER_S", 13.0)
    monkeypatch.setattr(rows, "SCORED_S", 1.0)
    monkeypatch.setattr(rows, "WRONG", ("off",))
    grid_of(tmp_path, TINY)
    return tmp_path / "grid.yaml"


def test_the_benchmark_of_learning_prints_one_json_object(short):
    words = ["--only", "off", "--most", "1", "--grid", str(short), "--json"]
    done = CliRunner().invoke(command, words, catch_exceptions=False)
    found = json.loads(done.stdout)["rows"]["off"]
    values = found["cases"][0]["values"]
    assert values["learned_rms"] > 2.0 * values["file_rms"] > 2.0
    assert found["summary"]["learned_rms worst"] == values["learned_rms"]
