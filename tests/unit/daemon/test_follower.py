"""A run beside another controller: the gate of the compensation, its limits, and that nothing stops the machine."""

import math

import pytest

from friction_hil.config import from_dict
from friction_hil.daemon.control.journal import JournalReader, JournalWriter, make_journal
from friction_hil.daemon.control.message import Action, Change, pack
from friction_hil.daemon.control.packed import room
from friction_hil.daemon.control.state import Messages
from friction_hil.daemon.figures import SETTLE_S, Condition
from friction_hil.daemon.follower import FollowerAxis
from friction_hil.daemon.loop import Loop
from friction_hil.daemon.realtime import SteppedClock
from friction_hil.daemon.run import LoopSettings
from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.stop import StopRequest
from friction_hil.drive import AxisFacts, Drives, DriveState, Mode
from friction_hil.errors import ConfigurationError
from friction_hil.motion.trajectory import PathTime
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo
from tests.servo_drives import PERIOD_S, Rows, axis_dict

ENABLED = DriveState.OPERATION_ENABLED
SIDECAR = {
    "tpdos": [{"cob_id": 0x181, "entries": [0x6041, 0x6064]}],
    "rpdos": [{"cob_id": 0x201, "entries": [0x6040, 0x607A]}],
    "offset": {"cob_id": 0x501, "entries": [0x60B2]},
}


def sidecar_dict(**changes):
    """An axis of a sidecar."""
    return axis_dict(
        **{
            "sidecar": SIDECAR,
            "counts_per_unit": 2**20 / math.tau,
            "rated_torque": 0.64,
            "trajectory": {"kind": "master"},
            "compensation": {"fade_s": 0.1},
            **changes,
        }
    )


def configuration(role="sidecar", **changes):
    bus = {"interface": "virtual", "channel": "follower", "role": role}
    return from_dict({"version": 1, "period_s": PERIOD_S, "bus": bus, "axes": {"x": sidecar_dict(**changes)}}, "test")


class Machine(Drives):
    """A servo that its own controller moves to and fro, and the daemon beside it, as `friction_hil.drive.Drives`.

    ``disturb(cycle, feedback)`` changes what is heard; ``state(cycle)`` is the drive's state.
    """

    is_follower = True

    def __init__(self, *, state=lambda cycle: ENABLED, disturb=lambda cycle, feedback: None):
        self.servo = Servo(ServoConfig())
        self.servo.set_period(PERIOD_S)
        self.state, self.disturb = state, disturb
        self.cycle, self.offset = 0, 0.0
        self.sent, self.states, self.targets = [], [], []

    def connect(self):
        resolution = 1.0 / self.servo.counts_per_unit
        return [AxisFacts("x", "servo", resolution, 6.4e-4, 1.5 * PERIOD_S, 0.5 * PERIOD_S)]

    def start(self):
        pass

    def target(self, cycle):
        return 0.3 * (1.0 - math.cos(math.tau * cycle * PERIOD_S))

    def receive(self, feedback, end_ns):
        servo, heard = self.servo, feedback[0]
        servo.advance(round(PERIOD_S * servo.steps_per_second))
        state = self.state(self.cycle)
        if state is ENABLED:
            servo.command(Mode.CSP, self.target(self.cycle), 0.0, self.offset)
        else:
            servo.command(0, 0.0)
        heard.position, heard.velocity, heard.torque = servo.position, servo.velocity, servo.torque
        heard.state, heard.is_fresh, heard.message, heard.missing = state, True, "", ""
        heard.position_demand = self.target(self.cycle)
        heard.is_offset_wanted = True
        self.disturb(self.cycle, heard)
        self.states.append(state)
        self.cycle += 1

    def warm_caches(self):
        pass

    def send(self, commands):
        self.offset = commands[0].torque
        self.servo.torque_offset = self.offset
        self.sent.append(self.offset)

    def close(self):
        return []


