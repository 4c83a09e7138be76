"""The compensator of n joints does, in a loop of one's own, what the daemon's does, and never raises in it."""

import math
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil import recordings
from friction_hil.checked_yaml.text import dump
from friction_hil.compensator import INPUTS, STATE
from friction_hil.config import from_dict
from friction_hil.daemon.assembly import make_compensator, make_limits
from friction_hil.daemon.safety import LoopState, Supervisor
from friction_hil.drive import DriveState, Feedback
from friction_hil.drive.codes import code_of
from friction_hil.errors import ConfigurationError, UsageError
from friction_hil.own_loop.joints import make_joints
from friction_hil.own_loop.kernel import RESULTS
from friction_hil.replay.verify import verify
from tests.compensators import LUGRE, Axis, columns, compensator, resolution
from tests.export_subjects import EVERY_MODEL
from tests.own_loops import FRICTION, LIMITS, PERIOD_S, STRIBECK, axis, configuration, loop, motion, steps


@pytest.mark.parametrize("velocity", ["difference", "drive", "kalman"])
def test_one_joint_gives_the_bits_of_the_daemons_own_step(velocity):
    config = configuration(axis(compensation={"fade_s": 0.05, "velocity": velocity}))
    own, model = fh.Compensator(config), config.axes["j0"]
    one = make_compensator(model, model.model, make_joints(config, None).facts[0], PERIOD_S)
    inputs = motion(400, 1)
    fresh = np.random.default_rng(1).random((400, 1)) > 0.05
    dt = PERIOD_S * np.where(np.arange(400) % 37, 1, 3)
    dt[0] = PERIOD_S
    got = steps(own, 400, fresh=fresh, dt=dt, **inputs)[:, 0]
    cycle, position, wanted = -1.0, math.nan, []
    lead = one.settings.lead_s
    assert lead == 1.0 * PERIOD_S
    for k in range(400):
        cycle += round(dt[k] / PERIOD_S)
        q, dq, tau, q_des, dq_des, ddq_des, load = (each[k, 0] for each in inputs.values())
        position = q if fresh[k, 0] else position
        dq = dq if fresh[k, 0] else one.velocity_estimate
        ahead = dq_des + lead * ddq_des
        feedback = (position, dq, tau, q_des, dq_des, ahead, fresh[k, 0], True)
        wanted.append(one.step(cycle, *feedback, ddq_des, math.nan, load))
    np.testing.assert_array_equal(got, wanted)
    assert np.abs(got).max() > 0.05
    assert own.missed == 2 * 10
    assert own.fault is None


def test_many_joints_are_as_many_single_ones():
    axes, inputs = (axis(), axis(STRIBECK), axis()), motion(300, 3)
    got = steps(loop(*axes), 300, **inputs)
    for k, each in enumerate(axes):
        alone = steps(loop(each), 300, **{name: value[:, k : k + 1] for name, value in inputs.items()})
        np.testing.assert_array_equal(got[:, k], alone[:, 0])


@pytest.mark.deep  # it compiles
def test_a_network_beside_another_model_needs_the_room_of_both():
    """The settings of all joints have one type, and a model that has less of it gives the same bits."""
    one, wide = compensator(LUGRE), compensator(EVERY_MODEL["residual"])
    room = np.zeros(1, wide.record.dtype)
    inputs = columns(200, position=np.cumsum(np.full(200, 1e-4)), velocity_demand=0.1, velocity_demand_ahead=0.1)
    wanted, _ = one.replay(inputs)
    other = compensator(LUGRE)
    other.move_to(room, np.zeros(1, STATE))
    np.testing.assert_array_equal(other.replay(inputs)[0], wanted)


