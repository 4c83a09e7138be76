"""Requests at the control socket, with a loop that stands, goes on or ends a start by a fault."""

import json
import math
import os
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import asdict

import numpy as np
import pytest

from friction_hil.config import self_contained
from friction_hil.daemon.control import desk, state
from friction_hil.daemon.control.desk import Desk
from friction_hil.daemon.control.job import ControlJob
from friction_hil.daemon.control.journal import JournalReader, make_journal
from friction_hil.daemon.control.message import Action
from friction_hil.daemon.control.packed import room, unpack
from friction_hil.daemon.control.state import error_without
from friction_hil.daemon.learning_board import LearningBoard, first_report
from friction_hil.daemon.ring import RingWriter
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import AxisFacts, DriveState
from friction_hil.recordings import columns
from tests.servo_drives import axis_dict, configuration


class Loop:
    """The loop's ends of ring and journal."""

    def __init__(self):
        self.ring = RingWriter(len(columns.NAMES) + 1, 64)
        self.journal = JournalReader(make_journal(room(1)))
        self.board = LearningBoard()
        self.cycle = self.change = 0
        self.is_enabled = 0.0  # the compensation
        self.row(LoopState.WAITING, DriveState.SWITCH_ON_DISABLED)

    def row(self, run, drive):
        values = {"cycle": self.cycle, "time_s": 1e-3 * self.cycle, "state": run, "drive_state": drive}
        values |= {"is_fresh": 1.0, "change": self.change, "is_enabled": self.is_enabled}
        self.ring.push(np.array([*(values.get(name, math.nan) for name in columns.NAMES), math.nan]))
        self.cycle += 1

    def taken(self):
        """The action of the message that is there for the loop, None for none."""
        message = self.journal.take(self.cycle)
        return None if message is None else unpack(message, []).action

    @contextmanager
    def going_on(self, rows):
        """Write rows in the background, and do at once what is asked for."""
        is_over = threading.Event()

        def go_on():
            while not is_over.is_set():
                if self.journal.has_news and (message := self.journal.take(self.cycle)) is not None:
                    self.change = int(np.frombuffer(message[:8], "<f8")[0])
                    self.journal.answer(self.change, self.cycle)
                self.row(*rows[min(self.cycle, len(rows) - 1)])
                time.sleep(1e-3)

        thread = threading.Thread(target=go_on)
        thread.start()
        try:
            yield
        finally:
            is_over.set()
            thread.join()


@pytest.fixture
def loop():
    return Loop()


RUNNING, WAITING = (LoopState.RUNNING, DriveState.OPERATION_ENABLED), (LoopState.WAITING, DriveState.SWITCH_ON_DISABLED)


@pytest.fixture
def ask(loop, monkeypatch):
    """A function that returns the answer to a request."""
    monkeypatch.setattr(desk, "_ANSWER_S", 0.05)
    monkeypatch.setattr(state, "STANDS_S", 0.05)
    config = self_contained(configuration(x=axis_dict()))
    facts = [asdict(AxisFacts("x", "servo", 1e-5, 1e-4, 2.5e-3, 1.5e-3))]
    job = ControlJob("mill", config, "mill.yaml", facts, list(columns.NAMES), 1)
    asked = Desk(job, loop.ring.descriptor, loop.journal.descriptor, loop.board.descriptor)
    yield lambda **request: asked.answer(json.dumps(request).encode(), os.geteuid())
    os.close(loop.journal.descriptor)


@pytest.fixture
def status(ask):
    """A function that returns what is known of axis x."""
    return lambda: ask(do="status")["axes"]["x"]


def test_what_a_standing_loop_did_not_answer_is_withdrawn_so_that_no_axis_is_enabled_later(loop, ask):
    assert "withdrawn" in ask(do="start")["problems"][0]
    assert loop.taken() is None
    assert "as soon as it goes on" in ask(do="stop")["problems"][0]  # a stop waits for the loop ...
    assert "a stop waits for it" in ask(do="start")["problems"][0]  # ... and nothing takes its place
    assert loop.taken() is Action.STOP


def test_a_stop_comes_before_all_that_waits_for_a_loop_that_stands_and_always_finds_a_place(loop, ask, monkeypatch):
    monkeypatch.setattr(desk, "_ANSWER_S", 0.3)
    refused, problems = threading.Event(), []

    def tell():
        problems.append(ask(do="tell", text="hello").get("problems", [""])[0])
        if "answered already" in problems[-1]:
            refused.set()

    others = [threading.Thread(target=tell) for _ in range(desk._MOST_OTHERS + 1)]
    for each in others:
        each.start()
    assert refused.wait(10.0)  # all others wait for the loop, or for each other
    assert "as soon as it goes on" in ask(do="stop")["problems"][0]
    assert loop.taken() is Action.STOP
    assert ask(do="status")["ok"]
    for each in others:
        each.join()
    assert sum("withdrawn" in each for each in problems) == 1  # the one whose turn it was
    assert sum("a stop waits for it" in each for each in problems) == desk._MOST_OTHERS - 1


