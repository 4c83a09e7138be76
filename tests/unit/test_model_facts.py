"""Facts of friction that coulomb, stribeck, dahl and lugre must reproduce, on the reference set of the literature.

Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Transactions on Automatic Control 40(3), 1995: 1 kg on a plane.
The mass is integrated here, step by step, with the friction that `Runner.step` gives.
"""

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
import pytest

import friction_hil as fh

REFERENCE = {
    "sigma0": 1e5,
    "sigma1": math.sqrt(1e5),
    "sigma2": 0.4,
    "coulomb": 1.0,
    "static": 1.5,
    "stribeck_velocity": 1e-3,
}


def reference():
    return fh.models.create("lugre", **REFERENCE)


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


def test_fact_1_constant_velocity_settles_on_the_stribeck_curve():
    v = np.array([-0.1, -2e-3, -1e-3, 5e-4, 1e-3, 3e-3, 0.05])
    torque = [reference().simulate(np.full(200, one), 1e-5 / abs(one))[-1] for one in v]
    curve = np.sign(v) * (1.0 + 0.5 * np.exp(-((v / 1e-3) ** 2))) + 0.4 * v
    np.testing.assert_allclose(torque, curve, rtol=1e-6)


def test_fact_2_presliding_is_small_and_has_hysteresis():
    mass, dt = Mass(reference().start("simulation")), 2e-4
    force = np.concatenate([np.arange(0.0, 1.425, dt), np.arange(1.425, -1.425, -dt), np.arange(-1.425, 1.425, dt)])
    for one in force:
        mass.push(float(one), dt)
    x = mass.column(0)
    assert np.abs(x).max() < 50e-6
    assert np.abs(x).max() == pytest.approx(-REFERENCE["static"] / REFERENCE["sigma0"] * math.log(0.05), rel=0.1)
    down, up = np.flatnonzero(np.abs(force) < dt / 2)[1:3]
    assert x[down] > 10e-6  # at no force it lies where it was pushed to
    assert x[up] < x[down] - 10e-6  # another place on the way back


