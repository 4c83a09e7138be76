"""The commands that the pages of this project show: found, cut into words, and parsed without being run."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import click

from friction_hil.cli import application
from tools.benchmarks.commands import command as benchmarks

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    *(path for top in ("friction_hil", "drivers", "tools") for path in sorted((ROOT / top).rglob("*.md"))),
]
_BLOCK = re.compile(r"^ *```sh\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
_PARTS = re.compile(r"(^ *```.*?^ *```)", re.MULTILINE | re.DOTALL)
_CODE = re.compile(r"`([^`\n]+)`")
_FIRST = re.compile(r"^(?:\.venv/bin/)?(friction-hil|\./tools/\w+)(?= |$)")
_NUMBERS = {"S", "N", "V", "HZ", "SPEED"}  # placeholders for numbers


@dataclass(frozen=True)
class Shown:
    """A command on a page.

    ``words`` begin with the program; placeholders for numbers are replaced. A command in a sentence or table is not
    ``is_complete``: it may leave its arguments out.
    """

    page: str
    text: str
    words: tuple[str, ...]
    is_complete: bool
    is_in_table: bool = False

    def __str__(self) -> str:
        return f"{self.page}: {self.text}"


def shown_commands() -> Iterator[Shown]:
    """Find all commands in the shell blocks, tables and sentences of the pages, in the order of each page."""
    for page in PAGES:
        name, text = str(page.relative_to(ROOT)), page.read_text(encoding="utf-8")
        for part in _PARTS.split(text):
            if block := _BLOCK.match(part):
                for line in block[1].replace("\\\n", " ").splitlines():
                    yield from _cut(name, re.split(r"  #| > ", line)[0].strip(), is_complete=True)
            elif not _PARTS.match(part):
                for line in part.splitlines():
                    yield from _in_line(name, line)


def _in_line(page: str, line: str) -> Iterator[Shown]:
    """Cut the commands of a line; in a row of a table, single options belong to the command before them."""
    latest = ""
    for code in _CODE.findall(line):
        if _FIRST.match(code):
            latest = code
            yield from _cut(page, code, is_in_table=line.startswith("|"))
        elif latest and line.startswith("|") and re.match(r"--\w", code):
            yield from _cut(page, f"{latest} {code}", is_in_table=True)


def _cut(page: str, text: str, *, is_complete: bool = False, is_in_table: bool = False) -> Iterator[Shown]:
    if not _FIRST.match(text):
        return
    words = shlex.split(text)
    words[0] = Path(words[0]).name if words[0].endswith("friction-hil") else words[0]
    alternatives = next((word for word in words if "|" in word), None)
    for each in (alternatives or "").replace("\\", "").split("|"):
        chosen = [each if word == alternatives else word for word in words]
        yield Shown(page, text, tuple(filter(None, map(_filled, chosen))), is_complete, is_in_table)


def _filled(word: str) -> str:
    """Replace a placeholder by a value; an optional argument, ``[CONFIG]``, by nothing."""
    if word.startswith("["):
        return ""
    return "1" if word in _NUMBERS else word.removesuffix("...")


def resolve(words: tuple[str, ...], *, is_complete: bool = True) -> tuple[str, frozenset[str]]:
    """Parse a command without running it; return the full name of the command, and the options that it uses.

    Raises
    ------
    click.ClickException, FrictionHilError
        There is no such command or option, or an argument is wrong or missing.
    """
    program, *rest = words
    if program == "./tools/demo":
        return program, resolve(("friction-hil", "demo", *rest))[1]
    if program != "friction-hil" and program != "./tools/bench":
        assert (ROOT / program).exists()
        return program, frozenset()
    command: click.Command = application if program == "friction-hil" else benchmarks
    name, options = program, frozenset(word.partition("=")[0] for word in rest if re.match(r"--\w", word))
    context = click.Context(command, info_name=program)
    while isinstance(command, click.Group) and rest and rest[0] != "NAME" and not rest[0].startswith("-"):
        found = command.get_command(context, rest[0])
        assert found is not None, f"no command {rest[0]!r}"
        name, command, rest = f"{name} {rest[0]}", found, rest[1:]
    known = {word for each in command.get_params(context) for word in (*each.opts, *each.secondary_opts)}
    assert options <= known, f"{name} has no {', '.join(options - known)}"
    if is_complete and not options & {"--help", "--version"}:
        command.make_context(name, rest)
    return name, options
