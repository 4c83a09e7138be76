"""Changes of a running daemon in the files that the companion writes."""

import json
import math
import os

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from friction_hil import recordings
from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.companion.recorder import Recorder
from friction_hil.daemon.control import journal
from friction_hil.daemon.ring import RingObserver, RingReader, RingWriter

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
            run.ring.push_event(cycle, "change", "2")
            run.ring.push_event(cycle, "fault", "something")
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
