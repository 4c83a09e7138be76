"""Velocity estimators: delay and noise as told, gaps, glitches, and what no input may do."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from friction_hil.compensator import velocity
from friction_hil.compensator.velocity import KINDS, MAX_GAP_CYCLES, VelocityEstimator
from friction_hil.drive.encoder import unwrap
from friction_hil.errors import UsageError
from friction_hil.numerics.jit import compiled

PERIOD_S = 2.0**-10
RESOLUTION = 2.0**-18  # both exact in binary: shifts by whole counts are exact
INERTIA = 2e-4
LIMIT = 1000.0  # rad/s^2

checked = settings(max_examples=60, deadline=None)
every_kind = pytest.mark.parametrize("kind", KINDS)
from_position = pytest.mark.parametrize("kind", KINDS[:3])

# embedded, as in the compensator
SETTINGS = np.dtype([("before", "f8"), ("velocity", velocity.SETTINGS), ("after", "f8")])
STATE = np.dtype([("before", "f8"), ("velocity", velocity.STATE), ("after", "f8")])


@compiled
def _run(settings, state, cycle, position, drive_velocity, net_torque, is_fresh, estimate):
    c, r = settings[0], state[0]
    for k in range(cycle.shape[0]):
        if is_fresh[k] > 0.0:
            velocity.update(c.velocity, r.velocity, cycle[k], position[k], drive_velocity[k], net_torque[k])
        else:
            velocity.predict(c.velocity, r.velocity, cycle[k], net_torque[k])
        estimate[k] = r.velocity.velocity


class Estimate:
    """An estimator at work; `feed` returns its velocities."""

    def __init__(self, kind="difference", **changes):
        given = {"period_s": PERIOD_S, "resolution": RESOLUTION, "acceleration": 50.0, "inertia": INERTIA}
        given |= {"torque_uncertainty": 0.01, "uncertainty_time_s": 0.02}
        self.estimator = VelocityEstimator(kind, **given | changes)
        self._settings = np.zeros(1, SETTINGS)
        self._settings[0]["velocity"] = self.estimator.record[0]
        self._state = np.zeros(1, STATE)
        self.flat = self._state.view(np.float64)
        self.cycle = 0

    def __getitem__(self, name):
        return float(self._state[0]["velocity"][name])

    def feed(self, position, *, drive=None, torque=0.0, fresh=True, cycle=None):
        position = np.asarray(position, dtype=float)
        if cycle is None:
            cycle = self.cycle + np.arange(position.size)
        columns = [cycle, position, math.nan if drive is None else drive, torque, fresh]
        columns = [np.array(np.broadcast_to(column, position.shape), dtype=float) for column in columns]
        estimate = np.empty(position.size)
        _run(self._settings, self._state, *columns, estimate)
        self.cycle = int(columns[0][-1]) + 1
        assert self.flat[0] == 0.0, "the field before"
        assert self.flat[-1] == 0.0, "the field after"
        return estimate


SIZES = [(2e-4, 1e-3, 6e-6), (2e-6, 125e-6, 1e-9), (2e-1, 10e-3, 1e-2), (2e-6, 10e-3, 1e-9), (2e-1, 125e-6, 1e-4)]


@pytest.mark.parametrize(("inertia", "period_s", "resolution"), SIZES)
@every_kind
def test_under_even_acceleration_the_lag_is_the_delay_told(kind, inertia, period_s, resolution):
    a = 1e4 * resolution / (100.0 * period_s) ** 2
    given = {"inertia": inertia, "period_s": period_s, "resolution": resolution, "acceleration": a, "smoothing": 0.3}
    one = Estimate(kind, **given, torque_uncertainty=inertia * a, uncertainty_time_s=20.0 * period_s)
    t = np.arange(3000) * period_s
    true = 5.0 * a * period_s + a * t
    estimate = one.feed(5.0 * a * period_s * t + 0.5 * a * t**2, drive=true)
    lag_cycles = (true - estimate)[-1] / (a * period_s)
    assert lag_cycles == pytest.approx(one.estimator.delay_cycles, rel=1e-6, abs=1e-6)
    assert one.estimator.delay_cycles > 0.0


@pytest.mark.parametrize("smoothing", [0.1, 0.5, 1.0])
@pytest.mark.parametrize(("kind", "age", "own"), [("difference", 0.5, {}), ("drive", 0.7, {"drive_delay_cycles": 0.7})])
def test_an_estimate_is_as_old_as_its_filter_and_what_it_filters(kind, age, own, smoothing):
    told = VelocityEstimator(kind, PERIOD_S, RESOLUTION, smoothing=smoothing, **own).delay_cycles
    assert told == pytest.approx(age + (1.0 - smoothing) / smoothing)


@pytest.mark.parametrize("fineness", [0.1, 1.0, 10.0])
@from_position
def test_rounding_of_a_wild_motion_gives_the_noise_told(kind, fineness):
    exact = np.cumsum(np.random.default_rng(1).normal(scale=50.0 * RESOLUTION, size=100_000))
    rounded = np.round(exact / RESOLUTION) * RESOLUTION
    changes = {"acceleration": 50.0 * fineness, "torque_uncertainty": 0.01 * fineness, "smoothing": 0.05 * fineness}
    one, two = Estimate(kind, **changes), Estimate(kind, **changes)
    error = (one.feed(rounded) - two.feed(exact))[2000:]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(one.estimator.noise, rel=0.05)


def test_noise_of_the_drives_velocity_goes_through_the_filter():
    own = np.random.default_rng(2).normal(scale=0.3, size=100_000)
    one = Estimate("drive", smoothing=0.2, drive_noise=0.3)
    assert np.std(one.feed(0.0 * own, drive=own)) == pytest.approx(one.estimator.noise, rel=0.05)


def _riccati(F, Q, R, cycles):
    """Covariance before a measurement, by the plain recursion until it changes no more."""
    P = Q.copy()
    P[0, 0] += 1e6 * R
    for _ in range(cycles):
        K, before = P[:, 0] / (P[0, 0] + R), P
        P = F @ (P - np.outer(K, P[0])) @ F.T + Q
        if np.all(np.abs(P - before) <= 1e-13 * np.abs(P)):
            break
    return P


decades = st.floats(0.0, 1.0)


@checked
@given(decades, decades, decades, decades, st.floats(1.0, 1000.0))
def test_kalman_gains_are_those_of_the_covariance_recursion(i, p, r, u, time_cycles):
    inertia, period_s, resolution = 2e-6 * 1e5**i, 125e-6 * 80.0**p, 1e-9 * 1e7**r
    torque_uncertainty = 1e-3 * 1e5**u
    changes = {"inertia": inertia, "period_s": period_s, "resolution": resolution}
    changes |= {"torque_uncertainty": torque_uncertainty, "uncertainty_time_s": time_cycles * period_s}
    T, leak, R = period_s, math.exp(-1.0 / time_cycles), resolution**2 / 12.0
    F = np.array([[1.0, T, 0.5 * T**2 / inertia], [0.0, 1.0, T / inertia], [0.0, 0.0, leak]])
    # a torque that wanders within the cycle, through the double integrator; it keeps its standard deviation
    t = (np.arange(2000) + 0.5) / 2000
    b = np.array([T**2 * t**2 / 2.0 / inertia, T * t / inertia, np.ones_like(t)])
    Q = torque_uncertainty**2 * (1.0 - leak**2) * (b @ b.T) / t.size
    assume(Q[0, 0] < 1e6 * R)  # beyond, the recursion itself loses digits
    assume(Q[0, 0] > 1e-12 * R)  # and below, it takes more than 5000 cycles
    P = _riccati(F, Q, R, 5000)
    for gap in (1, 2, MAX_GAP_CYCLES):
        # an innovation of 1 makes the state the gain
        one = Estimate("kalman", **changes)
        one.feed(np.zeros(20))
        one.feed([1.0], cycle=np.array([19.0 + gap]))
        P_before = P
        for _ in range(gap - 1):
            P_before = F @ P_before @ F.T + Q
        K = P_before[:, 0] / (P_before[0, 0] + R)
        np.testing.assert_allclose([one["velocity"], one["torque"]], K[1:], rtol=1e-4)
        assert one["offset"] == pytest.approx(-R / (P_before[0, 0] + R), rel=1e-4, abs=1e-12)


@checked
@given(st.sampled_from(KINDS), decades, decades, decades, decades, decades)
def test_every_size_of_machine_gives_a_stable_estimator(kind, i, p, r, u, t):
    period_s, resolution = 125e-6 * 80.0**p, 1e-9 * 1e7**r
    given = {"inertia": 2e-6 * 1e5**i, "period_s": period_s, "resolution": resolution, "acceleration": 0.1 * 1e6**u}
    one = Estimate(kind, **given, torque_uncertainty=1e-4 * 1e6**u, uncertainty_time_s=1e-4 * 1e5**t)
    assert 0.0 <= one.estimator.delay_cycles < math.inf
    assert 0.0 < one.estimator.noise < 6.0 * resolution / period_s
    rng = np.random.default_rng(0)
    for loss, bound in ((0.0, 8.0), (0.5, 60.0), (0.8, 60.0)):  # carried on over ten cycles, noise grows tenfold
        estimate = one.feed(resolution * rng.integers(0, 2, 5000), fresh=rng.random(5000) >= loss)
        assert np.max(np.abs(estimate)) < bound * resolution / period_s


@pytest.mark.parametrize("acceleration", [0.1, 10.0, 1000.0])
def test_the_tracking_bandwidth_has_the_least_error(acceleration):
    def error(one):
        return math.hypot(one.delay_cycles * PERIOD_S * acceleration, one.noise)

    chosen = error(VelocityEstimator("tracking", PERIOD_S, RESOLUTION, acceleration=acceleration))
    others = [VelocityEstimator("tracking", PERIOD_S, RESOLUTION, bandwidth_hz=f) for f in np.geomspace(0.1, 1e4, 300)]
    assert chosen <= 1.1 * min(map(error, others))


@every_kind
@pytest.mark.parametrize("speed", [0.0, -3.7, 250.0])
def test_an_even_motion_is_found_exactly_and_rest_without_drift(kind, speed):
    one = Estimate(kind)
    estimate = one.feed(1.0 + speed * PERIOD_S * np.arange(4000), drive=speed)
    assert estimate[-1] == pytest.approx(speed, rel=1e-9)
    assert one["offset"] == pytest.approx(0.0, abs=1e-9)
    resting = one.feed(np.full(4000, 7.0), drive=0.0)
    assert np.max(np.abs(resting[-100:])) < 1e-6


@checked
@given(st.sampled_from(KINDS[:3]), st.lists(st.booleans(), min_size=2, max_size=200), st.floats(0.1, 1e4))
def test_flicker_between_two_counts_is_no_motion(kind, counts, fineness):
    one = Estimate(kind, acceleration=fineness, torque_uncertainty=fineness * INERTIA, max_acceleration=1e-3)
    estimate = one.feed(RESOLUTION * np.array(counts, dtype=float))
    impulse = Estimate(kind, acceleration=fineness, torque_uncertainty=fineness * INERTIA)
    answer = impulse.feed(np.r_[0.0, RESOLUTION, np.zeros(5000)])
    assert np.max(np.abs(estimate)) <= (0.5 + 1e-9) * np.sum(np.abs(answer)) + 1e-12
    assert np.sum(np.abs(answer)) <= 12.0 * RESOLUTION / PERIOD_S
    assert one["glitches"] == 0.0


counts = st.lists(st.integers(-1000, 1000), min_size=2, max_size=60)


@checked
@given(st.sampled_from(KINDS), counts, st.integers(-(2**30), 2**30))
def test_a_shift_by_whole_counts_changes_no_bit(kind, walk, shift):
    position = RESOLUTION * np.cumsum(walk)
    here, there = Estimate(kind, max_acceleration=LIMIT), Estimate(kind, max_acceleration=LIMIT)
    drive = np.array(walk, dtype=float)
    expected = here.feed(position, drive=drive)
    np.testing.assert_array_equal(there.feed(position + shift * RESOLUTION, drive=drive), expected)


def test_a_kalman_filter_that_knows_the_torque_does_not_lag():
    t = PERIOD_S * np.arange(2000)
    torque = 0.02 * np.sin(40.0 * t)
    true, position = np.zeros_like(t), np.zeros_like(t)
    for k in range(1, t.size):
        change = torque[k] / INERTIA * PERIOD_S
        true[k] = true[k - 1] + change
        position[k] = position[k - 1] + PERIOD_S * (true[k - 1] + 0.5 * change)
    np.testing.assert_allclose(Estimate("kalman").feed(position, torque=torque), true, atol=1e-9)
    blind = Estimate("tracking").feed(position)
    assert np.max(np.abs(blind - true)[100:]) > 0.02


wild = st.one_of(st.floats(-1e3, 1e3), st.sampled_from([math.nan, math.inf, -math.inf, 1e308, -1e308]))
rows = st.lists(st.tuples(st.integers(-2, 14), wild, wild, wild, st.booleans()), min_size=1, max_size=60)
limits = st.sampled_from([math.inf, LIMIT, 1e-6])


@checked
@example("kalman", math.inf, [(1, 0.0, 0.0, 0.0, True), (1, 1e308, 0.0, 0.0, True), (1, 0.0, 0.0, 1e308, False)])
@given(st.sampled_from(KINDS), limits, rows)
def test_nothing_poisons_the_state(kind, limit, rows):
    passed, position, drive, torque, fresh = np.array(rows, dtype=float).T
    one = Estimate(kind, max_acceleration=limit)
    estimate = one.feed(position, drive=drive, torque=torque, fresh=fresh, cycle=np.cumsum(passed))
    assert np.all(np.isfinite(estimate))
    assert np.all(np.isfinite(one.flat))
    start = one.cycle + MAX_GAP_CYCLES + 1
    after = one.feed(2.0 * PERIOD_S * np.arange(3000), drive=2.0, cycle=start + np.arange(3000))
    assert after[-1] == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
@pytest.mark.parametrize(
    ("kind", "what"), [(kind, "position") for kind in KINDS] + [("drive", "drive"), ("kalman", "torque")]
)
def test_what_is_not_finite_is_as_if_nothing_came(kind, what, wrong):
    position = 0.01 * np.sin(0.1 * np.arange(60))
    columns = {"position": position, "drive": np.gradient(position, PERIOD_S), "torque": 0.0 * position}
    fresh = np.ones(60)
    fresh[30] = 0.0
    expected = Estimate(kind).feed(columns["position"], **{k: columns[k] for k in ("drive", "torque")}, fresh=fresh)
    columns[what][30] = wrong
    estimate = Estimate(kind).feed(columns["position"], **{k: columns[k] for k in ("drive", "torque")})
    np.testing.assert_array_equal(estimate, expected)
    if kind in ("difference", "tracking"):  # which use neither torque nor the drive's velocity
        unused = Estimate(kind).feed(columns["position"], torque=math.nan, drive=math.inf)
        np.testing.assert_array_equal(unused, Estimate(kind).feed(columns["position"]))


@checked
@given(st.sampled_from(KINDS), st.lists(st.integers(1, MAX_GAP_CYCLES), min_size=3, max_size=30), st.booleans())
def test_gaps_leave_an_even_motion_alone(kind, gaps, are_announced):
    one = Estimate(kind, max_acceleration=LIMIT)
    one.feed(3.0 * PERIOD_S * np.arange(3000), drive=3.0)
    last = one.cycle - 1 + np.cumsum(gaps)
    cycle = np.arange(one.cycle, last[-1] + 1) if are_announced else last
    estimate = one.feed(3.0 * PERIOD_S * cycle, drive=3.0, cycle=cycle, fresh=np.isin(cycle, last))
    np.testing.assert_allclose(estimate, 3.0, rtol=1e-9)
    assert one["glitches"] == 0.0


def test_in_a_gap_the_kalman_filter_follows_the_torque_and_the_others_hold():
    for kind in KINDS:
        one = Estimate(kind)
        one.feed(np.zeros(100), drive=0.0)
        estimate = one.feed(np.zeros(20), torque=0.02, fresh=False)
        expected = np.minimum(np.arange(1, 21), MAX_GAP_CYCLES) * PERIOD_S * 0.02 / INERTIA
        np.testing.assert_allclose(estimate, expected if kind == "kalman" else 0.0, rtol=1e-12)


@from_position
def test_a_slope_over_a_gap_weighs_as_much_as_over_the_cycles_it_spans(kind):
    one = Estimate(kind, smoothing=1.0, acceleration=1e6, torque_uncertainty=1e3)
    one.feed(np.zeros(50))
    estimate = one.feed([0.01, 0.02], cycle=np.array([54.0, 55.0]))
    assert 0.01 / 5.0 / PERIOD_S <= estimate[0] <= 2.5 * 0.01 / 5.0 / PERIOD_S


@every_kind
@pytest.mark.parametrize("drive", [0.0, 4.0])
def test_after_a_long_gap_it_starts_anew(kind, drive):
    one = Estimate(kind)
    one.feed(2.0 * PERIOD_S * np.arange(100), drive=2.0)
    unknown = kind != "drive" and drive == 0.0
    estimate = one.feed([50.0], drive=None if unknown else drive, cycle=np.array([99.0 + MAX_GAP_CYCLES + 1]))
    assert estimate[0] == drive
    assert (one["position"], one["offset"]) == (50.0, 0.0)


@from_position
@pytest.mark.parametrize("size", [-1e3, -0.1, 0.1, 1e3, 1e15])
@pytest.mark.parametrize("speed", [0.0, 30.0])
def test_a_glitch_costs_what_a_missing_sample_costs(kind, size, speed):
    position = speed * PERIOD_S * np.arange(300) + 1e-4 * np.sin(0.05 * np.arange(300))
    fresh = np.ones(300)
    fresh[200] = 0.0
    expected = Estimate(kind).feed(position, fresh=fresh)
    position[200] += size
    one = Estimate(kind, max_acceleration=LIMIT)
    np.testing.assert_array_equal(one.feed(position), expected)
    assert one["glitches"] == 1.0


@from_position
@pytest.mark.parametrize("speed", [0.0, 5.0])
@pytest.mark.parametrize("gap", [1, 4])
def test_a_new_place_is_taken_when_the_next_sample_confirms_it(kind, speed, gap):
    one = Estimate(kind, max_acceleration=LIMIT)
    one.feed(speed * PERIOD_S * np.arange(3000))
    cycle = one.cycle + np.r_[0, gap + np.arange(200)]
    estimate = one.feed(-40.0 + speed * PERIOD_S * cycle, cycle=cycle)
    np.testing.assert_allclose(estimate, speed, atol=1e-6)
    assert one["glitches"] == 1.0
    assert one["position"] == -40.0 + speed * PERIOD_S * cycle[-1]


@checked
@given(
    st.sampled_from(KINDS[:3]),
    st.lists(st.tuples(st.floats(-1.0, 1.0), st.integers(1, 12)), min_size=1, max_size=20),
    st.lists(st.integers(1, 4), min_size=100, max_size=100),
    st.randoms(use_true_random=False),
    st.sampled_from([0.01, LIMIT]),
)
def test_no_possible_motion_is_taken_for_a_glitch(kind, pieces, gaps, random, limit):
    acceleration = limit * np.concatenate([np.full(cycles, share) for share, cycles in pieces])
    true = np.r_[0.0, np.cumsum(acceleration) * PERIOD_S]
    exact = np.r_[0.0, np.cumsum(PERIOD_S * (true[:-1] + 0.5 * PERIOD_S * acceleration))]
    flicker = np.array([random.choice([-1, 0, 1]) for _ in exact])
    position = RESOLUTION * (np.round(exact / RESOLUTION) + flicker)
    cycle = np.cumsum(gaps)
    cycle = cycle[cycle < exact.size]
    assume(cycle.size)
    one = Estimate(kind, max_acceleration=limit)
    one.feed(position[cycle], cycle=cycle)
    assert one["glitches"] == 0.0


@from_position
def test_an_impact_harder_than_the_limit_does_not_blind_the_estimator(kind):
    one = Estimate(kind, max_acceleration=LIMIT)
    position = 20.0 * PERIOD_S * np.r_[np.arange(500), 499.0 - np.arange(500)]  # it bounces off
    estimate = one.feed(position)
    assert np.max(np.abs(estimate)) < 60.0
    assert estimate[-1] == pytest.approx(-20.0, rel=1e-6)
    assert one["glitches"] <= 2.0


@from_position
def test_a_limit_set_too_low_still_lets_the_motion_be_seen(kind):
    one = Estimate(kind, max_acceleration=0.2 * LIMIT)
    t = PERIOD_S * np.arange(300)
    estimate = one.feed(0.5 * LIMIT * t**2)
    assert 0.1 * LIMIT * t[-1] < estimate[-1] < 1.2 * LIMIT * t[-1]


@from_position
def test_without_a_limit_every_position_counts(kind):
    one = Estimate(kind)
    assert one.feed([0.0, 0.0, 0.0, 1.0])[-1] > 0.0
    assert one["position"] == 1.0


@checked
@given(st.integers(16, 64), st.integers(-(2**80), 2**80), st.data())
def test_unwrap_follows_any_motion_below_half_the_range(bits, start, data):
    count, true = start, start
    for _ in range(10):
        true += data.draw(st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1))
        unsigned = true % 2**bits
        raw = data.draw(st.sampled_from([unsigned, unsigned - 2**bits if unsigned >= 2 ** (bits - 1) else unsigned]))
        assert (count := unwrap(count, raw, bits)) == true


@pytest.mark.parametrize("bits", range(16, 65))
def test_every_width_wraps_at_both_ends(bits):
    top = 2 ** (bits - 1) - 1
    wrapped = [unwrap(top, -top - 1, bits), unwrap(-top - 1, top, bits), unwrap(2 * top + 1, 0, bits)]
    assert wrapped == [top + 1, -top - 2, 2 * top + 2]


@pytest.mark.parametrize(
    ("kind", "changes", "said"),
    [
        ("kalmann", {}, "did you mean 'kalman'"),
        ("difference", {"smoothing": 0.0}, "smoothing"),
        ("difference", {"period_s": math.nan}, "period_s"),
        ("difference", {"resolution": 0.0}, "resolution"),
        ("tracking", {"acceleration": math.nan}, "acceleration"),
        ("tracking", {"bandwidth_hz": -5.0}, "bandwidth_hz"),
        ("kalman", {"inertia": math.nan}, "inertia"),
        ("kalman", {"torque_uncertainty": 0.0}, "torque_uncertainty"),
        ("kalman", {"uncertainty_time_s": math.inf}, "uncertainty_time_s"),
        ("difference", {"max_acceleration": math.nan}, "max_acceleration"),
    ],
)
def test_mistakes_are_named(kind, changes, said):
    with pytest.raises(UsageError, match=said):
        Estimate(kind, **changes)
