"""How often the 90-% intervals of resonance, anti-resonance and stiffness hold the true value, over repetitions.

python -m tests.coverage_of_errors            # 20 repetitions of each of four axes: minutes
python -m tests.coverage_of_errors 40
"""

import sys
from collections.abc import Iterator

import numpy as np

from friction_hil.identification.data import prepare
from friction_hil.identification.frequency_response import frequency_response
from friction_hil.identification.resonance import Resonance, fit_resonance
from friction_hil.motion import multisine
from friction_hil.motion.trajectory import Path
from friction_hil.recordings import Recording
from tests.two_mass_axis import LOOP_HZ, Array, Axis, Side, record

QUANTITIES = ("antiresonance_hz", "resonance_hz", "stiffness")
INTERVAL = 1.645  # standard errors to either side: 90 % of a normal distribution
AXES = {
    "light load": Axis(),
    "heavy load, little damping": Axis(load_inertia=4e-4, resonance_hz=45.0, damping_ratio=0.01),
    "Stribeck friction on either side": Axis(
        resonance_hz=80.0, motor=Side(0.03, 0.05, 0.05, viscous=1e-3), load=Side(0.04, 0.06, 0.05)
    ),
    "LuGre friction": Axis(motor=Side(0.03, 0.04, 0.05, viscous=2e-3, sigma0=300.0, sigma1=0.05)),
}
PLAN = multisine.plan(2.0, 1.0, period_s=1e-3, high_hz=150.0, duration_s=24.0)


def shaken(axis: Axis, seed: int, plan: multisine.MultisinePlan = PLAN) -> Recording:
    """Record the product's multisine, at 1 kHz, on another stretch of the axis and with other noise for each seed."""
    demand = demanded(multisine.multisine_path(plan), plan.duration_s)
    recording = record(axis, demand, seed=seed)
    del recording.columns["load_position"]
    return recording


def demanded(path: Path, seconds: float) -> Array:
    """Return position and velocity (n, 2) of a path at the rate of the drive."""
    return np.array([path(i / LOOP_HZ)[:2] for i in range(round(seconds * LOOP_HZ))])


def found(axis: Axis, repetitions: int) -> Iterator[Resonance]:
    """Yield what is found in each repetition."""
    for seed in range(repetitions):
        response = frequency_response(prepare(shaken(axis, seed)))
        resonance = None if response is None else fit_resonance(response)[0]
        if resonance is not None:
            yield resonance


def true_values(axis: Axis) -> dict[str, float]:
    """Return what the intervals should hold."""
    return {
        "antiresonance_hz": axis.antiresonance_hz,
        "resonance_hz": axis.resonance_hz,
        "stiffness": axis.stiffness,
    }


def main() -> None:
    """Print the coverage for each axis, and of all."""
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    everything = []
    for name, axis in AXES.items():
        true = true_values(axis)
        rows = [
            [(each.values[key] - true[key]) / each.errors[key] for key in QUANTITIES]
            for each in found(axis, repetitions)
        ]
        everything += rows
        if not rows:
            print(f"{name}: found in none of {repetitions}")
            continue
        scores = np.array(rows)
        held = np.mean(np.abs(scores) <= INTERVAL, axis=0)
        print(f"{name}: found in {len(rows)} of {repetitions}")
        for key, share, mean, spread in zip(QUANTITIES, held, scores.mean(0), scores.std(0), strict=True):
            print(f"  {key}: {share:.0%} of the 90-% intervals; score {mean:+.2f}, spread {spread:.2f}")
    print(f"all: {np.mean(np.abs(everything) <= INTERVAL):.0%}")


if __name__ == "__main__":
    main()
