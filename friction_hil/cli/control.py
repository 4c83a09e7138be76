"""``friction-hil status``, ``set``, ``start``, ``stop`` and ``reset``: see and change what runs."""

from typing import Any

import click

from friction_hil.cli.completion import complete_daemon
from friction_hil.cli.options import option_axes, option_json

_option_config = click.argument(
    "config", metavar="NAME|CONFIG", type=click.Path(dir_okay=False), shell_complete=complete_daemon
)


@click.command("status")
@click.argument("name", required=False, shell_complete=complete_daemon)
@option_json
def status(**options: Any) -> int:
    """Show the daemon NAME, or all that run here: state, axes, drives, gains, models and faults.

    A drive whose state was not read back in the last cycle is reported as unknown.
    """
    from friction_hil.cli.work import control  # imported here: --help must not wait for the tables

    return control.status(**options)


@click.command("set")
@click.argument("name", shell_complete=complete_daemon)
@click.argument("assignments", metavar="AXIS.KEY=VALUE...", nargs=-1, required=True)
@option_json
def set_values(**options: Any) -> int:
    """Change settings of the daemon NAME while it runs: x.gain=0.8 x.enabled=false x.model=other.yaml.

    A key is one of an axis's compensation in the configuration, or model. Values are checked as in the configuration.
    All of them are applied in the same cycle, or none: without a step of torque, over the time fade_s. The recording
    holds each change.
    """
    from friction_hil.cli.work import control  # imported here: --help must not wait for the YAML parser

    return control.set_values(**options)


@click.command("start")
@click.argument("name", shell_complete=complete_daemon)
@option_json
def start(**options: Any) -> int:
    """Enable the axes of the daemon NAME, which was started with run --wait or stopped with stop NAME: they move.

    After a fault, reset NAME comes first. Exit status 1 unless the axes run.
    """
    from friction_hil.cli.work import control  # imported here: as the other commands

    return control.start(**options)


@click.command("stop")
@_option_config
@option_axes
@option_json
def stop(**options: Any) -> int:
    """Stop the running daemon of this name, or the drives of CONFIG that were left enabled, and read back their power.

    NAME: the daemon brings its axes to rest, fades the compensation out, disables the drives and waits; start NAME
    enables them again. Ctrl-C, SIGTERM or systemctl stop end the daemon itself.

    CONFIG: for drives that no daemon controls any more.
    Quick stop, then disable, for each axis, whatever its driver. Nothing is enabled, and no mode or watchdog is needed.
    Exit status 1 unless every drive was read back without power: what does not answer is reported as unknown.
    """
    from friction_hil.cli.work import stop  # imported here: --help must not wait for the drivers

    return stop.stop(**options)


@click.command("reset")
@_option_config
@option_axes
@option_json
def reset(**options: Any) -> int:
    """Reset the faults of the running daemon of this name, or of the drives of CONFIG; none of them gets power.

    NAME: the daemon has to wait: it was stopped, or was started with run --wait. start NAME enables it then.

    Reports what each fault was. Remove its cause first. Nothing is enabled; a drive that has power is left alone. Exit
    status 1 unless every drive was read back without fault and without power.
    """
    from friction_hil.cli.work import stop  # imported here: --help must not wait for the drivers

    return stop.reset(**options)
