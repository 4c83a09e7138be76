"""The benchmark that compares experiments in parts with whole ones."""

import json

import pytest
from click.testing import CliRunner

from friction_hil.checked_yaml.text import dump
from tools.benchmarks.experiment import command
from tools.benchmarks.tune import OWN
from tools.benchmarks.tune.axes import read_axes


@pytest.mark.deep
def test_the_benchmark_of_experiments_compares_whole_ones_with_parts(tmp_path) -> None:
    """On an axis whose gain asks for little: two parts are enough, and their model is as good."""
    [content] = read_axes((OWN,), ("dahl_csv",)).values()
    axis = content["axes"]["x"]
    axis["experiment"] = {"velocity": 3.0, "travel": 1.0, "duration_s": 45.0}
    axis["compensation"] = {"gain": 0.2, "fade_s": 0.3}
    content["period_s"] = 5e-3
    file = tmp_path / "axis.yaml"
    file.write_text(dump(content))

    done = CliRunner().invoke(command, [str(file), "--models", "coulomb", "--json"], catch_exceptions=False)

    whole, parts = json.loads(done.stdout)["rows"]
    assert (whole["is_sequential"], whole["experiment_s"], whole["unknown"]) == (False, 45.0, None)
    assert (parts["is_sequential"], parts["experiment_s"]) == (True, 30.0)
    assert 0.0 < parts["unknown"] < 0.14
    assert parts["reductions"]["own"]["rms"] > 0.95 * whole["reductions"]["own"]["rms"]
