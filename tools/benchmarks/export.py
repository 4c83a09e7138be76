"""Time of the step of an export to C, compared with this program's compiled step and with C written by hand.

gcc compiles all C with -O3 -march=native. The loops over the samples are in C and in compiled code: what is compared is
the step. One step by hand has the operations of the model, expm1 among them; the loop of ``models.c`` has exp in its
place, which is faster and loses the precision of small motions.
"""

import ctypes
import tempfile
from pathlib import Path

import numpy as np

import friction_hil as fh
from friction_hil.compensator import INPUTS, Compensator, CompensatorSettings
from friction_hil.friction import dispatch, kernel
from tools.benchmarks.c_library import load
from tools.benchmarks.models import DT, CLoops, Work, example, in_turns, recording
from tools.benchmarks.report import Row, compare

SAMPLES = 200_000
TARGET = 1.2
_LOOPS = """
#include "axis.c"

static double by_hand(double *z, double v, double dt)
{
    const double ratio = v / HAND_STRIBECK_VELOCITY, fading = v / HAND_DAMPING_VELOCITY;
    const double level = HAND_COULOMB + (HAND_STATIC - HAND_COULOMB) * exp(-ratio * ratio), before = *z;
    const double settled = level / HAND_SIGMA0 * ((v > 0.0) - (v < 0.0));
    *z -= expm1(-HAND_SIGMA0 * fabs(v) * dt / level) * (settled - *z);
    return HAND_SIGMA0 * *z + HAND_SIGMA1 * exp(-fading * fading) * ((*z - before) / dt) + HAND_SIGMA2 * v;
}
void hand_run(const double *velocity, long n, double dt, double *torque)
{
    double z = 0.0;
    for (long k = 0; k < n; k++)
        torque[k] = by_hand(&z, velocity[k], dt);
}
void model_run(const double *velocity, long n, double dt, double *torque)
{
    axis_model s;
    axis_model_init(&s);
    for (long k = 0; k < n; k++)
        torque[k] = axis_model_step(&s, velocity[k], dt, 0.0, 0.0, NAN, 0.0);
}
void compensator_run(const double *position, const double *velocity, const double *demand, long n, double *torque)
{
    axis_compensator s;
    axis_compensator_init(&s);
    for (long k = 0; k < n; k++) {
        const axis_compensator_input in = {
            1U, position[k], velocity[k], 0.0, demand[k], velocity[k], velocity[k], NAN, NAN, true, true};
        torque[k] = axis_compensator_step(&s, &in);
    }
}
"""


def run() -> list[Row]:
    """Measure LuGre's step and the whole compensator.

    Raises
    ------
    FrictionHilError
        gcc is not installed, or it failed.
    """
    parameters = ",".join(f"{name}={value}" for name, value in example("lugre").parameters.items())
    model_text = f"lugre:{parameters}"
    model = example("lugre")
    settings = CompensatorSettings(period_s=DT, position_resolution=1e-5, torque_limit=1.0, lead_s=1.5e-3)
    compensator = Compensator(model, settings)
    with tempfile.TemporaryDirectory() as folder:
        fh.export.write(model_text.replace("inf", ".inf"), "c", folder, name="axis", compensator=compensator)
        loops = Path(folder) / "loops.c"
        constants = (f"#define HAND_{name.upper()} {value!r}\n" for name, value in model.parameters.items())
        loops.write_text("".join(constants) + _LOOPS)
        library = load(loops)
    array = np.ctypeslib.ndpointer(np.float64, ndim=1, flags="C")
    library.model_run.argtypes = library.hand_run.argtypes = (array, ctypes.c_long, ctypes.c_double, array)
    library.compensator_run.argtypes = (array, array, array, ctypes.c_long, array)
    velocity = recording(SAMPLES)
    position = np.round(np.cumsum(velocity) * DT / 1e-5) * 1e-5
    demand, torque = np.cumsum(velocity) * DT, np.empty(SAMPLES)
    inputs = _inputs(position, velocity, demand)
    by_hand = CLoops().of(model)
    tag = dispatch.tag(model.kind)
    work: dict[str, Work] = {
        "model": (SAMPLES, lambda: library.model_run(velocity, SAMPLES, DT, torque)),
        "model here": (
            SAMPLES,
            lambda: dispatch.each_step(
                tag, model.values[kernel.HEADER :], np.zeros(kernel.STATE_ROOM), velocity, DT, 0.0, torque
            ),
        ),
        "step by hand": (SAMPLES, lambda: library.hand_run(velocity, SAMPLES, DT, torque)),
        "model by hand": (SAMPLES, lambda: by_hand(velocity, out=torque)),
        "compensator": (SAMPLES, lambda: library.compensator_run(position, velocity, demand, SAMPLES, torque)),
        "compensator here": (SAMPLES, lambda: Compensator(model, settings).replay(inputs)),
    }
    times = in_turns(work, "steps")
    return [
        compare(f"lugre, step (compiled step; target {TARGET})", "ns", times["model"], times["model here"]),
        compare(f"lugre, step (C by hand; target {TARGET})", "ns", times["model"], times["step by hand"]),
        compare("lugre, step (C by hand with exp)", "ns", times["model"], times["model by hand"]),
        compare(
            f"compensator, step (compiled step; target {TARGET})",
            "ns",
            times["compensator"],
            times["compensator here"],
        ),
    ]


def _inputs(position: "np.ndarray", velocity: "np.ndarray", demand: "np.ndarray") -> list["np.ndarray"]:
    ones, unknown = np.ones(position.size), np.full(position.size, np.nan)
    given = {
        "cycle": np.arange(position.size, dtype=np.float64),
        "position": position,
        "velocity": velocity,
        "torque": 0.0 * ones,
        "position_demand": demand,
        "velocity_demand": velocity,
        "velocity_demand_ahead": velocity,
        "is_fresh": ones,
        "is_enabled": ones,
        "acceleration_demand_ahead": unknown,
        "temperature": unknown,
    }
    return [given[name] for name in INPUTS]
