"""The stop of one drive: its table, and what must hold whatever is lost between the stop and the drive."""

from dataclasses import dataclass
from pathlib import Path

import hypothesis
import pytest
from hypothesis import strategies as st

from friction_hil.drive import DriveState
from friction_hil.drive.stop import DriveStop, StopState

MS = 1_000_000


@dataclass
class Drive:
    """A drive on a ramp, in milliseconds and counts."""

    speed: float = 50.0  # counts per millisecond
    deceleration: float = 0.5
    position: float = 0.0
    state: DriveState = DriveState.OPERATION_ENABLED
    obeys: bool = True
    is_enabled_again_at: int | None = None

    def pass_millisecond(self, now_ms: int) -> None:
        if self.state is DriveState.QUICK_STOP_ACTIVE:
            self.speed = max(0.0, self.speed - self.deceleration)
        self.position += self.speed
        if now_ms == self.is_enabled_again_at:
            self.state = DriveState.OPERATION_ENABLED

    def carry_out(self, step: StopState) -> None:
        if step is StopState.QUICK_STOP and self.obeys and self.state is DriveState.OPERATION_ENABLED:
            self.state = DriveState.QUICK_STOP_ACTIVE
        elif step is StopState.DISABLE:
            self.state = DriveState.SWITCH_ON_DISABLED


def follow(stop: DriveStop, drive: Drive, end_ms: int, lost=lambda _: False, latency_ms: int = 3) -> list:
    """Run a stop against a drive; return each step with its time, and the drive's speed then."""
    steps, under_way, until_ms = [], None, 0
    for now_ms in range(end_ms):
        drive.pass_millisecond(now_ms)
        if under_way is not None and now_ms >= until_ms:
            answer(stop, drive, under_way, now_ms, is_lost=lost(len(steps) - 1))
            under_way = None
        if under_way is None and (step := stop.step(now_ms * MS)) is not None:
            steps.append((now_ms, step, drive.speed))
            under_way, until_ms = step, now_ms + latency_ms
    return steps


def answer(stop: DriveStop, drive: Drive, step: StopState, now_ms: int, *, is_lost: bool) -> None:
    if is_lost:
        stop.take_silence()
    elif step.reads_state:
        stop.take_state(drive.state, now_ms * MS)
    elif step is StopState.STANDSTILL:
        stop.take_position(drive.position, now_ms * MS)
    else:
        drive.carry_out(step)
        stop.take_command(now_ms * MS)


def first(steps: list, wanted: StopState) -> tuple[int, float]:
    return next((time, speed) for time, step, speed in steps if step is wanted)


def test_a_moving_drive_comes_to_rest_before_it_is_disabled() -> None:
    stop, drive = DriveStop(2.0), Drive()
    steps = follow(stop, drive, 400)
    assert steps[0][1] is StopState.QUICK_STOP
    at_ms, speed = first(steps, StopState.DISABLE)
    assert speed == 0.0
    assert 150 <= at_ms <= 100 + 50 + 12  # 100 ms of ramp, 50 ms at rest, and the steps between
    assert stop.is_proved
    assert stop.state is DriveState.SWITCH_ON_DISABLED


@pytest.mark.parametrize(
    ("given", "has_state", "begin_ms", "end_ms"),
    [
        ({"obeys": False}, True, 101, 109),
        ({"speed": 0.0, "obeys": False}, False, 50, 69),
        ({"deceleration": 0.0}, True, 2001, 2004),
    ],
    ids=["ignores the quick stop", "shows no quick stop: by its position", "does not come to rest"],
)
def test_a_drive_that_does_not_stop_as_it_should_is_disabled_in_time(given, has_state, begin_ms, end_ms) -> None:
    steps = follow(DriveStop(2.0, has_quick_stop_state=has_state), drive := Drive(**given), 2300)
    assert begin_ms <= first(steps, StopState.DISABLE)[0] <= end_ms
    assert drive.state is DriveState.SWITCH_ON_DISABLED


