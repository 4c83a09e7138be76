"""Friction models by name, and model files: the public Python interface to the models.

>>> import friction_hil as fh
>>> model = fh.models.create("coulomb", coulomb=0.1, viscous=0.01)
>>> model.steady_state([-1.0, 0.0, 2.0])
array([-0.11,  0.  ,  0.12])
"""

from friction_hil.friction import (
    NETWORK_ALONE,
    Axis,
    Family,
    FrictionModel,
    InvalidParameterError,
    Network,
    NetworkStructure,
    Runner,
    create,
    describe,
    describe_brief,
    names,
    simulate_many,
)
from friction_hil.models import library
from friction_hil.models.files import load

__all__ = [
    "NETWORK_ALONE",
    "Axis",
    "Family",
    "FrictionModel",
    "InvalidParameterError",
    "Network",
    "NetworkStructure",
    "Runner",
    "create",
    "describe",
    "describe_brief",
    "library",
    "load",
    "names",
    "simulate_many",
]