@pytest.mark.parametrize("kind", [np.float32, int, list, "fortran", "object"])
def test_numbers_of_any_type_are_taken(kind):
    inputs = {name: np.round(8.0 * values) for name, values in motion(120, 3).items()}
    fast = axis(limits={"torque": 1.0, "velocity": 1e5})
    wanted = steps(loop(fast, fast, fast), 120, **inputs)
    if kind is list:
        other = {name: values.tolist() for name, values in inputs.items()}
    elif kind == "fortran":
        other = {name: np.asfortranarray(values) for name, values in inputs.items()}
    else:
        other = {name: values.astype(kind) for name, values in inputs.items()}
    one = loop(fast, fast, fast)
    np.testing.assert_array_equal(steps(one, 120, **other), wanted)
    assert one.fault is None


def test_the_velocity_of_a_demand_follows_from_its_position():
    inputs = motion(200, 1)
    one = loop(axis(), record_s=10.0)
    steps(one, 200, q=inputs["q"], q_des=inputs["q_des"])
    row = dict(zip(INPUTS, one._memory.rows[150, 0], strict=False))
    slope = np.gradient(inputs["q_des"][:, 0], PERIOD_S)
    assert row["velocity_demand"] == pytest.approx(slope[150], abs=0.02)
    assert row["velocity_demand_ahead"] == pytest.approx(slope[151], abs=0.02)
    assert math.isnan(row["load_torque"])


_number = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(-30.0, 30.0), st.just(0.0))
_array = st.one_of(st.none(), st.lists(_number, min_size=3, max_size=3))
_anything = st.one_of(_array, _array, st.lists(_number, max_size=4), st.text(max_size=2), st.just(object()))
_cycle = st.fixed_dictionaries(
    dict.fromkeys(("q", "dq", "tau", "q_des", "dq_des", "ddq_des", "load", "temperature"), _anything)
    | {"fresh": st.one_of(st.none(), st.booleans(), st.lists(st.booleans(), max_size=4))}
    | {"dt": st.one_of(_number, st.text())}
)


@settings(max_examples=60, deadline=None)
@given(st.lists(_cycle, min_size=1, max_size=25), st.booleans())
def test_nothing_raises_in_the_loop_and_the_output_stays_within_torque_and_slew(cycles, is_moving):
    one, start, before = loop(), motion(60, 3), np.zeros(3)
    if is_moving:
        before = steps(one, 60, **start)[-1]
    else:
        one.step(start["q"][0], dt=PERIOD_S)
    for each in cycles:
        missed = one.missed
        out = one.step(**each)
        passed = 1 + one.missed - missed
        assert out.shape == (3,)
        assert np.isfinite(out).all()
        assert (np.abs(out) <= LIMITS["torque"]).all()
        assert (np.abs(out - before) <= LIMITS["torque_slew"] * PERIOD_S * passed * (1.0 + 1e-12)).all()
        before = out.copy()
    for _ in range(60):  # a fault ends in nothing
        out = one.step(start["q"][0], dt=PERIOD_S)
    assert one.fault is None or not out.any()


_jumpy = st.one_of(st.floats(-0.3, 0.3), st.floats(-2.0, 2.0), st.just(math.nan))
_feedback = st.tuples(st.booleans(), _jumpy, st.one_of(st.floats(-30.0, 30.0), st.just(math.nan)), st.integers(1, 4))


@settings(max_examples=100, deadline=None)
@given(st.lists(_feedback, min_size=1, max_size=60), st.integers(1, 12))
def test_feedback_is_judged_as_the_daemons_supervisor_judges_it(cycles, max_missed):
    """Which is usable, and in which cycle what is wrong; a velocity by the positions alone is the estimator's here."""
    one = loop(axis(), realtime={"max_missed": max_missed})
    config = one._joints.configuration.axes["j0"]
    judge = Supervisor("j0", make_limits(config), PERIOD_S, 1e-5, max_stale_cycles=max_missed)
    one.step([0.0], [0.0], [0.0], dt=PERIOD_S)
    first = Feedback(is_fresh=True, state=DriveState.OPERATION_ENABLED)
    judge.take(first)
    judge.find_fault(first, LoopState.RUNNING, 0.0, math.nan)
    q = 0.0
    for is_fresh, way, dq, passed in cycles:
        q = q + way if math.isfinite(way) else q
        given = q if math.isfinite(way) else math.nan
        one.step([given], [dq], [0.0], fresh=[is_fresh], dt=passed * PERIOD_S)
        feedback = Feedback(position=given, velocity=dq, is_fresh=is_fresh, state=DriveState.OPERATION_ENABLED)
        usable = judge.take(feedback, passed - 1)
        j = one._joints.limits[0]
        assert (bool(j["is_usable"]), j["position"]) == (usable, judge.position)
        fault = judge.find_fault(feedback, LoopState.RUNNING, one.velocity_estimate.item(), math.nan)
        if judge._steps.is_too_fast:
            break
        assert code_of(one.fault or "") == code_of(fault or "")
        if fault is not None:
            break


