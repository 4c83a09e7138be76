"""What a run keeps of its faults and of the states of the drives at its end, and its live lines at several widths."""

import io
import os
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.daemon.companion import status
from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.companion.status import StatusLine
from friction_hil.daemon.control.state import Messages, error_without
from friction_hil.daemon.figures import FeedbackGaps
from friction_hil.daemon.log import RunLog
from friction_hil.daemon.ring import EVENT_SLOTS, RingObserver, RingWriter
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState
from friction_hil.recordings import columns
from tests.messages import codes_in


@pytest.fixture
def sink():
    """A sink that keeps events."""
    return keeping()


def keeping():
    events = []
    return SimpleNamespace(events=events, event=lambda *event: events.append(event))


@pytest.fixture
def log(sink):
    return RunLog(sink, 1e-3)


@pytest.mark.parametrize("state", [DriveState.UNKNOWN, DriveState.OPERATION_ENABLED])
def test_a_drive_that_may_have_power_at_the_end_is_a_fault_after_any_number_of_others(sink, log, state):
    for k in range(1000):
        log.fault(k, f"fault {k}")
    kept = list(log.result.faults)
    assert kept == [f"fault {k}" for k in range(len(kept))]
    assert len(kept) < 100
    log.drive_state(1000, "x", state, is_read_back=True)
    log.drive_state(1000, "y", DriveState.SWITCH_ON_DISABLED, is_read_back=True)
    (last,) = log.result.faults[len(kept) :]
    assert last.startswith("x: ")
    assert (1000, "fault", last) in sink.events
    assert log.result.drive_states == [state, DriveState.SWITCH_ON_DISABLED]


def test_after_a_reset_the_same_fault_counts_again_however_many_there_were(sink, log):
    for k in range(1000):
        log.fault(k, f"fault {k}")
    log.reset(1000)
    assert not log.has_fault
    log.fault(1001, "fault 0")
    assert log.has_fault
    assert log.result.faults[-1] == "fault 0"
    assert [(cycle, name) for cycle, name, _ in sink.events if name == "reset"] == [(1000, "reset")]


@pytest.mark.parametrize(("missing", "words"), [(19, ""), (20, "20 of the 100 cycles")])
def test_the_first_fault_names_what_was_missing_before_it(log, missing, words):
    gaps = FeedbackGaps()
    for cycle in [*range(50), *range(500, 500 + missing)]:  # the first ones are too long ago
        gaps.miss(cycle, "lost")
    log.missed(595, 3, 3_000_000, max_missed=10)
    log.fault(597, "x: too fast [FH-107]", gaps.before(597))
    log.fault(598, "x: too far [FH-108]", gaps.before(598))
    first, second = log.result.faults
    assert first.startswith("x: too fast; 3 periods were missed 2 ms before")
    assert words in first
    assert ("feedback was missing" in first) == (words != "")
    assert codes_in([first, second]) == ["x FH-107", "x FH-108"]


def test_what_was_asked_for_and_learned_leaves_room_for_what_a_drive_says(sink, log):
    for k in range(1000):
        log.act(k, f"user 0: start {k}")
        log.notice(k, f"x: told once {k}")
    for cycle, text in ((20_000, "x: emergency 2310h overcurrent"), (21_000, "x: told for the first time")):
        log.notice(cycle, text)
        assert sink.events[-1] == (cycle, "notice", text)
    assert len(log.result.notices) < 300


@given(st.lists(st.integers(0, 5000), max_size=60).map(sorted))
def test_the_same_message_of_a_drive_counts_each_time(cycles):
    sink = keeping()
    log = RunLog(sink, 1e-3)
    for cycle in cycles:
        log.notice(cycle, "x: emergency 2310h overcurrent")
    assert sink.events == [(cycle, "notice", "x: emergency 2310h overcurrent") for cycle in cycles]
    assert log.result.notices == ["x: emergency 2310h overcurrent"] * bool(cycles)


def test_a_drive_that_talks_without_end_leaves_room_for_a_fault(sink, log):
    """The ring holds as many events as a companion that stands still for seconds can take afterwards."""
    for cycle in range(8000):
        log.notice(cycle, f"x: emergency {cycle}")
    log.fault(8000, "x: following error")
    assert len(sink.events) < EVENT_SLOTS
    assert any("8 a second" in text for _, _, text in sink.events)
    log.notice(60_000, "x: emergency 0")  # after a pause, each counts again
    assert sink.events[-1] == (60_000, "notice", "x: emergency 0")


def test_warnings_of_years_do_not_fill_the_memory(sink, log):
    for cycle in range(10_000):
        log.warn(cycle, f"warning {cycle}")
    assert (len(log.result.warnings), len(sink.events)) == (100, 10_000)


def test_the_error_without_compensation_stays_in_the_ring_for_whoever_looks_late():
    ring = RingWriter(1, 1)
    log = RunLog(SimpleNamespace(event=ring.push_event), 1e-3)
    log.error_without(0, "x", error_without("x", "rad", 9.0, 9.0, 1.0))
    log.error_without(1, "y", error_without("y", "m", 3e-4, 7e-4, 2.5))
    log.error_without(2, "x", error_without("x", "rad", 1e-4, 2e-4, 1.5))  # after a stop and a start
    for k in range(3 * EVENT_SLOTS):
        messages = Messages()
        for _, name, text in RingObserver(ring.descriptor).new_events():
            messages.take(name, text)
        x, y = messages.error_without["x"], messages.error_without["y"]
        assert (x, y) == ({"rms": 1e-4, "peak": 2e-4, "seconds": 1.5}, {"rms": 3e-4, "peak": 7e-4, "seconds": 2.5})
        log.warn(k, "something")


