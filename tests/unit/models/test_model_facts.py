"""Facts of friction that the models must reproduce, on the reference set of the literature.

Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Transactions on Automatic Control 40(3), 1995: 1 kg on a plane.
The other models get parameters of the same axis: 1 N Coulomb, 1.5 N break-away, 100 N/mm stiffness. The mass is
integrated here, step by step, with the friction that `Runner.step` gives. Facts 10, oddness, and 11,
consistency over the step, are those of tests/contract/friction_families.py and test_models_properties.py.
"""

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.integrate import quad

import friction_hil as fh

REFERENCE = {"sigma0": 1e5, "sigma1": math.sqrt(1e5), "sigma2": 0.4}
REFERENCE |= {"coulomb": 1.0, "static": 1.5, "stribeck_velocity": 1e-3}
STRIBECK = {"coulomb": 1.0, "static": 1.5, "stribeck_velocity": 1e-3, "viscous": 0.4}
BREAK_POINTS = np.array([2e-6, 5e-6, 12e-6, 30e-6])  # of GMS at Coulomb level
WEIGHTS = np.array([0.1, 0.2, 0.3, 0.4])
AXIS = {
    "coulomb": {"coulomb": 1.0, "viscous": 0.4},
    "stribeck": STRIBECK,
    "karnopp": STRIBECK | {"stick_velocity": 1e-5},
    "armstrong": {"coulomb": 1.0, "viscous": 0.4, "static_released": 1.2, "static_rested": 1.5}
    | {"stribeck_velocity": 1e-3, "lag_s": 2e-3, "rise_s": 0.3, "stiffness": 1e5},
    "power_law": {"coulomb": 1.0, "factor": 0.4, "exponent": 0.5},
    "dahl": {"sigma0": 1e5, "coulomb": 1.0, "viscous": 0.4},
    "bouc_wen": {"stiffness": 1e5, "beta": 6e4, "gamma": 4e4, "viscous": 0.4},
    "lugre": REFERENCE,
    "elasto_plastic": REFERENCE | {"breakaway_ratio": 0.7},
    "gms": STRIBECK | {"stiffness": list(WEIGHTS / BREAK_POINTS), "weight": list(WEIGHTS), "attraction": 200.0},
}
STATIC_MAPS = ("coulomb", "karnopp", "power_law", "stribeck", "table")


def on_axis(name, **changes):
    return fh.models.create(name, **AXIS[name] | changes)


@dataclass
class Mass:
    """1 kg with friction, under a force."""

    friction: fh.models.Runner
    is_static: bool = False
    x: float = 0.0
    v: float = 0.0
    trace: list[tuple[float, float, float]] = field(default_factory=list)

    def push(self, force, dt):
        friction = self.friction.step(self.v, dt, applied_torque=force)
        v = self.v + dt * (force - friction)
        # a static map stops a mass that would turn round
        self.v = 0.0 if self.is_static and v * self.v < 0.0 else v
        self.x += dt * self.v
        self.trace.append((self.x, self.v, friction))

    def column(self, number):
        return np.array(self.trace)[:, number]


def mass_on(name, **changes):
    return Mass(on_axis(name, **changes).start("simulation"), is_static=name in STATIC_MAPS)


def gaussian(v):
    return 1.0 + 0.5 * np.exp(-((v / 1e-3) ** 2))


CURVES = {
    "armstrong": lambda v: 1.0 + 0.2 / (1.0 + (v / 1e-3) ** 2),  # without rest before
    "dahl": np.ones_like,
    "bouc_wen": np.ones_like,
    "lugre": gaussian,
    "elasto_plastic": gaussian,
    "gms": gaussian,
}


@pytest.mark.parametrize("name", sorted(CURVES))
def test_fact_1_constant_velocity_settles_on_the_stribeck_curve(name):
    v = np.array([-0.1, -2e-3, -1e-3, 5e-4, 1e-3, 3e-3, 0.05])
    durations = np.maximum(2e-3 / np.abs(v), 0.5)
    model = on_axis(name, **({"rise_s": 1e9} if name == "armstrong" else {}))  # no rest before it breaks away
    torque = [
        model.simulate(np.full(2000, one), duration / 2000)[-1] for one, duration in zip(v, durations, strict=True)
    ]
    curve = np.sign(v) * CURVES[name](v) + 0.4 * v
    np.testing.assert_allclose(torque, curve, rtol=1e-6)
    np.testing.assert_allclose(model.steady_state(v), curve, rtol=1e-12)


