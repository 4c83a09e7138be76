"""``friction-hil simulate``: the drives of a configuration, simulated on its bus."""

import os
import select
import signal
import time
from collections.abc import Callable
from typing import Any

import click

_PRIORITY_BELOW_LOOP = 10
_STDIN_CHECK_S = 0.05


@click.command()
@click.argument("config", type=click.Path(dir_okay=False))
@click.option(
    "--pace",
    type=click.Choice(["real", "sync"]),
    default="real",
    show_default=True,
    help="real: keep real time. sync: advance by exactly one period at each SYNC, for tests that depend on no clock.",
)
@click.option("--ready-fd", type=int, metavar="N", help="Also write the 'ready' line to this file descriptor.")
@click.option("--exit-with-stdin", is_flag=True, help="End when standard input is closed, as a child of a test.")
def command(config: str, pace: str, ready_fd: int | None, exit_with_stdin: bool) -> None:
    """Simulate the drives of CONFIG on its bus, until interrupted.

    The axes with a 'simulation' section are simulated; all of them must have the same driver. One line
    'ready: ...' on standard output says that the drives are on the bus.
    """
    from friction_hil.config import load
    from friction_hil.config.drivers import SIMULATED_DRIVES, load_driver
    from friction_hil.daemon.realtime import punctuality
    from friction_hil.errors import UsageError

    configuration = load(config, needs_models=False)
    axes = {name: axis for name, axis in configuration.axes.items() if axis.simulation is not None}
    if not axes:
        raise UsageError(f"{config}: no axis has a 'simulation' section; an empty one (simulation: {{}}) will do")
    drivers = sorted({axis.driver for axis in axes.values()})
    if len(drivers) > 1:
        raise UsageError(
            f"{config}: simulated axes use the drivers {', '.join(drivers)}; one process simulates one kind of drive: "
            "give each its own configuration"
        )
    if configuration.bus is not None and configuration.bus.interface == "virtual":
        raise UsageError(
            f"{config}: nobody outside this process can hear a bus of interface 'virtual'; use udp_multicast"
        )
    drives: Any = load_driver(drivers[0], SIMULATED_DRIVES)(configuration, axes, pace=pace)
    try:
        ready = f"ready: {drives.open()}"
        is_stopping = _stop_conditions(exit_with_stdin)
        click.echo(ready)
        if ready_fd is not None:
            _announce(ready_fd, ready)
        priority = configuration.realtime.priority if pace == "real" else 0
        with punctuality(max(priority - _PRIORITY_BELOW_LOOP, 1) if priority else 0):
            drives.run(is_stopping)
    finally:
        drives.close()


def _announce(descriptor: int, line: str) -> None:
    from friction_hil.errors import UsageError

    try:
        os.write(descriptor, f"{line}\n".encode())
    except OSError as error:
        raise UsageError(f"--ready-fd {descriptor}: {error.strerror}") from error


def _stop_conditions(exit_with_stdin: bool) -> Callable[[], bool]:
    """Make the question whether to end: a signal came, or standard input is closed."""
    is_interrupted = False

    def interrupt(*_: object) -> None:
        nonlocal is_interrupted
        is_interrupted = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    if not exit_with_stdin:
        return lambda: is_interrupted

    next_check = 0.0

    def is_stopping() -> bool:
        nonlocal next_check
        now = time.monotonic()
        if is_interrupted or now < next_check:
            return is_interrupted
        next_check = now + _STDIN_CHECK_S
        return _is_closed(0)

    return is_stopping


def _is_closed(descriptor: int) -> bool:
    """Whether the writer of a pipe has gone; what it wrote is dropped."""
    while select.select([descriptor], [], [], 0.0)[0]:
        if not os.read(descriptor, 4096):
            return True
    return False
