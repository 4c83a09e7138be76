"""``friction-hil drives``: the drives on a bus, without a run."""

from typing import Any

import click

from friction_hil.cli import Group
from friction_hil.cli.options import option_json

_option_bus = click.option(
    "--bus",
    metavar="CHANNEL",
    help="Bus, where no CONFIG names it: can0, or INTERFACE:CHANNEL[:PORT], as udp_multicast:239.74.163.2:43114, "
    "slcan:/dev/ttyACM0.",
)
_option_bitrate = click.option("--bitrate", type=int, metavar="N", help="Bit rate of --bus, for adapters that need it.")
_option_may_disturb = click.option(
    "--may-disturb",
    is_flag=True,
    help="Read nodes although another master was heard to use their SDO server: its transfers may fail meanwhile, "
    "which can stop its machine.",
)


@click.group(cls=Group)
def command() -> None:
    """Find, show or stop the drives on a CAN bus.

    The bus is that of a configuration CONFIG, or --bus. Nothing here enables a drive or sends NMT or SYNC.
    """


@command.command()
@click.argument("config", required=False, metavar="[CONFIG]")
@_option_bus
@_option_bitrate
@_option_may_disturb
@option_json
def scan(**options: Any) -> int:
    """Find the nodes on the bus.

    Listens first, then reads identity, state and modes of the nodes 1 to 127; writes nothing. Exit status 1 if there
    is none.
    """
    from friction_hil.cli.work.drives import scan_bus  # imported here: --help must not wait for numba

    return scan_bus(**options)


@command.command()
@click.argument("words", nargs=-1, required=True, metavar="[CONFIG] NODE")
@_option_bus
@_option_bitrate
@_option_may_disturb
@option_json
def show(**options: Any) -> int:
    """Show what the drive at NODE says of itself.

    Identity, state, modes, units, mapping, watchdogs, and how the torque of a compensation could reach it. Writes
    nothing.
    """
    from friction_hil.cli.work.drives import show_drive  # imported here: --help must not wait for numba

    return show_drive(**options)


@command.command()
@click.argument("words", nargs=-1, metavar="[CONFIG] [NODE...]")
@_option_bus
@_option_bitrate
@option_json
def stop(**options: Any) -> int:
    """Stop drives that were left enabled, and read back that they have no power.

    The drives at NODE...; without these, those of CONFIG's axes, or with --bus all that answer. Writes quick stop and
    then disable voltage by SDO, which works in Pre-operational too. Exit status 1 unless every drive was read back
    without power. CANopen only; friction-hil stop CONFIG stops drives of any driver.
    """
    from friction_hil.cli.work.drives import stop_drives  # imported here: --help must not wait for numba

    return stop_drives(**options)
