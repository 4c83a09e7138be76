"""The work of ``friction-hil identify --joints``: all joints of one log, with or without the arm's own dynamics."""

import math
from pathlib import Path
from typing import Any

import click

from friction_hil.api.joints import IdentifiedJoints, identify_joints, of_joint
from friction_hil.cli.output import print_json
from friction_hil.cli.work.identify import print_result
from friction_hil.cli.work.progress import status_line
from friction_hil.cli.work.result_files import check_result_files
from friction_hil.cli.work.tables import new_table, number, print_files, print_table, say
from friction_hil.identification import Identification
from friction_hil.identification import thresholds as th
from friction_hil.identification.arm_fit import ArmFit
from friction_hil.numerics.readable import brief
from friction_hil.reports.identification_report import write_report

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
    with status_line("reading") as show:
        found = identify_joints(
            sources,
            column=columns,
            scale=scale,
            rate=rate_hz,
            where=where,
            arm_joints=named,
            signs=directions,
            progress=lambda text, share: show(text),
            **options,
        )
    written = found.save(output) if output is not None else {}
    reports = {name: of_joint(report, name) for name in found.joints} if report is not None else {}
    for name, path in reports.items():
        each = found.joints[name]
        assert isinstance(each.found, Identification)
        write_report(path, each.found, each.facts["free_run"], [one.text for one in each.findings], each.mechanics)
    if as_json:
        facts = found.to_dict()
        for name in found.joints:
            facts["joints"][name] |= {"output": written.get(name), "report": reports.get(name)}
        print_json(facts)
    else:
        _print(found, written, reports, verbose=verbose)
    return int(not found.is_usable)


def _print(found: IdentifiedJoints, written: dict[str, Path], reports: dict[str, Path], *, verbose: bool) -> None:
    if found.fit is not None:
        _print_arm(found.fit)
    for name, each in found.joints.items():
        click.echo(f"\n{name}")
        if found.fit is None or verbose:
            print_result(each, written.get(name), reports.get(name), verbose=verbose)
            continue
        say(f"Chosen: {each.label}." if each.is_usable else "No usable model.", stderr=False)
        for finding in each.findings:
            say(f"! {finding.text}.", stderr=False)
        print_files({"model file": written.get(name), "report": reports.get(name)})
    for name, reason in found.failures.items():
        click.echo(f"\n{name}")
        say(f"! no model: {reason}", stderr=False)


def _print_arm(fit: ArmFit) -> None:
    """Print friction of all joints with standard errors, and what the log says of the arm."""
    for problem in fit.problems:
        say(problem)
    say(
        "Friction of each joint, with standard errors; relative_error of the torque on blocks of time held out, of the "
        "whole arm and of the joint alone; by how much the file's torque of the links was off.",
        stderr=False,
    )
    columns = ("coulomb", "viscous", "offset", "per load", "rotor", "held out", "alone", "file off")
    table = new_table("joint", *map(number, columns))
    for joint, off in zip(fit.joints, fit.error_of_file, strict=True):
        cells = [
            f"{brief(joint.values[key], 4)} ({brief(joint.errors[key], 2)})" if key in joint.values else "-"
            for key in ("coulomb", "viscous", "offset", "load", "rotor")
        ]
        table.add_row(joint.name, *cells, _percent(joint.held_out), _percent(joint.alone), _percent(off))
    print_table(table)
    say(
        f"inertia and weight: the log determines {fit.determined} of {fit.combinations} combinations better than the "
        "file does; the others are the file's",
        stderr=False,
    )
    if fit.contradiction > th.ARM_CONTRADICTED:
        say(
            f"! the log contradicts the file: its masses, centres and inertias would be off by {fit.contradiction:.1f} "
            "times what is usual: check units (rad, N m), signs and order of the joints, and the direction of gravity.",
            stderr=False,
        )
    if not fit.is_physical:
        say(
            "! the refitted inertia matrix is not positive everywhere: the refitted arm is right about the torques of "
            "motions such as this one, and not to be simulated; a log with harder acceleration shows more of it.",
            stderr=False,
        )
    for joint in fit.joints:
        for flag in joint.flags if joint.is_known else ():
            say(f"! {joint.name}: {flag}.", stderr=False)


def _percent(value: float) -> str:
    return "-" if math.isnan(value) else f"{100.0 * value:.2f} %"
