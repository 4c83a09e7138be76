"""Preparation of a change outside the loop: keys and values are checked like a configuration, models are compiled."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from friction_hil.checked_yaml.messages import show
from friction_hil.checked_yaml.section import keys
from friction_hil.compensator import INPUTS, Compensator
from friction_hil.config import AxisConfig, from_dict
from friction_hil.config.axis import Compensation
from friction_hil.daemon.assembly import make_compensator
from friction_hil.daemon.axis import check_torque
from friction_hil.daemon.control.message import AxisChange
from friction_hil.daemon.static_torque import static_torque
from friction_hil.daemon.uncertainty import Table, uncertainty_table
from friction_hil.drive import AxisFacts
from friction_hil.errors import MOST_PRINTED, ConfigurationError, FrictionHilError, OptionError, UsageError, choices
from friction_hil.models.files import load_model_file
from friction_hil.numerics.jit import Array
from friction_hil.recordings import columns

_OF_THE_ESTIMATE = "it would begin the estimate of the velocity anew, in motion"
_NOT_LIVE = {
    "velocity": _OF_THE_ESTIMATE,
    "smoothing": _OF_THE_ESTIMATE,
    "acceleration": _OF_THE_ESTIMATE,
    "max_acceleration": _OF_THE_ESTIMATE,
    "baseline_s": "it counts from the beginning of a motion",
    "transmission": "it would move the set-point of the motor",
    "velocity_offset": "it is another way to the drive, with limits of its own",
    "learning": "its process begins with the daemon",
}
_ELSEWHERE = "change it in the configuration, and start the daemon again"


@dataclass(frozen=True, slots=True)
class Prepared:
    """A change that can be sent to the loop."""

    configuration: dict[str, Any]  # plain values of the whole configuration after the change
    axes: list[AxisChange | None]
    models: dict[str, str]  # file of the new model of each axis that gets one from a file
    # the `uncertainty_table` of each axis that gets a model with known errors
    uncertainty: dict[str, Table] = field(default_factory=dict)


def prepare(
    configuration: Mapping[str, Any],
    source: str,
    values: Mapping[str, Any],
    facts: Sequence[AxisFacts],
    rows: Mapping[str, tuple[Mapping[str, Array], Array]],
    *,
    has_network: bool,
) -> Prepared:
    """Check values and prepare what the loop needs of them.

    ``configuration``: the present one, as returned by `friction_hil.config.self_contained`; ``source``: where it came
    from, for messages. ``values``: new values by their keys, ``x.gain`` or ``x.adaptation.time_s``; ``x.model`` is the
    path of a file or its content. ``facts``: of all axes, in their order. ``rows``: latest inputs (n,) of each axis's
    compensator, and its state (m,) before the first of them: another model begins in the state in which it would be.
    ``has_network``: the loop has the code for models with a network.

    Raises `UsageError`: a key or a value is wrong, or not to be changed while the daemon runs; the message lists all
    that is wrong.
    """
    axes = {name: dict(axis) for name, axis in configuration["axes"].items()}
    now = {**configuration, "axes": axes}
    models: dict[str, str | None] = {}
    problems: list[str] = []
    changed: set[str] = set()
    switched: set[str] = set()
    for key, value in values.items():
        try:
            axis, steps = _place(key, axes)
            if steps == ["model"]:
                _check_kind(axis, value, configuration["axes"][axis]["model"]["axis"])
            _put(axes[axis], steps, value)
        except UsageError as error:
            problems.append(str(error))
            continue
        (switched if steps == ["compensation", "enabled"] else changed).add(axis)
        if steps == ["model"]:
            models[axis] = value if isinstance(value, str) else None
    if problems:
        raise UsageError("\n".join(problems))
    try:
        new = from_dict(now, source)
    except ConfigurationError as error:
        raise UsageError(
            "\n".join(_shortened(str(problem), source) for problem in error.problems[:MOST_PRINTED])
        ) from None
    changes: list[AxisChange | None] = []
    joints = () if new.arm is None else new.arm.joints
    for fact in facts:
        name, after, one = fact.name, new.axes[fact.name], None
        if name in changed | switched:
            axes[name] = after.model_dump(mode="json")  # with its model, if that was given as a file
            is_enabled = after.compensation.enabled if name in switched else None
            try:
                record, friction = None, None
                if name in changed:
                    check_torque(name, after, fact)
                    compensator = make_compensator(after, after.model, fact, new.period_s)
                    if name in models:
                        _check_model(name, after, has_network=has_network)
                        kinds = [_kind(each["axes"][name]["model"]["friction"]) for each in (configuration, now)]
                        friction = state_in(compensator, rows.get(name), name, is_alike=kinds[0] == kinds[1])
                    record = compensator.record
                if is_enabled:
                    _check_takes_torque(fact)
                one = AxisChange(is_enabled, record, friction, static_torque(after, is_of_arm=name in joints))
            except OptionError as error:
                problems.append(f"{error.axis}.{error.key}: {error.text}")
            except FrictionHilError as error:
                problems.append(str(error))
        changes.append(one)
    if problems:
        raise UsageError("\n".join(problems))
    files = {name: file for name, file in models.items() if file is not None}
    uncertainty = {name: table for name in models if (table := uncertainty_table(new.axes[name]))}
    return Prepared(now, changes, files, uncertainty)


def _place(key: str, axes: Mapping[str, Any]) -> tuple[str, list[str]]:
    """Return axis and field path of a key.

    Raises `UsageError`: there is no such key, or it is not to be changed while the daemon runs.
    """
    axis, _, rest = key.partition(".")
    if axis not in axes:
        raise UsageError(f"{key}: there is no axis {axis!r}; {choices(axis, axes)}")
    steps = rest.split(".")
    if steps[0] == "compensation":
        steps = steps[1:] or [""]
    name = steps[0]
    if name == "model" and len(steps) == 1:
        return axis, steps
    if name in _NOT_LIVE:
        raise UsageError(f"{key}: cannot be changed while the daemon runs, because {_NOT_LIVE[name]}: {_ELSEWHERE}")
    live = [each for each in keys(Compensation) if each not in _NOT_LIVE]
    if name in live:
        return axis, ["compensation", *steps]
    others = {*keys(AxisConfig), *axes[axis]}
    near = difflib.get_close_matches(name, [*live, "model"], n=1, cutoff=0.6)
    if name in others and not near:
        raise UsageError(f"{key}: cannot be changed while the daemon runs: {_ELSEWHERE}")
    raise UsageError(f"{key}: is not a key here; {choices(name, [*live, 'model'])}")


def _put(axis: dict[str, Any], steps: Sequence[str], value: Any) -> None:
    """Write a value into the plain values of an axis; a group that is not there yet is made."""
    group = axis
    for step in steps[:-1]:
        inner = group.get(step)
        if inner is not None and not isinstance(inner, dict):
            raise UsageError(f"{'.'.join(steps)}: {step} has no keys")
        group[step] = inner = dict(inner or {})
        group = inner
    group[steps[-1]] = value


def _shortened(problem: str, source: str) -> str:
    """Return a problem of the configuration under the key that was given: ``x.gain``."""
    return problem.removeprefix(f"{source}: ").replace("axes.", "", 1).replace(".compensation.", ".", 1)


def _check_kind(name: str, path: Any, kind: str) -> None:
    """Refuse the model of another kind of axis: as part of the configuration it would ask for other units first.

    Raises `UsageError`: the model is for a linear axis and this one is rotary, or the other way round; or the path is
    none.
    """
    if isinstance(path, Mapping):
        if path.get("axis") != kind:
            raise UsageError(f"{name}.model: axis: must be {kind}, as {name} is")
        return
    if not isinstance(path, str) or not path or "\0" in path:
        raise UsageError(f"{name}.model: must be the path of a model file, not {show(path)}")
    try:
        given = load_model_file(path).axis
    except FrictionHilError:
        return  # the check of the whole configuration says what is wrong with the file
    if given != kind:
        raise UsageError(f"{name}.model: is for a {given} axis, but {name} is {kind}")


def _check_takes_torque(fact: AxisFacts) -> None:
    """Refuse compensation, by a `UsageError`, where no torque gets to the drive."""
    if not fact.takes_torque:
        raise UsageError(
            f"{fact.name}.enabled: must be false, because this drive takes no torque beside the set-points of its mode "
            f"(mode cst compensates without that): {_ELSEWHERE}"
        )


def _check_model(name: str, after: AxisConfig, *, has_network: bool) -> None:
    """Refuse a model that cannot take the place of the present one, by a `UsageError` that says why."""
    if after.compensation.transmission is not None:
        raise UsageError(
            f"{name}.model: cannot be changed while the daemon runs, because compensation.transmission is on and "
            f"another backlash or stiffness would move the set-point of the motor: {_ELSEWHERE}"
        )
    if after.model.friction_model.network is not None and not has_network:
        raise UsageError(
            f"{name}.model: has a network, whose code this daemon has not loaded, because no model had one when it "
            f"started: {_ELSEWHERE}"
        )


def _kind(friction: Mapping[str, Any]) -> tuple[Any, set[str]]:
    """Return what the states of a friction model depend on."""
    return friction["model"], {name for name, value in (friction.get("modifiers") or {}).items() if value}


def state_in(
    compensator: Compensator, latest: tuple[Mapping[str, Array], Array] | None, name: str, *, is_alike: bool
) -> Array:
    """Return the state in which a model would be after the latest cycles.

    At rest these say nothing of the bristles, which have been bent since the last motion: a model of the same family
    begins with the present state.

    ``compensator`` has the model, and is changed. ``latest``: inputs (n,) of the cycles by name, and the state of the
    present compensator before the first of them. ``name``: of the axis, for messages. ``is_alike``: the present model
    is of the same family, with the same modifiers. Raises `UsageError`: the torque of the model is not finite there.
    """
    initial = compensator.friction_state
    if latest is not None:
        inputs, state = latest
        compensator.state[:] = state[: compensator.state.size]
        compensator.adopt(compensator.record, compensator.friction_state if is_alike else initial)
        for values in zip(*(inputs[each].tolist() for each in INPUTS), strict=True):
            compensator.step(*values)
            if compensator.is_faulty:
                raise UsageError(f"{name}.model: gives a torque that is not finite in the present motion")
    return compensator.friction_state


def entry_of(number: int, prepared: Prepared, models_of: Mapping[str, int], text: str) -> dict[str, Any]:
    """Return what the journal and the recording keep of a change.

    ``models_of``: number of the change that brought the present model of each axis; 0: the configuration of the run.
    ``text``: who changed what.
    """
    axes: dict[str, Any] = {}
    for (name, axis), change in zip(prepared.configuration["axes"].items(), prepared.axes, strict=True):
        is_adopted = change is not None and change.record is not None
        axes[name] = {"compensation": axis["compensation"], "is_adopted": is_adopted, "model_of": models_of[name]}
        if change is not None and change.friction is not None:
            axes[name] |= {"model_of": number, "model": axis["model"], "friction": _trimmed(change.friction)}
            if name in prepared.uncertainty:
                axes[name]["uncertainty"] = prepared.uncertainty[name]
    return {"number": number, "text": text, "axes": axes}


def _trimmed(values: Array) -> list[float]:
    """Return the values up to the last that is not zero."""
    used = values.nonzero()[0]
    found: list[float] = values[: used[-1] + 1 if used.size else 0].tolist()
    return found


def latest_inputs(
    row: Array, names: Sequence[str], state_width: int, axis: int
) -> tuple[dict[str, Array], Array] | None:
    """Return inputs of an axis's compensator from rows (n, width) of the ring, and its state before the first."""
    if not len(row):
        return None
    width = len(names) + state_width
    part = row[:, axis * width : (axis + 1) * width]
    inputs = {name: part[:, names.index(name)] for name in INPUTS}
    state = part[0, len(names) :]
    is_whole = np.isfinite(inputs[columns.CYCLE]).all() and np.isfinite(state[0])  # not of an axis that is broken
    return (inputs, state) if is_whole else None
