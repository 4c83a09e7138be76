"""The demo: simulated drives and the daemon as processes of their own, then a report of what they recorded."""

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.errors import FrictionHilError, RecordingError, UsageError

if TYPE_CHECKING:
    from friction_hil.analysis.circularity import Circularity
    from friction_hil.config import Configuration

REPORT, PICTURE, RECORDING = "report.html", "circularity.png", "recording.mcap"
_LAPS = 2
_PATIENCE_S = 20.0  # for a process that was told to end
_TICK_S = 0.2
_STOPPING_S = 1.5  # from the end of the motion to the daemon's

Tell = Callable[[str, float | None], None]
"""Takes what is going on, and the share of the whole that is done; or a remark, and None."""


class DemoError(FrictionHilError):
    """A process of the demo failed. Example: the bus does not open."""


class LoopFaultError(DemoError):
    """The daemon met a fault while the axes moved."""


@dataclass(frozen=True, slots=True)
class Demo:
    """What a demo leaves behind; ``loop`` is the daemon's own summary, ``pace`` is real or sync."""

    circularity: "Circularity"
    loop: dict[str, Any]
    pace: str
    report: Path
    picture: Path
    recording: Path


def run_demo(folder: Path, pace: str, tell: Tell) -> Demo:
    """Draw the circle and report on it.

    Parameters
    ----------
    folder : Path
        Where report, picture and recording go; made if need be. Those of a former demo are replaced.
    pace : str
        ``real``; ``sync``: in simulated time; or ``auto``: real, and where the computer does not keep up, sync.
    tell : callable

    Raises
    ------
    UsageError
        matplotlib is missing, or the folder has files of these names that are not a demo's.
    DemoError
        One of the processes failed; the message has what it said.
    RecordingError
        Too much was missed to judge.
    """
    from friction_hil.reports.figures import require_matplotlib

    require_matplotlib()
    claim(folder)
    with tempfile.TemporaryDirectory(prefix=".demo-", dir=folder) as name:
        work = Path(name)
        circularity, loop, notes, pace = _record(work, pace, tell)
        tell("making the report", 0.95)
        from friction_hil.reports.circularity_picture import draw_circle
        from friction_hil.reports.circularity_report import write_report

        circle = draw_circle(circularity)
        circle.savefig(work / PICTURE, dpi=130)
        write_report(work / REPORT, circularity, circle, loop, notes, pace)
        # the report first: it is what tells the next demo that the others are its own
        for made in (REPORT, PICTURE, RECORDING):
            os.replace(work / made, folder / made)
    return Demo(circularity, loop, pace, folder / REPORT, folder / PICTURE, folder / RECORDING)


def claim(folder: Path) -> None:
    """Make the folder of a demo.

    Raises
    ------
    UsageError
        Somebody else's files would be overwritten in it.
    """
    from friction_hil.reports.circularity_report import MARK

    folder.mkdir(parents=True, exist_ok=True)
    present = [name for name in (REPORT, PICTURE, RECORDING) if (folder / name).exists()]
    if not present:
        return
    report = folder / REPORT
    if not (report.is_file() and MARK in report.read_text(encoding="utf-8", errors="replace")[:1000]):
        raise UsageError(
            f"{folder / present[0]} exists and no former demo made it: it stays; name another folder with --output"
        )


def _private_configuration(work: Path) -> Path:
    """Copy the configuration that comes with the product, on a bus of its own."""
    from friction_hil.checked_yaml.text import dump, parse

    original = files("friction_hil.demo") / "demo.yaml"
    values = parse(original.read_text(encoding="utf-8"), str(original)).value
    values["bus"]["port"] = _free_port()
    del values["recording"]
    copy = work / "demo.yaml"
    copy.write_text(dump(values), encoding="utf-8")
    return copy


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port: int = probe.getsockname()[1]
        return port


