"""Names and messages of other origin reach no terminal as control sequences."""

import io
import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.cli import main
from friction_hil.printable import PrintableStream, own_style, printable

EVIL = "\x1b]0;owned\x07\x1b[2J\r\x9b31m\u202e[/red]:boom:"
SHOWN = r"\u001b]0;owned\u0007\u001b[2J\u000d\u009b31m\u202e[/red]:boom:"


@given(st.text(st.characters(codec=None)))
def test_no_control_character_stays(text):
    shown = printable(text)
    assert not [each for each in shown if each not in "\n\t" and (ord(each) < 32 or 127 <= ord(each) < 160)]
    assert not set(shown) & set("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\u2028\u2029")
    shown.encode()  # no half of a surrogate pair
    assert printable(shown) == shown
    # a JSON document stays the same document
    assert json.loads(printable(json.dumps([text], ensure_ascii=False))) == [text]
    words = "Geschwindigkeit [µm/s] → 速度 №1\tx\n"
    assert printable(words) == words


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A recording whose columns, axis and file have such names."""
    monkeypatch.chdir(tmp_path)
    names = {"time_s": np.arange(20) * 1e-3, "position": np.arange(20.0), "torque": np.ones(20), EVIL: np.ones(20)}
    np.savez("x.npz", **names)
    (tmp_path / f"{EVIL.replace('/', '')}.csv").write_text("time_s,position,torque\n0,1,2\n1,2,2\n2,3,2\n")
    return tmp_path


@pytest.mark.parametrize(
    "words",
    [
        ["convert", "x.npz", "--info"],
        ["convert", "x.npz", "--info", "--json"],
        ["convert", "x.npz", "y.mcap"],
        ["convert", EVIL.replace("/", "") + ".csv", "--info"],
        ["replay", EVIL.replace("/", "") + ".csv", "--model", "coulomb:coulomb=1"],
        ["replay", "x.npz", "--model", f"coulomb:coulomb=1,{EVIL}=3"],
        ["models", EVIL],
        ["config", "check", EVIL],
        [EVIL],
    ],
)
def test_no_command_prints_them(folder, words, capsys):
    before = sys.stdout, sys.stderr
    main(words)
    assert (sys.stdout, sys.stderr) == before, "the streams are put back"
    printed = capsys.readouterr()
    for text in printed:
        assert not set(text) & {"\x1b", "\x07", "\r", "\x9b", "\u202e"}
    assert "owned" in printed.out + printed.err
    assert "Traceback" not in printed.err


def on_a_terminal(*command, **environment):
    """Return what a command writes to a pseudo-terminal."""
    ours, theirs = pty.openpty()
    with subprocess.Popen(command, stdout=theirs, stderr=theirs, stdin=theirs, env=os.environ | environment):
        os.close(theirs)
        data = b""
        while True:
            try:
                data += os.read(ours, 4096)
            except OSError:  # Linux reports the end of a pseudo-terminal this way
                break
    os.close(ours)
    return data


def test_a_terminal_gets_them_as_text(folder):
    """On a real terminal, where colours are sent, but nothing of the names."""
    data = on_a_terminal(sys.executable, "-m", "friction_hil", "convert", "x.npz", "--info", COLUMNS="200")
    assert SHOWN.encode() in data
    assert b"\x1b]" not in data
    assert b"\x07" not in data
    assert b"\x1b[1m" in data  # the heading is bold
    assert b"\x1b[1mmodel" in on_a_terminal(sys.executable, "-m", "friction_hil", "models", COLUMNS="80", TERM="xterm")


def test_a_bar_and_what_is_printed_beside_it_reach_a_terminal():
    """The control sequences of a bar are not text; a message beside it keeps neither its own nor those of names."""
    program = """
import sys
from friction_hil.cli.colour import red
from friction_hil.cli.work.progress import progress_bar, status_line
from friction_hil.printable import PrintableStream

sys.stdout, sys.stderr = PrintableStream(sys.stdout), PrintableStream(sys.stderr)
with status_line("reading") as show:
    show("drawing", 1, 2)
    print(red("Error:"), "torque\\x9b2J", file=sys.stderr)
with progress_bar() as bar:
    bar.add_task("fitting")
"""
    text = on_a_terminal(sys.executable, "-c", program, COLUMNS="80", TERM="xterm").decode()
    assert r"\u001b" not in text
    assert r"\u000d" not in text
    assert "\x1b[2K" in text  # the bar is overwritten
    assert "Error:" in text
    assert "\U0010ff1b" not in text
    assert "\x9b" not in text


def test_no_word_of_an_error_is_cut_at_the_edge_of_a_terminal(folder):
    wrong = (["rnu"], ["run", "--duration", "5"], ["config", "check", "nowhere.yaml"], ["convert", "x.npz", "y.z"])
    for words in wrong:
        data = on_a_terminal(sys.executable, "-m", "friction_hil", *words, COLUMNS="40", NO_COLOR="1")
        lines = data.decode().splitlines()
        assert [line for line in lines if len(line) > 40 and "friction" not in line] == []
        assert "\x1b" not in data.decode()
    assert b"There are:\r\n.csv, .h5, " in data


@pytest.mark.parametrize("words", [["replay", "."], ["identify", "."], ["convert", ".", "x.csv"], ["plot", "."]])
def test_a_folder_in_the_place_of_a_recording_is_named(folder, words, capsys):
    assert main(words) == 2
    assert ".: no recording (.mcap) is in this folder" in capsys.readouterr().err


def test_a_file_name_that_is_not_utf_8(tmp_path, capsysbinary):
    name = os.fsdecode(bytes(tmp_path) + b"/\xff.csv")
    Path(name).write_text("time_s,torque\n0,1\n1,2\n")
    assert main(["convert", name, "--info"]) == 0
    assert rb"\udcff: 2 rows" in capsysbinary.readouterr().out


@pytest.mark.parametrize("is_terminal", [True, False])
def test_styles_of_our_own_are_kept_on_a_terminal(is_terminal):
    class Stream(io.StringIO):
        def isatty(self):
            return is_terminal

    stream = Stream()
    PrintableStream(stream).write(f"{own_style(click.style('Error:', fg='red', bold=True))} \x1b[31mred\x1b[0m")
    label = "\x1b[31m\x1b[1mError:\x1b[0m" if is_terminal else "Error:"
    assert stream.getvalue() == rf"{label} \u001b[31mred\u001b[0m"
