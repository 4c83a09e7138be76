"""Requests at the control socket, and their answers: JSON objects, one a line."""

import json
import math
import os
import pwd
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from typing import Any

from friction_hil import __version__
from friction_hil.daemon.control import journal
from friction_hil.daemon.control.job import ControlJob
from friction_hil.daemon.control.journal import JournalWriter, Present
from friction_hil.daemon.control.message import Action, Change, pack
from friction_hil.daemon.control.on_trial import OnTrial, RefusedError, settle, values_before
from friction_hil.daemon.control.state import DaemonState
from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.shared_document import cycle_of, read_document
from friction_hil.drive import AxisFacts, DriveState
from friction_hil.errors import FrictionHilError, choices
from friction_hil.numerics.readable import POSITION_UNITS

PROTOCOL = 1
_ANSWER_S = 5.0  # within which the loop takes a message
_LAST_ANSWER_S = 0.1  # of a loop that was taking the message while it was withdrawn
_LOOK_S = 0.01
_WATCH_S = 0.5  # between two looks at a process that has put something on trial
_HANGS_S = 10.0  # behind the loop: it judges each quarter of a second
_HANGS = f"its process has done nothing for {_HANGS_S:g} s"
_STOP_S = 20.0  # more than all time-outs of a stop together
_START_S = 20.0  # beyond enable_timeout_s: a first motion
_RESET_S = 2.0
LATEST_CYCLES = 500  # cycles over which another model finds the state in which it would be
_KEYS = {"status": (), "observe": (), "set": ("values",), "tell": ("text",), "start": (), "stop": (), "reset": ()}
_MAY_HAVE = {"set": ("reason", "learning"), "tell": ("learning",)}
_NEVER_REFUSED = ("status", "stop")  # however many requests are being answered
_MOST_OTHERS = 16  # at once: half of the places that the server has


