"""An axis on a serial line: feedback from its process image, commands in its numbers, the way through its states."""

import math

import pytest
from friction_hil_drivers.serial_line import codes
from friction_hil_drivers.serial_line.axis import SerialAxis, make_scales
from friction_hil_drivers.serial_line.description import Signal, Step
from friction_hil_drivers.serial_line.protocol import Image
from friction_hil_drivers.serial_line.units import AxisUnits
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from friction_hil.drive import Command, DriveState, Feedback, Request
from friction_hil.errors import UsageError
from tests import serial_bench

UNITS = AxisUnits(counts_per_unit=1000.0, rated_torque=0.5, torque_constant=0.1)
ENABLED, FAULT, DISABLED = DriveState.OPERATION_ENABLED, DriveState.FAULT, DriveState.SWITCH_ON_DISABLED


class Counter(Signal):
    """A signal that is a 16-bit counter."""

    @property
    def counter_bits(self):
        return 16


class Bench(serial_bench.TinyDescription):
    """A description without any protocol."""

    def units(self):
        return {**self.signals, "position": Counter(**self.signals["position"].model_dump())}


OWN = {
    "version": 1,
    "name": "a drive",
    "sources": ["its manual"],
    "signals": {
        "position": {"unit": "count"},
        "velocity": {"unit": "rpm", "scale": 0.1},
        "torque": {"unit": "A", "scale": 0.01},
        "status": {},
        "error": {},
        "torque_command": {"unit": "per_mille"},
        "power": {},
        "reset": {},
    },
    "states": [
        {"state": "fault", "signal": "error", "value_not": 0},
        {"state": "operation_enabled", "mask": 1, "value": 1},
        {"state": "switch_on_disabled", "mask": 1, "value": 0},
    ],
    "modes": {"cst": {"commands": ["torque_command"]}},
    "enable": [{"write": {"power": 2}}, {"write": {"power": 1}, "until": "operation_enabled", "timeout_s": 0.5}],
    "disable": [{"write": {"power": 0}, "until": "switch_on_disabled"}],
    "reset_fault": [{"write": {"reset": 1}}],
    "errors": {7: "over-temperature"},
}
CIA402 = {
    **{key: value for key, value in serial_bench.CIA402.items() if key != "watchdog"},
    "signals": {**{name: OWN["signals"][name] for name in ("position", "status", "torque_command")}, "control": {}},
    "modes": {"cst": {"commands": ["torque_command"]}},
}


def make(data=OWN, *, is_inverted=False, inverted_torque="none", units=UNITS, kind="rotary", before=()):
    description = Bench.model_validate(data)
    scales = make_scales("x", description, units, kind=kind, is_inverted=is_inverted, inverted_torque=inverted_torque)
    image = Image()
    return SerialAxis("x", description, scales, image, ("torque_command",), before), image


def hear(axis, image, time_s=0.0, trouble="", **values):
    for name, value in values.items():
        image.put((name,), (value,))
    feedback = Feedback()
    axis.fill(feedback, time_s, trouble)
    return feedback


def write(axis, request, time_s=0.0, torque=0.0):
    return dict(axis.take(Command(request, torque=torque), time_s))


@pytest.mark.parametrize(
    ("options", "motion", "sent", "reported"),
    [
        ({}, 1, 1, 1),
        ({"is_inverted": True}, -1, -1, -1),
        ({"inverted_torque": "command"}, 1, -1, 1),
        ({"inverted_torque": "feedback"}, 1, 1, -1),
        ({"inverted_torque": "both"}, 1, -1, -1),
        ({"is_inverted": True, "inverted_torque": "both"}, -1, 1, 1),
    ],
)
def test_numbers_of_the_drive_become_si_and_back_with_the_signs_of_the_axis(options, motion, sent, reported):
    axis, image = make(**options)
    feedback = hear(axis, image, position=500, velocity=600, torque=-150, status=1, error=0)
    assert feedback.position == pytest.approx(motion * 0.5)
    assert feedback.velocity == pytest.approx(motion * 60.0 * 2.0 * math.pi / 60.0)
    assert feedback.torque == pytest.approx(reported * -1.5 * 0.1)
    assert (feedback.state, feedback.is_fresh) == (ENABLED, True)
    write(axis, Request.ENABLE, torque=0.05)
    assert image.values["torque_command"] == pytest.approx(sent * 100.0)


