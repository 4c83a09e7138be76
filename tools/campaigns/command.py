"""The command line ``tools/campaign``."""

import json
import os
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import click

from friction_hil.cli.options import option_json
from friction_hil.errors import UsageError, choices
from tools.campaigns.faults import BY_NAME, FAULTS, Fault
from tools.campaigns.judge import judge
from tools.campaigns.table import Row, markdown
from tools.campaigns.trial import run_trial

_WIDTH = 100


@click.command()
@click.option("--tries", type=click.IntRange(1, 1000), default=6, show_default=True, help="Tries of each fault.")
@click.option("--first", type=click.IntRange(0), default=0, help="Number of the first try, to repeat one.")
@click.option("--seed", type=click.IntRange(0), default=7, show_default=True, help="Seed of all that is random.")
@click.option("--only", multiple=True, metavar="NAME", help="Only this fault; may be repeated.")
@click.option(
    "--output", type=click.Path(path_type=Path), metavar="FILE", help="Write the table to FILE (.md) as it grows."
)
@click.option("--list", "is_listing", is_flag=True, help="List the faults, and do nothing.")
@option_json
def command(
    tries: int, first: int, seed: int, only: tuple[str, ...], output: Path | None, is_listing: bool, as_json: bool
) -> int:
    """Put faults between the real daemon and simulated drives, and watch every frame between them.

    Each try takes one drive (CANopen, CANopen beside another master, or Modbus RTU in turn) in a random mode, and the
    fault strikes at a random moment of enabling, motion or stopping. All frames are read on the wire, where none may
    have more torque than the limit, or more change of it than the slew. At the end the drive is asked for its state.
    Exit status 1 if anything was not as it must be; each such try is printed with the command that repeats it.
    """
    faults = [_fault(name) for name in only] or list(FAULTS)
    if is_listing:
        width = max(len(fault.name) for fault in faults)
        for fault in faults:
            click.echo(f"{fault.name:<{width}}  {fault.text} ({', '.join(fault.arenas)})")
        return 0
    if output is not None and not output.parent.is_dir():
        raise UsageError(f"--output {output}: there is no folder {output.parent}")
    rows: list[Row] = []
    began_s = time.monotonic()
    for number, fault in enumerate(faults):
        row = Row(fault)
        rows.append(row)
        for attempt in range(first, first + tries):
            _progress(f"{number + 1}/{len(faults)} {fault.name}, try {attempt + 1 - first} of {tries}")
            seen = run_trial(fault, seed, attempt)
            verdict = judge(fault, seen)
            row.tries.append((seen, verdict))
            for problem in verdict.problems:
                what = " ".join([seen.arena, seen.mode, seen.phase, *seen.told])
                _say(f"FAIL {fault.name} ({what}): {problem}\n     repeat: {_again(fault, seed, attempt)}")
            if output is not None:
                _write(output, rows, seed, first, time.monotonic() - began_s)
    _progress("")
    failed = sum(len(row.failures) for row in rows)
    if as_json:
        repeat = [_again(row.fault, seed, first + number) for row in rows for number, _ in row.failures]
        click.echo(json.dumps({"seed": seed, "faults": [row.figures() for row in rows], "repeat": repeat}))
    else:
        click.echo(markdown(rows))
        click.echo(f"\n{_total(rows, seed, time.monotonic() - began_s)}")
    return 1 if failed else 0


def _total(rows: Sequence[Row], seed: int, took_s: float) -> str:
    """Return the sentence below the table."""
    tries, frames = sum(len(row.tries) for row in rows), sum(row.frames for row in rows)
    failed = sum(len(row.failures) for row in rows)
    void = sum(verdict.is_void for row in rows for _, verdict in row.tries)
    took = f"{took_s:.0f} s, seed {seed}"
    return f"{tries} tries, {frames} frames on the wire, in {took}; {failed or 'none'} failed, {void} void"


def _write(path: Path, rows: Sequence[Row], seed: int, first: int, took_s: float) -> None:
    """Write what there is so far, with the commands that repeat what failed; a reader never sees a half of it."""
    lines = [markdown(rows), "", _total(rows, seed, took_s), ""]
    for row in rows:
        for number, problems in row.failures:
            lines += [f"- `{_again(row.fault, seed, first + number)}`: {'; '.join(problems)}"]
    part = path.with_name(f"{path.name}.part")
    part.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")
    part.replace(path)


def _fault(name: str) -> Fault:
    if name not in BY_NAME:
        raise UsageError(f"no fault is called {name!r}; {choices(name, BY_NAME)}")
    return BY_NAME[name]


def _again(fault: Fault, seed: int, number: int) -> str:
    return f"./tools/campaign --only {fault.name} --seed {seed} --first {number} --tries 1"


def _progress(text: str) -> None:
    """Show what is being done, where somebody looks."""
    if sys.stderr.isatty():
        width = min(_WIDTH, shutil.get_terminal_size().columns - 1)
        os.write(sys.stderr.fileno(), f"\r{text[:width]:<{width}}\r".encode())


def _say(text: str) -> None:
    _progress("")
    click.echo(text, err=True)
