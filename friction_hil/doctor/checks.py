"""Everything that can be told of a machine and a configuration before the daemon runs; no drive notices it."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.config.drivers import driver_names, load_driver
from friction_hil.daemon.realtime import punctuality
from friction_hil.doctor import machine
from friction_hil.drive.finding import Finding, failure
from friction_hil.errors import ConfigurationError, FrictionHilError, Problem

if TYPE_CHECKING:
    from friction_hil.config import Configuration

CONFIGURATION = "configuration"  # the check that finds its mistakes
_ROOT = Path("/")


def examine(path: Path | None, root: Path = _ROOT) -> Iterator[Finding]:
    """Look at the machine, and at all that the configuration ``path`` needs of it.

    Parameters
    ----------
    path : Path, optional
        A configuration. Without one, or where it has mistakes, the drivers tell what there is for any drive.
    root : Path
        Where the files by which the system tells about itself begin.
    """
    from friction_hil.config import Realtime
    from friction_hil.numerics.jit import cache_folder

    yield machine.preemption(root)
    yield machine.processor_clock(root)
    yield machine.compiled_kernels(cache_folder())
    configuration = None
    if path is not None:
        configuration, problems = _load(path)
        yield from map(_mistake, problems)
        if configuration is not None:
            yield from _missing_models(configuration)
        if not problems:
            yield Finding(CONFIGURATION, "pass", f"{path}: no mistakes")
    realtime = Realtime() if configuration is None else configuration.realtime
    yield from _punctuality(realtime.priority)
    if configuration is None:
        yield from _hardware(root)
    else:
        yield from _daemon(configuration)


def _load(path: Path) -> "tuple[Configuration | None, list[Problem]]":
    from friction_hil.config import file_problems, load

    try:
        configuration = load(path, needs_models=False)
    except ConfigurationError as error:
        return None, list(error.problems)
    return configuration, file_problems(path, configuration)


def _missing_models(configuration: "Configuration") -> Iterator[Finding]:
    for name, axis in configuration.axes.items():
        file = axis.model.source_path
        if file is not None and not file.exists():
            yield Finding(f"{name}: model", "warn", f"there is no {file} yet", "friction-hil tune makes it")


def _mistake(problem: Problem) -> Finding:
    if not problem.field and problem.line is None:
        detail = f"{problem.path}: {problem.message}"
        return Finding(CONFIGURATION, "fail", detail, "give the path of a configuration that this user may read")
    where = problem.path if problem.line is None else f"{problem.path}, line {problem.line}"
    detail = f"{problem.field}: {problem.message}" if problem.field else problem.message
    return Finding(CONFIGURATION, "fail", detail, f"correct {where}")


def _punctuality(priority: int) -> list[Finding]:
    if priority == 0:
        detail = "realtime.priority is 0: the loop runs at ordinary priority, and nothing is asked of the system"
        return [Finding("priority", "warn", detail, "leave realtime.priority out, where punctuality matters")]
    with punctuality(priority) as findings:
        return findings


def _hardware(root: Path) -> Iterator[Finding]:
    """Let each installed driver tell what the machine has for it; several may tell the same."""
    told: set[Finding] = set()
    for name in driver_names():
        try:
            driver = load_driver(name)
        except ImportError as error:
            yield Finding(f"driver {name}", "warn", f"it cannot be imported: {error}", "install what it needs with pip")
            continue
        check = getattr(driver, "check_machine", None)
        for finding in () if check is None else check(root):
            if finding not in told:
                told.add(finding)
                yield finding


def _daemon(configuration: "Configuration") -> Iterator[Finding]:
    """Tell what a run of this configuration would find on its way to the drives."""
    if configuration.recording is not None:
        yield machine.recording_folder(configuration.recording.path)
    for name, axis in configuration.axes.items():
        for note in axis.model.friction_model.notes:
            yield Finding(f"{name}: model", "warn", note, "see whether the model file means that")
    for name in dict.fromkeys(axis.driver for axis in configuration.axes.values()):
        check = getattr(load_driver(name), "check_connection", None)
        axes = {key: axis for key, axis in configuration.axes.items() if axis.driver == name}
        if check is None:
            detail = f"the driver {name} tells nothing of its connection beforehand"
            yield Finding(f"driver {name}", "warn", detail, "friction-hil run with --dry-run connects to listen")
            continue
        try:
            yield from check(configuration, axes)
        except FrictionHilError as error:
            yield failure(f"driver {name}", error)
