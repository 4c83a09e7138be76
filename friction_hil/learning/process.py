"""The process that learns beside a daemon: reads its rows, and hands over through its control socket."""

import contextlib
import math
import os
import select
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.compensator.records import place
from friction_hil.config import AxisConfig, Configuration, from_dict
from friction_hil.daemon.companion import state_folder
from friction_hil.daemon.control.ask import DaemonGoneError, Question, ask
from friction_hil.daemon.learning_board import STARTING, LearningBoard
from friction_hil.daemon.learning_service import TICK_S
from friction_hil.daemon.ring import RingObserver
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import AxisFacts
from friction_hil.errors import FrictionHilError, UsageError
from friction_hil.friction.model import as_dict
from friction_hil.learning.compilation import compile_learning
from friction_hil.learning.estimate import Mechanics
from friction_hil.learning.gaps import Gaps
from friction_hil.learning.learner import Learner
from friction_hil.learning.proposal import Proposal, Step, described, fitting
from friction_hil.learning.proven import Proven, digest, recall, store
from friction_hil.learning.states import LearnerSettings
from friction_hil.learning.window import RECORDED
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import POSITION_UNITS
from friction_hil.recordings import columns

_LOOK_S = 0.02
_PATIENCE_S = 30.0  # the process of the control socket imports at its first request
_SIMULATED_LOOK_S = 5e-4
_LARGEST_SHARE = 0.25  # of a processor
_FOREVER = 2**62  # cycle that no run reaches
_ALIKE = 0.05  # differences of a proposal from the former one that are not worth another notice
_IDLE = "the axis is not in compensated motion"
_LATE = "too many rows are missing"
_BUSY = "this process has used its share of the processor"
_NO_TORQUE = "its drive does not report the torque"
_FOREIGN = "the settings were changed by somebody else, or before its process began again"  # and trials taken back


