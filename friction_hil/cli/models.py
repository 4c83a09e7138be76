"""``friction-hil models``: the friction models, a description of each, and its picture."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.completion import complete_model
from friction_hil.cli.options import option_json


@click.command("models")
@click.argument("name", required=False, shell_complete=complete_model)
@click.option(
    "--draw",
    "picture",
    type=click.Path(path_type=Path),
    metavar="PICTURE",
    help="Draw torque over velocity, and over position in a slow cycle, into PICTURE (.png, .svg).",
)
@click.option(
    "--motion",
    metavar="KIND[:KEY=X,...]|FILE",
    help="With --draw: draw the torque along a motion, over time, position and velocity. sine and reversals take "
    "amplitude (rad or m) and frequency (Hz), reversals also small (share of the amplitude) and times (as fast), steps "
    "take velocity and frequency; all take periods. FILE is a recording with time_s and velocity or position.",
)
@click.option(
    "--beside",
    multiple=True,
    metavar="MODEL",
    shell_complete=complete_model,
    help="With --draw: draw this model into the same picture, and along a motion its difference from NAME. May be "
    "repeated.",
)
@click.option(
    "--export-all",
    "gallery",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    help="Export NAME, or without NAME all example model files and an example of each model, to every format into DIR, "
    "with plots and a page.",
)
@click.option(
    "--library", "is_library", is_flag=True, help="List actuators whose friction is known, from published recordings."
)
@option_json
def command(**options: Any) -> None:
    """List the friction models, or describe the model NAME: formula, parameters, source, example.

    NAME may be an actuator of --library, include values, as in
    lugre:sigma0=2000,coulomb=0.08,static=0.12,stribeck_velocity=0.2, or be a model file: then its values are shown, and
    --draw draws them with their modifiers. Without values, the example is drawn.
    """
    from friction_hil.cli.work.models import show_models  # imported here: --help must not wait for numba

    show_models(**options)
