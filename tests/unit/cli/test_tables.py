"""Tables, live lines and progress on terminals of several widths: nothing is cut, numbers stand to the right."""

import io
import re
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from friction_hil.analysis.following import Figures
from friction_hil.cli.work import convert, drives, identify, replay, train, tune
from friction_hil.cli.work.following import Compared, following_table
from friction_hil.cli.work.progress import _Steps
from friction_hil.cli.work.tables import Table, lines, new_table, number, print_table, prose
from friction_hil.drive import DriveState
from friction_hil.drive.inventory import DriveEntry

WIDTHS = (60, 80, 120)
NAMES = st.text("abc de-", min_size=1, max_size=70)
LONG = "the_axis_that_carries_the_heavy_gripper"  # 39 columns


def rendered(table, width, *, is_terminal=False):
    out = Console(file=io.StringIO(), width=width, force_terminal=is_terminal, highlight=False, color_system=None)
    return list(lines(table, out))


def blocks(shown):
    """The tables of which the lines consist."""
    return [block.split("\n") for block in "\n".join(shown).split("\n\n")]


def words(shown):
    """Everything but blanks and the line breaks of wrapped cells."""
    return re.sub(r"\s", "", "".join(shown))


def assert_numbers_stand_right(shown, heading, numbers):
    """Heading and numbers of a column end in the same column of the screen."""
    [block] = [block for block in blocks(shown) if heading in "\n".join(block)]
    ends = {line.index(heading) + len(heading) for line in block if heading in line}
    for each in numbers:
        ends |= {m.end() for line in block for m in re.finditer(rf"(?<![\d.]){re.escape(each)}(?![\d.])", line)}
    assert len(ends) == 1, shown


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", ["x", LONG])
def test_the_following_error_fits(width, name):
    errors = [(Figures(2.57e-4, 2.189e-3), Figures(5.54e-5, 3.53e-4)), (Figures(83.1, 195.0), Figures(12.6, 50.1))]
    rows = [Compared((name, "stribeck + viscous (kept)"), "rad", a, b, a.times(b)) for a, b in errors]
    shown = rendered(following_table(("axis", prose("model")), rows), width)
    assert max(map(len, shown)) <= width
    for text in ("257", "2189", "55.4", "353", "4.6", "[µrad]", "[rad]", "12.6", "(kept)"):
        assert text in words(shown)
    assert_numbers_stand_right(shown, "lower", ["4.6", "6.2", "6.6", "3.9"])
    assert all("rms" in "".join(block) and name[:8] in "".join(block) for block in blocks(shown))
    assert (len(blocks(shown)) == 1) is (width == 120 or (name == "x" and width == 80))


def test_a_condition_that_nobody_has_is_no_column():
    shown = "\n".join(rendered(following_table(("axis",), [Compared(("x",), "m", None, Figures(0.0, 0.0), None)]), 80))
    assert "with\n" in shown + "\n"
    assert "without" not in shown
    assert "times" not in shown
    assert "rms [m]" in shown


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(NAMES, st.integers(-(10**9), 10**9)), min_size=1, max_size=4),
    st.integers(1, 9),
    st.integers(30, 130),
)
def test_whatever_a_table_contains_it_is_neither_cut_nor_too_wide(rows, count, width):
    table = new_table("name", prose("what it is"), *(number(f"number {k}") for k in range(count)))
    for text, value in rows:
        table.add_row(text.strip() or "-", f"as {text}", *(str(value + k) for k in range(count)))
    shown = rendered(table, width)
    assert max(map(len, shown)) <= width
    for _, value in rows:
        for k in range(count):
            assert str(value + k) in words(shown)
    for k in range(count):
        assert_numbers_stand_right(shown, f"number {k}", [str(value + k) for _, value in rows] if count == 1 else [])
    assert all(words([text]) in words(rendered(table, 1000)) for text, _ in rows)


