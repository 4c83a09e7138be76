"""What a hand feels of a simulated joint, and whether it rests alone: laws in use today, and `fh.Compensator`."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import click
import numpy as np

import friction_hil as fh
from friction_hil.cli.options import option_json
from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import new_table, number, print_table, prose
from friction_hil.config import from_dict
from friction_hil.numerics.jit import Array
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo
from tools.benchmarks.report import machine, rounds

PARAMETERS = {"sigma0": 400.0, "sigma1": 1.5, "sigma2": 0.04, "coulomb": 0.45, "static": 0.6, "stribeck_velocity": 0.15}
FRICTION = {"model": "lugre", "parameters": PARAMETERS}
GAIN = 0.9  # of all laws: the share of the friction that they know
TANH_RATE = 19.4  # s/rad, as openarm_teleop has for its first joint
GRAVITY_ERROR = 0.1  # N m, that a gravity model leaves
INERTIA, STIFFNESS = 0.02, 20.0  # of the joint, kg m^2; of the hand, N m/rad
STEP_S = 5e-4  # between two values of the hand's torque
CST = 10
PERIODS_S = (1e-3, 4e-3)
SETTINGS: dict[str, dict[str, Any]] = {  # of `compensation` in a configuration
    "fh.Compensator": {},
    "smoothing: 0.2": {"smoothing": 0.2},
    "velocity: drive": {"velocity": "drive"},
}
LAWS = ("none", "c*sign(dq)", "c*tanh(k*dq)", *SETTINGS)

Law = Callable[[float, float], float]  # of what the joint reports, q and dq
Lead = Callable[[float], tuple[float, float] | None]  # the hand's place and speed at a time; None: it has let go


def as_code(value: float, most: float, bits: int) -> float:
    """Return a value as a frame in MIT mode carries it: cut down to a code of some bits over -most to most."""
    codes = (1 << bits) - 1
    return math.floor((value + most) / (2.0 * most) * codes) / codes * 2.0 * most - most


def _in_mit_mode(q: float, dq: float) -> tuple[float, float]:
    return as_code(q, 12.5, 16), as_code(dq, 30.0, 12)  # ranges of a DM4310


def _as_it_is(q: float, dq: float) -> tuple[float, float]:
    return q, dq


@dataclass(frozen=True)
class Feedback:
    """How a joint reports its motion."""

    counts: int  # of the encoder, a turn
    resolution: float  # of the position that is reported, rad
    reported: Callable[[float, float], tuple[float, float]]


FEEDBACKS = {
    "20 bits": Feedback(2**20, math.tau / 2**20, _as_it_is),
    "MIT, 12 bits": Feedback(2**14, 25.0 / (2**16 - 1), _in_mit_mode),
}


@dataclass(frozen=True)
class Run:
    """What joint and hand did, by steps of the hand, (n,)."""

    t: Array
    position: Array
    way: Array  # in the step
    hand: Array  # torque
    compensation: Array  # torque

    def work(self, torque: Array, since: float, until: float = math.inf) -> float:
        """Work of a torque on the joint between two times, J."""
        return float(np.sum((torque * self.way)[(self.t >= since) & (self.t < until)]))

    def at(self, t: float) -> int:
        """Return the first step from a time on."""
        return int(np.searchsorted(self.t, t))


def make_law(name: str, feedback: Feedback, period_s: float, gain: float = GAIN) -> Law:
    """Return a law by its name in `LAWS`."""
    c = gain * PARAMETERS["coulomb"]
    if name == "none":
        return lambda q, dq: 0.0
    if name == "c*sign(dq)":
        return lambda q, dq: math.copysign(c, dq) if dq else 0.0
    if name == "c*tanh(k*dq)":
        return lambda q, dq: c * math.tanh(TANH_RATE * dq)
    joint = {
        "position_resolution": feedback.resolution,
        "limits": {"torque": 1.5, "velocity": 20.0},
        "model": {"axis": "rotary", "friction": FRICTION},
        "compensation": {"gain": gain, **SETTINGS[name]},
    }
    values = {"version": 1, "period_s": period_s, "axes": {"joint": joint}}
    comp = fh.Compensator(from_dict(values, "guiding"), record_s=0.0)

    def step(q: float, dq: float) -> float:
        torque = comp.step(np.array([q]), np.array([dq]), dt=period_s)
        if comp.fault:
            raise AssertionError(comp.fault)
        return float(torque[0])

    return step


def guide(law: Law, feedback: Feedback, period_s: float, lead: Lead, duration_s: float, weight: float = 0.0) -> Run:
    """Move a joint by a hand, a damped spring between its place and the joint; the law acts half a period late.

    ``weight``: torque against positive motion that nothing compensates, N m.
    """
    values: dict[str, Any] = {"mechanics": {"inertia": INERTIA}, "friction": FRICTION}
    values |= {"motor": {"rated_torque": 5.0, "peak_torque": 15.0}, "encoder": {"counts": feedback.counts}}
    joint = Servo(ServoConfig.model_validate(values))
    plant = joint.records[0]
    damping = 1.4 * math.sqrt(STIFFNESS * INERTIA)
    steps, parts = round(STEP_S * joint.steps_per_second), round(period_s / STEP_S)
    rows, computed = [], 0.0
    for k in range(round(duration_s / STEP_S)):
        if k % parts == 0:
            acting, computed = computed, law(*feedback.reported(joint.position, joint.velocity))
        if k % parts == parts // 2:
            acting = computed
        t, q = k * STEP_S, joint.true_position
        at = lead(t)
        hand = 0.0 if at is None else STIFFNESS * (at[0] - q) + damping * (at[1] - joint.true_velocity)
        plant["load_torque"] = weight - hand
        joint.command(CST, acting)
        joint.advance(steps)
        rows.append((t, q, joint.true_position - q, hand, acting))
    return Run(*np.array(rows).T)


def swing(amplitude: float, frequency_hz: float, until: float = math.inf, *, holds: bool = False) -> Lead:
    """To and fro, and from a time on the hand holds still or has let go."""
    rate = math.tau * frequency_hz

    def lead(t: float) -> tuple[float, float] | None:
        if t >= until:
            return (amplitude * (1.0 - math.cos(rate * until)), 0.0) if holds else None
        return amplitude * (1.0 - math.cos(rate * t)), amplitude * rate * math.sin(rate * t)

    return lead


def push(direction: float) -> Lead:
    """A hand that waits, and then pulls by one N m/s."""
    speed = direction / STIFFNESS
    return lambda t: (speed * max(t - 0.7, 0.0), speed if t > 0.7 else 0.0)


@dataclass(frozen=True)
class Figures:
    """What a hand finds."""

    feedback: str
    period_s: float
    law: str
    break_away: float  # largest torque of the hand from rest until the joint has moved by 20 mrad, N m
    turn: float  # largest torque of the hand in a guided motion, N m
    work: float  # of the hand in a cycle of it, J
    step: float  # largest change of the compensation from cycle to cycle in it, N m
    drift: float  # range of the position from 1 to 2 s after the hand has let go at a turn, rad
    pushing: float  # energy that a hand which holds the joint still has to take from it in a second, J
    travel: float  # in 2 s after the hand has let go in motion, with a `GRAVITY_ERROR`, rad


def measure(law: str, feedback: str, period_s: float, gain: float = GAIN) -> Figures:
    """Return the figures of a law."""

    def run(lead: Lead, duration_s: float, weight: float = 0.0) -> Run:
        kind = FEEDBACKS[feedback]
        return guide(make_law(law, kind, period_s, gain), kind, period_s, lead, duration_s, weight)

    break_away = 0.0
    for pushed in (run(push(1.0), 2.0), run(push(-1.0), 2.0)):
        end = int(np.argmax(np.abs(pushed.position) > 0.02))
        break_away = max(break_away, float(np.abs(pushed.hand[: end or None]).max()))
    guided = run(swing(0.15, 0.5, 4.0), 6.0)
    held = run(swing(0.15, 0.5, 1.8, holds=True), 4.0)
    fallen = run(swing(0.15, 0.5, 1.8), 3.8, GRAVITY_ERROR)
    led = slice(guided.at(2.0), guided.at(4.0))
    return Figures(
        feedback,
        period_s,
        law,
        break_away,
        float(np.abs(guided.hand[led]).max()),
        guided.work(guided.hand, 2.0, 4.0),
        float(np.abs(np.diff(guided.compensation[led])).max()),
        float(np.ptp(guided.position[guided.at(5.0) :])),
        max(0.0, -held.work(held.hand, 3.0)),
        float(abs(fallen.position[-1] - fallen.position[fallen.at(1.8)])),
    )


@click.command("guiding")
@click.option("--gain", default=GAIN, show_default=True, help="Share of the friction that is compensated.")
@option_json
def command(gain: float, as_json: bool) -> None:
    """Print what a hand finds of a joint with each law."""
    cases = [(law, feedback, period_s) for feedback in FEEDBACKS for period_s in PERIODS_S for law in LAWS]
    found = [measure(*cases[k], gain) for k in rounds(len(cases), "laws")]
    if as_json:
        print_json({"machine": machine(), "gain": gain, "rows": [asdict(each) for each in found]})
        return
    columns = ("break-away\nN m", "most\nN m", "work\nmJ", "step\nN m", "drift\nmrad", "pushes\nmJ/s", "travel\nmrad")
    table = new_table(prose("feedback"), number("Hz"), prose("law"), *map(number, columns))
    for each in found:
        torques = (f"{each.break_away:.2f}", f"{each.turn:.2f}", f"{1e3 * each.work:.0f}", f"{each.step:.2f}")
        rest = (f"{1e3 * each.drift:.2f}", f"{1e3 * each.pushing:.2f}", f"{1e3 * each.travel:.0f}")
        table.add_row(each.feedback, f"{1.0 / each.period_s:.0f}", each.law, *torques, *rest)
    print_table(table)
