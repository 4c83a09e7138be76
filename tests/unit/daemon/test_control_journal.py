"""The journal of the changes: whole entries arrive, nothing else is taken for one, and files hold what they need."""

import itertools
import json
import math
import os
import sys

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from friction_hil import recordings
from friction_hil.compensator.records import FIXED
from friction_hil.daemon.assembly import make_compensator
from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.companion.recorder import Recorder
from friction_hil.daemon.control import journal
from friction_hil.daemon.control.journal import JournalReader, JournalWriter, loop_pages, make_journal, read_only
from friction_hil.daemon.control.message import TEXT_BYTES, Action, AxisChange, Change, pack
from friction_hil.daemon.control.packed import MOST_GAIN, room, unpack
from friction_hil.daemon.ring import RingObserver, RingReader, RingWriter
from friction_hil.drive import AxisFacts
from tests.servo_drives import axis_dict, configuration

FACTS = AxisFacts("x", "servo", 1e-4, 6.4e-4, 2.5e-3, 1.5e-3)


def made(**changes):
    config = configuration(x=axis_dict(**changes)).axes["x"]
    return make_compensator(config, config.model, FACTS, 1e-3)


PRESENT = made()
WANTED = made(compensation={"fade_s": 0.2, "gain": 0.7})
WHOLE = Change(3, Action.NONE, [AxisChange(False, WANTED.record, WANTED.friction_state)], "user 1 set x.gain=0.7 µ")


@pytest.fixture
def ends():
    descriptor = make_journal(room(1))
    yield JournalReader(descriptor), JournalWriter(descriptor)
    os.close(descriptor)


def scribble(journal_end, at, garbage):
    """Write into the pages of the loop; the sequence number is their first word, odd while a block is written."""
    first, length = loop_pages(journal_end.descriptor)
    os.pwrite(journal_end.descriptor, garbage[: length - at], first + at)


def test_a_message_arrives_once_and_its_answer_comes_back(ends):
    reader, writer = ends
    assert not reader.has_news
    writer.post(writer.next_number, b"a block")
    assert reader.has_news
    assert reader.take(5) == b"a block"
    assert not reader.has_news
    assert writer.wait(1, 0.0) is None
    for number, refusal in ((1, ""), (2, "it is not µ-possible")):
        reader.answer(number, 5, refusal)
        assert writer.wait(number, 0.0) == (5, refusal)
    with pytest.raises(ValueError, match="fit"):
        writer.post(2, bytes(writer.capacity + 1))


@settings(max_examples=60)
@given(st.binary(min_size=1, max_size=2000), st.integers(0, 1500), st.integers(-(2**63), 2**63 - 1))
@example(b"\0", 0, -1)
def test_no_garbage_is_taken_for_an_entry_and_the_next_entry_arrives(garbage, at, sequence):
    descriptor = make_journal(room(1))
    reader, writer = JournalReader(descriptor), JournalWriter(descriptor)
    writer.post(1, b"first")
    reader.take(0)
    scribble(reader, at, garbage)
    scribble(reader, 0, sequence.to_bytes(8, sys.byteorder, signed=True))
    try:
        assert reader.take(1) in (None, b"first")
    except ValueError:
        assert reader.take(50) is None  # it rests
    assert JournalWriter(descriptor).next_number == 2  # a successor of who died writing it knows where to go on
    writer.post(2, b"second")
    assert reader.take(500) == b"second"
    os.close(descriptor)


def test_a_change_is_the_same_after_packing():
    message = pack(WHOLE)
    assert len(message) <= room(1)
    found = unpack(message, [PRESENT.record])
    assert (found.number, found.action, found.text) == (3, Action.NONE, WHOLE.text)
    (axis,) = found.axes
    assert axis.is_enabled is False
    assert axis.record.tobytes() == WANTED.record.tobytes()
    np.testing.assert_array_equal(axis.friction, WANTED.friction_state)
    alone = unpack(pack(Change(9, Action.STOP, [], "x" * 500)), [PRESENT.record])
    assert (alone.action, alone.axes, alone.text) == (Action.STOP, [], "x" * TEXT_BYTES)


