"""The whole daemon against simulated drives: lateness, start, memory, processor time.

Daemon, companion, server and simulated drives run as for a user, on a virtual bus, and record. Lateness is compared
with that of cyclictest, which runs in turn with the daemon at the same priority, alone or under the same stress. The
simulated drives take processor time that real ones do not: on few processors a part of the lateness is theirs.
"""

import contextlib
import math
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np

from friction_hil.cli.options import option_json
from friction_hil.config import Realtime
from friction_hil.daemon.control.ask import ask
from friction_hil.daemon.latency import INSTALL_CYCLICTEST, Latency, cyclictest, has_cyclictest, is_fifo_allowed
from friction_hil.errors import FrictionHilError
from friction_hil.numerics.jit import Array
from tools.benchmarks.loop import restart
from tools.benchmarks.loop.daemon import Daemon, busy_s, pss_kb, running
from tools.benchmarks.loop.observers import watching
from tools.benchmarks.report import Row, against, compare, note, rounds, show

PARTS = ("start", "compute", "lateness", "memory", "restart")
ROUNDS = 3
STARTS = 3
QUANTILES = {"p50": 0.5, "p99": 0.99}
LATENESS_TARGET_US, START_TARGET_S, COMPUTE_TARGET = 2.0, 3.0, 40.0
_WARM_UP_S = 75.0  # of memory: the worker fills that of the last minute first
_LOOKS_PER_S = 1.0
_COUNTED, _LOOK_S = 0.7, 0.05  # part of a run in simulated time that is measured; s between two looks


@click.command()
@click.argument("parts", nargs=-1, type=click.Choice(PARTS))
@click.option("--duration", default=10.0, show_default=True, type=click.FloatRange(2.0), help="Seconds of each run.")
@click.option("--axes", default=2, show_default=True, type=click.IntRange(1, 16), help="Axes, for lateness and memory.")
@click.option(
    "--observers",
    type=click.IntRange(0, 32),
    help="Attach the monitor, so many viewers of the page, and a Foxglove client. Default: nothing.",
)
@click.option("--stress", is_flag=True, help="Load the last processor with stress-ng.")
@option_json
def command(
    parts: tuple[str, ...], duration: float, axes: int, observers: int | None, stress: bool, as_json: bool
) -> None:
    """Measure PARTS of the daemon; by default all.

    start: to Operation enabled. compute: processor time of the control process in a cycle, in simulated time.
    lateness: of the cycles, against cyclictest. memory: of all processes; --duration 3600 for an hour.
    restart: lateness of the loop when the processes beside it are killed and started again.
    """
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as name, _stressed(stress):
        folder = Path(name)
        folder.chmod(0o700)
        for part in [part for part in PARTS if part in parts or not parts]:
            if part == "start":
                rows += _start(folder)
            elif part == "compute":
                rows += _compute(folder, duration)
            elif part == "lateness":
                rows += _lateness(folder, axes, duration, observers)
            elif part == "restart":
                rows += restart.measure(folder, axes)
            else:
                rows += _memory(folder, axes, duration, observers)
    show(rows, as_json=as_json)


@contextlib.contextmanager
def _stressed(is_wanted: bool) -> Iterator[None]:
    """Keep the last processor busy.

    Raises
    ------
    FrictionHilError
        stress-ng is not installed.
    """
    if not is_wanted:
        yield
        return
    if shutil.which("stress-ng") is None:
        raise FrictionHilError("stress-ng is not installed: sudo apt install stress-ng")
    last = max(os.sched_getaffinity(0))
    with subprocess.Popen(["stress-ng", "--cpu", "1", "--taskset", str(last), "--quiet"]) as process:
        try:
            yield
        finally:
            process.terminate()


def _start(folder: Path) -> list[Row]:
    """Start a daemon with two axes several times."""
    ready, enabled = [], []
    for _ in rounds(STARTS, "start"):
        with running(folder, 2, 1e-3, 0, 1.0) as daemon:
            ready.append(daemon.ready_s)
            enabled.append(daemon.enabled_s)
    return [
        Row("start of the process to the first cycle", float(np.median(ready)), "s"),
        against(START_TARGET_S, "start of the process to Operation enabled (target)", "s", float(np.median(enabled))),
    ]


