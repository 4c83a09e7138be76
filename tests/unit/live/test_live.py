"""Live data: figures, strips and the circle from rows, and attaching to daemons in whatever state they are."""

import json
import math
import os
import threading
import time
from dataclasses import asdict, replace
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from friction_hil import errors
from friction_hil.analysis.baseline import without_and_with
from friction_hil.cli.work.control import _lines
from friction_hil.config import Circle, self_contained
from friction_hil.daemon.control.ask import ask
from friction_hil.daemon.control.desk import Desk
from friction_hil.daemon.control.job import ControlJob
from friction_hil.daemon.control.journal import make_journal
from friction_hil.daemon.control.lock import ControlSocket
from friction_hil.daemon.control.names import find
from friction_hil.daemon.control.packed import room
from friction_hil.daemon.control.server import ControlServer
from friction_hil.daemon.control.state import error_without
from friction_hil.daemon.figures import SETTLE_S
from friction_hil.daemon.learning_board import LearningBoard
from friction_hil.daemon.ring import RingWriter
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState
from friction_hil.live import LiveFacts, LiveFigures, Reading, Rows, Settings, Watch, attach, friction_map
from friction_hil.live.reading import AxisSettings, LiveEvent
from friction_hil.live.values import values_of
from friction_hil.live.web.circle import CircleTracer
from friction_hil.live.web.metrics import metrics_text
from friction_hil.live.web.strips import BUCKET_S, WINDOW_S, Strips
from friction_hil.numerics.json_values import to_json
from friction_hil.recordings import Recording, columns
from tests.servo_drives import axis_dict, configuration

PERIOD_S, FADE_S, RAMP_S = 1e-3, 0.1, 0.2
CONFIGURATION = self_contained(configuration(x=axis_dict()))


def facts(remedies=None):
    return LiveFacts(
        *("mill", "1", "mill.yaml", CONFIGURATION, PERIOD_S, RAMP_S, 0, ("x",), {"x": "rotary"}, columns.NAMES),
        *({"x": {"torque_delay_s": 0.0}}, False, remedies or {}),
    )


def settings(model=None):
    axis = CONFIGURATION["axes"]["x"]
    given = {**axis["compensation"], "fade_s": FADE_S}
    return Settings(0, {"x": AxisSettings(given, model or axis["model"], None)})


def rows(count, first=0, **values):
    """Rows of one axis in motion; each value is a number or (count,)."""
    cycle = first + np.arange(count)
    known = {"cycle": cycle, "time_s": cycle * PERIOD_S, "state": LoopState.RUNNING, "is_fresh": 1.0, "is_enabled": 1.0}
    known |= {"drive_state": DriveState.OPERATION_ENABLED, "position": 0.0, "position_demand": 0.0, "change": 0.0}
    table = np.full((count, 1, len(columns.NAMES)), math.nan)
    for name, value in (known | values).items():
        table[:, 0, columns.NAMES.index(name)] = value
    return Rows(facts(), table)


def reading(found, lost=0, events=(), stands=False, model=None):
    return Reading(found, lost, tuple(events), settings(model), stands, False)


def parts(found, sizes):
    """The same rows in parts."""
    ends = np.cumsum(sizes)
    return [Rows(facts(), each) for each in np.split(found.values, ends[ends < len(found)])]


def test_only_steady_motion_counts_and_each_condition_by_itself():
    count = 4000
    is_on = np.arange(count) >= 2000
    error = np.where(is_on, 0.1, 0.5)
    begin = round((RAMP_S + SETTLE_S) / PERIOD_S)
    error[:begin] = 9.0  # ramp
    error[2000 : 2000 + round((FADE_S + SETTLE_S) / PERIOD_S)] = 7.0  # fade
    found = rows(count, is_enabled=is_on, position_demand=error)
    figures = LiveFigures(facts(), window_s=20.0)
    for part in parts(found, [1, 3, 1500, 700, 900]):
        figures.take(reading(part))
    x = figures.snapshot().axes["x"]
    assert (x.without.peak, x.compensated.peak) == (0.5, 0.1)
    assert x.without.rms == pytest.approx(0.5)
    assert x.without.seconds == pytest.approx(2.0 - RAMP_S - SETTLE_S)
    assert x.compensated.seconds == pytest.approx(2.0 - FADE_S - SETTLE_S)
    assert x.error == 0.1


