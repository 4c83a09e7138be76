"""The axes of ./tools/bench tune, and its figures for models that are known."""

from pathlib import Path

import pytest

from friction_hil.checked_yaml.text import dump
from friction_hil.config import load
from friction_hil.errors import UsageError
from tools.benchmarks.tune import OWN
from tools.benchmarks.tune.axes import read_axes
from tools.benchmarks.tune.judge import OTHERS, AxisResult, Rehearsals, judge_truth, judged_motions, truth
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


@pytest.mark.parametrize("by", ["velocity", "position"])
def test_the_truth_helps_by_other_inputs_than_the_torque_too(by) -> None:
    content = read_axes((OWN,), ("gms_17bit",))["gms_17bit"]
    by_torque, found = (judge_truth("gms_17bit", content, 0.9, each).true for each in ("torque", by))
    assert all(found[name].rms > 0.5 * by_torque[name].rms for name in found)
    assert found[OWN_MOTION] != by_torque[OWN_MOTION]
