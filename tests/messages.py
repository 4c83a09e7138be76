"""What a message is about and its code, for assertions that are not to hold its words."""

import re
from collections.abc import Iterable


def codes_in(messages: str | Iterable[str]) -> str | list[str]:
    """Return ``x FH-103`` for ``x: no usable feedback ... [FH-103]``; a message without a code stays as it is."""
    if not isinstance(messages, str):
        return [str(codes_in(each)) for each in messages]
    code = re.search(r"\[(FH-\d{3})\]$", messages)
    if code is None:
        return messages
    about = re.match(r"(\w+): ", messages)
    return f"{about[1]} {code[1]}" if about else code[1]