@hypothesis_settings(max_examples=15, deadline=None)
@given(st.sets(st.integers(1, 3998), max_size=2), st.sets(st.integers(0, 3999), max_size=2), st.integers(1200, 2800))
def test_a_recording_of_the_same_rows_has_the_same_following_error(missed, late, switched):
    cycle = np.delete(np.arange(4000.0), list(missed))
    is_fresh = ~np.isin(cycle, list(late))
    columns_there = {"cycle": cycle, "time_s": cycle * PERIOD_S, "is_enabled": cycle >= switched, "is_fresh": is_fresh}
    columns_there |= {"position_demand": np.sin(cycle), "position": np.zeros(len(cycle))}
    columns_there |= {"state": np.full(len(cycle), LoopState.RUNNING), "drive_state": np.zeros(len(cycle))}
    recorded = Recording("mill.mcap", "x", {name: each.astype(float) for name, each in columns_there.items()})
    phases = without_and_with(recorded, cycle_s=PERIOD_S, motion_s=math.inf, start_s=RAMP_S, fade_s=FADE_S)
    figures = LiveFigures(facts(), window_s=20.0)
    for part in parts(rows(len(cycle), **columns_there), [1, 3, 1500, 700]):
        figures.take(reading(part))
    x = figures.snapshot().axes["x"]
    for live, phase in zip((x.without, x.compensated), phases, strict=True):
        assert (live is None) == (phase is None)
        if phase is not None:
            assert live.rms == pytest.approx(phase.figures.rms, rel=1e-12)
            assert live.peak == phase.figures.peak


def test_compensation_that_was_taken_back_is_shown_as_off_until_it_is_switched_on_again():
    figures = LiveFigures(facts())
    figures.take(reading(rows(100, is_enabled=0.0)))  # in the time without compensation at the start
    assert figures.snapshot().axes["x"].is_enabled
    news = LiveEvent(100, 0.1, "warning", "x: compensation makes the following error larger: it is taken back [FH-129]")
    figures.take(reading(rows(100, first=100, is_enabled=0.0), events=[news]))
    assert not figures.snapshot().axes["x"].is_enabled
    figures.take(reading(rows(100, first=200)))
    assert figures.snapshot().axes["x"].is_enabled


def test_missed_periods_are_told_from_rows_that_were_lost_on_the_way_here():
    figures = LiveFigures(facts())
    figures.take(reading(rows(100)))
    figures.take(reading(rows(100, first=153, late_us=np.arange(100.0)), lost=50))
    shown = figures.snapshot()
    assert (shown.missed, shown.lost) == (3, 50)
    assert (shown.lateness.counts.sum(), shown.lateness.max_us) == (100, 99.0)
    assert shown.lateness.p50_us == pytest.approx(49.5)
    np.testing.assert_array_equal(shown.lateness.counts[:4], [2, 1, 3, 5])  # up to 1, 2, 5, 10 us


def test_friction_is_the_measured_torque_less_inertia_gravity_and_offset():
    time_s = np.arange(6000) * PERIOD_S
    omega, inertia = 4.0, 2e-3
    velocity, acceleration = 2.0 * np.sin(omega * time_s), 2.0 * omega * np.cos(omega * time_s)
    position = -2.0 / omega * np.cos(omega * time_s)
    torque = 0.1 * np.sign(velocity) + 0.02 * velocity + inertia * acceleration + 0.3 * np.sin(position) + 0.05
    model = {"version": 1, "axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": 0.1}}}
    model["friction"]["parameters"]["viscous"] = 0.02
    model["mechanics"] = {"inertia": inertia, "offset": 0.05, "gravity": {"sine": 0.3}}
    figures = LiveFigures(facts())
    found = rows(6000, position=position, velocity=velocity, torque=torque)
    for part in parts(found, [100] * 60):
        figures.take(reading(part, model=model))
    traced = figures.snapshot().axes["x"].friction
    away = np.abs(traced.velocity) > 0.05
    expected = 0.1 * np.sign(traced.velocity) + 0.02 * traced.velocity
    np.testing.assert_allclose(traced.torque[away], expected[away], atol=2e-3)
    assert traced.count.sum() == pytest.approx(5700 / 3, rel=0.05)  # of the last minute, 20000 points
    curve = np.interp(1.0, traced.curve_velocity, traced.curve_torque)
    assert curve == pytest.approx(0.12, rel=1e-3)


