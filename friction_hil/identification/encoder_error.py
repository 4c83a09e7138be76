"""Periodic error of the encoder: ripple of the measured position, as opposed to ripple of the torque. Pure.

An error e(q) of the measured position adds inertia times d2e/dt2 to the torque that the measured motion asks for. Over
the position it looks like cogging, but it grows with the square of the speed, while cogging does not. Both are
therefore fitted together for each order to the residual of a fit, and an order is an error of the encoder only if what
grows with the speed is clearly above zero beside what does not.

Source: S.-H. Lee et al., IEEE Transactions on Industrial Electronics 58(5), 2011 (position error of encoders with sine
and cosine signals).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.identification import thresholds as th
from friction_hil.identification.compliance import sandwich
from friction_hil.identification.motor_motion import MotorMotion, derivatives
from friction_hil.numerics import filtering
from friction_hil.numerics.jit import Array


@dataclass(frozen=True, slots=True)
class EncoderError:
    """Error of the measured position, ``amplitude`` sin(order q + phase)."""

    order: float  # periods per revolution, or per metre
    amplitude: float  # rad or m
    error: float  # standard error of the amplitude


def find_encoder_error(
    motions: Sequence[MotorMotion], residual: Array, inertia: float, *, is_linear: bool
) -> tuple[EncoderError, ...]:
    """Find orders in the residual of a fit that grow with the square of the speed.

    ``residual``: (k,), measured less predicted torque in the compared rows of the motions. ``inertia``: that moves with
    the encoder. ``is_linear``: the position is a length, and orders are per metre.
    """
    turn = 1.0 if is_linear else math.tau
    search = _Search(motions, residual, inertia, turn)
    travel = max(float(np.ptp(each.position)) for each in motions) / turn
    if travel <= 0.0:
        return ()
    step = 0.5 / travel if is_linear else 1.0
    least = max(th.LEAST_PERIODS / travel, step)
    orders: Array = (
        np.arange(math.ceil(least / step), math.ceil(least / step) + th.MOST_ORDERS, dtype=np.float64) * step
    )
    orders = orders[[search.is_resolved(each) for each in orders]]
    found: list[EncoderError] = []
    bar = 2.0 * math.log(max(len(orders), 1)) + th.ENCODER_EVIDENT
    for _ in range(th.MOST_LOOKED_AT if len(orders) else 0):
        order = float(orders[np.argmax(search.gains(orders))])
        both, share, amplitude, error = search.fit(order)
        if both < bar:
            break
        if share > th.ENCODER_LEAST_SHARE and amplitude > th.ENCODER_CLEAR * error:
            found.append(EncoderError(order, amplitude, error))
    return tuple(found)


class _Search:
    def __init__(self, motions: Sequence[MotorMotion], residual: Array, inertia: float, turn: float) -> None:
        self._motions, self._inertia, self._turn = motions, inertia, turn
        low = [filtering.lowpass(each.position, each.cutoff_hz, 1.0 / each.dt) for each in motions]
        rates = [derivatives(position, each.dt) for position, each in zip(low, motions, strict=True)]
        self._q = np.concatenate([position[each.rows] for position, each in zip(low, motions, strict=True)])
        self._v = np.concatenate([rate[0][each.rows] for rate, each in zip(rates, motions, strict=True)])
        self._a = np.concatenate([rate[1][each.rows] for rate, each in zip(rates, motions, strict=True)])
        self._fastest = np.concatenate([np.full(len(each.rows), th.ENCODER_BAND * each.cutoff_hz) for each in motions])
        begins = np.cumsum([0, *(len(each.rows) for each in motions)])
        self._starts: NDArray[np.intp] = np.concatenate(
            [b + each.starts for b, each in zip(begins[:-1], motions, strict=True)]
        )
        self._residual = residual.copy()

    def is_resolved(self, order: float) -> bool:
        """True if enough rows pass a period of the order slowly enough for the low-pass."""
        return bool(np.count_nonzero(self._is_slow(order)) >= th.ENCODER_LEAST_ROWS)

    def _is_slow(self, order: float) -> NDArray[np.bool_]:
        return np.asarray(np.abs(self._v) * order / self._turn < self._fastest)

    def gains(self, orders: Array) -> Array:
        """Return by how much each order (n,) lowers the sum of squares, as ripple of the torque and of the position."""
        found = np.zeros(len(orders))
        for i, order in enumerate(orders.tolist()):
            columns = self._columns(order)
            columns[~self._is_slow(order)] = 0.0
            norms = np.linalg.norm(columns, axis=0)
            columns /= np.where(norms > 0.0, norms, 1.0)
            score = columns.T @ self._residual
            found[i] = float(score @ np.linalg.lstsq(columns.T @ columns, score, rcond=1e-6)[0])
        return found

    def _columns(self, order: float) -> Array:
        """Return torque ripple and error of the encoder (k, 4), cosine and sine of each, without the low-pass."""
        w = math.tau / self._turn * order
        cosine, sine = np.cos(w * self._q), np.sin(w * self._q)
        square, linear = (w * self._v) ** 2, w * self._a
        return np.column_stack(
            [
                cosine,
                sine,
                self._inertia * (-square * cosine - linear * sine),
                self._inertia * (-square * sine + linear * cosine),
            ]
        )

    def fit(self, order: float) -> tuple[float, float, float, float]:
        """Fit an order through the low-pass, and remove it.

        Returns the Wald statistic of both ripples, the part of what they explain that the ripple of the torque alone
        does not, and amplitude and standard error of the position's.
        """
        w = math.tau / self._turn * order
        parts = []
        for each in self._motions:
            waves = np.column_stack([np.cos(w * each.position), np.sin(w * each.position)])
            curved = np.column_stack([derivatives(wave, each.dt)[1] for wave in waves.T])
            parts.append(each.compared(np.column_stack([waves, self._inertia * curved])))
        columns = np.concatenate(parts)
        columns[~self._is_slow(order)] = 0.0
        factors = np.linalg.lstsq(columns, self._residual, rcond=1e-12)[0]
        after = self._residual - columns @ factors
        everything = sandwich(columns, after, self._starts)
        both = float(factors @ np.linalg.pinv(everything) @ factors)
        covariance, pair = everything[2:, 2:], factors[2:]
        torque = columns[:, :2] @ np.linalg.lstsq(columns[:, :2], self._residual, rcond=1e-12)[0]
        explained = float(self._residual @ self._residual - after @ after)
        left = self._residual - torque
        share = float(left @ left - after @ after) / explained if explained > 0.0 else 0.0
        amplitude = float(np.hypot(*pair))
        slope = pair / amplitude if amplitude > 0.0 else np.zeros(2)
        self._residual = after
        return both, share, amplitude, math.sqrt(max(float(slope @ covariance @ slope), 0.0))