def _compute(folder: Path, duration_s: float) -> list[Row]:
    """Measure in simulated time: the drives, which one process simulates, need not keep up with the period."""
    rows = []
    for axes, period_s in ((2, 5e-4), (8, 1e-3)):
        label = f"{axes} axes at {1.0 / period_s:.0f} Hz"
        note(label)
        with running(folder, axes, period_s, 0, duration_s, "sync") as daemon:
            before_s, first = busy_s(daemon.pid), _cycle(daemon)
            while (cycle := _cycle(daemon)) - first < _COUNTED * duration_s / period_s:
                time.sleep(_LOOK_S)
            share = (busy_s(daemon.pid) - before_s) / ((cycle - first) * period_s)
        (result,) = daemon.results
        if result.summary["faults"]:
            note(f"{label} is left out: the processor time of a run that a fault has ended says nothing")
            continue
        name = f"{label}: time of control per cycle in simulated time, of the period (target)"
        rows.append(against(COMPUTE_TARGET, name, "%", 100.0 * share))
    return rows


def _cycle(daemon: Daemon) -> int:
    """Return the number of the daemon's latest cycle."""
    return int(ask(daemon.socket, {"do": "status"})["cycle"])


def _lateness(folder: Path, axes: int, duration_s: float, observers: int | None) -> list[Row]:
    if not has_cyclictest():
        raise FrictionHilError(f"cyclictest is not installed: {INSTALL_CYCLICTEST}")
    defaults = Realtime()
    priority = defaults.priority if is_fifo_allowed(defaults.priority) else 0
    note(f"both under SCHED_FIFO {priority}" if priority else "SCHED_FIFO is not allowed here: ordinary scheduling")
    rows = []
    for period_s in (1e-3, 5e-4):
        ours: dict[int, list[Latency]] = {0: [], defaults.spin_us: []}
        theirs: list[Latency] = []
        lost = 0
        label = f"{1.0 / period_s:.0f} Hz"
        for _ in rounds(ROUNDS, f"daemon and cyclictest at {label}"):
            theirs.append(cyclictest(priority, period_s, round(duration_s / period_s), is_fine=True))
            for spin_us, series in ours.items():
                with running(folder, axes, period_s, spin_us, math.inf) as daemon, contextlib.ExitStack() as stack:
                    if observers is not None:
                        stack.enter_context(watching(daemon.socket, observers))
                    daemon.from_cycle = _cycle(daemon)
                    time.sleep(duration_s)
                (result,) = daemon.results
                series.append(Latency(result.late_us, result.summary["missed"]))
                lost += result.lost
        for name, quantile in QUANTILES.items():
            references = [each.percentile_us(quantile) for each in theirs]
            values = [each.percentile_us(quantile) for each in ours[0]]
            rows.append(compare(f"late {name}, {label}, without spin (cyclictest)", "us", values, references))
        spun = float(np.median([each.percentile_us(0.99) for each in ours[defaults.spin_us]]))
        rows.append(against(LATENESS_TARGET_US, f"late p99, {label}, with spin (target)", "us", spun))
        rows.append(Row(f"{label}: rows lost", lost, ""))
    return rows


def _memory(folder: Path, axes: int, duration_s: float, observers: int | None) -> list[Row]:
    """Sample the memory of each process at 1 kHz, and fit a straight line after the warm-up."""
    taken: dict[str, list[float]] = {}
    times_s: list[float] = []
    with running(folder, axes, 1e-3, 0, math.inf) as daemon, contextlib.ExitStack() as stack:
        if observers is not None:
            stack.enter_context(watching(daemon.socket, observers))
        processes = daemon.processes()
        began_s = time.monotonic()
        while (now_s := time.monotonic() - began_s) < duration_s:
            times_s.append(now_s)
            for name, pid in processes.items():
                taken.setdefault(name, []).append(pss_kb(pid))
            time.sleep(1.0 / _LOOKS_PER_S)
    rows = []
    if duration_s < 2.0 * _WARM_UP_S:
        note(f"less than {2.0 * _WARM_UP_S:g} s: the memory of the last minute still fills, and counts as growth")
    first = int(np.searchsorted(times_s, min(_WARM_UP_S, 0.5 * duration_s)))
    for name, series in taken.items():
        slope, error = _slope(np.array(times_s[first:]), np.array(series[first:]))
        first_mib, last_mib = series[0] / 1024.0, series[-1] / 1024.0
        rows.append(Row(f"memory of {name} at the end (start)", last_mib, "MiB", first_mib, last_mib / first_mib))
        rows.append(
            Row(f"memory of {name}: growth (standard error)", 60.0 * slope, "kB/min", 60.0 * error, slope / error)
        )
    rows.append(Row(f"rows lost in {duration_s:g} s at 1000 Hz", daemon.results[0].lost, ""))
    return rows


def _slope(times: Array, values: Array) -> tuple[float, float]:
    """Return the slope of a straight line through (n,) values, and its standard error; NaN from fewer than three."""
    if len(times) < 3:
        return math.nan, math.nan
    centred = times - times.mean()
    slope = float(centred @ values / (centred @ centred))
    left = values - values.mean() - slope * centred
    return slope, math.sqrt(float(left @ left) / (len(times) - 2) / float(centred @ centred))
