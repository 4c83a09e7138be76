"""A run beside another controller: its demand, the gate of the compensation, and that nothing stops the machine."""

import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.config import from_dict
from friction_hil.daemon.control.journal import JournalReader, JournalWriter, make_journal
from friction_hil.daemon.control.message import Action, Change, pack
from friction_hil.daemon.control.packed import room
from friction_hil.daemon.control.state import Messages
from friction_hil.daemon.demand import SPAN, DemandEstimator
from friction_hil.daemon.figures import SETTLE_S, Condition
from friction_hil.daemon.follower import FollowerAxis
from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.stop import StopRequest
from friction_hil.drive import DriveState, Mode
from friction_hil.errors import ConfigurationError
from tests.loop_run import heard
from tests.messages import codes_in
from tests.servo_drives import PERIOD_S, ServoDrives, axis_dict, make_loop

ENABLED = DriveState.OPERATION_ENABLED
SIDECAR = {
    "tpdos": [{"cob_id": 0x181, "entries": [0x6041, 0x6064]}],
    "rpdos": [{"cob_id": 0x201, "entries": [0x6040, 0x607A]}],
    "offset": {"cob_id": 0x501, "entries": [0x60B2]},
}


def sidecar_dict(**changes):
    """An axis of a sidecar."""
    known = {"sidecar": SIDECAR, "counts_per_unit": 2**20 / math.tau, "rated_torque": 0.64}
    return axis_dict(**{**known, "trajectory": {"kind": "master"}, "compensation": {"fade_s": 0.1}, **changes})


def configuration(role="sidecar", **changes):
    bus = {"interface": "virtual", "channel": "follower", "role": role}
    return from_dict({"version": 1, "period_s": PERIOD_S, "bus": bus, "axes": {"x": sidecar_dict(**changes)}}, "test")


class Machine(ServoDrives):
    """A servo that its own controller moves to and fro, and the daemon beside it.

    ``disturb(cycle, feedback)`` changes what is heard; ``state(cycle)`` is the drive's state.
    """

    is_follower = True

    def __init__(self, *, state=lambda cycle: ENABLED, disturb=lambda cycle, feedback: None):
        super().__init__(configuration(), disturb=self.hear)
        self.state, self.also = state, disturb
        self.offset, self.offsets = 0.0, []

    def connect(self):
        return [replace(super().connect()[0], setpoint_delay_s=1.5 * PERIOD_S, actuation_delay_s=0.5 * PERIOD_S)]

    def target(self):
        return 0.3 * (1.0 - math.cos(math.tau * self.cycle * PERIOD_S))

    def activate(self, k, servo):
        self.states[k] = self.state(self.cycle)
        if self.states[k] is ENABLED:
            servo.command(Mode.CSP, self.target(), 0.0, self.offset)
        else:
            servo.command(0, 0.0)

    def hear(self, cycle, feedback):
        one = feedback[0]
        one.missing, one.position_demand, one.is_offset_wanted = "", self.target(), True
        self.also(cycle, feedback)

    def send(self, commands):
        self.offset = commands[0].torque
        self.servos[0].torque_offset = self.offset
        self.offsets.append(self.offset)


class Run:
    """A run beside the machine, and what there is to see of it afterwards."""

    def __init__(self, machine=None, *, config=None, faults=(), **settings):
        self.machine = machine or Machine()
        given = {"axis": FollowerAxis, "is_follower": True, "duration_s": 1.0, **settings}
        loop, self.sink, [self.axis] = make_loop(config or configuration(), self.machine, **given)
        self.result = loop.run()
        assert faults is None or codes_in(self.result.faults) == list(faults)
        self.sent, self.warnings = self.machine.offsets, self.result.warnings
        self.states = [text for _, name, text in self.sink.events if name == "state"]

    def figures(self, condition):
        return self.axis.following.errors.figures(condition)

    def largest(self, begin=0, end=None):
        return max(map(abs, self.sent[begin:end]))

    def assert_ended(self):
        assert self.states == ["running", "stopping", "done"]
        assert self.sent[-1] == 0.0


def at_the_socket(asked):
    """The journal of a loop that is asked for something in these cycles, who asks it, and its answers."""
    journal, answers = JournalReader(make_journal(room(1))), []
    writer = JournalWriter(journal.descriptor)

    def disturb(cycle, feedback):
        if cycle in asked:
            writer.post(cycle, pack(Change(cycle, asked[cycle])))
        elif cycle - 1 in asked:
            answers.append(writer.wait(cycle - 1, 0.0))

    return journal, disturb, answers


