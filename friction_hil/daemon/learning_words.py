"""What learning does for an axis, in words: for `run`, `status`, `monitor` and the page. Pure."""

import math
from collections.abc import Mapping
from typing import Any

from friction_hil.numerics.readable import brief, quantity

DOINGS = ("waiting", "watching", "trying", "resting", "stopped", "ended")
_STATES = {"kept": "not proven for this motion"}  # of a family that is not in use
_SAME = 1e-3  # relative difference of an estimate from the value in use that is not shown


def result(report: Mapping[str, Any]) -> str:
    """Return what learning has changed so far, from the report on one axis as ``friction-hil run --json`` has it.

    For example ``re-identified 3 times, error 5.10 mrad -> 1.90 mrad; residual layer: no gain, off``.
    """
    if report["mode"] == "propose":
        proposed = report["proposed"]
        return "learning would try nothing" if proposed is None else str(proposed["text"])
    times = report["re_identified"]
    words = [f"re-identified {times} time{'s' * (times != 1)}"]
    if times and report["error_before"] is not None and report["error_after"] is not None:
        shown = [quantity(report[key], report["unit"]) for key in ("error_before", "error_after")]
        words.append(f"error {shown[0]} -> {shown[1]}")
    if report["taken_back"]:
        words.append(f"{report['taken_back']} taken back")
    if report["stopped"]:
        words.append(f"stopped {report['stopped']} time{'s' * (report['stopped'] != 1)}")
    return (
        ", ".join(words) + _family(report["family"], report["unit"]) + _layer(report["residual_layer"], report["unit"])
    )


def _family(family: Mapping[str, Any], unit: str) -> str:
    """Return which family took the place of that of the model file, or was tried; nothing where none was."""
    if family["state"] == "on trial":
        return f"; family {family['text']}: on trial"
    if family["in_use"] != family["of_file"]:
        text = f"; family {family['in_use']} in place of {family['of_file']}"
        if family["text"] != family["in_use"] or family["state"] != "kept":
            return text
        before, after = (quantity(family[key], unit) for key in ("error_before", "error_after"))
        return f"{text}, error {before} -> {after}"
    if not family["tried"]:
        return ""
    return f"; family {family['text']}: {_STATES.get(family['state'], family['state'])}, off"


def last_line(axis: str, report: Mapping[str, Any]) -> str:
    """Return what a run says at its end: the axis, its `result`, and why learning has ended if it has."""
    ended = f", ended: {report['reason']}" if report["doing"] == "ended" else ""
    return f"{axis}: {result(report)}{ended}"


def _layer(layer: Mapping[str, Any], unit: str) -> str:
    """Return what the residual layer has done; nothing before it was looked for."""
    if not layer["state"]:
        return ""
    if layer["state"] != "on":
        return f"; residual layer: {layer['state']}, off"
    before, after = (quantity(layer[key], unit) for key in ("error_before", "error_after"))
    return f"; residual layer: {layer['text']}, error {before} -> {after}, on"


def doing(report: Mapping[str, Any]) -> str:
    """Return what learning does now, and why: ``stopped (the record has gaps)``."""
    reason = f" ({report['reason']})" if report["reason"] else ""
    return f"{report['doing']}{reason}"


def summary(report: Mapping[str, Any]) -> str:
    """Return mode, what learning does now, what it has changed, and the gain that follows from what is known."""
    return f"{report['mode']}: {doing(report)}; {result(report)}; gain {report['gain']:.3g}"


def parameters(report: Mapping[str, Any]) -> str:
    """Return the parameters in use with their relative standard errors: ``coulomb 0.08 ±1.2 %, ...``.

    Where learning knows a value better than the one in use, both are there. Empty once learning has ended, because
    other parameters may be in use then.
    """
    if report["doing"] == "ended":
        return ""
    estimates, errors = report["parameters"] or {}, report["relative_errors"] or {}
    words = []
    for name, value in report["in_use"].items():
        text = f"{name} {brief(value, 3)}"
        if name in errors:
            estimate, error = estimates.get(name, value), f"±{100.0 * errors[name]:.2g} %"
            is_same = math.isclose(estimate, value, rel_tol=max(_SAME, errors[name]))
            is_same = is_same or brief(estimate, 3) == brief(value, 3)
            text += f" {error}" if is_same else f" (estimate {brief(estimate, 3)} {error})"
        words.append(text)
    return ", ".join(words)