def plastic_travel(fraction, ratio):
    """Travel of quasi-static elasto-plastic bristles up to a fraction of break-away (Dupont et al., 2002)."""

    def slope(z):
        if z <= ratio:
            return 1.0
        alpha = 0.5 * math.sin(math.pi * (z - 0.5 * (1.0 + ratio)) / (1.0 - ratio)) + 0.5
        return 1.0 / (1.0 - alpha * z)

    return quad(slope, 0.0, fraction, points=[ratio])[0]


@pytest.mark.parametrize(
    ("name", "reach"),
    [
        ("lugre", -1.5e-5 * math.log(0.05)),
        ("elasto_plastic", 1.5e-5 * plastic_travel(0.95, 0.7)),
        ("gms", (1.425 - 1.5 * 0.6) * 30e-6 / 0.4),  # three of four elements slip
    ],
)
def test_fact_2_presliding_is_small_and_has_hysteresis(name, reach):
    mass, dt = mass_on(name), 2e-4
    force = np.concatenate([np.arange(0.0, 1.425, dt), np.arange(1.425, -1.425, -dt), np.arange(-1.425, 1.425, dt)])
    for one in force:
        mass.push(float(one), dt)
    x = mass.column(0)
    assert np.abs(x).max() < 50e-6
    assert np.abs(x).max() == pytest.approx(reach, rel=0.1)
    down, up = np.flatnonzero(np.abs(force) < dt / 2)[1:3]
    assert x[down] > 0.2 * reach  # at no force it lies where it was pushed to
    assert x[up] < x[down] - 0.2 * reach  # the position differs on the return


