"""Two masses on a spring, fitted to the frequency response of the motor. Pure.

    torque = (s motor_inertia + viscous + s load_inertia (stiffness + s damping)
              / (stiffness + s damping + s^2 load_inertia)) velocity

The anti-resonance is that of the load on its spring with the motor held still, sqrt(stiffness / load inertia); the
resonance that of both masses, sqrt(stiffness / load inertia + stiffness / motor inertia). A delay of the measured
torque turns the phase and is fitted too.

Another axis that is held in its place by its control loops gives way under this one. With a constant inertia for the
acceleration of each such axis, as its motion was measured, it is not taken for a load behind a coupling.

Source: G. Ferretti, G. Magnani, P. Rocco, Control Engineering Practice 12(1), 2004, section 2 (two-mass form).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from friction_hil.identification import thresholds as th
from friction_hil.identification.compliance import sandwich
from friction_hil.identification.frequency_response import Complex, FrequencyResponse
from friction_hil.numerics.jit import Array

_NAMES = ("motor_inertia", "load_inertia", "stiffness", "damping", "viscous", "delay_s")
_LARGEST_ERRORS = {"antiresonance_hz": 0.1, "resonance_hz": 0.1, "load_inertia": 0.3, "motor_inertia": 0.3}


@dataclass(frozen=True, slots=True)
class Resonance:
    """Two masses on a spring, with standard errors."""

    # ``motor_inertia``, ``load_inertia``, ``inertia`` (their sum), ``stiffness``, ``damping``, ``antiresonance_hz``,
    # ``resonance_hz``, ``damping_ratio`` (of the resonance), ``viscous`` and ``delay_s``: SI of the axis
    values: dict[str, float]
    errors: dict[str, float]  # standard errors of the values; include the mismatch of the form


def fit_resonance(response: FrequencyResponse) -> tuple[Resonance | None, str]:
    """Fit two masses to a frequency response; None, and why, if it does not show a resonance."""
    low, high = response.band_hz
    inside = (response.frequency_hz >= low) & (response.frequency_hz <= high)
    if np.mean(response.is_used[inside]) < th.LEAST_USED:
        return None, f"the recording excites only some frequencies between {low:.3g} and {high:.3g} Hz"
    found, why = _fit(response, response.response)
    if found is None or abs(found.values["delay_s"] / response.period_s - 0.5) > th.NEAR_MEAN:
        return found, why
    # half a period old, the torque is a mean over the period, which is smaller than the torque at high frequencies
    mean = np.sinc(response.frequency_hz * response.period_s)
    return _fit(response, response.response * mean)


def _fit(response: FrequencyResponse, corrected: Complex) -> tuple[Resonance | None, str]:
    from scipy.optimize import least_squares  # imported here: commands that do not need it start faster

    omega = math.tau * response.frequency_hz[response.is_used]
    measured = corrected[response.is_used]
    beside = response.beside[:, response.is_used]
    others = len(beside)
    sigma = np.maximum(response.errors[response.is_used], th.LEAST_ERROR)

    def residual_of(predict: Callable[[Array], Complex]) -> Callable[[Array], Array]:
        def residual(at: Array) -> Array:
            logs = np.log(measured / predict(at)) / sigma
            return np.concatenate([logs.real, logs.imag])

        return residual

    inertia = float(np.median(np.abs(1.0 / (omega * measured))))
    rigid_fit = residual_of(lambda at: _rigid(at, omega, beside))
    rigid = least_squares(
        rigid_fit,
        [math.log(inertia), 0.0, 0.0, *[0.0] * others],
        x_scale=[1.0, inertia, 1e-3, *[inertia] * others],
    )
    best = None
    fit = residual_of(lambda at: _two_masses(at, omega, beside))
    scale = [1.0, 1.0, 0.1, 1.0, inertia, 1e-3, *[inertia] * others]
    for antiresonance in np.geomspace(omega[0], omega[-1] / th.EDGE, th.RESONANCE_STARTS):
        for share in (0.2, 0.6):
            start = np.array(
                [
                    math.log((1.0 - share) * inertia),
                    math.log(share * inertia),
                    math.log(antiresonance),
                    math.log(0.03),
                    0.0,
                    0.0,
                    *rigid.x[3:],
                ]
            )
            tried = least_squares(fit, start, loss="soft_l1", max_nfev=12, x_scale=scale)
            if best is None or tried.cost < best.cost:
                best = tried
    assert best is not None
    best = least_squares(fit, best.x, x_scale=scale)
    freedom = max(2 * len(omega) - len(best.x), 1)
    variance = 2.0 * best.cost / freedom
    low, high = response.band_hz
    if 2.0 * (rigid.cost - best.cost) < th.RESONANCE_EVIDENT * max(variance, 1.0):
        return None, f"no resonance from {low:.3g} to {high:.3g} Hz, where the recording excites the axis"
    values, errors = _derived(
        best.x, _covariances(best.jac, fit(best.x), response, sigma), th.BETWEEN_LINES / response.window_s
    )
    load, total = values["load_inertia"], values["inertia"]
    weights = np.concatenate([sigma, sigma])
    misfit, of_one_mass = (float(np.sqrt(np.mean((each * weights) ** 2))) for each in (fit(best.x), rigid_fit(rigid.x)))
    is_inside = low < values["antiresonance_hz"] and values["resonance_hz"] * th.EDGE < high
    is_damped = th.LEAST_DAMPING < values["damping_ratio"] < th.MOST_DAMPING
    is_clear = all(errors[name] < most * values[name] for name, most in _LARGEST_ERRORS.items())
    explains = misfit < min(th.MOST_MISFIT, th.RESONANCE_FALL * of_one_mass)
    if not (is_inside and is_damped and is_clear and load > th.LEAST_LOAD * total and explains):
        return None, (
            f"the response from {low:.3g} to {high:.3g} Hz is neither that of one mass nor clearly that of two: a "
            "resonance beyond this band, backlash, losses of a gear or a third mass look so"
        )
    return Resonance(values, errors), ""


def two_mass_response(values: dict[str, float], frequency_hz: Array, beside: Complex | float = 0.0) -> Complex:
    """Return velocity over torque (m,) of fitted masses.

    ``values``: those of a `Resonance`. ``frequency_hz`` is (m,). ``beside``: (m,), torque of other axes that move with
    this one, over its velocity.
    """
    s = 2j * math.pi * frequency_hz
    spring = values["stiffness"] + s * values["damping"]
    load = s * values["load_inertia"]
    impedance = s * values["motor_inertia"] + values["viscous"] + load * spring / (spring + s * load) + beside
    return np.asarray(np.exp(-s * values["delay_s"]) ** -1 / impedance)


def _rigid(at: Array, omega: Array, beside: Complex) -> Complex:
    others = 1j * omega * (at[3:] @ beside)
    return np.asarray(np.exp(1j * omega * at[2]) / (1j * omega * math.exp(at[0]) + at[1] + others))


def _two_masses(at: Array, omega: Array, beside: Complex) -> Complex:
    return two_mass_response(_physical(at), omega / math.tau, 1j * omega * (at[6:] @ beside))


def _physical(at: Array) -> dict[str, float]:
    motor, load, omega, ratio = np.exp(np.clip(at[:4], -60.0, 60.0)).tolist()
    stiffness = load * omega**2
    return dict(
        zip(_NAMES, (motor, load, stiffness, 2.0 * ratio * stiffness / omega, float(at[4]), float(at[5])), strict=True)
    )


def _with_derived(at: Array) -> dict[str, float]:
    own = _physical(at)
    motor, load, stiffness = own["motor_inertia"], own["load_inertia"], own["stiffness"]
    resonance = math.sqrt(stiffness / load + stiffness / motor)
    return {
        **own,
        "inertia": motor + load,
        "antiresonance_hz": math.sqrt(stiffness / load) / math.tau,
        "resonance_hz": resonance / math.tau,
        "damping_ratio": 0.5 * own["damping"] / stiffness * resonance,
    }


def _derived(
    at: Array, covariances: Sequence[Array], between_lines: float
) -> tuple[dict[str, float], dict[str, float]]:
    """Return all values and their standard errors, linearised.

    The covariances add up; ``between_lines`` is the least error of a frequency, Hz.
    """
    values = _with_derived(at)
    covariance = np.sum(covariances, axis=0)
    scale = np.maximum(np.sqrt(np.diag(covariance)), 1e-12)
    steps = [1e-3 * size * np.eye(len(at))[i] for i, size in enumerate(scale)]
    sides = [(_with_derived(at + step), _with_derived(at - step)) for step in steps]
    errors = {}
    for name in values:
        slope = np.array(
            [(up[name] - down[name]) / (2e-3 * size) for (up, down), size in zip(sides, scale, strict=True)]
        )
        variance = max(float(slope @ covariance @ slope), 0.0)
        errors[name] = math.hypot(math.sqrt(variance), between_lines if name.endswith("_hz") else 0.0)
    return values, errors


def _covariances(jacobian: Array, residual: Array, response: FrequencyResponse, sigma: Array) -> tuple[Array, Array]:
    """Return the covariance of the parameters by scatter, and by mismatch.

    The first is that of a jackknife over windows, which knows that neighbouring lines are correlated. It is so large
    that a 90-% interval of a normal distribution is as wide as that of Student's with so few windows. The second takes
    the residual for what the form leaves out, which is alike over a whole band of frequencies.
    """
    from scipy.stats import norm, t  # imported here: commands that do not need it start faster

    few = float(t.ppf(0.95, response.windows - 1) / norm.ppf(0.95))
    changes = -np.linalg.pinv(jacobian)
    deviations = response.deviations[:, response.is_used] / sigma
    shifts = np.concatenate([deviations.real, deviations.imag], axis=1) @ changes.T
    frequency = response.frequency_hz[response.is_used]
    bands = np.floor(
        th.RESONANCE_BANDS * np.log(frequency / frequency[0]) / np.log(frequency[-1] / frequency[0] * (1.0 + 1e-9))
    )
    both = np.concatenate([bands, bands])
    order = np.argsort(both, kind="stable")
    starts = np.flatnonzero(np.diff(both[order], prepend=-1.0))
    return np.asarray(few**2 * shifts.T @ shifts), sandwich(jacobian[order], residual[order], starts)
