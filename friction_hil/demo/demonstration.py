"""The demo: simulated drives and the daemon as separate processes, then a report on their recording.

This process imports numpy, numba and matplotlib, and compiles what learning needs, while the drives start, so that the
user does not wait for both.
"""

import contextlib
import json
import os
import socket
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.checked_yaml.text import dump, parse
from friction_hil.daemon.child import Child
from friction_hil.daemon.control.ask import Question
from friction_hil.daemon.control.names import socket_path
from friction_hil.errors import FrictionHilError, RecordingError
from friction_hil.reports.figures import require_matplotlib
from friction_hil.reports.page import claim_folder, generator

if TYPE_CHECKING:
    from friction_hil.analysis.circularity import Circularity
    from friction_hil.config import Configuration

REPORT, PICTURE, RECORDING = "report.html", "circularity.png", "recording.mcap"
_LAPS = 2
# From the laps with the model as given to the end: six windows of learning (see its README.md). Where the computer
# misses periods, learning loses windows.
_LEARNING_S = {"real": 48.0, "sync": 37.0}
_COMPILING_S = 0.3
_TICK_S = 0.2
_LOOK_S = 1.0  # from one question to the daemon to the next
_PATIENCE_S = 0.5  # for its answer
_RESOLUTION = 1e-6  # rad; any, for the compilation
_STOPPING_S = 1.5  # from the end of the motion to the end of the daemon

ShowProgress = Callable[[str, float | None], None]
"""Takes a text and the completed fraction of the demo; or a remark, and None."""


class DemoError(FrictionHilError):
    """A process of the demo failed. Example: the bus does not open."""


class LoopFaultError(DemoError):
    """The daemon ended with a fault while the axes moved."""


@dataclass(frozen=True, slots=True)
class Demo:
    """Result of a demo; ``loop`` is the summary that the daemon prints, ``pace`` is real or sync."""

    circularity: "Circularity"
    loop: dict[str, Any]
    pace: str
    report: Path
    picture: Path
    recording: Path


def run_demo(folder: Path, pace: str, show: ShowProgress) -> Demo:
    """Let the simulated axes draw the circle without and with compensation and after learning, and write the report.

    ``folder``: for report, picture and recording, created if necessary; files of an earlier demo are replaced.
    ``pace``: ``real``; ``sync``: in simulated time; or ``auto``: real, and sync if the computer does not keep up.
    ``show`` shows the progress.

    Raises `UsageError`: matplotlib is missing, or the folder has files of these names that no demo made; `DemoError`:
    one of the processes failed; the message includes its output on stderr; `RecordingError`: too many cycles were
    missed for a result.
    """
    require_matplotlib()
    claim(folder)
    with tempfile.TemporaryDirectory(prefix=".demo-", dir=folder) as name:
        work = Path(name)
        circularity, loop, notes, pace = _record(work, pace, show)
        show("making the report", 0.95)
        # imported here: loaded while the drives start
        from friction_hil.reports.circularity_picture import draw_circle
        from friction_hil.reports.circularity_report import write_report

        circle = draw_circle(circularity)
        circle.savefig(work / PICTURE, dpi=130)
        write_report(work / REPORT, circularity, circle, loop, notes, pace)
        # the report first: by it the next demo recognises the other files as replaceable
        for made in (REPORT, PICTURE, RECORDING):
            os.replace(work / made, folder / made)
    return Demo(circularity, loop, pace, folder / REPORT, folder / PICTURE, folder / RECORDING)


def compile_demo(show: ShowProgress) -> None:
    """Compile for this machine what simulated drives, runs and learning need, by a fraction of a second of the demo."""
    with tempfile.TemporaryDirectory(prefix="friction-hil-") as work:
        _run_processes(private_configuration(Path(work)), "sync", show, _COMPILING_S)


def claim(folder: Path) -> None:
    """Create the folder of a demo; see `claim_folder`."""
    claim_folder(folder, (REPORT, PICTURE, RECORDING), generator("demo"), "demo")


def private_configuration(work: Path) -> Path:
    """Copy the configuration of the demo, turn learning on in it, and give it a bus of its own."""
    original = files("friction_hil.demo") / "demo.yaml"
    values = parse(original.read_text(encoding="utf-8"), str(original)).value
    values["bus"]["port"] = _free_port()
    del values["recording"]
    for axis in values["axes"].values():
        axis["compensation"]["learning"] = "on"
    copy = work / "demo.yaml"
    copy.write_text(dump(values), encoding="utf-8")
    return copy


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port: int = probe.getsockname()[1]
        return port


