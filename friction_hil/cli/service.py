"""``friction-hil service``: the daemon as a service of systemd."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli import Group
from friction_hil.cli.options import option_json

_option_root = click.option(
    "--root",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("/"),
    help="Directory that counts as root of the file system, for images and packages.  [default: /]",
)


@click.group(cls=Group)
def command() -> None:
    """Install, remove or show the daemon as a service of systemd.

    A service starts with the machine and waits: axes are enabled by 'friction-hil start NAME' only.
    """


@command.command()
@click.argument("name")
@click.argument("config", type=click.Path(path_type=Path))
@_option_root
@click.option("--force", is_flag=True, help="Replace the service if there is one of this name.")
@option_json
def install(**options: Any) -> int:
    """Write the files of the service NAME for CONFIG: unit, user, udev rules, and a copy of the configuration.

    Nothing is started. CONFIG and the files beside it that it names go to /etc/friction-hil/NAME, recordings with
    relative paths to /var/lib/friction-hil/NAME. Needs root.
    """
    from friction_hil.cli.work.service import install  # imported here: --help must not wait for pydantic

    return install(**options)


@command.command()
@click.argument("name")
@_option_root
@option_json
def remove(**options: Any) -> int:
    """Stop the service NAME and remove its files; recordings stay. Needs root."""
    from friction_hil.cli.work.service import remove  # imported here: --help must not wait for pydantic

    return remove(**options)


@command.command()
@click.argument("name", required=False)
@option_json
def status(**options: Any) -> int:
    """Show what systemd says of the service NAME, or of all. Exit status 1 unless each is active."""
    from friction_hil.cli.work.service import status  # imported here: --help must not wait for pydantic

    return status(**options)
