"""`identify_joints`: friction of all joints of a log, with or without the arm's own dynamics."""

import math
import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from friction_hil.api.arguments import Progress, read, require_recording, shown_by
from friction_hil.api.identification import Identified, identified_axis, settings_of
from friction_hil.checked_yaml.output import check_writable
from friction_hil.config.new_own_loop import LoggedJoint, own_loop_configuration
from friction_hil.dynamics import Arm, load
from friction_hil.errors import FrictionHilError, UsageError, choices
from friction_hil.friction import describe
from friction_hil.identification import Identification, IdentificationSettings, structures
from friction_hil.identification import thresholds as th
from friction_hil.identification.arm_fit import ArmFit, JointFriction, as_axes, identify_arm
from friction_hil.numerics.json_values import to_json
from friction_hil.recordings import Recording
from friction_hil.recordings.given import Given, kind_of
from friction_hil.recordings.segments import with_position
from friction_hil.tuning.settings import ShowStep

_SOURCE = re.compile(r"\s*[*/]|:u?int\d+")  # what follows the name of a column in a source

Log = dict[str, Recording]  # of each joint, by name


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class IdentifiedJoints:
    """Result of `identify_joints`.

    Attributes
    ----------
    joints : dict of str to Identified
        Result of each joint, by its name in the log.
    failures : dict of str
        Why there is none of the others.
    names : tuple of str
        All of them, in the order of the log.
    fit : ArmFit or None
        Friction of the joints and the refitted arm, ``fit.arm``, with standard errors; None without an arm.
    """

    joints: Mapping[str, Identified]
    failures: Mapping[str, str]
    names: tuple[str, ...]
    fit: ArmFit | None = None

    @property
    def is_usable(self) -> bool:
        """True if each joint has a model."""
        return not self.failures and all(each.is_usable for each in self.joints.values())

    def save(self, path: str | Path, *, config: str | Path | None = None) -> dict[str, Path]:
        """Write the model file of each joint that has one, as ``--output`` does.

        Parameters
        ----------
        path : path
            Name with the suffix .yaml; that of the joint is put in, ``friction.yaml`` becomes ``friction_elbow.yaml``.
        config : path, optional
            Also write a configuration of all joints for `Compensator`, as ``--config`` does: its limits are 1.5 times
            the largest friction and speed of the log.

        Returns
        -------
        dict of str to path
            The files by joint.

        Raises
        ------
        UsageError
            The suffix is wrong, a file cannot be written, or a joint of the configuration has no model.
        """
        if config is not None:
            check_configuration_path(Path(config))
            if not self.is_usable:
                lacking = [name for name, each in self.joints.items() if not each.is_usable] + list(self.failures)
                raise UsageError(f"{config} would be of all joints, and there is no model of {', '.join(lacking)}")
        files = {name: of_joint(Path(path), name) for name, each in self.joints.items() if each.is_usable}
        for name, file in files.items():
            self.joints[name].save(file)
        if config is not None:
            Path(config).write_text(self._configuration(files, Path(config).parent), encoding="utf-8")
        return files

    def _configuration(self, files: Mapping[str, Path], folder: Path) -> str:
        joints: dict[str, LoggedJoint] = {}
        for number, (name, file) in enumerate(files.items()):
            each, known = self.joints[name], None if self.fit is None else self.fit.joints[number]
            assert isinstance(each.found, Identification)
            records, model = each.found.records, each.model
            gravity = model.mechanics.gravity
            own_load = abs(gravity.constant) + math.hypot(gravity.sine, gravity.cosine)
            steps = [record.resolution for record in records if record.resolution is not None]
            joints[_axis_name(name if known is None else known.name, joints)] = LoggedJoint(
                model=Path(os.path.relpath(file, folder)),
                is_linear=model.axis == "linear",
                friction=model.friction_model,
                resolution=max(steps, default=None),
                speed=max(float(np.max(np.abs(record.velocity))) for record in records),
                load=own_load if known is None else known.load_range[1],
            )
        return own_loop_configuration(joints)

    def to_dict(self) -> dict[str, Any]:
        """Return what the command prints with ``--json``.

        Returns
        -------
        dict
            Values that JSON can hold: NaN and infinity are None.
        """
        joints: dict[str, Any] = {name: dict(each.facts) for name, each in self.joints.items()}
        joints |= {name: {"is_usable": False, "reason": reason} for name, reason in self.failures.items()}
        found: dict[str, Any] = to_json(
            {"joints": joints} if self.fit is None else {"arm": _facts(self.fit), "joints": joints}
        )
        return found

    def __repr__(self) -> str:
        """Return the model of each joint."""
        labels = ", ".join(f"{name}: {each.label}" for name, each in self.joints.items())
        return f"IdentifiedJoints({labels}; {len(self.failures)} failures)"


