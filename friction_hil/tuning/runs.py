"""Runs of the daemon that record experiments and trials."""

import contextlib
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from friction_hil.config import Configuration
from friction_hil.daemon.notices import is_limit_cycle
from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.session import SessionResult, SessionSettings, run_session
from friction_hil.daemon.stop import stop_on_signals
from friction_hil.drive.codes import FaultCode
from friction_hil.errors import FrictionHilError
from friction_hil.recordings import Recording, read_all
from friction_hil.tuning.arm_box import has_box, refuse_outside
from friction_hil.tuning.motions import TuningError, held
from friction_hil.tuning.settings import Dialog, TuneSettings

_LOOK_S = 0.1


class Seconds:
    """Where the time of a tuning goes: seconds of motion, and of computing while nothing moves."""

    def __init__(self) -> None:
        self.motion_s = 0.0  # of all runs, as planned
        self._standstill_s = 0.0  # between two runs, without the time for an answer
        self._since: float | None = None  # that is counted next

    @property
    def figures(self) -> dict[str, float]:
        """Seconds by their names, up to now; those of enabling and disabling drives are in none of them."""
        after_s = 0.0 if self._since is None else time.monotonic() - self._since
        return {
            "motion_s": round(self.motion_s, 3),
            "computing_between_s": round(self._standstill_s, 3),
            "computing_after_s": round(after_s, 3),
        }

    @contextlib.contextmanager
    def moving(self, duration_s: float) -> Iterator[None]:
        """Count a run."""
        with self.asking():
            yield
        self.motion_s += duration_s
        self._since = time.monotonic()

    @contextlib.contextmanager
    def asking(self) -> Iterator[None]:
        """Count no time."""
        if self._since is not None:
            self._standstill_s += time.monotonic() - self._since
        yield
        if self._since is not None:
            self._since = time.monotonic()


class TuningRuns:
    """Runs of the daemon into one folder."""

    def __init__(self, settings: TuneSettings, dialog: Dialog) -> None:
        self._settings, self._dialog = settings, dialog
        self._reported: set[str] = set()
        self.recordings: list[Path] = []  # so far
        # of the daemon, each once; not those of limit cycles, which are results of a trial
        self.warnings: list[str] = []
        # what drives were left with after some run, in the words of their driver, each once
        self.leftovers: list[str] = []

    def run(self, configuration: Configuration, duration_s: float, file: str, speeds: Mapping[str, float]) -> Path:
        """Run the daemon once; return the path of the recording, which is complete.

        ``speeds`` are those that the axes may reach, by axis: one that is clearly faster ends the run.

        Raises `TuningError`: the run met a fault, or rows of its recording were lost; `UsageError`: the arm would leave
        its box, and nothing has moved; `KeyboardInterrupt`: the user stopped the run, and the axes are at rest.
        """
        path = self._settings.folder / file
        if has_box(configuration):
            refuse_outside(configuration, duration_s, self.look(configuration), path.stem.replace("_", " "))
        session = SessionSettings(
            duration_s=duration_s,
            record=path,
            is_fault_reset_wanted=self._settings.is_fault_reset_wanted,
            is_paced_by_sync=self._settings.is_paced_by_sync,
            is_status_shown=self._settings.is_status_shown,
            status_title=path.stem.replace("_", " "),
            has_black_box=False,  # all of a trial is recorded
            allowed_speeds=speeds,
        )
        with stop_on_signals() as stop:
            result = run_session(configuration, session, stop, self._report_once)
        self._check(result, path, tuple(configuration.axes), speeds)
        if stop.is_by_user:
            self._dialog.tell(f"stopped, the axes are at rest; the results so far are in {self._settings.folder}")
            raise KeyboardInterrupt
        return path

    def look(self, configuration: Configuration) -> dict[str, Recording]:
        """Return what the drives report while none is enabled."""
        path = self._settings.folder / "start.mcap"
        session = SessionSettings(
            _LOOK_S, record=path, dry_run=True, is_paced_by_sync=self._settings.is_paced_by_sync, has_black_box=False
        )
        try:
            with stop_on_signals() as stop:
                run_session(held(configuration), session, stop, self._report_once)
            return read_all(path)
        finally:
            path.unlink(missing_ok=True)

    def _check(self, result: SessionResult, path: Path, names: Sequence[str], speeds: Mapping[str, float]) -> None:
        report = result.report
        for warning in result.loop.warnings:
            # a model that makes an axis oscillate is reported with its trial, by name
            is_of_trial = any(is_limit_cycle(warning, name) for name in names)
            if not is_of_trial and warning not in self.warnings:
                self.warnings.append(warning)
        self.leftovers += (text for text in result.loop.leftovers if text not in self.leftovers)
        if report is not None and report.recording:
            self.recordings += map(Path, report.recording)
        if result.loop.faults:
            where, advice = f"; the run is in {path}", _advice(result.loop.faults, path, speeds)
            if not _has_run(path):
                path.unlink(missing_ok=True)
                where = "; nothing has moved"
            raise TuningError("; ".join(result.loop.faults) + advice + where)
        if report is None or report.lost or report.pending or not report.recording:
            problems = "; ".join(report.problems) if report is not None and report.problems else "rows were lost"
            raise TuningError(f"{path}: the recording is not complete: {problems}")

    def _report_once(self, line: str) -> None:
        if line not in self._reported:
            self._reported.add(line)
            self._dialog.report(line)


def _advice(faults: Sequence[str], path: Path, speeds: Mapping[str, float]) -> str:
    """Return what may be done about an axis that was faster than announced."""
    if not any(f"[{FaultCode.VELOCITY_LIMIT}]" in fault for fault in faults):
        return ""
    if driven := ", ".join(_moved_while_disabled(path, speeds)):
        return (
            f"; {driven} moved before the drive was enabled, so that a load turns the axis, e.g. the weight on a "
            "vertical one: a brake or a counterweight has to hold it while the drive is off (a simulated axis has a "
            "brake with simulation: {mechanics: {has_brake: true}})"
        )
    return (
        "; a loop that swings needs a lower velocity_gain; one that is soft, so that the axis jumps where it breaks "
        "away, needs a higher one, or a higher velocity in 'experiment'"
    )


def _moved_while_disabled(path: Path, speeds: Mapping[str, float]) -> list[str]:
    """Return the axes that were faster than they may be before their drives were first enabled."""
    found = []
    for name, recording in _rows(path).items():
        before = recording["velocity"][np.isin(recording["state"], (LoopState.IDLE, LoopState.ENABLING))]
        if np.any(np.abs(before) > speeds.get(name, math.inf)):
            found.append(name)
    return found


def _has_run(path: Path) -> bool:
    """True if a recording has rows in which an axis was commanded to move."""
    return any(np.any(each["state"] == LoopState.RUNNING) for each in _rows(path).values())


def _rows(path: Path) -> dict[str, Recording]:
    """Return the recordings of all axes; empty if there is no row, or no file."""
    try:
        return read_all(path)
    except FrictionHilError:
        return {}
