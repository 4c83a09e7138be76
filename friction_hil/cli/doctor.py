"""``friction-hil doctor``: checks before a run."""

from pathlib import Path
from typing import Any

import click


@click.command("doctor")
@click.argument("config", required=False, type=click.Path(path_type=Path))
@click.option(
    "--try-watchdog",
    is_flag=True,
    help="Also let each watchdog of each drive lapse, at standstill and without torque, and report what it does.",
)
@click.option(
    "--warm",
    is_flag=True,
    help="Before that, compile what runs and learning need, once for this machine, by a demo in simulated time.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON list on stdout and nothing else.")
def command(**options: Any) -> int:
    """Check this machine, and with CONFIG also the connection to its drives.

    Run it as the user who runs the daemon. Ports and buses are opened and closed at once; nothing is written to a
    drive, except with --try-watchdog: then each drive is set up as for a run, switched on without torque, and left
    without the daemon's frames. Each check ends with pass, warn (the daemon runs, but less well, or the system does not
    report what was checked) or fail (it will not run, or not safely); warn and fail come with a code and the remedy.
    Exit status 1 if a check fails, 2 if CONFIG has mistakes.
    """
    from friction_hil.cli.work.doctor import run_doctor  # imported here: --help must not wait for numba

    return run_doctor(**options)