def identify_joints(
    recording: Given,
    joints: str,
    *,
    torque: str | None = None,
    velocity: str | None = None,
    arm: Arm | str | Path | None = None,
    arm_joints: Sequence[str] | None = None,
    signs: Sequence[float] | None = None,
    models: str | Sequence[str] = "all",
    validate: Given = (),
    linear: bool = False,
    gravity: Literal["auto", "none", "constant", "pendulum"] = "auto",
    min_speed: float = 0.0,
    group_by: str | None = None,
    torque_is: Literal["auto", "mean", "instant"] = "auto",
    refine: bool | None = None,
    column: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    rate: float | None = None,
    where: str | None = None,
    lowpass: float | None = None,
    decimate: int | None = None,
    loss: Literal["squares", "huber"] = "squares",
    seed: int = 0,
    progress: Progress | None = None,
) -> IdentifiedJoints:
    """Identify all joints of a log; with a model of the arm, friction is told from the arm's own dynamics.

    ``friction-hil identify --joints`` does the same. The arguments that are not named here are those of `identify`.

    Parameters
    ----------
    recording : path, dict of arrays, data frame, or a list of these
        Logs of all joints.
    joints : str
        Position columns by a pattern, ``q{}`` or ``state[:,{}]``, or their names, ``q1,q2``; without ``torque`` axes of
        the file by name, or ``all``.
    torque, velocity : str, optional
        Torque and velocity columns, by a pattern or one for each joint, with factors: ``tau1*-1,tau2``.
    arm : Arm or path, optional
        The arm, or its URDF or MJCF.
    arm_joints : sequence of str, optional
        Joints of that file in the order of the log; by default those of the same names, or all.
    signs : sequence of float, optional
        1 or -1 for each joint: -1 where the log counts against the file.
    models, validate, linear, gravity, min_speed, group_by, torque_is, refine
        See `identify`. With an arm, static families by default, and neither ``gravity`` nor ``refine`` or ``linear``.
    column, scale, rate, where, lowpass, decimate, loss, seed, progress
        See `identify`.

    Returns
    -------
    IdentifiedJoints

    Raises
    ------
    RecordingError
        A log cannot be read, lacks a column or is too short, or no joint moves.
    UsageError
        An argument is wrong, or arm and log do not go together.

    Examples
    --------
    >>> import numpy as np
    >>> import friction_hil as fh
    >>> t = np.arange(3000) * 0.004
    >>> v = np.cos(np.outer(t, [5.0, 7.0])) + 0.4 * np.cos(np.outer(t, [13.0, 11.0]) + 1.0)
    >>> torque = [0.3, 0.1] * np.sign(v) + 0.02 * np.gradient(v, t, axis=0)
    >>> log = {"time_s": t, "q": np.cumsum(v, axis=0) * 0.004, "tau": torque}
    >>> found = fh.identify_joints(log, "q[:,{}]", torque="tau[:,{}]", models="coulomb", gravity="none", refine=False)
    >>> [round(each.model.friction.parameters["coulomb"], 1) for each in found.joints.values()]
    [0.3, 0.1]
    """
    reading = {"column": column, "scale": scale, "rate": rate, "where": where}
    require_recording(recording)
    settings = settings_of(models, gravity, min_speed, group_by, torque_is, refine, lowpass, decimate, loss, seed)
    if arm is None and (arm_joints is not None or signs is not None):
        raise UsageError("--urdf-joints and --signs need --urdf")
    if arm is not None and (gravity, refine, linear) != ("auto", None, False):
        raise UsageError("--gravity, --refine and --linear are not for an arm, whose file says it: not with --urdf")
    patterns = {"position": joints, "torque": torque, "velocity": velocity}
    show = shown_by(progress)
    logs = _logs(recording, patterns, reading)
    apart = [] if isinstance(validate, Sequence) and not len(validate) else _logs(validate, patterns, reading)
    if any(list(each) != list(logs[0]) for each in (*logs, *apart)):
        raise UsageError("the logs do not have the same joints")
    if arm is None:
        kind = kind_of((each for log in (*logs, *apart) for each in log.values()), is_linear=linear)
        return _as_own_axes(logs, apart, replace(settings, axis=kind), show)
    dynamics = arm if isinstance(arm, Arm) else _loaded(arm, arm_joints, signs, list(logs[0]))
    show("the arm's own dynamics")
    together = [list(log.values()) for log in logs]
    fit = identify_arm(together, dynamics, lowpass_hz=lowpass, least_speed=min_speed)
    return _of_arm(fit, logs, apart, settings, show)


def check_configuration_path(path: Path, option: str = "") -> None:
    """Raise `UsageError` if a configuration cannot be written to a path, or there is one that somebody has edited."""
    if path.suffix not in (".yaml", ".yml"):
        raise UsageError(f"{option}{path}: a configuration ends in .yaml")
    check_writable(path, option)
    if path.exists():
        raise UsageError(f"{option}{path} exists already; it is not replaced: move it, or give another name")


