"""Warnings about one axis in a run, each given once. Pure."""

import math
from collections import deque

from friction_hil.compensator import Compensator, adaptation
from friction_hil.compensator.temperature import HIGHEST, LOWEST, SLEW
from friction_hil.drive import DriveState, Feedback
from friction_hil.friction.network_model import beyond_speed

_PATIENCE_S = 2.0  # for a first temperature
_IDLE_S = 0.5  # without compensation, before it is told why
_OVER_COMPENSATED = "the axis oscillates by its own compensation (limit cycle, over-compensation)"


def is_limit_cycle(warning: str, name: str) -> bool:
    """Return True if a warning of a run says that the compensation of this axis made it oscillate."""
    return warning.startswith(f"{name}: {_OVER_COMPENSATED}")


class CompensationNotices:
    """Warnings about the compensation of one axis: lowered gain, and a network beyond its trained speed."""

    __slots__ = (
        "_beyond",
        "_gain_factor",
        "_name",
        "_trained_speed",
        "_unit",
    )

    def __init__(self, name: str, unit: str, compensator: Compensator) -> None:
        self._name, self._unit = name, unit  # unit of the position, ``rad`` or ``m``
        self.renew(compensator)

    def renew(self, compensator: Compensator) -> None:
        """Begin anew with the present model of the compensator."""
        self._trained_speed, self._beyond = compensator.trained_speed, beyond_speed(compensator.has_residual)
        self._gain_factor = compensator.gain_factor

    def next(self, compensator: Compensator, velocity: float) -> str | None:
        """Return the warning of this cycle, given the estimated velocity; each once, and None in most cycles."""
        if compensator.gain_factor != self._gain_factor:
            self._gain_factor = compensator.gain_factor
            return f"{self._name}: {_OVER_COMPENSATED}: the gain is now {self._gain_factor:.0%} of the configured one"
        if abs(velocity) > self._trained_speed:
            limit, self._trained_speed = self._trained_speed, math.inf
            return (
                f"{self._name}: faster than the {limit:g} {self._unit}/s that the network was trained for; beyond, "
                f"{self._beyond}"
            )
        return None


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


class AxisNotices:
    """All warnings of one axis, at most one in a cycle.

    ``unit``: of the position, ``rad`` or ``m``.
    """

    __slots__ = ("_compensation", "_name", "_others", "_period_s", "_temperature", "_unit")

    def __init__(self, name: str, unit: str, period_s: float, compensator: Compensator) -> None:
        self._name, self._unit, self._period_s = name, unit, period_s
        self._others: deque[str] = deque()
        self.renew(compensator)

    def renew(self, compensator: Compensator) -> None:
        """Begin anew with the present model of the compensator."""
        self._compensation = CompensationNotices(self._name, self._unit, compensator)
        self._temperature = None  # the model does not depend on it
        if math.isfinite(compensator.record[0]["reference_temperature"]):
            self._temperature = TemperatureNotices(self._name, compensator, self._period_s)

    def add(self, text: str | None) -> None:
        """Give this warning too, if there is one."""
        if text:
            self._others.append(text)

    def next(self, compensator: Compensator, velocity: float, temperature: float) -> str | None:
        """Return the warning of this cycle, given estimated velocity and measured temperature; None in most cycles."""
        warning = self._compensation.next(compensator, velocity)
        if warning is None and self._others:
            warning = self._others.popleft()
        if warning is None and self._temperature is not None:
            warning = self._temperature.next(temperature)
        return warning


class MasterNotices:
    """Tells, once for each change, that the drive does not operate, or does again, and why nothing is compensated."""

    __slots__ = ("_idle_cycles", "_is_operating", "_name", "_patience_cycles", "_told")

    def __init__(self, name: str, period_s: float) -> None:
        self._name = name
        self._patience_cycles = max(1, round(_IDLE_S / period_s))
        self._idle_cycles = 0
        self._is_operating: bool | None = None
        self._told = ""

    def next(self, feedback: Feedback) -> str | None:
        """Return the notice of this cycle; None in most cycles."""
        is_powered = feedback.state is DriveState.OPERATION_ENABLED
        self._idle_cycles = 0 if is_powered and feedback.is_offset_wanted else self._idle_cycles + 1
        if is_powered and self._is_operating is False:
            self._is_operating, self._told = True, ""
            return f"{self._name}: its master has enabled the drive again"
        if is_powered:
            self._is_operating = True
        elif self._is_operating and feedback.state.words != self._told:
            self._is_operating, self._told = False, feedback.state.words
            return (
                f"{self._name}: the drive left Operation enabled, its master's business: {self._told}{feedback.reason}"
            )
        if self._idle_cycles == self._patience_cycles:
            return self._why_idle(feedback)
        return None

    def _why_idle(self, feedback: Feedback) -> str | None:
        if self._is_operating is None:
            state = f"the drive is in state {feedback.state.words}{feedback.reason}, and its master has not enabled it"
            return f"{self._name}: not compensated so far: {state}"
        if self._is_operating:
            reason = "it is in another mode than the configured one, or its master does not command operation (6040h)"
            return f"{self._name}: not compensated, although the drive is in Operation enabled: {reason}"
        return None


def adaptation_notice(name: str, unit: str, compensator: Compensator) -> str | None:
    """Return the notice that adaptation learned nothing in a whole run, and what it needs; None if it did."""
    if compensator.record[0]["adaptation_s"] == 0.0 or compensator.learned_s > 0.0:
        return None
    return f"{name}: compensation.adaptation learned nothing: {adaptation_needs(unit, compensator)}"


def adaptation_needs(unit: str, compensator: Compensator) -> str:
    """Return what adaptation needs in order to learn; ``unit`` is that of the position, ``rad`` or ``m``."""
    return (
        "it needs the drive's torque and an axis that slides in one direction for more than "
        f"{adaptation.SETTLED_S:g} s and {compensator.sliding_travel:.2g} {unit}, faster than "
        f"{compensator.slowest_learning:.2g} {unit}/s (four times the noise of the velocity estimate)"
    )
