"""The compensation of a configuration: defaults, keys, mistakes, and what the compensator is made with."""

import math

import pytest

from friction_hil.daemon.assembly import lead_s, make_compensator
from friction_hil.drive import AxisFacts
from friction_hil.errors import ConfigurationError, UsageError
from tests.servo_drives import PERIOD_S, axis_dict, configuration


def configured(*, inertia=2e-4, **compensation):
    """The axis of a configuration with these keys."""
    axis = axis_dict(compensation=compensation)
    axis["model"]["mechanics"] = {"inertia": inertia} if inertia else {}
    return configuration(x=axis).axes["x"]


FACTS = AxisFacts("x", "servo", 1e-5, 1e-4, 2.5e-3, 1.5e-3)


def made(**compensation):
    axis = configured(**compensation)
    return make_compensator(axis, axis.model, FACTS, PERIOD_S).settings


def test_the_defaults():
    """No position needs to reach the velocity limit within a period, and what is not given is off."""
    assert configured().compensation.model_dump() == {
        **{"enabled": True, "gain": 0.9, "gain_negative": None, "source": "auto", "fade_s": 0.5, "baseline_s": 0.0},
        **{"velocity": "difference", "smoothing": 1.0, "acceleration": None, "max_acceleration": None},
        **{"dead_band": 0.0, "gravity": True, "adaptation": None, "transmission": None, "learning": "off"},
        "velocity_offset": None,
    }
    assert configured(adaptation={}).compensation.adaptation.model_dump() == {"time_s": 20.0, "bound": 0.3}
    settings = made()
    assert (settings.gain_negative, settings.dead_band, settings.adaptation_s) == (None, 0.0, 0.0)
    assert (settings.velocity, settings.smoothing, settings.inertia) == ("difference", 1.0, 2e-4)
    assert settings.max_acceleration == pytest.approx(axis_dict()["limits"]["velocity"] / PERIOD_S)


@pytest.mark.parametrize(
    ("given", "field", "expected"),
    [
        ({"gain": 0.7}, "gain", 0.7),
        ({"gain_negative": 0.6}, "gain_negative", 0.6),
        ({"source": "demand"}, "source", "demand"),
        ({"fade_s": 2.0}, "fade_s", 2.0),
        ({"velocity": "kalman"}, "velocity", "kalman"),
        ({"velocity": "drive", "smoothing": 0.5}, "smoothing", 0.5),
        ({"velocity": "tracking", "acceleration": 30.0}, "acceleration", 30.0),
        ({"max_acceleration": 1e3}, "max_acceleration", 1e3),
        ({"dead_band": 0.02}, "dead_band", 0.02),
        ({"adaptation": {"time_s": 5.0}}, "adaptation_s", 5.0),
        ({"adaptation": {"bound": 0.1}}, "adaptation_bound", 0.1),
    ],
)
def test_every_key_reaches_the_compensator(given, field, expected):
    assert getattr(made(**given), field) == expected
    assert getattr(made(), field) != expected


@pytest.mark.parametrize(
    ("given", "field", "words"),
    [
        ({"velocity": "position"}, "compensation.velocity", "difference"),
        ({"velocity": "tracking"}, "compensation", "tracking needs acceleration"),
        ({"velocity": "kalman", "inertia": None}, "compensation.velocity", "needs mechanics.inertia"),
        ({"adaptation": {}, "inertia": None}, "compensation.adaptation", "needs mechanics.inertia"),
        ({"velocity": "drive", "smoothing": 0.05}, "compensation.smoothing", "cycles"),
        ({"gain_negative": -0.1}, "compensation.gain_negative", "at least 0 and at most 1.5"),
        ({"acceleration": 0.0}, "compensation.acceleration", "above 0"),
        ({"max_acceleration": math.inf}, "compensation.max_acceleration", "finite"),
        ({"dead_band": -1.0}, "compensation.dead_band", "at least 0"),
        ({"adaptation": {"time_s": 0.0}}, "compensation.adaptation.time_s", "0.1"),
        ({"adaptation": {"bound": 1.0}}, "compensation.adaptation.bound", "1"),
        ({"adaptation": True}, "compensation.adaptation", ""),
    ],
)
def test_a_mistake_is_told_with_its_place(given, field, words):
    with pytest.raises(ConfigurationError) as caught:
        configured(**given)
    (problem,) = caught.value.problems
    assert problem.field == f"axes.x.{field}"
    assert words in problem.message


