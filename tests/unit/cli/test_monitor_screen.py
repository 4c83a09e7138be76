"""The screen of the monitor: what it shows at which size, and that it fits."""

import re

import numpy as np
import pytest

from friction_hil.cli.work.monitor_screen import brief_line, screen, waiting_screen
from friction_hil.live import LiveEvent, LiveFigures
from friction_hil.live.web.content import COLUMNS, figures_message
from friction_hil.numerics.readable import quantity
from tests.unit.live.test_live import facts, reading, rows

MODEL = {"version": 1, "axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": 0.1}}}


@pytest.fixture(scope="module")
def shown():
    """A run with both phases, a fault, and friction that is twice that of the model."""
    time_s = np.arange(6000) * 1e-3
    velocity = 2.0 * np.sin(4.0 * time_s)
    values = {"velocity": velocity, "position": -0.5 * np.cos(4.0 * time_s), "torque": 0.2 * np.sign(velocity)}
    values |= {"position_demand": values["position"] + 1e-3, "is_enabled": time_s > 3.0, "late_us": 30.0}
    fault = LiveEvent(6000, 6.0, "fault", "x: following\x1b[2Jerror is beyond its limit [FH-109]")
    figures = LiveFigures(facts({"FH-109": "free the axis"}), window_s=3.0)
    figures.take(reading(rows(6000, **values), events=[fault], model=MODEL))
    return figures.snapshot()


def plain(lines):
    return [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in lines]


@pytest.mark.parametrize("size", [(80, 24), (120, 40), (50, 15), (20, 5), (1, 1)])
def test_it_fills_the_terminal_and_no_line_is_wrapped(shown, size):
    width, height = size
    lines = plain(screen(shown, width, height, 0, is_coloured=True, is_live=True))
    assert len(lines) == height
    assert max(map(len, lines)) < max(width, 2)
    assert not any("\x1b" in line for line in lines)  # of a message: no sequence of its own reaches the terminal
    assert len(waiting_screen("mill", shown, width, height, is_coloured=False)) == height


def test_figures_fault_and_remedy_are_there_at_the_usual_size(shown):
    lines = plain(screen(shown, 80, 24, 0, is_coloured=False, is_live=True))
    text = "\n".join(lines)
    for word in ("running", "operation enabled", "1.00 mrad", "[FH-109]", "remedy: free the axis"):
        assert word in text
    assert "q ends" in lines[-1]
    assert re.search(r"≤ 50.0 µs █", text)


def test_it_shows_every_value_of_the_page_as_the_page_does(shown):
    text = "\n".join(plain(screen(shown, 120, 40, 0, is_coloured=False, is_live=False)))
    page = figures_message(facts(), shown, {"x": ([], [[] for _ in COLUMNS])}, None)["axes"]["x"]["values"]
    values = {label: value for label, value in page if label != "Parameters"}
    rms = quantity(shown.axes["x"].compensated.rms, "rad")
    assert values["Error with compensation"] == f"{rms} RMS, 1.00 mrad peak"
    assert all(label in text and value in text for label, value in values.items())


def test_measured_friction_is_drawn_above_a_model_that_is_too_low(shown):
    lines = plain(screen(shown, 120, 40, 0, is_coloured=False, is_live=False))
    right = [line[60:88] for line in lines]
    measured = next(k for k, line in enumerate(right) if "●" in line)
    model = [k for k, line in enumerate(right) if re.search("[⠁-⣿]{3}", line)][-1]
    rows_of_graph = next(k for k, line in enumerate(lines) if "±" in line)
    assert measured < model < rows_of_graph


def test_without_colour_only_bold_and_dim_are_left(shown):
    codes = {*re.findall(r"\x1b\[([0-9;]*)m", "".join(screen(shown, 80, 24, 0, is_coloured=False, is_live=True)))}
    assert codes <= {"0", "1", "2"}
    assert "31;1" in "".join(screen(shown, 80, 24, 0, is_coloured=True, is_live=True))


def test_a_line_for_a_pipe_has_state_error_and_fault(shown):
    line = brief_line(shown)
    assert line.startswith(
        "mill: running; 5.999 s; missed 0; late p99 30.0 µs; x: operation enabled, error 1.00 mrad rms"
    )
    assert "fault: x: following" in line
    assert "\x1b" not in line
    assert "\n" not in line
