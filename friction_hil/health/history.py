"""Observations kept in a file: one line of JSON for each recording and axis, so that recordings may be removed.

The first line of an axis is its layout. A recording that has been observed is known again by its name and start. It is
read again only if it has grown since; what it shows then takes the place of what it showed before.
"""

import dataclasses
import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from friction_hil.errors import FrictionHilError
from friction_hil.health.observation import Layout, Motion, Observation, Quantity

_VERSION = 1


def state_of(path: Path) -> str:
    """Return what differs when the content of a file does."""
    facts = path.stat()
    return f"{facts.st_size} {facts.st_mtime_ns}"


@dataclass(slots=True)
class History:
    """What is known of the axes of a machine."""

    layouts: dict[str, Layout] = field(default_factory=dict)  # by axis
    parts: dict[str, dict[str, list[Observation]]] = field(default_factory=dict)  # by axis and recording
    states: dict[str, str] = field(default_factory=dict)  # of the file of each recording, as it was read

    def observations(self, axis: str) -> list[Observation]:
        """Return all observations of an axis."""
        return [each for part in self.parts[axis].values() for each in part]

    def add_layout(self, axis: str, layout: Layout) -> dict[str, Any]:
        """Set the layout of an axis; return its line."""
        self.layouts[axis] = layout
        return {"version": _VERSION, "axis": axis, "layout": dataclasses.asdict(layout)}

    def add(self, recording: str, state: str, axis: str, observations: list[Observation]) -> dict[str, Any]:
        """Set what a recording shows of an axis; return its line."""
        self.parts.setdefault(axis, {})[recording] = observations
        self.states[recording] = state
        found = [dataclasses.asdict(each) for each in observations]
        return {"version": _VERSION, "recording": recording, "state": state, "axis": axis, "observations": found}


def load(path: Path) -> History:
    """Read a history; an empty one if there is no such file.

    Raises `FrictionHilError`: the file cannot be read, or a line is not that of a history.
    """
    history = History()
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return history
    except (OSError, UnicodeDecodeError) as error:
        raise FrictionHilError(f"{path} cannot be read: {error}") from None
    lines = text.splitlines()
    for number, line in enumerate(lines, 1):
        try:
            _take(history, json.loads(line, parse_constant=_refuse))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            if number == len(lines) and not text.endswith("\n"):
                continue  # cut off while it was written; the recording is read again
            raise FrictionHilError(
                f"{path}, line {number}: is no line of a history of friction ({error}); give another file, or remove "
                "this one to begin again"
            ) from None
    return history


def _refuse(text: str) -> float:
    raise ValueError(f"{text} is not finite")


def _take(history: History, line: dict[str, Any]) -> None:
    if line["version"] != _VERSION:
        raise ValueError(f"version {line['version']}, this program knows {_VERSION}")
    if "layout" in line:
        own = line["layout"]
        if own["kind"] not in ("rotary", "linear"):
            raise ValueError(f"kind {own['kind']!r}")
        history.add_layout(line["axis"], Layout(own["kind"], _numbers(own["edges"]), _numbers(own["orders"])))
        return
    found = [_observation(each) for each in line["observations"]]
    history.add(str(line["recording"]), str(line["state"]), str(line["axis"]), found)


def _observation(content: dict[str, Any]) -> Observation:
    temperature = content["temperature"]
    return Observation(
        source=str(content["source"]),
        time_s=_number(content["time_s"]),
        duration_s=_number(content["duration_s"]),
        temperature=None if temperature is None else _number(temperature),
        motion=Motion(**{name: _number(value) for name, value in content["motion"].items()}),
        quantities={
            name: Quantity(_number(each["value"]), _number(each["error"]))
            for name, each in content["quantities"].items()
        },
        not_shown={str(name): str(how) for name, how in content["not_shown"].items()},
    )


def _numbers(values: list[Any]) -> tuple[float, ...]:
    return tuple(map(_number, values))


def _number(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError("a number is not finite")
    return number
