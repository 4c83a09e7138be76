"""The work of ``friction-hil set``, ``status``, ``start``, and of ``stop`` and ``reset`` for a running daemon."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from friction_hil.checked_yaml.text import parse
from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import say
from friction_hil.daemon import learning_words
from friction_hil.daemon.control.ask import ask
from friction_hil.daemon.control.names import find, running
from friction_hil.errors import MOST_PRINTED, ConfigurationError, FrictionHilError, UsageError, choices
from friction_hil.numerics.readable import quantity

_UNPROVED = "unknown"


def set_values(*, name: str, assignments: Sequence[str], as_json: bool) -> int:
    """Change settings of a daemon."""
    values = dict(map(_assignment, assignments))
    if len(values) < len(assignments):
        raise UsageError("a key is given twice")
    answer = ask(find(name), {"do": "set", "values": values})
    if as_json:
        print_json(answer)
    else:
        say(f"{name}: changed in cycle {answer['cycle']}: {', '.join(assignments)}", stderr=False)
    return 0


def start(*, name: str, as_json: bool) -> int:
    """Enable the axes of a daemon; return 1 unless they run."""
    return act_on_daemon(name, "start", as_json=as_json)


def is_daemon(config: str) -> bool:
    """Return True if an argument names a running daemon, and no file; a `UsageError`: it is neither."""
    if os.path.lexists(config):
        return False
    daemons = dict(running())
    if config in daemons:
        return True
    if os.sep in config or Path(config).suffix in (".yaml", ".yml"):
        return False  # meant as a file: its loading says what is wrong
    raise UsageError(
        f"there is no configuration file {config!r}, and no daemon of this name; {choices(config, daemons)}"
    )


def status(*, name: str | None, as_json: bool) -> int:
    """Print the state of one daemon, or of all that run here."""
    paths = {name: find(name)} if name is not None else dict(running())
    answers: dict[str, dict[str, Any]] = {}
    for each, path in paths.items():
        try:
            answers[each] = ask(path, {"do": "status"})
        except FrictionHilError as error:
            if name is not None:
                raise
            answers[each] = {"ok": False, "problems": [str(error)]}
    if as_json:
        print_json({"daemons": answers})
        return 0
    if not answers:
        say("no daemon runs here", stderr=False)
    for each, answer in answers.items():
        for line in _lines(each, answer):
            say(line, stderr=False)
    return 0


def _assignment(text: str) -> tuple[str, Any]:
    """Return key and value of ``x.gain=0.8``; the value is YAML, a model file becomes an absolute path.

    Raises `UsageError`: it is no assignment, or the value is not YAML.
    """
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise UsageError(f"{text!r} is no assignment: write AXIS.KEY=VALUE, e.g. x.gain=0.8")
    if key.endswith(".model"):
        return key, str(Path(value).absolute())
    try:
        document = parse(value, key)
    except ConfigurationError as error:
        raise UsageError(str(error)) from None
    if document.problems:
        raise UsageError("; ".join(map(str, document.problems[:MOST_PRINTED])))
    try:
        json.dumps(document.value, allow_nan=False)
    except ValueError:
        raise UsageError(f"{key}: must be a finite number, not {value}") from None
    return key, document.value


def act_on_daemon(name: str, what: str, *, as_json: bool) -> int:
    """Start, stop or reset a daemon; return 1 unless that was read back."""
    answer = ask(find(name), {"do": what})
    if as_json:
        print_json(answer)
    else:
        done = {"start": "started", "stop": "stopped", "reset": "reset"}[what]
        words = done if answer["is_done"] else f"NOT {done.upper()}"
        say(f"{name}: {words}; the run is {_words(answer['state'])}", stderr=False)
        for axis, state in answer["drives"].items():
            say(f"{axis}: {_drive(state)}", stderr=False)
        for fault in answer["faults"]:
            say(f"fault: {fault}", stderr=False)
    return 0 if answer["is_done"] else 1


def _drive(state: str) -> str:
    if state == _UNPROVED:
        return "UNKNOWN: it is not known whether it has power"
    return f"{state} read back"


def _words(state: str) -> str:
    return state.replace("_", " ")


def _lines(name: str, answer: dict[str, Any]) -> list[str]:
    if not answer["ok"]:
        return [f"{name}: {problem}" for problem in answer["problems"]]
    time_s = "" if answer["time_s"] is None else f", {answer['time_s']:.1f} s"
    changes = f", last change {answer['changes']}" if answer["changes"] else ""
    lines = [f"{name}: {_words(answer['state'])}{time_s}{changes} ({answer['configuration']})"]
    for axis, each in answer["axes"].items():
        unit, force = each["unit"], "N m" if each["unit"] == "rad" else "N"
        file = f" ({os.path.basename(each['model_file'])})" if each["model_file"] else ""
        gain = f"gain {each['gain']:g}" if each["enabled"] else "compensation off"
        lines.append(f"  {axis}: drive {each['drive_state']}, {gain}, {each['model']}{file}")
        if each["position"] is not None:
            lines.append(
                f"     position {quantity(each['position'], unit)}, "
                f"velocity {quantity(each['velocity'], unit + '/s')}, "
                f"compensation {quantity(each['compensation'], force)}"
            )
        if error := each.get("error_without"):
            rms, peak = quantity(error["rms"], unit), quantity(error["peak"], unit)
            lines.append(f"     following error without compensation {rms} RMS, {peak} peak")
        if learning := each.get("learning"):  # a daemon of an earlier version has none
            lines.append(f"     learning {learning_words.summary(learning)}")
            more = learning_words.parameters(learning), learning["last"] and f"last: {learning['last']}"
            lines += [f"     {text}" for text in more if text]
    lines += [f"  fault: {fault}" for fault in answer["faults"]]
    return [*lines, *(f"  warning: {warning}" for warning in answer["warnings"])]