def _record(work: Path, pace: str, tell: Tell) -> tuple["Circularity", dict[str, Any], str, str]:
    """Draw the circle; return what came of it, the daemon's summary, what it said, and the pace."""
    from friction_hil.analysis.circularity import analyse
    from friction_hil.recordings import read_all

    if pace == "auto":
        try:
            return _record(work, "real", tell)
        except (LoopFaultError, RecordingError) as error:
            tell(f"{error}\nThis computer is too busy for real time. Once more, in simulated time.", None)
            (work / RECORDING).unlink(missing_ok=True)
            pace = "sync"
    loop, notes = _run_processes(_private_configuration(work), pace, tell)
    return analyse(read_all(work / RECORDING)), loop, notes, pace


def _run_processes(path: Path, pace: str, tell: Tell) -> tuple[dict[str, Any], str]:
    """Run drives and daemon; return the daemon's summary, and what it said."""
    tell("starting the simulated drives", 0.0)
    with _Child(["simulate", str(path), "--exit-with-stdin"], pace, path.parent) as drives:
        # what this process will need is loaded now, beside the drives, and not when it would keep the user waiting
        import_module("matplotlib.figure")
        from friction_hil.analysis.circularity import duration_s
        from friction_hil.config import load

        configuration = load(path)
        moving_s = duration_s(configuration, _LAPS)
        while not drives.printed:
            drives.wait(_TICK_S)
            drives.refuse_failure()
        tell("starting the daemon", 0.1)
        run = ["run", str(path), "--duration", f"{moving_s:g}", "--record", str(path.parent / RECORDING), "--json"]
        with _Child(run, pace, path.parent) as daemon:
            if pace == "sync":
                tell("drawing the circle in simulated time", 0.15)
            began_s = 0.0
            while not daemon.wait(_TICK_S):
                if pace == "real" and daemon.said:  # it speaks when it has found its drives
                    began_s = began_s or time.monotonic()
                    tell(*_progress(configuration, time.monotonic() - began_s, moving_s))
            drives.refuse_failure()
            daemon.refuse_failure(LoopFaultError if daemon.printed else DemoError)
        return json.loads(daemon.printed), daemon.said


def _progress(configuration: "Configuration", elapsed_s: float, moving_s: float) -> tuple[str, float]:
    baseline_s = max(axis.compensation.baseline_s for axis in configuration.axes.values())
    which = "without" if elapsed_s < baseline_s else "with"
    return f"drawing the circle {which} compensation", 0.15 + 0.75 * min(elapsed_s / (moving_s + _STOPPING_S), 1.0)


class _Child:
    """A command of friction-hil as a process of its own, which ends with this one whatever happens.

    It is in a session of its own: Ctrl-C reaches it through us, in order. Its standard input is closed when this
    process is gone.
    """

    def __init__(self, arguments: Sequence[str], pace: str, folder: Path) -> None:
        self._name = arguments[0]
        self._out, self._err = folder / f"{self._name}.out", folder / f"{self._name}.err"
        with open(self._out, "wb") as out, open(self._err, "wb") as err:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "friction_hil", *arguments, "--pace", pace],
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=err,
                start_new_session=True,
            )

    def __enter__(self) -> "_Child":
        return self

    def __exit__(self, *_: object) -> None:
        process = self._process
        try:
            if process.poll() is None:
                process.terminate()  # both commands come to rest, or leave the bus, before they end
                process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            pass
        finally:
            process.kill()
            process.wait()
            assert process.stdin is not None
            process.stdin.close()

    def wait(self, timeout_s: float) -> bool:
        """Wait for its end; whether it has come."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)
        return self._process.returncode is not None

    def refuse_failure(self, error: type[DemoError] = DemoError) -> None:
        """Raise ``error`` with what it said if it has failed."""
        if status := self._process.poll():
            said = self.said.strip() or f"it ended with status {status}"
            raise error(f"'friction-hil {self._name}' failed:\n{said}")

    @property
    def printed(self) -> str:
        """Its standard output so far."""
        return self._out.read_text(encoding="utf-8")

    @property
    def said(self) -> str:
        """Its standard error so far."""
        return self._err.read_text(encoding="utf-8", errors="replace")
