"""The pipeline from a recording to evenly sampled segments with velocity and acceleration. Pure.

Replay, identification, training and tuning all use it: required columns, even grid (`even_grid`), choice of the
velocity, low-pass, derivatives. They differ in what they ask of it and in what they do with the segments.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from friction_hil.errors import RecordingError, UsageError
from friction_hil.numerics import filtering
from friction_hil.numerics.jit import Array
from friction_hil.recordings.columns import TIME
from friction_hil.recordings.contradictions import contradictions, option, turned_torque, unsigned_register
from friction_hil.recordings.even import EvenGrid, even_grid
from friction_hil.recordings.quality import GAP_PERIODS, acceleration_noise, is_coarse, resolution, without_overflow
from friction_hil.recordings.recording import Recording

_LONGEST_DELAY_S = 1.0  # of a torque that a driver reads late
INTEGRATED = "velocity, integrated"  # source of a position that no file has
_DEFAULT_DECIMATION, _ROWS_TO_KEEP = 10, 1000  # 1 in 10, or more where fewer rows would be left
DEFAULT_LOWPASS_RATIO = 0.1  # of the sampling rate, where the velocity is derived from the position
_LEAST_LOWPASS_RATIO = 0.01  # where the encoder is coarse
_LOWPASS_STEP = 0.85
NOISE_RATIO = 0.2  # of the acceleration, that counts may make: an inertia becomes too small by the square of it
LEAST_KNOWN_FRACTION = 0.9  # of the rows: a slow input with fewer values is not used
_FINER = 0.25  # of the counts' noise: a velocity with more is that of counts, or of less than two bits more
_MOST_ROUNDING = 1.5  # of the noise of rounded positions: more is motion
_FAST = 2.0  # counts per sample: from there on a count says no more about time than the sample itself
_LEAST_FRACTION = 0.5  # of the samples that are slower: fewer, and the encoder is not coarse


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Evenly sampled part of a recording without a gap; arrays (n,), SI."""

    path: str
    axis: str
    time_s: Array
    position: Array  # low-passed if `lowpass_hz` is set
    velocity: Array  # as recorded, or the central differences of `position`
    acceleration: Array  # central differences of `velocity`
    torque: Array  # measured, not filtered
    load_torque: Array | None  # slow inputs and position demand are not filtered; None where they are not known
    temperature: Array | None
    demand: Array | None
    rate_hz: float  # of sampling
    lowpass_hz: float | None  # cut-off of the zero-phase low-pass; None where the recorded velocity is used as it is
    encoder: Array  # measured position, not filtered

    @property
    def dt(self) -> float:
        """Sampling period, s."""
        return 1.0 / self.rate_hz

    def lowpass(self, values: Array) -> Array:
        """Apply the low-pass of the position to (n,) or (n, m) values; return them unchanged if there is none."""
        return values if self.lowpass_hz is None else filtering.lowpass(values, self.lowpass_hz, self.rate_hz)

    def lowpassed(self) -> "Segment":
        """Return the segment with torque and slow inputs low-passed as the position is."""
        if self.lowpass_hz is None:
            return self
        return replace(
            self,
            torque=self.lowpass(self.torque),
            load_torque=None if self.load_torque is None else self.lowpass(self.load_torque),
            temperature=None if self.temperature is None else self.lowpass(self.temperature),
        )


@dataclass(frozen=True, slots=True, eq=False)
class EvenSignals:
    """A recording on an even grid, and the low-pass that its velocity needs."""

    recording: Recording
    grid: EvenGrid
    lowpass_hz: float | None  # cut-off of the zero-phase low-pass; None if the recorded velocity is used as it is
    # defects of the columns and their treatment, without the messages of the recording itself
    problems: tuple[str, ...]

    @property
    def longest(self) -> int:
        """Number of rows of the longest segment."""
        return int(max(rows.stop - rows.start for rows in self.grid.segments))

    @property
    def settling_rows(self) -> int:
        """Rows at either end of a segment in which the low-pass has not settled."""
        return 0 if self.lowpass_hz is None else filtering.settling_samples(self.lowpass_hz, self.grid.rate_hz)

    def segment(self, rows: slice) -> Segment:
        """Return one of ``grid.segments`` with velocity and acceleration."""
        rate_hz = self.grid.rate_hz
        columns = {name: np.ascontiguousarray(values[rows]) for name, values in self.grid.columns.items()}
        position = columns["position"]
        if self.lowpass_hz is not None:
            position = filtering.lowpass(between_counts(position), self.lowpass_hz, rate_hz)
        velocity = columns["velocity"] if "velocity" in columns else np.gradient(position, 1.0 / rate_hz)
        return Segment(
            path=self.recording.path,
            axis=self.recording.axis,
            time_s=self.grid.time_s[rows],
            position=position,
            velocity=velocity,
            acceleration=np.gradient(velocity, 1.0 / rate_hz),
            torque=columns["torque"],
            load_torque=columns.get("load_torque"),
            temperature=columns.get("temperature"),
            demand=columns.get("position_demand"),
            rate_hz=rate_hz,
            lowpass_hz=self.lowpass_hz,
            encoder=columns["position"],
        )