def test_no_friction_is_measured_on_a_joint_of_an_arm():
    arm = {"file": "arm.urdf", "joints": {"x": "joint1"}}
    figures = LiveFigures(replace(facts(), configuration={**CONFIGURATION, "arm": arm}))
    figures.take(reading(rows(6000, velocity=1.0, torque=0.3)))
    traced = figures.snapshot().axes["x"].friction
    assert traced.count.sum() == 0
    assert "weight" in traced.note


def test_faults_stay_until_they_are_reset_and_have_their_remedy():
    figures = LiveFigures(facts({"FH-103": "check the cable"}), faults=["an old one"])
    none = rows(0)
    late = LiveEvent(5, 5e-3, "fault", "x: no usable feedback [FH-103]")
    figures.take(reading(none, events=[late, LiveEvent(6, 6e-3, "warning", "slow")]))
    shown = figures.snapshot()
    assert [each.text for each in shown.faults] == ["an old one", late.text]
    assert (shown.faults[1].code, shown.faults[1].remedy) == ("FH-103", "check the cable")
    assert [each.text for each in shown.warnings] == ["slow"]
    figures.take(reading(none, events=[LiveEvent(7, 7e-3, "reset", "the fault is reset")]))
    assert figures.snapshot().faults == ()


def test_a_loop_that_stands_proves_nothing_of_its_drives_and_json_has_no_nan():
    figures = LiveFigures(facts())
    figures.take(reading(rows(10)))
    assert (figures.snapshot().state, figures.snapshot().axes["x"].is_powered) == ("running", True)
    figures.take(reading(rows(0), stands=True))
    shown = figures.snapshot()
    assert (shown.state, shown.axes["x"].drive_state, shown.axes["x"].is_powered) == ("unknown", "unknown", None)
    assert math.isnan(shown.axes["x"].position)  # the last one is no present one
    assert math.isnan(shown.axes["x"].error)
    assert json.loads(json.dumps(to_json(asdict(shown)), allow_nan=False))["axes"]["x"]["position"] is None


def test_code_is_compiled_before_the_first_rows_are_read(monkeypatch):
    spies = [mock.Mock(wraps=getattr(friction_map, name)) for name in ("steady_curve", "replay_segments")]
    monkeypatch.setattr(friction_map, "steady_curve", spies[0])
    monkeypatch.setattr(friction_map, "replay_segments", spies[1])
    figures = LiveFigures(facts())
    assert [spy.call_count for spy in spies] == [1, 1]
    figures.take(reading(rows(0)))
    assert figures.snapshot().axes["x"].friction.note == "no motion yet"  # of that nothing is left


@pytest.fixture
def folder(tmp_path_factory, monkeypatch):
    found = tmp_path_factory.mktemp("s")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(found))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    return found