def assert_within_slew(offsets):
    assert max(abs(b - a) for a, b in itertools.pairwise(offsets)) <= 300.0 * PERIOD_S * 1.001


def test_compensation_is_faded_in_and_out_and_the_last_offset_is_zero():
    run = Run()
    run.assert_ended()
    assert run.sent[:50] == [0.0] * 50
    assert run.largest() > 0.05
    assert run.sent[-2:] == [0.0, 0.0]
    assert_within_slew(run.sent)
    assert run.sink.column("x", "state").count(LoopState.RUNNING) == pytest.approx(1000, abs=2)


def test_a_stop_and_a_start_at_the_control_socket_fade_the_offset_and_leave_the_drive_to_its_master():
    journal, disturb, answers = at_the_socket({400: Action.STOP, 700: Action.START, 900: Action.RESET})
    run = Run(Machine(disturb=disturb), journal=journal, duration_s=0.5)
    assert run.states == ["running", "stopping", "waiting", "running", "stopping", "done"]
    refusals = [refusal for _, refusal in answers]
    assert refusals[:2] == ["", ""]
    assert "not its own to reset" in refusals[2]
    assert set(run.sent[600:700]) == {0.0}
    assert run.largest(800, 1100) > 0.05


def test_a_sidecar_that_is_started_again_begins_without_compensation_again():
    journal, disturb, _ = at_the_socket({900: Action.STOP, 1300: Action.START})
    config = configuration(compensation={"fade_s": 0.1, "baseline_s": 0.7})
    run = Run(Machine(disturb=disturb), config=config, journal=journal, duration_s=1.5)
    assert run.largest(800, 900) > 0.05
    assert set(run.sent[1100:2000]) == {0.0}  # 0.7 s from the start on
    assert run.largest(2100, 2500) > 0.05
    again = run.figures(Condition.WITHOUT)
    assert again.counted > 0.1 / PERIOD_S
    told = Messages()
    for name, text in [each[1:] for each in run.sink.events if each[1] == "error_without"]:
        before = dict(told.error_without)
        told.take(name, text)
        assert told.error_without != before  # once for each of the two times
    assert before
    seconds = again.counted * PERIOD_S
    assert told.error_without["x"] == pytest.approx({"rms": again.rms, "peak": again.peak, "seconds": seconds})


def test_gravity_is_left_to_the_master_whose_loops_carry_it_already():
    """Nor would the fade-out ever end: it waits for an offset of zero."""
    mechanics = {"inertia": 2e-4, "torque_lag_s": 3e-4, "offset": 0.1, "gravity": {"constant": 0.05, "sine": 0.1}}
    heavy = Run(config=configuration(model=sidecar_dict()["model"] | {"mechanics": mechanics}))
    heavy.assert_ended()
    assert heavy.sent == Run().sent


def test_compensation_reduces_the_following_error():
    run = Run(config=configuration(compensation={"fade_s": 0.1, "baseline_s": 2.0}), duration_s=5.0)
    run.assert_ended()
    without, compensated = (run.figures(each) for each in (Condition.WITHOUT, Condition.WITH))
    assert compensated.rms < 0.4 * without.rms
    settled = SETTLE_S / PERIOD_S
    assert without.counted == pytest.approx(2.0 / PERIOD_S - settled, abs=3)
    assert compensated.counted == pytest.approx(2.9 / PERIOD_S - settled, abs=3)


def test_a_dry_run_computes():
    stop = StopRequest()

    def disturb(cycle, feedback):
        stop.is_requested = cycle > 300

    run = Run(Machine(disturb=disturb), stop=stop, dry_run=True)
    assert max(run.sink.column("x", "compensation")) > 0.02


def test_a_drive_that_its_master_disables_gets_no_offset_and_is_compensated_again_once_it_is_back():
    off = range(400, 700)
    run = Run(Machine(state=lambda cycle: DriveState.SWITCHED_ON if cycle in off else ENABLED), duration_s=1.5)
    run.assert_ended()
    gone, back = run.warnings
    assert gone.endswith("switched on")
    assert "enabled the drive again" in back
    assert set(run.sent[400:700]) == {0.0}
    assert run.sent[699] == 0.0
    assert abs(run.sent[702]) < 0.01  # faded in anew
    assert run.largest(850, 1000) > 0.05


