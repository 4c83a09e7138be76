"""A scaled model has a multiple of the torque, for any motion."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.friction.scaling import scaled_friction
from tests.friction_models import models, motions


def scaled(model: fh.models.FrictionModel, factor: float) -> fh.models.FrictionModel:
    parameters, modifiers = scaled_friction(model.name, model.parameters, model.modifiers, factor)
    return fh.models.create(model.name, modifiers=modifiers, **parameters)


@given(data=st.data(), factor=st.floats(0.2, 5.0))
def test_the_torque_of_a_scaled_model_is_a_multiple(data: Any, factor: float) -> None:
    # one family of each kind of parameters: plain, lists of elements, points, power of the velocity
    model = data.draw(models(("lugre", "gms", "table", "power_law")))
    motion = data.draw(motions(model))
    torques = {name for name in motion.inputs if name in ("load_torque", "applied_torque")}
    inputs = {name: values * (factor if name in torques else 1.0) for name, values in motion.inputs.items()}
    plain = motion.simulate(model)
    multiple = scaled(model, factor).simulate(motion.velocity, motion.dt, **inputs)
    np.testing.assert_allclose(multiple, factor * plain, rtol=1e-7, atol=1e-9 * factor * max(np.abs(plain).max(), 1.0))


@pytest.mark.parametrize("name", fh.models.names())
def test_scaling_there_and_back_gives_the_parameters_of_each_family(name: str) -> None:
    example = dict(fh.models.describe(name).example)
    there, _ = scaled_friction(name, example, {}, 4.0)
    back, _ = scaled_friction(name, there, {}, 0.25)
    assert there != example
    assert back == example
