"""``friction-hil convert``: recordings from one format to another, and the content of one."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.options import option_json
from friction_hil.cli.recording_options import recording_options


@click.command("convert")
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.argument("target", metavar="[OUT]", type=click.Path(path_type=Path), required=False)
@click.option("--info", is_flag=True, help="Describe the content of IN; write nothing.")
@click.option("--config", type=click.Path(path_type=Path), help="Configuration that describes a CAN log.")
@click.option("--force", is_flag=True, help="Overwrite OUT if it exists.")
@recording_options
@option_json
def command(**options: Any) -> None:
    """Convert the recording IN to OUT; the suffixes give the formats.

    Reads .mcap, .csv, .txt, .tsv, .dat and .lvm (columns of numbers, with or without names), .parquet, .mf4 and .mdf,
    .h5 and .hdf5, .mat (MATLAB 4 to 7.3), .npz, .npy, .json (a list of rows), joint states of ROS in .mcap, .db3 and
    .bag, and logs of raw CAN frames (candump .log, .asc, .blf, .trc; --config describes them). Writes .mcap, .csv,
    .parquet, .mf4, .h5, .hdf5, .mat (MATLAB 5), .npz and .json. Parquet, MDF and HDF5 need:
    pip install "friction-hil[formats]".

    --info shows what a file of another program holds, what is suspicious in it, and the command that would read it.

    A table without time stamps takes its sampling rate: --rate 1000. Columns without names are column1, column2, ...,
    those of a matrix q[:,0], q[:,1], ... Files side by side are joined: position.csv --column torque=torque.csv:tau,
    at their times if both have a column of time stamps, else row by row.

    Values are kept bit for bit, units if the format can hold them. Each axis of a recording with several is written to
    a file of its own, OUT_x.csv; --axis selects one. Metadata, events and restart points are not converted.

    Instead of --column, a file IN.columns.yaml beside IN, or columns.yaml for all files of its folder, may contain
    `columns: {time_s: t, torque: vir*35.15}`. With --where, the torque is NaN in rows that are not used.

    The model file of a trained network is converted to ONNX, for controllers that run it: net.yaml net.onnx.
    """
    from friction_hil.cli.work.convert import convert  # imported here: --help must not wait for numba

    convert(**options)
