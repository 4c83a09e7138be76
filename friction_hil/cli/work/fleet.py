"""The work of ``friction-hil fleet``."""

import os
from pathlib import Path
from typing import Any

import click

from friction_hil.cli.output import print_json
from friction_hil.cli.work.progress import by_share, status_line
from friction_hil.cli.work.tables import print_files, say
from friction_hil.fleets import Fleet, fleet
from friction_hil.numerics.readable import brief

_SHOWN = 3


def do_fleet(
    *,
    work: str,
    sources: tuple[str, ...],
    output: Path,
    scheduler: str | None,
    axis: str | None,
    columns: dict[str, str],
    scale: dict[str, float],
    where: str | None,
    rate_hz: float | None,
    models: str | None,
    linear: bool,
    to: str | None,
    as_json: bool,
) -> int:
    """Do the work, and print what it found; return the exit status: 1 if a recording was not done or not verified."""
    if axis is not None:
        raise click.UsageError("--axis: a fleet has all axes of its recordings")
    options: dict[str, Any] = {} if models is None else {"models": models}
    options |= {} if to is None else {"to": to}
    if linear:
        options |= {"kind": "linear"} if work == "health" else {"linear": True}
    with status_line(f"{work}: {len(sources)} sources") as show:
        found = fleet(
            work,
            sources,
            output=output,
            scheduler=scheduler,
            column=columns,
            scale=scale,
            rate=rate_hz,
            where=where,
            progress=by_share(show),
            **options,
        )
    if as_json:
        print_json({"work": work, "known": found.known, "rows": found.rows, "worst": found.worst[:_SHOWN]})
    else:
        _print(found)
    is_bad = bool(found.failures) or (work == "verify" and bool(found.worst))
    return int(is_bad)


def _print(found: Fleet) -> None:
    """Print how much was done, what stands out, and where the rest is."""
    names = {row["source"] for row in found.rows}
    failed = {row["source"] for row in found.failures}
    before = f", {found.known} of them before" if found.known else ""
    say(f"{len(names) - len(failed)} of {len(names)} done{before}; {len(found.rows)} rows", stderr=False)
    for row in found.worst[:_SHOWN]:
        say(f"- {_sentence(found.work, row)}", stderr=False)
    if (more := len(found.worst) - _SHOWN) > 0:
        say(f"- and {more} more in the report", stderr=False)
    print_files({"table": found.table, "report": found.report})
    if failed:
        say("next: the same command does those again that failed", stderr=False)


def _sentence(work: str, row: dict[str, Any]) -> str:
    if row["error"]:
        return f"not done: {row['error']}"
    name = f"{os.path.basename(row['source'])}, {row['axis']}"
    if work == "verify":
        return f"{name}: not verified: {row['reason']}"
    if work == "health" and "state" not in row:
        return f"{name}: not judged: {row['problems']}"
    if work == "health":
        return f"{name}: {row['quantity']} has changed by {brief(row['change'], 3)} {row['unit']}"
    if not row["is_usable"]:
        return f"{name}: no usable model: {row['flags']}"
    error = row["relative_error"]
    return f"{name}: {row['model']}, relative error {'unknown' if error is None else f'{100.0 * error:.1f} %'}"
