"""Picture of the wake-up latency: how many wake-ups were late by how much."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from friction_hil.daemon.latency import Latency
from friction_hil.reports.figures import BLUE, FAULT, GREEN, GREY, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = (BLUE, GREEN, GREY)
_BINS = 120
_SHORTEST_US = 0.1


def draw_latency(found: Mapping[str, Latency], period_s: float) -> "Figure":
    """Draw a histogram with logarithmic axes of each measurement, by name, and the period of the loop, s."""
    figure = new_figure(9.0, 5.0)
    axes = figure.subplots()
    period_us = 1e6 * period_s
    longest = max(period_us, *(each.max_us for each in found.values()))
    edges = np.geomspace(_SHORTEST_US, 1.2 * longest, _BINS + 1)
    for (name, each), colour in zip(found.items(), _COLOURS, strict=False):
        counts = np.histogram(np.maximum(each.late_us, edges[0]), edges)[0]
        label = (
            f"{name}: p50 {each.percentile_us(0.5):.1f}, p99 {each.percentile_us(0.99):.1f}, max {each.max_us:.0f} µs"
        )
        axes.stairs(counts, edges, color=colour, label=label)
    axes.axvline(period_us, color=FAULT, linestyle="--", linewidth=1.0, label=f"period, {period_us:g} µs")
    axes.set(xscale="log", yscale="log", xlabel="wake-up after the deadline [µs]", ylabel="wake-ups", ylim=(0.7, None))
    axes.legend()
    figure.suptitle("Wake-up latency of the loop")
    return figure
