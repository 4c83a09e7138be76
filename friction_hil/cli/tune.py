"""``friction-hil tune``: commissioning on the drive."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.completion import complete_axis
from friction_hil.cli.options import (
    option_daemon_pace,
    option_families,
    option_json,
    option_reset_fault,
    option_simulate,
    option_verbose,
)


@click.command("tune")
@click.argument("config", type=click.Path(path_type=Path))
@click.option(
    "--axis",
    "names",
    multiple=True,
    metavar="NAME",
    shell_complete=complete_axis,
    help="Axis to tune; all by default. May be repeated.",
)
@option_families
@click.option(
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Folder for recordings, models and report; it must be new or empty.  [default: out/tune, with the time in its "
    "name if it exists]",
)
@click.option(
    "--mechanics",
    is_flag=True,
    help="Shake each axis too while it slides, for half a minute, to find masses and resonance behind the motor.",
)
@click.option(
    "--apply",
    is_flag=True,
    help="Write model and gain that helped into CONFIG; its comments stay.",
)
@click.option("--yes", is_flag=True, help="Do not ask for confirmation before the axes move.")
@option_simulate
@option_reset_fault
@option_daemon_pace
@option_verbose
@option_json
def command(**options: Any) -> int:
    """Identify the friction of the axes of CONFIG on the machine, and test the compensation.

    Each axis moves as far and as fast as its 'experiment' allows. From this motion a friction model and the inertia are
    identified. They are tested on the trajectories of the axes and on slow, small and fast motions, without and with
    compensation, and the best one at other gains too. Model and gain with the smallest following error are
    recommended; --apply writes them into CONFIG. The model file that CONFIG names need not exist: tune writes it. An
    existing one is not changed; the new model is then in DIR.

    Exit status 1 if a model did not help, after a fault, or if a drive was not left as it was found.
    """
    from friction_hil.cli.work.tune import tune_machine  # imported here: --help must not wait for numba

    return tune_machine(**options)
