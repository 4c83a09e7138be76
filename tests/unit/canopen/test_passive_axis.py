"""A drive that another master moves, in a dry run: frames in, sets of one instant out."""

import struct

import pytest
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.canopen.cycle.listener import STEPPED_TIMEOUT_S, STEPPED_TIMEOUTS
from friction_hil_drivers.canopen.cycle.passive import PassiveAxis, PassiveExchange
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.codec import FEEDBACK
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.daemon.realtime import SteppedClock
from friction_hil.drive import DriveState, Feedback
from friction_hil.errors import DriveError
from tests.canopen_axis_bench import EMCY, HEARTBEAT, MS, NODE, TPDO1, TPDO2, UNITS, answers, drive_of


def axis_of(*, is_synchronous=(True, True), second=FEEDBACK[1]):
    layouts = struct.Struct("<Hih"), struct.Struct("<ib")
    tpdos = tuple(
        MappedPdo(can_id, entries, layout, number, is_synchronous=is_sync)
        for number, (can_id, entries, layout, is_sync) in enumerate(
            zip((TPDO1, TPDO2), (FEEDBACK[0], second), layouts, is_synchronous, strict=True)
        )
    )
    return PassiveAxis(drive_of(tpdos=tpdos, rpdos=()), NODE)


def frames(instant):
    """What the drive sends at one instant: position and velocity are the same number of increments."""
    return answers(instant, velocity=instant)


def take(axis, *frames, sync=True):
    if sync:
        axis.on_sync()
    for can_id, data in frames:
        axis.handlers[can_id](data)


def report(axis, cycle):
    feedback = Feedback()
    axis.report(feedback, cycle * MS)
    return feedback


@given(st.lists(st.sampled_from("SABR"), max_size=60))
def test_position_and_velocity_of_a_set_are_of_one_instant(events):
    """SYNC, either TPDO (sent at most once after a SYNC), a report: in whatever order, and however many are missing."""
    axis, instant, sent, cycle = axis_of(), 0, set(), 0
    for event in events:
        if event == "S":
            axis.on_sync()
            instant, sent = instant + 1, set()
        elif event == "R":
            cycle += 1
            heard = report(axis, cycle)
            if heard.is_fresh:
                assert heard.position * UNITS.counts_per_unit == heard.velocity * UNITS.velocity_per_unit
            else:
                assert "did not come: its master has stopped?" in heard.missing
        elif instant and event not in sent:
            sent.add(event)
            can_id, data = frames(instant)["AB".index(event)]
            axis.handlers[can_id](data)


def test_each_set_is_reported_once():
    axis = axis_of()
    take(axis, *frames(3))
    assert axis.is_complete
    assert [report(axis, cycle).is_fresh for cycle in (1, 2)] == [True, False]
    take(axis, frames(3)[0], sync=False)  # a bus that doubles it makes no new set
    assert not report(axis, 3).is_fresh


def test_tpdos_without_sync_make_a_set_whenever_all_have_come():
    axis = axis_of(is_synchronous=(False, False))
    for instant in (1, 2):
        for frame in frames(instant):
            assert not axis.is_complete
            take(axis, frame, sync=False)
        heard = report(axis, instant)
        assert (heard.is_fresh, heard.position, heard.message) == (True, instant / UNITS.counts_per_unit, "")


def test_what_comes_seldom_is_not_waited_for_and_until_then_nothing_of_it_is_known():
    """Its statusword and mode come when they change: the position comes with each SYNC."""
    axis = axis_of(is_synchronous=(True, False), second=(objects.VELOCITY_ACTUAL, objects.MODE_DISPLAY))
    take(axis, frames(5)[0])
    assert report(axis, 1).is_fresh
    take(axis, frames(7)[1], sync=False)
    take(axis, frames(8)[0])
    heard = report(axis, 2)
    assert (heard.position, heard.velocity) == (8 / UNITS.counts_per_unit, 7 / UNITS.velocity_per_unit)


@pytest.mark.parametrize("size", [0, 7, 9])
def test_a_tpdo_of_another_length_is_no_feedback_and_named(size):
    axis = axis_of()
    take(axis, (TPDO1, bytes(size)), frames(1)[1])
    heard = report(axis, 1)
    assert not heard.is_fresh
    assert f"TPDO 1 has {size} bytes" in heard.missing


def test_emergencies_and_a_restart_are_noticed_and_are_no_fault():
    axis = axis_of()
    take(axis, (EMCY, bytes.fromhex("1186200000000000")), (HEARTBEAT, b"\x00"), sync=False)
    heard = report(axis, 1)
    assert [notice.partition(" ")[0] for notice in heard.notices] == ["emergency", "node"]
    assert (heard.error, heard.message, heard.state) == ("8611h following error", "", DriveState.UNKNOWN)


class SilentBus:
    """A bus on which nothing comes; the times for which it was waited for."""

    def __init__(self):
        self.waited_s = []

    def receive(self, timeout):
        if timeout:
            self.waited_s.append(timeout)


def test_a_master_that_has_ended_ends_a_dry_run_in_simulated_time():
    bus = SilentBus()
    exchange = PassiveExchange(bus, [axis_of()], SteppedClock(), period_s=1e-3, sync_id=0x80)
    for _ in range(STEPPED_TIMEOUTS - 1):
        exchange.receive([Feedback()], 0)
    with pytest.raises(DriveError, match="FH-221"):
        exchange.receive([Feedback()], 0)
    assert bus.waited_s == [STEPPED_TIMEOUT_S] * STEPPED_TIMEOUTS
