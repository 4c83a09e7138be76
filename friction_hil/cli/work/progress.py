"""Progress on stderr: a line that says what a command is doing, and bars."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from friction_hil.cli.work.tables import console

_COMPILING = "compiling, once on this machine"


@contextmanager
def status_line(text: str) -> Iterator[Callable[[str], None]]:
    """Show ``text`` beside a spinner, and yield a function that replaces it; nothing is shown without a terminal.

    While numba compiles, which takes seconds and happens once on a machine, the line says so.
    """
    shown = text
    with console(stderr=True).status(text) as status:

        def show(text: str) -> None:
            nonlocal shown
            shown = text
            status.update(text)

        with _compilation_reported(lambda: status.update(f"{shown}: {_COMPILING}")):
            yield show


@contextmanager
def _compilation_reported(report: Callable[[], None]) -> Iterator[None]:
    from numba.core import event  # imported here: a command that compiles nothing must not wait for numba

    class Compilation(event.Listener):
        def on_start(self, _: object) -> None:
            report()

        def on_end(self, _: object) -> None:
            pass

    with event.install_listener("numba:compile", Compilation()):
        yield


def progress_bar(*, is_threaded: bool = True) -> Progress:
    """Return a bar with text and elapsed time, which vanishes at the end.

    ``is_threaded=False``: it has no thread that refreshes it, which would take time from a real-time loop.
    """
    columns = (BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    return Progress(*columns, console=console(stderr=True), transient=True, auto_refresh=is_threaded)
