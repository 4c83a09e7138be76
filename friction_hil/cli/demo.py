"""``friction-hil demo``: two simulated axes draw a circle, without and with compensation, and after learning."""

from typing import Any

import click

from friction_hil.cli.options import folder_option, option_json


@click.command("demo")
@folder_option("out/demo", "the report, its picture and the recording")
@click.option(
    "--pace",
    type=click.Choice(["auto", "real", "sync"]),
    default="auto",
    show_default=True,
    help="real: 1000 cycles a second. sync: in simulated time, as fast as this computer is. auto: real, or sync if "
    "this computer is too busy for that.",
)
@option_json
def command(**options: Any) -> int:
    """Draw a circle with two simulated axes: without friction compensation, with it, and after learning.

    Needs no hardware and takes a good minute. Simulated drives and the daemon run as separate processes on a virtual
    CAN bus. Exit status 1 if compensation did not help, as given or as learned, or if a process failed.
    """
    from friction_hil.cli.work.demo import demonstrate  # imported here: --help must not wait for numba

    return demonstrate(**options)
