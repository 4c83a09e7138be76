"""What all commands share in printing: JSON on stdout, and consoles for people."""

import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.console import Console

option_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout, nothing else.")


def print_json(value: Any) -> None:
    """Print one JSON document on stdout. NaN and infinity become null; numpy scalars and arrays are fine.

    Raises
    ------
    TypeError
        ``value`` holds something that has no form in JSON.
    """
    click.echo(json.dumps(to_json(value), indent=2, ensure_ascii=False, allow_nan=False))


def to_json(value: Any) -> Any:
    """Turn ``value`` into what JSON can hold: NaN and infinity to None, arrays to lists, paths to text."""
    if value is None or isinstance(value, bool | str):
        return str(value) if isinstance(value, str) else value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(item) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    if hasattr(value, "tolist"):  # numpy, which is not imported for this
        return to_json(value.tolist())
    raise TypeError(f"{type(value).__name__} has no form in JSON: {value!r}")


def console(*, stderr: bool = False) -> "Console":
    """Make a rich console: stdout for results, stderr for progress and warnings."""
    from rich.console import Console

    return Console(stderr=stderr, highlight=False)


@contextmanager
def noticed_compilation(tell: Callable[[str], None]) -> Iterator[None]:
    """Call ``tell`` with a note whenever a kernel has to be compiled: that takes seconds, once on a machine."""
    from numba.core import event

    class Compilation(event.Listener):
        def on_start(self, _: object) -> None:
            tell("compiling, which is kept for the next time")

        def on_end(self, _: object) -> None:
            pass

    with event.install_listener("numba:compile", Compilation()):
        yield
