"""State machine of a serial line: the documented tables are those of the code, and every state can be left."""

import re
from pathlib import Path

import pytest
from friction_hil_drivers.serial_line import line_state
from friction_hil_drivers.serial_line.line_state import LineEvent, LineState, Permission, Reception, Timeliness
from hypothesis import given
from hypothesis import strategies as st

README = Path(line_state.__file__).with_name("README.md")
STATES = {state.name: state for state in (*Reception, *Timeliness)}


def table(heading):
    """Return the rows of the table in the README whose header begins so, without header and rule."""
    lines = README.read_text().splitlines()
    (start,) = (k for k, line in enumerate(lines) if line.startswith(heading))
    rows = []
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip().strip("`") for cell in line.strip("|").split("|")])
    return rows


@pytest.mark.parametrize(("names_drives", "column"), [(True, 2), (False, 3)])
def test_the_documented_transitions_are_those_of_the_code(names_drives, column):
    documented = {
        (STATES[row[0]], LineEvent[row[1]]): STATES[row[column]]
        for row in table("| state | event | next state |")
        if row[column] != row[0]
    }
    assert documented == LineState(names_drives=names_drives).transitions


@pytest.mark.parametrize(("names_drives", "index"), [(True, 0), (False, -1)])
def test_the_documented_permissions_are_those_of_the_code(names_drives, index):
    documented = {}
    for state, *cells in table("| state | requests with a reply |"):
        documented[Reception[state]] = Permission(*(cell.split(" / ")[index] == "yes" for cell in cells))
    assert documented == LineState(names_drives=names_drives).permissions


def test_every_state_and_event_is_documented():
    text = README.read_text()
    for name in (*STATES, *LineEvent.__members__):
        assert re.search(rf"`{name}`", text), name


def test_no_key_of_the_table_stands_for_two_states():
    rows = re.findall(r"^    \((?:Reception|Timeliness)\.", Path(line_state.__file__).read_text(), re.MULTILINE)
    assert len(rows) == len(line_state.TRANSITIONS) + len(line_state.ANONYMOUS_TRANSITIONS)
    assert not set(map(int, Reception)) & set(map(int, Timeliness))


@given(st.booleans(), st.lists(st.sampled_from(LineEvent)))
def test_from_every_state_a_well_behaved_line_becomes_normal_again(names_drives, events):
    state = LineState(names_drives=names_drives)
    for event in events:
        state.apply(event)
    for event in (
        LineEvent.LINE_QUIET,
        LineEvent.LAST_REPLY,
        LineEvent.LINE_QUIET,
        LineEvent.NO_REPLY_LATE,
        LineEvent.ALL_ANSWERED,
    ):
        state.apply(event)
    assert state.is_normal
    assert state.permission == Permission(*5 * (True,))


@given(st.booleans(), st.lists(st.sampled_from(LineEvent)))
def test_commands_pass_in_every_state_but_while_a_line_becomes_quiet(names_drives, events):
    """A line that never becomes quiet must not keep a drive from being disabled."""
    state = LineState(names_drives=names_drives)
    for event in events:
        state.apply(event)
    if not state.permission.commands:
        state.apply(LineEvent.LINE_NEVER_QUIET)
    assert state.permission.commands
