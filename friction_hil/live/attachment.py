"""Attaching to a running daemon from another process of the same machine.

The daemon's rows are in memory that has no name. The process of the control socket hands out descriptors of it that are
open for reading only, to whoever may use the socket. From then on nobody is asked any more: the loop, and that process,
neither know nor notice who looks.
"""

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from friction_hil import __version__
from friction_hil.daemon.control import journal
from friction_hil.daemon.control.ask import DaemonGoneError, Question
from friction_hil.daemon.control.names import candidates, find, is_live
from friction_hil.daemon.control.state import STANDS_S
from friction_hil.daemon.ring import RingObserver
from friction_hil.daemon.shared_document import read_document
from friction_hil.drive.codes import code_of
from friction_hil.errors import FrictionHilError
from friction_hil.live.reading import AxisSettings, LiveEvent, LiveFacts, Reading, Rows, Settings

_PATIENCE_S = 10.0  # the process of the control socket imports numpy at its first request
_SIGHT_S = 1.0  # between two looks at a socket whose loop stands
_REQUEST = {"do": "observe"}


def attach(name: str) -> "Live":
    """Attach to the daemon called ``name``.

    Raises `UsageError`: no daemon of this name runs here; the message lists those that do. Raises `FrictionHilError`:
    this user may not use its control socket, it is of another version, or it does not answer within 10 s, because it is
    still starting; the message says so.
    """
    path = find(name)
    identity = _identity(path)
    with _explained(name), Question(path, _REQUEST, _PATIENCE_S) as question:
        while (answer := question.answer()) is None:
            pass
        return _live(path, identity, answer, question.descriptors)


