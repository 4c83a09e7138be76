"""Live lines of a run at several widths: parts go from the least important one on, and nothing is wrapped."""

import io
import os
import re
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.daemon.companion import status
from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.companion.status import StatusLine
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState
from friction_hil.recordings import columns

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
