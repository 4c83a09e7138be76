"""The residual layer: a bounded torque for what the family of an axis's model cannot express.

It is learned from what the refined model leaves of the measured torque: harmonics of the position (cogging, gear mesh,
pitch of a screw), a curve over the distance since the last reversal and one over the speed for each direction, and the
dependence on the load. All are linear in their amplitudes (`friction_hil.learning.layer`) and become modifiers of the
model, driven by the intended motion; at rest nothing of it changes.

Orders are looked for in one window of the record (`friction_hil.identification.ripple`); amplitudes are those of all
windows, the older the less. The simplest explanation is preferred: a group of features is added only if amplitudes
that were found without a part of the record explain that part, by more than its stretches scatter. Distance, speed and
load share much with the parameters of the model, which are therefore estimated beside their amplitudes, and handed
over with them.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import linalg

from friction_hil.daemon.learning_board import LayerFigures
from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel
from friction_hil.friction.modifiers import MAX_HARMONICS
from friction_hil.identification.ripple import RippleSearch
from friction_hil.learning import thresholds as th
from friction_hil.learning.estimate import MECHANICS, LeftOver
from friction_hil.learning.layer import LOAD, REVERSAL, RIPPLE, SPEED, Feature, Layer, columns, pairs
from friction_hil.numerics.jit import Array


@dataclass(frozen=True, slots=True)
class Memory:
    """Normal equations of weighted rows: ``information`` (m, m) and ``shown`` (m,)."""

    information: Array
    shown: Array

    def older(self, seconds: float) -> "Memory":
        """Return what is left of it after some time."""
        kept = math.exp(-seconds / th.LAYER_REMEMBERED_S)
        return Memory(kept * self.information, kept * self.shown)

    def with_rows(self, columns: Array, target: Array) -> "Memory":
        """Return the memory with further rows (k, m), (k,)."""
        return Memory(self.information + columns.T @ columns, self.shown + columns.T @ target)

    def at(self, index: list[int]) -> "Memory":
        """Return that of some of the values."""
        return Memory(self.information[np.ix_(index, index)], self.shown[index])

    def solved(self, mean: Array, prior: Array) -> Array:
        """Return the values (m,) that are most probable with those, and their information (m, m), expected before."""
        return np.asarray(np.linalg.solve(self.information + prior, self.shown + prior @ mean))


@dataclass(frozen=True, slots=True)
class Rows:
    """Weighted rows of a window."""

    weights: Array  # (k,)
    # (k, n + m) of the torque of n features with an amplitude of one, and of what is explained by the coordinates
    columns: Array
    target: Array  # (k,) what the belief leaves of the torque
    whole: Array  # (k,) what coordinates of zero would leave of it
    x: Array  # (m,) coordinates
    first: Array  # (m,) their standard deviations before anything was learned


@dataclass(frozen=True, slots=True)
class Finding:
    """What a window shows of a layer."""

    layer: Layer | None  # None: what the model leaves is noise
    # share of the mean square of what the model leaves that it explains of rows that it was not learned from
    explained: float = 0.0
    change: float = 0.0  # root mean square by which its torque differs from that of the layer in use, N m or N
    is_spent: bool = False  # the layer in use has explained nothing in the last windows
    x: Array | None = None  # (m + 3,) coordinates of the belief that belong to the layer; None: those of the belief

    @property
    def text(self) -> str:
        """What is proposed."""
        return f"a residual layer: {self.layer}, which explains {100.0 * self.explained:.0f} % of what the model leaves"


@dataclass(slots=True)
class Residual:
    """Learning of the residual layer of one axis."""

    model: FrictionModel  # of the model file
    figures: LayerFigures = field(default_factory=LayerFigures)
    _waves: tuple[Feature, ...] = ()
    _memory: Memory = field(default_factory=lambda: empty(0))  # of the amplitudes of waves alone
    _grid: tuple[Feature, ...] = ()  # of the other groups
    _ranges: tuple[float, float, float] | None = None  # speed, load and distance that the grid is for
    _joint: Memory = field(default_factory=lambda: empty(0))  # of waves, grid and coordinates of the belief
    _grouped: tuple[str, ...] = ()  # that the last window has shown
    _is_beside: bool = False  # the last trial was of more than ripple
    _is_waves_turn: bool = False  # where that was no gain, ripple alone is tried next
    _spent: int = 0  # windows in which the layer in use explained nothing
    _pause: int = th.LAYER_FIRST_PAUSE
    _rest: int = 0  # windows until the next trial
    _patience: int = 1
    _blind: int = 0  # windows until orders are looked for again

    def look(self, left: LeftOver, used: Layer | None) -> Finding:
        """Learn from what the model without a layer leaves of a window, during which the layer ``used`` was in use."""
        friction = left.friction(left.belief.model)
        added = np.zeros_like(friction) if used is None else left.friction(used.on(left.belief.model)) - friction
        speed = np.abs(left.velocity)
        is_moving = speed > th.LAYER_MOVING * float(np.max(speed, initial=0.0))
        if np.count_nonzero(is_moving) < th.STRETCHES * th.LAYER_PARTS or not np.isfinite(left.torque).all():
            return Finding(None)
        typical = max(float(np.median(np.abs(left.torque[is_moving]))), 1e-12)
        weights = is_moving / np.hypot(typical, left.doubt)
        if used is not None:
            gained = np.sum(weights**2 * (left.torque**2 - (left.torque - added) ** 2))
            self._spent = self._spent + 1 if gained <= 0.0 else 0
            if self._spent >= th.LAYER_SPENT:
                return Finding(None, is_spent=True)
        if not self._waves:
            if self._blind:
                self._blind -= 1
            else:
                self._begin(self._search(left, weights))
        self._spread(left, weights)
        rows = rows_of(left, weights, (*self._waves, *self._grid))
        waves, after = list(range(len(self._waves))), rows.target
        if self._waves:
            own = rows.columns[:, waves]
            predicted = self._predicted(waves, own, rows.target, self._memory, self._expected(waves))
            self._memory = self._memory.older(left.seconds).with_rows(own, rows.target)
            if is_evident(rows.target, rows.target - predicted):
                after = rows.target - predicted
            else:
                waves = []
        index, after = self._groups(rows, waves, after, used)
        self._joint = self._joint.older(left.seconds).with_rows(rows.columns, rows.whole)
        explained = 1.0 - float(np.sum(after**2)) / max(float(np.sum(rows.target**2)), 1e-300)
        found, before = Finding(None, explained), self._grouped
        self._grouped = ()
        kept = set() if used is None else set(used.groups)
        is_turn = not (self._is_waves_turn and waves)
        if index and is_turn and explained > th.LAYER_CLEAR and is_evident(rows.target, after, th.AT_TIMES):
            known = self._joint.at(index)
            solved = known.solved(*self._expected(index, rows, known))
            wanted = Finding(self._layer(index, solved), explained, x=solved[-rows.x.size :])
            found = self._checked(left, rows, friction, added, used, wanted)
            if found.layer is not None:
                self._grouped = found.layer.groups
                if not set(self._grouped) <= {RIPPLE, *before, *kept}:
                    found = Finding(None, explained)  # to be found in two windows, one after the other
        if found.layer is None and waves and kept <= {RIPPLE}:
            wanted = Finding(self._layer(waves, self._memory.solved(*self._expected(waves))), explained)
            found = self._checked(left, rows, friction, added, used, wanted)
        if self._waves and not waves and used is None:
            self._begin(())  # another search at the next window
        return found

    def is_worth(self, found: Finding, used: Layer | None) -> bool:
        """Return True if a finding is worth a trial now."""
        self.figures.explained = found.explained
        if not self.figures.state:
            self.figures.state = "noise only"
        if found.layer is None or found.layer == used:
            return False
        if self._rest:
            self._rest -= 1
            return False
        return True

    def was_tried(self, found: Finding, used: Layer | None, error: float) -> None:
        """Take note that a finding is tried, with the error before; ``used`` is the layer in use so far."""
        self.figures.tried += 1
        self._is_beside = found.layer is not None and found.layer.groups != (RIPPLE,)
        if used is None:
            self.figures.state, self.figures.text = "on trial", str(found.layer)
            self.figures.error_before, self.figures.error_after = error, None

    def was_kept(self, tried: Layer | None, error: float) -> None:
        """Take note that a trial was a gain."""
        self.figures.state, self.figures.text, self.figures.error_after = "on", str(tried), error
        self._pause, self._is_waves_turn = th.LAYER_FIRST_PAUSE, False

    def was_refused(self, used: Layer | None, why: str) -> None:
        """Take note that a trial was no gain, refused or without a verdict; ``used`` is the layer that stays."""
        self.figures.state = why if used is None else "on"
        self._is_waves_turn = self._is_beside
        self._rest, self._pause = self._pause, min(2 * self._pause, th.LAYER_LONGEST_PAUSE)

    def changed_motion(self, used: Layer | None) -> None:
        """Take note of another motion and of what is proven for it; what was learned goes on."""
        self._spent, self._grouped = 0, ()
        if self.figures.tried:
            self.figures.state = "on" if used is not None else "not proven for this motion"

    def end(self) -> None:
        """Begin anew: the layer in use was switched off."""
        self.figures.state = "no longer a gain"
        self._begin(())
        self._grid, self._ranges, self._spent = (), None, 0

    def _begin(self, orders: Sequence[float]) -> None:
        """Go on with other orders of ripple."""
        old = len(self._waves)
        self._waves = pairs(RIPPLE, orders)
        self._memory = empty(len(self._waves))
        joint = empty(len(self._waves) + self._joint.shown.size - old)
        rest = slice(len(self._waves), None)
        joint.information[rest, rest] = self._joint.information[old:, old:]
        joint.shown[rest] = self._joint.shown[old:]
        self._joint = joint

    def _spread(self, left: LeftOver, weights: Array) -> None:
        """Choose the places of the other groups, anew where the motion leaves their ranges."""
        load = np.abs(np.nan_to_num(left.window.load_torque[left.rows][weights > 0.0]))
        is_loaded = float(np.std(load)) > th.LOAD_VARIED * self.model.level
        seen = (power_of_two(np.max(np.abs(left.velocity))), power_of_two(np.max(load)) if is_loaded else 0.0)
        size = len(self._waves) + len(self._grid) + left.belief.x.size
        known = self._ranges or (0.0, 0.0, 0.0)
        if self._joint.shown.size == size and all(one <= other for one, other in zip(seen, known, strict=False)):
            return
        top, most = max(seen[0], known[0]), max(seen[1], known[1])
        # a static map has no distance of its own
        distance = known[2] or presliding(self.model) or float(np.ptp(left.position)) * th.DISTANCE_OF_TRAVEL
        self._ranges = (top, most, distance)
        places = {
            REVERSAL: [distance * each for each in th.LAYER_DISTANCES] if distance > 0.0 else [],
            SPEED: [top * each for each in th.LAYER_SPEEDS],
            LOAD: [most] if most > 0.0 else [],
        }
        own = self.model.modifiers
        self._grid = tuple(each for group, at in places.items() if group not in own for each in pairs(group, at))
        self._joint = empty(len(self._waves) + len(self._grid) + left.belief.x.size)

    def _search(self, left: LeftOver, weights: Array) -> list[float]:
        """Return the orders that stand out."""
        present = self.model.modifiers.get(RIPPLE, ())
        most = min(th.MOST_HARMONICS, MAX_HARMONICS - len(present))
        if most <= 0:
            return []
        thinned = (_thinned(each) for each in (left.position, left.torque, left.slopes, weights))
        position, torque, slopes, weights = thinned
        parts = [slice(0, torque.size)]
        is_linear = self.model.axis == "linear"
        orders = RippleSearch(position, torque, slopes, weights, parts, is_linear=is_linear).orders(most)
        if not orders:
            self._blind, self._patience = self._patience, min(2 * self._patience, th.LAYER_LONGEST_PAUSE)
        return orders

    def _groups(self, rows: Rows, waves: list[int], after: Array, used: Layer | None) -> tuple[list[int], Array]:
        """Return the columns of waves and groups that explain more than waves alone, and what they leave.

        ``waves``: columns of waves that are evident. ``after``: (k,) what these leave of the target.
        """
        features = (*self._waves, *self._grid)
        coordinates = range(len(features), rows.columns.shape[1])
        own = {
            group: [i for i, each in enumerate(features) if each.group == group] for group in (REVERSAL, SPEED, LOAD)
        }
        left = [group for group, index in own.items() if index]
        chosen: list[str] = [group for group in left if used is not None and group in used.groups]

        def tried(groups: list[str]) -> tuple[list[int], Array]:
            index = [*waves, *itertools.chain(*(own[each] for each in groups)), *coordinates]
            known = self._joint.at(index)
            predicted = self._predicted(
                index, rows.columns[:, index], rows.whole, known, self._expected(index, rows, known)
            )
            return index, rows.whole - predicted

        index, now = tried(chosen)
        if not np.sum(now**2) < np.sum(after**2):
            now = after  # what the belief says is better than that
        while left := [group for group in left if group not in chosen]:
            found = {group: tried([*chosen, group]) for group in left}
            best = min(left, key=lambda group: float(np.sum(found[group][1] ** 2)))
            if not is_evident(now, found[best][1], th.AT_TIMES):
                break
            chosen.append(best)
            index, now = found[best]
        return (index, now) if chosen else ([], after)

    def _expected(self, index: list[int], rows: Rows | None = None, known: Memory | None = None) -> tuple[Array, Array]:
        """Return mean and information of amplitudes and coordinates before anything was learned of them.

        Coordinates are held where they are, by what was known of them first and a part of what ``known`` shows.
        """
        count = len(self._waves) + len(self._grid)
        own = [i for i in index if i < count]
        information = expected([(*self._waves, *self._grid)[i] for i in own]) / self.model.level**2
        mean = np.zeros(len(own))
        if rows is not None and known is not None:
            held = th.SAME_ROWS * rows.first**-2.0 + th.LAYER_HELD * np.diag(known.information)[len(own) :]
            information = linalg.block_diag(information, np.diag(held))
            mean = np.concatenate([mean, rows.x])
        return mean, information

    def _predicted(
        self, index: list[int], columns: Array, target: Array, memory: Memory, expected: tuple[Array, Array]
    ) -> Array:
        """Return the target of each part of the rows as the other parts and the past predict it."""
        predicted = np.empty_like(target)
        bounds = np.linspace(0, target.size, th.LAYER_PARTS + 1).astype(int)
        for begin, end in itertools.pairwise(bounds):
            is_other = np.ones(target.size, dtype=bool)
            is_other[begin:end] = False
            solved = memory.with_rows(columns[is_other], target[is_other]).solved(*expected)
            amplitudes = self._layer(index, solved).amplitudes
            solved[: len(amplitudes)] = amplitudes
            predicted[begin:end] = columns[begin:end] @ solved
        return predicted

    def _layer(self, index: list[int], solved: Array) -> Layer:
        """Return the layer of amplitudes, within its bound; values of coordinates follow them."""
        features = (*self._waves, *self._grid)
        own = [features[i] for i in index if i < len(features)]
        # the friction of a model rises with its load
        amplitudes = [float(max(a, 0.0) if each.group == LOAD else a) for each, a in zip(own, solved, strict=False)]
        return Layer(tuple(own), tuple(amplitudes)).limited(th.LAYER_SHARE * self.model.level)

    def _checked(
        self, left: LeftOver, rows: Rows, friction: Array, added: Array, used: Layer | None, found: Finding
    ) -> Finding:
        """Return what is found if it is what it seems, and the layer in use where it hardly differs."""
        assert found.layer is not None
        base, own = left.belief.model, friction
        if found.x is not None:
            try:
                base = left.belief.coordinates.model_at(found.x[:-MECHANICS])
                own = left.friction(base)
            except UsageError:
                return Finding(None, found.explained)
        torque = left.friction(found.layer.on(base))
        if found.x is not None:
            moved = left.slopes[:, -MECHANICS:] @ (found.x - left.belief.x)[-MECHANICS:]
            after = rows.weights * (left.torque - (torque - friction) + moved)
            # coordinates act in straight lines only nearby
            if not np.sum(after**2) < (1.0 - th.LAYER_EXPLAINED) * np.sum(rows.target**2):
                return Finding(None, found.explained)
        change = float(np.sqrt(np.mean((torque - own - added) ** 2)))
        return replace(found, layer=found.layer if change > th.WORTH * self.model.level else used, change=change)


def _thinned(values: Array) -> Array:
    """Return means of successive rows (k, ...), about `th.SEARCHED_ROWS` of them."""
    length = max(len(values) // th.SEARCHED_ROWS, 1)
    rows = len(values) // length
    return np.asarray(values[: rows * length].reshape(rows, length, *values.shape[1:]).mean(axis=1))


def empty(count: int) -> Memory:
    """Return the memory of nothing."""
    return Memory(np.zeros((count, count)), np.zeros(count))


def rows_of(left: LeftOver, weights: Array, features: Sequence[Feature]) -> Rows:
    """Return the rows of a window with weights (k,)."""
    found = columns(left.belief.model, features, left.gradient)
    whole = left.torque - left.slopes @ left.belief.x
    return Rows(
        weights,
        weights[:, None] * np.column_stack([found, -left.slopes]),
        weights * left.torque,
        weights * whole,
        left.belief.x,
        left.belief.first,
    )


def is_evident(before: Array, after: Array, errors: float = th.LAYER_EVIDENT) -> bool:
    """Return True if weighted residuals (k,) became smaller, by so many errors of what their stretches scatter by."""
    starts = np.linspace(0, before.size, th.STRETCHES, endpoint=False).astype(int)
    gains = np.add.reduceat(before**2 - after**2, starts)
    error = float(np.std(gains, ddof=1)) / math.sqrt(gains.size)
    share = float(np.sum(gains)) / max(float(np.sum(before**2)), 1e-300)
    return share > th.LAYER_EXPLAINED and float(np.mean(gains)) > errors * error


def expected(features: Sequence[Feature]) -> Array:
    """Return the information (m, m) with which amplitudes of features are expected about zero, in friction levels.

    Curves are smooth and both directions are alike: the mean of both and half their difference are random walks along
    the places of a curve.
    """
    found = np.eye(len(features)) * th.AMPLITUDE_EXPECTED**-2.0
    for group in (REVERSAL, SPEED, LOAD):
        own = [i for i, each in enumerate(features) if each.group == group]
        count = len(own) // 2
        steps = np.eye(count) - np.eye(count, k=-1)
        walk = np.kron(steps.T @ steps, np.diag([th.CURVE_SMOOTH**-2.0, th.DIRECTIONS_DIFFERENT**-2.0]))
        both = np.kron(np.eye(count), np.array([[0.5, 0.5], [0.5, -0.5]]))
        found[np.ix_(own, own)] = th.SAME_ROWS * both.T @ walk @ both
    return np.asarray(found)


def presliding(model: FrictionModel) -> float:
    """Return the distance over which the torque builds up after a reversal, rad or m; 0 for a static map."""
    stiffness = model.presliding_stiffness
    return model.level / stiffness if stiffness > 0.0 else 0.0


def power_of_two(value: float) -> float:
    """Return the next power of two, so that ranges that hardly differ have the same; 0 for 0."""
    return float(2.0 ** math.ceil(math.log2(value))) if value > 0.0 else 0.0
