"""The result of a tuning, the same as JSON, and what it recommends for the configuration."""

import os
from collections.abc import Collection, Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from friction_hil.checked_yaml.edit import edit, with_value
from friction_hil.checked_yaml.output import check_writable
from friction_hil.checked_yaml.text import FieldPath
from friction_hil.config import Configuration, file_problems, load
from friction_hil.errors import ConfigurationError
from friction_hil.numerics.readable import named_constants
from friction_hil.tuning import thresholds
from friction_hil.tuning.arm import JointCheck
from friction_hil.tuning.choice import AxisTuning
from friction_hil.tuning.cogging import position_share
from friction_hil.tuning.rehearsed import RehearsedFit
from friction_hil.tuning.runs import Seconds
from friction_hil.tuning.sequential import ExperimentResult
from friction_hil.tuning.torque_lag import TorqueLag
from friction_hil.tuning.torque_ratio import TorqueRatio


@dataclass(slots=True, eq=False)
class Tuning:
    """Result of tuning a machine."""

    axes: dict[str, AxisTuning] = field(default_factory=dict)
    recordings: list[Path] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)  # of the daemon and of the tuning
    report: Path | None = None  # if one was written
    torque_lags: dict[str, TorqueLag] = field(default_factory=dict)  # by axis
    torque_ratios: dict[str, TorqueRatio] = field(default_factory=dict)  # by axis
    # how long the experiment took and why it ended, by axis
    experiments: dict[str, ExperimentResult] = field(default_factory=dict)
    leftovers: list[str] = field(default_factory=list)  # what drives were left with after some run
    # models with what they do in simulation, best first, by axis; empty for an axis that could not be simulated
    rehearsed: dict[str, tuple[RehearsedFit, ...]] = field(default_factory=dict)
    joints: dict[str, JointCheck] = field(default_factory=dict)  # axes of an arm: what the experiment says of its file
    arm: dict[str, Any] | None = None  # all joints from the trial, as JSON of `friction_hil.identify_joints`
    arm_text: str = ""  # the same in a line
    seconds: Seconds = field(default_factory=Seconds)  # of motion, and of computing while nothing moves


def checked(config: Path) -> Configuration:
    """Return a configuration whose model files need not exist, but whose other files must.

    Raises `ConfigurationError`: it is wrong, or a file is missing.
    """
    configuration = load(config, needs_models=False)
    if problems := file_problems(config, configuration):
        raise ConfigurationError(problems)
    return configuration


def as_dict(tuning: Tuning, config: Path = Path(), applied: Collection[str] = ()) -> dict[str, Any]:
    """Return the object that ``tune --json`` prints; ``applied``: axes whose keys were written into ``config``."""
    return {
        "axes": {
            name: {
                **_axis(name, tuning),
                "recommended": recommended_keys(axis, config) if axis.recommended.trial.has_helped else {},
                "is_applied": name in applied,
            }
            for name, axis in tuning.axes.items()
        },
        "arm": tuning.arm,
        "seconds": tuning.seconds.figures,
        "thresholds": named_constants(thresholds),
        "recordings": tuning.recordings,
        "report": tuning.report,
        "warnings": tuning.warnings,
        "not_restored": tuning.leftovers,
    }


def _axis(name: str, tuning: Tuning) -> dict[str, Any]:
    axis, lag, ratio = tuning.axes[name], tuning.torque_lags.get(name), tuning.torque_ratios.get(name)
    best, share = axis.best, position_share(axis.best.model)
    own = axis.recommended.trial.own
    return {
        "model": best.label,
        "file": axis.file,
        "in_place": axis.is_in_place,
        "reason": best.identification.reason,
        "flags": best.fit.flags,
        "parameters": best.model["friction"]["parameters"],
        "mechanics": best.model["mechanics"],
        "experiment": tuning.experiments[name].figures if name in tuning.experiments else None,
        "torque_lag": None if lag is None else lag.figures,
        "torque_ratio": None if ratio is None else ratio.figures,
        "arm": asdict(tuning.joints[name]) if name in tuning.joints else None,
        "position_torque": None if share is None else asdict(share),
        "left": {
            "rms": share_left(own.compensated.rms, own.uncompensated.rms),
            "peak": share_left(own.compensated.peak, own.uncompensated.peak),
        },
        "tried": [
            {
                "model": each.label,
                **each.trial.figures,
                "reduction": asdict(each.trial.reduction),
                "has_helped": each.trial.has_helped,
            }
            for each in axis.candidates
        ],
        "gains": [each.figures for each in axis.gains],
    }


def recommended_keys(axis: AxisTuning, config: Path) -> dict[str, Any]:
    """Return the keys of an axis that differ from those of the configuration."""
    found: dict[str, Any] = {} if axis.is_in_place else {"model": os.path.relpath(axis.file, config.parent)}
    gain = axis.recommended.gain
    if gain is not None and axis.gains and gain != axis.gains[0].gain:
        found["compensation"] = {"gain": gain}
    return found


def share_left(compensated: float, uncompensated: float) -> float:
    """Return the share of an error that compensation does not remove; 0 of none."""
    return compensated / uncompensated if uncompensated > 0.0 else 0.0


def apply_recommended(tuning: Tuning, config: Path) -> dict[str, dict[str, Any]]:
    """Write what is recommended into the configuration; return it by axis."""
    found = {
        name: recommended_keys(axis, config) for name, axis in tuning.axes.items() if axis.recommended.trial.has_helped
    }
    changes: dict[FieldPath, Any] = {}
    for name, keys in found.items():
        if "model" in keys:
            changes["axes", name, "model"] = keys["model"]
        if "compensation" in keys:
            changes["axes", name, "compensation", "gain"] = keys["compensation"]["gain"]
    if changes:
        edit(config, changes)
    return {name: keys for name, keys in found.items() if keys}


def refuse_unchangeable(config: Path, names: Iterable[str]) -> None:
    """Refuse a configuration that cannot be rewritten, before anything moves."""
    check_writable(config, "--apply ")
    text = config.read_text(encoding="utf-8-sig")
    for name in names:
        for keys, value in ((("model",), "x.yaml"), (("compensation", "gain"), 1.0)):
            with_value(text, ("axes", name, *keys), value, str(config))
