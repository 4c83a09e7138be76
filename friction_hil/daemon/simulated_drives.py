"""Simulated drives for a command that usually runs real ones (``--simulate``): on a bus or on lines of their own."""

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from friction_hil.checked_yaml.text import dump
from friction_hil.config import Configuration, self_contained
from friction_hil.config.drivers import SIMULATED_DRIVES, load_driver
from friction_hil.config.load import only_driver
from friction_hil.daemon.child import Child
from friction_hil.daemon.latency import why_not_real_time
from friction_hil.daemon.realtime import RealClock
from friction_hil.errors import DriveError, FrictionHilError, UsageError

_TICK_S, _QUIET_S = 0.02, 1.0
_READY = "ready: "


@contextmanager
def simulated_drives(
    configuration: Configuration,
    pace: str,
    report: Callable[[str], None],
    is_interrupted: Callable[[], bool] = lambda: False,
) -> Iterator[Configuration]:
    """Start the simulated drives of a configuration, and yield the configuration that reaches them.

    They are another process, ``friction-hil simulate``, which ends with this one in any case. Bus or lines are used by
    nothing else, so that no command can reach a real drive. A sidecar gets its stand-in master too.

    ``configuration``: axes without ``simulation`` get simulated drives with its defaults. ``pace``: real or sync.
    ``report`` is called with lines for the user. ``is_interrupted`` is True once the user wants to stop.

    Raises `UsageError`: the driver has no simulated drives that can be moved to a bus of their own; `DriveError`: the
    simulated drives do not start; `KeyboardInterrupt`: the user stopped before they were ready.
    """
    driver = only_driver(configuration)
    with tempfile.TemporaryDirectory(prefix="friction-hil-") as name:
        folder = Path(name)
        made = load_driver(driver, SIMULATED_DRIVES).make_private(configuration, folder)
        if made is None:
            raise UsageError(
                f"--simulate: simulated drives of the driver {driver} cannot have a bus of their own; start them with "
                "'friction-hil simulate' in another terminal"
            )
        private, former = made
        file = folder / "simulated.yaml"
        file.write_text(dump(self_contained(private)), encoding="utf-8")
        words = ["simulate", str(file), "--exit-with-stdin", "--pace", pace]
        if private.bus is not None and private.bus.role == "sidecar":
            words.append("--master")
        with Child(words, folder) as drives:
            where, *notes = _wait_until_ready(drives, report, is_interrupted)
            report(f"simulated drives: {where}, on a private bus instead of {former}")
            for line in notes:
                report(line)
            try:
                yield private
            except FrictionHilError:
                hint_at_simulated_time(configuration, pace, report)
                raise
            if drives.wait(0.0):
                report(f"the simulated drives ended before the run: {drives.said.strip() or 'no message'}")


def hint_at_simulated_time(configuration: Configuration, pace: str, report: Callable[[str], None]) -> None:
    """Say after a failure if this computer is too busy for real time, which simulated drives do not need."""
    if pace == "real" and (reason := why_not_real_time(RealClock(0), configuration.period_s)):
        report(f"{reason}; --pace sync runs in simulated time, in which nothing is late")


def _wait_until_ready(drives: Child, report: Callable[[str], None], is_interrupted: Callable[[], bool]) -> list[str]:
    """Return what they print when they are on the bus: nodes and bus, then notes."""
    begin_s, is_told = time.monotonic(), not sys.stderr.isatty()
    while not (printed := drives.printed).endswith("\n"):
        if not is_told and time.monotonic() > begin_s + _QUIET_S:
            is_told = True
            report("starting the simulated drives: the first time, they are compiled for this machine")
        if is_interrupted():
            raise KeyboardInterrupt
        if drives.wait(_TICK_S):
            drives.refuse_failure(DriveError)
            raise DriveError("the simulated drives ended before they were ready")
    return printed.strip().removeprefix(_READY).splitlines()
