"""Columns that contradict each other: a wrong unit, sign or register that leaves plausible numbers. Pure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_hil.recordings.columns import TIME
from friction_hil.recordings.mapping import parse_source
from friction_hil.recordings.quality import GAP_PERIODS, LARGEST, without_overflow
from friction_hil.recordings.recording import Array, Recording

_FEWEST_ROWS = 50
_SPANS = (200, 1000, 5000)  # parts of a recording over which the change of position is compared
_TOGETHER = 0.97  # correlation of two measurements of one motion
_APART = 0.5  # correlation of signals that do not belong together
_TREND = 0.7  # of both signals, where they move
_SAME = (0.8, 1.25)  # ratios that noise and delay explain
_CLOSE = 0.03  # relative distance from a known ratio
_CAUSES = (  # change of position over velocity times time
    (180.0 / math.pi, "position is in degrees, or velocity is 57.3 times too small", "position", "pi/180"),
    (math.pi / 180.0, "velocity is in degrees per second", "velocity", "pi/180"),
    (math.pi / 30.0, "velocity is in revolutions per minute", "velocity", "pi/30"),
    (6.0, "position is in degrees and velocity in revolutions per minute", "position", "pi/180"),
    (1.0 / 60.0, "position is in revolutions and velocity in revolutions per minute", "position", "2*pi"),
    (2.0 * math.pi, "velocity is in revolutions per second", "velocity", "2*pi"),
    (1.0 / (2.0 * math.pi), "position is in revolutions", "position", "2*pi"),
    (1000.0, "position is in thousandths (mm, mrad), or time in kiloseconds", "position", "0.001"),
    (0.001, "time is in milliseconds", TIME, "0.001"),
    (1e-6, "time is in microseconds", TIME, "1e-6"),
    (1e-9, "time is in nanoseconds", TIME, "1e-9"),
)
_SLOWEST_CLOCK_S = 0.05  # rows that are closer together have a time in seconds
_SLOWEST_ROWS_S = 0.5  # a log of a motion has more rows
_REGISTERS = (8, 16, 32)  # bits
_RARELY = 0.02  # of the rows
_STEPS = 0.15  # of a step: rounding of a register that was scaled
_FEWEST_LEVELS = 5
_MOVES = 0.2  # of the highest speed, above which the torque of a motion counts
_SHARE = 0.2  # of these rows in each direction, at least
_AGAINST = 0.3  # of the RMS torque, with the wrong sign in both directions


def contradictions(recording: Recording) -> list[str]:
    """Return what position, velocity and time say against each other, one sentence each."""
    found = _of_motion(recording)
    if not found and TIME in recording and recording.period_s > _SLOWEST_ROWS_S:
        found.append(
            f"the rows are {recording.period_s:.4g} s apart: if {TIME} is in milliseconds, "
            f"{option(recording, TIME, '0.001')}"
        )
    return found


def unsigned_register(recordings: Sequence[Recording], name: str = "torque") -> str:
    """Return a sentence if a column is a signed register that was read as an unsigned one; empty if it is not.

    Its negative values are near the top of its range, and hardly any are between; it may have been scaled since.
    """
    source, factor = parse_source(recordings[0].sources.get(name, name))
    raw = np.concatenate([each[name] for each in recordings if name in each]) / factor
    found = register_of(raw)
    if found is None:
        return ""
    text, own = found.source(source), factor * found.step
    text += "" if own == 1.0 else f"*{own:.10g}"
    what = "whole numbers" if found.step == 1.0 else f"multiples of {found.step:.6g}"
    return (
        f"the {name} is {what} from {np.nanmin(raw):.10g} to {np.nanmax(raw):.10g} and hardly any between: "
        f"a signed register of {found.bits} bits, logged as an unsigned one; give --column {name}='{text}'"
    )


def turned_torque(recording: Recording) -> str:
    """Return a sentence if the torque points against the motion in both directions, as no friction can; else empty.

    What pulls to one side, as gravity, is left out; what accelerates and what brakes the axis cancel in each direction.
    A torque that has lost the sign of its register points anywhere: it is read right first.
    """
    names = ("position", "torque") if "velocity" not in recording else ("velocity", "torque")
    if any(name not in recording for name in names) or unsigned_register([recording]):
        return ""
    motion, torque = (without_overflow(recording.columns[name]) for name in names)
    if names[0] == "position":
        motion = np.gradient(motion) if len(motion) > 1 else motion
    known = np.isfinite(motion) & np.isfinite(torque)
    if np.count_nonzero(known) < _FEWEST_ROWS:
        return ""
    motion, torque = motion[known], torque[known]
    least = _MOVES * float(np.quantile(np.abs(motion), 0.99))
    forth, back = torque[motion > least], torque[motion < -least]
    if min(len(forth), len(back)) < _SHARE * (len(forth) + len(back)) or not len(forth):
        return ""
    centre, friction = 0.5 * (forth.mean() + back.mean()), 0.5 * (forth.mean() - back.mean())
    size = math.sqrt(float(np.mean((np.concatenate([forth, back]) - centre) ** 2)))
    if not friction < -_AGAINST * size:
        return ""
    return "the torque points against the motion in both directions, as if friction drove the axis: its sign is turned"


@dataclass(frozen=True, slots=True)
class Register:
    """A signed register of ``bits`` bits that was logged as an unsigned one, and multiplied by ``step`` since."""

    bits: int
    step: float

    def source(self, column: str) -> str:
        """Return what reads the register from a column."""
        return f"{column}{'' if self.step == 1.0 else f'/{self.step:.6g}'}:int{self.bits}"


def register_of(values: Array) -> Register | None:
    """Return the register that was read without its sign; None if the values are no such one."""
    raw = values[np.isfinite(values)]
    if len(raw) < _FEWEST_LEVELS or np.any(raw < 0.0):
        return None
    top = float(np.max(raw))
    if not 0.0 < top < LARGEST or np.mean((raw > top / 3.0) & (raw < 0.75 * top)) >= _RARELY:
        return None
    step = _step(raw)
    if step is None:
        return None
    for bits in _REGISTERS:
        share = raw / step / 2.0**bits
        if np.any(share > 0.75) and np.all(share < 1.0) and np.mean((share > 0.25) & (share < 0.75)) < _RARELY:
            return Register(bits, step)
    return None


def _of_motion(recording: Recording) -> list[str]:
    names = (TIME, "position", "velocity")
    if any(name not in recording for name in names):
        return []
    time, position, velocity = (without_overflow(recording.columns[name]) for name in names)
    if recording.sources.get("velocity", "velocity") == recording.sources.get("position", "position"):
        return [f"position and velocity are the same column, {recording.sources['velocity']}"]
    known = np.isfinite(position) & np.isfinite(velocity)
    time, position, velocity = time[known], position[known], velocity[known]
    if len(time) < _FEWEST_ROWS or not (np.std(position) > 0.0 and np.std(velocity) > 0.0):
        return []
    if np.array_equal(position, velocity):
        return ["position and velocity hold the same numbers: one of them is the other signal"]
    compared = [_compared(time, position, velocity, parts) for parts in _SPANS]
    correlation, ratio, trend = max(compared, key=lambda each: abs(each[0]))
    if abs(correlation) < _APART and trend > _TREND:
        return [
            f"velocity and the change of position have little in common (correlation {correlation:.2g}): one of them "
            "is another signal, or decoded wrongly"
        ]
    if abs(correlation) < _TOGETHER or _SAME[0] <= ratio <= _SAME[1]:
        return []
    return [_sentence(recording, ratio)]


def _compared(time: Array, position: Array, velocity: Array, parts: int) -> tuple[float, float, float]:
    """Return correlation and ratio of the change of position and the integral of the velocity over parts."""
    steps = np.diff(time)
    period = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else math.nan
    is_usable = (steps > 0.0) & (steps <= GAP_PERIODS * period)
    travelled = np.where(is_usable, 0.5 * (velocity[1:] + velocity[:-1]) * steps, 0.0)
    moved = np.where(is_usable, np.diff(position), 0.0)
    moved = np.where(np.abs(moved) > 0.5 * np.ptp(position), 0.0, moved)  # wraps
    length = max(1, len(steps) // parts)
    count = len(steps) // length
    moved = moved[: count * length].reshape(count, length).sum(axis=1)
    travelled = travelled[: count * length].reshape(count, length).sum(axis=1)
    together, own = float(moved @ travelled), float(travelled @ travelled)
    size = math.sqrt(float(moved @ moved) * own)
    if not (size > 0.0 and math.isfinite(size)):
        return 1.0, 1.0, 0.0
    return together / size, together / own, min(_trend(moved), _trend(travelled))


def _trend(values: Array) -> float:
    """Return the correlation of neighbours, with the sum of squares: near 1 for a motion, about 0 for noise."""
    return float(values[1:] @ values[:-1]) / max(float(values @ values), 1e-300)


def _sentence(recording: Recording, ratio: float) -> str:
    size = abs(ratio)
    cause, column, factor = "the unit of one of them is wrong", "velocity", ""
    for known, text, name, conversion in _CAUSES:
        if abs(size / known - 1.0) < _CLOSE:
            cause, column, factor = text, name, conversion
    if column == TIME and recording.period_s < _SLOWEST_CLOCK_S:
        cause, column = "velocity is in thousandths (mm/s, mrad/s)", "velocity"
    if abs(size - 1.0) < _CLOSE:
        return (
            "the change of position is the velocity with the other sign: the sign of one of them is turned; "
            f"{option(recording, 'velocity', '-1')}"
        )
    sign = "" if ratio > 0.0 else ", and the sign of one of them is turned"
    hint = f"; {option(recording, column, factor)}" if factor else ""
    return f"the change of position is {ratio:.4g} times velocity times time: {cause}{sign}{hint}"


def option(recording: Recording, name: str, factor: str) -> str:
    """Return the option that multiplies a column by a factor."""
    source = recording.sources.get(name, name)
    text = f"--column {name}={source}*{factor}"
    return f"give {text}" if " " not in text.removeprefix("--column ") else f"give --column '{name}={source}*{factor}'"


def _step(raw: Array) -> float | None:
    """Return the step of a register: 1 for whole numbers, else what it was multiplied by; None if it is none."""
    whole = np.round(raw, 6)
    if np.all(whole == np.floor(whole)):
        return 1.0
    levels = np.unique(raw)
    if len(levels) < _FEWEST_LEVELS:
        return None
    gap = int(np.argmax(np.diff(levels))) + 1
    low = levels[:gap]
    if len(low) < _FEWEST_LEVELS:
        return None
    distances = np.diff(low)
    step = float(np.median(distances[distances < 1.5 * np.median(distances)]))
    for end in np.geomspace(4, len(levels), 24):  # each time as far as the step is known well enough
        used = levels[: int(end)]
        counts = np.round(used / step)
        if not np.any(counts > 0.0):
            continue
        step = float(counts @ used / (counts @ counts))
    counts = levels / step
    if (
        float(np.max(np.abs(counts - np.round(counts)))) > 0.5 - _STEPS
        and float(np.std(counts - np.round(counts))) > _STEPS
    ):
        return None
    return _rounded(step, levels)


def _rounded(step: float, levels: Array) -> float:
    """Return the shortest number that explains the levels as well as the step."""
    error = float(np.std(levels - step * np.round(levels / step)))
    for figures in range(1, 10):
        short = float(f"{step:.{figures}g}")
        if short > 0.0 and float(np.std(levels - short * np.round(levels / short))) <= 1.2 * error + 1e-12 * levels[-1]:
            return short
    return step
