"""A daemon in processes of its own, against simulated drives on a virtual bus, and what it costs."""

import json
import math
import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil import config, recordings
from friction_hil.checked_yaml.text import dump
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import FrictionHilError
from friction_hil.numerics.jit import Array
from tools.benchmarks.processes import PROGRAM, simulated
from tools.benchmarks.report import note

DEMO = Path(__file__).parents[3] / "config/demo.yaml"
NAME = "bench"
_NAMES = {"friction_hil.daemon.companion": "worker", "friction_hil.daemon.control": "server"}
_PATIENCE_S = 60.0
# A busy machine is to be measured: nothing that watches a drive on a live bus is to end the run.
_MOST_MISSED, _HEARTBEAT_S = 1000, 10.0


@dataclass(frozen=True, slots=True)
class Result:
    """Result of one run.

    Attributes
    ----------
    late_us : (n,) array
        Lateness of the cycles in motion, us, ascending.
    summary : dict
        What ``run --json`` printed.
    lost : int
        Rows that are not in the recording.
    after_restarts_us : (n,) array
        Lateness of the cycles right after a process was started again, us.
    """

    late_us: Array
    summary: dict[str, Any]
    lost: int
    after_restarts_us: Array


@dataclass(slots=True)
class Daemon:
    """A daemon that runs.

    Attributes
    ----------
    pid : int
        Of the control process.
    socket : Path
    from_cycle : int
        First cycle whose lateness counts.
    ready_s, enabled_s : float
        Time from the start of its process until its first cycle, and until all axes were in Operation enabled, s.
    """

    pid: int
    socket: Path
    from_cycle: int = 0
    ready_s: float = float("nan")
    enabled_s: float = float("nan")
    results: list[Result] = field(default_factory=list)

    def processes(self) -> dict[str, int]:
        """Return the processes of the daemon by their names: control, supervisor, worker, server, and others."""
        found = {"control": self.pid}
        for pid in _descendants(self.pid):
            words = Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
            module = next((word for word in words if word.startswith("friction_hil.daemon.")), words[0])
            found[_NAMES.get(module) or module.rpartition(".")[2]] = pid
        return found


def configured(axes: int, period_s: float, spin_us: int) -> dict[str, Any]:
    """Return a configuration with ``axes`` times the first axis of the demo, compensated from the start."""
    given = config.self_contained(config.load(DEMO))
    (axis, *_) = given["axes"].values()
    axis["compensation"]["baseline_s"] = 0.0
    axis["heartbeat_s"] = _HEARTBEAT_S
    del axis["limits"]["following_error"]
    given["axes"] = {f"x{node}": {**axis, "node": node} for node in range(1, axes + 1)}
    given["period_s"] = period_s
    given["realtime"] |= {"spin_us": spin_us, "max_missed": _MOST_MISSED}
    given["bus"] |= {"port": 43117}
    given.pop("recording", None)
    return given


@contextmanager
def running(
    folder: Path, axes: int, period_s: float, spin_us: int, duration_s: float, pace: str = "real"
) -> Iterator[Daemon]:
    """Run a daemon that records, and its drives; on leaving, its end is awaited and its result is there.

    With an infinite duration it is stopped on leaving.

    Raises
    ------
    FrictionHilError
        It did not start. A fault at its end is only told: what was measured before counts.
    """
    path = folder / f"{NAME}.yaml"
    path.write_text(dump(configured(axes, period_s, spin_us)))
    record = folder / "run.mcap"
    words = [*PROGRAM, "run", str(path), "--json", "--record", str(record), "--force", "--pace", pace]
    environment = os.environ | {"XDG_RUNTIME_DIR": str(folder), "NOTIFY_SOCKET": str(folder / "notify")}
    with simulated(path, pace), _Manager(folder / "notify") as manager, (folder / "told").open("w") as told:
        began_s = time.monotonic()
        if math.isfinite(duration_s):
            words += ["--duration", f"{duration_s:g}"]
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=told, text=True, env=environment)
        try:
            daemon = Daemon(process.pid, folder / "friction-hil" / f"{NAME}.sock")
            daemon.ready_s = manager.wait("READY=1") - began_s
            daemon.enabled_s = manager.wait("STATUS=running") - began_s
            yield daemon
            if math.isinf(duration_s):
                process.send_signal(signal.SIGINT)
                duration_s = 0.0
            printed, _ = process.communicate(timeout=duration_s + _PATIENCE_S)
        except TimeoutError:
            process.terminate()
            process.wait()
            text = (folder / "told").read_text().strip()
            raise FrictionHilError(f"the daemon has not enabled its axes: {text}") from None
        except BaseException:
            process.terminate()
            process.wait()
            raise
    if not printed:
        text = (folder / "told").read_text().strip()
        raise FrictionHilError(f"the daemon failed ({process.returncode}): {text}")
    summary = json.loads(printed)
    for fault in summary["faults"]:
        note(f"the run ended with a fault: {fault}")
    recording = recordings.read(record, "x1")
    is_counted = (recording["state"] == LoopState.RUNNING) & (recording["cycle"] >= daemon.from_cycle)
    late_us = np.sort(recording["late_us"][is_counted])
    restarts = np.array([event.cycle + 1.0 for event in recording.events if "takes over" in event.text])
    after_us = recording["late_us"][np.isin(recording["cycle"], restarts)]
    daemon.results.append(Result(late_us, summary, summary["cycles"] - len(recording), after_us))


class _Manager:
    """Service manager to which the daemon reports its states."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)

    def __enter__(self) -> "_Manager":
        self._path.unlink(missing_ok=True)
        self._socket.bind(str(self._path))
        self._socket.settimeout(_PATIENCE_S)
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def wait(self, message: str) -> float:
        """Return when a message came.

        Raises
        ------
        TimeoutError
            It did not come.
        """
        while (found := self._socket.recv(4096).decode()) != message:
            if found.startswith("STOPPING"):
                raise TimeoutError
        return time.monotonic()


def _descendants(pid: int) -> list[int]:
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            found += [int(child), *_descendants(int(child))]
    return found


def pss_kb(pid: int) -> float:
    """Return the proportional set size of a process, kB: its share of the pages that it has in memory."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    found = re.search(r"^Pss:\s+(\d+) kB", text, re.MULTILINE)
    if found is None:
        raise FrictionHilError(f"/proc/{pid}/smaps_rollup has no Pss")
    return float(found[1])


def busy_s(pid: int) -> float:
    """Return the time for which the main thread of a process has been on a processor, s."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) * 1e-9