ODD = [math.nan, math.inf, -math.inf, -1.0, 0.0, 0.5, 1.0, 3.0, 1e9, 1e300, 5e-324]


@settings(max_examples=300)
@given(st.integers(0, len(pack(WHOLE)) // 8 - TEXT_BYTES // 8 - 1), st.sampled_from(ODD) | st.floats())
def test_a_wrong_number_is_refused_or_harmless(place, value):
    """Whatever one number is: no other error than a refusal, and no setting that could harm the axis."""
    numbers = np.frombuffer(pack(WHOLE)[:-TEXT_BYTES], "<f8").copy()
    numbers[place] = value
    try:
        change = unpack(numbers.tobytes() + bytes(TEXT_BYTES), [PRESENT.record])
    except ValueError:
        return
    for axis in [each for each in change.axes if each is not None and each.record is not None]:
        record, present = axis.record[0], PRESENT.record[0]
        assert 0.0 <= record["gain_positive"] <= MOST_GAIN
        assert 0.0 <= record["gain_negative"] <= MOST_GAIN
        assert 0.0 < record["fade_s"] < math.inf
        for name in ("period_s", "torque_limit", "torque_slew", "resolution", "velocity_limit"):
            assert record[name] == present[name]
        assert not np.isnan(record["friction"]).any()
        assert axis.friction is None or np.isfinite(axis.friction).all()


@settings(max_examples=60)
@given(st.binary(max_size=3000))
def test_bytes_that_are_no_change_are_refused(message):
    with pytest.raises(ValueError, match=r"^(it is|its|the|a) "):
        unpack(message, [PRESENT.record])


@pytest.mark.parametrize(("name", "value"), [("gain_positive", 1.6), *((name, 40.0) for name, _ in FIXED)])
def test_what_keeps_an_axis_safe_is_not_to_be_changed(name, value):
    record = WANTED.record.copy()
    record[name] = value
    with pytest.raises(ValueError, match=r"not to be changed|out of its range"):
        unpack(pack(Change(1, Action.NONE, [AxisChange(None, record)])), [PRESENT.record])


def test_another_model_needs_a_state():
    other = made(model=axis_dict()["model"] | {"friction": {"model": "coulomb", "parameters": {"coulomb": 0.1}}})
    with pytest.raises(ValueError, match="needs a state"):
        unpack(pack(Change(1, Action.NONE, [AxisChange(None, other.record)])), [PRESENT.record])


def test_no_number_is_used_twice_and_a_stop_waits_until_it_is_answered(ends):
    reader, writer = ends
    writer.post(1, b"stop", is_stop=True)
    assert writer.is_stop_waiting
    reader.answer(1, 7)
    writer.post(2, b"start")
    writer.withdraw()  # the loop has taken it at this moment, and answers late
    assert (writer.next_number, writer.is_stop_waiting) == (3, False)


def test_who_gets_a_descriptor_for_reading_cannot_write_and_nobody_can_cut_off_what_the_loop_reads(ends):
    reader, writer = ends
    writer.post(1, b"a block", numbered(1))
    descriptor = read_only(reader.descriptor)
    assert journal.entries(descriptor) == [numbered(1)]
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.pwrite(descriptor, b"garbage", 0)
    assert os.fstat(descriptor).st_mode & 0o777 == 0o400  # so that it is not opened again for writing
    with pytest.raises(PermissionError):
        os.ftruncate(writer.descriptor, 0)
    os.close(descriptor)


class Death(BaseException):
    """The writer is killed."""


def dies(call, moment):
    """Call a function that is killed at the line of the journal of this number; True if it came so far."""
    lines, former = itertools.count(1), sys.gettrace()

    def trace(frame, event, _):
        if frame.f_code.co_filename != journal.__file__:
            return None
        if event == "line" and next(lines) == moment:
            raise Death
        return trace

    sys.settrace(trace)
    try:
        call()
    except Death:
        return True
    finally:
        sys.settrace(former)
    return False


def test_a_writer_that_is_killed_at_any_moment_leaves_whole_entries_and_a_successor_goes_on():
    def entry(number):  # the third makes the first superfluous
        return numbered(number, number - 1, 500.0 * (number > 2))

    for moment in itertools.count(1):
        descriptor = make_journal(room(1))
        reader, writer = JournalReader(descriptor), JournalWriter(descriptor)
        for number in (1, 2):
            writer.post(number, b"former", entry(number))
        reader.take(0)
        has_died = dies(lambda writer=writer: writer.post(3, b"third", entry(3), is_stop=True), moment)
        known = [each["number"] for each in journal.entries(descriptor)]
        block = reader.take(1) if reader.has_news else None
        assert known in ([1, 2], [2], [2, 3])
        assert block in (None, b"third")
        successor = JournalWriter(descriptor)
        if block or known == [2, 3]:
            assert (successor.next_number, successor.is_stop_waiting) == (4, True)
        number = successor.next_number
        successor.post(number, b"next", entry(number))
        assert reader.take(2) == b"next"
        assert journal.entries(descriptor)[-1] == entry(number)
        os.close(descriptor)
        if not has_died:
            break
    assert block == b"third"


COLUMNS = ["time_s", "cycle", "change"]


def entry(number):
    """A change whose settings are too long for an event of the ring."""
    return {"number": number, "text": "user 7", "axes": {"x": {"friction": [0.1 * number] * 200}}}


class Recorded:
    """The recorder of a run, with its ring and its journal."""

    def __init__(self, folder, **given):
        self.ring, self.journal = RingWriter(len(COLUMNS), 64), journal.make_journal()
        job = Job(["x"], COLUMNS, 0, 1e-3, 0, path=str(folder / "run.mcap"), **given)
        self.recorder = Recorder(job, RingReader(self.ring.descriptor), self.journal)
        self.recorder.open(1)

    def push(self, cycle, change):
        self.ring.push(np.array([1e-3 * cycle, cycle, change], float))

    def take(self):
        self.recorder.take(self.recorder._ring.drain(), self.recorder._ring.drain_events())

    def close(self):
        """End the recording; all is released, nothing twice: a successor would begin after it."""
        self.recorder.close(was_abandoned=False)
        os.close(self.journal)
        successor = RingReader(self.ring.descriptor)
        assert (len(successor.drain()), successor.drain_events(), successor.lost) == (0, [], 0)


def test_each_file_holds_the_settings_of_its_rows_whole(tmp_path):
    """Also the second file of a run: its worker has not seen the changes that came before."""
    run = Recorded(tmp_path)
    journal.append(run.journal, entry(1))
    for cycle in range(20):
        if cycle == 10:
            journal.append(run.journal, entry(2))
            for event in (("change", "2"), ("fault", "something")):
                run.ring.push_event(cycle, *event)
        run.push(cycle, 1 + (cycle >= 10))
    run.take()
    run.close()
    events = recordings.read(tmp_path / "run.mcap").events
    assert [(event.cycle, event.name) for event in events] == [(0.0, "change"), (10.0, "change"), (10.0, "fault")]
    assert [json.loads(event.text) for event in events[:2]] == [entry(1), entry(2)]


def test_a_change_shortly_before_the_next_file_is_in_the_file_of_its_first_rows(tmp_path):
    run = Recorded(tmp_path, rotate_s=0.01)
    for cycle in range(18):
        if cycle in (8, 14):
            number = 1 + (cycle > 8)
            journal.append(run.journal, entry(number))
            run.ring.push_event(cycle, "change", str(number))
        run.push(cycle, (cycle >= 8) + (cycle >= 14))
    run.take()  # at once, as after a stall of the disk
    run.close()
    files = sorted(tmp_path.glob("*.mcap"))
    assert len(files) == 2
    for file in files:
        alone = file.rename(tmp_path / f"alone{file.stem.removeprefix('run')}x.mcap")  # without the others beside it
        recording = recordings.read(alone)
        events = [json.loads(event.text)["number"] for event in recording.events if event.name == "change"]
        assert set(recording.columns["change"]) <= {0.0, *events}


def numbered(number, before=0, time_s=0.0, models=()):
    axes = {name: {"model_of": model} for name, model in zip("xy", models, strict=False)}
    return {"number": number, "before": before, "time_s": time_s, "text": "user 7", "axes": axes}


def test_a_file_holds_what_its_rows_need_and_nothing_of_the_years_before(tmp_path):
    """Change 9 is in force, with models of 2 and 7; 10 has another one for y. The event of 11 was lost."""
    run = Recorded(tmp_path)
    for number, models in ((2, (2, 0)), (5, (2, 0)), (7, (2, 7)), (9, (2, 7)), (10, (2, 10)), (11, (2, 10))):
        journal.append(run.journal, numbered(number, models=models))
    for cycle, number in enumerate((9, 9, 10, 10, 11)):
        if cycle == 2:
            run.ring.push_event(cycle, "change", "10")
        run.push(cycle, number)
        run.take()
    run.close()
    events = recordings.read(tmp_path / "run.mcap").events
    found = {json.loads(event.text)["number"]: event.cycle for event in events}
    assert (len(events), found) == (5, {2: 0.0, 7: 0.0, 9: 0.0, 10: 2.0, 11: 0.0})


@given(st.lists(st.tuples(st.floats(0.0, 100.0), st.booleans(), st.sampled_from(["", "x", "y"])), max_size=40))
def test_the_journal_keeps_what_rows_of_the_last_minutes_were_computed_with(asked):
    """Some changes bring a model, some are refused by the loop."""
    changes = journal.make_journal()
    now_s, in_force, models, history = 0.0, 0, {"x": 0, "y": 0}, [(0.0, 0, {0})]
    for number, (pause_s, is_taken, axis) in enumerate(asked, start=1):
        now_s += pause_s
        wanted = models | ({axis: number} if axis else {})
        journal.keep(changes, journal.needed(journal.entries(changes), in_force, now_s))
        journal.append(changes, numbered(number, in_force, now_s, wanted.values()))
        known = {entry["number"] for entry in journal.entries(changes)} | {0}
        ends_s = [start_s for start_s, _, _ in history[1:]] + [math.inf]
        needed = [each for each, end_s in zip(history, ends_s, strict=True) if end_s >= now_s - journal.KEPT_S]
        assert {one for _, change, of in needed for one in {change} | of} <= known
        if is_taken:
            in_force, models = number, wanted
            history.append((now_s, number, set(models.values())))
    os.close(changes)


def test_the_journal_does_not_grow_with_the_changes():
    changes = journal.make_journal()
    for number in range(1, 1001):
        journal.keep(changes, journal.needed(journal.entries(changes), number - 1, 60.0 * number))
        journal.append(changes, numbered(number, number - 1, 60.0 * number, (number - number % 100, 0)))
    kept = journal.entries(changes)
    assert [entry["number"] for entry in kept] == [900, 996, 997, 998, 999, 1000]
    assert os.fstat(changes).st_size - sum(journal.loop_pages(changes)) < 5000
    os.close(changes)


def test_an_observer_takes_nothing_from_the_reader():
    ring = RingWriter(2, 32)
    observer, reader = RingObserver(ring.descriptor), RingReader(ring.descriptor)
    assert observer.newest(5).shape == (0, 2)
    for k in range(100):
        ring.push(np.array([k, -k], float))
    np.testing.assert_array_equal(observer.newest(3)[:, 0], [97.0, 98.0, 99.0])
    assert len(observer.newest(1000)) == 16  # the older half may be overwritten at any moment
    ring.push_event(3, "fault", "first")
    assert observer.new_events() == [(3.0, "fault", "first")]
    assert observer.new_events() == []
    assert len(reader.drain()) == 32
    assert reader.drain_events() == [(3.0, "fault", "first")]
