"""Time and error of training a friction network, compared with BLAS, C, pyrenn and scipy.

The plant is a LuGre model, 20,000 samples at 1 kHz; see `friction_hil.training`. pyrenn (PyPI) is optional: install it
to see its rows. It is stopped after a number of iterations, and both are timed until they reach the error that it has
then, in free run on the training samples.
"""

import contextlib
import ctypes
import importlib
import io
import math
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from scipy.optimize import least_squares

import friction_hil as fh
from friction_hil.errors import FrictionHilError
from friction_hil.friction import network
from friction_hil.models import NetworkStructure
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array, compiled_for_one_sample
from friction_hil.recordings import Recording
from friction_hil.training import NetworkSpec, levenberg, normal, task_of_recordings, train_task
from friction_hil.training.checks import simulate
from friction_hil.training.constraints import CONTRACTIONS, Constraint
from friction_hil.training.excitation import excitation
from friction_hil.training.first_weights import first_weights
from friction_hil.training.gated import row_length
from friction_hil.training.jacobian import fill_rows
from friction_hil.training.layout import Samples, empty
from friction_hil.training.objective import NetworkRun, Objective
from friction_hil.training.train import Options, train
from tools.benchmarks.c_library import load
from tools.benchmarks.report import Row, against, compare, note

DT, SAMPLES, TOP_SPEED = 1e-3, 20_000, 1.2
ROUNDS = 11
SEEDS, NARX_SEEDS = range(10), range(3)
GATED, NARX = NetworkStructure(hidden=(8,)), NetworkStructure("narx", (9,), 1, 1)
STEP_NETWORK = NetworkStructure(hidden=(10,))
PYRENN_ITERATIONS = 10  # each takes about 6 s; the error then is that of ours after one or two
COUNT, TORQUE_NOISE = 2.0 * math.pi / 2**20, 0.01  # rad, and of the torque's standard deviation
OTHERS: dict[str, dict[str, Any]] = {
    "lugre": {"sigma0": 2700.0, "sigma1": 0.9, "sigma2": 8e-3, "damping_velocity": 0.3}
    | {"coulomb": 0.05, "static": 0.08, "stribeck_velocity": 0.3},
    "elasto_plastic": {"sigma0": 400.0, "sigma1": 0.3, "sigma2": 2e-3, "damping_velocity": 0.06, "breakaway_ratio": 0.6}
    | {"coulomb": 0.2, "static": 0.26, "stribeck_velocity": 0.06},
    "gms": {"stiffness": [800.0, 300.0, 120.0, 40.0], "weight": [0.3, 0.3, 0.2, 0.2], "attraction": 6.0}
    | {"coulomb": 0.08, "static": 0.14, "stribeck_velocity": 0.2, "viscous": 2e-3},
}
SOURCE = Path(__file__).with_suffix(".c")


def plant() -> Any:
    """Create the LuGre model of the plant."""
    levels: dict[str, Any] = {"coulomb": 0.11, "static": 0.17, "stribeck_velocity": 0.12, "damping_velocity": 0.12}
    return fh.models.create("lugre", sigma0=900.0, sigma1=0.6, sigma2=4e-3, **levels)


def samples(seed: int, count: int = SAMPLES, dt: float = DT) -> Samples:
    """Return samples of the plant along a designed excitation."""
    velocity = excitation(TOP_SPEED, dt, count, seed=seed)
    return Samples(dt, velocity, plant().simulate(velocity, dt))


def run() -> list[Row]:
    """Measure everything.

    Raises
    ------
    FrictionHilError
        gcc is not installed, or it failed.
    """
    note(f"medians of {ROUNDS} rounds, processor time; errors are NRMSE in free run")
    return [*iterations(), *whole_array(), single_step(), *time_to_error(), *errors(), *other_plants()]


def in_turns(work: dict[str, Callable[[], object]]) -> dict[str, list[float]]:
    """Do all the work in every round; return the processor time of each part, ms. The first round compiles."""
    times: dict[str, list[float]] = {name: [] for name in work}
    for number in range(ROUNDS + 1):
        for name, do in work.items():
            began = time.process_time_ns()
            do()
            if number:
                times[name].append((time.process_time_ns() - began) / 1e6)
    return times


def iterations() -> list[Row]:
    """Time one iteration of Levenberg-Marquardt against the product J' J of a BLAS."""
    data, rows = samples(0), []
    for structure in (GATED, NARX):
        p = empty(structure, data)
        at = first_weights(p, structure, data, np.random.default_rng(0))
        objective = Objective(
            p, NetworkRun(p, data), Constraint(structure, CONTRACTIONS[structure.kind]), 1e-9, is_free=True
        )
        jacobian = np.random.default_rng(0).standard_normal((SAMPLES, structure.weights))
        step, factor = np.empty(structure.weights), np.empty((structure.weights, structure.weights))

        def iteration(
            objective: Objective = objective, at: Array = at, step: Array = step, factor: Array = factor
        ) -> None:
            objective.cost(at)
            matrix, gradient = objective.normal_equations()
            normal.solve(matrix + 1e-3 * np.diag(np.diag(matrix)), -gradient, step, factor)

        def product(jacobian: Array = jacobian) -> Array:
            return np.asarray(jacobian.T @ jacobian)

        times = in_turns({"iteration": iteration, "product": product})
        size = f"{structure.weights} weights, {SAMPLES} samples"
        name = f"{structure.kind}: one LM iteration, {size} (J'J by BLAS; target 2)"
        rows.append(compare(name, "ms", times["iteration"], times["product"]))
    return rows