class AxisLearning:
    """Learning of one axis of a daemon.

    ``folder``: of the parameters that were kept last; None: they are neither used nor stored.
    """

    def __init__(self, name: str, config: AxisConfig, facts: AxisFacts, period_s: float, folder: Path | None) -> None:
        self.name, self.config, self.period_s = name, config, period_s
        given, mechanics = config.compensation, config.model.mechanics
        self.is_tried = given.learning == "on"
        gravity = mechanics.gravity
        static = (gravity.constant + mechanics.offset, gravity.sine, gravity.cosine)
        self.learner = Learner(
            config.model.friction_model,
            Mechanics(mechanics.inertia, static),
            (config.model.fit or {}).get("standard_errors") or {},
            LearnerSettings(
                period_s,
                facts.position_resolution,
                given.gain,
                given.fade_s,
                is_gain_fixed=given.gain_negative is not None,
            ),
        )
        self._gaps = Gaps(self.learner.record.rows_per_tick, period_s)
        self.unit = POSITION_UNITS[config.model.axis]
        self._is_paused, self._why_paused = True, STARTING
        self._is_busy = False
        self._file = None if folder is None or not self.is_tried else folder / f"{name}.json"
        self._model = digest(config.model.model_dump(mode="json", exclude={"fit"}))
        self._kept = self.learner.proven
        self._is_begun = self._file is None
        self._in_use = self._of_file = self.learner.in_use
        self._last = ""  # text of what has happened last
        self._proposed: dict[str, Any] | None = None
        self._proposals: dict[Step, dict[str, Any]] = {}  # the last of each kind
        self.why_ended = ""

    def compile(self, resolution: float) -> None:
        """Compile what an estimate needs: for the first time on a machine, rows would be lost meanwhile."""
        compile_learning(self.learner.belief, self.period_s, resolution)

    def take(
        self, rows: Mapping[str, Array], following: Mapping[str, Array], *, is_in_force: bool, is_busy: bool
    ) -> Proposal | None:
        """Take the rows of a tick; those of an axis that is not compensated in motion only end a trial.

        ``rows``: (k,) each. ``following``: the row after them, (0,) or (1,), if there is one yet. ``is_in_force``: the
        last change was in force by then. ``is_busy``: this process has used its share of the processor: estimates wait.
        """
        self._is_busy = is_busy
        whole = self._gaps.fill(rows, following)
        if not (np.all(rows["state"] == LoopState.RUNNING) and np.all(rows["is_enabled"] == 1.0)):
            return self._skip(_IDLE, "the motion ended")
        if whole is None:
            return self._skip(_LATE, _LATE)
        self._is_paused = False
        if not self._is_begun:
            self._resume(float(rows["temperature_estimate"][-1]))
        ratio = self.config.model.mechanics.torque_ratio
        given = {**whole, "torque": whole["torque"] / ratio}
        return self.learner.take(given, is_in_force=is_in_force, may_estimate=not is_busy)

    def _skip(self, state: str, end: str) -> Proposal | None:
        """Leave a tick out; what is on trial then is taken back."""
        self._why_paused = state
        if self._is_paused:
            return None
        self._is_paused = True
        return self.learner.pause(end)

    def _resume(self, temperature: float) -> None:
        """Begin with what an earlier run has kept."""
        assert self._file is not None
        self._is_begun = True
        found, why = recall(self._file, self._model, temperature if math.isfinite(temperature) else None)
        if found is not None:
            try:
                self.learner.resume(found.parameters, found.gain, found.friction)
            except UsageError as error:
                why = f"{self._file}: {error}"
        if why:
            self.learner.notes.append(f"the parameters of an earlier run are not used: {why}")

    def keep(self, temperature: float) -> str:
        """Write what was kept to the file for the next run; return what is to be said, if anything."""
        if self._file is None or self.learner.proven == self._kept:
            return ""
        self._kept = self.learner.proven
        celsius = temperature if math.isfinite(temperature) else None
        try:
            parameters, gain, friction = self._kept
            store(self._file, Proven(self._model, parameters, gain, time.time(), celsius, friction))
        except OSError as error:
            return f"{self.name}: what was learned cannot be kept for the next run: {self._file}: {error.strerror}"
        return ""

    def take_note(self, proposal: Proposal | None) -> tuple[list[str], list[str]]:
        """Return what is to be said after a tick, and the text of what is to be handed over, if anything.

        A proposal of an axis that only proposes is refused.
        """
        notes: list[str] = list(self.learner.notes)
        handed: list[str] = []
        self.learner.notes.clear()
        if proposal is not None:
            after, gain = self.learner.wanted
            text = described(proposal, self._in_use, after, self.name, is_tried=self.is_tried)
            if self.is_tried:
                handed.append(text)
            else:
                proposed = {"parameters": after, "gain": gain, "text": text}
                before = self._proposals.get(proposal.step)
                # a residual layer is found anew each time: that there is one is said once
                if before is None or not (proposal.step is Step.LAYER or _is_alike(proposed, before)):
                    notes.append(text)
                self._proposals[proposal.step] = self._proposed = proposed
                self.learner.refuse()
        self._in_use = self.learner.in_use
        self._last = [self._last, *notes, *handed][-1]
        return [f"{self.name}: {text}" for text in notes], [f"{self.name}: {text}" for text in handed]

    def values(self, proposal: Proposal) -> dict[str, Any]:
        """Return what is to be set for a proposal."""
        values: dict[str, Any] = {f"{self.name}.gain": proposal.gain}
        if proposal.model is not None:
            content = self.config.model.model_dump(mode="json")
            content["friction"] |= as_dict(proposal.model)
            if self._in_use != self._of_file:  # else the errors of the file hold
                errors, correlations = self.learner.belief.uncertainty
                fit = {"standard_errors": errors, "correlations": [list(pair) for pair in correlations]}
                content["fit"] = {**(content["fit"] or {}), **fit}
            values[f"{self.name}.model"] = content
        return values

    def report(self) -> dict[str, Any]:
        """Return what has happened so far, for `run --json`."""
        figures = self.learner.figures
        doing, reason = ("ended", self.why_ended) if self.why_ended else self.learner.doing
        if doing == "watching" and (self._is_paused or self._is_busy):
            doing, reason = "waiting", self._why_paused if self._is_paused else _BUSY
        found = replace(
            figures,
            mode=self.config.compensation.learning,
            unit=self.unit,
            doing=doing,
            reason=reason,
            last=self._last,
            in_use=self._in_use,
            parameters=self.learner.belief.parameters if figures.relative_errors is not None else None,
            proposed=self._proposed,
        )
        return asdict(found)


