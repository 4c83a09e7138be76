"""The plainest axis: inertia, Coulomb and viscous friction that are not negative, beside offset and gravity. Pure."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from friction_hil.identification import thresholds as th
from friction_hil.identification.data import Data, Mask
from friction_hil.numerics.jit import Array


class PlainAxis:
    """Linear regression of the torque of an axis whose friction is Coulomb and viscous.

    ``gravity``: parameters of gravity to fit, such as ``gravity.sine``. ``has_spring``: a torque that is proportional
    to the position is fitted, too; in a swing about one place it looks like a negative inertia.
    """

    def __init__(self, data: Data, gravity: Sequence[str], *, has_spring: bool = False) -> None:
        self._data = data
        direction = data.stack([np.sign(record.velocity) for record in data.records])
        signed = np.column_stack([data.column("inertia"), direction, data.column("viscous")])
        size = np.linalg.norm(signed, axis=0)
        self._signed: Array = signed / np.where(size > 0.0, size, 1.0)
        names = dict.fromkeys(["offset", *(name for name in gravity if name != "gravity.constant")])
        free = [data.column(name) for name in names] + ([data.motion("position")] if has_spring else [])
        self._free: Array = np.column_stack(free)

    def error(self, torque: Array | None = None, *, sign: float = 1.0) -> float:
        """Return the relative error of the fit to a torque (k,), the measured one by default, times ``sign``."""
        wanted = sign * (self._data.torque if torque is None else torque)
        norm = float(np.linalg.norm(wanted))
        return float(np.linalg.norm(wanted - self._predict(wanted))) / norm if norm > 0.0 else math.nan

    def least_speed(self, speed: Array) -> float | None:
        """Return the least speed below which rows spoil the prediction of fast motion; None if there is none.

        The axis is fitted to the rows above several least speeds. Each fit is judged by the same fast rows, in blocks
        that were held out of it.
        """
        top = float(np.quantile(speed, th.TOP))
        fast = speed >= th.FRACTIONS[-1] * top
        tried = [
            value
            for value in (fraction * top for fraction in th.FRACTIONS)
            if np.mean(speed >= value) > th.PLAIN_LEAST_SHARE
        ]
        if not tried or top == 0.0:
            return None
        errors = [self._held_out(speed >= value, fast) for value in (0.0, *tried)]
        best = min(errors)
        if errors[0] <= th.SPOILT * best:
            return None
        return next(value for value, error in zip(tried, errors[1:], strict=True) if error <= th.PLAIN_SAME * best)

    def _held_out(self, rows: Mask, judged: Mask) -> float:
        """Return the RMS error in the rows ``judged``, each block predicted by a fit to ``rows`` of the others."""
        torque, square, count = self._data.torque, 0.0, 0
        edges = np.linspace(0, len(torque), th.BLOCKS + 1).round().astype(int)
        for begin, end in itertools.pairwise(edges):
            kept, own = rows.copy(), np.zeros(len(torque), dtype=bool)
            kept[begin:end] = False
            own[begin:end] = judged[begin:end]
            if np.count_nonzero(kept) <= self._signed.shape[1] + self._free.shape[1]:
                return math.inf
            square += float(np.sum((torque[own] - self._predict(torque, kept)[own]) ** 2))
            count += int(np.count_nonzero(own))
        return math.sqrt(square / count) if count else math.inf

    def _predict(self, torque: Array, rows: Mask | slice = slice(None)) -> Array:
        """Return the prediction (k,) of a fit to some rows of a torque (k,)."""
        signed, free, wanted = self._signed[rows], self._free[rows], torque[rows]
        # what has no sign is projected out, and found afterwards from what is left
        basis = np.linalg.qr(free)[0]
        size, _ = nnls(signed - basis @ (basis.T @ signed), wanted - basis @ (basis.T @ wanted))
        rest = np.linalg.lstsq(free, wanted - signed @ size, rcond=None)[0]
        predicted: Array = self._signed @ size + self._free @ rest
        return predicted
