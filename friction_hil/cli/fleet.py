"""``friction-hil fleet``: one work on the recordings of many machines."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.options import option_json
from friction_hil.cli.recording_options import recording_options


@click.command("fleet")
@click.argument("work", metavar="WORK", type=click.Choice(["identify", "health", "convert", "verify"]))
@click.argument("sources", metavar="RECORDING...", nargs=-1, required=True)
@click.option(
    "--output",
    required=True,
    type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER",
    help="Folder for table.parquet, report.html and the files of the axes; what is done is kept there.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Distribute the recordings over the workers of the Dask scheduler at ADDRESS, e.g. tcp://10.0.0.5:8786, "
    "instead of the cores of this machine. The workers must reach them by the same paths or addresses.",
)
@recording_options
@click.option("--models", metavar="NAME,NAME", help="identify: families of friction models to try. [default: all]")
@click.option("--linear", is_flag=True, help="identify, health: linear axes: m, N, kg.")
@click.option("--to", metavar="SUFFIX", help="convert: format of the new files. [default: .parquet]")
@option_json
def command(**options: Any) -> int:
    """Do the same WORK for each RECORDING: identify, health, convert or verify; end with one table and one report.

    RECORDING may be a file, a folder, a quoted pattern 'logs/**/*.mcap', or an address in an object store,
    's3://bucket/logs/*.mcap'. health takes the recordings of one folder as those of one machine.

    Each recording that is done is kept in FOLDER at once. After an interruption or a lost cluster, the same command
    goes on with the others; those that failed or have changed are done again.
    """
    from friction_hil.cli.work.fleet import do_fleet  # imported here: --help must not wait for numba

    return do_fleet(**options)
