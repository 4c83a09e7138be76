"""``friction-hil reset``: resets the faults of a running daemon, or of the drives of a configuration."""

from typing import Any

import click

from friction_hil.cli.completion import complete_daemon
from friction_hil.cli.options import option_axes, option_json


@click.command("reset")
@click.argument("config", metavar="NAME|CONFIG", type=click.Path(dir_okay=False), shell_complete=complete_daemon)
@option_axes
@option_json
def command(**options: Any) -> int:
    """Reset the faults of the running daemon of this name, or of the drives of CONFIG; none of them gets power.

    NAME: the daemon has to wait: it was stopped, or was started with run --wait. start NAME enables it then.

    Reports what each fault was. Remove its cause first. Nothing is enabled; a drive that has power is left alone. Exit
    status 1 unless every drive was read back without fault and without power.
    """
    from friction_hil.cli.work.stop import reset  # imported here: --help must not wait for the drivers

    return reset(**options)
