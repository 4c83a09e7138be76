"""Time to read recordings, compared with the bare library of each format, and to replay them.

The library reads the same file into the same arrays, without mapping, checks and units. Also reported are the rows a
second of MCAP, for the columns that a replay needs and for all columns, and the samples a second of a replay with
LuGre, compared with the model alone. The files are made by the benchmark and removed.
"""

import json
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import friction_hil as fh
from friction_hil.errors import FrictionHilError
from friction_hil.models.files import model_from_argument
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.columns import NAMES
from friction_hil.recordings.mcap_format import ROW_SCHEMA
from friction_hil.replay.comparison import replay
from tools.benchmarks import models
from tools.benchmarks.models import DT, Work, example, in_turns
from tools.benchmarks.report import Row, compare, note

# The libraries are imported in the functions that read: each is optional, and some take a second to import.
Columns = dict[str, Array]
Read = Callable[[Path], Columns]

ROWS = 60_000
TEXT_ROWS = 5_000  # text takes a hundred times as long
NEEDED = ("time_s", "position", "velocity", "torque")
LUGRE = "lugre:sigma0=2000,sigma1=1,coulomb=0.08,static=0.12,stribeck_velocity=0.2"


def csv(path: Path) -> Columns:
    """Read with pyarrow."""
    from pyarrow import csv as arrow_csv

    table = arrow_csv.read_csv(path)
    return {name: table.column(name).to_numpy() for name in table.column_names}


def parquet(path: Path) -> Columns:
    """Read with pyarrow."""
    from pyarrow import parquet as arrow_parquet

    table = arrow_parquet.read_table(path)
    return {name: table.column(name).to_numpy() for name in table.column_names}


def mf4(path: Path) -> Columns:
    """Read with asammdf."""
    import asammdf

    with asammdf.MDF(path) as mdf:
        signals = mdf.select([name for name in mdf.channels_db if name != "time"])
        return {signal.name: signal.samples for signal in signals} | {"time_s": signals[0].timestamps}


def hdf5(path: Path) -> Columns:
    """Read with h5py."""
    import h5py

    with h5py.File(path) as file:
        return {name: dataset[()] for name, dataset in file.items()}


def matlab(path: Path) -> Columns:
    """Read with scipy."""
    from scipy.io import loadmat

    return {name: value.ravel() for name, value in loadmat(path).items() if name[0] != "_"}


def npz(path: Path) -> Columns:
    """Read with numpy."""
    with np.load(path) as archive:
        return dict(archive)


def json_rows(path: Path) -> Columns:
    """Read with Python's json module, and make an array of each column."""
    rows = json.loads(path.read_bytes())
    return {name: np.array([row[name] for row in rows], dtype=np.float64) for name in rows[0]}


