"""The simulated servo with two masses, backlash, load and gear, compared with textbook results."""

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from friction_hil.config.external_torque import read_table, simulated_servo
from friction_hil.errors import UsageError
from friction_hil.friction import describe
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo

OFF, CSP, CSV, CST = 0, 8, 9, 10
HZ = 80_000
FREE = {"model": "coulomb", "parameters": {"coulomb": 0.0}}


def coulomb(level=0.0, static=None, viscous=0.0):
    return {"model": "coulomb", "parameters": {"coulomb": level, "static": static or level, "viscous": viscous}}


def machine(position=0.0, *, friction=FREE, hz=HZ, peak=100.0, loops=None, encoder=None, gear=None, **mechanics):
    """A servo whose torque acts at once, with the given mechanics."""
    parts = {"mechanics": {"inertia": 1e-4, **mechanics}, "friction": friction, "integration_hz": hz}
    parts |= {"loops": loops or {}, "encoder": encoder or {}, "gear": gear or {}}
    parts["motor"] = {"torque_lag_s": 0.0, "peak_torque": peak}
    return Servo(ServoConfig.model_validate(parts), position)


def pushed(one, torque):
    one.command(CST, torque)
    return one


def record(one, seconds, *names, pieces=1000):
    """Values of properties after each of equal pieces of time, (pieces, names)."""
    steps = round(seconds * one.steps_per_second / pieces)
    rows = []
    for _ in range(pieces):
        one.advance(steps)
        rows.append([getattr(one, name) for name in names])
    return np.array(rows)


def residual(one, at_start=0.0):
    """What is missing in the energy balance, J."""
    e = one.energy
    return e.stored - at_start - (e.motor_work + e.load_work - e.friction_heat - e.load_friction_heat - e.coupling_heat)


def test_a_default_servo_is_rigid_and_each_part_makes_it_a_machine():
    assert ServoConfig().is_rigid
    mechanics = (
        *({"load": {"inertia": 1e-4, "stiffness": 50.0}}, {"gravity": {"sine": 0.1}}, {"spring": {"stiffness": 0.1}}),
        {"inertia_variation": [{"order": 2, "cosine": 1e-5}]},
        {"external": {"sine": {"amplitude": 0.1, "frequency_hz": 5.0}}},
    )
    nodes = {
        "winding": {"capacity": 20.0, "resistance": 0.8, "loss": 12.0},
        "motor": {"capacity": 150, "resistance": 2.0},
    }
    others = (
        *({"encoder": {"noise": 1e-5}}, {"encoder": {"latency_s": 1e-3}}, {"torque_feedback": {"offset": 0.1}}),
        *({"motor": {"no_load_speed": 100.0}}, {"motor": {"cogging": [{"order": 6, "sine": 0.01}]}}),
        *({"loops": {"dead_time_s": 1.25e-4}}, {"loops": {"has_anti_windup": False}}),
        *({"thermal": nodes}, {"wear": [{"time_s": 0.0, "factor": 1.5}]}),
    )
    for parts in (*({"mechanics": each} for each in mechanics), *others):
        assert not ServoConfig.model_validate(parts).is_rigid, parts
    with pytest.raises(UsageError, match="keeps no account"):
        _ = Servo(ServoConfig()).energy


