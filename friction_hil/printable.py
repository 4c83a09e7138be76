"""Text of other origin on a terminal: control characters are shown, not sent.

Names of columns, axes and files, and what drives send, can contain escape sequences, which would move the cursor,
overwrite lines, or set the title of the window. Only `printable` decides what may reach a terminal; `PrintableStream`
applies it to everything that a command prints.
"""

import re
from collections.abc import Iterable
from typing import Any, TextIO

# Stands for the escape character in colours and weights that a command itself chose: see `own_style`.
_OWN_ESCAPE = "\U0010ff1b"
_STYLE = r"(\[[0-9;]*m)"

# Control characters except tab and line feed, marks that change the direction of the text or end a line, and halves of
# surrogate pairs, which Python uses for bytes of a file name that are not UTF-8 and which no stream can encode.
_UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]"
)


def printable(text: str) -> str:
    r"""Replace each unprintable character by its code, which is also valid within a JSON string.

    >>> printable("torque\x1b[2J")
    'torque\\u001b[2J'
    """
    return _UNPRINTABLE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def on_one_line(text: str) -> str:
    r"""Replace each line break and tab by a space, and make the rest `printable`: for a line of a comment in a file.

    >>> on_one_line("run\n1.mcap")
    'run 1.mcap'
    """
    return printable(re.sub(r"[\t\n\v\f\r\x85\u2028\u2029]+", " ", text))


def own_style(text: str) -> str:
    """Mark the colours and weights in ``text``, so that a `PrintableStream` sends them to a terminal.

    For text in which everything else has been made printable before it was styled, e.g. by ``click.style``.
    """
    return re.sub(f"\x1b{_STYLE}", rf"{_OWN_ESCAPE}\1", text)


def without_own_style(text: str) -> str:
    """Return ``text`` without what `own_style` has marked."""
    return re.sub(f"{_OWN_ESCAPE}{_STYLE}", "", text)


class PrintableStream:
    """A text stream that makes all text `printable` before it writes it to ``stream``.

    Styles that `own_style` has marked are kept on a terminal, and left out elsewhere.
    """

    def __init__(self, stream: TextIO) -> None:
        # the stream itself, by rich's name for it: a rich console writes its own colours there, and makes the text
        # printable before (`friction_hil.cli.work.tables.console`)
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        """Write ``text``; return its length."""
        shown = printable(text)
        if _OWN_ESCAPE in shown:
            is_terminal = self.rich_proxied_file.isatty()
            shown = re.sub(f"{_OWN_ESCAPE}{_STYLE}", "\x1b\\1", shown) if is_terminal else without_own_style(shown)
        self.rich_proxied_file.write(shown)
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write ``lines``."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)
