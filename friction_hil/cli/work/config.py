"""The work of ``friction-hil config``."""

from collections.abc import Sequence
from dataclasses import asdict

import click

from friction_hil.checked_yaml.text import dump
from friction_hil.cli.colour import echo_problems
from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import say
from friction_hil.config import Configuration, file_problems, json_schema, load, located, missing_models, self_contained
from friction_hil.daemon.static_torque import static_torque_shortage
from friction_hil.errors import ConfigurationError, OptionError, Problem


def check_files(files: Sequence[str], as_json: bool) -> int:
    """Print the mistakes of each configuration; return 2 if there is any."""
    reports: dict[str, tuple[Problem, ...]] = {}
    notes: dict[str, list[Problem]] = {}
    for file in files:
        try:
            configuration = load(file, needs_models=False)
            reports[file] = tuple(file_problems(file, configuration))
            notes[file] = [
                *missing_models(file, configuration),
                *_inert_adaptations(file, configuration),
                *_short_limits(file, configuration),
            ]
        except ConfigurationError as error:
            reports[file] = error.problems
    if as_json:
        found = [
            {"path": file, "problems": list(map(asdict, problems)), "notes": list(map(asdict, notes.get(file, ())))}
            for file, problems in reports.items()
        ]
        print_json({"files": found})
    else:
        for file, problems in reports.items():
            echo_problems(problems)
            if not problems:
                click.echo(f"{file}: ok")
                for note in notes[file]:
                    say(f"note: {note}", stderr=False)
    return 2 if any(reports.values()) else 0


def _inert_adaptations(file: str, configuration: Configuration) -> list[Problem]:
    """Return a note for each axis whose adaptation will learn nothing in the configured motion."""
    adapting = {name: axis for name, axis in configuration.axes.items() if axis.compensation.adaptation is not None}
    if not adapting:
        return []
    from friction_hil.daemon.adaptation_check import adaptation_problem  # imported here: it is slow to load

    found: list[Problem] = []
    for name, axis in adapting.items():
        if text := adaptation_problem(name, axis, configuration.period_s):
            found += located(file, OptionError(name, "compensation.adaptation", text)).problems
    return found


def _short_limits(file: str, configuration: Configuration) -> list[Problem]:
    """Return a note for each axis whose torque limit is too small for the feed-forward of gravity."""
    found: list[Problem] = []
    for name, axis in configuration.axes.items():
        if text := static_torque_shortage(axis):
            found += located(file, OptionError(name, "limits.torque", text)).problems
    return found


def show_file(file: str) -> None:
    """Print a configuration with its defaults and models, as YAML; a model file that is not there yet by its path."""
    configuration = load(file, needs_models=False)
    values = self_contained(configuration)
    for note in missing_models(file, configuration):
        say(f"note: {note}")
        name = note.field.split(".")[1]
        values["axes"][name]["model"] = str(configuration.axes[name].model.source_path)
    click.echo(dump(values), nl=False)


def print_schema() -> None:
    """Print the JSON Schema of configurations."""
    print_json(json_schema())