def test_smooth_motion_is_integrated_to_second_order():
    """Halving the step divides the error by four, for all smooth parts together."""
    parts = {
        "load": {"inertia": 2e-4, "stiffness": 30.0, "damping": 5e-3, "friction": coulomb(0.0, viscous=2e-3)},
        "gravity": {"sine": 0.1, "cosine": 0.05},
        "spring": {"stiffness": 0.5, "rest": 0.1},
        "inertia_variation": [{"order": 2, "cosine": 3e-5, "sine": 5e-5}],
        "external": {"sine": {"amplitude": 0.05, "frequency_hz": 20.0}},
    }
    error = {"transmission_error": [{"order": 3, "cosine": 2e-3, "sine": 1e-3}]}
    courses = []
    for factor in (1, 2, 4, 16):
        one = machine(friction=coulomb(0.0, viscous=1e-3), gear=error, hz=24_000 * factor, **parts)
        pushed(one, 0.2)
        courses.append(record(one, 0.25, "true_position", "load_position", "true_velocity", "load_velocity", pieces=25))
    errors = [np.sqrt(np.mean((course - courses[-1]) ** 2, axis=0)) for course in courses[:-1]]
    own = 1.0 / 16.0**2  # error of the finest, relative to that of the coarsest
    np.testing.assert_allclose(errors[0] / errors[1], (1.0 - own) / (1.0 / 4.0 - own), rtol=0.08)
    np.testing.assert_allclose(errors[1] / errors[2], (1.0 / 4.0 - own) / (1.0 / 16.0 - own), rtol=0.08)


def test_two_masses_respond_as_their_transfer_functions():
    """Motor and load velocity over the torque of a sine, from below the anti-resonance to above the resonance."""
    j1, j2, k, d, viscous = 1e-4, 2e-4, 40.0, 4e-3, 2e-3
    anti, resonance = math.sqrt(k / j2), math.sqrt(k * (1.0 / j1 + 1.0 / j2))
    for omega in (0.4 * anti, anti, math.sqrt(anti * resonance), resonance, 1.6 * resonance):
        omega = 2.0 * math.pi * HZ / (16.0 * round(2.0 * math.pi * HZ / omega / 16.0))  # whole steps in a period
        period = round(2.0 * math.pi * HZ / omega)
        load, still = {"inertia": j2, "stiffness": k, "damping": d}, {"sine": {"amplitude": 0.0, "frequency_hz": 1.0}}
        one = machine(friction=coulomb(0.0, viscous=viscous), loops={"rate_hz": HZ}, load=load, external=still)
        rows, count = [], round(0.6 * HZ / period) * period
        for i in range(count + 2 * period):
            pushed(one, 0.05 * math.sin(omega * (i + 0.5) / HZ))
            one.advance(1)
            if i >= count:
                rows.append((one.true_velocity, one.load_velocity))
        phase = np.exp(-1j * omega * np.arange(count + 1, count + 1 + 2 * period) / HZ)
        found = 2j * np.mean(np.array(rows) * phase[:, None], axis=0) / 0.05
        s = 1j * omega
        coupling = d * s + k
        system = np.array([[j1 * s * s + viscous * s + coupling, -coupling], [-coupling, j2 * s * s + coupling]])
        expected = s * np.linalg.solve(system, [1.0, 0.0])
        np.testing.assert_allclose(found, expected, rtol=0.01, atol=0.003 * np.abs(expected).max())


