"""``friction-hil live``: serves the data of a running daemon to browsers, Foxglove and Prometheus."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.completion import complete_daemon

_PORT = 8080


@click.command("live")
@click.argument("name", shell_complete=complete_daemon)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    metavar="PORT",
    help=f"Serve the page, and /metrics for Prometheus. Default: {_PORT} without --foxglove; 0: a free port.",
)
@click.option(
    "--foxglove", type=click.IntRange(0, 65535), metavar="PORT", help="Serve a Foxglove WebSocket, on loopback alone."
)
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    metavar="ADDRESS",
    help="Address at which the page is served. Beyond loopback, reading needs the token too.",
)
@click.option(
    "--allow-host",
    "allow_hosts",
    multiple=True,
    metavar="NAME",
    help="Let browsers call page and WebSocket by this name too, and the WebSocket from its pages.",
)
@click.option(
    "--token-file",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Take the token that changes need from FILE (mode 600), made if it is not there. Default: a random one.",
)
@click.option("--exit-with-stdin", is_flag=True, help="Stop when standard input is closed, e.g. by a parent process.")
def command(**options: Any) -> int:
    """Serve the live data of the daemon NAME: a page for browsers, metrics for Prometheus, a WebSocket for Foxglove.

    It waits for the daemon, and attaches again when that one has ended and comes back. The loop is not touched. The
    page can change gain and model, switch the compensation, reset and stop; it cannot enable an axis.

    'live: {dashboard: 8080, foxglove: 8765}' in a configuration lets 'run' start it. Ctrl-C ends it.
    """
    if options["port"] is None and options["foxglove"] is None:
        options["port"] = _PORT
    from friction_hil.cli.work.live import live  # imported here: --help must not wait for numpy

    return live(**options)
