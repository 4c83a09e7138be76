"""``friction-hil plot``: a recording as a picture or as an interactive page."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.options import option_json
from friction_hil.cli.recording_options import recording_options


@click.command("plot")
@click.argument("source", metavar="RECORDING", type=click.Path(path_type=Path))
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="A picture (.png, .svg, .pdf) or an interactive page (.html); by default RECORDING with .png.",
)
@click.option("--from", "begin", type=float, metavar="S", help="Draw from this time of the recording on.")
@click.option("--to", "end", type=float, metavar="S", help="Draw up to this time of the recording.")
@click.option(
    "--config",
    type=click.Path(path_type=Path),
    help="Configuration that describes a CAN log, or replaces the one inside a recording.",
)
@recording_options
@option_json
def command(**options: Any) -> None:
    """Draw a RECORDING: motion, following error, torques, timing of the loop, friction over velocity.

    Missed periods, faults and other events are marked. If the run had both (compensation.baseline_s), the following
    error without and with compensation is drawn side by side, with the figures of whole periods of steady motion. The
    configuration in a recording of the daemon gives model and units; --config does so for other recordings.

    A picture shows one axis; of a recording with several, each gets a file of its own, OUT_x.png. A page (.html) shows
    all axes, can be zoomed, and needs neither a network nor other files. Formats and columns are those of `convert`; a
    panel whose columns are missing is left out, and reported.
    """
    from friction_hil.cli.work.plot import plot  # imported here: --help must not wait for numba

    plot(**options)