def run(machine, *, config=None, stop=None, journal=None, **settings):
    config = config or configuration()
    path_time = PathTime(0.25)
    axes = [
        FollowerAxis(name, config.axes[name], facts, PERIOD_S, path_time)
        for name, facts in zip(config.axes, machine.connect(), strict=True)
    ]
    sink = Rows(config)
    settings = LoopSettings(period_s=PERIOD_S, is_follower=True, **{"duration_s": 1.0, **settings})
    loop = Loop(machine, axes, path_time, SteppedClock(), sink, settings, stop or StopRequest(), journal)
    return loop.run(), sink, axes[0]


def at_the_socket(asked):
    """The journal of a loop that is asked for something in these cycles, who asks it, and its answers."""
    journal, answers = JournalReader(make_journal(room(1))), []
    writer = JournalWriter(journal.descriptor)

    def disturb(cycle, heard):
        if cycle in asked:
            writer.post(cycle, pack(Change(cycle, asked[cycle])))
        elif cycle - 1 in asked:
            answers.append(writer.wait(cycle - 1, 0.0))

    return journal, disturb, answers


def states_of(sink):
    return [text for _, name, text in sink.events if name == "state"]


def test_compensation_is_faded_in_and_out_and_the_last_offset_is_zero():
    machine = Machine()
    result, sink, _axis = run(machine)
    assert result.faults == []
    assert states_of(sink) == ["running", "stopping", "done"]
    assert machine.sent[:50] == [0.0] * 50
    assert max(map(abs, machine.sent)) > 0.05
    assert machine.sent[-2:] == [0.0, 0.0]
    steps = [abs(b - a) for a, b in zip(machine.sent, machine.sent[1:], strict=False)]
    assert max(steps) <= 300.0 * PERIOD_S * 1.001
    running = sink.column("x", "state").count(LoopState.RUNNING)
    assert running == pytest.approx(1000, abs=2)
    assert set(machine.states) == {ENABLED}


def test_a_stop_and_a_start_at_the_control_socket_fade_the_offset_and_leave_the_drive_to_its_master():
    journal, disturb, answers = at_the_socket({400: Action.STOP, 700: Action.START, 900: Action.RESET})
    machine = Machine(disturb=disturb)
    result, sink, _axis = run(machine, journal=journal, duration_s=0.5)
    assert result.faults == []
    assert states_of(sink) == ["running", "stopping", "waiting", "running", "stopping", "done"]
    assert [refusal for _, refusal in answers] == [
        *("", "", "it commands no drive: their faults are not its own to reset")
    ]
    assert set(machine.sent[600:700]) == {0.0}
    assert max(map(abs, machine.sent[800:1100])) > 0.05
    assert set(machine.states) == {ENABLED}


def test_a_sidecar_that_is_started_again_begins_without_compensation_again():
    journal, disturb, _ = at_the_socket({900: Action.STOP, 1300: Action.START})
    machine = Machine(disturb=disturb)
    config = configuration(compensation={"fade_s": 0.1, "baseline_s": 0.7})
    result, sink, axis = run(machine, config=config, journal=journal, duration_s=1.5)
    assert result.faults == []
    assert max(map(abs, machine.sent[800:900])) > 0.05
    assert set(machine.sent[1100:2000]) == {0.0}  # 0.7 s from the start on
    assert max(map(abs, machine.sent[2100:2500])) > 0.05
    again = axis.following.errors.figures(Condition.WITHOUT)
    assert again.counted > 0.1 / PERIOD_S
    told = Messages()
    for name, text in [each[1:] for each in sink.events if each[1] == "error_without"]:
        before = dict(told.error_without)
        told.take(name, text)
        assert told.error_without != before  # once for each of the two times
    assert before
    seconds = again.counted * PERIOD_S
    assert told.error_without["x"] == pytest.approx({"rms": again.rms, "peak": again.peak, "seconds": seconds})


