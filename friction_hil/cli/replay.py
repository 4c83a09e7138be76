"""``friction-hil replay``: recordings through friction models, and the compensator run again."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.completion import complete_model
from friction_hil.cli.options import option_json, option_lowpass
from friction_hil.cli.recording_options import recording_options


@click.command("replay")
@click.argument("sources", metavar="RECORDING...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--model",
    "model_arguments",
    multiple=True,
    metavar="FILE_OR_NAME",
    shell_complete=complete_model,
    help="Model file, pattern of model files, or NAME:coulomb=0.08,viscous=2e-3. May be repeated.",
)
@click.option(
    "--verify",
    "is_verifying",
    is_flag=True,
    help="Run the daemon's compensator again and compare every bit.",
)
@click.option(
    "--config",
    type=click.Path(path_type=Path),
    help="Configuration that describes a CAN log, or replaces the one inside a recording.",
)
@recording_options
@option_lowpass
@click.option(
    "--decimate",
    type=click.IntRange(min=1),
    metavar="N",
    help="Use every N-th sample; as 'identify' does by default. 1 compares every sample, with the noise of the torque.",
)
@click.option("--output", type=click.Path(path_type=Path), metavar="PICTURE", help="Draw into PICTURE (.png, .svg).")
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Distribute the files over the workers of the Dask scheduler at ADDRESS, e.g. tcp://10.0.0.5:8786, instead of "
    "the cores of this machine. The workers must reach the files by the same paths.",
)
@option_json
def command(**options: Any) -> int:
    """Predict the torque of each RECORDING with each model, and compare it with the measured torque.

    RECORDING may be a pattern, also a quoted one: 'logs/**/*.mcap'. The files are distributed over all cores; a file
    that cannot be read is reported and does not stop the others. Formats and columns are those of `convert`.

    Without --model, a recording of the daemon is compared with the model that it ran with. Velocity and acceleration
    are derived from the position if there is no velocity, or with --lowpass. The error is the relative_error that
    'identify' and 'train' print, of torques that were prepared alike: norm(measured - predicted) / norm(measured).

    --verify feeds the recording through the whole compensator, which must reproduce the recorded compensation. If it
    does not, the first cycle that differs is reported, and the exit status is 1.
    """
    from friction_hil.cli.work.replay import replay  # imported here: --help must not wait for numba

    return replay(**options)