class Watch:
    """Attach to a daemon whenever it runs: now, later, and again when another one of this name starts."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._question: tuple[Path, tuple[int, int] | None, Question] | None = None
        self.live: Live | None = None  # the daemon, also after its end until the next one is attached

    def poll(self) -> "Live | None":
        """Return the daemon; None while none of this name runs, or while it starts. It never waits.

        Raises `FrictionHilError`: this user may not use its control socket, or it is of another version; the message
        says so.
        """
        if self.live is not None and not self.live.is_over:
            return self.live
        try:
            with _explained(self._name):
                found = self._ask()
        except DaemonGoneError:
            self._hang_up()
            return None
        if found is not None:
            self._hang_up()
            if self.live is not None:
                self.live.close()
            self.live = found
        return found

    def close(self) -> None:
        """Detach; safe to call twice."""
        self._hang_up()
        if self.live is not None:
            self.live.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(self) -> "Live | None":
        """Ask once, and look for the answer from then on: a daemon answers when it has started."""
        if self._question is None:
            path = next((each for each in candidates(self._name) if os.path.exists(each)), None)
            if path is None:
                return None
            self._question = path, _identity(path), Question(path, _REQUEST)
        path, identity, question = self._question
        if (answer := question.answer()) is None:
            return None
        live = _live(path, identity, answer, question.descriptors)
        if live.has_ended:
            live.close()
            return None
        return live

    def _hang_up(self) -> None:
        if self._question is not None:
            self._question[-1].close()
            self._question = None


def _live(path: Path, identity: tuple[int, int] | None, answer: Mapping[str, Any], descriptors: list[int]) -> "Live":
    """Return the daemon that has answered; the descriptors are its own then."""
    try:
        ring, changes, *learning = descriptors
        live = Live(answer, ring, changes, lambda: _identity(path) == identity and is_live(path), *learning)
    except (KeyError, TypeError, ValueError) as error:
        version = f"of friction-hil {answer.get('version')}, and this is {__version__}"
        raise _other_version(str(answer.get("name")), version) from error
    descriptors.clear()
    return live


@contextlib.contextmanager
def _explained(name: str) -> Iterator[None]:
    """Say what it means that a daemon does not know the request."""
    try:
        yield
    except FrictionHilError as error:
        if "nothing is called 'observe'" in str(error):
            raise _other_version(name, "of an earlier version of friction-hil") from None
        raise


class Live:
    """A daemon that somebody looks at. `attach` makes it; use it as a context manager, or `close` it.

    ``answer``: of the control socket to ``observe``. The descriptors are those of the memory of rows, of changes, and
    of what the process that learns says, open for reading; this closes them. ``is_there`` returns False if the daemon
    listens at its control socket no more.
    """

    def __init__(
        self,
        answer: Mapping[str, Any],
        ring_descriptor: int,
        journal_descriptor: int,
        is_there: Callable[[], bool],
        learning_descriptor: int | None = None,
    ) -> None:
        self.facts = _facts(answer)
        # that nobody had reset when this was attached; those after it are events
        self.faults = tuple(map(str, answer["faults"]))
        # the daemon has ended, as the last `read` saw; one of this name that starts later is another one: attach again
        self.is_over = False
        self._files: Mapping[str, str] = answer["files"]
        width, axes, columns = len(self.facts.columns) + int(answer["state_width"]), self.facts.axes, self.facts.columns
        self.ring = RingObserver(ring_descriptor)
        if self.ring.width != len(axes) * width:
            raise ValueError("the rows have another width than the columns")
        self._wanted = (np.arange(len(axes))[:, None] * width + np.arange(len(columns))).ravel()
        self._journal, self._learning = journal_descriptor, learning_descriptor
        self._is_there = is_there
        self._missed = 0
        self._written, self._written_s = self.ring.rows_written, time.monotonic()
        self._next_sight_s = 0.0
        self._settings = self._read_settings(0)

    @property
    def has_ended(self) -> bool:
        """True once the loop has written its last row; there may be rows to read."""
        return self.ring.is_closed

    @property
    def settings(self) -> Settings:
        """Settings in force in the last row that was read."""
        return self._settings

    def read(self) -> Reading:
        """Return what has happened since the last call; it never waits.

        The first call returns the rows and events that the memory still has: those of about the last 4 s. Call it at
        least every 2 s; rows that are overwritten before are lost, and counted.
        """
        has_ended = self.has_ended  # before the rows: what is written then is complete
        events = tuple(map(self._event, self.ring.new_events()))  # before the rows: those before an event are there
        rows = self.ring.new_rows(self._wanted)
        lost = self.ring.rows_missed - self._missed
        self._missed = self.ring.rows_missed
        stands = self._stands()
        self.is_over = self.is_over or has_ended or (stands and not self._is_in_sight())
        facts = self.facts
        values = rows.reshape(len(rows), len(facts.axes), len(facts.columns))
        found = Rows(facts, values)
        self._settings = self._settings_of(found)
        learning = {} if self._learning is None else read_document(self._learning).get("axes", {})
        return Reading(found, lost, events, self._settings, stands, self.is_over, learning)

    def close(self) -> None:
        """Detach; safe to call twice."""
        if self._journal >= 0:
            os.close(self.ring.descriptor)
            os.close(self._journal)
            self._journal = -1
            if self._learning is not None:
                os.close(self._learning)
                self._learning = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _stands(self) -> bool:
        """Return True if no row was written for a second."""
        written, now_s = self.ring.rows_written, time.monotonic()
        if written != self._written:
            self._written, self._written_s = written, now_s
        return now_s - self._written_s >= STANDS_S

    def _is_in_sight(self) -> bool:
        """Return False if the daemon is gone; it is looked for once a second."""
        now_s = time.monotonic()
        if now_s < self._next_sight_s:
            return True
        self._next_sight_s = now_s + _SIGHT_S
        return self._is_there()

    def _settings_of(self, rows: Rows) -> Settings:
        """Return the settings in force in the last of the rows."""
        change = rows.of(self.facts.axes[0], "change")
        known = change[np.isfinite(change)]
        if not known.size or int(known[-1]) == self._settings.change:
            return self._settings
        return self._read_settings(int(known[-1]))

    def _read_settings(self, change: int) -> Settings:
        now = journal.present(self._journal, self.facts.configuration, self._files, change)
        axes = {
            name: AxisSettings(axis["compensation"], axis["model"], now.files[name])
            for name, axis in now.configuration["axes"].items()
        }
        return Settings(change, axes)

    def _event(self, event: tuple[float, str, str]) -> LiveEvent:
        cycle, name, text = event
        code = code_of(text)
        return LiveEvent(cycle, cycle * self.facts.period_s, name, text, code, self.facts.remedy(text))


def _other_version(name: str, what: str) -> FrictionHilError:
    return FrictionHilError(f"the daemon {name!r} is {what}", "look at it with its own version, or start it with this")


def _facts(answer: Mapping[str, Any]) -> LiveFacts:
    configuration = answer["configuration"]
    return LiveFacts(
        name=answer["name"],
        version=answer["version"],
        source=answer["source"],
        configuration=configuration,
        period_s=configuration["period_s"],
        ramp_s=answer["ramp_s"],
        started_unix_ns=answer["started_unix_ns"],
        axes=tuple(configuration["axes"]),
        kinds={name: axis["model"]["axis"] for name, axis in configuration["axes"].items()},
        columns=tuple(answer["columns"]),
        drives={fact["name"]: fact for fact in answer["facts"]},
        is_follower=answer["is_follower"],
        remedies=answer["remedies"],
    )


def _identity(path: Path) -> tuple[int, int] | None:
    """Return what tells the socket of one daemon from that of the next; None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_ctime_ns
