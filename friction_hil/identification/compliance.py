"""Two masses, backlash and friction on either side, fitted to the torque over whole recordings. Pure.

    torque = motor_inertia q'' + viscous q' + motor_level bristle(q) + gravity + offset + coupling(q)

The load is simulated, driven by the measured motion of the motor (`friction_hil.identification.compliance`), so that
friction may change its sign on either side and the coupling may have backlash. The torque is nonlinear in the inertia
of the load, stiffness, damping, the Coulomb level of the load and the gap, and in the stroke of the bristle; all else
is linear and projected out. Both sides pass the same low-pass once.

A bristle and a coupling behind which the load sticks are the same spring. They differ in the mass behind it: while the
load sticks, only the motor is accelerated; while it slides, it swings on its spring. A rigid axis with a bristle is
therefore fitted to the same rows, with the same terms.

Source: P. Dahl, The Aerospace Corporation TOR-158(3107-18), 1968 (bristle).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.identification import thresholds as th
from friction_hil.identification.least_squares import scaled_solution
from friction_hil.identification.motor_motion import MotorMotion
from friction_hil.numerics.jit import Array, compiled

LOAD = ("load_inertia", "stiffness", "damping", "load_level", "backlash")
_DIFFERENCE = 1e-3  # step of the derivatives, of each coordinate
_KEPT = 8
_UNSEEN = 1e200  # variance of a parameter on which nothing depends: finite, so that others are not lost by it
_MARGIN = 1e-6  # of a start to its bounds


@dataclass(frozen=True, slots=True, eq=False)
class TorqueFit:
    """Fit of a rigid or a compliant axis to the torque."""

    # ``motor_inertia`` (of a rigid axis: all of it), ``motor_level``, ``delay_s`` that was left, ``stroke``, and for
    # two masses those of `LOAD` and ``inertia``, the sum
    values: dict[str, float]
    errors: dict[str, float]  # standard errors of the values
    at: Array  # coordinates of the search
    residual: Array  # (k,), of the compared rows
    free: float = 0.0  # part of the time in which the gap was open

    @property
    def rmse(self) -> float:
        """Root mean square of the residual."""
        return float(np.sqrt(np.mean(self.residual**2)))


class ComplianceFitter:
    """Fits of rigid and compliant axes to the same rows.

    ``inertia``, ``friction``: rough inertia of the whole axis and rough level of its friction: units of the search.
    ``has_model``: the last column of the motions, friction of a known model, is used.
    """

    def __init__(self, motions: Sequence[MotorMotion], inertia: float, friction: float, *, has_model: bool) -> None:
        self._motions = motions
        self._inertia, self._friction, self.has_model = inertia, friction, has_model
        self._bristles: dict[float, Array] = {}  # most steps of a search change something else
        self._travel = max(float(np.ptp(each.position)) for each in motions)
        self._target = np.concatenate([each.compared(each.torque) for each in motions])
        fixed = np.concatenate([each.compared(each.columns) for each in motions])
        self._fixed: Array = fixed if has_model else fixed[:, : fixed.shape[1] - 1]
        norms = np.linalg.norm(self._fixed, axis=0)
        self._basis = np.linalg.qr(self._fixed / np.where(norms > 0.0, norms, 1.0))[0]
        begins = np.cumsum([0, *(len(each.rows) for each in motions)])
        self._starts = np.concatenate([b + each.starts for b, each in zip(begins[:-1], motions, strict=True)])

    def rigid(self) -> TorqueFit:
        """Fit a single mass with a bristle."""
        return self._searched([np.array([math.log(each)]) for each in th.STROKES])

    def compliant(self, rigid: TorqueFit) -> TorqueFit | None:
        """Fit two masses without backlash, from a coarse grid; None if that is hardly better than one mass."""
        lower, upper = self._bounds(5)
        rough = [
            np.array([stroke, math.log(share), omega, math.log(0.05), level])
            for stroke in th.SHORT_STROKES
            for omega in np.linspace(lower[2] + 0.5, upper[2] - 0.2, th.TWO_MASSES_GRID)
            for level in (0.02, 0.5, 0.95)
            for share in (0.15, 0.5)
        ]
        short = self._for_each_share(self._best(rough, th.FINER))
        if min(self._cost(at) for at in short) > th.PROMISING**2 * float(rigid.residual @ rigid.residual):
            return None
        return self._searched(short)

    def with_backlash(self, begin: TorqueFit) -> TorqueFit:
        """Fit two masses with backlash; ``begin`` is the fit without."""
        gaps = [
            np.array([*begin.at[:2], begin.at[2] + stiffer, *begin.at[3:5], gap])
            for gap in np.geomspace(0.05, 50.0, 12)
            for stiffer in (0.0, 0.25, 0.75)
        ]
        return self._searched(self._for_each_share(self._best(gaps, th.FINER)))

    def near(self, begin: TorqueFit) -> TorqueFit:
        """Fit the same form as another fit, from where it ended."""
        return self._searched([begin.at])

    def evidence(self, one: TorqueFit, other: TorqueFit) -> float:
        """Return by how many standard errors ``one`` is better than ``other``, stretch of time by stretch."""
        gains = np.add.reduceat(other.residual**2 - one.residual**2, self._starts)
        spread = float(np.std(gains, ddof=1)) * math.sqrt(len(gains)) if len(gains) > 1 else 0.0
        return float(np.sum(gains)) / spread if spread > 0.0 else 0.0

    def physical(self, at: Array) -> dict[str, float]:
        """Return the nonlinear parameters of coordinates.

        The coordinates are the logarithms of stroke, inertia of the load, square root of the stiffness and damping
        ratio, then the level of the load and the backlash, all in units of the axis. Stiffness rather than the
        anti-resonance is one of them because slow motion determines it whatever the inertia.
        """
        values = {"stroke": self._travel * math.exp(at[0])}
        if len(at) > 1:
            load, stiffness = self._inertia * math.exp(at[1]), self._inertia * math.exp(2.0 * at[2])
            damping = 2.0 * math.exp(at[3]) * math.sqrt(stiffness * load)
            backlash = self._gap * at[5] if len(at) > 5 else 0.0
            values |= zip(LOAD, (load, stiffness, damping, self._friction * at[4], backlash), strict=True)
        return values

    @property
    def _gap(self) -> float:
        return 1e-3 * self._travel

    def _bounds(self, count: int) -> tuple[Array, Array]:
        top = 1.5 * max(each.cutoff_hz for each in self._motions)
        omegas = math.log(math.tau * th.LEAST_HZ), math.log(math.tau * top)
        lower = [
            math.log(th.TWO_MASSES_LEAST_STROKE),
            math.log(1e-4),
            omegas[0],
            math.log(th.TWO_MASSES_LEAST_RATIO),
            0.0,
            0.0,
        ]
        upper = [math.log(th.MOST_STROKE), math.log(2.0), omegas[1], math.log(th.MOST_RATIO), 2.0, 200.0]
        return np.array(lower[:count]), np.array(upper[:count])

    def _for_each_share(self, starts: Sequence[Array]) -> list[Array]:
        """Return coordinates after a short search for each of several inertias of the load.

        The load swings on after each reversal; one that swings a period more or less is a minimum of its own.
        """
        found = []
        for share in th.TWO_MASSES_SHARES:
            near = [
                np.array([at[0], math.log(share), at[2], math.log(ratio), *at[4:]])
                for at in starts
                for ratio in (0.02, 0.1)
            ]
            found.append(self._descended(self._best(near, 1)[0], th.TWO_MASSES_FIRST_EVALUATIONS)[0])
        return found

    def _descended(self, at: Array, evaluations: int) -> tuple[Array, float]:
        """Return coordinates and cost after a local search."""
        from scipy.optimize import least_squares  # imported here: commands that do not need it start faster

        found = least_squares(
            self._residual,
            at,
            bounds=self._bounds(len(at)),
            diff_step=_DIFFERENCE,
            max_nfev=evaluations,
            ftol=1e-5,
            xtol=1e-5,
            x_scale=0.3,
        )
        return found.x, float(found.cost)

    def _best(self, starts: Sequence[Array], count: int) -> list[Array]:
        """Return the best of some coordinates, within the bounds."""
        lower, upper = self._bounds(len(starts[0]))
        within = [np.clip(at, lower + _MARGIN, upper - _MARGIN) for at in starts]
        if len(within) <= count:
            return within
        costs = [self._cost(at) for at in within]
        return [within[int(index)] for index in np.argsort(costs)[:count]]

    def _searched(self, starts: Sequence[Array]) -> TorqueFit:
        ends = [self._descended(at, th.TWO_MASSES_EVALUATIONS) for at in self._best(starts, th.SEARCHES)]
        return self._result(min(ends, key=lambda each: each[1])[0])

    def _coupling(self, at: Array) -> tuple[Array, float]:
        """Return the compared torque of the coupling, and the part of the time in which the gap was open."""
        if len(at) == 1:
            return np.zeros_like(self._target), 0.0
        values = self.physical(at)
        found, free = [], 0.0
        for each in self._motions:
            torque, is_free = coupling_torque(
                each.position,
                each.dt,
                load_inertia=values["load_inertia"],
                stiffness=values["stiffness"],
                damping=values["damping"],
                backlash=values["backlash"],
                level=values["load_level"],
                load=each.load,
            )
            found.append(each.compared(torque))
            free += float(np.mean(is_free)) / len(self._motions)
        return np.concatenate(found), free

    def _bristle(self, at: Array) -> Array:
        key = float(at[0])
        if key not in self._bristles:
            if len(self._bristles) >= _KEPT:
                self._bristles.clear()
            stroke = self.physical(at[:1])["stroke"]
            self._bristles[key] = np.concatenate([each.compared(each.bristle(stroke)) for each in self._motions])
        return self._bristles[key]

    def _cost(self, at: Array) -> float:
        residual = self._residual(at)
        return float(residual @ residual)

    def _residual(self, at: Array) -> Array:
        """Return the residual (k,) after the best linear parameters."""
        rest, bristle = self._target - self._coupling(at)[0], self._bristle(at)
        rest, bristle = (each - self._basis @ (self._basis.T @ each) for each in (rest, bristle))
        size = float(bristle @ bristle)
        return np.asarray(rest - bristle * (float(bristle @ rest) / size) if size > 0.0 else rest)

    def _result(self, at: Array) -> TorqueFit:
        coupling, free = self._coupling(at)
        columns = np.column_stack([self._bristle(at), self._fixed])
        linear = scaled_solution(columns, self._target - coupling)
        residual = self._target - coupling - columns @ linear
        steps = np.diag(_DIFFERENCE * np.maximum(np.abs(at), 1.0))

        def predicted(point: Array) -> Array:
            return np.asarray(self._coupling(point)[0] + linear[0] * self._bristle(point))

        slopes = [(predicted(at + step) - predicted(at - step)) / (2.0 * step.sum()) for step in steps]
        covariance = sandwich(np.column_stack([*slopes, columns]), residual, self._starts)
        count = len(at)
        own = {"motor_level": count, "motor_inertia": count + 1, "delay_s": count + 2}
        values = {name: float(linear[k - count]) for name, k in own.items()} | self.physical(at)
        gradients = {name: np.eye(len(covariance))[k] for name, k in own.items()}
        for name in self.physical(at):
            gradients[name] = np.zeros(len(covariance))
            for k, step in enumerate(steps):
                up, down = self.physical(at + step), self.physical(at - step)
                gradients[name][k] = (up[name] - down[name]) / (2.0 * step.sum())
        if count > 1:
            values["inertia"] = values["motor_inertia"] + values["load_inertia"]
            gradients["inertia"] = gradients["motor_inertia"] + gradients["load_inertia"]
        errors = {name: math.sqrt(max(float(g @ covariance @ g), 0.0)) for name, g in gradients.items()}
        return TorqueFit(values, errors, at, residual, free)


def sandwich(jacobian: Array, residual: Array, starts: NDArray[np.intp]) -> Array:
    """Return the covariance (p, p) of parameters where residuals within a stretch of rows are correlated.

    ``jacobian`` is (k, p), ``residual`` (k,); ``starts``: first row of each stretch.

    Source: K.-Y. Liang, S. Zeger, Biometrika 73(1), 1986.
    """
    norms = np.linalg.norm(jacobian, axis=0)
    is_unseen = norms == 0.0
    norms = np.where(is_unseen, 1.0, norms)
    scaled = jacobian / norms
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12)
    sums = np.add.reduceat(scaled * residual[:, None], starts, axis=0)
    covariance = np.asarray(inverse @ (sums.T @ sums) @ inverse / np.outer(norms, norms))
    covariance[is_unseen, is_unseen] = _UNSEEN
    return covariance


def coupling_torque(
    position: Array,  # (n,) of the motor, evenly sampled, rad or m
    dt: float,  # s
    *,
    load_inertia: float,  # kg m^2 or kg, above zero
    stiffness: float,  # N m/rad or N/m, above zero
    damping: float,  # N m s/rad or N s/m
    backlash: float,  # whole width of the gap, rad or m
    level: float,  # Coulomb friction of the load, N m or N
    load: Array,  # (n,), torque on the load that opposes positive motion, N m or N, e.g. its weight
) -> tuple[Array, Array]:
    """Simulate the load and return the torque that it takes from the motor.

    Returns the torque at the samples, N m or N, and the part of the period before each sample in which the gap was
    open.
    """
    parts = max(1, math.ceil(math.sqrt(stiffness / load_inertia) * dt / th.TWO_MASSES_STEP))
    torque, is_free = np.empty(len(position)), np.empty(len(position))
    _simulate(position, dt, parts, load_inertia, stiffness, damping, 0.5 * backlash, level, load, torque, is_free)
    return torque, is_free


@compiled
def _simulate(
    position: Array,
    dt: float,
    parts: int,
    inertia: float,
    stiffness: float,
    damping: float,
    half: float,
    level: float,
    load: Array,
    torque: Array,
    is_free: Array,
) -> None:
    step = dt / parts
    count = len(position)
    hold = step * level / inertia
    q, v = position[0], 0.0
    torque[0], is_free[0] = 0.0, 0.0
    coupling = 0.0
    for i in range(1, count):
        begin, end = position[i - 1], position[i]
        slope = 0.5 * (end - position[max(i - 2, 0)])
        next_slope = 0.5 * (position[min(i + 1, count - 1)] - begin)
        rise = end - begin
        a, b = slope + next_slope - 2.0 * rise, 3.0 * rise - 2.0 * slope - next_slope
        free = 0
        for k in range(1, parts + 1):
            x = k / parts
            motor = begin + x * (slope + x * (b + x * a))
            speed = (slope + x * (2.0 * b + 3.0 * x * a)) / dt
            twist = motor - q
            if twist > half:
                coupling = stiffness * (twist - half) + damping * (speed - v)
                if half > 0.0 and coupling < 0.0:
                    coupling = 0.0
            elif twist < -half:
                coupling = stiffness * (twist + half) + damping * (speed - v)
                if half > 0.0 and coupling > 0.0:
                    coupling = 0.0
            elif half > 0.0:
                coupling = 0.0
                free += 1
            else:
                coupling = damping * (speed - v)
            v += step * (coupling - load[i]) / inertia
            v -= min(max(v, -hold), hold)
            q += step * v
        torque[i] = coupling
        is_free[i] = free / parts