@pytest.mark.parametrize("acceleration", [1e-6, 1e-3])
def test_an_acceleration_that_makes_the_tracking_too_slow_is_told_when_the_drive_is_known(acceleration):
    with pytest.raises(UsageError, match="tracking"):
        made(velocity="tracking", acceleration=acceleration)


@pytest.mark.parametrize(("mechanics", "expected"), [({}, 1.5e-3), ({"delay_s": 1.2e-3}, 1.2e-3 + 0.5 * PERIOD_S)])
def test_the_lead_reaches_to_the_middle_of_the_period_in_which_the_torque_acts(mechanics, expected):
    """By the driver's facts; a delay of the model file is one to the torque's start."""
    axis = axis_dict()
    axis["model"]["mechanics"] = {"inertia": 2e-4, "torque_lag_s": 3e-4, **mechanics}
    model = configuration(x=axis).axes["x"].model
    assert lead_s(model, FACTS, PERIOD_S) == pytest.approx(expected + 3e-4)


CROSSING = {"backlash": 2e-3, "load": {"inertia": 1e-4, "friction": 0.03}}


def crossing(mechanics=(), **axis):
    one = axis_dict(**{"compensation": {"transmission": {"acceleration": 300.0}}} | axis)
    one["model"]["mechanics"] = {"inertia": 2e-4} | CROSSING | dict(mechanics)
    return configuration(x=one).axes["x"]


def test_crossing_takes_gap_and_load_from_the_model_file():
    axis = crossing()
    settings = make_compensator(axis, axis.model, FACTS, PERIOD_S).settings
    assert (settings.backlash, settings.load_inertia, settings.load_friction) == (2e-3, 1e-4, 0.03)
    assert (settings.offset_acceleration, settings.offset_velocity) == (300.0, math.inf)
    assert (settings.stiffness, settings.offset_limit) == (math.inf, 1e-3)
    axis = crossing({"load": CROSSING["load"] | {"stiffness": 50.0}, "gravity": {"sine": 0.03, "cosine": 0.04}})
    settings = make_compensator(axis, axis.model, FACTS, PERIOD_S).settings
    assert settings.stiffness == 50.0
    assert settings.offset_limit == pytest.approx(1e-3 + (0.03 + 0.05 + 1e-4 * 300.0) / 50.0)
    assert (settings.velocity_limit, settings.setpoint_delay_s) == (30.0, 2.5e-3)


TORQUE_MODE = {"mode": "cst", "trajectory": {"kind": "none"}, "limits": {"torque": 0.3, "velocity": 30.0}}


@pytest.mark.parametrize(
    ("mechanics", "axis", "reason"),
    [
        ({"backlash": 0.0}, {}, r"mechanics\.load .*mechanics\.backlash"),
        ({"load": None}, {}, r"mechanics\.load"),
        ({"load": {"inertia": 1e-4}}, {}, r"mechanics\.load"),
        ({"load": {"inertia": 1e-4, "friction": 0.0}}, {}, "floats in the gap"),
        ({"encoder": "load"}, {}, "encoder: load"),
        ({"load": {"inertia": 3e-4, "friction": 0.03}}, {}, r"mechanics\.inertia, 0\.0002"),
        ({}, {"compensation": {"transmission": {}}}, "acceleration"),
        ({}, {"compensation": {"transmission": {"acceleration": 0.0}}}, "above 0"),
        ({}, TORQUE_MODE, "set-point"),
    ],
)
def test_crossing_is_refused_where_it_makes_no_sense(mechanics, axis, reason):
    with pytest.raises(ConfigurationError, match=reason):
        crossing(mechanics, **axis)