@pytest.mark.parametrize("wrong", ["unit", "sign", "joint", "none"])
def test_a_velocity_that_is_not_that_of_the_position_is_a_fault(wrong):
    slow = axis(limits=LIMITS | {"velocity": 6.0})
    one, inputs = loop(slow, slow), motion(400, 2)
    inputs["q"], dq = inputs["q_des"], inputs["dq_des"]
    inputs["dq"] = {"unit": 0.2 * dq, "sign": -dq, "joint": dq[:, ::-1].copy(), "none": dq}[wrong]
    steps(one, 400, **inputs)
    assert code_of(one.fault or "") == ("" if wrong == "none" else "FH-119")


@pytest.mark.parametrize(
    ("limits", "given", "code"),
    [
        ({"velocity": 0.5}, {}, "FH-107"),
        ({"position": [-0.1, 0.1]}, {}, "FH-108"),
        ({"following_error": 1e-4}, {}, "FH-109"),
        ({}, {"fresh": False}, "FH-103"),
        ({}, {"dq": math.nan}, "FH-103"),
    ],
)
def test_beyond_a_limit_the_output_fades_to_zero_and_says_why_until_it_is_faded_in(limits, given, code):
    one, inputs = loop(axis(limits=LIMITS | limits), record_s=1.0), motion(200, 1)
    for name, value in given.items():
        inputs[name] = np.full((200, 1), value)
        inputs[name][:1] = True if name == "fresh" else 0.0
    out = steps(one, 200, **inputs)
    assert code_of(one.fault) == code
    assert one.fault.startswith("j0: ")
    assert not out[-1].any()
    assert one.is_faded_out
    assert ("fault", one.fault) in [event[1:] for event in one._memory._events]
    one.fade_in()
    assert one.fault is None


def test_nothing_is_compensated_before_each_joint_has_had_a_position():
    one, inputs = loop(), motion(700, 3)
    inputs["q"][:630, 1] = math.nan
    out = steps(one, 700, **inputs)
    assert not out[:630].any()
    assert np.abs(out[690:]).min() > 0.0
    (notice,) = one.notices
    assert notice == "no position of j1 so far: nothing is compensated yet [FH-101]"


def test_a_joint_without_demand_is_guided_and_rests_without_any_compensation_after_the_hand_lets_go():
    """Of a simulated joint, with the encoder and the delay of one; see test_compensator_hand_guiding."""
    step = resolution(14)
    friction = {"model": "lugre", "parameters": dict(fh.models.describe("lugre").example)}
    changes = {"position_resolution": step, "limits": LIMITS | {"torque": 1.0, "torque_slew": None}}
    given = from_dict({"version": 1, "period_s": 1e-3, "axes": {"j0": axis(friction, **changes)}}, "test")
    own = fh.Compensator(given)
    simulated, work = Axis(LUGRE, resolution=step), []

    class Adapter:
        gain_factor, settings = 1.0, None

        @staticmethod
        def step(cycle, position, velocity, torque, *_):
            return float(own.step([position], [velocity], [torque], dt=1e-3)[0])

    def hand(t, position, velocity):
        place, speed = 0.2 * (1.0 - math.cos(6.0 * t)), 1.2 * math.sin(6.0 * t)
        torque = 20.0 * (place - position) + 0.09 * (speed - velocity) if t < 2.0 else 0.0
        work.append(torque * velocity)
        return torque

    run = simulated.run(Adapter, 4.0, hand=hand)
    assert np.abs(run.after(0.5).compensation).max() > 0.03
    assert sum(work) > 0.0  # the joint takes energy from the hand, and gives none
    rest = run.after(3.5)
    assert np.ptp(rest.position) < 3e-6
    assert not rest.compensation.any()


