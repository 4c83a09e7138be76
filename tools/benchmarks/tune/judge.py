"""One axis: tuned by the command, then judged against the truth on motions of other speeds and strokes."""

import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from friction_hil_drivers.canopen.simulated.drives import SimulatedCanopenDrives

from friction_hil.checked_yaml.text import dump
from friction_hil.config import AxisConfig, Configuration, load
from friction_hil.config.axis import VelocityOffset
from friction_hil.models.files import load_model_file
from friction_hil.models.model_file import ModelFile
from friction_hil.motion.trajectory import Path as MotionPath
from friction_hil.motion.trajectory import sine_path, triangle_path
from friction_hil.recordings import read
from friction_hil.rehearsal import Motion, Outcome, Rehearsal
from friction_hil.servo.config import ServoConfig

OWN, OTHERS = "own", ("fast", "small", "triangle", "slow", "tiny")
ENOUGH = 0.8  # of the reduction by the truth
_START_S = 2.0
_OFFSET, _OFFSET_SLEW = 20.0, 1e5  # bounds of a velocity offset, rad/s and rad/s^2, which no axis here needs


@dataclass(frozen=True, slots=True)
class Reduction:
    """Factors by which RMS and peak of the following error fall, and the gain that the guard has left."""

    rms: float
    peak: float
    gain_factor: float


@dataclass(frozen=True, slots=True)
class AxisResult:
    """Result of one axis; ``tuned`` is empty if tune ended without a model, and ``problem`` says why.

    Attributes
    ----------
    true, tuned : dict of Reduction
        By motion.
    model : str
        Family of the kept model.
    tune_s, motion_s : float
        Time that tune took, and the recorded time of it: the motion, which took less because SYNC paces it.
    """

    name: str
    true: dict[str, Reduction]
    tuned: dict[str, Reduction]
    model: str
    problem: str
    tune_s: float
    motion_s: float

    def ratio(self, motion: str) -> tuple[float, float]:
        """Return the reductions of RMS and peak, tuned over true; 0 without a model."""
        if motion not in self.tuned:
            return 0.0, 0.0
        tuned, true = self.tuned[motion], self.true[motion]
        return tuned.rms / true.rms, tuned.peak / true.peak


def tune_axis(name: str, content: dict[str, Any]) -> AxisResult:
    """Tune an axis in a folder of its own, and judge the model that is kept."""
    with tempfile.TemporaryDirectory(prefix="friction-hil-") as folder:
        file = Path(folder) / f"{name}.yaml"
        configuration = _written(content, file)
        [(axis_name, axis)] = configuration.axes.items()
        output = Path(folder) / "tuned"
        start = time.monotonic()
        done = run_tune(file, output)
        tune_s = time.monotonic() - start
        model = output / f"{axis_name}.yaml"
        is_found = done.stdout.startswith("{") and model.is_file()
        recordings = json.loads(done.stdout).get("recordings", []) if is_found else []
        rehearsals = Rehearsals(axis, configuration.period_s)
        tuned = load_model_file(model) if is_found else None
        return AxisResult(
            name,
            rehearsals.reductions(truth(axis)),
            {} if tuned is None else rehearsals.reductions(tuned),
            "" if tuned is None else tuned.friction.model,
            "" if is_found else last_line(done),
            tune_s,
            sum(_length_s(Path(each), axis_name) for each in recordings),
        )


def _written(content: dict[str, Any], file: Path) -> Configuration:
    """Write a configuration to a file, and return it as read from there."""
    file.write_text(dump(content), encoding="utf-8")
    return load(file, needs_models=False)


def judge_truth(name: str, content: dict[str, Any], gain: float, by: str = "torque") -> AxisResult:
    """Judge what the true friction of an axis reaches at a gain, without tuning it.

    ``by``: what the drive is given: ``torque``, or a ``velocity`` or ``position`` by the gains of its loops.
    """
    with tempfile.TemporaryDirectory(prefix="friction-hil-") as folder:
        configuration = _written(content, Path(folder) / f"{name}.yaml")
    [axis] = configuration.axes.values()
    given = {"gain": gain, "velocity_offset": None if by == "torque" else _offset(axis, has_shift=by == "position")}
    axis = axis.model_copy(update={"compensation": axis.compensation.model_copy(update=given)})
    reached = Rehearsals(axis, configuration.period_s).reductions(truth(axis))
    return AxisResult(name, reached, {}, "", "", 0.0, 0.0)


