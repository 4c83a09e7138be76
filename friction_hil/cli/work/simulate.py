"""The work of ``friction-hil simulate``."""

import os
import select
import signal
import time
from collections.abc import Callable
from typing import Any

import click

from friction_hil.config import AxisConfig, Configuration, load
from friction_hil.config.drivers import SIMULATED_DRIVES, load_driver
from friction_hil.daemon.realtime import punctuality
from friction_hil.errors import UsageError

_PRIORITY_BELOW_LOOP = 10
_STDIN_CHECK_S = 0.05


def simulate(*, config: str, pace: str, ready_fd: int | None, exit_with_stdin: bool) -> None:
    """Run the simulated drives of a configuration until a signal comes, or standard input is closed."""
    configuration = load(config, needs_models=False)
    axes = {name: axis for name, axis in configuration.axes.items() if axis.simulation is not None}
    driver = _only_driver(config, configuration, axes)
    drives: Any = load_driver(driver, SIMULATED_DRIVES)(configuration, axes, pace=pace)
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


def _only_driver(config: str, configuration: Configuration, axes: dict[str, AxisConfig]) -> str:
    """Return the driver of all simulated axes.

    Raises
    ------
    UsageError
        There is no simulated axis, there are several drivers, or other processes could not reach the bus.
    """
    if not axes:
        raise UsageError(f"{config}: no axis has a 'simulation' section; an empty one (simulation: {{}}) is enough")
    drivers = sorted({axis.driver for axis in axes.values()})
    if len(drivers) > 1:
        raise UsageError(
            f"{config}: simulated axes use the drivers {', '.join(drivers)}; one process simulates one kind of drive: "
            "write a configuration for each"
        )
    if configuration.bus is not None and configuration.bus.interface == "virtual":
        raise UsageError(
            f"{config}: a bus of interface 'virtual' cannot be reached from outside its process; use udp_multicast"
        )
    return drivers[0]


def _announce(descriptor: int, line: str) -> None:
    try:
        os.write(descriptor, f"{line}\n".encode())
    except OSError as error:
        raise UsageError(f"--ready-fd {descriptor}: {error.strerror}") from error


def _stop_conditions(exit_with_stdin: bool) -> Callable[[], bool]:
    """Return a function that is true after a signal, or with ``exit_with_stdin`` once standard input is closed."""
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
        return _read_until_closed(0)

    return is_stopping


def _read_until_closed(descriptor: int) -> bool:
    """Discard what was written to a pipe; return true if its writer has closed it."""
    while select.select([descriptor], [], [], 0.0)[0]:
        if not os.read(descriptor, 4096):
            return True
    return False
