"""What has changed in the friction of an axis, from its observations in the order of time. Pure."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.health import thresholds as th
from friction_hil.health.chart import Baseline, Chart, draw_chart, fit_baseline, threshold_for
from friction_hil.health.observation import RIPPLE, Layout, Observation, family, label, unit
from friction_hil.numerics.jit import Array

YEAR_S = 365.25 * 86400.0
_SIDES = 2

State = Literal["unchanged", "changed", "learning", "not shown"]


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Judgement on one quantity.

    Attributes
    ----------
    name, label, unit : str
    state : str
        ``unchanged``, ``changed``, ``learning`` the baseline, or ``not shown`` by the motion.
    reason : str
        Why it is not judged; empty if it is.
    times_s : (n,) array
        s since 1970.
    values, errors : (n,) array
        At the temperature of the baseline.
    baseline : float or None
    baseline_error : float or None
    slope, slope_error : float or None
        Change per K; None where temperature is not removed.
    change, change_error : float
        Of the mean since ``since_s``; 0 if unchanged.
    since_s, alarm_s : float or None
        Time of the first observation after the most likely step, and that of the alarm.
    level : float
        Larger one of the sums over the threshold: an alarm is given at 1.
    """

    name: str
    label: str
    unit: str
    state: State
    reason: str
    times_s: Array
    values: Array
    errors: Array
    baseline: float | None = None
    baseline_error: float | None = None
    slope: float | None = None
    slope_error: float | None = None
    change: float = 0.0
    change_error: float = 0.0
    since_s: float | None = None
    alarm_s: float | None = None
    level: float = 0.0

    @property
    def share(self) -> float | None:
        """Change over baseline; None if either is not known, or the baseline is near zero."""
        if self.state != "changed" or self.baseline is None or self.baseline_error is None:
            return None
        is_known = abs(self.baseline) > th.KNOWN_BASELINE * self.baseline_error
        return self.change / abs(self.baseline) if is_known else None


@dataclass(frozen=True, slots=True, eq=False)
class Health:
    """Judgement on an axis.

    Attributes
    ----------
    axis : str
    layout : Layout
    verdicts : tuple of Verdict
    notes : tuple of str
        What limits the judgement.
    count : int
        Observations that are compared.
    """

    axis: str
    layout: Layout
    verdicts: tuple[Verdict, ...]
    notes: tuple[str, ...]
    count: int

    @property
    def changed(self) -> tuple[Verdict, ...]:
        """Quantities with an alarm, that of the largest sum first."""
        return tuple(sorted((v for v in self.verdicts if v.state == "changed"), key=lambda v: -v.level))

    @property
    def is_judged(self) -> bool:
        """True if any quantity is compared with a baseline and has an observation after it."""
        return any(each.state in ("unchanged", "changed") for each in self.verdicts)


@dataclass(frozen=True, slots=True, eq=False)
class _Series:
    name: str
    times: Array
    values: Array
    errors: Array
    temperatures: Array  # NaN where not known


def judge(
    axis: str,
    observations: Sequence[Observation],
    layout: Layout,
    *,
    baseline: int = th.BASELINE,
    false_alarms: float = th.FALSE_ALARMS,
) -> Health:
    """Compare the observations of an axis with the first ones.

    Parameters
    ----------
    axis : str
    observations : sequence of Observation
    layout : Layout
        That of the observations.
    baseline : int
        Number of observations of a quantity that are its baseline.
    false_alarms : float
        Largest expected number of false alarms in a year, of all quantities of the axis together.

    Raises
    ------
    UsageError
        The baseline is too short, or the number of false alarms is none.
    """
    if baseline < th.LEAST_BASELINE:
        raise UsageError(f"a baseline needs {th.LEAST_BASELINE} observations or more, not {baseline}")
    if not 0.0 < false_alarms < math.inf:
        raise UsageError(f"false alarms per year are a number above 0, not {false_alarms:g}")
    notes: list[str] = []
    kept = _similar(sorted(observations, key=lambda each: each.time_s), baseline, notes)
    names = dict.fromkeys(name for each in observations for name in (*each.quantities, *each.not_shown))
    series = [_series(name, kept) for name in names]
    judged = sum(len(each.values) > baseline for each in series)
    threshold = _threshold(kept, judged, false_alarms)
    uses_temperature = _note_temperature(kept[:baseline], notes)
    verdicts = tuple(_verdict(each, kept, layout, baseline, threshold, uses_temperature) for each in series)
    if not observations:
        notes.append("no observation: no recording shows the axis sliding for long enough")
    return Health(axis, layout, verdicts, tuple(notes), len(kept))


def _similar(observations: list[Observation], baseline: int, notes: list[str]) -> list[Observation]:
    """Return the observations of similar motion; others cannot be compared, because no friction is a straight line."""
    if not observations:
        return []
    first = observations[:baseline]
    speed = statistics.median(each.motion.speed for each in first)
    travel = statistics.median(each.motion.travel for each in first)

    def is_similar(each: Observation) -> bool:
        pairs = ((each.motion.speed, speed), (each.motion.travel, travel))
        return all(a <= th.SIMILAR * b and b <= th.SIMILAR * a for a, b in pairs)

    kept = [each for each in observations if is_similar(each)]
    if len(kept) < len(observations):
        other = next(each for each in observations if not is_similar(each))
        notes.append(
            f"{len(observations) - len(kept)} of {len(observations)} observations have another motion than the first "
            f"ones (e.g. {other.source}: median speed {other.motion.speed:.3g} against {speed:.3g}, travel "
            f"{other.motion.travel:.3g} against {travel:.3g}) and are not compared"
        )
    return kept


