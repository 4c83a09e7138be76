"""The parameters that were kept last, in a file that outlives the daemon: the next run begins with them."""

import hashlib
import json
import math
import os
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from friction_hil import friction
from friction_hil.errors import UsageError
from friction_hil.learning import thresholds as th

_VERSION = 2


@dataclass(frozen=True, slots=True)
class Proven:
    """What was kept last of an axis."""

    model: str  # digest of the content of the model file
    parameters: dict[str, float]  # by their names in ``model.free``
    gain: float
    unix_s: float  # when it was kept
    temperature: float | None  # of the axis at that time, °C, where one is known
    friction: dict[str, Any] | None = None  # as a model file has it, where the family is not that of the model file


def digest(content: Mapping[str, Any]) -> str:
    """Return a digest of the plain content of a model file."""
    return hashlib.blake2b(json.dumps(content, sort_keys=True, default=str).encode(), digest_size=16).hexdigest()


def store(path: Path, proven: Proven) -> None:
    """Write a file; a reader sees the old one or the new one. Raises `OSError`: it cannot be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_suffix(".new")
    with open(new, "w", encoding="utf-8") as file:
        json.dump({"version": _VERSION, **asdict(proven)}, file)
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)


def recall(path: Path, model: str, temperature: float | None, now_s: float | None = None) -> tuple[Proven | None, str]:
    """Return what was kept last, or None with the reason why it is not used; empty if there is no file.

    ``model``: digest of the present model file. ``temperature``: of the axis now, °C. ``now_s``: since 1970, s; that of
    the clock by default.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        if values.pop("version") not in (1, _VERSION):  # the first one knew no other family
            return None, f"{path} is of another version"
        found = Proven(**values)
        numbers = [found.gain, found.unix_s, *found.parameters.values()]
        if found.friction is not None:
            friction.create(
                found.friction["model"], modifiers=found.friction.get("modifiers"), **found.friction["parameters"]
            )
        is_sound = all(math.isfinite(float(each)) for each in numbers) and 0.0 <= found.gain <= 1.5
    except FileNotFoundError:
        return None, ""
    except (OSError, ValueError, TypeError, KeyError, AttributeError, UsageError):
        return None, f"{path} cannot be read"
    if not is_sound:
        return None, f"{path} has values that are no parameters"
    if found.model != model:
        return None, "the model file has changed"
    age_s = (time.time() if now_s is None else now_s) - found.unix_s
    if not 0.0 <= age_s <= th.PROVEN_LONGEST_S:
        return None, f"they are {age_s / 86400.0:.0f} days old"
    if temperature is not None and found.temperature is not None:
        warmer = abs(temperature - found.temperature)
        if warmer > th.PROVEN_WARMEST_K:
            return None, f"the temperature differs by {warmer:.0f} K"
    return found, ""