@pytest.mark.parametrize(
    ("state", "disturb", "words"),
    [
        (DriveState.FAULT, heard(error="8611h following error"), "state fault (8611h following error)"),
        (ENABLED, heard(is_offset_wanted=False), "is in another mode"),
    ],
)
def test_a_run_in_which_nothing_is_compensated_says_why_once(state, disturb, words):
    run = Run(Machine(state=lambda cycle: state, disturb=disturb), duration_s=2.0)
    (warning,) = run.warnings
    assert words in warning


@pytest.mark.parametrize("state", [DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE, DriveState.QUICK_STOP_ACTIVE])
def test_a_fault_of_the_drive_is_its_masters_business(state):
    said = heard(error="8611h following error")
    run = Run(Machine(state=lambda cycle: state if cycle >= 400 else ENABLED, disturb=said))
    assert set(run.sent[400:]) == {0.0}
    assert "(8611h following error)" in run.warnings[0]


@pytest.mark.parametrize("jump", [0.0, 50.0])
def test_another_mode_fades_the_compensation_out_at_its_own_pace_and_may_set_the_position_anew(jump):
    """As homing does."""

    def disturb(cycle, feedback):
        feedback[0].is_offset_wanted = not 400 <= cycle < 700
        feedback[0].position += jump * (cycle >= 500)
        feedback[0].position_demand += jump * (cycle >= 500)

    run = Run(Machine(disturb=disturb), duration_s=1.5)
    assert set(run.sent[510:700]) == {0.0}
    assert any(run.sent[401:450])
    assert run.largest(800) > 0.05


def faster(cycle, feedback):
    feedback[0].position += 0.04 * max(cycle - 400, 0)  # 40 rad/s


def astray(cycle, feedback):
    feedback[0].position_demand += cycle > 400


@pytest.mark.parametrize(
    ("disturb", "reason"),
    [
        (faster, "FH-107"),
        (heard(401, is_fresh=False, missing="TPDO 181h did not come"), "TPDO 181h"),
        (heard(401, message="SYNC (080h) did not come [FH-248]"), "FH-248"),
        (astray, "FH-109"),
    ],
)
def test_a_fault_fades_the_offset_out_and_the_machine_runs_on(disturb, reason):
    run = Run(Machine(disturb=disturb), faults=None)
    assert reason in run.result.faults[0]
    assert run.states == ["running", "fault_stopping", "done"]
    assert run.sent[-1] == 0.0
    assert_within_slew(run.sent[390:])
    assert 440 < run.machine.cycle < 530  # fade_s after the fault


def test_limits_do_not_apply_to_a_drive_that_does_not_operate():
    run = Run(Machine(state=lambda cycle: DriveState.SWITCH_ON_DISABLED, disturb=faster))
    assert set(run.sent) == {0.0}


def test_an_exception_in_the_computation_ends_with_zero(monkeypatch):
    compute = FollowerAxis.compute

    def broken(self, cycle, *arguments):
        if cycle > 400:
            raise ZeroDivisionError("broken")
        return compute(self, cycle, *arguments)

    monkeypatch.setattr(FollowerAxis, "compute", broken)
    run = Run(faults=["x FH-111"])
    assert run.sent[-1] == 0.0
    assert len(run.sent) < 410


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sidecar": None}, "must list the PDOs"),
        ({"counts_per_unit": None}, "axes.x.counts_per_unit: "),
        ({"rated_torque": None}, "axes.x.rated_torque: "),
        ({"trajectory": {"kind": "hold"}}, "must be 'master'"),
        ({"sidecar": {**SIDECAR, "tpdos": [{"cob_id": 0x181, "entries": [0x6064]}]}}, "6041h statusword"),
        ({"sidecar": {**SIDECAR, "offset": {"cob_id": 0x201, "entries": [0x60B2]}}}, "0x201 is given twice"),
        ({"sidecar": {**SIDECAR, "offset": {"cob_id": 0x501, "entries": [0x60B2, 0x6071]}}}, "alone"),
        ({"sidecar": {**SIDECAR, "rpdos": [{"cob_id": 0x201, "entries": [0x60B2]}]}}, "would overwrite"),
        ({"sidecar": {**SIDECAR, "tpdos": [{"cob_id": 0x181, "entries": [0x2001]}]}}, "0x20010010"),
        ({"controller": {"position_gain": 1.0}}, "axes.x.controller: "),
        ({"role": "master"}, "'master' needs bus.role: sidecar"),
        ({"role": "master"}, "is only for bus.role: sidecar"),
    ],
)
def test_mistakes_of_the_configuration_are_told(changes, words):
    with pytest.raises(ConfigurationError) as error:
        configuration(**changes)
    assert words in str(error.value)


