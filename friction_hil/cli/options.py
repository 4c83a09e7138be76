"""Options that several commands have in common."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from friction_hil.cli.completion import complete_models

Command = TypeVar("Command", bound=Callable[..., Any])

option_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout and nothing else.")
option_verbose = click.option("-v", "--verbose", is_flag=True, help="Print the details too.")
option_reset_fault = click.option("--reset-fault", is_flag=True, help="Reset a fault of a drive before enabling it.")
option_axes = click.option(
    "--axis", "axes", multiple=True, metavar="NAME", help="Only the axis NAME; may be repeated. Default: all axes."
)
option_simulate = click.option(
    "--simulate",
    is_flag=True,
    help="Use simulated drives in place of the real ones, on a bus or lines of their own. They start and end with the "
    "command.",
)
option_daemon_pace = click.option(
    "--pace",
    type=click.Choice(["real", "sync"]),
    default="real",
    show_default=True,
    help="real: keep real time. sync: run as fast as drives simulated with --pace sync reply.",
)
option_families = click.option(
    "--models",
    default="all",
    show_default=True,
    metavar="all|NAME,NAME",
    shell_complete=complete_models,
    callback=lambda context, parameter, text: () if text == "all" else tuple(map(str.strip, text.split(","))),
    help="Families of friction models to try.",
)
option_lowpass = click.option("--lowpass", type=float, metavar="HZ", help="Low-pass all signals at HZ, without delay.")
option_validate = click.option(
    "--validate",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="RECORDING",
    help="Recording to judge by, not to fit to. Without any, parts of the others are held out. May be repeated.",
)
_RESULTS = (
    click.option(
        "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the random starting values."
    ),
    click.option("--output", type=click.Path(path_type=Path), metavar="MODEL.yaml", help="Write the model file."),
    click.option(
        "--report", type=click.Path(path_type=Path), metavar="FILE.html", help="Write a report with figures and tables."
    ),
)


def numbers(context: click.Context, parameter: click.Parameter, text: str | None) -> dict[str, float]:
    """Return the numbers of an option ``KEY=X,KEY=X``; empty without one."""
    found: dict[str, float] = {}
    for part in text.split(",") if text else ():
        key, _, value = part.partition("=")
        try:
            found[key.strip()] = float(value)
        except ValueError:
            raise click.BadParameter(f"{part!r} is not KEY=NUMBER") from None
    return found


def result_options(command: Command) -> Command:
    """Add ``--seed``, ``--output`` and ``--report`` of a command that makes a model file."""
    for option in reversed(_RESULTS):
        command = option(command)
    return command


def folder_option(default: str, replaced: str) -> Callable[[Command], Command]:
    """Return the option ``--output`` for a folder whose former content, ``replaced``, is overwritten."""
    return click.option(
        "--output",
        type=click.Path(file_okay=False, path_type=Path),
        default=Path(default),
        show_default=True,
        metavar="DIR",
        help=f"Folder for {replaced}; those of an earlier run are replaced.",
    )
