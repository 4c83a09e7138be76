"""``friction-hil reset``: resets the faults of the drives of a configuration."""

from typing import Any

import click

from friction_hil.cli.options import option_axes, option_json


@click.command("reset")
@click.argument("config", type=click.Path(dir_okay=False))
@option_axes
@option_json
def command(**options: Any) -> int:
    """Reset the faults of the drives of CONFIG, and leave the drives without power.

    Reports what each fault was. Remove its cause first. Nothing is enabled; a drive that has power is left alone. Exit
    status 1 unless every drive was read back without fault and without power.
    """
    from friction_hil.cli.work.stop import reset  # imported here: --help must not wait for the drivers

    return reset(**options)