@pytest.mark.parametrize("width", WIDTHS)
def test_drives_of_a_bus_are_shown_in_parts_where_the_terminal_is_narrow(width, capsys, monkeypatch):
    monkeypatch.setattr("friction_hil.cli.work.tables._WIDE", width)
    entry = DriveEntry(
        **{"node": 17, "name": "Panasonic MINAS A6B", "vendor_id": 0x66F, "product_code": 0x535000A1, "serial": 123456},
        **{"profile": 402, "nmt": "pre-operational", "state": DriveState.SWITCH_ON_DISABLED, "mode": "csp"},
        **{"modes": ("pp", "pv", "tq", "hm", "csp", "csv", "cst"), "answers": True},
    )
    drives.print_scan([entry])
    shown = capsys.readouterr().out.splitlines()
    assert max(map(len, shown)) <= width
    for text in ("0x66f 0x535000a1 0x1e240", "pre-operational", "switch on disabled", "pp pv tq hm csp csv cst"):
        assert any(text in line for line in shown), text
    parts = blocks(shown)
    assert all(part[0].split()[0] == "node" and part[1].split()[0] == "17" for part in parts)
    assert len(parts) == (2 if width == 120 else 3 if width == 60 else 2)


@pytest.mark.parametrize("width", WIDTHS)
def test_other_tables_fit(width, capsys, monkeypatch):
    monkeypatch.setattr("friction_hil.cli.work.tables._WIDE", width)
    error = SimpleNamespace(relative_error=0.12345)
    values = {"direction.positive.coulomb": -1.23456e-5}
    fit = SimpleNamespace(
        **{"label": "elasto_plastic + direction + load + temperature", "count": 12, "train": error},
        **{"cross_validation": error, "across_speeds": None, "validation": error},
        **{"structure": SimpleNamespace(modifiers=("direction",)), "values": values},
        inference=SimpleNamespace(standard_errors={"direction.positive.coulomb": 1.2e-7}),
    )
    found = SimpleNamespace(fits=(fit,), groups=(("", (fit,)),), records=(SimpleNamespace(group="a"),), settings=None)
    tried = [
        {"model": f"lugre:sigma0=2000,coulomb={k}", "rmse": 10.0**-k, "unit": "N m", "relative_error": 0.5}
        for k in range(3)
    ]
    replayed = {"path": f"/logs/{LONG}.mcap", "axis": "x", "problems": [], "models": tried}
    outcome = SimpleNamespace(picture=None, facts=replayed)
    column = {"unit": "rad/s or m/s", "values": 123456, "min": -0.0, "max": 1e5, "step": 1.2345e-7}
    columns = {"velocity_demand_ahead": column}
    facts = {"rows": 1, "duration_s": 1.0, "rate_hz": 1.0, "jitter_s": 0.0, "gaps": 0, "longest_gap_s": 0.0}
    printed = (
        lambda: identify.print_candidates(found),
        lambda: identify.print_parameters(fit),
        lambda: replay.print_outcomes([outcome]),
        lambda: convert.print_axis("x", {**facts, "columns": columns, "metadata": [], "events": []}),
    )
    for show in printed:
        show()
        shown = [line for line in capsys.readouterr().out.splitlines() if not line.startswith("Number of free")]
        assert max(map(len, shown)) <= width, shown
    assert "-0 " not in "\n".join(shown)
    assert "1.235e-07" in words(shown)
    assert "100000" in words(shown)


def test_rows_have_a_cell_for_each_column_and_a_table_in_a_pipe_is_as_wide_as_it_needs(capsys):
    table = new_table("name", number("value"))
    with pytest.raises(ValueError, match="1 cells for 2 columns"):
        Table(table.columns).add_row("x")
    table.add_row("n" * 150, "1")
    print_table(table)
    assert [len(line) for line in capsys.readouterr().out.splitlines()][1] == 150 + 2 + 5


def test_remaining_time_follows_from_the_steps_so_far():
    now = 0.0
    steps = _Steps(lambda: now)
    for now, done, total, text in (  # noqa: B007 - the clock is read by the steps
        (100.0, 0, None, ""),
        (100.0, 1, 5, "1 of 5"),
        (130.0, 2, 5, "2 of 5, 2:00 left"),
        (160.0, 3, 5, "3 of 5, 1:30 left"),
        (160.0, 1, None, "1"),
        (190.0, 4, None, "4"),
        (190.0, 1, 2, "1 of 2"),  # another stage
        (191.5, 2, 2, "2 of 2, 0:01 left"),
        (191.5, 1, 6, "1 of 6"),
        (191.6, 4, 6, "4 of 6"),  # what was quick so far says nothing of the rest
    ):
        assert steps.text(done, total) == text


def test_modules_without_tables_of_their_own_use_this_one():
    for module in (convert, drives, identify, replay, train, tune):
        assert module.print_table is print_table