def test_pendulum_on_an_elastic_shaft_moves_as_in_mujoco():
    """Two bodies in series, the second joint elastic and damped, with gravity: no other part has the same in MuJoCo."""
    j1, j2, k, d, viscous, mass, arm = 1e-2, 2e-2, 60.0, 0.02, 0.03, 0.5, 0.2
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.0005" integrator="RK4" gravity="0 0 -9.81"/>
        <worldbody><body><inertial pos="0 0 0" mass="1e-9" diaginertia="{j1} {j1} {j1}"/>
          <joint type="hinge" axis="0 1 0" damping="{viscous}"/>
          <body><joint type="hinge" axis="0 1 0" stiffness="{k}" damping="{d}"/>
            <inertial pos="0 0 {-arm}" mass="{mass}" diaginertia="{j2} {j2} {j2}"/></body></body></worldbody>
        </mujoco>"""
    )
    data = mujoco.MjData(model)
    data.qpos[0] = 0.9
    load, gravity = {"inertia": j2 + mass * arm**2, "stiffness": k, "damping": d}, {"sine": mass * 9.81 * arm}
    one = machine(0.9, friction=coulomb(0.0, viscous=viscous), inertia=j1, load=load, gravity=gravity)
    pushed(one, 0.2)
    data.qfrc_applied[0] = 0.2
    for _ in range(100):
        one.advance(HZ // 50)
        for _ in range(40):
            mujoco.mj_step(model, data)
        assert one.true_position == pytest.approx(data.qpos[0], abs=2e-5)
        assert one.load_position == pytest.approx(data.qpos[0] + data.qpos[1], abs=2e-5)


STATIC = st.tuples(st.floats(0.0, 0.2), st.floats(0.0, 0.1), st.floats(0.0, 5e-3)).map(
    lambda x: coulomb(x[0], x[0] + x[1], x[2])
)


SLIDING = {"friction": coulomb(), "load_friction": None, "inertia": 1e-3, "ratio": 1.0, "backlash": 0.0}


@example(**SLIDING, resonance_hz=20.0, damping=0.0, hysteresis=0.09375, torques=[0.001953125])
@settings(max_examples=60, deadline=None)
@given(
    friction=STATIC,
    load_friction=st.none() | STATIC,
    inertia=st.floats(5e-5, 1e-3),
    ratio=st.floats(0.2, 5.0),
    resonance_hz=st.floats(20.0, 800.0),
    damping=st.floats(0.0, 0.2),
    backlash=st.sampled_from([0.0, 1e-6, 1e-4, 5e-3, 0.1]),
    hysteresis=st.none() | st.floats(0.01, 0.1),
    torques=st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=8),
)
def test_no_machine_creates_energy(
    friction, load_friction, inertia, ratio, resonance_hz, damping, backlash, hysteresis, torques
):
    """Random masses, couplings and pushes: friction and coupling only ever take energy, and the account closes."""
    reduced = inertia * ratio / (1.0 + ratio)
    stiffness = reduced * (2.0 * math.pi * resonance_hz) ** 2
    coupling = {"stiffness": stiffness, "damping": 2.0 * damping * math.sqrt(stiffness * reduced), "backlash": backlash}
    load = {"inertia": ratio * inertia, **coupling, "friction": load_friction}
    gear = {} if hysteresis is None else {"hysteresis": {"torque": hysteresis, "stiffness": 10.0 * stiffness}}
    one = machine(friction=friction, inertia=inertia, load=load, gear=gear)
    before, scale = one.energy, 1e-12
    for torque in [*torques, 0.0]:
        pushed(one, torque)
        for _ in range(20):
            one.advance(37)
            now = one.energy
            scale = max(scale, abs(now.motor_work), now.stored)
            tiny = (1e-9 if hysteresis is None else 1e-6) * scale
            assert now.friction_heat >= before.friction_heat - 1e-12 * scale
            assert now.load_friction_heat >= before.load_friction_heat - 1e-12 * scale
            assert now.coupling_heat >= before.coupling_heat - tiny
            assert abs(residual(one)) <= 1e-10 * scale
            before = now


@example(name="gms", load_name="gms", ratio=1.0, backlash=0.0, torques=[-0.16796875, 0.125])
@settings(max_examples=25, deadline=None)
@given(
    name=st.sampled_from(["dahl", "lugre", "gms"]),
    load_name=st.sampled_from(["dahl", "lugre", "gms"]),
    ratio=st.floats(0.2, 5.0),
    backlash=st.sampled_from([0.0, 1e-4, 5e-3]),
    torques=st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=6),
)
def test_friction_with_bristles_gives_back_no_more_than_they_hold(name, load_name, ratio, backlash, torques):
    """Heat falls by at most the energy of the deflection at break-away; everything else is lost for good."""
    models = {each: {"model": each, "parameters": dict(describe(each).example)} for each in (name, load_name)}
    load = {"inertia": ratio * 1e-4, "stiffness": 50.0, "damping": 5e-3, "backlash": backlash}
    one = machine(hz=160_000, friction=models[name], load=load | {"friction": models[load_name]})
    most, held = np.zeros(2), []
    for model in (one.config.friction_model, one.config.load_friction_model):
        level = max(model.parameters["coulomb"], model.parameters.get("static", 0.0))
        stiffness = model.parameters.get("stiffness", [model.presliding_stiffness])  # a GMS element holds a share each
        shares = model.parameters.get("weight", [1.0])
        held.append(sum(0.5 * (share * level) ** 2 / each for share, each in zip(shares, stiffness, strict=True)))
    scale = 1e-9
    for torque in [*torques, 0.0]:
        pushed(one, torque)
        for _ in range(40):
            one.advance(41)
            energy = one.energy
            heat = np.array([energy.friction_heat, energy.load_friction_heat])
            scale = max(scale, energy.motor_work)
            assert np.all(heat >= most - 1.05 * np.array(held) - 1e-4 * scale)
            assert abs(residual(one)) <= 1e-10 * scale
            most = np.maximum(most, heat)


def test_an_impact_conserves_momentum_and_energy_exactly_without_damping():
    one = machine(load={"inertia": 2e-4, "stiffness": 1e4, "backlash": 1e-2})
    pushed(one, 0.1)
    one.advance(800)
    pushed(one, 0.0)
    start = one.energy.stored
    momentum = 1e-4 * one.true_velocity + 2e-4 * one.load_velocity
    assert start > 1e-3
    rows = record(one, 0.3, "true_velocity", "load_velocity")
    assert np.count_nonzero(np.diff(np.sign(rows[:, 0] - rows[:, 1]))) > 10
    np.testing.assert_allclose(1e-4 * rows[:, 0] + 2e-4 * rows[:, 1], momentum, rtol=1e-9)
    assert one.energy.stored == pytest.approx(start, rel=1e-9)
    assert one.energy.coupling_heat == pytest.approx(0.0, abs=1e-9 * start)


def swinging(angle, order, swing, spring, hz=HZ, pieces=40):
    """The largest relative change of the energy of an arm whose inertia swings, over half a second."""
    springs = {"spring": {"stiffness": spring}} if spring > 0.01 else {}
    varying = [{"order": order, "sine": swing}]
    one = machine(angle, gravity={"sine": 0.2}, inertia_variation=varying, inertia=1e-4, hz=hz, **springs)
    start = one.energy.stored
    assert start > 1e-3
    stored = record(one, 0.5, "energy", pieces=pieces)[:, 0]
    return max(abs(each.stored / start - 1.0) for each in stored)


@pytest.mark.parametrize(("angle", "order", "swing"), [(2.5, 8.0, 5.235382e-5), (2.0, 5.0, 7.9e-5), (2.8, 8.0, 8e-5)])
def test_half_the_step_leaves_a_quarter_of_the_error_of_a_swinging_arm_at_most(angle, order, swing):
    """The method is of second order, also where the inertia swings by 80 %: at a turn in the midst of its change."""
    errors = [swinging(angle, order, swing, 0.5, hz, pieces=20) for hz in (40_000, 80_000)]
    assert errors[1] < 0.25 * errors[0]
    assert errors[1] < 2e-4


@settings(max_examples=25, deadline=None)
@given(st.floats(0.2, 2.8), st.floats(1.0, 8.0), st.floats(0.0, 8e-5), st.floats(0.0, 0.5))
def test_a_swinging_arm_of_varying_inertia_keeps_its_energy(angle, order, swing, spring):
    assert swinging(angle, order, swing, spring) < 2e-4


def test_stick_slip_is_the_cycle_of_the_phase_plane():
    """A mass pulled by a spring at constant speed: amplitude and period as the exact orbit between stick and slip.

    With a constant level while sliding the orbit in the phase plane is an arc of a circle about the sliding
    equilibrium, and the stick is a straight line (Armstrong-Helouvry, Control of Machines with Friction, 1991, ch. 5).
    The motor, held by a stiff velocity loop, is the end that pulls.
    """
    speed, k, j, level, static = 0.5, 2.0, 1e-3, 0.05, 0.12
    loops = {"velocity_gain": 2000.0, "integral_hz": 50.0}
    load = {"inertia": j, "stiffness": k, "friction": coulomb(level, static)}
    one = machine(inertia=1.0, loops=loops, peak=1e6, load=load)
    rows = []
    for i in range(3000):
        one.command(CSV, speed)
        one.advance(80)
        rows.append((1e-3 * i, one.true_position - one.load_position, one.load_velocity))
    t, twist, velocity = np.array(rows)[1000:].T
    omega = math.sqrt(k / j)
    excess = (static - level) / k  # twist at break-away over that of the equilibrium
    radius = math.hypot(excess, speed / omega)
    slip = (2.0 * math.pi - 2.0 * math.atan2(excess * omega, speed)) / omega
    stick = 2.0 * excess / speed
    begins = t[1:][(velocity[:-1] <= 0.0) & (velocity[1:] > 0.0)]
    assert np.diff(begins) == pytest.approx(slip + stick, rel=0.02)
    assert velocity.max() == pytest.approx(speed + omega * radius, rel=0.01)
    assert twist.max() == pytest.approx(level / k + radius, rel=0.02)


def backlash_cycle(gain, lag):
    """Amplitude over half the gap and frequency at which gain/(s(1 + lag s)) times backlash is -1, or None."""

    def describing(x):  # x: amplitude over half the gap; Slotine and Li, Applied Nonlinear Control, 1991, section 5.2
        beta = 2.0 / x - 1.0
        b = (math.pi / 2.0 - math.asin(beta) - beta * math.sqrt(1.0 - beta * beta)) / math.pi
        return complex(b, -4.0 / math.pi * (1.0 / x - 1.0 / x**2))

    found = None
    for x in np.geomspace(1.001, 100.0, 20000):
        n = describing(x)
        angle = -math.pi - np.angle(n)  # phase that the linear part must have
        lagging = -angle - math.pi / 2.0
        if not 0.0 < lagging < math.pi / 2.0:
            continue
        omega = math.tan(lagging) / lag
        if abs(n) * gain / (omega * math.hypot(1.0, lag * omega)) >= 1.0:
            found = x, omega  # the larger crossing is the stable cycle
    return found


def test_backlash_in_the_position_loop_cycles_as_its_describing_function_says():
    """The encoder is at a light load with friction, which stays where the gap leaves it."""
    gain, lag, gap, inertia = 160.0, 0.05, 0.02, 1e-2
    predicted = backlash_cycle(gain, lag)
    loops = {"rate_hz": HZ, "position_gain": gain, "velocity_gain": inertia / lag, "integral_hz": 0.0}
    loops |= {"velocity_filter_hz": 20_000.0, "inertia_feedforward": 0.0}
    load = {"inertia": 2e-6, "stiffness": 20.0, "damping": 5e-3, "backlash": gap, "friction": coulomb(0.002)}
    one = machine(inertia=inertia, loops=loops, encoder={"at": "both", "counts": 1e9}, load=load)
    one.command(CSP, 0.0)
    pushed(one, 0.5)
    one.advance(8000)
    one.command(CSP, 0.0)
    rows = []
    for i in range(6000):
        one.command(CSP, 0.0)
        one.advance(80)
        rows.append((1e-3 * i, one.true_position))
    t, position = np.array(rows)[3000:].T
    crossings = t[1:][(position[:-1] < 0.0) & (position[1:] >= 0.0)]
    assert len(crossings) > 5
    amplitude = 0.5 * np.ptp(position) / (0.5 * gap)
    frequency = 2.0 * math.pi / np.mean(np.diff(crossings))
    assert amplitude == pytest.approx(predicted[0], rel=0.15)
    assert frequency == pytest.approx(predicted[1], rel=0.1)


def test_an_external_torque_is_the_sine_and_the_steps_that_are_given():
    one = machine(external={"steps": [{"time_s": 0.01, "torque": -0.02}, {"time_s": 0.03, "torque": 0.0}]})
    one.advance(4 * HZ // 100)
    assert one.true_velocity == pytest.approx(0.02 * 0.02 / 1e-4, rel=1e-3)
    one = machine(external={"sine": {"amplitude": -0.02, "frequency_hz": 10.0}})
    one.advance(HZ // 20)  # half a period
    assert one.true_velocity == pytest.approx(2.0 * 0.02 / (2.0 * math.pi * 10.0) / 1e-4, rel=1e-3)


def test_an_external_torque_is_read_from_a_file(tmp_path: Path):
    path = tmp_path / "force.txt"
    path.write_text("# time, torque\n0.00, 0.0\n0.02 -0.04\n\n0.04,0\n")
    assert read_table(path) == [(0.0, 0.0), (0.02, -0.04), (0.04, 0.0)]
    mechanics = {"inertia": 1e-4, "external": {"file": str(path)}}
    config = ServoConfig.model_validate({"mechanics": mechanics, "friction": FREE})
    one = simulated_servo(config)
    one.advance(4 * HZ // 100)
    assert one.true_velocity == pytest.approx(0.04 * 0.02 / 1e-4, rel=1e-3)
    with pytest.raises(UsageError, match=r"content of .*force.txt is missing"):
        Servo(config)
    for content, words in (
        ("0 0\n1 nan\n", ":2: "),
        ("0 0\n0 1\n", ":2: .*0 s"),
        ("0 0 0\n", ":1: "),
        ("# \n", "no rows"),
    ):
        path.write_text(content)
        with pytest.raises(UsageError, match=words):
            simulated_servo(config)
    path.unlink()
    with pytest.raises(UsageError, match=r"cannot be read: No such file"):
        simulated_servo(config)


@pytest.mark.parametrize("has_load", [False, True])
def test_gear_losses_are_those_of_the_efficiencies(has_load):
    """Torque that just lifts and that just lowers a weight, and a worm gear that holds it alone."""
    weight, forward, backward = 0.1, 0.6, 0.4
    load = {"load": {"inertia": 1e-4, "stiffness": 100.0, "damping": 0.02}} if has_load else {}

    def settled(torque, efficiency=backward):
        gear = {"forward_efficiency": forward, "backward_efficiency": efficiency}
        one = pushed(machine(friction=coulomb(0.0), gear=gear, load_torque=weight, **load), torque)
        one.advance(HZ // 2)
        return one.true_velocity

    assert settled(weight / forward * 1.02) > 1.0
    assert settled(weight * backward * 0.98) < -1.0
    for torque in (weight / forward * 0.98, weight * backward * 1.02):
        assert settled(torque) == pytest.approx(0.0, abs=1e-6), torque
    assert settled(0.0, efficiency=-0.1) == pytest.approx(0.0, abs=1e-6)


def test_a_transmission_error_moves_the_load_by_its_harmonics():
    error = [{"order": 2, "cosine": 1e-3, "sine": 2e-3}]
    load = {"inertia": 1e-5, "stiffness": 500.0, "damping": 0.05}
    one = machine(friction=coulomb(0.0, viscous=0.05), load=load, gear={"transmission_error": error})
    pushed(one, 0.02)
    for _ in range(50):
        one.advance(HZ // 10)
        q = one.true_position
        expected = 1e-3 * math.cos(2.0 * q) + 2e-3 * math.sin(2.0 * q)
        assert one.load_position - q == pytest.approx(expected, abs=3e-5)


def test_gear_hysteresis_lags_the_twist_by_its_torque():
    """Wound up and let go on a held motor: friction inside the gear keeps a part of the twist."""
    load = {"inertia": 1e-4, "stiffness": 20.0, "damping": 0.2}
    one = machine(friction=coulomb(10.0), load_torque=0.2, load=load)
    steps = [{"time_s": 0.1, "torque": 0.2}, {"time_s": 0.4, "torque": 0.0}]
    gear = {"hysteresis": {"torque": 0.05, "stiffness": 200.0}}
    other = machine(friction=coulomb(10.0), load=load, gear=gear, external={"steps": steps})
    one.advance(HZ)
    assert one.load_position == pytest.approx(-0.2 / 20.0, rel=1e-3)
    other.advance(2 * HZ // 5)
    assert -0.2 / 20.0 < other.load_position <= -0.15 / 20.0 * 0.99
    other.advance(HZ)
    assert -0.05 / 20.0 < other.load_position < -1e-5


def test_the_load_sticks_up_to_its_own_break_away():
    load = {"inertia": 1e-4, "stiffness": 50.0, "damping": 0.15, "friction": coulomb(0.08, 0.12)}
    one = machine(load=load)
    for k in range(101):
        pushed(one, 0.119 * k / 100)
        one.advance(HZ // 200)
    assert one.load_position == 0.0
    assert one.true_position == pytest.approx(0.119 / 50.0, rel=0.01)
    one = pushed(machine(load=load), 0.2)
    one.advance(HZ // 10)
    assert one.load_velocity == pytest.approx((0.2 - 0.08) / 2e-4 * 0.1, rel=0.05)


def test_a_brake_holds_the_motor_and_the_load_hangs_on_the_coupling():
    load = {"inertia": 1e-4, "stiffness": 50.0, "damping": 0.02, "backlash": 4e-3}
    one = machine(has_brake=True, load_torque=0.1, load=load)
    one.advance(HZ)
    assert one.true_position == 0.0
    assert one.load_position == pytest.approx(-0.1 / 50.0 - 2e-3, rel=1e-3)
    assert one.position == 0.0


@pytest.mark.parametrize(("at", "is_load"), [("motor", False), ("load", True), ("both", True)])
def test_the_encoder_is_where_the_configuration_puts_it(at, is_load):
    encoder = {"at": at, "counts": 1e6} | ({"load_counts": 4096} if at == "both" else {})
    load = {"inertia": 1e-4, "stiffness": 2.0, "damping": 5e-3}
    one = pushed(machine(0.5, encoder=encoder, load=load), 0.1)
    one.advance(HZ // 100)
    where = one.load_position if is_load else one.true_position
    resolution = 2.0 * math.pi / (4096 if at == "both" else 1e6)
    assert abs(one.true_position - one.load_position) > 2.0 * 2.0 * math.pi / 4096
    assert 0.0 <= where - one.position < resolution
    rate = one.load_velocity if at == "load" else one.true_velocity
    assert one.velocity == pytest.approx(rate, rel=0.15)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"encoder": {"at": "load"}}, "encoder.at: load or both needs mechanics.load"),
        ({"gear": {"hysteresis": {"torque": 1, "stiffness": 1}}}, "gear.hysteresis needs mechanics.load"),
        ({"encoder": {"at": "load", "load_counts": 100}}, "counts is that one's"),
        ({"mechanics": {"axis": "linear", "gravity": {"sine": 1.0}}}, "load_torque"),
        ({"mechanics": {"inertia_variation": [{"order": 1, "sine": 1.0}]}}, "negative somewhere"),
        ({"mechanics": {"load": {"inertia": 1e-4}}}, "mechanics.load.stiffness"),
        ({"mechanics": {"load": {"inertia": 1e-4, "stiffness": math.nan}}}, "finite number"),
        ({"mechanics": {"load": {"inertia": 1e-7, "stiffness": 1e4}}}, "too slow for this friction and inertia"),
        ({"gear": {"forward_efficiency": 0.5}, "friction": {"modifiers": {"load": {"motoring": 0.1}}}}, "same losses"),
        ({"mechanics": {"external": {"steps": [{"time_s": 1, "torque": 0}] * 2}}}, "times of steps must rise"),
    ],
)
def test_a_machine_that_cannot_be_is_refused(parts, words):
    with pytest.raises(ValidationError, match=words):
        ServoConfig.model_validate(parts)
