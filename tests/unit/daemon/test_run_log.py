"""What a run keeps of its faults, and of the states of the drives at its end."""

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.daemon.control.state import Messages, error_without
from friction_hil.daemon.figures import FeedbackGaps
from friction_hil.daemon.log import RunLog
from friction_hil.daemon.ring import EVENT_SLOTS, RingObserver, RingWriter
from friction_hil.drive import DriveState
from tests.messages import codes_in


class Events:
    """A sink that keeps events."""

    def __init__(self):
        self.events = []

    def event(self, cycle, name, text):
        self.events.append((cycle, name, text))


@pytest.fixture
def sink():
    return Events()


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
    sink = Events()
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