def test_wrong_shapes_are_refused_at_the_first_call_and_fade_the_output_out_later():
    one, inputs = loop(), motion(300, 3)
    for wrong in ({"q": [0.0, 0.0]}, {"q": np.zeros((3, 1))}, {"q": 0.0}, {"q": ["a", "b", "c"]},
                  {"q": np.zeros(3), "load": np.zeros(4)}, {"q": np.zeros(3), "fresh": [True]}):  # fmt: skip
        with pytest.raises(UsageError, match="j0, j1, j2"):
            one.step(**wrong)
    before = steps(one, 100, **inputs)[-1]
    assert np.abs(before).min() > 0.0
    faded = [one.step(inputs["q"][0, :2], dt=PERIOD_S).copy() for _ in range(30)]
    assert one.fault == "q has the shape (2,): it must be (3,), a number for each of j0, j1, j2"
    assert (np.abs(faded[0] - before) <= LIMITS["torque_slew"] * PERIOD_S).all()
    assert not faded[-1].any()
    one.fade_in()
    steps(one, 100, **{name: values[100:] for name, values in inputs.items()})
    assert one.fault is None
    assert not one.is_faded_out


@pytest.mark.parametrize(("key", "name"), [("drive", "dq"), ("kalman", "tau")])
def test_what_a_setting_needs_is_asked_for_at_the_first_call(key, name):
    one = loop(axis(compensation={"velocity": key}))
    with pytest.raises(UsageError, match=rf"{name} is missing: compensation of j0"):
        one.step([0.0])


def test_settings_change_without_a_step_and_other_joints_keep_theirs():
    axes, inputs = [axis(limits=LIMITS | {"torque_slew": None})] * 3, motion(400, 3)
    one, plain = loop(*axes), steps(loop(*axes), 400, **inputs)
    first = steps(one, 200, **inputs)
    one.set("j1", gain=0.5, gain_negative=0.5)
    last = steps(one, 200, **{name: values[200:] for name, values in inputs.items()})
    got = np.concatenate([first, last])
    np.testing.assert_array_equal(got[:, [0, 2]], plain[:, [0, 2]])
    np.testing.assert_array_equal(got[:201, 1], plain[:201, 1])
    np.testing.assert_allclose(got[300:, 1], plain[300:, 1] * 0.5 / 0.9, rtol=1e-6)
    for key, value in {"gian": 1.0, "gain": 7.0, "velocity": "kalman"}.items():
        with pytest.raises(UsageError, match=key):
            one.set("j1", **{key: value})
    with pytest.raises(UsageError, match="no joint 'j9'"):
        one.set("j9", gain=1.0)


def test_joints_fade_out_and_in_one_by_one():
    one, inputs = loop(), motion(400, 3)
    steps(one, 100, **inputs)
    one.fade_out("j1")
    out = steps(one, 100, **{name: values[100:] for name, values in inputs.items()})
    assert not out[-1, 1]
    assert out[-1, [0, 2]].all()
    one.fade_out()
    out = steps(one, 100, **{name: values[200:] for name, values in inputs.items()})
    assert not out[-1].any()
    one.fade_in()
    out = steps(one, 50, **{name: values[300:] for name, values in inputs.items()})
    assert out[-1].astype(bool).tolist() == [True, False, True]
    one.fade_in("j1")
    out = steps(one, 50, **{name: values[350:] for name, values in inputs.items()})
    assert out[-1].all()


