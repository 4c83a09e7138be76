"""What compensation does on a machine: following errors of motor and load on several motions, without and with it."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from friction_hil.daemon.figures import figures_of
from friction_hil.numerics.jit import Array

SIDES = MOTOR, LOAD = "motor", "load"

Run = Callable[[bool], "Course"]
"""Simulates a motion, with compensation if the argument is true."""

OnProgress = Callable[[str, float], None]
"""Receives the motion that was simulated and the finished fraction of all work."""


class Errors(NamedTuple):
    """Root mean square and largest absolute value of a following error, rad or m, or their ratios."""

    rms: float
    peak: float

    def over(self, other: "Errors") -> "Errors":
        """Return the ratios to other errors; infinity where those are zero."""
        return Errors(*(a / b if b > 0.0 else math.inf for a, b in zip(self, other, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """One simulated motion, from where it is steady on."""

    time_s: Array  # (n,), since then
    demand: Array  # (n,), demanded position, rad or m
    # (n,), following error of the drive: demand less position by the encoder of its position loop, at the motor or,
    # where the machine has one there, at the load
    motor: Array
    load: Array  # (n,), demand less true position of the load
    gain_factor: float = 1.0  # what the guard against limit cycles has left of the gain at the end; 1: there was none

    def error(self, side: str) -> Array:
        """Return the following error of a side, (n,), less its mean.

        The mean is the constant part, e.g. of the twist under a weight, which homing takes out.
        """
        error = self.motor if side == MOTOR else self.load
        return error - np.mean(error)

    def errors(self, side: str) -> Errors:
        """Return RMS and peak of the error of a side; infinity if the simulation diverged."""
        found = figures_of(self.error(side))
        return Errors(found.rms, found.peak)

    @property
    def unseen(self) -> float:
        """RMS of what the load deviates from the encoder, less its mean: twist, play, errors of gear and encoder.

        No torque of the motor takes it away.
        """
        return float(np.std(self.motor - self.load))


def scored(trace: Mapping[str, Array], period_s: float, duration_s: float) -> Course:
    """Return the last ``duration_s`` of the signals of a rehearsal."""
    samples = round(duration_s / period_s)
    last = {name: values[-samples:] for name, values in trace.items()}
    return Course(
        period_s * np.arange(samples, dtype=np.float64),
        last["demand"],
        last["error"],
        last["load_error"],
        float(last["gain_factor"][-1]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class MotionResult:
    """A motion without and with compensation."""

    without: Course
    compensated: Course

    def reduction(self, side: str) -> Errors:
        """Return the factors by which RMS and peak of the error of a side are lower with compensation."""
        return self.without.errors(side).over(self.compensated.errors(side))


@dataclass(frozen=True, slots=True, eq=False)
class MachineStudy:
    """Results of a machine."""

    units: dict[str, str]  # of the position by axis: rad or m
    motions: dict[str, dict[str, MotionResult]]  # by axis and motion

    def rows(self) -> Iterator[tuple[str, str, str, MotionResult]]:
        """Yield axis, motion, side and result, in their order."""
        for axis, results in self.motions.items():
            for motion, result in results.items():
                for side in SIDES:
                    yield axis, motion, side, result

    @property
    def facts(self) -> dict[str, dict[str, dict[str, dict[str, dict[str, float]]]]]:
        """RMS and peak by axis, motion, side and condition, in SI, and the factors by which they are lower."""
        facts: dict[str, dict[str, dict[str, dict[str, dict[str, float]]]]] = {}
        for axis, motion, side, result in self.rows():
            facts.setdefault(axis, {}).setdefault(motion, {})[side] = {
                "without": result.without.errors(side)._asdict(),
                "compensated": result.compensated.errors(side)._asdict(),
                "reduction": result.reduction(side)._asdict(),
            }
        return facts


def study_machine(
    units: Mapping[str, str],  # of the position by axis: rad or m
    runs: Mapping[str, Mapping[str, Run]],  # what simulates each motion, by axis and motion
    on_progress: OnProgress = lambda text, fraction: None,
) -> MachineStudy:
    """Simulate all motions of all axes, without and with compensation."""
    found: dict[str, dict[str, MotionResult]] = {}
    done, whole = 0, sum(map(len, runs.values()))
    for axis, motions in runs.items():
        found[axis] = {}
        for name, run in motions.items():
            on_progress(f"{axis}: {name}", done / whole)
            found[axis][name] = MotionResult(run(False), run(True))
            done += 1
    return MachineStudy(dict(units), found)