def test_gravity_is_left_to_the_master_whose_loops_carry_it_already():
    """Nor would the fade-out ever end: it waits for an offset of zero."""
    mechanics = {"inertia": 2e-4, "torque_lag_s": 3e-4, "offset": 0.1, "gravity": {"constant": 0.05, "sine": 0.1}}
    plain, heavy = Machine(), Machine()
    run(plain)
    model = sidecar_dict()["model"] | {"mechanics": mechanics}
    result, sink, _ = run(heavy, config=configuration(model=model))
    assert result.faults == []
    assert heavy.sent == plain.sent
    assert states_of(sink) == ["running", "stopping", "done"]


def test_compensation_reduces_the_following_error():
    machine = Machine()
    config = configuration(compensation={"fade_s": 0.1, "baseline_s": 2.0})
    result, _, axis = run(machine, config=config, duration_s=5.0)
    assert result.faults == []
    without, compensated = (axis.following.errors.figures(each) for each in (Condition.WITHOUT, Condition.WITH))
    assert compensated.rms < 0.4 * without.rms
    settled = SETTLE_S / PERIOD_S
    assert without.counted == pytest.approx(2.0 / PERIOD_S - settled, abs=3)
    assert compensated.counted == pytest.approx(2.9 / PERIOD_S - settled, abs=3)


def test_a_dry_run_computes_and_its_drives_get_nothing_to_send():
    machine = Machine()
    stop = StopRequest()

    def disturb(cycle, heard):
        stop.is_requested = cycle > 300

    machine.disturb = disturb
    result, sink, _ = run(machine, stop=stop, dry_run=True)
    assert result.faults == []
    assert max(sink.column("x", "compensation")) > 0.02


def test_a_drive_that_its_master_disables_gets_no_offset_and_is_compensated_again_once_it_is_back():
    off = range(400, 700)
    machine = Machine(state=lambda cycle: DriveState.SWITCHED_ON if cycle in off else ENABLED)
    result, sink, _ = run(machine, duration_s=1.5)
    assert result.faults == []
    assert result.warnings == [
        "x: the drive left Operation enabled, its master's business: switched on",
        "x: its master has enabled the drive again",
    ]
    assert set(machine.sent[400:700]) == {0.0}
    assert machine.sent[699:702][0] == 0.0
    assert abs(machine.sent[702]) < 0.01  # faded in anew
    assert max(map(abs, machine.sent[850:1000])) > 0.05
    assert states_of(sink) == ["running", "stopping", "done"]


def test_a_run_in_which_nothing_is_compensated_says_why():
    machine = Machine(state=lambda cycle: DriveState.FAULT)

    def disturb(cycle, heard):
        heard.error = "8611h following error"

    machine.disturb = disturb
    result, _, _ = run(machine)
    state = "the drive is in state fault (8611h following error), and its master has not enabled it"
    assert result.warnings == [f"x: not compensated so far: {state}"]


def test_a_drive_in_another_mode_is_told_once():
    machine = Machine()

    def disturb(cycle, heard):
        heard.is_offset_wanted = False

    machine.disturb = disturb
    result, _, _ = run(machine, duration_s=2.0)
    (warning,) = result.warnings
    assert "although the drive is in Operation enabled: it is in another mode" in warning


@pytest.mark.parametrize("state", [DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE, DriveState.QUICK_STOP_ACTIVE])
def test_a_fault_of_the_drive_is_its_masters_business(state):
    machine = Machine(state=lambda cycle: state if cycle >= 400 else ENABLED)

    def disturb(cycle, heard):
        heard.error = "8611h following error"

    machine.disturb = disturb
    result, _, _ = run(machine)
    assert result.faults == []
    assert set(machine.sent[400:]) == {0.0}
    assert "(8611h following error)" in result.warnings[0]


def test_another_mode_fades_the_compensation_out_at_its_own_pace():
    def disturb(cycle, heard):
        heard.is_offset_wanted = not 400 <= cycle < 700

    machine = Machine(disturb=disturb)
    result, _, _ = run(machine)
    assert result.faults == []
    assert set(machine.sent[510:700]) == {0.0}
    assert any(machine.sent[401:450])