def test_a_model_that_depends_on_temperature_says_that_it_is_given_none():
    warm = {"temperature": {"reference": 40.0, "coefficient": -0.004}}
    one = loop(axis(FRICTION | {"modifiers": warm}), axis(), record_s=10.0)
    steps(one, 1500, **motion(1500, 2))
    (notice,) = one.notices
    assert notice.startswith("j0: the drive reports no temperature: the friction model is evaluated at its reference")
    steps(one, 1, **motion(1, 2), temperature=np.full((1, 2), 55.0))
    row = dict(zip((*INPUTS, *RESULTS), one._memory.rows[1500, 0], strict=True))
    assert row["temperature"] == 55.0
    assert row["temperature_estimate"] == pytest.approx(40.0, abs=0.01)  # it follows slowly


def test_the_time_without_compensation_at_the_start_comes_first():
    out = steps(loop(axis(compensation={"baseline_s": 0.2, "fade_s": 0.05})), 200, **motion(200, 1))[:, 0]
    assert not out[:100].any()
    assert np.abs(out[150:]).max() > 0.03


def test_what_the_configuration_leaves_off_stays_off_until_it_is_named():
    one, inputs = loop(axis(compensation={"enabled": False, "fade_s": 0.05}), axis()), motion(300, 2)
    one.fade_in()
    out = steps(one, 200, **inputs)
    assert not out[:, 0].any()
    assert out[-1, 1] != 0.0
    one.set("j0", enabled=True)
    assert steps(one, 100, **{name: values[200:] for name, values in inputs.items()})[-1, 0] != 0.0


def test_what_is_saved_is_verified_bit_for_bit_with_every_change(tmp_path):
    one, inputs = loop(record_s=3.0), motion(2500, 3)
    inputs["dt"] = PERIOD_S * np.where(np.arange(2500) % 101, 1, 4)
    inputs["fresh"] = np.random.default_rng(2).random((2500, 3)) > 0.02
    inputs["ddq_des"][::3] = math.nan
    for begin in range(0, 2500, 500):
        if begin == 1500:
            one.set("j0", model={"axis": "rotary", "friction": STRIBECK})
        elif begin:
            one.set(f"j{begin // 500 % 3}", gain=0.9 - 1e-4 * begin)
        steps(one, 500, **{name: values[begin : begin + 500] for name, values in inputs.items()})
    path = one.save(tmp_path / "run.mcap")
    assert one.notices[-1].endswith("the 1000 cycles before were dropped")
    found = recordings.read_all(path)
    assert list(found) == ["j0", "j1", "j2"]
    for recording in found.values():
        result = verify(recording)
        assert (result.reason, result.rows, result.tolerance) == ("", 1500, 0.0)
        assert len(recording.restarts) == 3
        assert np.ptp(recording["load_torque"]) > 0.1
    found["j1"].columns["load_torque"][700] += 1e-9
    assert "checksum" in verify(found["j1"]).reason
    with pytest.raises(FileExistsError):
        one.save(path)
    with pytest.raises(UsageError, match=r"\.mcap"):
        one.save(tmp_path / "run.csv")
    with pytest.raises(UsageError, match="record_s is 0"):
        loop().save(tmp_path / "none.mcap")


def test_the_load_changes_the_friction_and_is_not_added():
    inputs = motion(300, 1)
    inputs["load"][:] = 0.0
    without = steps(loop(axis(limits=LIMITS | {"torque": 1.0})), 300, **inputs)
    inputs["load"][:] = 0.5
    heavy = steps(loop(axis(limits=LIMITS | {"torque": 1.0})), 300, **inputs)
    more = 0.9 * np.array([0.1, 0.05]) * 0.5  # gain times coefficient times load, motoring and driven
    level = np.abs(heavy[250]) - np.abs(without[250])
    assert any(level == pytest.approx(each, rel=0.05) for each in more)


def test_times_that_are_none_count_as_a_period_and_are_told():
    one, inputs = loop(), motion(300, 3)
    inputs["dt"] = [(0.0, -1.0, math.nan, math.inf, "soon")[k % 5] for k in range(300)]
    got = steps(one, 300, **inputs)
    inputs["dt"] = [PERIOD_S] * 300
    np.testing.assert_array_equal(got, steps(loop(), 300, **inputs))
    assert one.notices == ["dt is not above zero, or no number: a call without a time counts as a period"]