class Desk:
    """Answers requests."""

    def __init__(
        self, job: ControlJob, ring_descriptor: int, journal_descriptor: int, learning_descriptor: int | None = None
    ) -> None:
        self._job = job
        self._names = list(job.configuration["axes"])
        self._journal = JournalWriter(journal_descriptor)
        self._learning = learning_descriptor  # memory of what the process that learns says; None without one
        shown = (ring_descriptor, journal_descriptor, learning_descriptor)
        self._read_only = [journal.read_only(each) for each in shown if each is not None]
        self._state = DaemonState(ring_descriptor, self._names, job.columns, job.state_width)
        self._preparing = threading.Lock()  # one change of settings is prepared upon the other
        self._sending = _Turn()  # a stop does not wait for what is being prepared
        self._others = threading.BoundedSemaphore(_MOST_OTHERS)
        self._looking = threading.Lock()
        self._watched: set[int] = set()  # processes that have put something on trial
        self._do: dict[str, Callable[[Mapping[str, Any], str], dict[str, Any]]] = {
            "status": self._status,
            "observe": self._observe,
            "set": self._set,
            "tell": self._tell,
            "start": self._start,
            "stop": self._stop,
            "reset": self._reset,
        }

    def answer(self, line: bytes, user: int) -> dict[str, Any]:
        """Return the answer to a request; ``ok`` is false with ``problems`` where it is refused.

        ``user``: number of the user who asks.
        """
        try:
            request = _request(line)
            with nullcontext() if request["do"] in _NEVER_REFUSED else self._one_of_the_others():
                with self._looking:  # at each request: the ring holds the last events only
                    self._state.look()
                return {"ok": True, **self._do[request["do"]](request, _who(user))}
        except FrictionHilError as error:
            return {"ok": False, "problems": str(error).splitlines()}

    @contextmanager
    def _one_of_the_others(self) -> Iterator[None]:
        """Refuse what would take the place of a stop."""
        if not self._others.acquire(blocking=False):
            raise RefusedError(f"{_MOST_OTHERS} requests are being answered already, only stop and status are besides")
        try:
            yield
        finally:
            self._others.release()

    def _status(self, request: Mapping[str, Any], who: str) -> dict[str, Any]:
        self._state.await_row()
        with self._looking:
            self._state.look()
            messages = self._state.messages
            faults, warnings, notices = (list(each) for each in (messages.faults, messages.warnings, messages.notices))
            errors = dict(messages.error_without)
            if self._state.stands:
                warnings.append("the loop has written no row for a second: it stands, and the drives are unknown")
        now = self._present()
        learning = {} if self._learning is None else read_document(self._learning).get("axes", {})
        if self._judge_hangs():
            learning = {name: {**report, "doing": "waiting", "reason": _HANGS} for name, report in learning.items()}
        axes = {}
        for name in self._names:
            given, model = (now.configuration["axes"][name][key] for key in ("compensation", "model"))
            axes[name] = {
                **self._state.axis(name),
                "unit": POSITION_UNITS[model["axis"]],
                "enabled": given["enabled"] and not self._state.is_taken_back(name),
                "gain": given["gain"],
                "gain_negative": given["gain_negative"],
                "adaptation": given["adaptation"],
                "model": model["friction"]["model"],
                "model_file": now.files[name],
                "learning": learning.get(name),
                "error_without": errors.get(name),
            }
        return {
            "protocol": PROTOCOL,
            "name": self._job.name,
            "configuration": self._job.source,
            **self._state.loop(),
            "faults": faults,
            "warnings": warnings,
            "notices": notices,
            "axes": axes,
        }

    def _observe(self, request: Mapping[str, Any], who: str) -> dict[str, Any]:
        """Return what never changes in a run, and the memory in which the rest is: rows, events, changes."""
        with self._looking:
            faults = list(self._state.messages.faults)
        job = self._job
        return {
            "protocol": PROTOCOL,
            "version": __version__,
            "name": job.name,
            "source": job.source,
            "started_unix_ns": job.started_unix_ns,
            "configuration": job.configuration,
            "files": job.files,
            "facts": job.facts,
            "columns": job.columns,
            "state_width": job.state_width,
            "is_follower": job.is_follower,
            "ramp_s": job.ramp_s,
            "remedies": job.remedies,
            "faults": faults,
            "descriptors": self._read_only,  # the server sends these along
        }

    def take_back(self, why: str) -> None:
        """Take back what is on trial, if anything is: nobody judges it any more."""
        try:
            with self._looking:
                self._state.look()
            self._set({"values": {}, "reason": f"learning: {why}"}, "")
        except FrictionHilError as error:
            if not self._state.has_ended:
                sys.stderr.write(f"friction-hil: what was on trial could not be taken back: {error}\n")

    def _watch(self, process: int) -> None:
        """Take back what is on trial when a process dies or hangs; refuse one that has died already."""
        try:
            descriptor = os.pidfd_open(process)
        except OSError as error:
            raise RefusedError(f"process {process}, which would judge the trial: {error.strerror}") from None
        has_died = bool(select.select([descriptor], [], [], 0.0)[0])
        if has_died or process in self._watched:
            os.close(descriptor)
            if has_died:
                raise RefusedError(f"process {process}, which would judge the trial, has died")
            return
        self._watched.add(process)
        threading.Thread(target=self._await_end, args=(process, descriptor), daemon=True).start()

    def _await_end(self, process: int, descriptor: int) -> None:
        while not select.select([descriptor], [], [], _WATCH_S)[0]:
            if self._judge_hangs() and self._present().on_trial:
                self.take_back(_HANGS)
        os.close(descriptor)
        self._watched.discard(process)
        self.take_back("its process died")

    def _judge_hangs(self) -> bool:
        """Return True if the process that learns is far behind the loop, which waits for it in simulated time.

        Before its first row it compiles, and has nothing on trial.
        """
        rows = self._state.rows(1)
        if self._learning is None or not len(rows) or (done := cycle_of(self._learning)) < 0:
            return False
        behind = self._cycle(rows) - done
        return behind * float(self._job.configuration["period_s"]) > _HANGS_S

    def _set(self, request: Mapping[str, Any], who: str) -> dict[str, Any]:
        """Change settings. Whoever is not learning takes back what is on trial by that: nobody would judge it."""
        # imported here: only what changes settings needs numba and the models
        from friction_hil.daemon.control.prepare import entry_of, latest_inputs, prepare

        values = request["values"]
        learning = OnTrial.of(request.get("learning"), self._names)
        shown = ", ".join(f"{key}={_shown(value)}" for key, value in values.items())
        text = request.get("reason", f"{who} set {shown}")
        if not isinstance(text, str):
            raise RefusedError("reason must be a text")
        with self._preparing:
            before = self._present()
            former = before.on_trial
            if learning is not None and learning.upon != self._state.last_change():
                raise RefusedError("the settings were changed meanwhile")
            if learning is not None and learning.axes:
                self._watch(learning.process)  # within the lock: its death is dealt with after this change
            if not values and (self._state.has_ended or not former):
                return {}
            if learning is None and former:
                values = {**values_before(before, values), **values}
                text = f"{text}; what was on trial of {', '.join(former)} is taken back"
            rows = self._state.rows(LATEST_CYCLES)
            latest = {
                name: found
                for k, name in enumerate(self._names)
                if (found := latest_inputs(rows, self._job.columns, self._job.state_width, k)) is not None
            }
            facts = [AxisFacts(**{**fact, "units": ()}) for fact in self._job.facts]
            has_network = self._job.has_network
            prepared = prepare(before.configuration, self._job.source, values, facts, latest, has_network=has_network)
            with self._sending.taken():
                number = self._journal.next_number
                entry = entry_of(number, prepared, before.models_of, text)
                if learning is not None:
                    learning.mark(entry, before)
                in_force, now_s = self._state.last_change(), self._state.loop()["time_s"] or 0.0
                entry |= {"files": prepared.models, "before": in_force, "time_s": now_s}
                cycle = self._send(Change(number, Action.NONE, prepared.axes, text), entry)
        return {"cycle": cycle, "change": number}

    def _tell(self, request: Mapping[str, Any], who: str) -> dict[str, Any]:
        """Put a notice into the record of the run."""
        if not isinstance(request["text"], str):
            raise RefusedError("text must be a text")
        learning = OnTrial.of(request.get("learning"), self._names)
        if learning is not None:
            with self._preparing:
                settle(self._journal.descriptor, self._state.last_change(), learning.axes)
        with self._sending.taken():
            cycle = self._send(Change(self._journal.next_number, text=request["text"]))
        return {"cycle": cycle}

    def _start(self, request: Mapping[str, Any], who: str) -> dict[str, Any]:
        return self._act(Action.START, who, _START_S + self._job.configuration["enable_timeout_s"], self._has_started)

    def _stop(self, request: Mapping[str, Any], who: str) -> dict[str, Any]:
        return self._act(Action.STOP, who, _STOP_S, self._has_stopped)

    def _reset(self, request: Mapping[str, Any], who: str) -> dict[str, Any]:
        return self._act(Action.RESET, who, _RESET_S, self._is_without_fault)

    def _act(self, action: Action, who: str, timeout_s: float, is_done: Callable[[], bool]) -> dict[str, Any]:
        """Ask something of the run, and wait until it is done; what the drives reported last is in the answer."""
        with self._sending.taken(is_stop=action is Action.STOP):
            cycle = self._send(Change(self._journal.next_number, action, text=f"{who}: {action.name.lower()}"))
        self._state.await_row()  # the loop goes on: it has answered
        end_s = time.monotonic() + timeout_s
        is_fulfilled = False
        while not (is_fulfilled := is_done()) and time.monotonic() < end_s and not self._state.has_ended:
            if action is Action.START and self._is_given_up(cycle):
                break
            time.sleep(_LOOK_S)
        self._state.await_row()
        with self._looking:
            self._state.look()
            faults = list(self._state.messages.faults)
        drives = {name: state.words for name, state in self._state.drive_states().items()}
        return {"cycle": cycle, "is_done": is_fulfilled, **self._state.loop(), "drives": drives, "faults": faults}

    def _has_started(self) -> bool:
        return self._state.loop_state() is LoopState.RUNNING

    def _is_given_up(self, cycle: int) -> bool:
        """Return True if the run waits again after a start in ``cycle``: a fault or a stop has ended it."""
        rows = self._state.rows(1)
        return len(rows) > 0 and self._cycle(rows) > cycle and self._state.loop_state() is LoopState.WAITING

    def _has_stopped(self) -> bool:
        if self._state.loop_state() is not LoopState.WAITING:
            return False
        drives = self._state.drive_states().values()
        return self._job.is_follower or not any(state.is_powered or state is DriveState.UNKNOWN for state in drives)

    def _is_without_fault(self) -> bool:
        bad = (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE, DriveState.UNKNOWN)
        return not any(state in bad or state.is_powered for state in self._state.drive_states().values())

    def _send(self, change: Change, entry: Mapping[str, Any] | None = None) -> int:
        """Hand a change to the loop; return the cycle in which it was applied.

        ``entry``: what the journal keeps of it, if it changes settings. Raises `RefusedError`: the loop refuses it, has
        ended, or does not answer.
        """
        if self._state.has_ended:
            raise RefusedError("the daemon has ended its loop")
        is_stop = change.action is Action.STOP
        if self._journal.is_stop_waiting and not is_stop:
            raise RefusedError("the loop stands, and a stop waits for it: nothing else is handed to it before that")
        self._journal.post(change.number, pack(change), entry, is_stop=is_stop)
        answer = self._journal.wait(change.number, _ANSWER_S)
        if answer is None and is_stop:
            raise RefusedError(
                f"the loop has not answered within {_ANSWER_S:g} s: it stops as soon as it goes on; until then nothing "
                "is known of the drives"
            )
        if answer is None:
            self._journal.withdraw()  # an axis must not be enabled, or changed, when nobody expects it any more
            answer = self._journal.wait(change.number, _LAST_ANSWER_S)
        if answer is None:
            raise RefusedError(f"the loop has not answered within {_ANSWER_S:g} s: the request was withdrawn")
        cycle, refusal = answer
        if refusal:
            raise RefusedError(refusal)
        end_s = time.monotonic() + _ANSWER_S
        while not len(rows := self._state.rows(1)) or self._cycle(rows) < cycle:  # the row of that cycle comes next
            if time.monotonic() > end_s or self._state.has_ended:
                break
            time.sleep(1e-3)
        return cycle

    def _cycle(self, rows: Any) -> float:
        value = float(rows[-1, self._job.columns.index("cycle")])
        return value if math.isfinite(value) else math.inf

    def _present(self) -> Present:
        """Return what is in force in the latest row."""
        job, number = self._job, self._state.last_change()
        return journal.present(self._journal.descriptor, job.configuration, job.files, number)


