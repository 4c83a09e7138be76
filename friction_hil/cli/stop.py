"""``friction-hil stop``: stops a running daemon, or takes the power of the drives of a configuration."""

from typing import Any

import click

from friction_hil.cli.completion import complete_daemon
from friction_hil.cli.options import option_axes, option_json


@click.command("stop")
@click.argument("config", metavar="NAME|CONFIG", type=click.Path(dir_okay=False), shell_complete=complete_daemon)
@option_axes
@option_json
def command(**options: Any) -> int:
    """Stop the running daemon of this name, or the drives of CONFIG that were left enabled, and read back their power.

    NAME: the daemon brings its axes to rest, fades the compensation out, disables the drives and waits; start NAME
    enables them again. Ctrl-C, SIGTERM or systemctl stop end the daemon itself.

    CONFIG: for drives that no daemon controls any more.
    Quick stop, then disable, for each axis, whatever its driver. Nothing is enabled, and no mode or watchdog is needed.
    Exit status 1 unless every drive was read back without power: what does not answer is reported as unknown.
    """
    from friction_hil.cli.work.stop import stop  # imported here: --help must not wait for the drivers

    return stop(**options)
