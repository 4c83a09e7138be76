"""The work of ``friction-hil demo``."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from friction_hil.cli.output import print_json
from friction_hil.cli.work.following import Compared, following_table
from friction_hil.cli.work.progress import progress_bar
from friction_hil.cli.work.tables import print_files, print_table
from friction_hil.demo import demonstration
from friction_hil.demo.demonstration import Demo


def demonstrate(*, output: Path, pace: str, as_json: bool) -> int:
    """Run the demo and print its figures; return 1 if compensation did not help."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)
    with _progress() as show:
        demo = demonstration.run_demo(output, pace, show)
    if as_json:
        print_json(_as_dict(demo))
    else:
        _print(demo)
    for figure in demo.circularity.not_helped:
        click.echo(f"compensation did not help: {figure} is not lower with it", err=True)
    return 1 if demo.circularity.not_helped else 0


@contextmanager
def _progress() -> Iterator[Callable[[str, float | None], None]]:
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


def _print(demo: Demo) -> None:
    circularity, loop = demo.circularity, demo.loop
    before, after = circularity.uncompensated, circularity.compensated
    rows = []
    for axis in circularity.axes:
        without, compensated = before.figures[axis], after.figures[axis]
        rows.append(Compared((axis,), circularity.unit, without, compensated, without.times(compensated)))
    print_table(following_table(("axis",), rows))
    left_out = before.left_out + after.left_out
    click.echo(
        f"{before.count} laps each; {left_out} of {2 * before.rows} periods left out because the computer was late"
    )
    late = "in simulated time"
    if demo.pace == "real":
        late = f"late p50 {loop['late_p50_us']:.0f} µs, p99 {loop['late_p99_us']:.0f} µs; {loop['missed']} missed"
    click.echo(f"loop: {loop['cycles']} cycles of {circularity.configuration.period_s * 1e3:g} ms; {late}")
    print_files({name: getattr(demo, name) for name in ("report", "picture", "recording")})
