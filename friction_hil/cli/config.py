"""``friction-hil config``: check configurations, show them in full, describe their format."""

import click

from friction_hil.cli import Group
from friction_hil.cli.options import option_json


@click.group(cls=Group)
def command() -> None:
    """Check, show and describe configurations."""


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