def _axis_name(name: str, taken: Collection[str]) -> str:
    """Return a name of an axis: small letters, digits and _, the first a letter."""
    safe = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    safe = safe if safe[:1].isalpha() else f"joint_{safe}"
    return safe if safe not in taken else f"{safe}_{len(taken)}"


def of_joint(path: Path, joint: str) -> Path:
    """Return the name of a joint's file."""
    safe = re.sub(r"[^\w.-]+", "_", joint).strip("_")
    return path.with_name(f"{path.stem}_{safe}{path.suffix}")


def _logs(given: Given, patterns: Mapping[str, str | None], reading: Mapping[str, Any]) -> list[Log]:
    """Read the joints of each log."""
    wanted = {name: pattern for name, pattern in patterns.items() if pattern is not None}
    if len(wanted) == 1 and "{}" not in wanted["position"]:
        return _axes(given, wanted["position"], reading)
    for name in wanted:
        if name in (reading["column"] or {}):
            raise UsageError(f"--column {name} is of one axis: not with --joints")
    if "torque" not in wanted:
        raise UsageError("--joints with a pattern needs --torque, e.g. 'tau{}'")
    first = read(given, axis=None, **{**reading, "where": None, "scale": None}, only=("time_s",), is_preview=True)[0]
    own = _expanded(first.path, wanted, [*first.columns, *first.others])
    found: dict[str, list[Recording]] = {}
    for place, source in enumerate(own["position"]):
        mapped = {**(reading["column"] or {}), **{name: each[place] for name, each in own.items()}}
        name = _SOURCE.split(source)[0]
        wanted_here = ("time_s", *wanted, "temperature")
        read_here = read(given, axis=name, **{**reading, "column": mapped}, only=wanted_here)
        found[name] = [each if wanted.get("velocity") else _without_velocity(each) for each in read_here]
    return [dict(zip(found, log, strict=True)) for log in zip(*found.values(), strict=True)]


def _without_velocity(recording: Recording) -> Recording:
    """Return a recording whose velocity comes from its position: a column of that name is of another joint."""
    columns = {name: values for name, values in recording.columns.items() if name != "velocity"}
    return replace(recording, columns=columns)


def _axes(given: Given, wanted: str, reading: Mapping[str, Any]) -> list[Log]:
    """Read axes of files by name, such as the joints of a bag."""
    found: dict[str, Log] = {}
    for each in read(given, axis=None, **reading, has_all_axes=True):
        found.setdefault(each.path, {})[each.axis] = each
    logs = []
    for path, there in found.items():
        names = list(there) if wanted == "all" else [name.strip() for name in wanted.split(",")]
        for name in names:
            if name not in there:
                text = f"{path} has no axis {name!r}; {choices(name, there)}"
                raise UsageError(f"{text}; columns need a pattern and --torque: --joints 'q{{}}' --torque 'tau{{}}'")
        logs.append({name: with_position(there[name]) for name in names})
    return logs


def _expanded(path: str, given: Mapping[str, str], columns: Sequence[str]) -> dict[str, list[str]]:
    """Return the sources of each quantity, one for each joint, from patterns or lists."""
    numbers = _numbers(given["position"], columns) if "{}" in given["position"] else []
    if "{}" in given["position"] and not numbers:
        text = f"{path}: no column fits --joints {given['position']!r}"
        raise UsageError(f"{text}; {choices(given['position'], columns)}")
    found = {}
    for name, pattern in given.items():
        option = "--joints" if name == "position" else f"--{name}"
        if pattern.count("{}") > 1 or ("{}" in pattern and not numbers):
            raise UsageError(f"{option} {pattern!r}: one {{}} stands for the number or name of a joint of --joints")
        if "{}" in pattern:
            if "{}" in _SOURCE.split(pattern)[0] and not _numbers(pattern, columns):
                raise UsageError(f"{path}: no column fits {option} {pattern!r}; {choices(pattern, columns)}")
            found[name] = [pattern.replace("{}", each) for each in numbers]
        else:
            found[name] = [each.strip() for each in pattern.split(",")]
    counts = {name: len(each) for name, each in found.items()}
    for name, count in counts.items():
        if count != counts["position"]:
            raise UsageError(f"--joints has {counts['position']} columns, --{name} {count}: one for each joint")
    return found


