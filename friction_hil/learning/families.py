"""Other families than that of an axis's model: what each would explain of the torque, and when one is worth a trial.

Beside the belief about the present family there is one about each of its alternatives (`ALTERNATIVES`), begun from the
present model. The evidence is predictive (prequential; A. P. Dawid, Journal of the Royal Statistical Society A 147(2),
1984): each window of the record is explained by all of them before any has learned from it, so that a family with more
parameters has no advantage by having them. Families change rarely: the whole of what was found has to speak for it.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from friction_hil import friction
from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel
from friction_hil.identification.least_squares import NUMERICAL
from friction_hil.learning.conversion import ALTERNATIVES, converted
from friction_hil.learning.coordinates import Coordinates, value_of
from friction_hil.learning.estimate import MECHANICS, Belief, first_belief, refine, unexplained
from friction_hil.learning.figures import FamilyFigures
from friction_hil.learning.motions import Used
from friction_hil.learning.window import Window, velocity_of
from friction_hil.numerics.jit import Array

WINDOWS = 8  # of the same motion, one after the other, that a family is judged by
_SETTLED = 4  # windows of a motion in which the present family alone learns
_BEGUN = 2  # windows that another one has learned from before it is judged
_EXPLAINED = 0.1  # of the mean square of what the present family leaves: a family that explains less is not tried
_WORTH = 0.004  # of the friction level: root mean square torque that it explains in addition
_EVIDENT = 3.0  # standard errors of the windows
_RARELY = 100  # windows, ten minutes of motion, before another family is looked for
_UNDECIDED = 10  # windows, after a trial without a verdict, or before another family's trial
_DRIFT = 0.1  # relative standard deviation of what temperature and wear change within a minute
_DEFLECTIONS = np.geomspace(0.1, 1e-5, 9)  # of the travel: break-away of a map that has no presliding


@dataclass(slots=True)
class _Other:
    """A family that is not in use."""

    belief: Belief
    learned: int = 0  # windows
    explained: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOWS))  # relative, of each window
    torque: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOWS))  # mean square, in squares of the level


@dataclass(slots=True)
class Families:
    """What is known of the families that are not in use."""

    figures: FamilyFigures
    _others: dict[str, _Other] = field(default_factory=dict)
    _used: set[str] = field(default_factory=set)  # that were in use: their coordinates may be those of a motion
    _windows: int = 0  # of the present motion
    _turn: int = 0
    _quiet: int = 0  # windows in which no family is considered
    _rests: dict[str, int] = field(default_factory=dict)  # windows until a family is considered again
    _pauses: dict[str, int] = field(default_factory=dict)  # the next rest

    def swap(self, belief: Belief, to: Coordinates) -> Belief:
        """Return what is known of the family that comes into use, and keep the belief about the former one."""
        name = to.model.name
        found = self._others.pop(name).belief
        assert found.coordinates is to
        self._others[belief.coordinates.model.name] = _Other(belief, _BEGUN)
        return found

    def add(self, content: Mapping[str, Any], present: Belief) -> Used:
        """Return a model of another family that was kept in an earlier run, with the gain 1.

        ``content``: as `friction_hil.friction.model.as_dict` returns it. Raises `UsageError`: there is no such model.
        """
        axis = present.coordinates.model.axis
        parameters, modifiers = content["parameters"], content.get("modifiers")
        model = friction.create(content["model"], modifiers=modifiers, axis=axis, **parameters)
        belief = first_belief(model, present.mechanics, {})
        self._others[model.name] = _Other(belief)
        self._used.add(model.name)
        return Used(belief.x, 1.0, belief.coordinates)

    def look(self, window: Window, present: Belief, resolution: float, skipped_s: float) -> None:
        """Compare all families by a window that none of them has learned from; then one of the others learns from it.

        ``present``: about the family in use, before the window; the others as for `estimate`.
        """
        seconds = len(window) * window.period_s - skipped_s
        for other in self._others.values():
            other.belief = other.belief.older(_DRIFT, seconds)
        self._windows += 1
        self._quiet = max(self._quiet - 1, 0)
        self._rests = {name: left - 1 for name, left in self._rests.items() if left > 1}
        names = [each for each in ALTERNATIVES.get(present.coordinates.model.name, ()) if each not in self._rests]
        if self._windows <= _SETTLED or self._quiet or not names:
            return
        given = (resolution, skipped_s)
        left, doubt = unexplained(window, present, present.x, *given)
        size = math.sqrt(float(np.mean(left**2)))
        is_moving = np.diff(window.position_demand, prepend=window.position_demand[0])[-1 - left.size : -1] != 0.0
        if not (size > 0.0 and is_moving.any()):
            return
        weights = is_moving / np.hypot(size, doubt)  # of a reversal within a period nothing is known
        before = _mean_square(weights * left)
        for name in names:
            if name in self._others and (other := self._others[name]).learned >= _BEGUN:
                after = _mean_square(weights * unexplained(window, other.belief, _shown(other.belief), *given)[0])
                if math.isfinite(after):
                    moving = np.count_nonzero(is_moving) / left.size
                    other.explained.append(1.0 - after / before)
                    other.torque.append((before - after) / moving * (size / present.coordinates.model.level) ** 2)
                    self.figures.explained[name] = float(np.mean(other.explained))
                    self.figures.state = self.figures.state or "none explains more"
        self._turn += 1
        self._learn(names[self._turn % len(names)], window, present, *given)

    def best(self) -> Used | None:
        """Return a model of the family that explains clearly more, with the gain 1; or None."""
        found = [each for each in self._others.values() if _is_evident(each)]
        if self._quiet or not found:
            return None
        best = max(found, key=lambda each: float(np.mean(each.explained)))
        return Used(_shown(best.belief), 1.0, best.belief.coordinates)

    def reason(self, name: str, present: str) -> str:
        """Return what speaks for a family."""
        share = 100.0 * float(np.mean(self._others[name].explained))
        return f"the family {name} in place of {present}: explains {share:.0f} % of what that leaves"

    def was_tried(self, name: str, error: float) -> None:
        """Take note that a family is tried, with the following error before."""
        self.figures.tried += 1
        self.figures.state, self.figures.text = "on trial", name
        self.figures.error_before, self.figures.error_after = error, None
        self._used.add(name)

    def was_kept(self, error: float) -> None:
        """Take note that the trial was a gain, with the following error after it."""
        self.figures.state, self.figures.error_after = "kept", error
        self._quiet = _RARELY
        self._forget_evidence()

    def was_refused(self, name: str, why: str) -> None:
        """Take note that the trial was no gain, refused or without a verdict; ``why`` becomes the state."""
        self.figures.state = why
        is_undecided = why == "without a verdict"
        self._rests[name] = _UNDECIDED if is_undecided else self._pauses.get(name, _RARELY)
        if not is_undecided:
            self._pauses[name] = 2 * self._rests[name]
        self._quiet = _UNDECIDED
        self._forget_evidence()

    def change_motion(self) -> None:
        """Take note of another motion: evidence is of one motion, and what was never in use is begun anew."""
        kept = {*self._used, self.figures.of_file}
        self._others = {name: each for name, each in self._others.items() if name in kept}
        self._forget_evidence()

    def doubt(self) -> None:
        """Take note that the axis may not be what it was."""
        for other in self._others.values():
            other.belief = other.belief.doubted()
        self._forget_evidence()

    def _forget_evidence(self) -> None:
        self._windows = 0
        self.figures.explained.clear()
        for other in self._others.values():
            other.explained.clear()
            other.torque.clear()

    def _learn(self, name: str, window: Window, present: Belief, resolution: float, skipped_s: float) -> None:
        try:
            if name not in self._others:
                self._others[name] = _Other(_begun(name, window, present, resolution, skipped_s))
            other = self._others[name]
            other.belief = refine(window, other.belief, resolution, skipped_s).belief
            other.learned += 1
        except (UsageError, *NUMERICAL):  # a level of zero, for example
            self._rests[name] = _UNDECIDED


def _is_evident(other: _Other) -> bool:
    """Return True if a family explained clearly more in all of the last windows together."""
    if len(other.explained) < WINDOWS:
        return False
    mean, error = float(np.mean(other.explained)), float(np.std(other.explained, ddof=1)) / math.sqrt(WINDOWS)
    return mean > max(_EXPLAINED, _EVIDENT * error) and float(np.mean(other.torque)) > _WORTH**2


def _begun(name: str, window: Window, present: Belief, resolution: float, skipped_s: float) -> Belief:
    """Return what is known of another family at first: the present parameters, little of what it adds.

    Of the deflections at break-away, which a static map does not have, it has the one that explains the record best.
    """
    model = present.model
    speed = float(np.max(np.abs(velocity_of(window, resolution)), initial=0.0))
    travel = float(np.ptp(window.position))
    found: list[tuple[float, Belief]] = []
    for part in _DEFLECTIONS if model.family.is_static else _DEFLECTIONS[:1]:
        other = converted(model, name, speed=speed, deflection=part * travel)
        belief = first_belief(other, present.mechanics, _errors(other, model))
        x = belief.x.copy()
        x[-MECHANICS:] = present.x[-MECHANICS:]
        belief = replace(belief, x=x)
        left, _ = unexplained(window, belief, x, resolution, skipped_s)
        found.append((float(np.mean(left**2)), belief))
    return min(found, key=lambda each: each[0])[1]


def _errors(model: FrictionModel, present: FrictionModel) -> Mapping[str, float]:
    """Return standard errors of what a model adds to the present one: as large as the parameters."""
    return {name: abs(value_of(model, name)) for name in model.free if name not in present.free}


def _shown(belief: Belief) -> Array:
    """Return the coordinates with those at their first value that the record has not shown."""
    return belief.shown(np.zeros_like(belief.x))


def _mean_square(values: Array) -> float:
    return float(np.mean(values**2))