def test_homing_may_set_the_position_anew():
    def disturb(cycle, heard):
        heard.is_offset_wanted = not 300 <= cycle < 500
        if cycle >= 400:
            heard.position += 50.0
            heard.position_demand += 50.0

    machine = Machine(disturb=disturb)
    result, _, _ = run(machine, duration_s=1.5)
    assert result.faults == []
    assert max(map(abs, machine.sent[700:])) > 0.05


def faster(cycle, heard):
    if cycle > 400:
        heard.position += 0.04 * (cycle - 400)  # 40 rad/s


def silent(cycle, heard):
    if cycle > 400:
        heard.is_fresh, heard.missing = False, "TPDO 181h of node 1 did not come in time after SYNC"


def unsynchronised(cycle, heard):
    if cycle > 400:
        heard.message = "SYNC (080h) did not come for 11 periods [FH-248]"


def astray(cycle, heard):
    if cycle > 400:
        heard.position_demand += 1.0


@pytest.mark.parametrize(
    ("disturb", "reason"), [(faster, "FH-107"), (silent, "TPDO 181h"), (unsynchronised, "FH-248"), (astray, "FH-109")]
)
def test_a_fault_fades_the_offset_out_and_the_machine_runs_on(disturb, reason):
    machine = Machine(disturb=disturb)
    result, sink, _ = run(machine)
    assert reason in result.faults[0]
    assert states_of(sink) == ["running", "fault_stopping", "done"]
    assert machine.sent[-1] == 0.0
    steps = [abs(b - a) for a, b in zip(machine.sent[390:], machine.sent[391:], strict=False)]
    assert max(steps) <= 300.0 * PERIOD_S * 1.001
    assert 440 < machine.cycle < 530  # fade_s after the fault
    assert set(machine.states) == {ENABLED}


def test_limits_do_not_apply_to_a_drive_that_does_not_operate():
    machine = Machine(state=lambda cycle: DriveState.SWITCH_ON_DISABLED, disturb=faster)
    result, _, _ = run(machine)
    assert result.faults == []
    assert set(machine.sent) == {0.0}


def test_an_exception_in_the_computation_ends_with_zero(monkeypatch):
    machine = Machine()
    compute = FollowerAxis.compute

    def broken(self, cycle, *arguments):
        if cycle > 400:
            raise ZeroDivisionError("broken")
        return compute(self, cycle, *arguments)

    monkeypatch.setattr(FollowerAxis, "compute", broken)
    result, _, _ = run(machine)
    assert "ZeroDivisionError" in result.faults[0]
    assert machine.sent[-1] == 0.0
    assert len(machine.sent) < 410


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sidecar": None}, "must list the PDOs"),
        ({"counts_per_unit": None}, "does not ask the drive"),
        ({"rated_torque": None}, "does not ask the drive"),
        ({"trajectory": {"kind": "hold"}}, "must be 'master' with bus.role: sidecar"),
        ({"sidecar": {**SIDECAR, "tpdos": [{"cob_id": 0x181, "entries": [0x6064]}]}}, "6041h statusword"),
        ({"sidecar": {**SIDECAR, "offset": {"cob_id": 0x201, "entries": [0x60B2]}}}, "0x201 is given twice"),
        ({"sidecar": {**SIDECAR, "offset": {"cob_id": 0x501, "entries": [0x60B2, 0x6071]}}}, "alone"),
        ({"sidecar": {**SIDECAR, "rpdos": [{"cob_id": 0x201, "entries": [0x60B2]}]}}, "would overwrite"),
        ({"sidecar": {**SIDECAR, "tpdos": [{"cob_id": 0x181, "entries": [0x2001]}]}}, "0x20010010"),
        ({"controller": {"position_gain": 1.0}}, "another one controls the axis"),
    ],
)
def test_mistakes_of_the_configuration_are_told(changes, words):
    with pytest.raises(ConfigurationError) as error:
        configuration(**changes)
    assert words in str(error.value)


def test_keys_of_a_sidecar_are_refused_for_a_master():
    with pytest.raises(ConfigurationError) as error:
        configuration(role="master")
    assert "'master' needs bus.role: sidecar" in str(error.value)
    assert "is only for bus.role: sidecar" in str(error.value)