ENABLED = DriveState.OPERATION_ENABLED


def shown(names, *, width=80, height=24, drive=ENABLED, error=1.25e-4, kinds=(), lost=0):
    """The lines after a second of a run, in which the axes have this constant following error."""
    line = StatusLine(Job(list(names), list(columns.NAMES), 0, 1e-3, 0, kinds=list(kinds)))
    line.show(rows(names, drive, error), lost)
    return line.lines(lost, width, height)


def rows(names, drive=ENABLED, error=1.25e-4, count=1000):
    made, cycle = np.full((count, len(names), len(columns.NAMES)), np.nan), np.arange(count)[:, None]
    values = {"time_s": cycle * 1e-3, "cycle": cycle, "position": 1.0, "position_demand": 1.0 + error}
    values |= {"velocity": -1.5, "compensation": 0.0424, "late_us": 12.0, "state": LoopState.RUNNING}
    for name, value in {**values, "drive_state": drive}.items():
        made[:, :, columns.NAMES.index(name)] = value
    return made.reshape(count, -1)


@pytest.fixture(autouse=True)
def never_printed(monkeypatch):
    monkeypatch.setattr(StatusLine, "_print", lambda *_: None)


def test_one_line_for_the_loop_and_one_for_each_axis():
    loop, x, other = shown(["x", "gripper"], kinds=["rotary", "linear"])
    assert loop == "1.0 s  RUNNING  missed 0  late p99 12 µs  lost 0"
    assert x == "x        error  125 µrad rms  comp  42.4 mN m  velocity -1.50 rad/s"
    assert other == "gripper  error    125 µm rms  comp    42.4 mN  velocity   -1.50 m/s"


@pytest.mark.parametrize(("width", "kept"), [(120, 3), (80, 3), (60, 2), (35, 1), (12, 1)])
def test_the_least_important_parts_go_first(width, kept):
    loop, *axes = shown(["x", "y"], width=width)
    assert max(map(len, [loop, *axes])) <= width
    for text in axes:
        found = [word in text for word in ("error", "comp", "velocity")]
        assert found == [True, True, True][:kept] + [False] * (3 - kept) or width == 12
    assert loop.startswith("1.0 s")


@pytest.mark.parametrize(
    ("name", "given", "words"),
    [
        ("x", {"drive": DriveState.FAULT, "width": 45}, "^(?!.*comp).*  fault"),  # more important than its torque
        ("the_axis_that_carries_the_gripper", {"width": 40}, "^the_axis_that_carr…  error  125 µrad rms$"),
        ("x", {"error": np.nan}, "error         - rms"),  # before anything is known there are no numbers
    ],
)
def test_what_matters_most_is_shown(name, given, words):
    (_, text) = shown([name], **given)
    assert re.search(words, text)


@given(
    st.lists(st.text("abc_0", min_size=1, max_size=60), min_size=1, max_size=40),
    st.integers(1, 200),
    st.integers(1, 60),
    st.floats(-1e6, 1e6),
)
def test_the_lines_never_exceed_the_terminal(names, width, height, error):
    lines = shown(names, width=width, height=height, error=error)
    assert max(map(len, lines)) <= width
    assert len(lines) <= max(height - 1, 2)
    if len(names) + 1 > len(lines):
        left = len(names) - (len(lines) - 2)
        assert f"... and {left} more axes".startswith(lines[-1])


def test_the_cursor_goes_back_to_the_first_line_each_time(monkeypatch):
    monkeypatch.undo()
    screen = io.StringIO()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(status, "_terminal_size", lambda: os.terminal_size((81, 24)))
    monkeypatch.setattr(status, "_INTERVAL_S", 0.0)
    line = StatusLine(Job(["x", "y"], list(columns.NAMES), 0, 1e-3, 0))
    for _ in range(3):
        line.show(rows(["x", "y"]), 0)
    line.close(0)
    # what a terminal makes of it: three lines, over and over
    row, at = [""], 0
    for part in re.split(r"(\r|\n|\x1b\[2A|\x1b\[K)", screen.getvalue()):
        if part == "\n":
            at += 1
            row += [""] * (at + 1 - len(row))
        elif part == "\x1b[2A":
            at -= 2
        elif part not in ("\r", "\x1b[K"):
            row[at] = part or row[at]
    assert [text.split()[0] for text in row if text] == ["1.0", "x", "y"]
    assert row[3:] == [""]


def test_a_part_of_something_longer_says_what_moves_and_for_how_long():
    job = Job(["x"], list(columns.NAMES), 0, 1e-3, 0, status_title="x experiment 2, of 16 s")
    line = StatusLine(job)
    line.show(rows(["x"]), 0)
    assert line.lines(0, 80, 24)[0].startswith("x experiment 2, of 16 s  1.0 s  RUNNING")
