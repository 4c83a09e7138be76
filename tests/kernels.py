"""Compile what many tests run: once, before several workers would each compile it in their own memory."""

import hashlib
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from friction_hil import Compensator, models
from friction_hil.friction import kernel
from friction_hil.numerics import jit
from tests.launcher import load_kernels

_ANY_MODEL = "any model"
_LONGEST = (_ANY_MODEL, "table", "armstrong")  # they come first, so that all processes end at the same time


def compile_kernels(workers: int) -> None:
    """Compile in as many processes, unless that has been done with these sources."""
    folder = jit.cache_folder()
    if folder is None:
        return
    done = Path(folder) / f"for_tests_{hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:16]}"
    if done.exists():
        return
    print("compiling, once with these sources ...", file=sys.stderr, flush=True)
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        list(pool.map(_compile, dict.fromkeys((*_LONGEST, *models.names()))))
    done.touch()


def _compile(name: str) -> None:
    if name == _ANY_MODEL:
        load_kernels()
        Compensator.load(Path(__file__).parents[1] / "config/own_loop.yaml", period_s=1e-3)
        models.create("coulomb", coulomb=0.1).start()
        kernel.prepare(jit.ready(kernel.step_with_network), 6)
        return
    model = models.create(name, **models.describe(name).example)
    model.simulate_with_gradient([0.1], 1e-3)
    model.simulate([0.1, 0.2], 1e-3)
    model.simulate([0.1, 0.2], [1e-3, 2e-3])
    model.simulate_with_gradient([0.1, 0.2], [1e-3, 2e-3])
    model.steady_state([0.1, 0.2])
