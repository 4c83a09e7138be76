"""Time of the friction models, compared with a plain C loop of the same model (``models.c``).

gcc compiles the C code at each run with -O3 -march=native. Both sides simulate the same motion into an array.
"""

import ctypes
import math
import time
from collections.abc import Callable, Iterable
from functools import partial
from itertools import chain
from pathlib import Path
from statistics import median

import numpy as np

import friction_hil as fh
from friction_hil.models import FrictionModel
from friction_hil.numerics.jit import Array
from tools.benchmarks.c_library import COMMAND, load
from tools.benchmarks.report import Row, against, compare, note, rounds

Simulate = Callable[..., Array]
Work = tuple[int, Callable[[], object]]  # number of equal parts, and the function that does them

SOURCE = Path(__file__).with_suffix(".c")
DT = 1e-3
ROUNDS = 15
SAMPLES = 1_000_000
SLOW, SHORT_SAMPLES = ("elasto_plastic",), 200_000  # its substeps take much longer than any other model
CANDIDATES, CANDIDATE_SAMPLES = 64, 25_000
GRADIENT_SAMPLES = 200_000
STEPS = 20_000
WORKERS = 2
TARGET, LUGRE_TARGET, CANDIDATES_TARGET, GRADIENT_TARGET, STEP_TARGET_US = 1.1, 0.6, 1.3, 4.0, 0.5
SIX = ("sigma0", "sigma1", "sigma2", "coulomb", "static", "stribeck_velocity")


class CLoops:
    """The loops of ``models.c``, compiled when it is created.

    Raises
    ------
    FrictionHilError
        gcc is not installed, or it failed.
    """

    def __init__(self) -> None:
        self._library = load(SOURCE)

    def of(self, model: FrictionModel, dt: float = DT) -> Simulate:
        """Return the C function of ``model``: velocity (n,) to torque (n,), from rest."""
        function = self._library[model.name]
        array = np.ctypeslib.ndpointer(np.float64, ndim=1, flags="C")
        function.argtypes = (array, array, ctypes.c_long, ctypes.c_double, array)
        function.restype = None
        parameters = np.array(flat(model.parameters.values()))

        def simulate(velocity: Array, out: Array | None = None) -> Array:
            torque = np.empty(velocity.size) if out is None else out
            function(parameters, velocity, velocity.size, dt, torque)
            return torque

        return simulate


def flat(values: Iterable[object]) -> list[float]:
    """Return parameter values as the C loops take them: a list follows its length, text is left out."""
    numbers: list[float] = []
    for value in values:
        if isinstance(value, list | tuple):
            elements = [list(element) if isinstance(element, list | tuple) else [element] for element in value]
            numbers += [len(elements), *chain.from_iterable(elements)]
        elif isinstance(value, int | float):
            numbers.append(float(value))
    return numbers


def example(name: str, **changed: float) -> FrictionModel:
    """Create the example model of the family ``name``, with some parameters ``changed``."""
    return fh.models.create(name, **{**fh.models.describe(name).example, **changed})


def recording(samples: int) -> Array:
    """Return the velocity, rad/s, of a motion with starts, stops, rests and reversals: a gated multi-sine."""
    t = np.arange(samples) * DT
    sines = ((0.9, 0.31, 0.0), (0.5, 0.83, 1.0), (0.3, 2.3, 2.0), (0.15, 7.1, 3.0), (0.1, 19.0, 4.0))
    motion = sum(amplitude * np.sin(2.0 * np.pi * hertz * t + phase) for amplitude, hertz, phase in sines)
    gate = np.clip(1.9 + 2.0 * np.sin(2.0 * np.pi * 0.05 * t), 0.0, 1.0)  # closed for a tenth of the time
    return np.asarray(motion * gate * gate * (3.0 - 2.0 * gate), dtype=np.float64)


def run() -> list[Row]:
    """Measure everything, each model alternately with its C loop.

    Raises
    ------
    FrictionHilError
        gcc is not installed, or it failed.
    """
    loops = CLoops()
    note(f"{' '.join(COMMAND)}; ns of processor time a sample, medians of {ROUNDS} rounds")
    return [*whole_arrays(loops), *candidates(loops), *gradients(), single_step()]


