"""The work of ``friction-hil stop`` and ``friction-hil reset``."""

from collections.abc import Mapping, Sequence
from typing import Any

from friction_hil.cli.output import print_json
from friction_hil.cli.work.control import act_on_daemon, is_daemon
from friction_hil.cli.work.tables import say
from friction_hil.config import AxisConfig, Configuration, load
from friction_hil.config.drivers import load_driver
from friction_hil.drive.driver import not_stopped
from friction_hil.drive.inventory import Stop, StopReport
from friction_hil.errors import FrictionHilError, UsageError, choices


def stop(*, config: str, axes: Sequence[str], as_json: bool) -> int:
    """Stop a daemon or drives; return 1 unless each drive has been read back without power."""
    if is_daemon(config):
        _refuse_axes(axes)
        return act_on_daemon(config, "stop", as_json=as_json)
    return _carry_out(config, axes, is_reset=False, as_json=as_json)


def reset(*, config: str, axes: Sequence[str], as_json: bool) -> int:
    """Reset faults; return 1 unless each drive has been read back without fault and without power."""
    if is_daemon(config):
        _refuse_axes(axes)
        return act_on_daemon(config, "reset", as_json=as_json)
    return _carry_out(config, axes, is_reset=True, as_json=as_json)


def _refuse_axes(axes: Sequence[str]) -> None:
    if axes:
        raise UsageError("--axis is for the drives of a configuration; a daemon stops and resets all of its axes")


def _carry_out(config: str, names: Sequence[str], *, is_reset: bool, as_json: bool) -> int:
    configuration = load(config, needs_models=False)
    chosen = _choose(config, configuration, names)
    found: dict[str, Stop] = {}
    notes: list[str] = []
    for driver in dict.fromkeys(axis.driver for axis in chosen.values()):
        of_driver = {name: axis for name, axis in chosen.items() if axis.driver == driver}
        report = _serve(driver, configuration, of_driver, is_reset=is_reset)
        found |= {each.axis: each for each in report.stops}
        notes += report.notes
    stops = [found[name] for name in chosen]
    if as_json:
        print_json({"axes": [_json(each) for each in stops], "notes": notes})
    else:
        for each in stops:
            say(_line(each, config, is_reset=is_reset), stderr=False)
        for note in notes:
            say(f"note: {note}", stderr=False)
    return 0 if all(each.is_proved for each in stops) else 1


def _choose(path: str, configuration: Configuration, names: Sequence[str]) -> dict[str, AxisConfig]:
    """Return the axes of these names, all axes for none; a `UsageError`: there is no axis of a name."""
    for name in names:
        if name not in configuration.axes:
            raise UsageError(f"--axis {name}: {path} has no such axis; {choices(name, configuration.axes)}")
    return {name: axis for name, axis in configuration.axes.items() if not names or name in names}


def _serve(driver: str, configuration: Configuration, axes: Mapping[str, AxisConfig], *, is_reset: bool) -> StopReport:
    """Stop or reset the drives of one driver; its failure must not keep the others from being stopped."""
    try:
        kind = load_driver(driver)
        return kind.reset_axes(configuration, axes) if is_reset else kind.stop_axes(configuration, axes)
    except FrictionHilError as error:
        return not_stopped(axes, str(error))


def _json(stop: Stop) -> dict[str, Any]:
    return {
        "axis": stop.axis,
        "address": stop.address,
        "before": stop.before.words,
        "after": stop.after.words,
        "result": stop.result,
        "fault": stop.fault,
        "detail": stop.reason,
    }


def _line(stop: Stop, config: str, *, is_reset: bool) -> str:
    before, after = stop.before.words, stop.after.words
    words = {
        "stopped": f"stopped: {before} before, {after} read back",
        "reset": f"fault reset: {stop.fault}; {after} read back, without power",
        "fault": f"STILL IN FAULT: {stop.fault}",
        "unpowered": f"{'had no fault' if is_reset else 'had no power'}: {after}",
        "powered": f"STILL POWERED: {after} read back",
        "unknown": "UNKNOWN: it is not known whether it has power",
    }[stop.result]
    if is_reset and stop.result == "powered" and stop.before.is_powered:
        words = f"NOT RESET: {before}, with power; friction-hil stop {config} takes its power"
    where = f" ({stop.address})" if stop.address else ""
    return f"{stop.axis}{where}: {words}{f' ({stop.reason})' if stop.reason else ''}"
