"""Numbers that tell a state, derived from a description's rules."""

import itertools

import pytest
from friction_hil_drivers.serial_line.description import STATES, Rule
from friction_hil_drivers.serial_line.simulated.states import matches, telling_numbers
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.drive import DriveState

NAMES = ("fault", "operation_enabled", "switch_on_disabled", "switched_on")
SIGNALS = ("status", "error")
MOST = 16  # of numbers in the rules below: whatever they tell apart shows within twice of that


@st.composite
def rules(draw):
    number = draw(st.integers(0, MOST - 1))
    mask = draw(st.none() | st.integers(1, MOST - 1))
    value = number if mask is None else number & mask
    is_not = draw(st.booleans())
    return Rule(
        state=draw(st.sampled_from(NAMES)),
        signal=draw(st.sampled_from(SIGNALS)),
        mask=mask,
        value=None if is_not else value,
        value_not=value if is_not else None,
    )


def first(given_rules, numbers):
    """State that the rules tell."""
    for rule in given_rules:
        if rule.fits(numbers.get(rule.signal, 0.0)):
            return STATES[rule.state]
    return None


@settings(max_examples=100, deadline=None)
@given(given_rules=st.lists(rules(), min_size=1, max_size=5), name=st.sampled_from(NAMES))
def test_numbers_are_found_where_there_are_any(given_rules, name):
    numbers = telling_numbers(given_rules, STATES[name], {})
    if numbers is not None:
        assert numbers.keys() == {rule.signal for rule in given_rules}
        assert first(given_rules, numbers) is STATES[name]
        return
    for status, error in itertools.product(range(2 * MOST), repeat=2):
        assert first(given_rules, {"status": status, "error": error}) is not STATES[name]


def test_preferred_numbers_go_first_where_they_do():
    is_broken = Rule(state="fault", signal="error", value_not=0)
    assert telling_numbers([is_broken], DriveState.FAULT, {"error": (0, 77)}) == {"error": 77.0}
    bit = Rule(state="fault", signal="error", mask=0x100, value=0x100)
    assert telling_numbers([bit], DriveState.FAULT, {"error": (77,)}) == {"error": 256.0}


@pytest.mark.parametrize(("written", "is_match"), [(0.1, True), (0.10000000149, True), (0.1001, False)])
def test_numbers_match_as_exactly_as_the_line_can_say_them(written, is_match):
    assert matches({"a": 0.1}, {"a": written, "b": 1.0}) is is_match
    assert not matches({"a": 0.1, "c": 0.0}, {"a": written})