@given(st.lists(st.integers(-30000, 30000), min_size=1, max_size=30))
def test_a_counter_that_wraps_is_followed(steps):
    axis, image = make()
    total = 0
    hear(axis, image, position=0, velocity=0)
    for step in steps:
        total += step
        wrapped = (total + 0x8000) % 0x10000 - 0x8000
        assert hear(axis, image, position=wrapped, velocity=0).position == pytest.approx(total / 1000.0)


def test_without_a_velocity_it_is_the_difference_of_positions():
    axis, image = make(CIA402)
    assert hear(axis, image, 0.0, position=0, status=0x40).velocity == 0.0
    assert hear(axis, image, 1e-3, position=20, status=0x40).velocity == pytest.approx(20.0)
    assert hear(axis, image, 3e-3, position=30, status=0x40).velocity == pytest.approx(5.0), "after a lost cycle"


@pytest.mark.parametrize("missing", ["counts_per_unit", "rated_torque", "torque_constant"])
def test_what_a_unit_needs_must_be_given_and_fit_the_axis(missing):
    given_units = {"counts_per_unit": 1000.0, "rated_torque": 0.5, "torque_constant": 0.1}
    with pytest.raises(UsageError, match="velocity in rpm"):
        make(kind="linear")
    del given_units[missing]
    with pytest.raises(UsageError, match=missing):
        make(units=AxisUnits(**given_units))


def test_a_cycle_without_position_keeps_the_last_and_says_why():
    axis, image = make()
    hear(axis, image, 0.0, position=500, velocity=600, status=1, error=0)
    feedback = hear(axis, image, 1e-3, "no reply", velocity=900)
    assert not feedback.is_fresh
    assert feedback.position == pytest.approx(0.5)
    assert feedback.velocity == pytest.approx(2.0 * math.pi), "a velocity alone is not taken: the two belong together"
    assert feedback.missing == "no reply"


def test_a_state_that_is_not_told_for_long_is_an_error_but_not_at_once_after_a_silence():
    """Where the state is read in the background, position is back some cycles before it."""
    axis, image = make()
    hear(axis, image, 0.0, position=0, velocity=0, status=1, error=0)
    assert not hear(axis, image, 0.49, position=0, velocity=0).message
    feedback = hear(axis, image, 0.51, "exception 2", position=0, velocity=0)
    assert feedback.message.endswith(f"exception 2 [{codes.STATE_NOT_REPORTED}]")
    axis, image = make()
    hear(axis, image, 0.0, position=0, velocity=0, status=1, error=0)
    for k in range(1, 100):
        assert not hear(axis, image, 0.01 * k, "no reply in time").message
    for time_s, is_error in ((1.0, False), (1.4, False), (1.6, True)):
        assert bool(hear(axis, image, time_s, "exception 2", position=0, velocity=0).message) is is_error


def test_a_state_is_unknown_until_all_that_tells_it_was_heard_and_a_fault_is_told_in_words():
    axis, image = make()
    assert hear(axis, image, position=0, velocity=0, status=1).state is DriveState.UNKNOWN
    assert hear(axis, image, position=0, velocity=0, error=0).state is ENABLED
    feedback = hear(axis, image, position=0, velocity=0, status=1, error=7)
    assert (feedback.state, feedback.error) == (FAULT, "7 (7h) over-temperature")
    assert "3210h" in hear(*make(CIA402), position=0, status=8, error=0x3210).error


def test_a_sequence_goes_on_when_a_step_was_taken_and_the_state_followed():
    axis, image = make()
    hear(axis, image, position=0, velocity=0, status=0, error=0)
    assert write(axis, Request.ENABLE) == {"power": 2.0}
    assert write(axis, Request.ENABLE) == {"power": 2.0}, "until it is acknowledged"
    axis.sequencer.acknowledge()
    assert write(axis, Request.ENABLE) == {"power": 1.0}
    axis.sequencer.acknowledge()
    assert write(axis, Request.ENABLE) == {"power": 1.0}, "until the state follows"
    hear(axis, image, position=0, velocity=0, status=1, error=0)
    assert write(axis, Request.ENABLE) == {}
    assert write(axis, Request.DISABLE) == {"power": 0.0}
    assert write(axis, Request.QUICK_STOP) == {"power": 0.0}, "where the description has no quick stop"