@pytest.mark.parametrize(("ratio", "is_fault"), [(1.2, False), (0.8, False), (0.3, True), (1.04, None)])
def test_a_period_that_is_not_that_of_the_file_is_told(ratio, is_fault):
    now = iter(range(10**9, 10**12, round(1e9 * ratio * PERIOD_S)))
    one = fh.Compensator(configuration(axis()), clock=lambda: next(now))
    for _ in range(300):
        one.step([0.0])
    said = [*one.notices, one.fault or ""]
    assert (one.fault is not None) is (is_fault is True)
    assert any(
        f"a call comes every {1e3 * ratio * PERIOD_S:.3g} ms, and period_s is 2 ms" in text for text in said
    ) is (is_fault is not None)
    assert one.missed == 0


def test_a_second_thread_in_a_step_is_a_fault():
    one, inside, go_on = loop(axis()), threading.Event(), threading.Event()
    one.step([0.0])

    class Slow:
        def __array__(self, dtype=None, copy=None):
            inside.set()
            go_on.wait(10.0)
            return np.zeros(1)

    first = threading.Thread(target=one.step, args=(Slow(),))
    first.start()
    assert inside.wait(10.0)
    assert one.step([0.0]).shape == (1,)
    go_on.set()
    first.join()
    assert "two threads" in one.fault


FILE = {"version": 1, "axes": {"shoulder": axis(), "elbow": axis(STRIBECK)}}


@pytest.fixture
def path(tmp_path):
    (tmp_path / "arm.yaml").write_text(dump(FILE))
    return tmp_path / "arm.yaml"


def test_a_file_needs_no_period_where_the_loop_gives_it(path):
    one = fh.Compensator.load(path, period_s=0.004, joints=["elbow", "shoulder"])
    assert (one.joints, one.period_s, one.notices) == (("elbow", "shoulder"), 0.004, [])
    with pytest.raises(UsageError, match=r"arm\.yaml has no period_s"):
        fh.Compensator.load(path)
    for wrong in ("elbow", [1], ["elbow", "wrist"], ["elbow", "elbow"], []):
        with pytest.raises(UsageError, match="joints"):
            fh.Compensator.load(path, period_s=0.004, joints=wrong)
    path.write_text(dump({**FILE, "period_s": 0.002}))
    assert fh.Compensator.load(path, period_s=0.002).period_s == fh.Compensator.load(path).period_s == 0.002
    with pytest.raises(ConfigurationError, match=r"period_s: is 0\.002, but the program gives 0\.004"):
        fh.Compensator.load(path, period_s=0.004)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"position_resolution": None}, "position_resolution: must be a number"),
        ({"compensation": {"adaptation": {}}, "has_torque": False}, "adaptation: needs the torque"),
        ({"limits": {"velocity": 1.0}}, r"limits\.torque: is missing"),
    ],
)
def test_what_a_joint_lacks_is_said_with_its_line(path, changes, message):
    path.write_text(dump({**FILE, "axes": {"shoulder": axis(**changes)}}))
    with pytest.raises(ConfigurationError, match=rf"arm\.yaml:\d+: .*{message}"):
        fh.Compensator.load(path, period_s=0.004)


def test_what_only_the_daemon_does_and_other_units_are_told():
    model = {"axis": "linear", "friction": STRIBECK, "mechanics": {"inertia": 1.0}}
    said = loop(axis(model=model, shadows=[{"name": "other", "model": model}])).notices
    assert said[0].startswith("j0: its model is of a linear axis: positions in m")
    assert "shadows" in said[1]


def test_a_model_file_in_place_of_a_configuration_is_told_nothing_of_a_period(tmp_path):
    (tmp_path / "elbow.yaml").write_text(dump({"version": 1, "axis": "rotary", "friction": STRIBECK}))
    with pytest.raises(ConfigurationError, match="axis") as told:
        fh.Compensator.load(tmp_path / "elbow.yaml", period_s=PERIOD_S)
    assert "the program gives" not in str(told.value)
