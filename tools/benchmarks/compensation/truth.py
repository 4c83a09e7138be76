"""The model file of a simulated servo: what a compensator would know that knows everything about it."""

from typing import Any

from friction_hil import models
from friction_hil.config.simulation import Mechanism, UrdfArm
from friction_hil.errors import UsageError
from friction_hil.models import FrictionModel
from friction_hil.models.model_file import Gravity, ModelFile
from friction_hil.servo.config import ServoConfig, TrueFriction
from friction_hil.servo.mechanisms import Gantry
from tools.benchmarks.compensation.belief import converted

_ADDED = ("coulomb", "static", "viscous", "sigma2")
_PRESLIDING = "sigma0"
_NONE: dict[str, Any] = {"model": "dahl", "parameters": {"sigma0": 1e-9, "coulomb": 1e-12}}


def true_friction(servo: ServoConfig) -> FrictionModel | None:
    """Return the friction of a servo as one model at the motor, with the losses of the gear and its cogging as ripple.

    Friction at the load adds to it: levels and viscous friction. The motor feels the bristles of the load in series
    with the coupling. Two bristles that slip after different travels are no single bristle; the one that takes their
    place saves as much work in a slow reversal as both, 2 level^2 / stiffness. None if it is no single model.
    """
    own, load = _with_cogging(servo), servo.mechanics.load
    other = servo.load_friction_model
    if other is None or load is None:
        return own
    if "direction" in own.modifiers or other.modifiers:
        return None
    try:
        there = converted(other, own.name).parameters
    except UsageError:
        return None
    parameters = dict(own.parameters)
    for name in _ADDED:
        if name in parameters:
            parameters[name] += there.get(name, 0.0)
    if _PRESLIDING in parameters:
        # a static map has no bristles: its friction is felt as the coupling is wound up
        give = 1.0 / load.stiffness + (1.0 / other.presliding_stiffness if other.presliding_stiffness > 0.0 else 0.0)
        saved = own.level**2 / own.parameters[_PRESLIDING] + other.level**2 * give
        parameters[_PRESLIDING] = (own.level + other.level) ** 2 / saved
    return models.create(own.name, modifiers=own.modifiers, axis=own.axis, **parameters)


def _with_cogging(servo: ServoConfig) -> FrictionModel:
    """Return the friction at the motor; cogging drives where a ripple of friction brakes."""
    own = servo.friction_model
    cogging = [{"order": h.order, "cosine": -h.cosine, "sine": -h.sine} for h in servo.motor.cogging]
    if not cogging:
        return own
    modifiers = {**own.modifiers, "ripple": [*own.modifiers.get("ripple", []), *cogging]}
    return models.create(own.name, modifiers=modifiers, axis=own.axis, **own.given)


def without_torques(servo: ServoConfig) -> ServoConfig:
    """Return a servo without the torques that move it off its demand, known or not: only the lag of its drive is left.

    These are friction, losses of the gear, weight, spring, cogging, ripple and external torque.
    """
    none = TrueFriction(**_NONE)
    mechanics = servo.mechanics.model_copy(
        update={"load_torque": 0.0, "gravity": None, "spring": None, "external": None}
    )
    if mechanics.load is not None:
        update = {"load": mechanics.load.model_copy(update={"friction": None})}
        mechanics = mechanics.model_copy(update=update)
    return servo.model_copy(
        update={
            "mechanics": mechanics,
            "friction": none,
            "gear": servo.gear.model_copy(update={"forward_efficiency": 1.0, "backward_efficiency": 1.0}),
            "motor": servo.motor.model_copy(update={"cogging": (), "torque_ripple": ()}),
        }
    )


def without_gravity(model: ModelFile) -> ModelFile:
    """Return a model file that feeds neither gravity nor an offset forward, for `without_torques`."""
    mechanics = model.mechanics.model_copy(update={"gravity": Gravity(), "offset": 0.0})
    return model.model_copy(update={"mechanics": mechanics})


def without_forces(mechanism: Mechanism) -> Mechanism:
    """Return a mechanism without weight and without force at its tool; its inertia and its springs stay."""
    if isinstance(mechanism, Gantry):
        return mechanism
    none = (0.0, 0.0, 0.0) if isinstance(mechanism, UrdfArm) else 0.0
    return mechanism.model_copy(update={"gravity": none, "tool_force": ()})


def model_file(
    servo: ServoConfig,
    friction: FrictionModel,
    inertia_error: float = 0.0,
    *,
    share: float = 0.0,
    swing: float = 0.0,
) -> ModelFile:
    """Return a model file with a friction, and with the mechanics of a servo but for an error of the inertia.

    Parameters
    ----------
    servo : ServoConfig
    friction : FrictionModel
    inertia_error : float
        Relative.
    share, swing : float
        Of a mechanism that the servo moves with another one: inertia, and torque of gravity per sine of the position.
    """
    mechanics, load, level = servo.mechanics, servo.mechanics.load, servo.load_friction_model
    gravity = mechanics.gravity
    factor = 1.0 + inertia_error
    behind: dict[str, float] | None = None
    if share > 0.0:
        behind = {"inertia": factor * share}
    if load is not None:
        behind = {
            "inertia": factor * load.inertia,
            "stiffness": load.stiffness,
            "damping": load.damping,
            "friction": 0.0 if level is None else level.level,
        }
    return ModelFile.model_validate(
        {
            "version": 1,
            "axis": mechanics.axis,
            "friction": {"model": friction.name, "parameters": friction.given, "modifiers": friction.modifiers},
            "mechanics": {
                "inertia": factor * (mechanics.total_inertia + share),
                "gravity": {
                    "constant": mechanics.load_torque,
                    "sine": swing + (0.0 if gravity is None else gravity.sine),
                    "cosine": 0.0 if gravity is None else gravity.cosine,
                },
                "torque_lag_s": servo.motor.torque_lag_s,
                "backlash": 0.0 if load is None else load.backlash,
                "encoder": "motor" if servo.encoder.at == "motor" else "load",
                "load": behind,
            },
        }
    )
