"""The work of ``friction-hil config``: makes, checks, shows and describes configurations."""

import json
import os
import shlex
import zlib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from friction_hil.checked_yaml.text import dump
from friction_hil.cli.colour import echo_problems
from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import new_table, print_table, prose, say
from friction_hil.config import Configuration, file_problems, json_schema, load, located, missing_models, self_contained
from friction_hil.config.annotated import FILL_IN_MARK
from friction_hil.config.examples import copied, examples, summary
from friction_hil.config.new_file import SCHEMA_FILE, Wanted, new_configuration
from friction_hil.daemon.assembly import velocity_offset_shortage
from friction_hil.daemon.static_torque import largest_weights, static_torque_shortage
from friction_hil.errors import ConfigurationError, OptionError, Problem, UsageError

_SUFFIXES = (".yaml", ".yml")
_FIRST_PORT, _PORTS = 43200, 2000  # of simulated buses: files in different places do not share one


def check_files(files: Sequence[str], as_json: bool) -> int:
    """Print the mistakes of each configuration; return 2 if there is any."""
    reports: dict[str, tuple[Problem, ...]] = {}
    notes: dict[str, list[Problem]] = {}
    purposes: dict[str, str] = {}
    for file in files:
        try:
            configuration = load(file, needs_models=False)
            reports[file] = tuple(file_problems(file, configuration))
            purposes[file] = _purpose(configuration)
            notes[file] = [
                *missing_models(file, configuration),
                *_inert_adaptations(file, configuration),
                *_short_limits(file, configuration),
                *(
                    Problem(file, None, f"axes.{name}.model", axis.model.is_of_other_axis)
                    for name, axis in configuration.axes.items()
                    if axis.model.is_of_other_axis
                ),
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
                click.echo(f"{file}: ok{purposes[file]}")
                for note in notes[file]:
                    say(f"note: {note}", stderr=False)
    return 2 if any(reports.values()) else 0


def _purpose(configuration: Configuration) -> str:
    """Return what a configuration without drivers is for; empty for any other."""
    if not configuration.is_own_loop:
        return ""
    period = ", which gives period_s" if configuration.lacks_period else ""
    return f", for friction_hil.Compensator in a loop of your own{period}: it names no driver, which `run` would need"


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
    """Return a note for each limit of a torque or velocity offset that is too small for gravity or friction."""
    found: list[Problem] = []
    weights = largest_weights(configuration)
    for name, axis in configuration.axes.items():
        if text := velocity_offset_shortage(axis):
            found += located(file, OptionError(name, "compensation.velocity_offset.limit", text)).problems
        if text := static_torque_shortage(axis, weights.get(name)):
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


def write_new(*, file: str | None, example: str | None, force: bool, **given: Any) -> None:
    """Write a new configuration, or a copy of an example, and the schema for editors beside it."""
    target = _target(file, example)
    options = {name: value for name, value in given.items() if value is not None}
    if example is not None:
        _refuse_options(options)
        texts = copied(example, target)
    else:
        port = _FIRST_PORT + zlib.crc32(os.fsencode(target.absolute())) % _PORTS
        texts = {target: new_configuration(Wanted(path=target, port=port, **options))}
    taken = [path for path in texts if os.path.lexists(path) and (path == target or _differs(path, texts[path]))]
    if taken and not force:
        raise UsageError(f"{', '.join(map(str, taken))} exists already; --force overwrites it, another name keeps it")
    for path, text in texts.items():
        _write(path, text)
        click.echo(f"written: {path}")
    _write_schema(target.parent / SCHEMA_FILE)
    _print_rest(target)


def print_examples() -> None:
    """Print the names of the examples and what they show."""
    table = new_table("example", prose("what it shows"))
    for name, path in examples().items():
        table.add_row(name, summary(path))
    print_table(table)
    click.echo("\n'friction-hil config new --example NAME' copies one.")


def _target(file: str | None, example: str | None) -> Path:
    target = Path(file or f"{example or 'machine'}.yaml")
    if target.suffix not in _SUFFIXES:
        if target.suffix:
            raise UsageError(f"{target}: a configuration ends in .yaml")
        target = target.with_suffix(".yaml")
    return target


def _refuse_options(options: dict[str, Any]) -> None:
    given = [f"--{name.removeprefix('is_')}" for name, value in options.items() if value not in (None, False)]
    if given:
        raise UsageError(f"--example copies a file as it is: leave {', '.join(given)} out, and edit the copy")


def _differs(path: Path, text: str) -> bool:
    try:
        return path.read_text(encoding="utf-8") != text
    except (OSError, UnicodeDecodeError):
        return True


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None


def _write_schema(path: Path) -> None:
    """Write the schema for editors; a broken driver of another package is no reason to have no configuration."""
    try:
        schema = json_schema()
    except UsageError as error:
        click.echo(f"no schema for editors: {error}", err=True)
        return
    _write(path, json.dumps(schema) + "\n")
    click.echo(f"written: {path} (for editors)")


def _print_rest(target: Path) -> None:
    """Print what the user is to do next: the keys to fill in, then the command that checks the file."""
    try:
        configuration = load(target, needs_models=False)
        problems = file_problems(target, configuration)
        notes = missing_models(target, configuration)
    except ConfigurationError as error:
        problems, notes = list(error.problems), []
    lines = [(problem.line or 0, str(problem)) for problem in problems]
    reported = {line for line, _ in lines}
    for number, line in enumerate(target.read_text(encoding="utf-8").splitlines(), 1):
        if (
            f"# {FILL_IN_MARK}" in line and number not in reported
        ):  # a check that comes after the others will ask for it
            key = line.strip().partition(":")[0]
            lines.append((number, f"{target}:{number}: {key}: must be filled in; see its comment"))
    if lines:
        click.echo("\nTo be filled in or corrected before anything runs:")
    for _, text in sorted(lines):
        say(text, stderr=False)
    for note in notes:
        say(f"note: {note}", stderr=False)
    click.echo(f"\nNext: friction-hil config check {shlex.quote(str(target))}")