def _record(work: Path, pace: str, show: ShowProgress) -> tuple["Circularity", dict[str, Any], str, str]:
    """Draw the circle; return its analysis, the daemon's summary, its messages, and the pace."""
    path = private_configuration(work)
    if pace == "auto":
        # imported here: not for those who choose the pace
        from friction_hil.config import load
        from friction_hil.daemon.latency import why_not_real_time
        from friction_hil.daemon.realtime import RealClock

        show("looking how busy this computer is", 0.0)
        reason = why_not_real_time(RealClock(0), load(path).period_s)
        if not reason:
            try:
                return _record(work, "real", show)
            except (LoopFaultError, RecordingError) as error:
                (work / RECORDING).unlink(missing_ok=True)
                reason = f"this computer is too busy: {error}"
        show(f"{reason}. In simulated time:", None)
        pace = "sync"
    loop, notes = _run_processes(path, pace, show)
    # imported here: loaded while the drives start
    from friction_hil.analysis.circularity import analyse
    from friction_hil.recordings import read_all

    return analyse(read_all(work / RECORDING)), loop, notes, pace


def _run_processes(
    path: Path, pace: str, show: ShowProgress, moving_s: float | None = None
) -> tuple[dict[str, Any], str]:
    """Run drives and daemon for the laps, or ``moving_s``; return the daemon's summary and its messages."""
    show("starting the simulated drives", 0.0)
    with Child(["simulate", str(path), "--exit-with-stdin", "--pace", pace], path.parent) as drives:
        # imported here: while the drives start
        import_module("matplotlib.figure")
        from friction_hil.analysis.circularity import duration_s
        from friction_hil.config import load

        configuration = load(path)
        if moving_s is None:
            moving_s = duration_s(configuration, _LAPS) + _LEARNING_S[pace]
        _compile_learning(configuration)
        while not drives.printed:
            drives.wait(_TICK_S)
            drives.refuse_failure(DemoError)
        show("starting the daemon", 0.1)
        run = ["run", str(path), "--duration", f"{moving_s:g}", "--record", str(path.parent / RECORDING), "--json"]
        # what an earlier run has learned would spoil the comparison: its folder is empty
        state = {"STATE_DIRECTORY": str(path.parent)}
        name = f"demo-{os.getpid()}"  # another demo may run, or a daemon of the same configuration
        with Child([*run, "--pace", pace, "--name", name], path.parent, state) as daemon:
            progress = _Progress(configuration, moving_s, socket_path(name), pace)
            while not daemon.wait(_TICK_S):
                if pace == "sync" or daemon.said:  # its first message comes when it has found its drives
                    show(*progress.look())
            drives.refuse_failure(DemoError)
            if not daemon.printed:
                daemon.refuse_failure(DemoError)
        result = json.loads(daemon.printed)
        if result["faults"]:  # without the daemon's own words: they name files that are removed
            raise LoopFaultError("; ".join(result["faults"]))
        daemon.refuse_failure(DemoError)
        return result, daemon.said


def _compile_learning(configuration: "Configuration") -> None:
    """Compile what learning needs, which beside a loop in real time would take as long as the motion."""
    from friction_hil.learning.compilation import compile_learning
    from friction_hil.learning.estimate import Mechanics, first_belief

    for axis in configuration.axes.values():
        mechanics = Mechanics(axis.model.mechanics.inertia, (0.0, 0.0, 0.0))
        compile_learning(first_belief(axis.model.friction_model, mechanics, {}), configuration.period_s, _RESOLUTION)


class _Progress:
    """What the daemon does, by its own account.

    ``moving_s``: duration of the motion, s. ``socket``: control socket of the daemon. ``pace``: ``real`` or ``sync``.
    """

    def __init__(self, configuration: "Configuration", moving_s: float, socket: Path, pace: str) -> None:
        axes = configuration.axes.values()
        self._baseline_s = max(axis.compensation.baseline_s for axis in axes)
        self._learning_from_s = moving_s - _LEARNING_S[pace]
        self._moving_s, self._period_s = moving_s, configuration.period_s
        self._socket, self._pace = socket, pace
        self._next_look_s = 0.0
        self._elapsed_s, self._kept = 0.0, ""

    def look(self) -> tuple[str, float]:
        """Return a text and the completed fraction of the demo."""
        now_s = time.monotonic()
        if now_s >= self._next_look_s:
            self._next_look_s = now_s + _LOOK_S
            with contextlib.suppress(FrictionHilError):  # it is not there yet, or ends: it says itself if it fails
                with Question(self._socket, {"do": "status"}, _PATIENCE_S) as question:
                    while (status := question.answer()) is None:
                        pass
                self._take(status)
        done = 0.15 + 0.75 * min(self._elapsed_s / (self._moving_s + _STOPPING_S), 1.0)
        if self._pace == "sync":
            return "drawing the circle in simulated time", done
        if self._elapsed_s < self._baseline_s:
            return "drawing the circle without compensation", done
        if self._elapsed_s < self._learning_from_s:
            return "drawing the circle with compensation by the model as given", done
        return f"learning from the motion{self._kept}", done

    def _take(self, status: dict[str, Any]) -> None:
        """Take what the daemon says of itself."""
        self._elapsed_s = (status.get("cycle") or 0) * self._period_s
        kept = {}
        for name, axis in status.get("axes", {}).items():
            if report := axis["learning"]:
                kept[name] = report["re_identified"] + (report["residual_layer"]["state"] == "on")
        if any(kept.values()):
            self._kept = f"; kept so far: {', '.join(f'{name} {count}' for name, count in kept.items())}"
