"""``friction-hil latency``: wake-up latency of this machine."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.options import option_json


@click.command("latency")
@click.argument("config", required=False, type=click.Path(path_type=Path))
@click.option("--period", "period_s", type=float, metavar="S", help="Period of the loop.  [default: 0.001]")
@click.option("--spin", "spin_us", type=int, metavar="US", help="Busy waiting before each deadline, in µs; 0: none.")
@click.option(
    "--priority", type=click.IntRange(0, 99), metavar="N", help="SCHED_FIFO priority; 0: ordinary scheduling."
)
@click.option(
    "--duration", "duration_s", type=float, default=10.0, show_default=True, metavar="S", help="Of each part."
)
@click.option(
    "--output", type=click.Path(path_type=Path), metavar="FILE", help="Draw the histogram into FILE (.png, ...)."
)
@option_json
def command(**options: Any) -> int:
    """Measure how late this machine wakes up a loop.

    It waits for deadlines with the code of the daemon's loop, and does nothing in between. Period, busy waiting and
    priority are those of CONFIG, else the daemon's defaults. The same is measured without busy waiting, and with
    cyclictest where it is installed, one after the other. Load the machine as it will be loaded in operation. No drive
    is needed.
    """
    from friction_hil.cli.work.latency import run_latency  # imported here: --help must not wait for numba

    return run_latency(**options)
