"""The work of ``friction-hil identify --joints``: all joints of one log, with or without the arm's own dynamics."""

import math
from pathlib import Path
from typing import Any

import click

from friction_hil.api.identification import Identified
from friction_hil.api.joints import IdentifiedJoints, check_configuration_path, identify_joints, of_joint
from friction_hil.cli.output import print_json
from friction_hil.cli.work.identify import first, print_result
from friction_hil.cli.work.progress import by_share, status_line
from friction_hil.cli.work.result_files import check_result_files
from friction_hil.cli.work.tables import new_table, number, print_table, say
from friction_hil.identification import Identification
from friction_hil.identification import thresholds as th
from friction_hil.identification.arm_fit import ArmFit
from friction_hil.numerics.readable import brief
from friction_hil.reports.identification_report import write_report

_REMARKS = 3  # in the summary; -v has all
_OF_ONE_AXIS = ("axis", "controller", "static", "fix", "unknown_gain")


def identify_all(
    *,
    sources: tuple[Path, ...],
    columns: dict[str, str],
    scale: dict[str, float],
    where: str | None,
    rate_hz: float | None,
    arm_joints: str | None,
    signs: str | None,
    output: Path | None,
    config: Path | None,
    report: Path | None,
    as_json: bool,
    verbose: bool,
    **options: Any,
) -> int:
    """Identify each joint of a log; write a model file and a report for each, and print the results.

    Returns 1 if there is a joint without a model.
    """
    for name in _OF_ONE_AXIS:
        if options.pop(name):
            raise click.UsageError(f"--{name.replace('_', '-')} is of one axis: not with --joints")
    try:
        directions = None if signs is None else [float(each) for each in signs.split(",")]
    except ValueError:
        raise click.UsageError(f"--signs {signs}: must be 1 or -1 for each joint, e.g. 1,-1,1") from None
    named = None if arm_joints is None else [name.strip() for name in arm_joints.split(",")]
    check_result_files(output, report)
    if config is not None:
        if output is None:
            raise click.UsageError("--config needs --output friction.yaml: it names the model files")
        check_configuration_path(config, "--config ")
    with status_line("reading") as show:
        found = identify_joints(
            sources,
            column=columns,
            scale=scale,
            rate=rate_hz,
            where=where,
            arm_joints=named,
            signs=directions,
            progress=by_share(show),
            **options,
        )
    has_config = config is not None and found.is_usable
    written = found.save(output, config=config if has_config else None) if output is not None else {}
    reports = {name: of_joint(report, name) for name in found.joints} if report is not None else {}
    for name, path in reports.items():
        each = found.joints[name]
        assert isinstance(each.found, Identification)
        write_report(path, each.found, each.facts["free_run"], [one.text for one in each.findings], each.mechanics)
    if as_json:
        facts = found.to_dict()
        for name in found.joints:
            facts["joints"][name] |= {"output": written.get(name), "report": reports.get(name)}
        print_json(facts | ({"configuration": config if has_config else None} if config is not None else {}))
    else:
        configs = [config] if config is not None and has_config else []
        files = {"model files": [*written.values()], "reports": [*reports.values()], "configuration": configs}
        _print(found, files, verbose=verbose)
        if config is not None and not has_config:
            say(f"{config} is not written: it would be of all joints, and not all have a model.")
    return int(not found.is_usable)


def _print(found: IdentifiedJoints, files: dict[str, list[Path]], *, verbose: bool) -> None:
    """Print what was found of all joints, what it is worth, what is uncertain and what to do next."""
    if verbose:
        for name, each in found.joints.items():
            click.echo(name)
            print_result(each, None, None, verbose=True, is_last=False)
            click.echo()
    if found.fit is None:
        _print_joints(found)
    else:
        _print_arm(found, found.fit, verbose=verbose)
    remarks = _remarks(found)
    for text in remarks if verbose else first(remarks, _REMARKS):
        say(text, stderr=False)
    for what, paths in files.items():
        if paths:
            say(f"{what}: {', '.join(map(str, paths))}", stderr=False)
    if files["configuration"]:
        config = files["configuration"][0]
        say(
            f"next: friction-hil config check {config}; then, in your loop, "
            f"fh.Compensator.load({str(config)!r}, period_s=...)",
            stderr=False,
        )
    elif files["model files"]:
        say("next: the same with --config arm.yaml, which writes the configuration for fh.Compensator", stderr=False)
    elif found.is_usable:
        say(
            "next: the same with --output friction.yaml --config arm.yaml: model files, and their configuration",
            stderr=False,
        )