class _Turn:
    """Turn of one request at a time to hand something to the loop; a stop goes before all others that wait."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._is_taken = False
        self._stops = 0  # that wait

    @contextmanager
    def taken(self, *, is_stop: bool = False) -> Iterator[None]:
        with self._changed:
            self._stops += is_stop
            while self._is_taken or (self._stops and not is_stop):
                self._changed.wait()
            self._stops -= is_stop
            self._is_taken = True
        try:
            yield
        finally:
            with self._changed:
                self._is_taken = False
                self._changed.notify_all()


def _request(line: bytes) -> dict[str, Any]:
    """Return a request that has the form of one; a `RefusedError` says what is wrong with it."""
    try:
        request = json.loads(line)
    except (ValueError, RecursionError):
        raise RefusedError('a request is one JSON object a line, e.g. {"do": "status"}') from None
    try:
        json.dumps(request, ensure_ascii=False).encode()
    except (UnicodeEncodeError, RecursionError):
        raise RefusedError("a request is text: it has half of a surrogate pair, or is nested too deep") from None
    if not isinstance(request, dict):
        raise RefusedError('a request is a JSON object, e.g. {"do": "status"}')
    what = request.get("do")
    if not isinstance(what, str) or what not in _KEYS:
        raise RefusedError(f"do: nothing is called {what!r}; {choices(str(what), _KEYS)}")
    for key in request:
        known = ("do", *_KEYS[what], *_MAY_HAVE.get(what, ()))
        if key not in known:
            raise RefusedError(f"{key}: is not a key here; {choices(key, known)}")
    for key in _KEYS[what]:
        if key not in request:
            raise RefusedError(f"{key}: is missing")
    if what == "set" and not (isinstance(request["values"], dict) and request["values"]):
        raise RefusedError('values must be a group of keys and values, e.g. {"x.gain": 0.8}')
    return request


def _who(user: int) -> str:
    try:
        return f"user {user} ({pwd.getpwuid(user).pw_name})"
    except KeyError:
        return f"user {user}"


def _shown(value: Any) -> str:
    if isinstance(value, dict) and "friction" in value:
        return "a model without a file"
    text = value if isinstance(value, str) else json.dumps(value)
    return text.rpartition("/")[2] if isinstance(value, str) else text