def _series(name: str, observations: Sequence[Observation]) -> _Series:
    rows = [
        (each.time_s, each.quantities[name].value, each.quantities[name].error, each.temperature)
        for each in observations
        if name in each.quantities
    ]
    columns = list(zip(*rows, strict=True)) if rows else [(), (), (), ()]
    times, values, errors = (np.array(column, dtype=float) for column in columns[:3])
    known = np.array([math.nan if each is None else each for each in columns[3]], dtype=float)
    return _Series(name, times, values, errors, known)


def _threshold(observations: Sequence[Observation], judged: int, false_alarms: float) -> float:
    """Return the threshold at which all sums together give so many false alarms per year."""
    if len(observations) < 2 or not judged:
        return math.inf
    span = observations[-1].time_s - observations[0].time_s
    per_year = YEAR_S / max(span / (len(observations) - 1), th.LEAST_INTERVAL_S)
    return threshold_for(max(_SIDES * judged * per_year / false_alarms, 2.0))


def _note_temperature(first: Sequence[Observation], notes: list[str]) -> bool:
    """Return True if temperature can be removed; otherwise a note says why not."""
    known = [each.temperature for each in first if each.temperature is not None]
    if len(known) < len(first):
        what = "is not recorded" if not known else f"is recorded in {len(known)} of the first {len(first)} observations"
        notes.append(f"the temperature {what}: its effect is not removed, and may look like a change")
        return False
    return bool(first)


def _verdict(
    series: _Series,
    observations: Sequence[Observation],
    layout: Layout,
    baseline: int,
    threshold: float,
    uses_temperature: bool,
) -> Verdict:
    kind = layout.kind
    words, units = label(series.name, layout), unit(series.name, kind)
    if uses_temperature:
        is_known = np.isfinite(series.temperatures)
        series = _Series(
            series.name,
            *(each[is_known] for each in (series.times, series.values, series.errors, series.temperatures)),
        )
    count = len(series.values)
    own = (series.times, series.values, series.errors)
    if not count:
        how = next(
            (each.not_shown[series.name] for each in reversed(observations) if series.name in each.not_shown), ""
        )
        return Verdict(series.name, words, units, "not shown", how or "no observation shows it", *own)
    if count <= baseline:
        return Verdict(series.name, words, units, "learning", f"{count} of {baseline + 1} observations", *own)
    # the amplitude of noise has Rayleigh's distribution; its root is nearly normal (Weibull's of shape 4)
    is_amplitude = family(series.name) == RIPPLE
    values, errors = _rooted(series.values, series.errors) if is_amplitude else (series.values, series.errors)
    temperatures = series.temperatures if uses_temperature else np.zeros(count)
    known = fit_baseline(values[:baseline], errors[:baseline], temperatures[:baseline] if uses_temperature else None)
    chart = draw_chart(known, values[baseline:], errors[baseline:], temperatures[baseline:], threshold)
    return _judged(series, known, chart, temperatures, baseline, is_amplitude, words, units)


def _judged(
    series: _Series,
    known: Baseline,
    chart: Chart,
    temperatures: Array,
    baseline: int,
    is_amplitude: bool,
    words: str,
    units: str,
) -> Verdict:
    value, value_error, change, change_error = known.value, known.error, chart.change, chart.change_error
    slope, slope_error = known.slope, known.slope_error
    if is_amplitude:  # back from roots to amplitudes
        now = max(value + change, 0.0)
        change_error, change = 2.0 * now * change_error, now**2 - value**2
        scale = 2.0 * abs(value)
        value, value_error = value**2, scale * value_error
        slope, slope_error = scale * slope, scale * slope_error
    times = series.times[baseline:]
    has_slope = known.temperature is not None
    removed = slope * (temperatures - known.temperature) if known.temperature is not None else 0.0
    has_alarm = chart.sign != 0
    return Verdict(
        series.name,
        words,
        units,
        "changed" if has_alarm else "unchanged",
        "",
        series.times,
        series.values - removed,
        series.errors,
        baseline=value,
        baseline_error=value_error,
        slope=slope if has_slope else None,
        slope_error=slope_error if has_slope else None,
        change=change if has_alarm else 0.0,
        change_error=change_error if has_alarm else 0.0,
        since_s=float(times[chart.begin]) if has_alarm else None,
        alarm_s=float(times[chart.alarm]) if has_alarm else None,
        level=float(max(chart.upper[-1], chart.lower[-1])) / chart.threshold,
    )


def _rooted(values: Array, errors: Array) -> tuple[Array, Array]:
    roots = np.sqrt(np.maximum(values, 0.0))
    return roots, errors / (2.0 * np.sqrt(np.maximum(np.maximum(values, errors), 1e-300)))
