"""Messages about the temperature that a friction model is given."""

import math

from friction_hil.compensator import Compensator
from friction_hil.compensator.temperature import HIGHEST, LOWEST, SLEW

_PATIENCE_S = 2.0  # for a first temperature


class TemperatureNotices:
    """Says, once each, that a model that depends on temperature has none measured, or an implausible one."""

    __slots__ = ("_instead", "_is_known", "_left", "_name", "_told")

    def __init__(self, name: str, compensator: Compensator, period_s: float) -> None:
        self._name = name
        record = compensator.record[0]
        self._instead = (
            f"the friction model is evaluated at its reference temperature, {record['reference_temperature']:g} °C"
        )
        if record["heat_capacity"] > 0.0:
            self._instead = f"the thermal observer takes its place, which begins at {record['first_temperature']:g} °C"
        self._left = round(_PATIENCE_S / period_s)
        self._is_known = False
        self._told: set[str] = set()

    def next(self, temperature: float) -> str | None:
        """Return the notice of this cycle, None in most cycles."""
        if LOWEST <= temperature <= HIGHEST:
            self._is_known = True
            return None
        if math.isfinite(temperature):
            text = f"reports a temperature of {temperature:g} °C, which is not plausible"
            return self._once("implausible", text)
        if self._is_known:
            return self._once("lost", "does not report its temperature any more")
        self._left -= 1
        return self._once("none", "reports no temperature") if self._left <= 0 else None

    def _once(self, kind: str, text: str) -> str | None:
        if kind in self._told:
            return None
        self._told.add(kind)
        slowly = f", towards it by at most {SLEW:g} K/s" if self._is_known else ""
        return f"{self._name}: the drive {text}: {self._instead}{slowly}"
