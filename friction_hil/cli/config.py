"""``friction-hil config``: make configurations, check them, show them in full, describe their format."""

import math
from typing import Any

import click

from friction_hil.cli import Group
from friction_hil.cli.options import option_json


def _above_zero(context: click.Context, parameter: click.Parameter, value: float | None) -> float | None:
    """Check a limit; click's ranges let NaN and infinity through."""
    if value is not None and not 0.0 < value < math.inf:
        raise click.BadParameter(f"must be a number above zero, not {value:g}")
    return value


@click.group(cls=Group)
def command() -> None:
    """Make, check, show and describe configurations."""


@command.command()
@click.argument("file", required=False, metavar="[FILE]")
@click.option("--driver", metavar="NAME", help="Driver of the drive: canopen (default), modbus, ascii, dynamixel.")
@click.option(
    "--bus",
    metavar="CHANNEL",
    help="CAN interface such as can0, or INTERFACE:CHANNEL[:PORT]; with a serial driver the port, e.g. /dev/ttyUSB0.",
)
@click.option("--bitrate", type=int, metavar="N", help="Bit rate of the CAN bus, or baud rate of the line.")
@click.option("--node", metavar="N", help="CANopen node, Modbus unit, Dynamixel id, or axis of the text protocol.")
@click.option("--description", metavar="NAME", help="Drive of a serial driver: a ready description, or your own file.")
@click.option("--mode", metavar="MODE", help="csp, csv or cst; by default the first of these that the drive has.")
@click.option(
    "--torque",
    type=float,
    callback=_above_zero,
    metavar="LIMIT",
    help="Limit of the torque, N m (N); start with a small value.",
)
@click.option(
    "--velocity", type=float, callback=_above_zero, metavar="LIMIT", help="Limit of the velocity, rad/s (m/s)."
)
@click.option(
    "--travel",
    type=float,
    callback=_above_zero,
    metavar="DISTANCE",
    help="How far the axis may move to either side, rad (m).",
)
@click.option("--linear", "is_linear", is_flag=True, help="A linear axis: m, m/s, N.")
@click.option(
    "--simulated", "is_simulated", is_flag=True, help="A simulated drive on this machine; nothing to fill in."
)
@click.option(
    "--like",
    metavar="ACTUATOR",
    help="Begin with the friction of a known actuator ('friction-hil models --library'), marked as not identified on "
    "this axis.",
)
@click.option("--example", metavar="NAME", help="Copy an example instead; 'friction-hil config examples' lists them.")
@click.option("--force", is_flag=True, help="Overwrite FILE.")
def new(driver: str | None, **options: Any) -> None:
    """Write an annotated configuration.

    FILE is machine.yaml by default. What the options do not say is marked in the file, and 'config check' refuses it
    until it is filled in: there are no default limits of torque, velocity and travel. A schema for editors is written
    beside it.
    """
    from friction_hil.cli.work.config import write_new  # imported here: --help must not wait for numba

    write_new(driver=driver, **options)


@command.command("examples")
def list_examples() -> None:
    """List the example configurations."""
    from friction_hil.cli.work.config import print_examples  # imported here: --help must not wait for numba

    print_examples()


@command.command()
@click.argument("files", nargs=-1, required=True, metavar="FILE...", type=click.Path())
@option_json
def check(files: tuple[str, ...], as_json: bool) -> int:
    """Report all mistakes in configurations.

    Each mistake in FILE..., and in the files that they name, is reported with file and line. No bus is opened. Exit
    status 2 if there is any.
    """
    from friction_hil.cli.work.config import check_files  # imported here: --help must not wait for numba

    return check_files(files, as_json)


@command.command()
@click.argument("file", metavar="FILE", type=click.Path())
def show(file: str) -> None:
    """Print a configuration with all defaults.

    The models that FILE names are included, so that the result is self-contained YAML.
    """
    from friction_hil.cli.work.config import show_file  # imported here: --help must not wait for numba

    show_file(file)


@command.command()
def schema() -> None:
    """Print the JSON Schema, for editors.

    It includes the options of the installed drivers.
    """
    from friction_hil.cli.work.config import print_schema  # imported here: --help must not wait for numba

    print_schema()
