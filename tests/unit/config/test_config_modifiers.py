"""Mistakes in the friction of a model file: each is reported with its line, its field and what is expected."""

import pytest

import friction_hil as fh
from friction_hil.errors import ConfigurationError

TEXT = """version: 1
axis: linear
friction:
  model: gms
  parameters:
    stiffness: [100.0, 50.0]
    weight: [0.4, 0.6]
    attraction: 1.0
    coulomb: 1.0
    static: 1.2
    stribeck_velocity: 0.1
  modifiers:
    direction:
      positive: {coulomb: 1.1}
    load: {motoring: 0.1, driven: 0.05}
    ripple:
      - {order: 7, cosine: 1.0}
      - {order: 14, sine: 0.5}
    reversal: {distance: [1e-5, 1e-3], positive: [0.1, 0.0]}
    speed: {velocity: [0.1], positive: [0.1], negative: [0.2]}
"""


def load(tmp_path, text):
    path = tmp_path / "axis.yaml"
    path.write_text(text)
    return fh.models.load(path)


def test_what_is_right_is_loaded_as_it_stands(tmp_path):
    model = load(tmp_path, TEXT)
    assert model.axis == "linear"
    assert model.parameters["weight"] == [0.4, 0.6]
    assert model.modifiers["ripple"][1] == {"order": 14.0, "cosine": 0.0, "sine": 0.5}
    assert model.modifiers["reversal"]["negative"] == [0.1, 0.0]
    assert {"direction.positive.coulomb", "reversal.negative[1]", "speed.negative[0]"} <= set(model.free)


@pytest.mark.parametrize(
    ("right", "wrong", "line", "field", "words"),
    [
        ("[0.4, 0.6]", "[0.4, 0.7]", 7, "parameters.weight", "sum to 1.1, not to 1"),
        ("[0.4, 0.6]", "[1.0]", 7, "parameters.weight", "has 1 elements"),
        ("[100.0, 50.0]", "[100.0, -50.0]", 6, "parameters.stiffness", "stiffness[1] = -50"),
        ("    attraction: 1.0\n", "", 5, "parameters.attraction", "gms needs attraction"),
        ("coulomb: 1.1", "coulom: 1.1", 14, "modifiers.direction.positive.coulom", "did you mean 'coulomb'"),
        ("coulomb: 1.1", "stiffness: [1.0, 2.0, 3.0]", 14, "modifiers.direction.positive", "weight has 2 elements"),
        ("motoring: 0.1", "motoring: much", 15, "modifiers.load.motoring", "is 'much', not a number"),
        ("order: 14", "order: -1", 18, "modifiers.ripple[1].order", "order = -1"),
        ("[1e-5, 1e-3]", "[1e-3, 1e-5]", 19, "modifiers.reversal.distance", "distance[1] = 1e-05"),
        ("[0.1, 0.0]", "[0.1]", 19, "modifiers.reversal.positive", "1 elements, but distance 2"),
        ("distance: [1e-5", "distance: [0.0", 19, "modifiers.reversal.distance", "distance[0] = 0"),
        ("velocity: [0.1], ", "", 20, "modifiers.speed.velocity", "needs velocity"),
        ("    load:", "    loads:", 15, "modifiers.loads", "did you mean 'load'"),
    ],
)
def test_a_mistake_is_reported_with_its_line(tmp_path, right, wrong, line, field, words):
    assert right in TEXT
    with pytest.raises(ConfigurationError) as caught:
        load(tmp_path, TEXT.replace(right, wrong))
    assert f"axis.yaml:{line}: friction.{field}" in str(caught.value)
    assert words in str(caught.value)
