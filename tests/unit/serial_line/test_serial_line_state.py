"""State machine of a serial line: the documented table is that of the code, and every state can be left."""

from pathlib import Path

from friction_hil_drivers.serial_line import line_state
from friction_hil_drivers.serial_line.line_state import TABLE, LineEvent, LineState, Permission, Reception, Timeliness
from hypothesis import given
from hypothesis import strategies as st

README = Path(line_state.__file__).with_name("README.md").read_text()


def pair(words):
    """Show what applies, and what applies where replies have no name."""
    return " / ".join(dict.fromkeys(words))


def rows():
    for state, row in TABLE.items():
        permission = [pair("yes" if each else "no" for each in both) for both in row.permission] or [""] * 5
        following = [f"`{e.name}` → {pair(f'`{to.name}`' for to in both)}" for e, both in row.following.items()]
        yield f"| {' | '.join([f'`{state.name}`', row.meaning, *permission, ', '.join(following)])} |"


def test_the_documented_table_is_that_of_the_code():
    _, table = README.split("|---|---|---|---|---|---|---|---|\n")
    assert table.partition("\n\n")[0] == "\n".join(rows())
    assert set(TABLE) == {*Reception, *Timeliness}, "no key stands for two states"
    assert {event for row in TABLE.values() for event in row.following} == set(LineEvent)
    assert all(f"`{event.name}`" in README.partition("The events are:")[2] for event in LineEvent)


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
