"""``friction-hil start``: enables the axes of a daemon that waits."""

from typing import Any

import click

from friction_hil.cli.completion import complete_daemon
from friction_hil.cli.options import option_json


@click.command("start")
@click.argument("name", shell_complete=complete_daemon)
@option_json
def command(**options: Any) -> int:
    """Enable the axes of the daemon NAME, which was started with run --wait or stopped with stop NAME: they move.

    After a fault, reset NAME comes first. Exit status 1 unless the axes run.
    """
    from friction_hil.cli.work.control import start  # imported here: as the other commands

    return start(**options)
