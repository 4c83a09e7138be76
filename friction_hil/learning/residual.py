"""The residual layer: a bounded torque over position for what the family of an axis's model cannot express.

It is learned from what the refined model leaves of the measured torque, as harmonics of the position (cogging, gear
mesh, pitch of a screw) that become the ripple of the model. A harmonic of the position is the derivative of a
potential: whatever its amplitude, it gives no energy over a closed path, and it has no state that could drift at rest.

Orders are looked for in one window of the record (`friction_hil.identification.ripple`); amplitudes are those of all
windows, the older the less. A layer is proposed only if amplitudes that were found without a part of the record explain
that part, by more than its stretches scatter.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from friction_hil import friction
from friction_hil.friction import FrictionModel
from friction_hil.friction.modifiers import MAX_HARMONICS
from friction_hil.identification.ripple import RippleSearch
from friction_hil.learning.estimate import LeftOver
from friction_hil.learning.figures import LayerFigures
from friction_hil.numerics.jit import Array

SHARE = 0.2  # of the friction level: amplitudes of a layer together are at most so much
_MOST = 4  # harmonics
_REMEMBERED_S = 60.0  # time constant of forgetting
_EXPECTED = 0.1  # of the friction level: standard deviation of an amplitude before anything was learned
_EXPLAINED = 0.1  # of the mean square of what the model leaves: a layer that explains less is not worth a trial
_WORTH = 0.004  # of the friction level: root mean square torque, or change of it, that is worth a trial
_EVIDENT = 3.0  # standard errors by which the explained part exceeds chance
_STRETCHES = 12  # of a window, that count as repeated records
_PARTS = 2  # of a window, each explained by what the others and the past show
_SPENT = 2  # windows in which a layer explained nothing, one after the other: it is switched off
_FIRST_PAUSE, _LONGEST_PAUSE = 2, 40  # windows without a trial, after one that was no gain
_SEARCHED_ROWS = 2000  # of a window; the search takes most of the time
_MOVING = 0.01  # of the top speed: slower rows are at rest, where friction is whatever holds the axis


@dataclass(frozen=True, slots=True)
class Layer:
    """Torque that is added to that of a friction model.

    Attributes
    ----------
    orders : tuple of float
        Periods per revolution, on a linear axis per metre.
    amplitudes : tuple of (float, float)
        Factors of cosine and sine, N m or N.
    is_linear : bool
        True on a linear axis.
    """

    orders: tuple[float, ...]
    amplitudes: tuple[tuple[float, float], ...]
    is_linear: bool = False

    @property
    def most(self) -> float:
        """Largest torque that it can give, N m or N."""
        return math.fsum(math.hypot(*each) for each in self.amplitudes)

    def on(self, model: FrictionModel) -> FrictionModel:
        """Return a model with this torque beside its own."""
        harmonics = [dict(each) for each in model.modifiers.get("ripple", ())]
        for order, (cosine, sine) in zip(self.orders, self.amplitudes, strict=True):
            same = [each for each in harmonics if each["order"] == order]
            if same:
                same[0]["cosine"] += cosine
                same[0]["sine"] += sine
            else:
                harmonics.append({"order": order, "cosine": cosine, "sine": sine})
        modifiers = {**model.modifiers, "ripple": harmonics}
        return friction.create(model.name, modifiers=modifiers, axis=model.axis, **model.given)

    def torque(self, position: Array) -> Array:
        """Return the torque (n,) at positions (n,), N m or N."""
        return np.asarray(_waves(position, self.orders, self.is_linear) @ np.ravel(self.amplitudes))

    def limited(self, most: float) -> "Layer":
        """Return the layer with amplitudes of at most ``most`` together."""
        factor = min(1.0, most / self.most) if self.most > 0.0 else 1.0
        return replace(self, amplitudes=tuple((factor * cosine, factor * sine) for cosine, sine in self.amplitudes))

    def __str__(self) -> str:
        return "ripple of order " + ", ".join(f"{each:g}" for each in self.orders)


def between(layer: Layer | None, other: Layer | None, part: float) -> Layer | None:
    """Return what lies a part of the way from a layer to another one; None is a layer without torque."""
    if layer == other:
        return other
    found: dict[float, Array] = {}
    for each, factor in ((layer, 1.0 - part), (other, part)):
        if each is not None:
            for order, pair in zip(each.orders, each.amplitudes, strict=True):
                found[order] = found.get(order, 0.0) + factor * np.array(pair)
    is_linear = any(each is not None and each.is_linear for each in (layer, other))
    pairs = tuple((float(pair[0]), float(pair[1])) for pair in found.values())
    return Layer(tuple(found), pairs, is_linear)


@dataclass(frozen=True, slots=True)
class Finding:
    """What a window shows of a layer.

    Attributes
    ----------
    layer : Layer or None
        None: what the model leaves is noise.
    explained : float
        Share of the mean square of what the model leaves that it explains of rows that it was not learned from.
    change : float
        Root mean square by which its torque differs from that of the layer in use, N m or N.
    is_spent : bool
        The layer in use has explained nothing in the last windows.
    """

    layer: Layer | None
    explained: float = 0.0
    change: float = 0.0
    is_spent: bool = False

    @property
    def text(self) -> str:
        """What is proposed."""
        return f"a residual layer: {self.layer}, which explains {100.0 * self.explained:.0f} % of what the model leaves"


@dataclass(slots=True)
class Residual:
    """Learning of the residual layer of one axis.

    Attributes
    ----------
    model : FrictionModel
        Of the model file.
    """

    model: FrictionModel
    _orders: tuple[float, ...] = ()
    _information: Array = field(default_factory=lambda: np.zeros((0, 0)))
    _shown: Array = field(default_factory=lambda: np.zeros(0))
    _spent: int = 0  # windows in which the layer in use explained nothing
    _pause: int = _FIRST_PAUSE
    _rest: int = 0  # windows until the next trial
    _patience: int = 1
    _blind: int = 0  # windows until orders are looked for again

    @property
    def _is_linear(self) -> bool:
        return self.model.axis == "linear"

    def look(self, left: LeftOver, used: Layer | None) -> Finding:
        """Learn from what the model without a layer leaves of a window.

        Parameters
        ----------
        left : LeftOver
        used : Layer or None
            In use during the window.
        """
        if used is not None:
            gained = np.sum(left.torque**2 - (left.torque - used.torque(left.position)) ** 2)
            self._spent = self._spent + 1 if gained <= 0.0 else 0
            if self._spent >= _SPENT:
                return Finding(None, is_spent=True)
        speed = np.abs(left.velocity)
        is_moving = speed > _MOVING * float(np.max(speed, initial=0.0))
        if np.count_nonzero(is_moving) < _STRETCHES * _PARTS or not np.isfinite(left.torque).all():
            return Finding(None)
        weights = is_moving / np.hypot(_typical(left.torque[is_moving]), left.doubt)
        if not self._orders:
            if self._blind:
                self._blind -= 1
                return Finding(None)
            self._begin(self._search(left, weights))
        if not self._orders:
            return Finding(None)
        columns = _waves(left.position, self._orders, self._is_linear)
        explained, is_evident = self._explained(columns, left.torque, weights)
        self._remember(columns, left.torque, weights, left.seconds)
        if not is_evident:
            if used is None:
                self._begin(())  # another search at the next window
            return Finding(None, explained)
        found = self._layer(self._solve(self._information, self._shown))
        torque = found.torque(left.position)
        if used is not None:
            torque = torque - used.torque(left.position)
        change = float(np.sqrt(np.mean(torque**2)))
        return Finding(found if change > _WORTH * self.model.level else used, explained, change)

    def is_worth(self, found: Finding, used: Layer | None, figures: LayerFigures) -> bool:
        """Return True if a finding is worth a trial now."""
        figures.explained = found.explained
        if not figures.state:
            figures.state = "noise only"
        if found.layer is None or found.layer == used:
            return False
        if self._rest:
            self._rest -= 1
            return False
        return True

    def was_tried(self, found: Finding, used: Layer | None, figures: LayerFigures, error: float) -> None:
        """Take note that a finding is tried, with the error before; ``used`` is the layer in use so far."""
        figures.tried += 1
        if used is None:
            figures.state, figures.text = "on trial", str(found.layer)
            figures.error_before, figures.error_after = error, None

    def was_kept(self, tried: Layer | None, figures: LayerFigures, error: float) -> None:
        """Take note that a trial was a gain."""
        figures.state, figures.text, figures.error_after = "on", str(tried), error
        self._pause = _FIRST_PAUSE

    def was_refused(self, used: Layer | None, figures: LayerFigures, why: str) -> None:
        """Take note that a trial was no gain, refused or without a verdict; ``used`` is the layer that stays."""
        figures.state = why if used is None else "on"
        self._rest, self._pause = self._pause, min(2 * self._pause, _LONGEST_PAUSE)

    def changed_motion(self, used: Layer | None, figures: LayerFigures) -> None:
        """Take note of another motion and of what is proven for it; what was learned goes on."""
        self._spent = 0
        if figures.tried:
            figures.state = "on" if used is not None else "not proven for this motion"

    def end(self, figures: LayerFigures) -> None:
        """Begin anew: the layer in use was switched off."""
        figures.state = "no longer a gain"
        self._begin(())
        self._spent = 0

    def _begin(self, orders: Sequence[float]) -> None:
        self._orders = tuple(orders)
        self._information = np.zeros((2 * len(orders), 2 * len(orders)))
        self._shown = np.zeros(2 * len(orders))

    def _search(self, left: LeftOver, weights: Array) -> list[float]:
        """Return the orders that stand out."""
        present = self.model.modifiers.get("ripple", ())
        most = min(_MOST, MAX_HARMONICS - len(present))
        if most <= 0:
            return []
        thinned = (_thinned(each) for each in (left.position, left.torque, left.slopes, weights))
        position, torque, slopes, weights = thinned
        parts = [slice(0, torque.size)]
        orders = RippleSearch(position, torque, slopes, weights, parts, is_linear=self._is_linear).orders(most)
        if not orders:
            self._blind, self._patience = self._patience, min(2 * self._patience, _LONGEST_PAUSE)
        return orders

    def _solve(self, information: Array, shown: Array) -> Array:
        """Return the amplitudes that are most probable."""
        prior = 1.0 / (_EXPECTED * self.model.level) ** 2
        return np.asarray(np.linalg.solve(information + prior * np.eye(len(shown)), shown))

    def _remember(self, columns: Array, torque: Array, weights: Array, seconds: float) -> None:
        kept = math.exp(-seconds / _REMEMBERED_S)
        weighted = weights[:, None] * columns
        self._information = kept * self._information + weighted.T @ weighted
        self._shown = kept * self._shown + weighted.T @ (weights * torque)

    def _explained(self, columns: Array, torque: Array, weights: Array) -> tuple[float, bool]:
        """Return the share of parts of the window that the rest explains, and if that is more than chance."""
        predicted = np.empty_like(torque)
        bounds = np.linspace(0, torque.size, _PARTS + 1).astype(int)
        for begin, end in itertools.pairwise(bounds):
            is_other = np.ones(torque.size, dtype=bool)
            is_other[begin:end] = False
            weighted = weights[is_other, None] * columns[is_other]
            found = self._solve(
                self._information + weighted.T @ weighted,
                self._shown + weighted.T @ (weights * torque)[is_other],
            )
            layer = self._layer(found)
            predicted[begin:end] = columns[begin:end] @ np.ravel(layer.amplitudes)
        before, after = (weights * torque) ** 2, (weights * (torque - predicted)) ** 2
        starts = np.linspace(0, torque.size, _STRETCHES, endpoint=False).astype(int)
        gains = np.add.reduceat(before - after, starts)
        error = float(np.std(gains, ddof=1)) / math.sqrt(gains.size)
        share = float(np.sum(gains)) / max(float(np.sum(before)), 1e-300)
        return share, share > _EXPLAINED and float(np.mean(gains)) > _EVIDENT * error

    def _layer(self, amplitudes: Array) -> Layer:
        pairs = tuple((float(cosine), float(sine)) for cosine, sine in amplitudes.reshape(-1, 2))
        return Layer(self._orders, pairs, self._is_linear).limited(SHARE * self.model.level)


def _thinned(values: Array) -> Array:
    """Return means of successive rows (k, ...), about `_SEARCHED_ROWS` of them."""
    length = max(len(values) // _SEARCHED_ROWS, 1)
    rows = len(values) // length
    return np.asarray(values[: rows * length].reshape(rows, length, *values.shape[1:]).mean(axis=1))


def _typical(torque: Array) -> float:
    """Return the median size of a residual, N m or N, above zero."""
    return max(float(np.median(np.abs(torque))), 1e-12)


def _waves(position: Array, orders: Sequence[float], is_linear: bool) -> Array:
    """Return cosine and sine of each order (n, 2 m)."""
    angles = np.outer(position, np.array(orders) * (math.tau if is_linear else 1.0))
    return np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(position.size, -1)
