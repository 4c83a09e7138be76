"""``friction-hil demo``: the whole thing without hardware."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from friction_hil.cli.output import console, option_json, print_json

if TYPE_CHECKING:
    from friction_hil.demo.demonstration import Demo


@click.command("demo")
@click.option(
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("out/demo"),
    show_default=True,
    metavar="DIR",
    help="Folder for the report, its picture and the recording; those of a former demo are replaced.",
)
@click.option(
    "--pace",
    type=click.Choice(["auto", "real", "sync"]),
    default="auto",
    show_default=True,
    help="real: 1000 cycles a second. sync: in simulated time, as fast as this computer is. auto: real, and where this "
    "computer is too busy for that, sync.",
)
@option_json
def command(output: Path, pace: str, as_json: bool) -> int:
    """Let two simulated axes draw a circle, without and then with friction compensation.

    Needs no hardware and takes about 20 s. Simulated drives and the daemon run as separate processes on a virtual
    CAN bus. Exit status 1 if compensation did not help, or if a process failed.
    """
    from friction_hil.demo.demonstration import run_demo

    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    with _progress() as tell:
        demo = run_demo(output, pace, tell)
    if as_json:
        print_json(_as_dict(demo))
    else:
        _print(demo)
    for figure in demo.circularity.not_helped:
        click.echo(f"compensation did not help: {figure} is not lower with it", err=True)
    return 1 if demo.circularity.not_helped else 0


@contextmanager
def _progress() -> Iterator[Callable[[str, float | None], None]]:
    """Show what is going on: a bar on a terminal, a line for each new thing elsewhere. All of it on stderr."""
    if not sys.stderr.isatty():
        last = ""

        def tell_line(text: str, share: float | None) -> None:
            nonlocal last
            if text != last:
                click.echo(text if share is None else f"{text} ...", err=True)
                last = text

        yield tell_line
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    # no thread of its own to refresh it: it would take time from the loop
    columns = (BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console(stderr=True), transient=True, auto_refresh=False) as bar:
        task = bar.add_task("", total=1.0)

        def tell(text: str, share: float | None) -> None:
            if share is None:
                bar.console.print(text, markup=False, soft_wrap=True)
            else:
                bar.update(task, description=text, completed=share, refresh=True)

        yield tell


def _as_dict(demo: "Demo") -> dict[str, Any]:
    circularity, loop = demo.circularity, demo.loop
    laps = {"uncompensated": circularity.uncompensated, "compensated": circularity.compensated}
    timing = {name: loop[name] for name in ("cycles", "late_p50_us", "late_p99_us", "missed")}
    if demo.pace == "sync":
        timing.update(late_p50_us=None, late_p99_us=None)  # in simulated time nothing is late
    return {
        "axes": {
            axis: {
                name: {"rms": each.figures[axis].rms, "peak": each.figures[axis].peak} for name, each in laps.items()
            }
            for axis in circularity.axes
        },
        "loop": {"period_s": circularity.configuration.period_s, **timing},
        "report": demo.report,
        "recording": demo.recording,
    }


def _print(demo: "Demo") -> None:
    from rich.table import Table

    from friction_hil.reports.numbers import digits, unit_of_figures

    circularity, loop = demo.circularity, demo.loop
    factor, unit = unit_of_figures(circularity)
    before, after = circularity.uncompensated, circularity.compensated
    table = Table(f"following error [{unit}]", box=None, header_style="bold", pad_edge=False)
    for name in ("without", "with compensation", "times lower"):
        table.add_column(name, justify="right")
    for axis in circularity.axes:
        for name in ("rms", "peak"):
            values = [digits(getattr(laps.figures[axis], name) * factor) for laps in (before, after)]
            table.add_row(f"{axis} {name}", *values, digits(circularity.factor(axis, name), 2))
    out = console()
    out.print(table)
    out.print(f"{before.count} laps each; {before.left_out + after.left_out} of {2 * before.rows} periods do not count")
    late = "in simulated time"
    if demo.pace == "real":
        late = f"late p50 {loop['late_p50_us']:.0f} us, p99 {loop['late_p99_us']:.0f} us; {loop['missed']} missed"
    out.print(f"loop: {loop['cycles']} cycles of {circularity.configuration.period_s * 1e3:g} ms; {late}")
    for name in ("report", "picture", "recording"):
        out.print(f"{name}: {getattr(demo, name)}", markup=False, soft_wrap=True)
