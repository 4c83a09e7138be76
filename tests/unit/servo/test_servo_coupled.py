"""Two simulated servos on one mechanism, compared with closed forms, single servos and MuJoCo."""

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from friction_hil.config.simulation import Mechanism
from friction_hil.errors import UsageError
from friction_hil.friction import describe
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.coupled_servos import CoupledServos
from friction_hil.servo.servo import Servo
from tests.unit.servo.test_servo_machine import coulomb

OFF, CSP, CST = 0, 8, 10
HZ = 80_000
GANTRY = {
    "kind": "gantry",
    "axes": ["a", "b"],
    "span": 1.2,
    "beam": {"mass": 30.0, "inertia": 4.0},
    "payload": {"mass": 10.0, "position": 0.3},
    "yaw_stiffness": 2e5,
}
ARM = {
    "kind": "two_link_arm",
    "axes": ["a", "b"],
    "links": [
        {"length": 0.4, "mass": 3.0, "center": 0.18, "inertia": 0.05},
        {"length": 0.3, "mass": 1.5, "center": 0.12, "inertia": 0.015},
    ],
    "payload": 0.5,
}
LUGRE = {"model": "lugre", "parameters": dict(describe("lugre").example)}
ROTORS = 0.08, 0.03


def servo(inertia, friction, axis, hz=HZ, *, brake=False, **parts):
    """A servo whose torque acts at once."""
    mechanics = {"axis": axis, "inertia": inertia, "has_brake": brake, **parts.pop("mechanics", {})}
    motor = {"torque_lag_s": 0.0, "peak_torque": 1e5}
    return ServoConfig.model_validate(
        {"mechanics": mechanics, "friction": friction, "motor": motor, "integration_hz": hz, **parts}
    )


def couple(mechanism, *positions, inertias=ROTORS, friction=None, hz=HZ, **parts):
    axis = "linear" if mechanism["kind"] == "gantry" else "rotary"
    configs = [servo(each, friction or coulomb(), axis, hz, **parts) for each in inertias]
    return CoupledServos(TypeAdapter(Mechanism).validate_python(mechanism), configs, positions or (0.0, 0.0))


def push(both, *torques):
    for one, torque in zip(both.servos, torques, strict=True):
        one.command(CST, torque)


def positions(both):
    return np.array([one.true_position for one in both.servos])


def velocities(both):
    return np.array([one.true_velocity for one in both.servos])


def residual(both, at_start):
    """What is missing in the energy balance, J."""
    e = both.energy
    return e.stored - at_start - (e.motor_work + e.load_work - e.friction_heat - e.coupling_heat)


