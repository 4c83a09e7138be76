"""Comparison of what was written to a drive with what the drive reports. Pure."""

from collections.abc import Iterable, Mapping

from friction_hil_drivers.serial_line.description import Description

_TIME_TOLERANCE = 0.1  # of the time of a watchdog: drives count it in steps of their own
_TOLERANCE = 1e-6  # of all other numbers: 32-bit floats


def contradiction(
    description: Description, written: Mapping[str, float], read: Mapping[str, float], names: Iterable[str]
) -> str:
    """Return which of the signals ``names`` the drive does not hold as written, "" if it holds them all.

    ``written`` and ``read`` are the drive's own numbers; both have all ``names``.
    """
    differing = [name for name in names if not _is_kept(description, name, written[name], read[name])]
    return "; ".join(f"{name} = {written[name]:g} was written, {read[name]:g} is read back" for name in differing)


def _is_kept(description: Description, name: str, written: float, read: float) -> bool:
    is_time = description.watchdog is not None and name == description.watchdog.signal and written != 0.0
    if is_time and not read > 0.0:  # 0 is off, a negative number a watchdog that has tripped
        return False
    return abs(read - written) <= (_TIME_TOLERANCE if is_time else _TOLERANCE) * abs(written)
