"""``friction-hil stop``: takes the power of the drives of a configuration."""

from typing import Any

import click

from friction_hil.cli.options import option_axes, option_json


@click.command("stop")
@click.argument("config", type=click.Path(dir_okay=False))
@option_axes
@option_json
def command(**options: Any) -> int:
    """Stop the drives of CONFIG that were left enabled, and read back that they have no power.

    Quick stop, then disable, for each axis, whatever its driver. Nothing is enabled, and no mode or watchdog is needed.
    Exit status 1 unless every drive was read back without power: what does not answer is reported as unknown.
    """
    from friction_hil.cli.work.stop import stop  # imported here: --help must not wait for the drivers

    return stop(**options)
