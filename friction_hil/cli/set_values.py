"""``friction-hil set``: changes settings of a daemon while it runs."""

from typing import Any

import click

from friction_hil.cli.completion import complete_daemon
from friction_hil.cli.options import option_json


@click.command("set")
@click.argument("name", shell_complete=complete_daemon)
@click.argument("assignments", metavar="AXIS.KEY=VALUE...", nargs=-1, required=True)
@option_json
def command(**options: Any) -> int:
    """Change settings of the daemon NAME while it runs: x.gain=0.8 x.enabled=false x.model=other.yaml.

    A key is one of an axis's compensation in the configuration, or model. Values are checked as in the configuration.
    All of them are applied in the same cycle, or none: without a step of torque, over the time fade_s. The recording
    holds each change.
    """
    from friction_hil.cli.work.control import set_values  # imported here: --help must not wait for the YAML parser

    return set_values(**options)
