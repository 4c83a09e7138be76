"""``friction-hil status``: shows the daemons that run."""

from typing import Any

import click

from friction_hil.cli.completion import complete_daemon
from friction_hil.cli.options import option_json


@click.command("status")
@click.argument("name", required=False, shell_complete=complete_daemon)
@option_json
def command(**options: Any) -> int:
    """Show the daemon NAME, or all that run here: state, axes, drives, gains, models and faults.

    A drive whose state was not read back in the last cycle is reported as unknown.
    """
    from friction_hil.cli.work.control import status  # imported here: --help must not wait for the tables

    return status(**options)
