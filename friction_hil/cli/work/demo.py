"""The work of ``friction-hil demo``."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from friction_hil.cli.output import print_json
from friction_hil.cli.work.progress import progress_bar
from friction_hil.cli.work.tables import new_table, number, print_files, print_table, say
from friction_hil.demo import demonstration
from friction_hil.demo.demonstration import Demo

if TYPE_CHECKING:
    from friction_hil.analysis.circularity import Circularity


def demonstrate(*, output: Path, pace: str, as_json: bool) -> int:
    """Run the demo and print its figures; return 1 if compensation did not help, as given or as learned."""
    for each in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(each) is not signal.SIG_IGN:
            signal.signal(each, signal.default_int_handler)
    with demo_progress() as show:
        demo = demonstration.run_demo(output, pace, show)
    if as_json:
        print_json(_as_dict(demo))
    else:
        _print(demo)
    circularity = demo.circularity
    for figure in circularity.not_helped:
        click.echo(f"compensation did not help: {figure} is not lower with it", err=True)
    for figure in circularity.learning_harmed:
        click.echo(f"learning made it worse: {figure} is not lower than without compensation", err=True)
    for figure in circularity.learning_not_helped:
        click.echo(f"learning did not help: {figure} is not lower than with the model as given", err=True)
    return 1 if circularity.not_helped or circularity.learning_harmed else 0


@contextmanager
def demo_progress() -> Iterator[Callable[[str, float | None], None]]:
    """Yield a function that shows a text and the completed fraction on stderr; or a remark, and None.

    On a terminal there is a bar, elsewhere a line for each new text.
    """
    if not sys.stderr.isatty():
        last = ""

        def show_line(text: str, done: float | None) -> None:
            nonlocal last
            if text != last:
                click.echo(text if done is None else f"{text} ...", err=True)
                last = text

        yield show_line
        return
    with progress_bar(is_threaded=False) as bar:
        task = bar.add_task("", total=1.0)

        def show(text: str, done: float | None) -> None:
            if done is None:
                bar.console.print(text, markup=False, soft_wrap=True)
            else:
                bar.update(task, description=text, completed=done, refresh=True)

        yield show


def _as_dict(demo: Demo) -> dict[str, Any]:
    circularity, loop = demo.circularity, demo.loop
    laps = {
        "uncompensated": circularity.uncompensated,
        "compensated": circularity.compensated,
        "learned": circularity.learned,
    }
    learning = dict(loop.get("learning", {}))
    timing = {name: loop[name] for name in ("cycles", "late_p50_us", "late_p99_us", "missed")}
    if demo.pace == "sync":
        timing.update(late_p50_us=None, late_p99_us=None)  # in simulated time nothing is late
        learning.update(cpu_share=None)  # which depends on the computer
    return {
        "axes": {
            axis: {name: None if each is None else asdict(each.figures[axis]) for name, each in laps.items()}
            for axis in circularity.axes
        },
        "loop": {"period_s": circularity.configuration.period_s, **timing},
        "learning": learning,
        "report": demo.report,
        "recording": demo.recording,
    }


def _print(demo: Demo) -> None:
    # imported here: loaded while the drives start
    from friction_hil.reports.circularity_report import learning_lines

    circularity, loop = demo.circularity, demo.loop
    _print_figures(circularity)
    left_out, rows = (sum(getattr(each, name) for each in circularity.laps) for name in ("left_out", "rows"))
    laps = circularity.uncompensated.count
    click.echo(f"{laps} laps each; {left_out} of {rows} periods left out because the computer was late")
    for line in learning_lines(circularity, loop):
        say(line, stderr=False)
    late = "in simulated time"
    if demo.pace == "real":
        late = f"late p50 {loop['late_p50_us']:.0f} µs, p99 {loop['late_p99_us']:.0f} µs; {loop['missed']} missed"
    click.echo(f"loop: {loop['cycles']} cycles of {circularity.configuration.period_s * 1e3:g} ms; {late}")
    print_files({name: getattr(demo, name) for name in ("report", "picture", "recording")})


def _print_figures(circularity: "Circularity") -> None:
    # imported here: loaded while the drives start
    from friction_hil.analysis.circularity import FIGURES
    from friction_hil.reports.numbers import figure_rows, unit_of_figures

    _, unit = unit_of_figures(circularity)
    with_compensation = ("with model\nas given", "with what\nwas learned")[: len(circularity.laps) - 1]
    headings = [number("without\ncompensation")]
    for words in with_compensation:
        headings += number(words), number("times\nlower")
    table = new_table("axis", "following\nerror", *headings, keys=2)
    for axis, name, (without, *errors), ratios in figure_rows(circularity):
        cells = [cell for pair in zip(errors, ratios, strict=True) for cell in pair]
        table.add_row(axis if name == FIGURES[0] else "", f"{name} [{unit}]", without, *cells)
    print_table(table)