def with_position(recording: Recording) -> Recording:
    """Return the recording; without a position, one that is integrated from the velocity, from an unknown start.

    Raises `RecordingError`: there is neither a position nor a velocity.
    """
    if "position" in recording or "velocity" not in recording:
        recording.require("position")
        return recording
    time, velocity = recording[TIME], without_overflow(recording["velocity"])
    steps = np.diff(time)
    period = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    is_usable = (steps > 0.0) & (steps <= GAP_PERIODS * period)
    moved = np.where(is_usable, 0.5 * (velocity[1:] + velocity[:-1]) * steps, 0.0)
    position = np.concatenate([[0.0], np.cumsum(np.nan_to_num(moved))])
    columns = recording.columns | {"position": np.where(np.isfinite(velocity), position, np.nan)}
    note = "no position: integrated from the velocity; nothing that depends on the position is identified"
    sources = recording.sources | {"position": INTEGRATED}
    return replace(recording, columns=columns, problems=[*recording.problems, note], sources=sources)


def is_position_integrated(recording: Recording) -> bool:
    """True if the position is that of `with_position`."""
    return recording.sources.get("position") == INTEGRATED


def known_fraction(recording: Recording, name: str) -> float:
    """Return the fraction of rows in which a column has a value; 0 if there is no such column."""
    return float(np.mean(np.isfinite(without_overflow(recording[name])))) if name in recording else 0.0


