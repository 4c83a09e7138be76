"""The axes of ./tools/bench tune, and its figures for models that are known."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from friction_hil.checked_yaml.text import dump
from friction_hil.config import load
from friction_hil.errors import UsageError
from tools.benchmarks.tune import OWN, command
from tools.benchmarks.tune.axes import read_axes
from tools.benchmarks.tune.judge import OTHERS, AxisResult, Rehearsals, judged_motions, truth
from tools.benchmarks.tune.judge import OWN as OWN_MOTION
from tools.benchmarks.tune.report import summary

pytestmark = pytest.mark.deep  # of the tools, not of the product


def test_every_axis_of_the_benchmark_is_a_configuration_that_tune_takes(tmp_path) -> None:
    with pytest.raises(UsageError, match="'nothing'"):
        read_axes((OWN,), ("nothing",))
    for name, content in read_axes((OWN,)).items():
        file = tmp_path / f"{name}.yaml"
        file.write_text(dump(content))
        axis = load(file, needs_models=False).axes["x"]
        assert axis.experiment is not None
        assert set(judged_motions(axis)) == {OWN_MOTION, *OTHERS}
        assert truth(axis).friction_model.level > 0.0


def test_the_truth_itself_has_a_ratio_of_one_and_no_model_one_of_zero(tmp_path) -> None:
    file = Path(tmp_path) / "axis.yaml"
    file.write_text(dump(read_axes((OWN,), ("gms_17bit",))["gms_17bit"]))
    configuration = load(file, needs_models=False)
    axis = configuration.axes["x"]
    rehearsals = Rehearsals(axis, configuration.period_s, (OWN_MOTION, "small"))
    true = rehearsals.reductions(truth(axis))
    known = AxisResult("known", true, true, "gms", "", 1.0, 1.0)
    missing = AxisResult("missing", true, {}, "", "refused", 1.0, 0.0)
    found = summary([known, missing], (OWN_MOTION, "small"))
    assert known.ratio(OWN_MOTION) == (1.0, 1.0)
    assert true[OWN_MOTION].rms > 3.0
    assert (found["axes"], found["without_model"], found["enough_of_truth"]) == (2, 1, 1)
    assert (found["runs"], found["worse_than_none"], found["gain_cut"]) == (2, 0, 0)


def test_the_truth_helps_by_other_inputs_than_the_torque_too() -> None:
    found = {}
    for by in ("torque", "velocity", "position"):
        shown = CliRunner().invoke(command, ["--truth", "0.9", "--by", by, "--only", "gms_17bit", "--json"])
        [axis] = json.loads(shown.stdout)["axes"]
        found[by] = {name: each["rms"] for name, each in axis["true"].items()}
    for by in ("velocity", "position"):
        assert all(found[by][name] > 0.5 * found["torque"][name] for name in found[by])
        assert found[by][OWN_MOTION] != found["torque"][OWN_MOTION]