def test_noise_and_a_counter_that_begins_anew_are_no_motion() -> None:
    stop = DriveStop(2.0, counter_range=2.0**32)
    stop.begin(0, StopState.STANDSTILL)
    edge = 2**31
    for k, position in enumerate((edge - 1, -edge, edge - 1, -edge + 1, edge - 1, edge - 1)):
        stop.at = StopState.STANDSTILL
        stop.take_position(position, 10 * k * MS)
    assert stop.at is StopState.DISABLE


def test_a_drive_that_is_enabled_again_is_disabled_again_and_not_called_off_meanwhile() -> None:
    stop, drive = DriveStop(2.0), Drive(speed=0.0, is_enabled_again_at=400)
    follow(stop, drive, 390)
    assert stop.is_proved
    follow(stop, drive, 700)
    assert stop.is_proved
    stop.take_state(DriveState.OPERATION_ENABLED, 1000 * MS)
    assert not stop.is_proved
    assert stop.step(1000 * MS) is StopState.DISABLE


def test_a_command_ends_after_two_readings_without_power_or_two_steps_without_an_answer() -> None:
    stop = DriveStop(2.0)
    stop.begin(0, StopState.DISABLE)
    stop.take_command(1 * MS)
    stop.take_state(DriveState.SWITCH_ON_DISABLED, 2 * MS)
    assert not stop.is_over(2000 * MS)
    stop.take_state(DriveState.SWITCH_ON_DISABLED, 102 * MS)
    assert stop.is_over(102 * MS)
    stop.begin(0)
    stop.take_silence()
    assert not stop.is_over(0)
    stop.take_silence()
    assert stop.is_over(0)


def test_a_quick_stop_that_was_answered_has_its_two_seconds_although_nothing_follows() -> None:
    stop = DriveStop(2.0)
    stop.begin(0)
    stop.take_command(10 * MS)
    assert not stop.is_over(1999 * MS)
    stop.take_silence()
    assert stop.step(1999 * MS) is StopState.QUICK_STOP
    stop.take_command(1999 * MS)
    stop.take_silence()
    assert not stop.is_over(1999 * MS)  # one step in a row
    assert stop.step(2001 * MS) is StopState.DISABLE


def test_a_command_waits_a_second_for_the_power_to_go_however_slow_the_answers_are() -> None:
    stop = DriveStop(2.0)
    stop.begin(0)
    stop.take_command(3000 * MS)
    assert stop.step(3000 * MS) is StopState.DISABLE
    assert not stop.is_over(3000 * MS)
    stop.take_command(6000 * MS)
    stop.take_state(DriveState.OPERATION_ENABLED, 6900 * MS)
    assert [stop.is_over(at_ms * MS) for at_ms in (6900, 7001)] == [False, True]


@hypothesis.given(st.lists(st.booleans(), max_size=60), st.integers(1, 40), st.booleans())
def test_whatever_is_lost_power_is_taken_in_time_and_only_a_reading_proves_it(lost, latency_ms, obeys) -> None:
    stop, drive = DriveStop(2.0), Drive(obeys=obeys)
    steps = follow(stop, drive, 6000, lambda k: k < len(lost) and lost[k], latency_ms)
    assert steps[0][1] is StopState.QUICK_STOP
    assert drive.state is DriveState.SWITCH_ON_DISABLED
    assert stop.is_proved
    disabled = [at for at, step, _ in steps if step is StopState.DISABLE]
    assert all(step is not StopState.QUICK_STOP for at, step, _ in steps if at > disabled[0])
    stop.take_silence()
    assert not stop.is_proved
    assert stop.state is DriveState.UNKNOWN


@pytest.mark.parametrize("state", StopState)
def test_the_page_has_a_row_for_each_state(state) -> None:
    page = Path(__file__).parents[3] / "drivers/friction_hil_drivers/canopen/stopping.md"
    assert f"\n| {state.name} | " in page.read_text()