def _numbers(pattern: str, columns: Iterable[str]) -> list[str]:
    """Return what stands for {} in the columns that fit, numbers in their order."""
    before, mark, after = _SOURCE.split(pattern)[0].partition("{}")
    if not mark:
        raise UsageError(f"{pattern!r}: the column with {{}} comes first, its factors behind it, as in 'q{{}}*pi/180'")
    fits = re.compile(re.escape(before) + r"(\w+)" + re.escape(after))
    found = [match[1] for match in map(fits.fullmatch, columns) if match is not None]
    if any(each.isdigit() for each in found):  # q1 to q6 and qfoo: the numbers are meant
        return sorted((each for each in found if each.isdigit()), key=int)
    return found


def _loaded(path: str | Path, joints: Sequence[str] | None, signs: Sequence[float] | None, names: Sequence[str]) -> Arm:
    """Load the arm whose joints are those of a log."""
    if joints is not None:
        arm = load(path, joints, signs=signs)
    else:
        try:
            arm = load(path, names, signs=signs)  # those of the same names
        except UsageError:
            arm = load(path, signs=signs)
    if len(arm) != len(names):
        raise UsageError(
            f"{path} has {len(arm)} joints ({', '.join(arm.joints)}), and the log {len(names)} ({', '.join(names)}): "
            "name those of the file in the order of the log with --urdf-joints"
        )
    return arm


def _as_own_axes(
    logs: Sequence[Log], apart: Sequence[Log], settings: IdentificationSettings, show: ShowStep
) -> IdentifiedJoints:
    """Identify each joint as an axis of its own."""
    joints, failures = {}, {}
    for name in logs[0]:
        beside = {log[name].path: {other: each for other, each in log.items() if other != name} for log in logs}
        ours, theirs = ([with_position(log[name]) for log in some] for some in (logs, apart))
        try:
            joints[name] = identified_axis(ours, theirs, settings, _of(name, show), beside, {})
        except FrictionHilError as error:  # of one joint, which costs the others nothing
            failures[name] = str(error)
    return IdentifiedJoints(joints, failures, tuple(logs[0]))


def _of_arm(
    fit: ArmFit, logs: Sequence[Log], apart: Sequence[Log], settings: IdentificationSettings, show: ShowStep
) -> IdentifiedJoints:
    """Identify the friction of each joint in what the arm's links leave of its torque."""
    static = tuple(name for name in structures.families() if describe(name).is_static)  # reversals are left out
    ours, theirs = ([as_axes(list(log.values()), fit) for log in some] for some in (logs, apart))
    joints, failures = {}, {}
    for k, (name, joint, is_linear) in enumerate(zip(logs[0], fit.joints, fit.arm.is_linear, strict=True)):
        if not joint.is_known:
            failures[name] = "; ".join(joint.flags)
            continue
        own = replace(
            settings,
            families=settings.families or static,
            axis="linear" if is_linear else "rotary",
            gravity="none",
            held={"inertia": joint.values.get("rotor", 0.0)},
            refine=False,
            lowpass_hz=fit.lowpass_hz,
            decimation=settings.decimation or fit.decimation,
            least_speed=joint.least_speed,
            sliding_s=fit.sliding_s,
        )

        def prefer(found: Identification, joint: JointFriction = joint) -> Identification:
            return _with_load(found, joint)

        try:
            joints[name] = identified_axis(
                [log[k] for log in ours],
                [log[k] for log in theirs],
                own,
                _of(name, show),
                {},
                {},
                has_mechanics=False,  # the file says what is behind the motors
                prefer=prefer,
            )
        except FrictionHilError as error:
            failures[name] = str(error)
    return IdentifiedJoints(joints, failures, tuple(logs[0]), fit)


def _of(name: str, show: ShowStep) -> ShowStep:
    def shown(text: str, number: int = 0, count: int | None = None, /) -> None:
        show(f"{name}: {text}", number, count)

    return shown


def _with_load(found: Identification, joint: JointFriction) -> Identification:
    """Prefer a model with friction per load, where the log of the whole arm shows it clearly."""
    factor, error = joint.values.get("load", 0.0), joint.errors.get("load", math.inf)
    best = next((each for each in found.fits if "load" in each.structure.modifiers), None)
    if factor <= th.LOAD_CLEAR * error or best is None or "load" in found.best.structure.modifiers:
        return found
    reason = (
        f"the whole arm shows friction of {factor:.3g} per load, with a standard error of {error:.2g}: {best.label} is "
        "the best model that has it"
    )
    return replace(found, fits=(best, *(each for each in found.fits if each is not best)), reason=reason)


def _facts(fit: ArmFit) -> dict[str, Any]:
    return {
        "path": fit.arm.path,
        "joints": [asdict(each) for each in fit.joints],
        "parameters": fit.arm.parameters.tolist(),
        "armatures": fit.arm.armatures.tolist(),
        "determined": fit.determined,
        "combinations": fit.combinations,
        "error_of_file": list(fit.error_of_file),
        "contradiction": fit.contradiction,
        "is_physical": fit.is_physical,
        "problems": list(fit.problems),
    }