def test_a_drive_that_does_not_follow_is_an_error_after_the_steps_time():
    axis, image = make()
    hear(axis, image, position=0, velocity=0, status=0, error=0)
    write(axis, Request.ENABLE, 0.0)
    axis.sequencer.acknowledge()
    write(axis, Request.ENABLE, 0.1)
    axis.sequencer.acknowledge()
    assert write(axis, Request.ENABLE, 0.55) == {"power": 1.0}
    assert not hear(axis, image, 0.56, position=0, velocity=0, status=0).message
    write(axis, Request.ENABLE, 0.65)
    message = hear(axis, image, 0.66, position=0, velocity=0, status=0).message
    assert "power = 1" in message
    assert codes.SEQUENCE_STUCK in message


@pytest.mark.parametrize("data", [OWN, CIA402], ids=["own", "cia402"])
def test_what_a_restart_may_have_changed_is_written_before_each_enabling(data):
    axis, image = make(data, before=[Step(write={"reset": 50} if data is OWN else {"control": 50})])
    hear(axis, image, position=0, velocity=0, status=0x40, error=0)
    for _ in range(2):
        assert set(write(axis, Request.ENABLE).values()) == {50.0}
        axis.sequencer.acknowledge()
        assert write(axis, Request.ENABLE) == ({"power": 2.0} if data is OWN else {"control": 0x06})
        write(axis, Request.DISABLE)


def test_a_fault_is_reset_by_its_own_sequence_only():
    axis, image = make()
    hear(axis, image, position=0, velocity=0, status=0, error=7)
    for request in (Request.ENABLE, Request.DISABLE, Request.QUICK_STOP):
        assert "reset" not in write(axis, request)
    assert write(axis, Request.RESET_FAULT) == {"reset": 1.0}


def test_cia402_is_enabled_by_controlwords_and_left_alone_when_it_is_there():
    axis, image = make(CIA402)
    words = []
    for status in (0x40, 0x21, 0x23):
        hear(axis, image, position=0, status=status)
        words.append(write(axis, Request.ENABLE)["control"])
        axis.sequencer.acknowledge()
    assert words == [0x06, 0x07, 0x0F]
    hear(axis, image, position=0, status=0x27)
    assert write(axis, Request.ENABLE) == {}
    assert write(axis, Request.QUICK_STOP) == {"control": 0x02}
    hear(axis, image, position=0, status=0x07)
    assert write(axis, Request.DISABLE) == {"control": 0x00}


def test_a_controlword_that_was_not_acknowledged_is_written_again():
    axis, image = make(CIA402)
    hear(axis, image, position=0, status=0x40)
    assert [write(axis, Request.DISABLE) for _ in range(3)] == [{"control": 0x00}] * 3
    axis.sequencer.acknowledge()
    assert write(axis, Request.DISABLE) == {}


def test_fault_reset_is_an_edge():
    axis, image = make(CIA402)
    hear(axis, image, position=0, status=0x08)
    words = []
    for _ in range(4):
        words.append(write(axis, Request.RESET_FAULT)["control"])
        axis.sequencer.acknowledge()
    assert words == [0x80, 0x00, 0x80, 0x00]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"enable": [{"write": {"powr": 1}}]}, "'powr'.*'power'"),
        ({"states": []}, "states, enable and disable"),
        ({"inferred": ["torc"]}, r"inferred\.0\s.*'torc'"),
        ({"modes": {"cst": {"commands": ["power"]}}}, r"modes\.cst\s+commands power"),
        ({"state_machine": "cia402"}, "cia402 needs the signal control"),
        ({"watchdog": {"signal": "dog"}}, r"watchdog\s.*'dog'"),
        ({"watchdog": {"signal": "reset"}}, "reset must be in s"),
        ({"states": [{"state": "fault", "value": 1, "value_not": 2}]}, "either value or value_not"),
        ({"signals": {**OWN["signals"], "velocity": {"unit": "A"}}}, "velocity is in A"),
        ({"signals": {**OWN["signals"], "velocity": {"unit": "rmp"}}}, "'rpm'"),
        ({"states": [{"state": "fault", "mask": 1, "value": 2}]}, "not in the mask 1"),
        ({"signals": {**OWN["signals"], "velocity": {"unit": "rpm", "scale": 0}}}, "must not be zero"),
    ],
)
def test_a_description_that_contradicts_itself_is_refused(change, message):
    with pytest.raises(ValidationError, match=message):
        Bench.model_validate({**OWN, **change})