def mcap(path: Path) -> Columns:
    """Read with mcap's reader, without sorting, and decode all messages at once."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        reader: Any = make_reader(file)
        bodies = [message.data[4:] for _, _, message in reader.iter_messages("/bench", log_time_order=False)]
        schemas = reader.get_summary().schemas.values()
    (schema,) = (each for each in schemas if each.name == ROW_SCHEMA)
    fields = [line.split()[1] for line in schema.data.decode().splitlines()]
    table = np.frombuffer(b"".join(bodies)).reshape(len(bodies), len(fields))
    return dict(zip(fields, np.ascontiguousarray(table.T), strict=True))


@dataclass(frozen=True, slots=True)
class Format:
    """A format, and a function that reads only the numbers with its library."""

    suffix: str
    library: str
    read: Read
    is_text: bool = False


FORMATS = (
    Format(".csv", "pyarrow", csv, is_text=True),
    Format(".json", "json", json_rows, is_text=True),
    Format(".parquet", "pyarrow", parquet),
    Format(".mf4", "asammdf", mf4),
    Format(".h5", "h5py", hdf5),
    Format(".mat", "scipy", matlab),
    Format(".npz", "numpy", npz),
    Format(".mcap", "mcap", mcap),
)


def recording(rows: int) -> Recording:
    """Return a recording with all columns of the daemon: a motion, its LuGre torque, noise."""
    random = np.random.default_rng(1)
    columns: Columns = {name: random.normal(size=rows) for name in NAMES}
    velocity = models.recording(rows)
    torque = example("lugre").simulate(velocity, DT)
    columns["cycle"] = np.arange(rows, dtype=np.float64)
    columns["time_s"] = DT * columns["cycle"]
    columns["position"], columns["velocity"] = DT * np.cumsum(velocity), velocity
    columns["torque"] = torque + 1e-3 * columns["torque"]
    return Recording("", "bench", columns)


def run() -> list[Row]:
    """Measure everything, each format alternately with its library.

    Raises
    ------
    UsageError
        A library is not installed.
    FrictionHilError
        A library reads other values than friction_hil.
    """
    note(f"{len(NAMES)} columns, {ROWS} rows (text: {TEXT_ROWS}); processor time, medians of {models.ROUNDS} rounds")
    with tempfile.TemporaryDirectory() as folder:
        paths = written(Path(folder))
        work: dict[str, Work] = {}
        for each in FORMATS:
            path = paths[each.suffix]
            check(path, fh.recordings.read(path).columns, each.read(path))
            work[each.suffix] = 1, partial(fh.recordings.read, path)
            work[f"library {each.suffix}"] = 1, partial(each.read, path)
        path = paths[".mcap"]
        work["needed"] = 1, partial(fh.recordings.read, path, only=NEEDED)
        times = in_turns(work, "reading")
    return [
        *(
            compare(
                f"{each.suffix}, {TEXT_ROWS if each.is_text else ROWS} rows ({each.library})",
                "ms",
                in_ms(times[each.suffix]),
                in_ms(times[f"library {each.suffix}"]),
            )
            for each in FORMATS
        ),
        rate(f"MCAP, {len(NEEDED)} of {len(NAMES)} columns (mcap)", "rows", times["needed"], times["library .mcap"]),
        rate(f"MCAP, all {len(NAMES)} columns (mcap)", "rows", times[".mcap"], times["library .mcap"]),
        lugre(),
    ]


def written(folder: Path) -> dict[str, Path]:
    """Write a file of each format; return the paths by suffix."""
    whole, short = recording(ROWS), recording(TEXT_ROWS)
    paths = {each.suffix: folder / f"bench{each.suffix}" for each in FORMATS}
    for each in FORMATS:
        fh.recordings.write(paths[each.suffix], short if each.is_text else whole)
    return paths


def check(path: Path, ours: Columns, theirs: Columns) -> None:
    """Check that both do the same work: equal values, as contiguous float64 arrays.

    Raises
    ------
    FrictionHilError
        Columns, values or types differ.
    """
    if ours.keys() != theirs.keys() or any(not np.array_equal(ours[name], theirs[name]) for name in ours):
        raise FrictionHilError(f"{path.name}: the library reads other columns or values than friction_hil")
    for name, values in [*ours.items(), *theirs.items()]:
        if values.dtype != np.float64 or not values.flags.c_contiguous:
            raise FrictionHilError(f"{path.name}: {name} is not a contiguous float64 array: {values.dtype}")


def lugre() -> Row:
    """Measure the replay of a recording in memory with LuGre, samples a second, against the model alone."""
    log = recording(ROWS)
    model = model_from_argument(LUGRE)
    alone = fh.models.create("lugre", **model.friction.parameters)
    work: dict[str, Work] = {
        "replay": (1, partial(replay, log, {"lugre": model})),
        "simulate": (1, partial(alone.simulate, log["velocity"], DT)),
    }
    times = in_turns(work, "LuGre replay")
    return rate("LuGre replay (simulate alone)", "samples", times["replay"], times["simulate"])


def in_ms(times: Iterable[float]) -> list[float]:
    """Convert ns to ms."""
    return [each / 1e6 for each in times]


def rate(name: str, what: str, ours: Iterable[float], theirs: Iterable[float]) -> Row:
    """Return the row that compares times for ``ROWS`` rows, ns, as millions of rows a second of processor time."""
    return compare(name, f"M {what}/s", [ROWS * 1e3 / each for each in ours], [ROWS * 1e3 / each for each in theirs])
