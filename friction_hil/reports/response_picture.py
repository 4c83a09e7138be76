"""Picture of a frequency response: gain, phase and coherence."""

from typing import TYPE_CHECKING, Any

import numpy as np

from friction_hil.identification.frequency_response import FrequencyResponse
from friction_hil.identification.resonance import Resonance, two_mass_response
from friction_hil.reports.figures import MEASURED, PREDICTED, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_POINTS = 1000  # of the fitted line
_UNUSED = "0.85"  # grey


def draw_response(response: FrequencyResponse, resonance: Resonance | None) -> "Figure":
    """Draw gain, phase and coherence over the frequency, and the two masses that were fitted, if any."""
    figure = new_figure(11.0, 7.0)
    gain, phase, coherence = figure.subplots(3, 1, sharex=True, height_ratios=[2, 1, 1])
    frequency, used = response.frequency_hz, response.is_used
    degrees = np.degrees(np.angle(response.response))
    panels: tuple[tuple[Any, Any], ...] = (
        (gain, np.abs(response.response)),
        (phase, degrees),
        (coherence, response.coherence),
    )
    for axes, values in panels:
        axes.plot(frequency[~used], values[~used], ".", color=_UNUSED, markersize=3.0)
        axes.plot(frequency[used], values[used], ".", color=MEASURED, markersize=5.0)
    if resonance is not None:
        low, high = response.band_hz
        line = np.geomspace(low, high, _POINTS)
        fitted = two_mass_response(resonance.values, line)
        gain.plot(line, np.abs(fitted), color=PREDICTED)
        phase.plot(line, np.degrees(np.angle(fitted)), color=PREDICTED)
    gain.set(ylabel="velocity / torque", xscale="log", yscale="log")
    phase.set(ylabel="phase [°]")
    coherence.set(ylabel="coherence", xlabel="frequency [Hz]", ylim=(0.0, 1.05))
    return figure
