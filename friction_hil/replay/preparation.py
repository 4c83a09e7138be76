"""Preparation of a recording for replay: low-passed segments, and their reduction to the compared rows. Pure."""

import itertools
from collections.abc import Sequence

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.numerics.filtering import (
    SETTLING_PERIODS,
    decimate,
    decimated_rows,
    decimation_padding,
    lowpass_padding,
)
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.segments import (
    LEAST_KNOWN_FRACTION,
    EvenSignals,
    Segment,
    default_decimation,
    even_signals,
    known_fraction,
    with_position,
)


def replay_segments(
    recording: Recording, lowpass_hz: float | None = None, factor: int | None = 1
) -> tuple[list[Segment], int, list[str]]:
    """Bring a recording to low-passed segments that are long enough for the filters; see `replay` of `comparison`.

    Returns the segments, the rows at either end of each in which the low-pass has not settled, and messages about
    defects of the recording and their treatment. ``factor``: decimation that is to follow; that of identification by
    default. Raises what `friction_hil.replay.comparison.replay` does.
    """
    recording = with_position(recording)
    recording.require("torque")
    problems = list(recording.problems)
    inputs = _known_inputs(recording, problems)
    signals = even_signals(recording, inputs, lowpass_hz=lowpass_hz, is_torque_delay_removed=True)
    problems += signals.problems
    rows = _long_enough(signals, default_decimation(signals.longest) if factor is None else factor, problems)
    return [signals.segment(each).lowpassed() for each in rows], signals.settling_rows, problems


class Reduction:
    """Reduction of the segments to the rows that are compared: settled ends removed, decimated, joined."""

    def __init__(self, settling: int, factor: int) -> None:
        self._settling, self._factor = settling, factor

    def __call__(self, values: Sequence[Array]) -> Array:
        """Reduce one (n,) array of each segment to (m,)."""
        return _joined([decimate(self._settled(each), self._factor) for each in values])

    def time_s(self, segments: Sequence[Segment]) -> Array:
        """Return the time stamps (m,) of the rows that are kept, s."""
        inner = [self._settled(each.time_s) for each in segments]
        return _joined([each[decimated_rows(len(each), self._factor)] for each in inner])

    def rows(self, segments: Sequence[Segment]) -> tuple[slice, ...]:
        """Return the rows of each segment after the reduction."""
        counts = [len(range(0, len(self._settled(each.time_s)), self._factor)) for each in segments]
        ends = np.cumsum([0, *counts]).tolist()
        return tuple(slice(begin, end) for begin, end in itertools.pairwise(ends))

    def _settled(self, values: Array) -> Array:
        return values[self._settling : len(values) - self._settling]


def _known_inputs(recording: Recording, problems: list[str]) -> list[str]:
    """Return the slow inputs that are used; report a load with too few values."""
    known = [name for name in ("load_torque", "temperature") if name in recording]
    fraction = known_fraction(recording, "load_torque")
    if "load_torque" in known and fraction < LEAST_KNOWN_FRACTION:
        known.remove("load_torque")
        problems.append(f"load_torque is known in {100.0 * fraction:.0f} % of the rows: not used")
    return known


def _long_enough(signals: EvenSignals, factor: int, problems: list[str]) -> list[slice]:
    """Return the segments in which low-pass and decimation settle; report the others."""
    path, segments = signals.recording.path, list(signals.grid.segments)
    if signals.lowpass_hz is not None:
        periods = SETTLING_PERIODS * signals.grid.rate_hz / signals.lowpass_hz
        segments = _split_off_short(
            signals,
            segments,
            max(lowpass_padding() + 1, 2.0 * periods),
            f"a low-pass at {signals.lowpass_hz:.4g} Hz",
            problems,
        )
        if not segments:
            raise RecordingError(
                f"{path}: {signals.longest} rows without a gap are too few for a low-pass at {signals.lowpass_hz:g} "
                f"Hz, which takes {SETTLING_PERIODS:g} periods to settle at either end"
            )
    shortest = 2 * signals.settling_rows + 1
    if factor > 1:
        shortest += max(factor, decimation_padding())
    longest = max(rows.stop - rows.start for rows in segments)
    segments = _split_off_short(signals, segments, shortest + 1, "these filters", problems)
    if not segments:
        raise RecordingError(
            f"{path}: {longest} rows without a gap are too few for these filters, which take {shortest} to settle"
        )
    return segments


def _split_off_short(
    signals: EvenSignals, segments: Sequence[slice], fewest: float, filters: str, problems: list[str]
) -> list[slice]:
    """Return the segments of at least ``fewest`` rows; report the others."""
    kept = [rows for rows in segments if rows.stop - rows.start >= fewest]
    time = signals.grid.time_s
    problems += [
        f"the part from {time[rows.start]:.6g} s to {time[rows.stop - 1]:.6g} s has {rows.stop - rows.start} rows, "
        f"too few for {filters}: left out"
        for rows in segments
        if rows not in kept
    ]
    return kept


def _joined(parts: Sequence[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
