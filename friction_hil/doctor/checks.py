"""All checks of a machine and a configuration before a run; no drive receives a byte unless watchdogs are tried."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from friction_hil.config import Configuration, Realtime, file_problems, load
from friction_hil.config.drivers import driver_names, load_driver
from friction_hil.daemon.companion.paths import series_name
from friction_hil.daemon.realtime import RealClock, punctuality
from friction_hil.doctor import disk, machine, timing
from friction_hil.drive.finding import Finding, failure
from friction_hil.errors import MOST_PRINTED, ConfigurationError, FrictionHilError, Problem, more_problems
from friction_hil.numerics.jit import cache_folder
from friction_hil.recordings import columns

CONFIGURATION = "configuration"  # name of the check that reports mistakes
_ROOT = Path("/")
_PERIOD_S = 1e-3  # of a loop, without a configuration


def examine(path: Path | None, root: Path = _ROOT, *, try_watchdog: bool = False) -> Iterator[Finding]:
    """Check the machine, and everything that the configuration ``path`` needs from it.

    Yields the findings in the order of the checks, each as soon as it is known. Without a configuration, or if it has
    mistakes, each installed driver checks the machine for any drive. ``root``: of the system files that are read.
    ``try_watchdog``: also connect to each drive and let its watchdogs lapse, unless a check before has failed.
    """
    if not sys.platform.startswith("linux"):
        yield machine.operating_system()
        yield machine.compiled_kernels(cache_folder())
        if path is not None:
            yield from _findings(path, *_load(path))
        return
    yield machine.preemption(root)
    yield machine.processor_clock(root)
    yield machine.compiled_kernels(cache_folder())
    configuration = None
    problems: list[Problem] = []
    if path is not None:
        configuration, problems = _load(path)
        yield from _findings(path, configuration, problems)
    realtime = Realtime() if configuration is None else configuration.realtime
    yield from _punctuality(realtime.priority)
    yield from _timing(root, realtime, _PERIOD_S if configuration is None else configuration.period_s)
    if configuration is None:
        yield from _hardware(root)
        return
    is_well = not problems
    for finding in _daemon(configuration):
        is_well = is_well and finding.result != "fail"
        yield finding
    if try_watchdog and is_well:
        yield from _watchdogs(configuration)


def _watchdogs(configuration: Configuration) -> Iterator[Finding]:
    """Yield what each drive does when the daemon is silent."""
    clock = RealClock(configuration.realtime.spin_us)
    for name in dict.fromkeys(axis.driver for axis in configuration.axes.values()):
        axes = {key: axis for key, axis in configuration.axes.items() if axis.driver == name}
        found = load_driver(name).try_watchdogs(configuration, axes, clock)
        if found is None:
            detail = f"the driver {name} has no trial of its watchdogs"
            fix = "disconnect the drive's cable at standstill and see whether it loses its power"
            yield Finding(f"driver {name}: watchdogs", "warn", detail, fix, "FH-445")
            continue
        yield from found


def _load(path: Path) -> tuple[Configuration | None, list[Problem]]:
    try:
        configuration = load(path, needs_models=False)
    except ConfigurationError as error:
        return None, list(error.problems)
    return configuration, file_problems(path, configuration)


def _findings(path: Path, configuration: Configuration | None, problems: list[Problem]) -> Iterator[Finding]:
    yield from map(_mistake, problems[:MOST_PRINTED])
    for line in more_problems(problems):
        yield Finding(CONFIGURATION, "fail", line, "correct those above first", "FH-402")
    if configuration is not None:
        yield from _missing_models(configuration)
    if not problems:
        yield Finding(CONFIGURATION, "pass", f"{path}: no mistakes")


def _missing_models(configuration: Configuration) -> Iterator[Finding]:
    for name, axis in configuration.axes.items():
        file = axis.model.source_path
        if file is not None and not os.path.lexists(file):
            yield Finding(
                f"{name}: model", "warn", f"{file} does not exist yet", "friction-hil tune makes it", "FH-403"
            )


def _mistake(problem: Problem) -> Finding:
    if not problem.field and problem.line is None:
        detail = f"{problem.path}: {problem.message}"
        fix = "give the path of a configuration that this user may read"
        return Finding(CONFIGURATION, "fail", detail, fix, "FH-401")
    where = problem.path if problem.line is None else f"{problem.path}, line {problem.line}"
    detail = f"{problem.field}: {problem.message}" if problem.field else problem.message
    return Finding(CONFIGURATION, "fail", detail, f"correct {where}", "FH-402")


def _recording_rate(configuration: Configuration) -> float:
    """Return the bytes per second of a recording before its compression."""
    shadows = {shadow.name for axis in configuration.axes.values() for shadow in axis.shadows}
    return 8.0 * len(configuration.axes) * (len(columns.NAMES) + len(shadows)) / configuration.period_s


def _punctuality(priority: int) -> list[Finding]:
    if priority == 0:
        detail = "realtime.priority is 0: the loop runs at ordinary priority and makes no real-time settings"
        return [Finding("priority", "warn", detail, "omit realtime.priority if punctuality matters", "FH-313")]
    with punctuality(priority) as findings:
        return findings


def _timing(root: Path, realtime: Realtime, period_s: float) -> Iterator[Finding]:
    """Yield what may delay the wake-ups of a loop."""
    is_prevented = realtime.priority > 0 and os.access(root / "dev/cpu_dma_latency", os.W_OK)
    yield timing.isolation(root, timing.own_cpus())
    yield timing.processor_load(root, timing.own_cpus())
    yield timing.interrupts(root)
    yield timing.throttling(root, 1e-6 * realtime.spin_us / period_s)
    yield timing.sleep_states(root, is_prevented=is_prevented)
    yield timing.cgroup_limits(root)
    yield timing.clock_source(root)


def _hardware(root: Path) -> Iterator[Finding]:
    """Yield what each installed driver finds on the machine; equal findings of several drivers once."""
    reported: set[Finding] = set()
    for name in driver_names():
        try:
            driver = load_driver(name)
        except ImportError as error:
            fix = "install its dependencies with pip"
            yield Finding(f"driver {name}", "warn", f"it cannot be imported: {error}", fix, "FH-405")
            continue
        for finding in driver.check_machine(root):
            if finding not in reported:
                reported.add(finding)
                yield finding


def _daemon(configuration: Configuration) -> Iterator[Finding]:
    """Yield what a run of this configuration would meet before its first cycle."""
    recording = configuration.recording
    if recording is not None and recording.path is not None:
        rate = _recording_rate(configuration)
        found = disk.recording_folder(
            recording.path, rate, recording.budget_bytes, series_name(configuration.source_path, recording.path)
        )
        yield found
        if found.result != "fail":
            yield disk.recording_speed(recording.path, rate)
    for name, axis in configuration.axes.items():
        for note in axis.model.friction_model.notes:
            yield Finding(f"{name}: model", "warn", note, "check whether the model file is meant so", "FH-404")
    for name in dict.fromkeys(axis.driver for axis in configuration.axes.values()):
        axes = {key: axis for key, axis in configuration.axes.items() if axis.driver == name}
        try:
            connection = load_driver(name).check_connection(configuration, axes)
            if connection is None:
                detail = f"the driver {name} has no checks of its connection"
                fix = "friction-hil run with --dry-run connects and only listens"
                connection = (Finding(f"driver {name}", "warn", detail, fix, "FH-406"),)
            yield from connection
        except FrictionHilError as error:
            yield failure(f"driver {name}", error, "FH-407")
