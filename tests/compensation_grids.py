"""A small grid of ``tools/bench compensation`` for tests, as text to be changed, and the plant of the reference."""

from pathlib import Path
from typing import Any

from tools.benchmarks.compensation import Grid, load

LUGRE: dict[str, Any] = {
    "model": "lugre",
    "parameters": {"sigma0": 2000.0, "sigma1": 1.0, "sigma2": 2e-3, "coulomb": 0.08, "static": 0.12}
    | {"stribeck_velocity": 0.2, "damping_velocity": 0.2},
}
TINY = """\
plants:
  servo:
    inertia: 2e-4
    friction:
      model: lugre
      parameters: {sigma0: 2000.0, sigma1: 0.05, coulomb: 0.08, static: 0.12, stribeck_velocity: 0.2}
drives:
  soft: {position_gain: 100.0, velocity_gain: 0.06, integral_hz: 16.0, torque_lag_s: 3e-4, rate_hz: 8000}
  stiff: {velocity_gain: 0.2}
motions:
  - {amplitude: 0.05, frequency: 2.0}
conditions:
  exact: {}
  off:
    gain: 0.9
    friction: {factors: {coulomb: 0.85}, parameters: {static: 0.1}}
compensator: {model: lugre, inertia_error: 0.05}
duration_s: 0.6
settling_s: 0.3
"""


def grid_of(folder: Path, text: str = TINY) -> Grid:
    """Read a grid from a file that is written for that."""
    path = folder / "grid.yaml"
    path.write_text(text)
    return load(path)
