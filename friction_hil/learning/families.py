"""Other families than that of an axis's model: what each would explain of the torque, and when one is worth a trial.

Beside the belief about the present family there is one about each of its `alternatives`, begun from the present model.
The evidence is predictive (prequential; A. P. Dawid, Journal of the Royal Statistical Society A 147(2), 1984): each
window of the record is explained by all of them before any has learned from it, so that a family with more parameters
has no advantage by having them. Families change rarely: the whole of what was found has to speak for it. The present
family with levels for each direction is quicker: it begins as the same model, and each stroke shows its difference.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from friction_hil import friction
from friction_hil.daemon.learning_board import FamilyFigures
from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel
from friction_hil.identification.least_squares import NUMERICAL
from friction_hil.learning import thresholds as th
from friction_hil.learning.conversion import Form, alternatives, converted, form_of
from friction_hil.learning.coordinates import Coordinates, value_of
from friction_hil.learning.estimate import MECHANICS, STATIC, Belief, first_belief, refine, unexplained
from friction_hil.learning.motions import Used
from friction_hil.learning.window import Window, velocity_of


@dataclass(slots=True)
class _Other:
    """A family that is not in use."""

    belief: Belief
    learned: int = 0  # windows
    explained: deque[float] = field(default_factory=lambda: deque(maxlen=th.FAMILY_WINDOWS))  # relative, of each window
    torque: deque[float] = field(
        default_factory=lambda: deque(maxlen=th.FAMILY_WINDOWS)
    )  # mean square, in squares of the level


@dataclass(slots=True)
class Families:
    """What is known of the families that are not in use."""

    figures: FamilyFigures
    of_file: Form
    _others: dict[Form, _Other] = field(default_factory=dict)
    _used: set[Form] = field(default_factory=set)  # that were in use: their coordinates may be those of a motion
    _windows: int = 0  # of the present motion
    _turn: int = 0
    _quiet: int = 0  # windows in which no family is considered
    _rests: dict[Form, int] = field(default_factory=dict)  # windows until a family is considered again
    _pauses: dict[Form, int] = field(default_factory=dict)  # the next rest

    def swap(self, belief: Belief, to: Coordinates) -> Belief:
        """Return what is known of the family that comes into use, and keep the belief about the former one."""
        found = self._others.pop(form_of(to.model)).belief
        assert found.coordinates is to
        self._others[form_of(belief.coordinates.model)] = _Other(belief, th.FAMILY_BEGUN)
        return found

    def add(self, content: Mapping[str, Any], present: Belief) -> Used:
        """Return a model of another family that was kept in an earlier run, with the gain 1.

        ``content``: as `friction_hil.friction.model.as_dict` returns it. Raises `UsageError`: there is no such model.
        """
        axis = present.coordinates.model.axis
        parameters, modifiers = content["parameters"], content.get("modifiers")
        model = friction.create(content["model"], modifiers=modifiers, axis=axis, **parameters)
        belief = first_belief(model, present.mechanics, {})
        self._others[form_of(model)] = _Other(belief)
        self._used.add(form_of(model))
        return Used(belief.x, 1.0, belief.coordinates)

    def look(self, window: Window, present: Belief, resolution: float, skipped_s: float) -> None:
        """Compare all families by a window that none of them has learned from; then one of the others learns from it.

        ``present``: about the family in use, before the window; the others as for `estimate`.
        """
        seconds = len(window) * window.period_s - skipped_s
        for other in self._others.values():
            other.belief = other.belief.older(th.DRIFT, seconds)
        self._windows += 1
        self._quiet = max(self._quiet - 1, 0)
        self._rests = {form: left - 1 for form, left in self._rests.items() if left > 1}
        forms = self._considered(present.coordinates.model)
        if self._quiet or not forms:
            return
        given = (resolution, skipped_s)
        left, doubt = unexplained(window, present, present.x, *given)
        size = math.sqrt(float(np.mean(left**2)))
        is_moving = np.diff(window.position_demand, prepend=window.position_demand[0])[-1 - left.size : -1] != 0.0
        if not (size > 0.0 and is_moving.any()):
            return
        weights = is_moving / np.hypot(size, doubt)  # of a reversal within a period nothing is known
        before = float(np.mean((weights * left) ** 2))
        for form in forms:
            if form in self._others and (other := self._others[form]).learned >= th.FAMILY_BEGUN:
                remaining, _ = unexplained(window, other.belief, other.belief.shown(), *given)
                after = float(np.mean((weights * remaining) ** 2))
                if math.isfinite(after):
                    moving = np.count_nonzero(is_moving) / left.size
                    other.explained.append(1.0 - after / before)
                    other.torque.append((before - after) / moving * (size / present.coordinates.model.level) ** 2)
                    self.figures.explained[str(form)] = float(np.mean(other.explained))
                    self.figures.state = self.figures.state or "none explains more"
        self._turn += 1
        quick = _for_directions(forms, form_of(present.coordinates.model))
        others = [each for each in forms if each not in quick]
        for form in quick + others[self._turn % max(len(others), 1) :][:1]:
            self._learn(form, window, present, *given)

    def best(self, present: Form) -> Used | None:
        """Return a model of the form that explains clearly more than the present one, with the gain 1; or None."""
        found = [other for form, other in self._others.items() if self._is_evident(form, other, present)]
        if self._quiet or not found:
            return None
        best = max(found, key=lambda each: float(np.mean(each.explained)))
        return Used(best.belief.shown(), 1.0, best.belief.coordinates)

    def reason(self, form: Form, present: Form) -> str:
        """Return what speaks for a family."""
        share = 100.0 * float(np.mean(self._others[form].explained))
        return f"the family {form} in place of {present}: explains {share:.0f} % of what that leaves"

    def was_tried(self, form: Form, error: float) -> None:
        """Take note that a family is tried, with the following error before."""
        self.figures.tried += 1
        self.figures.state, self.figures.text = "on trial", str(form)
        self.figures.error_before, self.figures.error_after = error, None
        self._used.add(form)

    def was_kept(self, form: Form, error: float) -> None:
        """Take note that the trial of a family was a gain, with the following error after it."""
        self.figures.state, self.figures.error_after = "kept", error
        self._quiet = 0 if form.has_directions else th.FAMILY_RARELY  # levels of each direction are no other family
        self._forget_evidence()

    def was_refused(self, form: Form, why: str) -> None:
        """Take note that the trial was no gain, refused or without a verdict; ``why`` becomes the state."""
        self.figures.state = why
        is_undecided = why == "without a verdict"
        self._rests[form] = th.FAMILY_UNDECIDED if is_undecided else self._pauses.get(form, th.FAMILY_RARELY)
        if not is_undecided:
            self._pauses[form] = 2 * self._rests[form]
        self._quiet = th.FAMILY_UNDECIDED
        self._forget_evidence()

    def change_motion(self) -> None:
        """Take note of another motion: evidence is of one motion, and what was never in use is begun anew."""
        kept = {*self._used, self.of_file}
        self._others = {form: each for form, each in self._others.items() if form in kept}
        self._forget_evidence()

    def doubt(self) -> None:
        """Take note that the axis may not be what it was."""
        for other in self._others.values():
            other.belief = other.belief.doubted()
        self._forget_evidence()

    def _considered(self, model: FrictionModel) -> list[Form]:
        """Return the forms that are compared with the present model: at first, those that directions are shown by."""
        forms = alternatives(model)
        forms += tuple(each for each in self._used if each in self._others and each not in forms)  # ways back
        forms = tuple(each for each in forms if each not in self._rests)
        return [*forms] if self._windows > th.FAMILY_SETTLED else _for_directions(forms, form_of(model))

    def _is_evident(self, form: Form, other: _Other, present: Form) -> bool:
        """Return True if a family explained clearly more in all of the last windows.

        A few windows are enough for one that adds levels for each direction, and so explains most of what it leaves
        without them.
        """
        explained, torque = np.array(other.explained), np.array(other.torque)
        adds_directions = _adds_directions(form, present)
        if adds_directions and (plain := self._others.get(Form(form.family))) and plain.explained:
            count = min(explained.size, len(plain.explained))
            explained = 1.0 - (1.0 - explained[-count:]) / (1.0 - np.array(plain.explained)[-count:])
            torque = torque[-count:] - np.array(plain.torque)[-count:]
        if (
            explained.size < (th.FEW_WINDOWS if adds_directions else th.FAMILY_WINDOWS)
            or not float(np.mean(torque)) > th.WORTH**2
        ):
            return False
        if adds_directions:
            return bool(np.min(explained) > th.OBVIOUS)
        mean, error = float(np.mean(explained)), float(np.std(explained, ddof=1)) / math.sqrt(th.FAMILY_WINDOWS)
        return mean > max(th.FAMILY_EXPLAINED, th.FAMILY_EVIDENT * error)

    def _forget_evidence(self) -> None:
        self._windows = 0
        self.figures.explained.clear()
        for other in self._others.values():
            other.explained.clear()
            other.torque.clear()

    def _learn(self, form: Form, window: Window, present: Belief, resolution: float, skipped_s: float) -> None:
        try:
            if form not in self._others:
                self._others[form] = _Other(_begun(form, window, present, resolution, skipped_s))
            other = self._others[form]
            other.belief = refine(window, other.belief, resolution, skipped_s).belief
            other.learned += 1
        except (UsageError, *NUMERICAL):  # a level of zero, for example
            self._rests[form] = th.FAMILY_UNDECIDED


def _adds_directions(form: Form, present: Form) -> bool:
    """Return True if a form has levels for each direction, and the present one has not."""
    return form.has_directions and not present.has_directions


def _for_directions(forms: Sequence[Form], present: Form) -> list[Form]:
    """Return the form that adds levels for each direction, and the same without, which is to explain less."""
    added = [each for each in forms if _adds_directions(each, present)]
    return added + [each for each in forms if replace(each, has_directions=True) in added and each not in added]


def _begun(form: Form, window: Window, present: Belief, resolution: float, skipped_s: float) -> Belief:
    """Return what is known of another family at first: the present parameters or those of the file, little of the rest.

    What a family cannot express bends its parameters. Of both, and of the deflections at break-away, which a static map
    does not have, it has those that explain the record best.
    """
    speed = float(np.max(np.abs(velocity_of(window, resolution)), initial=0.0))
    travel = float(np.ptp(window.position))
    found: list[tuple[float, Belief]] = []
    for model, known in ((present.model, present.x), (present.coordinates.model, np.zeros_like(present.x))):
        for part in th.MAP_DEFLECTIONS if model.family.is_static else th.MAP_DEFLECTIONS[:1]:
            other = converted(model, form, speed=speed, deflection=part * travel)
            # what it adds has standard errors as large as the parameters
            errors = {name: abs(value_of(other, name)) for name in other.free if name not in model.free}
            belief = first_belief(other, present.mechanics, errors)
            x = belief.x.copy()
            x[-MECHANICS:] = known[-MECHANICS:]
            if _adds_directions(form, form_of(model)):
                x[STATIC - MECHANICS] = 0.0  # a constant torque had to stand for what differs between the directions
            belief = replace(belief, x=x)
            left, _ = unexplained(window, belief, x, resolution, skipped_s)
            found.append((float(np.mean(left**2)), belief))
    return min(found, key=lambda each: each[0])[1]
