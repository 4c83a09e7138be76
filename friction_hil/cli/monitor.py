"""``friction-hil monitor``: shows a running daemon live."""

from typing import Any

import click

from friction_hil.cli.completion import complete_daemon


@click.command("monitor")
@click.argument("name", required=False, shell_complete=complete_daemon)
@click.option("--window", "window_s", type=click.FloatRange(0.1, 600.0), default=10.0, show_default=True, metavar="S")
@click.option("--once", is_flag=True, help="Show it once and end; exit status 1 if the daemon has a fault.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object a line, each second.")
def command(**options: Any) -> int:
    """Show the daemon NAME live: axes, following error, friction, lateness and faults.

    NAME may be left out where only one runs. Following error and lateness are those of the last S seconds (--window).
    The daemon does not notice who looks, and nothing is ever written to it. q or Ctrl-C ends the monitor, not the
    daemon; Tab shows the friction of the next axis. Where the output is no terminal, it is one line a second. While no
    daemon of this name runs, the monitor waits for it.

    Exit status: 0 after q or Ctrl-C; with --once 1 if the daemon has a fault, 2 if it does not run.
    """
    from friction_hil.cli.work.monitor import monitor  # imported here: --help must not wait for numpy

    return monitor(**options)
