"""The work of ``friction-hil config``."""

from collections.abc import Sequence
from dataclasses import asdict

import click

from friction_hil.checked_yaml.text import dump
from friction_hil.cli.colour import problem_line
from friction_hil.cli.output import print_json
from friction_hil.config import file_problems, json_schema, load, self_contained
from friction_hil.errors import ConfigurationError, Problem


def check_files(files: Sequence[str], as_json: bool) -> int:
    """Print the mistakes of each configuration; return 2 if there is any."""
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
                click.echo(problem_line(problem), err=True)
            if not problems:
                click.echo(f"{file}: ok")
    return 2 if any(reports.values()) else 0


def show_file(file: str) -> None:
    """Print a configuration with its defaults and models, as YAML."""
    click.echo(dump(self_contained(load(file))), nl=False)


def print_schema() -> None:
    """Print the JSON Schema of configurations."""
    print_json(json_schema())
