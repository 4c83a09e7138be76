"""``friction-hil identify``: friction, inertia, offset and gravity of an axis from its recordings."""

import math
from pathlib import Path
from typing import Any

import click

from friction_hil.cli.options import option_families, option_json, option_validate, option_verbose, result_options
from friction_hil.cli.recording_options import recording_options


def _pairs(context: click.Context, parameter: click.Parameter, words: tuple[str, ...]) -> dict[str, float]:
    values: dict[str, float] = {}
    for word in words:
        name, sign, text = word.partition("=")
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not (name and sign) or math.isnan(number):
            raise click.BadParameter(f"{word!r} does not have the form 'name=1.5'")
        if name in values:
            raise click.BadParameter(f"{name!r} is given twice")
        values[name] = number
    return values


_OF_JOINTS = ("joints", "torque", "velocity", "arm", "arm_joints", "signs", "config")


@click.command("identify")
@click.argument("sources", metavar="RECORDING...", nargs=-1, required=True, type=click.Path(path_type=Path))
@option_families
@option_validate
@click.option(
    "--fix",
    multiple=True,
    callback=_pairs,
    metavar="NAME=VALUE",
    help="Hold a parameter at a value. May be repeated.",
)
@click.option(
    "--linear",
    is_flag=True,
    help="A linear axis: m, N, kg. A recording of run says it itself.",
)
@click.option(
    "--static",
    is_flag=True,
    help="The files are maps of friction: points of velocity and torque at constant speeds, without time and position.",
)
@click.option(
    "--gravity",
    type=click.Choice(["auto", "none", "constant", "pendulum"]),
    default="auto",
    show_default=True,
    help="constant: a vertical axis. pendulum: sine and cosine of the position. auto: a pendulum if that predicts "
    "held-out data better.",
)
@click.option(
    "--unknown-gain",
    is_flag=True,
    help="The column torque is a signal of unknown gain (volts, amperes, duty cycle): identify gain and back-EMF. The "
    "scale comes from what --fix holds, e.g. inertia, or gravity.sine with the value of mass * 9.81 * length.",
)
@click.option(
    "--min-speed",
    type=click.FloatRange(min=0.0),
    default=0.0,
    metavar="SPEED",
    help="Ignore rows at which the axis is slower, rad/s or m/s: at rest, friction is not determined by the motion.",
)
@click.option(
    "--group-by",
    metavar="ENTRY",
    help="Hold out together the recordings that have the same value of ENTRY in their metadata, e.g. trajectory.",
)
@click.option(
    "--torque-is",
    type=click.Choice(["auto", "mean", "instant"]),
    default="auto",
    show_default=True,
    help="The torque that the drive reports: its mean since the last sample, or the value at the sample. auto: found "
    "from recordings that show presliding.",
)
@click.option(
    "--refine/--no-refine",
    default=None,
    help="Fit the chosen dynamic model again with the full bandwidth of the encoder.  [default: if presliding shows]",
)
@recording_options
@click.option(
    "--joints",
    metavar="PATTERN|NAMES",
    help="All joints of one log at once: position columns by a pattern, e.g. 'q{}', or axes of the file by name, e.g. "
    "shoulder,elbow; 'all' of them.",
)
@click.option(
    "--torque",
    metavar="PATTERN",
    help="With --joints: torque columns, e.g. 'tau{}*0.5', or one for each joint, e.g. 'tau1*-1,tau2'.",
)
@click.option(
    "--velocity",
    metavar="PATTERN",
    help="With --joints: velocity columns, e.g. 'dq{}'.  [default: from the positions]",
)
@click.option(
    "--urdf",
    "--arm",
    "arm",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="With --joints: URDF or MJCF of the arm. Its own dynamics are refitted and told from the friction, also from "
    "friction that grows with the load.",
)
@click.option(
    "--urdf-joints",
    "arm_joints",
    metavar="NAMES",
    help="Joints of that file in the order of the log, e.g. a,b,c.  [default: those of the same names, or all]",
)
@click.option(
    "--signs", metavar="SIGNS", help="1 or -1 for each joint: -1 where the log counts against the file, e.g. 1,-1,1."
)
@click.option(
    "--config",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="With --joints and --output: also write a configuration of these joints for fh.Compensator, with limits from "
    "the log.",
)
@click.option(
    "--lowpass",
    type=float,
    metavar="HZ",
    help="Derive the velocity from the position, low-passed at HZ without delay.",
)
@click.option(
    "--decimate",
    type=click.IntRange(min=1),
    metavar="N",
    help="Compare every N-th sample, behind a filter. Models run at the full rate.  [default: 10, less in a short "
    "recording]",
)
@click.option(
    "--loss",
    type=click.Choice(["squares", "huber"]),
    default="squares",
    show_default=True,
    help="huber: give outliers less weight.",
)
@click.option(
    "--controller",
    callback=_pairs,
    multiple=True,
    metavar="NAME=VALUE",
    help="position_gain (1/s) and velocity_gain (torque per velocity) of the loop that made the motion: also simulate "
    "the axis in closed loop, from position_demand.",
)
@result_options
@option_verbose
@option_json
def command(**options: Any) -> int:
    """Identify the friction model of an axis, its parameters with errors, inertia, offset and gravity.

    Every family of models is fitted, first plain and with parameters for each direction; the best ones then with
    further modifiers. Each candidate is judged by data that it was not fitted to: the recordings of --validate, or
    strokes of some speeds and blocks of time that are held out in turn. The simplest candidate within a standard error
    of the best is chosen.
    """
    # imported here: --help must not wait for numba
    of_joints = {name: options.pop(name) for name in _OF_JOINTS}
    if of_joints["joints"] is None:
        if given := [name for name, value in of_joints.items() if value is not None]:
            raise click.UsageError(f"--{given[0].replace('arm', 'urdf').replace('_', '-')} needs --joints")
        from friction_hil.cli.work.identify import identify_axis

        return identify_axis(**options)
    from friction_hil.cli.work.identify_joints import identify_all

    return identify_all(**options, **of_joints)