T, DELAY, LEAD = 1e-3, 1.5e-3, 1.1e-3


def motion(t):
    return 0.3 - 2.0 * t + 5.0 * t * t


def estimator():
    return DemandEstimator(T, DELAY, LEAD)


def test_constant_acceleration_is_exact():
    demand = estimator()
    for k in range(20):
        heard = demand.take(k, motion(k * T + DELAY))
        if k < SPAN - 1:
            assert all(map(math.isnan, heard))
            continue
        ahead = -2.0 + 10.0 * (k * T + LEAD)
        assert heard[:3] == pytest.approx((motion(k * T), -2.0 + 10.0 * k * T, ahead), abs=1e-9)
        assert heard[3] == pytest.approx(10.0 * (1.0 - 0.8 ** (k - SPAN + 2)), abs=1e-6)


@pytest.mark.parametrize("lost", [{30}, {30, 31}, {30, 32, 34}])
@pytest.mark.parametrize("is_missed", [False, True], ids=["repeated", "cycle missed"])
def test_lost_setpoints_leave_a_small_error_and_then_none(lost, is_missed):
    demand, heard = estimator(), None
    last = math.nan
    for k in range(60):
        if k in lost and is_missed:
            continue
        last = last if k in lost else 2.0 * (k * T + DELAY)
        heard = demand.take(k, last)
        if k >= SPAN:
            assert -1.0 < heard[2] < 3.0
        if k > 36 or SPAN <= k < 30:
            assert heard[:3] == pytest.approx((2.0 * k * T, 2.0, 2.0), abs=1e-9)


def test_setpoints_rounded_to_counts_give_a_quieter_velocity_than_their_difference():
    count = 2.0 * math.pi / 65536
    demand, errors, plain = estimator(), [], []
    before = 0.0
    for k in range(2000):
        setpoint = round(0.777 * (k * T + DELAY) / count) * count
        heard = demand.take(k, setpoint)
        if k > 10:
            errors.append(heard[2] - 0.777)
            plain.append((setpoint - before) / T - 0.777)
        before = setpoint
    assert math.hypot(*errors) < 0.9 * math.hypot(*plain)


def test_a_rest_is_a_rest_and_a_long_gap_is_not_bridged():
    demand, other = estimator(), estimator()
    for k in range(50):
        heard = demand.take(k, 1000.0 + motion(min(k, 20) * T))
    assert heard[:3] == (1000.0 + motion(20 * T), 0.0, 0.0)
    assert abs(heard[3]) < 1.0  # of 300 when it stopped
    for k in range(30):
        heard = other.take(k, motion(k * T + DELAY) if k < 20 else math.nan)
        if 20 <= k < 23:
            assert heard[0] == pytest.approx(motion(k * T), abs=1e-5)
        assert k < 23 or all(map(math.isnan, heard))


def test_without_a_demand_it_begins_anew():
    demand = estimator()
    for k in range(10):
        demand.take(k, motion(k * T))
    demand.forget()
    assert all(map(math.isnan, demand.take(10, math.nan)))
    for k in range(11, 11 + SPAN - 1):
        assert all(map(math.isnan, demand.take(k, 7.0)))
    assert demand.take(11 + SPAN, 7.0) == (7.0, 0.0, 0.0, 0.0)


@given(st.lists(st.booleans(), min_size=40, max_size=200), st.floats(-20.0, 20.0), st.floats(0.0, 3.0))
def test_lost_setpoints_do_not_turn_the_velocity_round(heard, acceleration, speed):
    """The motion goes on in one direction; whatever is lost, the demand says so, or that it is not known."""
    speed += SPAN * T * max(-acceleration, 0.0) + len(heard) * T * max(-acceleration, 0.0)
    demand = estimator()
    for k, is_heard in enumerate([True] * 20 + heard):
        time_s = k * T + DELAY
        setpoint = speed * time_s + 0.5 * acceleration * time_s**2 if is_heard else math.nan
        _, velocity, ahead, _ = demand.take(k, setpoint)
        slack = 0.05 + 12 * T * abs(acceleration)  # the acceleration is filtered, and a gap filled in by a line
        for value, at_s in ((velocity, k * T), (ahead, k * T + LEAD)):
            assert math.isnan(value) or value == pytest.approx(speed + acceleration * at_s, abs=slack)
