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
from friction_hil.config.own_loop import REFUSAL
from friction_hil.daemon.realtime import punctuality
from friction_hil.drive import SimulatedDriver
from friction_hil.errors import FrictionHilError, UsageError

_PRIORITY_BELOW_LOOP = 10
_STDIN_CHECK_S = 0.05
_MASTER_STOP_S = 5.0


def simulate(*, config: str, pace: str, master: bool, ready_fd: int | None, exit_with_stdin: bool) -> None:
    """Run the simulated drives of a configuration until a signal comes, or standard input is closed."""
    configuration = load(config, needs_models=False)
    if configuration.is_own_loop:
        raise UsageError(f"{config} {REFUSAL}")
    axes = {name: axis for name, axis in configuration.axes.items() if axis.simulation is not None}
    driver = _only_driver(config, configuration, axes)
    kind = load_driver(driver, SIMULATED_DRIVES)
    drives = kind(configuration, axes, pace=pace)
    conductor = _make_master(kind, driver, configuration, axes, pace) if master else None
    try:
        ready = f"ready: {drives.open()}"
        is_stopping = _stop_conditions(exit_with_stdin)
        click.echo(ready)
        if ready_fd is not None:
            _announce(ready_fd, ready)
        priority = configuration.realtime.priority if pace == "real" else 0
        with punctuality(max(priority - _PRIORITY_BELOW_LOOP, 1) if priority else 0):
            if conductor is None:
                drives.run(is_stopping)
            else:
                _run_with_master(drives, conductor, is_stopping, priority)
    finally:
        drives.close()


def _make_master(
    kind: type[SimulatedDriver], driver: str, configuration: Configuration, axes: dict[str, AxisConfig], pace: str
) -> Any:
    """Return the stand-in for the controller that moves the drives.

    Raises `UsageError`: there is none for drives of this kind, or the configuration is not that of a sidecar.
    """
    master = kind.make_master(configuration, axes, pace=pace)
    if master is None:
        raise UsageError(f"--master: there is no stand-in master for drives of the driver {driver}")
    return master


def _run_with_master(drives: SimulatedDriver, master: Any, is_stopping: Callable[[], bool], priority: int) -> None:
    """Serve the bus, with the master in a process of its own, until a signal comes or the master has ended."""
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(write_end)
        os._exit(_conduct(master, read_end, priority))
    os.close(read_end)
    try:
        drives.run(is_stopping)
        # the drives must answer while the master brings them to rest
        os.close(write_end)
        write_end = -1
        end = time.monotonic() + _MASTER_STOP_S
        drives.run(lambda: time.monotonic() > end or _has_ended(child))
    finally:
        if write_end >= 0:
            os.close(write_end)
        if not _has_ended(child):
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


def _conduct(master: Any, read_end: int, priority: int) -> int:
    """Run the master until its parent closes the pipe; return the exit status."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the parent tells when to stop, also after it was killed
    try:
        with punctuality(priority):
            master.run(lambda: bool(select.select([read_end], [], [], 0.0)[0]))
    except FrictionHilError as error:
        click.echo(f"master: {error}", err=True)
        return 1
    return 0


def _has_ended(child: int) -> bool:
    try:
        return os.waitpid(child, os.WNOHANG)[0] == child
    except ChildProcessError:
        return True


def _only_driver(config: str, configuration: Configuration, axes: dict[str, AxisConfig]) -> str:
    """Return the driver of all simulated axes.

    Raises `UsageError`: there is no simulated axis, there are several drivers, or other processes could not reach the
    bus.
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