def _remarks(found: IdentifiedJoints) -> list[str]:
    """Return what is wrong or uncertain, the worst first; what is the same of several joints is said once."""
    joints: dict[str, list[str]] = {}
    for name, reason in found.failures.items():
        joints.setdefault(f"no model: {reason}", []).append(name)
    findings = [(name, one) for name, each in found.joints.items() for one in each.findings]
    for name, finding in sorted(findings, key=lambda each: not each[1].is_fatal):
        joints.setdefault(finding.text, []).append(name)
    fit = found.fit
    for name, joint in zip(found.names, () if fit is None else fit.joints, strict=False):
        for flag in joint.flags if joint.is_known else ():
            joints.setdefault(flag, []).append(name)
    told = [f"! {', '.join(names)}: {text}." for text, names in joints.items()]
    if fit is not None and not fit.is_physical:
        told.insert(
            0,
            "! the refitted inertia matrix is not positive everywhere: the refitted arm is right about the torques of "
            "motions such as this one, and not to be simulated; a log with harder acceleration shows more of it.",
        )
    if fit is not None and fit.contradiction > th.ARM_CONTRADICTED:
        told.insert(
            0,
            f"! the log contradicts the file: its masses, centres and inertias would be off by {fit.contradiction:.1f} "
            "times what is usual: check units (rad, N m), signs and order of the joints, and the direction of gravity.",
        )
    return told


def _print_joints(found: IdentifiedJoints) -> None:
    """Print the model of each joint, each identified by itself."""
    say(
        "Friction of each joint by itself, SI, with standard errors; relative_error of the torque in parts of the log "
        "that were not fitted. --urdf tells the friction from the weight and inertia of the arm.",
        stderr=False,
    )
    table = new_table("joint", "model", *map(number, ("coulomb", "viscous", "inertia", "held out")))
    for name, each in found.joints.items():
        assert isinstance(each.found, Identification)
        best, errors = each.found.best, each.standard_errors
        cells = [_with_error(best.values.get(key), errors.get(key)) for key in ("coulomb", "viscous", "inertia")]
        table.add_row(name, _label(each), *cells, _percent(best.held_out.relative_error))
    print_table(table)


def _print_arm(found: IdentifiedJoints, fit: ArmFit, *, verbose: bool) -> None:
    """Print friction of all joints with standard errors, and what the log says of the arm."""
    for problem in first(fit.problems, _REMARKS):
        say(problem)
    say(
        "Friction of each joint, SI, with standard errors; relative_error of the torque in blocks of time that were "
        "not fitted, of the whole arm and of the joint alone; by how much the file's torque of the links was off.",
        stderr=False,
    )
    keys = {"coulomb": "coulomb", "viscous": "viscous", "per load": "load", "rotor": "rotor"}
    keys |= {"offset": "offset"} if verbose else {}
    table = new_table("joint", "model", *map(number, (*keys, "held out", "alone", "file off")))
    for name, joint, off in zip(found.names, fit.joints, fit.error_of_file, strict=True):
        cells = [_with_error(joint.values.get(key), joint.errors.get(key)) for key in keys.values()]
        shown = name if name == joint.name else f"{name} = {joint.name}"
        errors = (_percent(each) for each in (joint.held_out, joint.alone, off))
        table.add_row(shown, _label(found.joints.get(name)), *cells, *errors)
    print_table(table)
    say(
        f"inertia and weight: the log determines {fit.determined} of {fit.combinations} combinations better than the "
        "file does; the others are the file's",
        stderr=False,
    )


def _label(found: Identified | None) -> str:
    return found.label if found is not None and found.is_usable else "none"


def _with_error(value: float | None, error: float | None) -> str:
    text = "-" if value is None else brief(value, 4)
    return text if value is None or error is None else f"{text} ({brief(error, 2)})"


def _percent(value: float) -> str:
    return "-" if math.isnan(value) else f"{100.0 * value:.2f} %"
