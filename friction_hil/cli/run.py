"""``friction-hil run``: the daemon."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.options import option_daemon_pace, option_json, option_reset_fault, option_simulate


@click.command("run")
@click.argument("config", type=click.Path(path_type=Path))
@click.option("--duration", type=float, metavar="S", help="Stop the motion after S seconds.")
@click.option("--record", type=click.Path(path_type=Path), metavar="FILE", help="Record to FILE (.mcap).")
@click.option("--force", is_flag=True, help="Overwrite FILE if it exists.")
@click.option(
    "--dry-run",
    is_flag=True,
    help="Listen, compute and record, but never write a controlword, target or offset to a drive.",
)
@option_simulate
@option_reset_fault
@option_daemon_pace
@click.option(
    "--name", metavar="NAME", help="Name of the daemon for status, set, start, stop and reset. Default: CONFIG's stem."
)
@click.option("--group", metavar="GROUP", help="Let the members of GROUP use the control socket too.")
@click.option(
    "--wait", is_flag=True, help="Enable nothing before 'friction-hil start NAME', nor after a stop or fault."
)
@option_json
def command(**options: Any) -> int:
    """Run the daemon with the drives of CONFIG.

    It moves the axes along their trajectories and compensates their friction. Ctrl-C brings them to rest, fades the
    compensation out and disables the drives; so does every fault. At the end it prints the following error without
    compensation (compensation.baseline_s) and with it. Exit status 1 after a fault,
    or if a drive was not left as it was found.

    While it runs, 'friction-hil set NAME' changes gains and models, 'stop NAME' and 'start NAME' take and give power.
    """
    from friction_hil.cli.work.run import run  # imported here: --help must not wait for numba

    return run(**options)
