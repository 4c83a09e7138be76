"""What a run keeps of its faults, and of the states of the drives at its end."""

import pytest

from friction_hil.daemon.figures import FeedbackGaps
from friction_hil.daemon.log import RunLog
from friction_hil.drive import DriveState


class Events:
    """A sink that keeps events."""

    def __init__(self):
        self.events = []

    def push(self, row):
        raise AssertionError("a log pushes no rows")

    def event(self, cycle, name, text):
        self.events.append((cycle, name, text))


@pytest.mark.parametrize("state", [DriveState.UNKNOWN, DriveState.OPERATION_ENABLED])
def test_a_drive_that_may_have_power_at_the_end_is_a_fault_after_any_number_of_others(state):
    sink = Events()
    log = RunLog(sink, 1e-3)
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


def test_after_a_reset_the_same_fault_counts_again_however_many_there_were():
    sink = Events()
    log = RunLog(sink, 1e-3)
    for k in range(1000):
        log.fault(k, f"fault {k}")
    log.reset(1000)
    assert not log.has_fault
    log.fault(1001, "fault 0")
    assert log.has_fault
    assert log.result.faults[-1] == "fault 0"
    assert [event for event in sink.events if event[1] == "reset"] == [(1000, "reset", "the fault is reset")]


@pytest.mark.parametrize(
    ("missing", "words"), [(19, ""), (20, "; feedback was missing in 20 of the 100 cycles before")]
)
def test_the_first_fault_names_what_was_missing_before_it(missing, words):
    gaps, log = FeedbackGaps(), RunLog(Events(), 1e-3)
    for cycle in [*range(50), *range(500, 500 + missing)]:  # the first ones are too long ago
        gaps.miss(cycle, "lost")
    log.missed(595, 3, 3_000_000, max_missed=10)
    log.fault(597, "x: too fast [FH-107]", gaps.before(597))
    log.fault(598, "x: too far [FH-108]", gaps.before(598))
    first, second = log.result.faults
    assert first == f"x: too fast; 3 periods were missed 2 ms before{words} [FH-107]"
    assert second == "x: too far [FH-108]"