def whole_array() -> list[Row]:
    """Time the free run over a record against a plain C loop of the same network."""
    function = load(SOURCE).gated
    array = np.ctypeslib.ndpointer(np.float64, ndim=1, flags="C")
    function.argtypes, function.restype = (array, array, ctypes.c_long, ctypes.c_double, array), None
    data = samples(0, 100_000)
    p = empty(STEP_NETWORK, data)
    p[network.HEADER :] = 0.2 * np.random.default_rng(0).standard_normal(STEP_NETWORK.weights)
    plain = np.empty(len(data))
    ours = simulate(STEP_NETWORK, p, data.velocity, DT)
    function(p, data.velocity, len(data), DT, plain)
    if not np.allclose(ours, plain, rtol=1e-9, atol=1e-12):
        raise FrictionHilError("the C loop and the network disagree")
    times = in_turns(
        {
            "ours": lambda: simulate(STEP_NETWORK, p, data.velocity, DT),
            "C": lambda: function(p, data.velocity, len(data), DT, plain),
        }
    )
    per_sample = {name: [1e6 * taken / len(data) for taken in series] for name, series in times.items()}
    return [compare("gated 5-10-1: free run a sample (C; target 1.2)", "ns", per_sample["ours"], per_sample["C"])]


def single_step() -> Row:
    """Time one step from Python."""
    inner = network.step

    @compiled_for_one_sample
    def step(p: Array, s: Array, velocity: float) -> float:
        return inner(p, s, velocity, velocity, DT, 0.0, 0.0, 0.0)

    data = samples(0, 5000)
    p, s = empty(STEP_NETWORK, data), np.zeros(STEP_NETWORK.state_room)
    velocities = data.velocity.tolist()

    def steps() -> None:
        for velocity in velocities:
            step(p, s, velocity)

    taken = median(in_turns({"steps": steps})["steps"])
    return against(3.0, "one step of a 5-10-1 network from Python (target)", "us", 1e3 * taken / len(velocities))


def time_to_error() -> list[Row]:
    """Time from the same start to the same error: ours, scipy's LM with the same Jacobian, and pyrenn."""
    data, structure = samples(0), GATED
    p = empty(structure, data)
    start, constraint = first_weights(p, structure, data, np.random.default_rng(1)), Constraint(structure, 0.8)
    record, goal = NetworkRun(p, data), 0.01
    spread = float(np.std(record.target))

    def ours() -> float:
        objective, began = Objective(p, record, constraint, 0.0, is_free=True), time.process_time()
        levenberg.minimise_unbounded(
            objective.cost,
            objective.normal_equations,
            start,
            iterations=300,
            goes_on=lambda progress: math.sqrt(progress.cost) / spread > goal,
        )
        return time.process_time() - began

    class Reached(Exception):  # noqa: N818 - not an error
        pass

    objective = Objective(p, record, constraint, 0.0, is_free=True)

    def residual(at: Array) -> Array:
        if math.sqrt(objective.cost(at)) / spread <= goal:
            raise Reached
        return np.asarray(record.trace[:, -1] - record.target)

    def jacobian(at: Array) -> Array:
        objective.cost(at)
        rows = np.zeros((SAMPLES, structure.weights + network.SPARE))
        carried = np.zeros((1, row_length(objective.p)))
        common = (data.starts, record.inputs, record.gate_features, record.path, record.trace)
        fill_rows(objective.p, *common, True, 0, SAMPLES, carried, rows, structure.weights)
        rows = rows[:, : structure.weights]
        return np.asarray(rows + rows[:, constraint.feedback] @ constraint.apply(at)[1])

    def scipy_lm() -> float:
        began = time.process_time()
        try:
            least_squares(residual, start, jac=jacobian, method="lm", x_scale="jac", max_nfev=300)
        except Reached:
            return time.process_time() - began
        note("scipy did not reach the error")
        return time.process_time() - began

    ours()
    rows = [compare(f"to a training error of {goal:g} (scipy lm)", "s", [ours()], [scipy_lm()])]
    try:
        pyrenn: Any = importlib.import_module("pyrenn")
    except ModuleNotFoundError:
        note("pyrenn is not installed: its row is left out")
        return rows
    note(f"pyrenn: {PYRENN_ITERATIONS} iterations, about a minute")
    np.random.seed(0)  # pyrenn draws from it
    net, scaled = pyrenn.CreateNN([1, 8, 1], dIn=[0, 1], dOut=[1]), data.torque / np.std(data.torque)
    began = time.process_time()
    with contextlib.redirect_stdout(io.StringIO()):  # it prints when it is done
        net = pyrenn.train_LM(data.velocity[None], scaled[None], net, k_max=PYRENN_ITERATIONS)
    taken = time.process_time() - began
    goal = float(np.sqrt(np.mean((pyrenn.NNOut(data.velocity[None], net) - scaled) ** 2)))
    own = median(ours() for _ in range(5))
    name = f"to pyrenn's error of {goal:.3g}, after its {PYRENN_ITERATIONS} iterations (pyrenn)"
    factor = against(50.0, "speed-up over pyrenn (target: at least)", "times", taken / own)
    return [*rows, compare(name, "s", [own], [taken]), factor]


