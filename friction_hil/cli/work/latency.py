"""The work of ``friction-hil latency``."""

import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import new_table, number, print_table, say
from friction_hil.config import Realtime, load
from friction_hil.daemon.latency import (
    INSTALL_CYCLICTEST,
    Latency,
    cyclictest,
    has_cyclictest,
    is_fifo_allowed,
    measure,
)
from friction_hil.daemon.realtime import RealClock, punctuality
from friction_hil.drive.finding import complaints
from friction_hil.reports.figures import new_figure_for, save
from friction_hil.reports.latency_picture import draw_latency

_PERIOD_S = 1e-3
_SHORTEST_S, _LONGEST_S = 1e-4, 1.0  # periods of the loop
_MOST_DURATION_S = 3600.0  # each wake-up is kept
_BAR = 30  # characters
_BINS_US = tuple(digit * 10.0**power for power in range(6) for digit in (1, 2, 5))
NO_CYCLICTEST = f"cyclictest is not installed, so there is nothing to compare with: {INSTALL_CYCLICTEST}"


def run_latency(
    *,
    config: Path | None,
    period_s: float | None,
    spin_us: int | None,
    priority: int | None,
    duration_s: float,
    output: Path | None,
    as_json: bool,
) -> int:
    """Measure the wake-up latency and print it; return 0 whatever it is."""
    configuration = None if config is None else load(config, needs_models=False)
    realtime = Realtime() if configuration is None else configuration.realtime
    if period_s is None:
        period_s = _PERIOD_S if configuration is None else configuration.period_s
    spin_us = realtime.spin_us if spin_us is None else spin_us
    priority = realtime.priority if priority is None else priority
    _check(period_s, spin_us, duration_s)
    if output is not None:
        new_figure_for(output, 1.0, 1.0)  # a wrong suffix is refused before the measurement
    cycles = max(1, round(duration_s / period_s))
    found = _measure_all(period_s, spin_us, priority, cycles)
    if output is not None:
        save(draw_latency(found, period_s), output)
    granted = priority if priority and is_fifo_allowed(priority) else 0
    if as_json:
        print_json(_summary(found, period_s, granted, output))
        return 0
    scheduling = f"SCHED_FIFO priority {granted}" if granted else "ordinary scheduling"
    click.echo(f"{cycles} wake-ups of each, {period_s * 1e3:g} ms apart; {scheduling}")
    _print(found)
    if not has_cyclictest():
        say(f"note: {NO_CYCLICTEST}", stderr=False)
    worst = next(iter(found.values())).max_us
    click.echo(f"the loop woke up at most {worst:.0f} µs late: {100e-6 * worst / period_s:.3g} % of its period")
    if output is not None:
        click.echo(f"picture: {output}")
    return 0


def _check(period_s: float, spin_us: int, duration_s: float) -> None:
    """Refuse what the loop does not take either."""
    if not _SHORTEST_S <= period_s <= _LONGEST_S:
        raise click.BadParameter(f"must be between {_SHORTEST_S:g} and {_LONGEST_S:g} s", param_hint="--period")
    if not 0 <= spin_us < 1e6 * period_s:
        raise click.BadParameter(f"must be below the period, {1e6 * period_s:g} µs", param_hint="--spin")
    if not (math.isfinite(duration_s) and 0.0 < duration_s <= _MOST_DURATION_S):
        raise click.BadParameter(f"must be above 0 and at most {_MOST_DURATION_S:g} s", param_hint="--duration")


def _measure_all(period_s: float, spin_us: int, priority: int, cycles: int) -> dict[str, Latency]:
    """Measure one after the other, the loop as it is configured first."""
    clocks = {f"loop, spin {spin_us} µs": spin_us, "loop, no spin": 0}
    if not spin_us:
        del clocks[f"loop, spin {spin_us} µs"]
    found: dict[str, Latency] = {}
    with punctuality(priority) as findings:
        for line in complaints(findings):
            say(line)
        for name, spin in clocks.items():
            _announce(name, cycles * period_s)
            found[name] = measure(RealClock(spin), period_s, cycles)
    if has_cyclictest():
        _announce("cyclictest", cycles * period_s)
        granted = priority if priority and is_fifo_allowed(priority) else 0
        found["cyclictest"] = cyclictest(granted, period_s, cycles)
    return found


def _announce(name: str, duration_s: float) -> None:
    """Say what is measured now; a live line would need a thread, which the loop does not have either."""
    if sys.stderr.isatty():
        say(f"measuring for {duration_s:.3g} s: {name}")


def _summary(found: Mapping[str, Latency], period_s: float, priority: int, output: Path | None) -> dict[str, Any]:
    return {
        "period_s": period_s,
        "priority": priority,
        "measurements": [
            {
                "name": name,
                "wake_ups": len(each.late_us),
                "p50_us": each.percentile_us(0.5),
                "p99_us": each.percentile_us(0.99),
                "max_us": each.max_us,
                "missed": each.missed,
                "histogram": {"from_us": [0.0, *_BINS_US], "wake_ups": each.histogram((0.0, *_BINS_US))},
            }
            for name, each in found.items()
        ],
        "note": None if has_cyclictest() else NO_CYCLICTEST,
        "picture": output,
    }


def _print(found: Mapping[str, Latency]) -> None:
    """Print the figures, then the histogram, with bars for the loop as it is configured."""
    table = new_table("late by", *map(number, ("p50 [µs]", "p99 [µs]", "max [µs]", "missed")))
    for name, each in found.items():
        figures = (each.percentile_us(0.5), each.percentile_us(0.99), each.max_us)
        table.add_row(name, *(f"{figure:.1f}" for figure in figures), str(each.missed))
    print_table(table)
    click.echo()
    edges = (0.0, *_BINS_US)
    counts = {name: each.histogram(edges) for name, each in found.items()}
    used = [k for k in range(len(edges)) if any(count[k] for count in counts.values())]
    bars = next(iter(counts.values()))
    histogram = new_table(number("from µs"), *map(number, found), "loop (logarithmic)")
    for k in range(used[0], used[-1] + 1):
        histogram.add_row(f"{edges[k]:g}", *(str(count[k]) for count in counts.values()), _bar(bars[k], max(bars)))
    print_table(histogram)


def _bar(count: int, most: int) -> str:
    """Return a bar, logarithmic: a single wake-up must be seen beside a million others."""
    return "" if not count else "█" * max(1, round(_BAR * math.log1p(count) / math.log1p(most)))
