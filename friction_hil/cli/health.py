"""``friction-hil health``: what has changed in the friction of axes over hours and months."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.options import option_daemon_pace, option_json, option_reset_fault, option_simulate
from friction_hil.cli.recording_options import recording_options


@click.command("health")
@click.argument("sources", metavar="NAME|RECORDING|CONFIG...", nargs=-1, required=True)
@recording_options
@click.option("--linear", "is_linear", is_flag=True, help="Linear axes: m, N. Without it: rad, N m.")
@click.option(
    "--order",
    "orders",
    type=click.FloatRange(min=0.0, min_open=True),
    multiple=True,
    metavar="ORDER",
    help="Order of ripple to watch, periods per revolution or per metre, besides the lowest ones of a rotary axis, "
    "e.g. that of a gear mesh. May be repeated.",
)
@click.option(
    "--window",
    "window_s",
    type=click.FloatRange(min=5.0),
    default=600.0,
    show_default=True,
    metavar="S",
    help="Length of the stretch of a recording that gives one observation.",
)
@click.option(
    "--baseline",
    type=click.IntRange(min=10),
    default=30,
    show_default=True,
    metavar="N",
    help="Number of first observations that are the baseline.",
)
@click.option(
    "--since",
    type=click.DateTime(),
    metavar="TIME",
    help="Leave out what is older, e.g. after a repair: 2026-01-31 or 2026-01-31T14:25:30, local time.",
)
@click.option(
    "--false-alarms",
    type=click.FloatRange(min=0.0, min_open=True),
    default=1.0,
    show_default=True,
    metavar="N",
    help="False alarms to be expected per year and axis, at most, of all quantities together.",
)
@click.option(
    "--history",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.jsonl",
    help="Keep the observations in this file, and use those that are in it: the recordings may then be removed. "
    "Default for NAME: a file in the state folder.",
)
@click.option(
    "--report", type=click.Path(path_type=Path), metavar="FILE.html", help="Write a report with figures and tables."
)
@click.option(
    "--fingerprint",
    is_flag=True,
    help="Move the axes of the configuration file that is named, as the key 'experiment' of each says and without "
    "compensation, and judge these motions: always the same ones compare best.",
)
@click.option("--yes", is_flag=True, help="With --fingerprint: do not ask for confirmation before an axis moves.")
@option_simulate
@option_reset_fault
@option_daemon_pace
@click.option(
    "--metrics",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.prom",
    help="Write the figures for the textfile collector of Prometheus's node exporter.",
)
@option_json
def command(**options: Any) -> int:
    """Show what has changed in the friction of axes, with standard errors, and never why.

    NAME is a service, whose recordings are in /var/lib/friction-hil/NAME; a folder stands for the recordings in it.
    CONFIG is a configuration file, with --fingerprint.

    Exit status: 0 nothing has changed, 3 something has, 1 no quantity could be judged yet.
    """
    from friction_hil.cli.work.health import show_health  # imported here: --help must not wait for numba

    return show_health(**options)
