"""Orders of the position harmonics (cogging, gear mesh, screw pitch) that stand out in the residual of a fit. Pure.

Harmonics are added one at a time, each the one that lowers the residual most after everything that the fit has already
is projected out (orthogonal matching pursuit). A harmonic counts only

- if its columns are independent of those of the fit: over less than about two periods it looks like an offset, gravity
  or a difference of directions;
- if it exceeds what the largest of as many harmonics would be without a ripple. Its standard error allows for
  correlated residuals (sums over stretches of time: K.-Y. Liang, S. Zeger, Biometrika 73(1), 1986).

Where the position is an angle, ripple repeats with each revolution, so that orders are whole numbers. A real order is
returned only if it differs from a whole number by several standard errors (ripple of a motor behind a gear, for
example). On a linear axis all orders are real.

Source: Y. C. Pati, R. Rezaiifar, P. S. Krishnaprasad, Asilomar Conference on Signals, Systems and Computers, 1993.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from friction_hil.identification import thresholds as th
from friction_hil.numerics.jit import Array

_Basis = Array  # (k, l) with orthonormal columns
_Complex = NDArray[np.complex128]

MOST_HARMONICS = 4
_SLOW_DEGREE = 1  # of a polynomial of the position
_CHUNK = 64  # orders computed at once


class RippleSearch:
    """Search for harmonics in a residual."""

    def __init__(
        self,
        position: Array,  # (k,), rad or m
        residual: Array,  # (k,), N m or N
        jacobian: Array,  # (k, p), derivatives of the predicted torque over the parameters that the fit has already
        weights: Array,  # (k,), of the rows
        parts: Sequence[slice],  # rows of each record
        *,
        is_linear: bool,  # the position is a length: orders are then real and per metre
    ) -> None:
        self._is_linear = is_linear
        self._turns = position / (1.0 if is_linear else 2.0 * math.pi)
        self._travel = float(np.ptp(self._turns))
        self._step = np.abs(np.gradient(self._turns)) if len(position) > 1 else np.zeros(len(position))
        self._weights = weights
        # a low harmonic looks like an offset and a slope, whether the fit has them or not
        middle = self._turns - 0.5 * float(np.max(self._turns) + np.min(self._turns))
        slow = np.vander(middle / max(0.5 * self._travel, 1e-300), _SLOW_DEGREE + 1)
        columns = np.column_stack([slow, jacobian]) * weights[:, None]
        self._basis = _orthonormal(columns)
        self._target = weights * residual
        self._starts = np.concatenate([np.arange(part.start, part.stop, th.RIPPLE_STRETCH_ROWS) for part in parts])

    def orders(self, most: int = MOST_HARMONICS) -> list[float]:
        """Return the orders that stand out, largest first, per revolution or per metre."""
        grid = self._grid()
        found: list[float] = []
        bar = 2.0 * math.log(max(len(grid), 1)) + th.RIPPLE_EVIDENT
        start = self._target - self._basis @ (self._basis.T @ self._target)
        energy = float(start @ start)
        while len(grid) and len(found) < most:
            before, basis = found, self._span(found)
            gains = self._gains(grid, basis)
            if float(np.max(gains)) <= th.RIPPLE_LEAST_SHARE * energy:
                break
            found = self._polished([*found, self._peak(float(grid[np.argmax(gains)]), basis)])
            grid = grid[np.all(np.abs(grid[:, None] - found) >= 1.0 / self._travel, axis=1)]
            if min(self._evidence(found)) < bar:
                found = before
                break
        return self._where_contradicted(found)

    def _grid(self) -> Array:
        """Return orders at half the distance that the travel can tell apart."""
        if self._travel <= 0.0:
            return np.empty(0)
        low, high = th.RIPPLE_LEAST_PERIODS / self._travel, th.RIPPLE_MOST_PERIODS / self._travel
        grid = np.arange(low, high, 0.5 / self._travel)
        if not self._is_linear:
            grid = grid[grid >= 1.0]
        # half of the rows at least must resolve it: few slow ones show presliding rather than ripple
        return grid[grid * float(np.median(self._step)) * th.RIPPLE_ROWS_PER_PERIOD < 1.0]

    def _columns(self, order: float) -> Array:
        """Return weighted cosine and sine (k, 2), zero where rows are too far apart to resolve a period."""
        wave = self._waves(np.array([order]))[:, 0]
        return np.column_stack([wave.real, wave.imag])

    def _waves(self, orders: Array) -> _Complex:
        is_resolved = self._step[:, None] * orders * th.RIPPLE_ROWS_PER_PERIOD < 1.0
        waves = np.exp(2j * math.pi * np.outer(self._turns, orders))
        return np.asarray(waves * (is_resolved * self._weights[:, None]))

    def _span(self, orders: Sequence[float]) -> _Basis:
        """Return a basis of what the fit and these harmonics explain."""
        return _orthonormal(np.column_stack([self._basis, *(self._columns(each) for each in orders)]))

    def _gains(self, orders: Array, basis: _Basis) -> Array:
        """Return the decrease of the sum of squares by each order (n,); 0 where the fit has it already."""
        left = self._target - basis @ (basis.T @ self._target)
        gains = np.zeros(len(orders))
        for begin in range(0, len(orders), _CHUNK):
            waves = self._waves(orders[begin : begin + _CHUNK])
            parts = np.hstack([waves.real, waves.imag])
            count = waves.shape[1]
            inner = basis.T @ parts
            cc, ss = (
                np.sum(parts[:, half] ** 2, axis=0) - np.sum(inner[:, half] ** 2, axis=0)
                for half in (slice(0, count), slice(count, None))
            )
            cs = np.sum(parts[:, :count] * parts[:, count:], axis=0) - np.sum(
                inner[:, :count] * inner[:, count:], axis=0
            )
            score = left @ parts
            c, s = score[:count], score[count:]
            energy = 0.5 * np.sum(parts**2, axis=0).reshape(2, count).sum(axis=0)
            least = 0.5 * (cc + ss) - np.hypot(0.5 * (cc - ss), cs)
            is_seen = least > th.RIPPLE_LEAST_INDEPENDENT * energy
            determinant = np.where(is_seen, cc * ss - cs**2, 1.0)
            gains[begin : begin + count] = np.where(
                is_seen, (ss * c**2 - 2.0 * cs * c * s + cc * s**2) / determinant, 0.0
            )
        return gains

    def _peak(self, order: float, basis: _Basis) -> float:
        """Return the best order near one of the grid: on a rotary axis a whole number, if the travel allows one."""
        width = 0.6 / self._travel
        if not self._is_linear:
            near = np.arange(max(1.0, math.ceil(order - width)), math.floor(order + width) + 1.0)
            gains = self._gains(near, basis)
            if len(near) and np.any(gains > 0.0):
                return float(near[np.argmax(gains)])
        return self._real_peak(order, basis, width)

    def _real_peak(self, order: float, basis: _Basis, width: float) -> float:
        """Return the real order with the largest gain near a given one, by successively finer grids."""
        for _ in range(6):
            near = order + width * np.linspace(-1.0, 1.0, 9)
            near = near[near > 0.0]
            order = float(near[np.argmax(self._gains(near, basis))])
            width /= 3.0
        return order

    def _polished(self, orders: list[float]) -> list[float]:
        """Return the orders with each of them chosen anew while the others are taken as they are.

        Two that are closer than the travel can tell apart would fit a difference of two large harmonics to noise.
        """
        orders = list(orders)
        for _ in range(th.RIPPLE_POLISHES if len(orders) > 1 else 0):
            before = list(orders)
            for i in range(len(orders)):
                others = [*orders[:i], *orders[i + 1 :]]
                peak = self._peak(orders[i], self._span(others))
                if min(abs(peak - each) for each in others) >= 1.0 / self._travel:
                    orders[i] = peak
            if orders == before:
                break
        return orders

    def _evidence(self, orders: Sequence[float]) -> list[float]:
        """Return the Wald statistic of each harmonic, all of them fitted together."""
        found = []
        for i, order in enumerate(orders):
            basis = self._span([*orders[:i], *orders[i + 1 :]])
            columns = self._columns(order)
            columns -= basis @ (basis.T @ columns)
            factors, covariance = self._fitted(columns, basis)
            found.append(float(factors @ np.linalg.lstsq(covariance, factors, rcond=None)[0]))
        return found

    def _fitted(self, columns: Array, basis: _Basis) -> tuple[Array, Array]:
        """Fit columns (k, m) outside ``basis`` to the residual; return factors (m,) and their covariance (m, m)."""
        left = self._target - basis @ (basis.T @ self._target)
        inverse = np.linalg.pinv(columns.T @ columns)
        factors = inverse @ (columns.T @ left)
        scores = columns * (left - columns @ factors)[:, None]
        sums = np.add.reduceat(scores, self._starts, axis=0)
        return factors, inverse @ (sums.T @ sums) @ inverse

    def _where_contradicted(self, orders: list[float]) -> list[float]:
        """Return the orders, real ones in place of whole ones that the data contradict."""
        if self._is_linear:
            return orders
        kept = list(orders)
        for i, order in enumerate(orders):
            if order != round(order):
                continue
            others = self._span([*kept[:i], *kept[i + 1 :]])
            real = self._real_peak(order, others, 0.5)
            # the derivative over the order, at the peak, tells how well the data determine it
            columns = self._columns(real)
            basis = _orthonormal(np.column_stack([others, columns]))
            amplitudes = np.linalg.lstsq(
                columns - others @ (others.T @ columns), self._target - others @ (others.T @ self._target), rcond=None
            )[0]
            slope = (2.0 * math.pi * self._turns) * (columns[:, 0] * amplitudes[1] - columns[:, 1] * amplitudes[0])
            slope = (slope - basis @ (basis.T @ slope))[:, None]
            shift, variance = self._fitted(slope, basis)
            distance = abs(real + float(shift[0]) - order)
            if distance > th.RIPPLE_CONTRADICTION * math.sqrt(float(variance[0, 0])) and distance < 0.5:
                kept[i] = real
        return kept


def _orthonormal(columns: Array) -> _Basis:
    """Return an orthonormal basis of the span of columns (k, m)."""
    norms = np.linalg.norm(columns, axis=0)
    kept = columns[:, norms > 0.0] / norms[norms > 0.0]
    # by the small Gram matrix: tall and thin matrices are slow to factorise
    values, vectors = np.linalg.eigh(kept.T @ kept)
    is_kept = values > 1e-10 * max(float(values[-1]), 1e-300) if len(values) else np.zeros(0, dtype=bool)
    basis = kept @ (vectors[:, is_kept] / np.sqrt(values[is_kept]))
    # once more, for rounding
    values, vectors = np.linalg.eigh(basis.T @ basis)
    return np.asarray(basis @ (vectors / np.sqrt(values)))