def test_a_gantry_translates_as_one_mass():
    """Pushed evenly through its centre of mass, it gains F t / m and does not yaw."""
    both = couple({**GANTRY, "payload": {"mass": 10.0, "position": 0.0}}, inertias=(5.0, 5.0))
    push(both, 25.0, 25.0)
    both.advance(HZ // 2)
    assert velocities(both) == pytest.approx([0.5 * 50.0 / 50.0] * 2, rel=1e-9)
    assert both.tool == pytest.approx([0.125, 0.0], rel=1e-9, abs=1e-15)


def test_a_gantry_yaws_at_the_frequency_of_guides_and_inertia():
    """Released from a yaw, with the payload off its middle and unequal motors: two modes, one of them rigid."""
    span, (j1, j2) = GANTRY["span"], (6.0, 4.0)
    start = 1e-4
    both = couple(GANTRY, -start, start, inertias=(j1, j2))
    push(both, 0.0, 0.0)
    # in translation and yaw, about the middle
    mass, moment = 30.0 + 10.0 + j1 + j2, 10.0 * 0.3 + 0.5 * span * (j2 - j1)
    inertia = 4.0 + 10.0 * 0.09 + 0.25 * span**2 * (j1 + j2)
    omega = math.sqrt(GANTRY["yaw_stiffness"] / (inertia - moment**2 / mass))
    centre = moment / mass
    for k in range(1, 200):
        both.advance(HZ // 2000)
        q1, q2 = positions(both)
        yaw = (q2 - q1) / span
        assert yaw == pytest.approx(2.0 * start / span * math.cos(omega * k / 2000), abs=2e-4 * start)
        assert 0.5 * (q1 + q2) + centre * yaw == pytest.approx(centre * 2.0 * start / span, abs=1e-12)


def test_the_yaw_decays_with_the_damping_of_the_guides():
    gantry = {**GANTRY, "payload": {"mass": 0.0}, "yaw_damping": 300.0}
    both = couple(gantry, -1e-4, 1e-4, inertias=(5.0, 5.0))
    push(both, 0.0, 0.0)
    inertia = 4.0 + 0.5 * 1.2**2 * 5.0
    rate = 0.5 * 300.0 / inertia
    before = both.energy.stored
    both.advance(HZ // 10)
    period = round(HZ * 2.0 * math.pi / math.sqrt(2e5 / inertia - rate**2))
    peaks = []
    for _ in range(3):
        record = []
        for _ in range(period):
            both.advance(1)
            record.append(abs(positions(both)[1]))
        peaks.append(max(record))
    assert math.log(peaks[0] / peaks[2]) == pytest.approx(2 * period / HZ * rate, rel=1e-2)
    assert residual(both, before) == pytest.approx(0.0, abs=1e-12 * before)
    assert both.energy.coupling_heat > 0.9 * before * (1.0 - math.exp(-2 * rate * 0.1))


@pytest.mark.parametrize("friction", [LUGRE, coulomb(0.08, 0.12, 2e-3)])
def test_a_gantry_of_two_separate_masses_is_two_single_servos(friction):
    """The mass in the ends of the beam and no stiffness: nothing is left to couple."""
    # dyadic, so that the off-diagonal inertia is exactly zero
    gantry = {"kind": "gantry", "axes": ["a", "b"], "span": 2.0, "beam": {"mass": 2.0**-11, "inertia": 2.0**-11}}

    def one_of(inertia, **parts):
        mechanics = {"axis": "linear", "inertia": inertia, **parts}
        return ServoConfig.model_validate({"integration_hz": HZ, "friction": friction, "mechanics": mechanics})

    inertias, share = (2e-4, 3e-4), 2.0**-12
    both = CoupledServos(TypeAdapter(Mechanism).validate_python(gantry), [one_of(each) for each in inertias])
    single = [Servo(one_of(each + share, spring={"stiffness": 1e-12})) for each in inertias]
    for k in range(800):
        for axes in (both.servos, single):
            for sign, one in zip((1.0, -0.7), axes, strict=True):
                one.command(CSP, sign * 0.3 * math.sin(4e-3 * math.pi * k))
        both.advance(80)
        for one, alone in zip(both.servos, single, strict=True):
            alone.advance(80)
            assert one.true_position == pytest.approx(alone.true_position, abs=1e-9)
            assert one.position_demand == alone.position_demand


def test_a_two_link_arm_moves_as_in_mujoco():
    """Gravity, Coriolis and centrifugal forces, rotors, viscous joints and a load at the tool, for two seconds."""
    first, second = ARM["links"]
    viscous = 0.05
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.0005" integrator="RK4" gravity="0 0 -9.81"/>
        <worldbody><body>
          <joint type="hinge" axis="0 -1 0" damping="{viscous}" armature="{ROTORS[0]}"/>
          <inertial pos="0 0 {-first["center"]}" mass="{first["mass"]}" diaginertia="1 {first["inertia"]} 1"/>
          <body pos="0 0 {-first["length"]}">
            <joint type="hinge" axis="0 -1 0" damping="{viscous}" armature="{ROTORS[1]}"/>
            <inertial pos="0 0 {-second["center"]}" mass="{second["mass"]}" diaginertia="1 {second["inertia"]} 1"/>
            <body pos="0 0 {-second["length"]}">
              <inertial pos="0 0 0" mass="{ARM["payload"]}" diaginertia="1e-9 1e-9 1e-9"/></body>
          </body></body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    data.qpos[:] = 1.4, -0.9
    both = couple(ARM, 1.4, -0.9, friction=coulomb(viscous=viscous))
    push(both, 3.0, -1.0)
    data.qfrc_applied[:] = 3.0, -1.0
    fastest = 0.0
    for _ in range(100):
        both.advance(HZ // 50)
        for _ in range(40):
            mujoco.mj_step(model, data)
        assert positions(both) == pytest.approx(data.qpos, abs=2e-6)
        assert velocities(both) == pytest.approx(data.qvel, abs=2e-5)
        fastest = max(fastest, np.abs(velocities(both)).max())
    assert fastest > 5.0  # Coriolis and centrifugal forces mattered
    tip = data.xpos[-1]
    assert both.tool == pytest.approx((tip[0], tip[2]), abs=2e-6)


def test_the_arm_is_integrated_to_second_order():
    courses = []
    for factor in (1, 2, 4, 16):
        both = couple(ARM, 1.4, -0.9, friction=coulomb(viscous=0.05), hz=24_000 * factor)
        push(both, 3.0, -1.0)
        rows = []
        for _ in range(20):
            both.advance(600 * factor)
            rows.append([*positions(both), *velocities(both)])
        courses.append(np.array(rows))
    errors = [np.sqrt(np.mean((course - courses[-1]) ** 2, axis=0)) for course in courses[:-1]]
    own = 1.0 / 16.0**2  # error of the finest, relative to that of the coarsest
    np.testing.assert_allclose(errors[0] / errors[1], (1.0 - own) / (1.0 / 4.0 - own), rtol=0.05)
    np.testing.assert_allclose(errors[1] / errors[2], (1.0 / 4.0 - own) / (1.0 / 16.0 - own), rtol=0.05)


def test_a_force_at_the_tool_is_balanced_by_the_transposed_jacobian():
    """In a horizontal plane nothing moves while the motors take the force; then it does work."""
    q1, q2, x, y = 0.7, -1.1, 12.0, -5.0
    force = [{"time_s": 0.0, "x": x, "y": y}, {"time_s": 0.1, "x": 0.0, "y": 0.0}]
    both = couple({**ARM, "gravity": 0.0, "tool_force": force}, q1, q2)
    l1, l2 = (link["length"] for link in ARM["links"])
    second = l2 * (x * math.cos(q1 + q2) + y * math.sin(q1 + q2))
    push(both, -l1 * (x * math.cos(q1) + y * math.sin(q1)) - second, -second)
    both.advance(HZ // 10)
    assert positions(both) == pytest.approx([q1, q2], abs=1e-12)
    start = both.energy.stored
    both = couple({**ARM, "gravity": 0.0, "tool_force": force}, q1, q2)
    push(both, 0.0, 0.0)
    at = np.array(both.tool)
    both.advance(HZ // 10)
    moved = np.array(both.tool) - at
    assert both.energy.load_work == pytest.approx(moved @ (x, y), rel=1e-6)
    assert residual(both, start) == pytest.approx(0.0, abs=1e-12)


def test_static_friction_holds_a_joint_until_the_reaction_of_the_other_breaks_it_away():
    arm = {**ARM, "gravity": 0.0}
    stiff, weak = coulomb(2.0, 2.5), coulomb()
    mechanism = TypeAdapter(Mechanism).validate_python(arm)

    def pushed(torque):
        both = CoupledServos(mechanism, [servo(0.08, stiff, "rotary"), servo(0.03, weak, "rotary")], (0.0, 0.4))
        push(both, 0.0, torque)
        both.advance(HZ // 500)
        return both

    # held, the shoulder takes M12 times the acceleration of the elbow
    k = mechanism.links[1]
    elbow = k.inertia + k.mass * k.center**2 + 0.5 * k.length**2
    swing = 0.4 * (k.mass * k.center + 0.5 * k.length) * math.cos(0.4)
    breakaway = 2.5 * (elbow + 0.03) / (elbow + swing)
    held = pushed(0.98 * breakaway)
    assert held.servos[0].true_position == 0.0
    assert held.servos[1].true_velocity > 0.0
    assert pushed(1.02 * breakaway).servos[0].true_velocity < 0.0


@pytest.mark.parametrize("brake", [True, False])
def test_an_arm_under_gravity_is_held_by_its_brakes_and_falls_without_power(brake):
    both = couple(ARM, 1.2, 0.3, brake=brake)
    both.advance(HZ // 20)
    assert [one.true_position == at for one, at in zip(both.servos, (1.2, 0.3), strict=True)] == [brake, brake]


LINKS = st.fixed_dictionaries(
    {"length": st.floats(0.1, 1.0), "mass": st.floats(0.1, 10.0)}
    | {"center": st.floats(-0.3, 1.0), "inertia": st.floats(0.0, 0.5)}
)
ARMS = st.fixed_dictionaries(
    {
        **{"kind": st.just("two_link_arm"), "axes": st.just(["a", "b"]), "links": st.tuples(LINKS, LINKS).map(list)},
        "payload": st.floats(0.0, 5.0),
        "gravity": st.sampled_from([0.0, 9.81]),
        "tool_force": st.just([]) | st.floats(-20.0, 20.0).map(lambda x: [{"time_s": 0.01, "x": x, "y": -0.5 * x}]),
    }
)
GANTRIES = st.fixed_dictionaries(
    {
        **{"kind": st.just("gantry"), "axes": st.just(["a", "b"]), "span": st.floats(0.3, 3.0)},
        "beam": st.fixed_dictionaries({"mass": st.floats(1.0, 100.0), "inertia": st.floats(0.0, 50.0)}),
        "payload": st.fixed_dictionaries({"mass": st.floats(0.0, 50.0), "position": st.floats(-0.6, 0.6)}),
        "yaw_stiffness": st.just(0.0) | st.floats(1e2, 1e7),
        "yaw_damping": st.floats(0.0, 1e3),
    }
).map(lambda one: one | {"payload": {**one["payload"], "position": one["payload"]["position"] * one["span"]}})


def potential(mechanism):
    """Return the largest potential of an arm, J, in which differences are lost to rounding; 0 for a gantry."""
    links = mechanism.get("links", ())
    reach = sum(link["length"] + link["center"] for link in links)
    mass = sum(link["mass"] for link in links)
    return mechanism["gravity"] * reach * (mass + mechanism["payload"]) if links else 0.0


@settings(max_examples=60, deadline=None)
@given(
    mechanism=ARMS | GANTRIES,
    start=st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)),
    inertias=st.tuples(st.floats(1e-3, 0.5), st.floats(1e-3, 0.5)),
    levels=st.tuples(st.floats(0.0, 5.0), st.floats(0.0, 3.0), st.floats(0.0, 0.5)),
    torques=st.lists(st.tuples(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0)), min_size=1, max_size=6),
)
def test_no_mechanism_creates_energy(mechanism, start, inertias, levels, torques):
    """Random arms, gantries, frictions and pushes: the account closes to rounding, and heat is never negative."""
    friction = coulomb(levels[0], levels[0] + levels[1], levels[2])
    if mechanism["kind"] == "gantry":  # near 0, where a small yaw is not lost in the rounding of the positions
        start = (0.0, 1e-3 * start[1])
    both = couple(mechanism, *start, inertias=inertias, friction=friction)
    before = at_start = both.energy
    scale = abs(at_start.stored) + 1e-6
    rounding = 4.0 * np.finfo(float).eps * potential(mechanism)
    for pair in torques:
        push(both, *pair)
        both.advance(1200)
        now = both.energy
        assert now.friction_heat >= before.friction_heat - 1e-12 * scale
        assert now.coupling_heat >= before.coupling_heat - 1e-12 * scale
        exchanged = abs(now.motor_work) + abs(now.load_work) + now.friction_heat + now.coupling_heat
        scale = max(scale, abs(now.stored), exchanged)
        assert abs(residual(both, at_start.stored)) < 1e-9 * scale + rounding
        before = now


@pytest.mark.parametrize("mechanism", [ARM, GANTRY], ids=lambda each: each["kind"])
def test_the_order_in_which_the_axes_are_served_makes_no_difference(mechanism):
    """To the bit; a servo that is behind catches up without moving anything."""
    sets = [couple(mechanism, inertias=(2.0, 2.0), friction=LUGRE) for _ in range(3)]
    for k in range(40):
        for both in sets:
            for one in both.servos:
                one.command(CSP, 1e-4 * k)
        sets[0].advance(80)
        for one in reversed(sets[1].servos):
            one.advance(80)
        sets[2].servos[k % 2].advance(50)
        sets[2].servos[1 - k % 2].advance(80)
        sets[2].servos[k % 2].advance(30)
        for both in sets[1:]:
            for one, other in zip(both.servos, sets[0].servos, strict=True):
                assert one.records[2].tobytes() == other.records[2].tobytes()
    assert positions(sets[0])[0] > 1e-3


def test_the_drives_feed_the_inertia_of_the_mechanism_forward():
    gantry = couple(GANTRY, inertias=(5.0, 5.0))
    assert [one.total_inertia for one in gantry.servos] == pytest.approx([5.0 + 17.5, 5.0 + 22.5])
    arm = couple(ARM)
    elbow = 0.015 + 1.5 * 0.12**2 + 0.5 * 0.3**2
    shoulder = 0.05 + 3.0 * 0.18**2 + 2.0 * 0.4**2 + elbow
    assert [one.total_inertia for one in arm.servos] == pytest.approx([0.08 + shoulder, 0.03 + elbow])
    assert arm.servos[0].records[1][0]["inertia"] == arm.servos[0].total_inertia
    with pytest.raises(UsageError, match=r"ask CoupledServos\.energy"):
        _ = arm.servos[0].energy


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"mechanics": {"axis": "linear"}}, "a: mechanics.axis must be rotary"),
        ({"mechanics": {"load": {"inertia": 1.0, "stiffness": 10.0}}}, "a: mechanics.load is not for an axis of"),
        ({"mechanics": {"inertia_variation": [{"order": 1, "sine": 1e-3}]}}, "a: mechanics.inertia_variation is not"),
        ({"hz": 160_000}, "a and b need the same integration_hz"),
    ],
)
def test_servos_that_do_not_go_with_a_mechanism_are_refused(parts, words):
    mechanism = TypeAdapter(Mechanism).validate_python(ARM)
    with pytest.raises(UsageError, match=words):
        CoupledServos(mechanism, [servo(0.1, coulomb(), "rotary", **parts), servo(0.1, coulomb(), "rotary")])


@pytest.mark.parametrize(
    ("mechanism", "words"),
    [
        ({**GANTRY, "axes": ["a", "a"]}, "two different axes"),
        ({**GANTRY, "span": 0.0}, "greater than 0"),
        ({**GANTRY, "yaw_stiffness": math.inf}, "finite"),
        ({**GANTRY, "links": []}, "not permitted"),
        ({**ARM, "links": ARM["links"][:1]}, "links"),
        ({**ARM, "gravity": math.nan}, "finite"),
        ({**ARM, "tool_force": [{"time_s": 1.0}, {"time_s": 1.0}]}, "must rise"),
        ({**ARM, "kind": "scara"}, "two_link_arm"),
    ],
)
def test_mechanisms_that_cannot_be_are_refused(mechanism, words):
    with pytest.raises(ValidationError, match=words):
        TypeAdapter(Mechanism).validate_python(mechanism)
