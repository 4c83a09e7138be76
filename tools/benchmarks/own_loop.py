"""Time of a call of `friction_hil.Compensator` for one and for seven joints, against a hand-written law in numpy."""

import time
from collections.abc import Callable

import numpy as np

import friction_hil as fh
from friction_hil.config import from_dict, load, self_contained
from friction_hil.config.examples import examples
from tools.benchmarks.report import Row, against, compare, rounds

JOINTS = 7
TARGETS_US = {1: 3.0, JOINTS: 20.0}
CALLS, ROUNDS = 4000, 15
PERIOD_S = 0.004


def _compensator(joints: int) -> fh.Compensator:
    values = self_contained(load(examples()["own_loop"], period_s=PERIOD_S))
    axis = values["axes"]["shoulder"]
    configuration = from_dict({**values, "axes": {f"joint_{k}": axis for k in range(joints)}}, "own_loop")
    return fh.Compensator(configuration)


def run() -> list[Row]:
    """Measure in turn: every call by itself, with all that a loop gives."""
    t = PERIOD_S * np.arange(CALLS)
    q, dq = 0.5 * np.sin(t)[:, None] + np.zeros(JOINTS), 0.5 * np.cos(t)[:, None] + np.zeros(JOINTS)
    coulomb, rate, viscous = np.full(JOINTS, 0.4), np.full(JOINTS, 50.0), np.full(JOINTS, 0.05)

    speeds = list(dq)  # a loop has its arrays at hand: to cut them out of larger ones is no part of the call

    def law(k: int) -> object:
        speed = speeds[k]
        return coulomb * np.tanh(rate * speed) + viscous * speed

    def stepped(comp: fh.Compensator, n: int) -> Callable[[int], object]:
        place, speed, loads = (list(np.ascontiguousarray(each[:, :n])) for each in (q, dq, 0.1 * q))
        fresh = np.ones(n, bool)

        def step(k: int) -> object:
            a, v = place[k], speed[k]
            return comp.step(a, v, a, q_des=a, dq_des=v, load=loads[k], fresh=fresh, dt=PERIOD_S)

        return step

    comps = {n: _compensator(n) for n in TARGETS_US}
    works = {"numpy": law} | {str(n): stepped(comp, n) for n, comp in comps.items()}
    times: dict[tuple[str, int], list[float]] = {(name, p): [] for name in works for p in (50, 99)}
    for _ in rounds(ROUNDS, "calls"):
        for name, work in works.items():
            took = []
            for k in range(CALLS):
                began = time.perf_counter_ns()
                work(k)
                took.append(time.perf_counter_ns() - began)
            for p in (50, 99):
                times[name, p].append(float(np.percentile(took, p)) / 1e3)
    if any(comp.fault for comp in comps.values()):
        raise AssertionError("the compensation has faded out")
    rows = []
    for n, target in TARGETS_US.items():
        for p in (50, 99):
            name = f"step, {n} joint{'s' * (n > 1)}, p{p}"
            rows.append(compare(f"{name} (numpy, {JOINTS} joints)", "us", times[str(n), p], times["numpy", p]))
        rows.append(
            against(target, f"step, {n} joint{'s' * (n > 1)}, p50 (target)", "us", float(np.median(times[str(n), 50])))
        )
    return rows