def default_decimation(rows: int) -> int:
    """Return the decimation of the torques that identification, training and replay compare, where none is given."""
    return min(_DEFAULT_DECIMATION, max(1, rows // _ROWS_TO_KEEP))


def even_signals(
    recording: Recording,  # with `position` and `torque`
    held: Sequence[str] = (),  # columns that change slowly, to be interpolated over gaps of their own
    *,
    # cut-off of a 4th-order Butterworth low-pass, forward and backward; without it, where the velocity has to be
    # derived, `DEFAULT_LOWPASS_RATIO` of the sampling rate, or less as far as the encoder is coarse for the motion
    lowpass_hz: float | None = None,
    is_torque_delay_removed: bool = False,  # by moving the torque back as the driver stated in the recording
) -> EvenSignals:
    """Bring a recording to an even grid and decide where its velocity comes from.

    The recorded velocity is used unless it is absent, so coarse that it mostly stands still, as noisy as the counts of
    the position, or a low-pass is asked for. It is then derived from the low-passed position. Raises `RecordingError`:
    a column is missing, no part has three rows, or the drive does not report its torque; `UsageError`: the low-pass
    does not fit the sampling rate.
    """
    recording = with_position(recording)
    recording.require("torque")
    why_derived = _why_velocity_is_derived(recording) if lowpass_hz is None else ""
    has_velocity = lowpass_hz is None and not why_derived
    grid = even_grid(recording, ["position", "torque", *(["velocity"] if has_velocity else [])], held)
    problems = list(grid.problems)
    if has_velocity and not is_position_integrated(recording) and _is_velocity_of_counts(grid):
        has_velocity, why_derived = False, "velocity is as coarse as the counts of the position"
        del grid.columns["velocity"]
    if has_velocity and not is_position_integrated(recording):
        problems += contradictions(recording)
    if text := unsigned_register([recording]):
        problems.append(text)
    if text := turned_torque(recording):
        problems.append(f"{text}; {option(recording, 'torque', '-1')}")
    if is_torque_delay_removed and (delay_s := stated_torque_delay_s(recording)):
        problems.append(f"the drive's torque was read {1e3 * delay_s:.3g} ms late: moved back by as much")
        _move_torque_back(grid, delay_s)
    if why_derived:
        lowpass_hz = _derived_lowpass_hz(grid)
        problems.append(f"{why_derived}: derived from the position below {lowpass_hz:.4g} Hz")
    if lowpass_hz is not None and not 0.0 < lowpass_hz < grid.rate_hz / 2.0:
        raise UsageError(
            f"{recording.path}: a low-pass lies above 0 and below half the sampling rate, {grid.rate_hz / 2.0:.6g} Hz, "
            f"not at {lowpass_hz:g} Hz"
        )
    return EvenSignals(recording, grid, lowpass_hz, tuple(problems))


def _derived_lowpass_hz(grid: EvenGrid) -> float:
    """Return the cut-off below which the counts of the encoder make little of the acceleration."""
    rate, position = grid.rate_hz, max((grid.columns["position"][rows] for rows in grid.segments), key=len)
    cut_hz, step = DEFAULT_LOWPASS_RATIO * rate, resolution(position)
    if step is None or len(position) <= filtering.lowpass_padding():
        return cut_hz
    smooth = between_counts(position)
    while cut_hz > _LEAST_LOWPASS_RATIO * rate:
        acceleration = np.gradient(np.gradient(filtering.lowpass(smooth, cut_hz, rate), 1.0 / rate), 1.0 / rate)
        if acceleration_noise(step, cut_hz, rate) <= NOISE_RATIO * float(np.std(acceleration)):
            break
        cut_hz *= _LOWPASS_STEP
    return cut_hz


def _why_velocity_is_derived(recording: Recording) -> str:
    """Return the reason why the recorded velocity cannot be used; empty if it can."""
    if "velocity" not in recording:
        return "no velocity"
    velocity = without_overflow(recording["velocity"])
    if is_coarse(velocity):
        return f"velocity comes in steps of {resolution(velocity):.4g}, and mostly stands still"
    return ""


def _is_velocity_of_counts(grid: EvenGrid) -> bool:
    """Return True if the recorded velocity has the noise of the position's counts.

    The drive has then made it of these counts: behind its low-pass their steps are no multiples of a count any more,
    but they are nearly as large, and late.
    """
    rate, rows = grid.rate_hz, max(grid.segments, key=lambda each: each.stop - each.start)
    position, velocity = grid.columns["position"][rows], grid.columns["velocity"][rows]
    step = resolution(position)
    if step is None or len(position) <= filtering.lowpass_padding():
        return False
    # higher differences remove the motion, and keep noise
    counts, own = float(np.std(np.diff(position, 4))) * rate, float(np.std(np.diff(velocity, 3)))
    rounding = step * rate * math.sqrt(70.0 / 12.0)  # of fourth differences with the coefficients 1 -4 6 -4 1
    return counts < _MOST_ROUNDING * rounding and own > _FINER * counts


def stated_torque_delay_s(recording: Recording) -> float | None:
    """Return by how much the torque is older than the position in the same row, s; None if no driver stated it.

    Raises `RecordingError`: the drive does not report its torque.
    """
    facts = recording.metadata.get("facts")
    known = [each for each in facts if isinstance(each, dict)] if isinstance(facts, list) else []
    own = next((each for each in known if each.get("name") == recording.axis), {})
    delay_s = own.get("torque_delay_s")
    if "torque_delay_s" in own and delay_s is None and not recording["torque"].any():
        raise RecordingError(
            f"{recording.path}: the drive of axis {recording.axis} does not report its torque; in mode cst the command "
            "is nearly that: --column torque=command"
        )
    return float(delay_s) if isinstance(delay_s, int | float) and 0.0 <= delay_s <= _LONGEST_DELAY_S else None


def _move_torque_back(grid: EvenGrid, delay_s: float) -> None:
    """Replace the torque of a grid by the one that is read ``delay_s`` later, s."""
    torque = grid.columns["torque"] = grid.columns["torque"].copy()
    for rows in grid.segments:
        torque[rows] = np.interp(grid.time_s[rows] + delay_s, grid.time_s[rows], torque[rows])


def between_counts(position: Array) -> Array:
    """Return a position (n,), rad or m, with the time between counts used instead of their rounding.

    When a coarse encoder changes by one count, the axis is at the edge between the two counts, to within its travel in
    a sample. Between edges the position is interpolated without overshoot, so that a slow motion shows no staircase.
    Where the axis moves by several counts per sample the samples are kept.

    ``position`` is evenly sampled. It is returned as it is if its values are not quantised, or the encoder is not
    coarse for this motion.

    Source of the interpolation: F. N. Fritsch, J. Butland, SIAM Journal on Scientific and Statistical Computing 5(2),
    1984, as `scipy.interpolate.PchipInterpolator`. Of time stamps of edges: R. J. E. Merry, M. J. G. van de Molengraft,
    M. Steinbuch, Mechatronics 20(1), 2010.
    """
    step = resolution(position)
    if step is None:
        return position
    counts = np.round((position - position[0]) / step)
    moves = np.diff(counts)
    is_fast = np.abs(moves) >= _FAST
    edges = np.flatnonzero(np.abs(moves) == 1.0)
    if np.mean(~is_fast) < _LEAST_FRACTION or len(edges) < 2:
        return position
    from scipy.interpolate import PchipInterpolator  # imported here: few recordings need it

    samples = np.flatnonzero(np.append(is_fast, [False]) | np.append([False], is_fast))
    time = np.concatenate([edges + 0.5, samples])
    value = np.concatenate([0.5 * (counts[edges] + counts[edges + 1]), counts[samples]])
    order = np.argsort(time)
    inside = np.clip(np.arange(len(position)), time[order[0]], time[order[-1]])
    smooth: Array = position[0] + step * PchipInterpolator(time[order], value[order])(inside)
    return smooth