def whole_arrays(loops: CLoops) -> list[Row]:
    """Time `simulate` of every family against C, ns a sample."""
    models = {name: example(name) for name in fh.models.names()}
    models["lugre, constant sigma1"] = example("lugre", damping_velocity=math.inf)
    work: dict[str, Work] = {}
    for name, model in models.items():
        velocity = recording(SHORT_SAMPLES if model.name in SLOW else SAMPLES)
        torque = np.empty(velocity.size)
        work[name] = velocity.size, partial(model.simulate, velocity, DT, out=torque)
        work[f"C {name}"] = velocity.size, partial(loops.of(model), velocity, out=torque)
    times = in_turns(work, "whole arrays")
    return [
        compare(
            f"{name} (C; target {LUGRE_TARGET if model.name == 'lugre' else TARGET})",
            "ns",
            times[name],
            times[f"C {name}"],
        )
        for name, model in models.items()
    ]


def candidates(loops: CLoops) -> list[Row]:
    """Time many LuGre parameter sets over one recording in one call, ns a sample and candidate."""
    velocity = recording(CANDIDATE_SAMPLES)
    stiffness = example("lugre").parameters["sigma0"]
    models = [example("lugre", sigma0=stiffness * factor) for factor in np.geomspace(0.5, 2.0, CANDIDATES)]
    plain = [loops.of(model) for model in models]
    size = CANDIDATES * CANDIDATE_SAMPLES
    one = partial(fh.models.simulate_many, models, velocity, DT, workers=1)
    more = partial(fh.models.simulate_many, models, velocity, DT, workers=WORKERS)
    work: dict[str, Work] = {"ours": (size, one), "C": (size, lambda: [loop(velocity) for loop in plain])}
    times = in_turns(work, "candidates")
    spread = in_turns({"one": (size, one), "more": (size, more)}, "workers", time.perf_counter_ns)
    speedup = median(alone / shared for alone, shared in zip(spread["one"], spread["more"], strict=True))
    name = f"{CANDIDATES} lugre candidates"
    return [
        compare(f"{name} on one core (as many C loops; target {CANDIDATES_TARGET})", "ns", times["ours"], times["C"]),
        against(WORKERS, f"{name}: speed-up of {WORKERS} workers (workers)", "x", speedup),
    ]


def gradients() -> list[Row]:
    """Time the torque with its gradient in LuGre's six parameters against the torque alone, ns a sample."""
    velocity = recording(GRADIENT_SAMPLES)
    models = {
        "lugre": example("lugre"),
        "lugre, constant sigma1": example("lugre", damping_velocity=math.inf),
    }
    work: dict[str, Work] = {}
    for name, model in models.items():
        torque, gradient = np.empty(velocity.size), np.empty((velocity.size, len(SIX)))
        with_gradient = partial(model.simulate_with_gradient, velocity, DT, free=SIX, out=(torque, gradient))
        work[name] = velocity.size, with_gradient
        work[f"plain {name}"] = velocity.size, partial(model.simulate, velocity, DT, out=torque)
    times = in_turns(work, "gradients")
    return [
        compare(
            f"{name}: gradient in {len(SIX)} parameters (simulate; target {GRADIENT_TARGET:g})",
            "ns",
            times[name],
            times[f"plain {name}"],
        )
        for name in models
    ]


def single_step() -> Row:
    """Time one step of LuGre from Python, with the loop around it, us."""
    velocities = recording(STEPS).tolist()
    runner = example("lugre").start()

    def steps() -> None:
        step = runner.step
        for velocity in velocities:
            step(velocity, DT)

    times = in_turns({"step": (STEPS, steps)}, "single steps")
    return against(STEP_TARGET_US, "lugre: one hot step from Python (target)", "us", median(times["step"]) / 1e3)


def in_turns(
    work: dict[str, Work], label: str, clock: Callable[[], int] = time.process_time_ns
) -> dict[str, list[float]]:
    """Do all the ``work`` in every round; return the time of one part of each, ns.

    The default ``clock`` gives processor time, on which other programs have little influence. The first round compiles
    and is not counted. Every other round has the reverse order, so that none always profits from the content of the
    caches.
    """
    times: dict[str, list[float]] = {name: [] for name in work}
    for number in rounds(ROUNDS + 1, label):
        for name in work if number % 2 else reversed(work):
            parts, do = work[name]
            began = clock()
            do()
            taken = clock() - began
            if number:
                times[name].append(taken / parts)
    return times