def test_nothing_is_known_of_drives_while_the_loop_stands(loop, ask):
    answer = ask(do="status")
    assert (answer["state"], answer["axes"]["x"]["drive_state"]) == ("unknown", "unknown")
    assert "it stands" in answer["warnings"][-1]
    with loop.going_on([WAITING]):
        answer, stopped = ask(do="status"), ask(do="stop")
    assert (answer["state"], answer["axes"]["x"]["drive_state"]) == ("waiting", "switch on disabled")
    assert answer["warnings"] == []
    assert (stopped["is_done"], stopped["drives"]) == (True, {"x": "switch on disabled"})


def test_status_says_that_compensation_is_off_after_it_was_taken_back(loop, ask, status):
    with loop.going_on([RUNNING]):
        assert status()["enabled"] is True
        for name in ("x", "y"):
            loop.ring.push_event(loop.cycle, "warning", f"{name}: it is taken back [FH-129]")
        assert status()["enabled"] is False
        assert "x: it is taken back [FH-129]" in ask(do="status")["warnings"]
        loop.is_enabled = 1.0
        assert status()["enabled"] is True


def test_a_start_that_a_fault_ends_is_answered_at_once(loop, ask):
    rows = [(LoopState.ENABLING, DriveState.READY_TO_SWITCH_ON)] * 20
    began_s = time.monotonic()
    with loop.going_on([*rows, (LoopState.WAITING, DriveState.FAULT)]):
        answer = ask(do="start")
    assert answer["ok"], answer
    assert time.monotonic() - began_s < 5.0
    assert (answer["is_done"], answer["state"], answer["drives"]) == (False, "waiting", {"x": "fault"})


def test_a_fault_is_shown_although_many_changes_follow_it_before_anybody_looks(loop, ask):
    loop.ring.push_event(0, "fault", "x: it failed")
    for _ in range(20):
        ask(do="set", values={"x.gian": 1.0})
        for _ in range(20):
            loop.ring.push_event(0, "notice", "something")
    assert ask(do="status")["faults"] == ["x: it failed"]


@pytest.mark.parametrize("path", ["", "\0", "\ud800"])
def test_a_path_that_no_file_can_have_is_refused_in_words(ask, path):
    (problem,) = ask(do="set", values={"x.model": path})["problems"]
    assert "error in friction-hil" not in problem


def test_what_is_on_trial_is_taken_back_when_the_process_that_judges_it_hangs(loop, ask, status, monkeypatch):
    """It is alive, but says nothing of the rows of the last seconds: as after SIGSTOP."""
    monkeypatch.setattr(desk, "_WATCH_S", 0.01)
    monkeypatch.setattr(desk, "_ANSWER_S", 60.0)
    for _ in range(100):
        loop.row(*RUNNING)
    loop.board.say(loop.cycle, {"axes": {"x": first_report("on", "rad", 0.9)}})
    before = status()["gain"]
    waits = [sys.executable, "-c", "input()"]
    with subprocess.Popen(waits, stdin=subprocess.PIPE) as judge, loop.going_on([RUNNING]):
        words = {"process": judge.pid, "upon": 0, "axes": ["x"]}
        answer = ask(do="set", values={"x.gain": 0.4}, reason="learning tries", learning=words)
        assert answer["ok"], answer
        assert status()["gain"] == 0.4
        loop.cycle += round(desk._HANGS_S / 1e-3)
        end_s = time.monotonic() + 60.0
        while (now := status())["gain"] != before and time.monotonic() < end_s:
            time.sleep(0.01)
        judge.communicate(b"\n")
        for thread in threading.enumerate():
            if "_await_end" in thread.name:  # it sees the death, too
                thread.join(60.0)
    assert now["gain"] == before
    assert now["learning"]["reason"] == "its process has done nothing for 10 s"


def test_the_process_that_learns_does_not_hang_while_it_compiles_before_its_first_row(loop, status):
    loop.board.say(-1, {"axes": {"x": first_report("on", "rad", 0.9)}})
    loop.cycle += round(2.0 * desk._HANGS_S / 1e-3)
    loop.row(*RUNNING)
    assert status()["learning"] == first_report("on", "rad", 0.9)


def test_status_has_the_error_without_compensation_and_a_newer_one_replaces_it(loop, status):
    known = {"rms": 2.57e-4, "peak": 6.1e-4, "seconds": 9.5}
    with loop.going_on([RUNNING]):
        assert status()["error_without"] is None
        for figures in ((9.0, 9.0, 1.0), known.values()):
            loop.ring.push_event(loop.cycle, "error_without", error_without("x", "rad", *figures))
        loop.ring.push_event(loop.cycle, "error_without", "x: of a version that is not known yet")
        assert status()["error_without"] == known
    assert status()["error_without"] == known  # it was measured, though the loop stands now
