"""Joints of an arm: what their experiments show of weight and inertia, beside what the arm's file has. Pure.

While one joint moves and the others are held it is a pendulum, so that it is tuned as any axis. In the trial the arm of
the configuration has the weight, which the model must not have again.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil.compensator.load import gravity_torque
from friction_hil.config import Configuration
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import OptionError
from friction_hil.friction.modifiers import SIDES
from friction_hil.identification import Fit
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import FORCE_UNITS
from friction_hil.recordings import Recording
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.model_files import inertia_problem

_POSITIONS = 33  # of the moved joint, over what it has moved


@dataclass(slots=True)
class JointCheck:
    """Weight and inertia of a joint by its experiment and by the arm's file, with the others where they were held."""

    position: float  # where one of the weights is largest, rad or m; the least one if they are the same everywhere
    # identified, with the offset, N m or N; None: what the directions differ by may be weight
    weight: float | None
    weight_of_file: float
    inertia: float | None  # identified, of links and rotor, kg m^2 or kg; None: not determined
    inertia_of_file: float
    is_apart: bool  # the experiment tells the weight from what is the same at all positions, or there is none
    text: str = ""
    contradictions: tuple[str, ...] = ()


def refuse_torque_loops(configuration: Configuration) -> None:
    """Refuse joints of an arm in cst: in the experiment nothing but their controller would carry the weight."""
    for name in () if configuration.arm is None else configuration.arm.joints:
        if configuration.axes[name].mode == "cst":
            raise OptionError(
                name,
                "mode",
                "is cst, and an experiment is made without the torque of arm, so that the joint would sag: tune it in "
                "csp or csv, or record the arm with 'run', and find the friction of all joints with 'friction-hil "
                "identify RUN.mcap --joints all --urdf FILE'",
            )


def check_joint(
    configuration: Configuration, recorded: Mapping[str, Recording], model: Mapping[str, Any], fit: Fit, name: str
) -> JointCheck:
    """Compare what an experiment shows of a joint with the file of the arm.

    ``recorded``: all axes in that run. ``model``: file of the fit as plain values, with its weight.
    """
    arm = configuration.arm
    assert arm is not None
    joint = list(arm.joints).index(name)
    poses = np.tile([_where(recorded[each]) for each in arm.joints], (_POSITIONS, 1))
    own = _moving(recorded[name])
    poses[:, joint] = positions = np.linspace(np.min(own), np.max(own), _POSITIONS)
    mechanics, unit = model["mechanics"], FORCE_UNITS[model["axis"]]
    gravity = mechanics["gravity"]
    found: Array = mechanics["offset"] + gravity_torque(
        gravity["constant"], gravity["sine"], gravity["cosine"], positions
    )
    stated: Array = arm.dynamics.gravity(poses)[:, joint]
    swings = bool(gravity["sine"] or gravity["cosine"])
    if not swings:  # too short a way to show how it changes
        stated = np.full(_POSITIONS, np.mean(stated))
    inertia = None if inertia_problem(fit) else float(mechanics["inertia"])
    stated_inertia = float(np.mean(arm.dynamics.inertia_matrix(poses)[:, joint, joint]))
    largest = int(np.argmax(np.maximum(np.abs(found), np.abs(stated))))
    level, errors = _level(model), fit.inference.standard_errors
    is_light = bool(np.max(np.abs(stated)) <= th.ARM_LIGHT * level)
    doubt = max(errors.get(name, math.inf) for name in ("gravity.sine", "gravity.cosine"))
    check = JointCheck(
        float(positions[largest]),
        float(found[largest]) if swings or "direction" not in model["friction"].get("modifiers", {}) else None,
        float(stated[largest]),
        inertia,
        stated_inertia,
        is_light or (swings and doubt <= th.ARM_DOUBT * level),
    )
    file, wrong = arm.file.name, []
    check.text = f"weight {_said(check.weight)} {unit} identified, {check.weight_of_file:.3g} {unit} by {file}"
    least = max(th.ARM_OFF * max(abs(found[largest]), abs(stated[largest])), th.ARM_NOTED * level)
    if check.weight is not None and np.max(np.abs(found - stated)) > least:
        wrong.append(
            f"{check.text}: look at arm.payload, arm.signs, the order of arm.joints, arm.gravity and at the file "
            "itself; its torque is fed forward"
        )
    both = f"inertia {_said(inertia)} identified, {stated_inertia:.3g} by {file}"
    check.text += f"; {both}"
    if inertia is not None and abs(inertia - stated_inertia) > th.ARM_OFF * max(inertia, stated_inertia):
        wrong.append(f"{both}: look at arm.rotor_inertia, arm.gear, arm.payload and at the file itself")
    check.contradictions = tuple(wrong)
    return check


def without_weight(model: dict[str, Any], fit: Fit, check: JointCheck) -> dict[str, Any]:
    """Return a model file without the weight, which the arm has.

    Where the experiment does not tell the two apart, what may be weight goes too: the offset, and what the levels of
    the two directions differ by.
    """
    mechanics, friction, flags = model["mechanics"], model["friction"], list(model["fit"]["flags"])
    offset, error = mechanics["offset"], fit.inference.standard_errors.get("offset", 0.0)
    if offset and not (check.is_apart and th.ARM_SURE * error < abs(offset) <= _level(model)):
        flags.append(f"an offset of {offset:.3g} is not told from the weight, which arm has: 0 is written")
        offset = 0.0
    modifiers = dict(friction.get("modifiers", {}))
    if "direction" in modifiers and not check.is_apart:
        positive, negative = (friction["parameters"] | modifiers["direction"].get(side, {}) for side in SIDES)
        parameters = {name: 0.5 * (value + negative[name]) for name, value in positive.items()}
        del modifiers["direction"]
        friction = {**friction, "parameters": parameters, "modifiers": modifiers}
        flags.append("levels of the two directions are not told from the weight, which arm has: their mean is written")
    return {
        **model,
        "friction": friction,
        "mechanics": {**mechanics, "offset": offset, "gravity": dict.fromkeys(mechanics["gravity"], 0.0)},
        "fit": {**model["fit"], "flags": flags},
    }


def _level(model: Mapping[str, Any]) -> float:
    return ModelFile.model_validate(dict(model)).friction_model.level


def _said(value: float | None) -> str:
    return "not" if value is None else f"{value:.3g}"


def _where(recording: Recording) -> float:
    """Return where an axis was held, rad or m."""
    return float(np.median(_moving(recording)))


def _moving(recording: Recording) -> Array:
    position: Array = recording["position"][recording["state"] == LoopState.RUNNING]
    known: Array = position[np.isfinite(position)]
    return known if known.size else np.array([math.nan])
