"""``friction-hil config``: check configurations, show them in full, describe their format."""

from dataclasses import asdict

import click

from friction_hil.cli import Group
from friction_hil.cli.output import option_json, print_json
from friction_hil.errors import ConfigurationError, Problem


@click.group(cls=Group)
def command() -> None:
    """Check, show and describe configurations."""


@command.command()
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@option_json
def check(files: tuple[str, ...], as_json: bool) -> int:
    """Report every mistake of the configurations FILE..., and of the files that they name, with file and line.

    No bus is opened. Exit status 2 if there is any.
    """
    from friction_hil.config import file_problems, load

    reports: dict[str, tuple[Problem, ...]] = {}
    for file in files:
        try:
            reports[file] = tuple(file_problems(file, load(file)))
        except ConfigurationError as error:
            reports[file] = error.problems
    if as_json:
        found = [
            {"path": file, "problems": [asdict(problem) for problem in problems]} for file, problems in reports.items()
        ]
        print_json({"files": found})
    else:
        for file, problems in reports.items():
            for problem in problems:
                click.echo(str(problem), err=True)
            if not problems:
                click.echo(f"{file}: ok")
    return 2 if any(reports.values()) else 0


@command.command()
@click.argument("file", metavar="FILE")
def show(file: str) -> None:
    """Print the configuration FILE with its defaults filled in and its models inlined, as YAML."""
    from friction_hil.checked_yaml.text import dump
    from friction_hil.config import load, self_contained

    click.echo(dump(self_contained(load(file))), nl=False)


@command.command()
def schema() -> None:
    """Print the JSON Schema of configurations, for editors; it knows the installed drivers."""
    from friction_hil.config import json_schema

    print_json(json_schema())