class Learning:
    """Learning of the axes of a daemon that want it; ``is_simulated``: the loop waits for each tick."""

    def __init__(self, socket: Path, board: LearningBoard, *, is_simulated: bool) -> None:
        self._socket, self._board, self._is_simulated = socket, board, is_simulated
        with Question(socket, {"do": "observe"}, _PATIENCE_S) as question:
            while (answer := question.answer()) is None:
                pass
            self._ring = RingObserver(question.descriptors.pop(0))
        configuration: Configuration = from_dict(answer["configuration"], answer["source"])
        self._every = round(TICK_S / configuration.period_s)
        facts = {fact["name"]: AxisFacts(**{**fact, "units": ()}) for fact in answer["facts"]}
        self._axes: dict[int, AxisLearning] = {}
        self._all: list[AxisLearning] = []
        for number, (name, axis) in enumerate(configuration.axes.items()):
            if axis.compensation.learning == "off":
                continue
            # a simulated run begins as every other one
            folder = None if is_simulated else state_folder() / "learning" / socket.stem
            one = AxisLearning(name, axis, facts[name], configuration.period_s, folder)
            self._all.append(one)
            if facts[name].torque_delay_s is None:
                one.why_ended = _NO_TORQUE
                self._tell(f"{name}: nothing is learned: {_NO_TORQUE}")
            else:
                self._axes[number] = one
        board.say(-1, {"axes": self._reports(), "cpu_share": 0.0})
        for one in self._axes.values():
            one.compile(facts[one.name].position_resolution)
        names, width = list(answer["columns"]), len(answer["columns"]) + answer["state_width"]
        gain_factor = len(names) + place("limit_cycle.gain_factor")
        wanted = [
            "state",
            "is_enabled",
            "is_fresh",
            columns.CHANGE,
            *(each for each in RECORDED if each != "gain_factor"),
        ]
        self._names = [*wanted, "gain_factor"]
        places = [*(names.index(each) for each in wanted), gain_factor]
        self._wanted = np.array([axis * width + place for axis in self._axes for place in places], dtype=np.intp)
        self._rows = np.empty((0, self._wanted.size))
        self._own = 0.0  # number of the last change that learning has made
        self._foreign = False
        self._untold: list[str] = []  # there is room for one or two texts a tick
        self._began_s, self._began_cpu_s = time.monotonic(), time.process_time()

    @property
    def has_ended(self) -> bool:
        """True once the loop has ended."""
        return self._ring.is_closed

    def look(self) -> bool:
        """Take what is new; return True if there was a tick."""
        if not self._axes:
            self._board.say(_FOREVER, {"axes": self._reports(), "cpu_share": 0.0})
            return False
        rows = np.concatenate([self._rows, self._ring.new_rows(self._wanted)])
        cycles = rows[:, self._names.index("cycle")]
        ends = np.flatnonzero(cycles[:-1] // self._every != cycles[1:] // self._every) + 1
        if rows.size and (cycles[-1] + 1) % self._every == 0:
            ends = np.append(ends, len(rows))
        first = 0
        for end in ends.tolist():
            self._take(rows[first:end], rows[end : end + 1])
            first = end
        self._rows = rows[first:]
        return bool(ends.size)

    def _take(self, rows: Array, following: Array) -> None:
        """Take the rows of a tick of all axes, and the one after them, if there is one yet."""
        values: dict[str, Any] = {}
        notes: list[str] = []
        handed: list[str] = []
        parts = (np.split(each, len(self._axes), axis=1) for each in (rows, following))
        for axis, part, after in zip(self._axes.values(), *parts, strict=True):
            named, next_one = (
                dict(zip(self._names, np.ascontiguousarray(each.T), strict=True)) for each in (part, after)
            )
            change = float(np.nanmax(named[columns.CHANGE], initial=0.0))
            if change > self._own and not self._foreign:
                self._foreign = True
                for each in self._axes.values():
                    each.why_ended = _FOREIGN
                self._untold.append(f"learning ends: {_FOREIGN}")
            if self._foreign:
                continue
            is_busy = not self._is_simulated and self._is_too_busy()
            is_in_force = change >= self._own  # rows may be older than what was made of those before them
            proposal = axis.take(named, next_one, is_in_force=is_in_force, is_busy=is_busy)
            more_notes, more_handed = axis.take_note(proposal)
            notes, handed = [*notes, *more_notes], [*handed, *more_handed]
            if text := axis.keep(float(named["temperature_estimate"][-1])):
                notes.append(text)
            if proposal is not None and axis.is_tried:
                values |= axis.values(proposal)
        self._untold += notes
        if values:
            reason = fitting(handed)
            self._untold += handed  # those that there was no room for
            self._hand_over(values, reason)
        elif self._untold:
            self._tell(fitting(self._untold))
        share = (time.process_time() - self._began_cpu_s) / max(time.monotonic() - self._began_s, 1e-3)
        report = {"axes": self._reports(), "cpu_share": share}
        self._board.say(int(rows[-1, self._names.index("cycle")]), report)

    def _reports(self) -> dict[str, Any]:
        return {axis.name: axis.report() for axis in self._all}

    def _hand_over(self, values: Mapping[str, Any], text: str) -> None:
        try:
            answer = ask(self._socket, {"do": "set", "values": values, "reason": text, "learning": self._own_words()})
            self._own = float(answer["change"])
        except DaemonGoneError:
            raise
        except FrictionHilError as error:  # a limit of the axis, for example: the former settings stay
            for axis in self._axes.values():
                if any(key.startswith(f"{axis.name}.") for key in values):
                    axis.learner.refuse()
            self._tell(f"learning: refused: {error}")

    def _own_words(self) -> dict[str, Any]:
        """Return what the daemon has to know to take back what is on trial, should this process die."""
        tried = [] if self._foreign else [each.name for each in self._axes.values() if each.learner.has_trial]
        return {"process": os.getpid(), "upon": int(self._own), "axes": tried}

    def _tell(self, text: str) -> None:
        with contextlib.suppress(FrictionHilError):
            ask(self._socket, {"do": "tell", "text": text, "learning": self._own_words()})

    def _is_too_busy(self) -> bool:
        """Return True if learning has taken more than its share: then it goes more slowly."""
        elapsed = time.monotonic() - self._began_s
        return elapsed > 20.0 and time.process_time() - self._began_cpu_s > _LARGEST_SHARE * elapsed


def _is_alike(proposed: Mapping[str, Any], before: Mapping[str, Any]) -> bool:
    """Return True if two proposals are about the same."""
    after, former = proposed["parameters"], before["parameters"]
    return (
        abs(proposed["gain"] - before["gain"]) <= _ALIKE
        and after.keys() == former.keys()
        and all(math.isclose(value, former[name], rel_tol=_ALIKE) for name, value in after.items())
    )


def main(socket: str, board: int, pace: str) -> None:
    """Learn until the daemon ends."""
    is_simulated = pace == "simulated"
    control = select.poll()
    control.register(0, 0)  # standard input: no event but the hang-up, the signal to end, which is always reported
    memory = LearningBoard(board)
    try:
        learning = Learning(Path(socket), memory, is_simulated=is_simulated)
        while not (learning.has_ended or control.poll(0)):
            if not learning.look():
                time.sleep(_SIMULATED_LOOK_S if is_simulated else _LOOK_S)
    except DaemonGoneError:
        return


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