def test_fact_3_friction_lags_and_the_loop_widens_with_the_rate():
    widths = []
    for w in (1.0, 10.0, 25.0):
        n = 200_000
        t = np.linspace(0.0, 3 * 2.0 * np.pi / w, n)
        v = 1e-3 * (1.0 + np.sin(w * t))
        torque = reference().simulate(v, t[1])
        last = slice(2 * n // 3, n)
        v, torque, rate = v[last], torque[last], np.cos(w * t[last])
        rising, falling = (np.interp(1.5e-3, v[side], torque[side]) for side in _branches(v, rate))
        assert falling < rising
        widths.append(rising - falling)
    assert widths[0] < widths[1] < widths[2]


def _branches(v, rate):
    """Indices of rising and falling velocity, each by growing velocity."""
    for side in (rate > 0.0, rate < 0.0):
        rows = np.flatnonzero(side)
        yield rows[np.argsort(v[rows])]


def test_fact_4_break_away_falls_with_the_rate_of_the_force():
    levels = []
    for rate in (1.0, 5.0, 20.0, 50.0):
        mass, dt = Mass(reference().start("simulation")), 5e-5
        while mass.v < 5.0 * REFERENCE["stribeck_velocity"]:  # it slides
            mass.push(rate * dt * len(mass.trace), dt)
        levels.append(mass.column(2).max())
    assert all(a > b + 0.01 for a, b in itertools.pairwise(levels))
    assert 1.4 < levels[0] < 1.5
    assert 1.0 < levels[-1] < 1.25


@pytest.mark.parametrize(
    ("model", "is_static", "sticks"),
    [
        (fh.models.create("lugre", **REFERENCE), False, True),
        (fh.models.create("stribeck", coulomb=1.0, static=1.5, stribeck_velocity=1e-3, viscous=0.4), True, True),
        (fh.models.create("dahl", sigma0=1e5, coulomb=1.0, viscous=0.4), False, False),
        (fh.models.create("coulomb", coulomb=1.0, viscous=0.4), True, False),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_fact_5_stick_slip_needs_a_falling_curve(model, is_static, sticks):
    mass, dt = Mass(model.start("simulation"), is_static), 4e-4
    for k in range(100_000):  # 40 s at the end of a spring that is pulled at 0.1 m/s
        mass.push(2.0 * (0.1 * k * dt - mass.x), dt)
    v = mass.column(1)[50_000:]
    stuck = np.abs(v) < 1e-4
    starts = np.count_nonzero(np.diff(stuck.astype(int)) == -1)
    if sticks:
        assert starts >= 2
        assert v.max() > 0.2
    else:
        assert not stuck.any()
        assert np.ptp(v[-10_000:]) < 0.01


def test_fact_6_dahl_saturates_without_overshoot_and_lugre_overshoots_when_it_accelerates():
    x = np.linspace(0.0, 2e-4, 20_001)[1:]
    dahl = fh.models.create("dahl", sigma0=1e5, coulomb=1.0)
    force = dahl.simulate(np.full(x.size, x[0] / 1e-6), 1e-6)
    assert force[0] / x[0] == pytest.approx(1e5, rel=1e-3)
    assert np.all(np.diff(force) >= 0.0)
    assert 0.999 < force[-1] <= 1.0
    t = 1e-5 * np.arange(1, 100_001)
    overshoots = []
    for acceleration in (5e-3, 2e-2):
        torque = reference().simulate(acceleration * t, 1e-5) - 0.4 * acceleration * t
        overshoots.append(torque.max() - 1.0)
        assert torque[-1] == pytest.approx(1.0, abs=0.01)
    assert 0.5 > overshoots[0] > overshoots[1] > 0.1  # never above break-away, less of it the faster it starts
    assert dahl.simulate(2e-2 * t, 1e-5).max() <= 1.0
    steady = fh.models.create("lugre", **REFERENCE | {"sigma1": 0.0}).simulate(np.full(4000, 5e-4), 1e-4)
    assert np.all(np.diff(steady) >= 0.0)


@pytest.mark.parametrize(("speed", "is_passive"), [(0.010, True), (0.02, False), (0.1, False)])
def test_fact_8_constant_bristle_damping_is_passive_up_to_its_bound(speed, is_passive):
    """sigma1 <= 4 g / v, that is 12.6 mm/s. The bristles enter deflected as far as a standstill can leave them."""
    dt = 1e-8
    worst = math.inf
    for share in np.linspace(-1.0, 1.0, 201):
        runner = fh.models.create("lugre", **REFERENCE | {"sigma2": 0.0}).start("simulation")
        before = share * REFERENCE["static"] / REFERENCE["sigma0"]
        runner.state[0] = before
        supplied = runner.step(speed, dt) * speed * dt
        stored = 0.5 * REFERENCE["sigma0"] * (runner.state[0] ** 2 - before**2)
        worst = min(worst, (supplied - stored) / dt)
    assert bool(worst >= -1e-9) is is_passive


@pytest.mark.parametrize("gain", [0.0, 1.0])
def test_fact_9_an_integral_hunts_and_compensation_ends_it(gain):
    """PID position control of the 1995 paper. The mass is to go to 1 m; then it must stay there."""
    mass, dt = Mass(reference().start("simulation")), 4e-4
    compensator = reference().start("feedforward")
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


def test_fact_10_oddness_is_exact_on_a_long_rough_history():
    v = np.cumsum(np.random.default_rng(1).normal(size=20_000)) * 1e-4
    for model in (reference(), fh.models.create("dahl", sigma0=1e5, coulomb=1.0, exponent=1.5)):
        np.testing.assert_array_equal(model.simulate(-v, 1e-3), -model.simulate(v, 1e-3))