def _offset(axis: AxisConfig, *, has_shift: bool) -> VelocityOffset:
    """Return the velocity offset of a drive whose gains are known, made by its set-point with ``has_shift``."""
    servo = axis.simulation
    assert isinstance(servo, ServoConfig)
    loops = servo.loops
    offset = VelocityOffset(
        velocity_gain=loops.velocity_gain, integral_hz=loops.integral_hz, limit=_OFFSET, slew=_OFFSET_SLEW
    )
    if not has_shift:
        return offset
    shift = {
        "position_gain": loops.position_gain,
        "velocity_feedforward": loops.velocity_feedforward,
        "inertia": loops.inertia_feedforward * servo.mechanics.inertia,
    }
    return offset.model_copy(update=shift)


def run_tune(file: Path, output: Path) -> "subprocess.CompletedProcess[str]":
    """Run the command for all axes of a configuration, against simulated drives and paced by SYNC."""
    words = ["tune", str(file), "--simulate", "--pace", "sync", "--yes", "--json", "--output", str(output)]
    return subprocess.run([sys.executable, "-m", "friction_hil", *words], capture_output=True, text=True)


def last_line(done: "subprocess.CompletedProcess[str]") -> str:
    """Return the last line that a command has written to stderr."""
    return (done.stderr.strip().splitlines() or ["no message"])[-1]


class Rehearsals:
    """Reductions of the following error of a simulated axis by a model, on some motions."""

    def __init__(self, axis: AxisConfig, period_s: float, names: Sequence[str] = (OWN, *OTHERS)) -> None:
        servo = axis.simulation
        assert isinstance(servo, ServoConfig)
        facts = SimulatedCanopenDrives.simulated_facts("x", axis, period_s)
        self._servo, self._rehearsal = servo, Rehearsal(axis, facts, period_s)
        motions = judged_motions(axis)
        self._motions = {name: motions[name] for name in names}
        self._without = {name: self._run(truth(axis), motion, False) for name, motion in self._motions.items()}

    def _run(self, model: ModelFile, motion: Motion, is_compensated: bool) -> Outcome:
        return self._rehearsal.run(self._servo, model, motion, is_compensated=is_compensated)

    def reductions(self, model: ModelFile) -> dict[str, Reduction]:
        """Return the reductions by a model, by motion."""
        found = {}
        for name, motion in self._motions.items():
            without, with_ = self._without[name], self._run(model, motion, True)
            found[name] = Reduction(without.rms / with_.rms, without.peak / with_.peak, with_.gain_factor)
        return found


def judged_motions(axis: AxisConfig) -> dict[str, Motion]:
    """Return the motion of an axis, and others of a tenth of its speed, smaller strokes, twice its speed, and lines."""
    trajectory = axis.trajectory
    stroke = getattr(trajectory, "radius", None) or trajectory.amplitude  # type: ignore[union-attr]
    frequency = trajectory.frequency  # type: ignore[union-attr]

    def sine(amplitude: float, hz: float) -> Motion:
        return _motion(sine_path(amplitude, hz, 0.5 * math.pi), hz)

    return {
        OWN: sine(stroke, frequency),
        "fast": sine(stroke, 2.0 * frequency),
        "small": sine(0.1 * stroke, frequency),
        "triangle": _motion(triangle_path(stroke / 3.0, 0.5 * frequency, 0.1), 0.5 * frequency),
        "slow": sine(stroke, 0.1 * frequency),
        "tiny": sine(0.01 * stroke, frequency),
    }


def _motion(path: MotionPath, hz: float) -> Motion:
    periods = max(1, math.ceil(4.0 * hz))
    return Motion(path, periods / hz, start_s=_START_S + 1.0 / hz)


def truth(axis: AxisConfig) -> ModelFile:
    """Return the model file of the friction and mechanics that are simulated."""
    servo = axis.simulation
    assert isinstance(servo, ServoConfig)
    return ModelFile.model_validate(
        {
            "version": 1,
            "axis": servo.mechanics.axis,
            "friction": servo.friction.model_dump(),
            "mechanics": {
                "inertia": servo.mechanics.inertia,
                "offset": servo.mechanics.load_torque,
                "torque_lag_s": servo.motor.torque_lag_s,
            },
        }
    )


def _length_s(path: Path, axis: str) -> float:
    return read(path, axis).duration_s
