"""Model files, alone and named in a configuration: correct ones are accepted, and mistakes are reported."""

import math
import re

import pytest

from friction_hil.checked_yaml.text import dump
from friction_hil.errors import ConfigurationError, UsageError
from friction_hil.models.files import load_model_file, model_from_argument
from tests.fake_drivers import GOOD, changed, good, install, problems_in


@pytest.fixture(scope="module", autouse=True)
def _fake_drivers(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(install(tmp_path_factory.mktemp("site")))
        yield


@pytest.fixture
def path(tmp_path):
    return tmp_path / "axis.yaml"


def naming(model):
    """A configuration whose axis has this model file."""
    lines = GOOD.splitlines()
    start, end = lines.index("    model:"), lines.index("    compensation:")
    return "\n".join([*lines[:start], f"    model: {model}", *lines[end:]])


def test_mistakes_in_a_model_file_name_that_file(tmp_path, path):
    text = naming("models/bad.yaml")
    (tmp_path / "models").mkdir()
    model = tmp_path / "models" / "bad.yaml"

    model.write_text("axis: rotary\nfriction:\n  model: coulomb\n  parameters:\n    coulomb: -1\n    viscus: 0\n")
    assert {(problem.path, problem.line, problem.field) for problem in problems_in(path, text)} == {
        (str(model), 5, "friction.parameters.coulomb"),
        (str(model), 6, "friction.parameters.viscus"),
    }
    model.write_text("axis: rotary\nfriction: [\n")
    assert {(problem.path, problem.line) for problem in problems_in(path, text)} == {(str(model), 3)}
    model.rename(tmp_path / "models" / "bed.yaml")
    [problem] = problems_in(path, text)
    line = text.splitlines().index("    model: models/bad.yaml") + 1
    assert (problem.path, problem.line, problem.field) == (str(path), line, "axes.x.model")
    assert "'models/bed.yaml'" in problem.message


def test_a_shadow_whose_file_name_is_no_name(tmp_path, path):
    (tmp_path / "My-Axis.yaml").write_text(dump(good()["axes"]["x"]["model"]))
    (problem,) = problems_in(path, dump(changed(axes__x__shadows=["My-Axis.yaml"])))
    assert "{name: ..., model: My-Axis.yaml}" in problem.message


def test_model_file(tmp_path):
    path = tmp_path / "axis.yaml"
    path.write_text("axis: linear\nfriction: {model: coulomb, parameters: {coulomb: 20.4, viscous: 203.5}}\n")
    model = load_model_file(path)
    assert (model.axis, model.mechanics.inertia, model.source_path) == ("linear", 0.0, path)
    assert model.friction_model.parameters == {"coulomb": 20.4, "static": 20.4, "viscous": 203.5}
    path.write_text("axis: linear\nfriction: {model: coulomb, parameters: {coulomb: 20.4}}\nfit: [1]\nfoo: 2\n")
    with pytest.raises(ConfigurationError) as caught:
        load_model_file(path)
    assert [(problem.line, problem.field) for problem in caught.value.problems] == [(3, "fit"), (4, "foo")]
    path.write_text("- 3\n")
    with pytest.raises(ConfigurationError, match="none of the keys"):
        load_model_file(path)


def test_model_from_argument(tmp_path):
    model = model_from_argument("lugre:sigma0=2e3, coulomb=0.08,stribeck_velocity=.2,damping_velocity=.inf")
    assert (model.axis, model.friction.model) == ("rotary", "lugre")
    assert model.friction_model.parameters["sigma0"] == 2000.0
    assert model.friction_model.parameters["damping_velocity"] == math.inf
    path = tmp_path / "file.yaml"
    path.write_text("axis: linear\nfriction: {model: coulomb, parameters: {coulomb: 1}}\n")
    assert model_from_argument(str(path)).axis == "linear"


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("lugree", "'lugre'"),
        ("missing.yaml", "cannot be read"),
        ("coulomb", "coulomb needs coulomb"),
        ("coulomb:", "coulomb needs coulomb"),
        ("coulomb:coulomb", "parameter=value"),
        ("coulomb:coulomb=1,coulomb=2", "each parameter once"),
        ("coulomb:colomb=1", "'coulomb'"),
        *((f"coulomb:coulomb={value}", "not allowed") for value in ("-1", "-1" + " " * 300, ".nan")),
        ("coulomb:coulomb=1e999", "too large"),
        *((f"coulomb:coulomb={value}", "not a number") for value in ("1:30", "[1,2]")),
        ("coulomb:coulomb=[1", "not YAML"),
        ("coulomb:coulomb=", "is empty"),
    ],
)
def test_a_wrong_argument(argument, message):
    with pytest.raises(UsageError, match=re.escape(message)):
        model_from_argument(argument)


@pytest.mark.parametrize(
    "content",
    [
        *("root:secret:0:0:root:/root:/bin/sh\n", "services: {web: {password: secret}}\n", "- secret\n", "secret\n"),
        *("key: *secret\n", "!secret {a: 1}\n", "secret: 1\nsecret: 2\n", "secret: [\n", b"\xffsecret", ""),
    ],
)
def test_a_file_that_is_no_model_is_not_shown(path, content):
    """A configuration may name any file of the machine; what is in it is not for the terminal."""
    other = path.with_name("other.yaml")
    other.write_bytes(content if isinstance(content, bytes) else content.encode())
    (problem,) = problems_in(path, naming("other.yaml"))
    assert problem.path == str(other)
    assert "secret" not in problem.message
    assert problem.message == "is empty" if content == "" else "none of the keys" in problem.message
