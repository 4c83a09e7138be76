"""``friction-hil simulate``: the drives of a configuration, simulated on its bus."""

from typing import Any

import click


@click.command("simulate")
@click.argument("config", type=click.Path(dir_okay=False))
@click.option(
    "--pace",
    type=click.Choice(["real", "sync"]),
    default="real",
    show_default=True,
    help="real: keep real time. sync: advance by exactly one period at each SYNC or request, for tests that do not "
    "depend on the clock.",
)
@click.option(
    "--master",
    is_flag=True,
    help="Also simulate the controller that moves the drives, for a configuration with bus.role: sidecar.",
)
@click.option("--ready-fd", type=int, metavar="N", help="Also write the 'ready' line to this file descriptor.")
@click.option("--exit-with-stdin", is_flag=True, help="Stop when standard input is closed, e.g. by a parent process.")
def command(**options: Any) -> None:
    """Simulate the drives of CONFIG on its bus, until interrupted.

    The axes with a 'simulation' section are simulated; all of them must have the same driver. One line 'ready: ...' on
    standard output reports that the drives are on the bus.
    """
    from friction_hil.cli.work.simulate import simulate  # imported here: --help must not wait for numba

    simulate(**options)
