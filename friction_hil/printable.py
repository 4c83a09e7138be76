"""Text of other origin on a terminal: control characters are shown, not sent.

Names of columns, axes and files, and what drives send, can contain escape sequences, which would move the cursor,
overwrite lines, or set the title of the window. Only `printable` decides what may reach a terminal; `PrintableStream`
applies it to everything that a command prints.
"""

import re
from collections.abc import Iterable
from typing import Any, TextIO

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


class PrintableStream:
    """A text stream that makes all text `printable` before it writes it to ``stream``.

    Attributes
    ----------
    rich_proxied_file : TextIO
        The stream itself, by rich's name for it: a rich console writes its own colours there, and makes the text
        printable before (`friction_hil.cli.work.tables.console`).
    """

    def __init__(self, stream: TextIO) -> None:
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        """Write ``text``; return its length."""
        self.rich_proxied_file.write(printable(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write ``lines``."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)