@pytest.mark.parametrize("name", ["lugre", "elasto_plastic", "gms", "armstrong", "stribeck"])
def test_fact_3_friction_lags_and_the_loop_widens_with_the_rate(name):
    widths = []
    for w in (1.0, 10.0, 25.0):
        n = 200_000
        t = np.linspace(0.0, 3 * 2.0 * np.pi / w, n)
        v = 1e-3 * (1.0 + np.sin(w * t))
        torque = on_axis(name).simulate(v, t[1])
        last = slice(2 * n // 3, n)
        v, torque, rate = v[last], torque[last], np.cos(w * t[last])
        sides = (np.flatnonzero(sign * rate > 0.0) for sign in (1.0, -1.0))  # of rising and falling velocity
        by_velocity = (rows[np.argsort(v[rows])] for rows in sides)
        rising, falling = (np.interp(1.5e-3, v[rows], torque[rows]) for rows in by_velocity)
        widths.append(rising - falling)
    if name == "stribeck":  # a static map knows no lag
        np.testing.assert_allclose(widths, 0.0, atol=1e-9)
    else:
        assert 0.0 < widths[0] < widths[1] < widths[2]
        assert widths[2] > 1e-3


def test_armstrong_lags_by_its_dead_time():
    dt, lag = 1e-4, 20
    v = 2e-3 + 1e-3 * np.sin(30.0 * dt * np.arange(2000))
    late = np.concatenate([np.full(lag, v[0]), v])[: v.size]
    torque = on_axis("armstrong", rise_s=1e9).simulate(v, dt)
    np.testing.assert_allclose(torque[300:], (CURVES["armstrong"](late) + 0.4 * v)[300:], rtol=1e-9)


@pytest.mark.parametrize("name", ["lugre", "elasto_plastic", "gms", "armstrong"])
def test_fact_4_break_away_falls_with_the_rate_of_the_force(name):
    levels = []
    for rate in (1.0, 5.0, 20.0, 50.0):
        mass, dt = mass_on(name), 5e-5
        while mass.v < 5.0 * REFERENCE["stribeck_velocity"]:  # it slides
            mass.push(rate * dt * len(mass.trace), dt)
        levels.append(mass.column(2).max())
    assert all(a > b + 0.01 for a, b in itertools.pairwise(levels))
    assert 1.4 < levels[0] < 1.5
    assert 1.0 < levels[-1] < 1.3


def creep(runner, dt=1e-4):
    """Break-away level and time at rest of an axis that is pulled out of rest backwards, at 10 um/s."""
    torque = [runner.step(-1e-5, dt) for _ in range(40_000)]
    return -min(torque), dt * (1 + int(np.argmin(torque))), -torque[-1]


@pytest.mark.parametrize("dwell", [0.0, 0.05, 0.3, 3.0])
def test_armstrong_static_friction_rises_with_the_time_at_rest(dwell):
    """Fs = Fs_a + (Fs_inf - Fs_a) t2 / (t2 + gamma); a sudden stop from fast sliding leaves the lowest Fs_a."""
    runner, dt = on_axis("armstrong", viscous=0.0).start("simulation"), 1e-4
    for _ in range(200):
        sliding = runner.step(5e-3, dt)
    for _ in range(round(dwell / dt)):
        runner.step(0.0, dt)
    level, crept, after = creep(runner)
    rested = dwell + crept
    assert sliding < 1.05
    assert level == pytest.approx(1.2 + 0.3 * rested / (rested + 0.3), rel=1e-3)
    assert after == pytest.approx(1.0 + (level - 1.0) / (1.0 + 1e-4), rel=1e-3)


def test_armstrong_starts_from_the_level_at_which_the_last_slip_ended():
    runner, dt = on_axis("armstrong", viscous=0.0, static_rested=2.0, rise_s=0.01).start("simulation"), 1e-4
    for _ in range(1000):
        runner.step(0.0, dt)  # well rested before it moves
    for v in (5e-3, 5e-4):
        for _ in range(200):
            sliding = runner.step(v, dt)
    rested = 0.1 + 3.9e-3  # and 3.9 ms of spring, 0.5 N a sample, up to the level
    broke_away = 1.2 + 0.8 * rested / (rested + 0.01)
    assert sliding == pytest.approx(1.0 + (broke_away - 1.0) / 1.25, rel=1e-3)
    start = sliding
    level, rested, _ = creep(runner)
    assert start > 1.5  # more than static_released
    assert level == pytest.approx(start + (2.0 - start) * rested / (rested + 0.01), rel=1e-3)


@pytest.mark.parametrize(
    ("name", "sticks"),
    [(name, True) for name in ("lugre", "elasto_plastic", "gms", "stribeck", "karnopp", "armstrong")]
    + [(name, False) for name in ("dahl", "bouc_wen", "coulomb")],
)
def test_fact_5_stick_slip_needs_a_falling_curve(name, sticks):
    mass, dt = mass_on(name), 4e-4
    for k in range(100_000):  # 40 s at the end of a spring that is pulled at 0.1 m/s
        mass.push(2.0 * (0.1 * k * dt - mass.x), dt)
    x, v = mass.column(0)[50_000:], mass.column(1)[50_000:]
    stuck = np.abs(x[250:] - x[:-250]) < 1e-4  # no travel in 0.1 s; moving with the pull it would be 10 mm
    starts = np.count_nonzero(np.diff(stuck.astype(int)) == -1)
    if sticks:
        assert starts >= 2
        assert v.max() > 0.2
    else:
        assert not stuck.any()
        assert np.ptp(v[-10_000:]) < 0.01


def test_karnopp_balances_the_force_inside_its_dead_band():
    runner = on_axis("karnopp").start("simulation")
    for v in (0.0, 0.9e-5, -0.9e-5):
        for force, held in ((0.7, 0.7), (-1.4, -1.4), (9.0, 1.5), (-9.0, -1.5)):
            assert runner.step(v, 1e-3, applied_torque=force) == pytest.approx(held, abs=1e-5)
    assert runner.step(1.1e-5, 1e-3, applied_torque=-9.0) == pytest.approx(1.5, abs=1e-3)


def test_fact_6_dahl_saturates_without_overshoot_and_lugre_overshoots_when_it_accelerates():
    x = np.linspace(0.0, 2e-4, 20_001)[1:]
    for name in ("dahl", "bouc_wen"):
        force = on_axis(name, viscous=0.0).simulate(np.full(x.size, x[0] / 1e-6), 1e-6)
        assert force[0] / x[0] == pytest.approx(1e5, rel=1e-3)
        assert np.all(np.diff(force) >= 0.0)
        assert 0.999 < force[-1] <= 1.0
    t = 1e-5 * np.arange(1, 100_001)
    for name in ("lugre", "elasto_plastic", "gms"):
        overshoots = []
        for acceleration in (5e-3, 2e-2):
            torque = on_axis(name).simulate(acceleration * t, 1e-5) - 0.4 * acceleration * t
            overshoots.append(torque.max() - 1.0)
            assert torque[-1] == pytest.approx(1.0, abs=0.01)
        assert 0.5 > overshoots[0] > overshoots[1] > 0.1  # never above break-away, less of it the faster it starts
    assert on_axis("dahl", viscous=0.0).simulate(2e-2 * t, 1e-5).max() <= 1.0
    for name in ("lugre", "elasto_plastic"):
        steady = on_axis(name, sigma1=0.0).simulate(np.full(4000, 5e-4), 1e-4)
        assert np.all(np.diff(steady) >= 0.0)


def along(name, turns, speed=1e-4, step=1e-8):
    """Torque over a path through the turning points ``turns`` at one speed, one sample every ``step``."""
    lengths = np.round(np.diff([0.0, *turns]) / step).astype(int)
    v = np.concatenate([np.full(abs(length), math.copysign(speed, length)) for length in lengths])
    return np.cumsum(v / speed), on_axis(name).simulate(v, step / speed)


@pytest.mark.parametrize("name", ["gms", "dahl", "lugre", "bouc_wen", "elasto_plastic"])
def test_fact_7_only_gms_remembers_the_major_loop_when_a_minor_loop_closes(name):
    """At equal speed; GMS then goes on as if the minor loop had not been."""
    _, plain = along(name, [20e-6, -20e-6, 20e-6])
    x, looped = along(name, [20e-6, -20e-6, 10e-6, 2e-6, 10e-6, 20e-6])
    left, back = np.flatnonzero(np.isclose(x, 1000.0))[-2:]
    assert back - left == 1600
    gap = abs(looped[back] - looped[left])
    rest = np.abs(looped[back:] - plain[-(looped.size - back) :]).max()
    if name == "gms":
        assert max(gap, rest) < 1e-12
    else:
        assert min(gap, rest) > 5e-3


@pytest.mark.parametrize("name", ["elasto_plastic", "lugre"])
def test_presliding_under_a_swinging_force_does_not_drift_with_elasto_plastic_bristles(name):
    """Dupont et al., 2002: below break-away a model must not drift; LuGre drifts a little in every cycle."""
    mass, dt = mass_on(name), 2e-4
    force = 0.5 + 0.4 * np.sin(2.0 * np.pi * 10.0 * dt * np.arange(20_000))
    force[:500] *= np.linspace(0.0, 1.0, 500)
    for one in force:  # 40 swings up to 0.9 N, below the elastic limit of 1.05 N
        mass.push(float(one), dt)
    positions = mass.column(0)[2499::500]  # once a swing
    drift = np.diff(positions)
    if name == "elasto_plastic":
        assert np.abs(drift).max() < 1e-12
        assert np.ptp(mass.column(0)[-500:]) == pytest.approx(0.8e-5, rel=0.05)  # it swings like a spring
    else:
        assert np.all(drift > 1e-7)


@pytest.mark.parametrize(("speed", "is_passive"), [(0.010, True), (0.02, False), (0.1, False)])
def test_fact_8_constant_bristle_damping_is_passive_up_to_its_bound(speed, is_passive):
    """sigma1 <= 4 g / v, that is 12.6 mm/s. The bristles enter deflected as far as a standstill can leave them."""
    dt = 1e-8
    worst = math.inf
    for fraction in np.linspace(-1.0, 1.0, 201):
        runner = on_axis("lugre", sigma2=0.0).start("simulation")
        before = fraction * REFERENCE["static"] / REFERENCE["sigma0"]
        runner.state[0] = before
        supplied = runner.step(speed, dt) * speed * dt
        stored = 0.5 * REFERENCE["sigma0"] * (runner.state[0] ** 2 - before**2)
        worst = min(worst, (supplied - stored) / dt)
    assert bool(worst >= -1e-9) is is_passive


@pytest.mark.parametrize("gain", [0.0, 1.0])
@pytest.mark.parametrize("name", ["lugre", "elasto_plastic", "gms"])
def test_fact_9_an_integral_hunts_and_compensation_ends_it(name, gain):
    """PID position control of the 1995 paper. The mass is to go to 1 m; then it must stay there."""
    mass, dt = mass_on(name), 4e-4
    compensator = on_axis(name).start("feedforward")
    integral = 0.0
    for _ in range(150_000):
        error = 1.0 - mass.x
        integral += dt * error
        feedforward = gain * compensator.step(mass.v, dt)
        mass.push(3.0 * error + 4.0 * integral - 6.0 * mass.v + feedforward, dt)
    off = mass.column(0) - 1.0
    if gain == 0.0:
        assert np.count_nonzero(np.diff(np.sign(off[50_000:]))) >= 2
        assert np.ptp(off[-75_000:]) > 0.1
    else:
        assert np.abs(off[-50_000:]).max() < 1e-3


@pytest.mark.parametrize("name", ["coulomb", "karnopp", "power_law", "stribeck"])
@pytest.mark.parametrize("last", [0.0, 0.01, -0.01])
def test_at_rest_each_direction_has_its_own_break_away_level(name, last):
    """Friction opposes the applied torque, independently of the last direction of motion."""
    level = "coulomb" if name == "power_law" else "static"
    sides = {"positive": {level: 1.8}, "negative": {level: 1.6}}
    model = fh.models.create(name, **AXIS[name], modifiers={"direction": sides})
    for force, held in ((9.0, 1.8), (1.7, 1.7), (-9.0, -1.6), (-1.5, -1.5)):
        assert model.simulate([last, 0.0], 1e-3, applied_torque=[0.0, force])[1] == pytest.approx(held, rel=1e-12)