def errors() -> list[Row]:
    """Train with ten seeds; return the free-run errors on signals of other seeds, at three periods."""
    found: dict[float, list[float]] = {DT: [], 0.5 * DT: [], 4.0 * DT: []}
    seconds = []
    for seed in SEEDS:
        began = time.process_time()
        result = train(GATED, samples(seed), samples(seed + 100, 8000), seed=seed, options=Options())
        seconds.append(time.process_time() - began)
        for dt, series in found.items():
            test = samples(seed + 200, round(20.0 / dt), dt)
            left = simulate(result.structure, result.parameters, test.velocity, dt) - test.torque
            series.append(float(np.sqrt(np.mean(left**2)) / np.std(test.torque)))
    return [
        against(0.008, "gated, unseen, median of 10 seeds (target)", "NRMSE", median(found[DT])),
        against(0.015, "gated, unseen, worst of 10 seeds (target)", "NRMSE", max(found[DT])),
        *(
            against(0.02, f"gated at {dt / DT:g} times the period, worst of 10 (target)", "NRMSE", max(found[dt]))
            for dt in (0.5 * DT, 4.0 * DT)
        ),
        Row("gated: training with all its starts, median", median(seconds), "s"),
        *narx_errors(),
    ]


def narx_errors() -> list[Row]:
    """Train networks with their past torques as inputs; return the free-run error on sums of sines."""
    found = []
    for seed in NARX_SEEDS:
        result = train(NARX, samples(seed), samples(seed + 100, 8000), seed=seed, options=Options())
        velocity = sines(seed)
        truth = plant().simulate(velocity, DT)
        left = simulate(result.structure, result.parameters, velocity, DT) - truth
        found.append(float(np.sqrt(np.mean(left**2)) / np.std(truth)))
    return [against(0.02, f"narx, multi-sines, worst of {len(found)} seeds (target)", "NRMSE", max(found))]


def sines(seed: int) -> Array:
    """Return the velocity of a sum of six sines from 0.2 to 8 Hz, 20 s."""
    random = np.random.default_rng(seed + 200)
    time_s, frequencies = DT * np.arange(SAMPLES), 0.2 * 40.0 ** random.uniform(0.0, 1.0, 6)
    phases = random.uniform(0.0, math.tau, 6)
    velocity: Array = np.sin(math.tau * frequencies * time_s[:, None] + phases).sum(axis=1)
    velocity *= 0.8 * TOP_SPEED / np.max(np.abs(velocity))
    return velocity


def other_plants() -> list[Row]:
    """Train on recordings of other plants with encoder steps and torque noise; compare with the true torque."""
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.1}}  # only the mechanics is used
    known = ModelFile.model_validate({"axis": "rotary", "friction": friction})
    rows = []
    for name, parameters in OTHERS.items():
        model = fh.models.create(name, **parameters)
        top, began = 10.0 * parameters["stribeck_velocity"], time.process_time()
        recordings = [recorded(model, top, count, seed) for seed, count in ((0, SAMPLES), (100, 8000))]
        found = train_task(task_of_recordings(recordings[:1], recordings[1:], known), NetworkSpec())
        seconds, velocity = time.process_time() - began, excitation(top, DT, SAMPLES, seed=200)
        truth, trained = model.simulate(velocity, DT), found.trained
        left = simulate(trained.structure, trained.parameters, velocity, DT) - truth
        what = f"{name}, 20-bit encoder, 1 % torque noise, {seconds:.0f} s: against the truth, unseen (target)"
        rows.append(against(0.02, what, "NRMSE", float(np.sqrt(np.mean(left**2)) / np.std(truth))))
    return rows


def recorded(model: Any, top_speed: float, count: int, seed: int) -> Recording:
    """Return a recording of a designed motion with encoder steps and a noisy torque."""
    velocity = excitation(top_speed, DT, count, seed=seed)
    torque = model.simulate(velocity, DT)
    noise = TORQUE_NOISE * np.std(torque) * np.random.default_rng(seed).standard_normal(count)
    columns: dict[str, Array] = {
        "time_s": np.linspace(0.0, (count - 1) * DT, count),
        "position": np.round(np.cumsum(velocity) * DT / COUNT) * COUNT,
        "torque": torque + noise,
    }
    return Recording("made up", "axis", columns)
