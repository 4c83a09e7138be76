"""Progress on stderr: a line that says what a command is doing, and bars."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Column

from friction_hil.cli.work.tables import console
from friction_hil.numerics.readable import shortened

if TYPE_CHECKING:
    from friction_hil.tuning.settings import ShowStep

_COMPILING = "compiling, once on this machine"
_BEFORE_TEXT = 11  # columns: spinner, time, gaps, and the last column, in which some terminals wrap


@contextmanager
def status_line(text: str) -> Iterator["ShowStep"]:
    """Show ``text`` with a spinner and the time that has passed; yield a function that shows the next step.

    The function takes the text, and the number of the step and of all steps if they are known: then they are shown, and
    with the number of all steps the time that is left. Nothing is shown without a terminal. While numba compiles, which
    takes seconds and happens once on a machine, the line says so.
    """
    columns = (SpinnerColumn(), TimeElapsedColumn(), TextColumn("{task.description}", markup=False))
    errors = console(stderr=True)
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as bar:
        task, steps, shown, count_text = bar.add_task(text, total=None), _Steps(time.monotonic), text, ""

        def update(text: str) -> None:
            line = f"{count_text}  {text}" if count_text else text
            bar.update(task, description=shortened(line, errors.width - _BEFORE_TEXT))

        def show(text: str, number: int = 0, count: int | None = None, /) -> None:
            nonlocal shown, count_text
            shown, count_text = text, steps.text(number, count)
            update(text)

        with _compilation_reported(lambda: update(f"{_COMPILING}: {shown}")):
            yield show


def by_share(show: "ShowStep") -> Callable[[str, float | None], None]:
    """Return the callback of a public function that shows its steps, as per cent of what there is to do."""

    def on_step(text: str, share: float | None) -> None:
        if share is None:
            show(text)
        else:
            show(text, min(round(100.0 * share) + 1, 100), 100)

    return on_step


class _Steps:
    """Count of the steps of a stage, with an estimate of the time that is left; ``clock`` returns the time, s."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._began = clock()

    def text(self, number: int, count: int | None) -> str:
        """Return ``3 of 24, 0:40 left``; without a ``count`` the number alone, and without a number nothing."""
        if number <= 1:
            self._began = self._clock()
        if not number:
            return ""
        if count is None:
            return str(number)
        left = ""
        if number > 1:
            left_s = (self._clock() - self._began) / (number - 1) * (count - number + 1)
            left = "" if left_s < 1.0 else f", {int(left_s) // 60}:{int(left_s) % 60:02d} left"
        return f"{number} of {count}{left}"


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


def _text_column() -> TextColumn:
    """Return the column of the text, which comes last and gets the room that is left."""
    return TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis"))


def progress_bar(*, is_threaded: bool = True) -> Progress:
    """Return a bar with text, the time that has passed and that is left; it vanishes at the end.

    ``is_threaded=False``: it has no thread that refreshes it, which would take time from a real-time loop.
    """
    columns = (BarColumn(bar_width=20), TimeElapsedColumn(), TimeRemainingColumn(), _text_column())
    return Progress(*columns, console=console(stderr=True), transient=True, auto_refresh=is_threaded)