class Daemon:
    """The control socket of a daemon whose loop is played by the test."""

    def __init__(self, name="mill"):
        self.socket = ControlSocket(name)
        self.ring = RingWriter(len(columns.NAMES) + 2, 64)
        self.journal = make_journal(room(1))
        job = ControlJob(name, CONFIGURATION, "mill.yaml", [], list(columns.NAMES), 2)
        self.board = LearningBoard()
        desk = Desk(job, self.ring.descriptor, self.journal, self.board.descriptor)
        self.answer = desk.answer

    def push(self, count, **values):
        for _ in range(count):
            row = np.full(len(columns.NAMES) + 2, math.nan)
            for name, value in {"cycle": self.ring.rows_pushed, **values}.items():
                row[columns.NAMES.index(name)] = value
            self.ring.push(row)

    def serve(self):
        self.server = ControlServer(self.socket.descriptor, lambda: self.answer)
        threading.Thread(target=self.server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()

    def end(self):
        self.ring.close_writing()
        self.server.shutdown()
        self.server.server_close()
        self.socket.close()


def polled(watch):
    end_s = time.monotonic() + 10.0
    while (live := watch.poll()) is None:
        assert time.monotonic() < end_s
        time.sleep(0.01)
    return live


def test_a_watch_waits_for_a_daemon_that_starts_and_goes_over_to_the_next_one(folder):
    with Watch("mill") as watch:
        assert watch.poll() is None
        first = Daemon()
        assert watch.poll() is None  # it listens, and answers once it has started
        first.serve()
        first.push(5)
        live = polled(watch)
        assert [len(live.read().rows), len(live.read().rows)] == [5, 0]
        first.push(60)
        late = live.read()
        np.testing.assert_array_equal(late.rows.of("x", "cycle"), np.arange(33.0, 65.0))
        assert late.lost == 28
        first.push(1)
        first.end()
        last = live.read()
        assert (last.is_over, len(last.rows)) == (True, 1)
        assert watch.poll() is None
        second = Daemon()
        second.serve()
        assert polled(watch) is not live
        second.end()


def test_a_daemon_that_was_killed_is_over_and_one_that_stands_is_not(folder, monkeypatch):
    monkeypatch.setattr("friction_hil.live.attachment.STANDS_S", 0.0)
    monkeypatch.setattr("friction_hil.live.attachment._SIGHT_S", 0.0)
    daemon = Daemon()
    daemon.serve()
    with attach("mill") as live:
        standing = live.read()
        assert (standing.stands, standing.is_over) == (True, False)
        daemon.server.shutdown()
        daemon.server.server_close()
        daemon.socket._socket.close()  # as the kernel does it; the file stays
        assert live.read().is_over


def test_what_cannot_be_attached_is_named(folder):
    with pytest.raises(errors.UsageError, match="no daemon called 'mill'"):
        attach("mill")
    daemon = Daemon()
    daemon.serve()
    answer = daemon.answer
    try:
        daemon.answer = lambda line, user: {"ok": False, "problems": ["do: nothing is called 'observe'; there are: x"]}
        with pytest.raises(errors.FrictionHilError, match="earlier version"):
            attach("mill")
        daemon.answer = lambda line, user: answer(line, user) | {"version": "99", "columns": ["cycle"]}
        before = len(os.listdir("/proc/self/fd"))
        with pytest.raises(errors.FrictionHilError, match="friction-hil 99"):
            attach("mill")
        assert len(os.listdir("/proc/self/fd")) <= before + 1  # of the server's side
    finally:
        daemon.end()


def of_x(live, figures):
    figures.take(live.read())
    return figures.snapshot().axes["x"]


def test_who_attaches_after_the_time_without_compensation_sees_its_error_too(folder):
    daemon = Daemon()
    daemon.serve()
    running = {"state": LoopState.RUNNING, "position": 0.0, "is_fresh": 1.0, "change": 0.0}
    settle = round((RAMP_S + SETTLE_S) / PERIOD_S) + 1

    def tell(rms, seconds):
        daemon.ring.push_event(daemon.ring.rows_pushed, "error_without", error_without("x", "rad", rms, 2.0, seconds))

    try:
        with attach("mill") as early:
            seen = LiveFigures(early.facts, early.faults)
            assert of_x(early, seen).without is None
            for _ in range(settle // 20 + 1):
                daemon.push(20, **running, is_enabled=0.0, position_demand=0.5)
                own = of_x(early, seen).without
            assert own.rms == 0.5
            tell(1.0, 9.5)
            daemon.push(64, **running, is_enabled=1.0, position_demand=0.1)
            told = of_x(early, seen).without
            assert (told.rms, told.peak, told.seconds) == (1.0, 2.0, 9.5)  # of all of it
        with attach("mill") as late:
            seen = LiveFigures(late.facts, late.faults)
            assert of_x(late, seen).without == told
            text = "1.00 rad RMS, 2.00 rad peak"
            assert dict(values_of(seen.snapshot().axes["x"]))["Error without"] == text
            metrics = metrics_text("mill", seen.snapshot(), {})
            assert 'following_error_rms_radians{axis="x",compensation="off",daemon="mill"} 1.0\n' in metrics
            assert to_json(asdict(seen.snapshot()))["axes"]["x"]["without"] == {"rms": 1.0, "peak": 2.0, "seconds": 9.5}
            lines = _lines("mill", ask(find("mill"), {"do": "status"}))
            assert f"     following error without compensation {text}" in lines
            for _ in range(settle // 20 + 1):  # another time without compensation
                daemon.push(20, **running, is_enabled=0.0, position_demand=0.25)
                own = of_x(late, seen).without
            assert own.rms == 0.25
            tell(3.0, 4.0)
            assert of_x(late, seen).without.rms == 3.0
    finally:
        daemon.end()


@given(
    st.lists(st.floats(-1e3, 1e3) | st.just(np.nan), min_size=1, max_size=300),
    st.lists(st.integers(1, 120), min_size=1, max_size=6),
)
def test_however_rows_arrive_no_peak_is_lost_and_nothing_is_invented(values, parts):
    strips, column = Strips(1, 1e-3), np.array(values)
    time, found = 1e-3 * np.arange(len(column)), []
    for at in np.split(np.arange(len(column)), np.cumsum(parts)):
        times, [points] = strips.take(time[at], column[at, None])
        found += zip(times, points, strict=True)
    ends = np.floor(time / BUCKET_S)
    complete = ends < ends[-1]
    for bucket in np.unique(ends[complete]):
        inside = column[ends == bucket]
        known = inside[np.isfinite(inside)]
        shown = [value for at, value in found if int(at / BUCKET_S + 1e-6) == bucket]
        assert len(shown) == 2
        if known.size:
            assert sorted(shown) == pytest.approx([known.min(), known.max()], rel=1e-6)
        else:
            assert shown == [None, None]
    assert len(found) == 2 * len(np.unique(ends[complete]))


def test_a_gap_breaks_the_line_and_the_window_has_an_end():
    strips = Strips(1, 1e-3)
    time = np.concatenate([np.arange(0.0, 1.0, 1e-3), np.arange(2.0, 40.0, 1e-3)])
    times, [values] = strips.take(time, np.ones((len(time), 1)))
    [gap] = [at for at, value in zip(times, values, strict=True) if value is None]
    assert 1.0 < gap < 2.0
    kept, _ = strips.window()
    assert kept[-1] - kept[0] == pytest.approx(WINDOW_S, abs=BUCKET_S)


def test_slow_rows_are_all_shown():
    times, [values] = Strips(1, 0.05).take(0.05 * np.arange(9), np.arange(9.0)[:, None])
    assert (len(times), values) == (9, list(range(9)))


class Facts:
    """What the tracer of the circle needs of a daemon."""

    period_s, ramp_s = 1e-3, 0.2
    axes = ("x", "y")
    columns = ("cycle", "position", "position_demand", "state", "is_fresh", "is_enabled")


def turning(cycles, error, *, state=LoopState.RUNNING):
    """Rows of two axes on a circle of radius 2 about (1, -3), with a radius error that depends on the angle."""
    angle = 2.0 * np.pi * 0.5 * 1e-3 * cycles
    ones, rows = np.ones(len(cycles)), []
    for centre, way in ((1.0, np.cos(angle)), (-3.0, np.sin(angle))):
        rows.append([cycles, centre + (2.0 + error(angle)) * way, centre + 2.0 * way, state * ones, ones, ones])
    return Rows(Facts, np.moveaxis(np.array(rows), 2, 0))


def test_the_circle_shows_the_radius_error_over_the_angle_and_only_of_whole_laps_in_steady_motion():
    def error(angle):
        return 1e-3 * np.cos(3.0 * angle)

    tracer = CircleTracer(Facts, ("x", "y"), Circle(kind="circle", radius=2.0, frequency=0.5))
    for part in np.split(np.arange(2500.0), 10):  # a lap takes 2000 cycles, the start 700
        tracer.take(turning(part, error), 0)
    assert tracer.figures().error.size == 0
    for part in np.split(np.arange(2500.0, 5000.0), 10):
        tracer.take(turning(part, error), 0)
    lap = tracer.figures()
    assert lap.error.size == 2000
    assert lap.error == pytest.approx(error(lap.angle), abs=1e-6)
    assert (lap.compensated, lap.scale.ring, lap.scale.magnification) == (1.0, 5e-4, pytest.approx(800.0))
    tracer.take(turning(np.arange(5000.0, 5010.0), error, state=LoopState.STOPPING), 0)
    assert tracer.figures().error.size == 0
