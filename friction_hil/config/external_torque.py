"""The file with the load torque over time that a simulated servo may have (``mechanics.external.file``)."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.errors import UsageError

if TYPE_CHECKING:
    from friction_hil.numerics.jit import Array
    from friction_hil.servo.config import ServoConfig
    from friction_hil.servo.servo import Servo

_MOST_BYTES = 50_000_000


def simulated_servo(config: "ServoConfig", position: float = 0.0) -> "Servo":
    """Return a simulated servo, with the file of its external torque read.

    Raises `UsageError`: the file cannot be read, or a line of it is wrong; the message names the line.
    """
    from friction_hil.servo.servo import Servo

    return Servo(config, position, external_content(config))


def external_content(config: "ServoConfig") -> "Array | None":
    """Return the content of the file with the external torque of a servo, (n, 2); None if it has none.

    Raises `UsageError` as `simulated_servo` does.
    """
    import numpy as np

    external = config.mechanics.external
    if external is None or external.file is None:
        return None
    return np.array(read_table(external.file), dtype=np.float64)


def read_table(path: Path) -> list[tuple[float, float]]:
    """Read two columns of numbers, separated by a comma or white space; text after # is a comment.

    Raises `UsageError`: the file cannot be read, or a line has no two finite numbers, or a time that does not rise.
    """
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            raise UsageError(f"mechanics.external.file: {path} is no file")
        if path.stat().st_size > _MOST_BYTES:
            raise UsageError(f"{path}: larger than {_MOST_BYTES // 1_000_000} MB; reduce its rate")
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise UsageError(f"mechanics.external.file: {path} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"mechanics.external.file: {path} is no text file") from None
    rows: list[tuple[float, float]] = []
    for number, line in enumerate(lines, start=1):
        fields = line.partition("#")[0].replace(",", " ").split()
        if not fields:
            continue
        try:
            time_s, torque = map(float, fields)
        except ValueError:
            time_s = torque = math.nan
        if not (math.isfinite(time_s) and math.isfinite(torque)):
            raise UsageError(f"{path}:{number}: time in s and torque in N m are needed, not {line.strip()[:40]!r}")
        if rows and time_s <= rows[-1][0]:
            raise UsageError(f"{path}:{number}: the time {time_s:g} s is not after that of the row before")
        rows.append((time_s, torque))
    if not rows:
        raise UsageError(f"{path}: no rows of time in s and torque in N m")
    return rows
