"""Rolling figures of a daemon from its rows and events: the one source of what monitor, dashboard and metrics show.

Pure: no clock, no files; the same readings give the same figures.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from friction_hil.daemon.control.state import Messages
from friction_hil.daemon.figures import Condition, ErrorFigures
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState
from friction_hil.drive.codes import code_of
from friction_hil.live.following_error import RollingErrors, missed_before
from friction_hil.live.friction_map import FrictionTracer
from friction_hil.live.lateness import LatenessFigures
from friction_hil.live.reading import LiveFacts, Reading, Rows, Settings
from friction_hil.live.snapshot import AxisSnapshot, Message, Snapshot
from friction_hil.live.window import Window

WINDOW_S = 10.0
_MAP_WINDOWS = 6  # the friction over velocity is of the last so many windows
_LAST = (
    *("position", "velocity", "torque", "position_demand", "velocity_demand", "compensation", "command"),
    *("temperature", "temperature_estimate", "drive_state", "is_fresh", "is_enabled"),
)
_UNTIMED = (LoopState.IDLE, LoopState.WAITING)  # nothing moves, and no missed period counts


class LiveFigures:
    """Figures of a daemon.

    Compiles what it needs, which takes a while for the first time on a machine: make it before the first
    `friction_hil.live.Live.read`, so that no rows are lost meanwhile.

    ``faults``: that nobody had reset when this was attached, `friction_hil.live.Live.faults`. ``window_s``: duration
    over which following error, compensation and lateness are computed, s; friction over velocity is of the last six
    windows.
    """

    def __init__(self, facts: LiveFacts, faults: Sequence[str] = (), window_s: float = WINDOW_S) -> None:
        self._facts, self._window_s = facts, window_s
        self._messages = Messages(faults=list(faults))
        self._lateness = LatenessFigures(round(window_s / facts.period_s))
        self._axes = {name: _AxisFigures(facts, name, window_s) for name in facts.axes}
        self._last: dict[str, float] = dict.fromkeys(("time_s", "cycle", "state", "change"), math.nan)
        self._missed = self._lost = 0
        self._stands = self._is_over = False

    def take(self, reading: Reading) -> None:
        """Take what was read."""
        for event in reading.events:
            self._messages.take(event.name, event.text)
        self._stands, self._is_over = reading.stands, reading.is_over
        self._lost += reading.lost
        rows = reading.rows
        if len(rows):
            first = self._facts.axes[0]
            missed = missed_before(rows.of(first, "cycle"), self._last["cycle"], reading.lost)
            is_timed = ~np.isin(rows.of(first, "state"), _UNTIMED)
            self._missed += int(np.nansum(missed[is_timed]))
            self._lateness.take(rows.of(first, "late_us"))
            self._last = {name: float(rows.of(first, name)[-1]) for name in self._last}
        for name, axis in self._axes.items():
            axis.take(rows, reading.settings, reading.lost)
            axis.learning = reading.learning.get(name, axis.learning)
            axis.hear(self._messages.error_without.get(name))

    def snapshot(self) -> Snapshot:
        """Return the figures after what was taken so far."""
        facts, last = self._facts, self._last
        is_known = not (self._stands or self._is_over)
        return Snapshot(
            name=facts.name,
            source=facts.source,
            version=facts.version,
            state=self._state(),
            stands=self._stands,
            is_over=self._is_over,
            time_s=last["time_s"],
            cycle=_whole(last["cycle"]),
            change=_whole(last["change"]),
            period_s=facts.period_s,
            window_s=self._window_s,
            missed=self._missed,
            lost=self._lost,
            lateness=self._lateness.figures(),
            faults=self._told(self._messages.faults),
            warnings=self._told(self._messages.warnings),
            notices=self._told(self._messages.notices),
            axes={name: axis.snapshot(self._messages, is_known=is_known) for name, axis in self._axes.items()},
        )

    def _state(self) -> str:
        if self._is_over:
            return "ended"
        state = self._last["state"]
        if self._stands or not math.isfinite(state):
            return "unknown"
        return LoopState(int(state)).name.lower().replace("_", " ")

    def _told(self, texts: Sequence[str]) -> tuple[Message, ...]:
        return tuple(Message(text, code_of(text), self._facts.remedy(text)) for text in texts)


class _AxisFigures:
    """Figures of one axis."""

    def __init__(self, facts: LiveFacts, name: str, window_s: float) -> None:
        self._facts, self._name = facts, name
        self.learning: Mapping[str, Any] | None = None
        self._errors = RollingErrors(facts.period_s, facts.ramp_s, window_s)
        self._compensation = Window(round(window_s / facts.period_s))
        has_torque = facts.drives.get(name, {}).get("torque_delay_s") is not None
        is_of_arm = name in (facts.configuration.get("arm") or {"joints": ()})["joints"]
        self._friction = FrictionTracer(
            name, facts.period_s, _MAP_WINDOWS * window_s, has_torque=has_torque, is_of_arm=is_of_arm
        )
        self._last = dict.fromkeys(_LAST, math.nan)
        self._told: ErrorFigures | None = None
        self._error = math.nan
        self._settings: Settings | None = None
        self._friction.compile(facts.configuration["axes"][name]["model"])

    def take(self, rows: Rows, settings: Settings, lost: int) -> None:
        if self._settings is None or settings.change != self._settings.change:
            self._adopt(settings)
        if not len(rows):
            return
        fade_s = float(settings.axes[self._name].compensation["fade_s"])
        error = self._errors.take(rows, self._name, fade_s, lost)
        self._error = float(error[-1])
        compensation = rows.of(self._name, "compensation")
        self._compensation.extend(compensation[np.isfinite(compensation)])
        self._friction.take(rows)
        self._last = {name: float(rows.of(self._name, name)[-1]) for name in _LAST}

    def hear(self, error_without: Mapping[str, float] | None) -> None:
        """Take what the daemon says of the last time without compensation: it has seen all of it."""
        told = None if error_without is None else ErrorFigures(**error_without)
        if told != self._told:
            self._told = told
            self._errors.forget(Condition.WITHOUT)

    def _adopt(self, settings: Settings) -> None:
        before, self._settings = self._settings, settings
        model = settings.axes[self._name].model
        if before is None or before.axes[self._name].model != model:
            self._friction.use(model)

    def snapshot(self, messages: Messages, *, is_known: bool) -> AxisSnapshot:
        assert self._settings is not None
        last = self._last if is_known else dict.fromkeys(_LAST, math.nan)
        settings = self._settings.axes[self._name]
        state = _drive_state(last)
        measured, estimated = last["temperature"], last["temperature_estimate"]
        friction = settings.model["friction"]
        is_taken_back = self._last["is_enabled"] != 1.0 and messages.has_taken_back(self._name)
        return AxisSnapshot(
            kind=self._facts.kinds[self._name],
            unit=self._facts.unit(self._name, "position"),
            torque_unit=self._facts.unit(self._name, "torque"),
            drive_state=state.words,
            is_powered=None if state is DriveState.UNKNOWN else state.is_powered,
            **{name: last[name] for name in _LAST[:7]},
            temperature=estimated if math.isfinite(estimated) else measured,
            error=self._error if is_known else math.nan,
            without=self._errors.figures(Condition.WITHOUT) or self._told,
            compensated=self._errors.figures(Condition.WITH),
            compensation_rms=self._compensation.rms(),
            friction=self._friction.figures(),
            is_enabled=bool(settings.compensation["enabled"]) and not is_taken_back,
            gain=float(settings.compensation["gain"]),
            model=friction["model"],
            model_file=settings.model_file,
            parameters=friction["parameters"],
            settings=settings.compensation,
            learning=self.learning,
        )


def _drive_state(last: "dict[str, float]") -> DriveState:
    """Return the state of a drive as it was read back in the last row; unknown if nothing was."""
    state = last["drive_state"]
    is_read = last["is_fresh"] == 1.0 and math.isfinite(state)
    return DriveState(int(state)) if is_read else DriveState.UNKNOWN


def _whole(value: float) -> int:
    return int(value) if math.isfinite(value) else 0
