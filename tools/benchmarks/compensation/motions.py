"""The demanded motions: position with its exact first and second derivative, at any time."""

import math
from typing import Literal, Self

import numpy as np
from pydantic import model_validator

from friction_hil.checked_yaml.messages import refuse
from friction_hil.checked_yaml.section import Section, key
from friction_hil.numerics.jit import Array

# Position (rad), velocity and acceleration, each (n,)
Kinematics = tuple[Array, Array, Array]

_HARMONICS = np.array([1.0, 2.0, 3.0, 5.0, 7.0])
_RAMP_S = 0.5  # a multi-sine is faded in, because it begins with a jump of velocity
_OWN_KEYS = {"corner": "triangle", "rest": "dwell"}


class GridMotion(Section):
    """A motion that starts at rest at zero; all but the multi-sine lie between 0 and twice the amplitude."""

    kind: Literal["cosine", "multisine", "triangle", "dwell"] = key(
        "cosine: amplitude (1 - cos 2 pi f t); multisine: harmonics 1, 2, 3, 5, 7 of f with random phases, at most "
        "the amplitude in sum; triangle: constant speed with rounded corners; dwell: moves with rests between",
        default="cosine",
    )
    amplitude: float = key("half the stroke", "rad", gt=0)
    frequency: float = key("of the whole cycle, there and back", "Hz", gt=0, le=100)
    corner: float | None = key("fraction of the cycle in which a triangle reverses (0.1)", default=None, gt=0, le=1)
    rest: float | None = key("fraction of the cycle in which a dwell rests (0.5)", default=None, ge=0, lt=1)

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(
            self,
            (
                ((name,), f"belongs to kind: {kind}; a {self.kind} has none")
                for name, kind in _OWN_KEYS.items()
                if getattr(self, name) is not None and self.kind != kind
            ),
        )
        return self

    @property
    def name(self) -> str:
        """Name in tables and JSON."""
        kind = "" if self.kind == "cosine" else f"{self.kind} "
        own = "".join(f" {name} {getattr(self, name):g}" for name in _OWN_KEYS if getattr(self, name) is not None)
        return f"{kind}{self.amplitude:g} rad {self.frequency:g} Hz{own}"

    def at(self, t: Array, seed: int) -> Kinematics:
        """Return position, velocity and acceleration at the times ``t``, (n,), s, not negative."""
        if self.kind == "multisine":
            return _multisine(self.amplitude, self.frequency, t, seed)
        if self.kind == "triangle":
            return _triangle(self.amplitude, self.frequency, 0.1 if self.corner is None else self.corner, t)
        if self.kind == "dwell":
            return _dwell(self.amplitude, self.frequency, 0.5 if self.rest is None else self.rest, t)
        w = math.tau * self.frequency
        a = self.amplitude
        return a * (1.0 - np.cos(w * t)), a * w * np.sin(w * t), a * w * w * np.cos(w * t)


def _smooth_step(u: Array) -> Kinematics:
    """Return 10 u^3 - 15 u^4 + 6 u^5, the minimum-jerk step from 0 to 1, and its derivatives in u."""
    u = np.clip(u, 0.0, 1.0)
    rest = 1.0 - u
    return u**3 * (10.0 - 15.0 * u + 6.0 * u * u), 30.0 * (u * rest) ** 2, 60.0 * u * rest * (1.0 - 2.0 * u)


def _multisine(amplitude: float, frequency: float, t: Array, seed: int) -> Kinematics:
    """Return harmonics of equal velocity amplitude, faded in: q = s(t) x(t)."""
    w = math.tau * frequency * _HARMONICS[:, np.newaxis]
    weight = amplitude / _HARMONICS / np.sum(1.0 / _HARMONICS)
    angle = w * t + np.random.default_rng(seed).uniform(0.0, math.tau, w.shape)
    x, dx, ddx = weight @ np.sin(angle), weight @ (w * np.cos(angle)), weight @ (-w * w * np.sin(angle))
    s, ds, dds = _smooth_step(t / _RAMP_S)
    ds, dds = ds / _RAMP_S, dds / _RAMP_S**2
    return s * x, ds * x + s * dx, dds * x + 2.0 * ds * dx + s * ddx


def _there_and_back(frequency: float, t: Array) -> tuple[Array, Array]:
    """Return the time since the last reversal, s, and the direction: forward (1) or back (-1)."""
    half = 0.5 / frequency
    halves = np.floor(t / half)
    return t - halves * half, np.where(halves % 2.0 == 0.0, 1.0, -1.0)


def _triangle(amplitude: float, frequency: float, corner: float, t: Array) -> Kinematics:
    """Return a motion of constant speed with rounded corners, in which the velocity is a sine."""
    half, length = 0.5 / frequency, 0.5 * corner / frequency
    rounded = 2.0 * length / math.pi  # path of the two half corners of a stroke, divided by the speed
    speed = 2.0 * amplitude / (half - length + rounded)
    w = math.pi / length
    since, direction = _there_and_back(frequency, t)
    into = np.minimum(since, 0.5 * length)
    out = np.maximum(since - (half - 0.5 * length), 0.0)
    straight = np.clip(since - 0.5 * length, 0.0, half - length)
    path = speed * ((1.0 - np.cos(w * into)) / w + straight + np.sin(w * out) / w)
    velocity = speed * np.where(out > 0.0, np.cos(w * out), np.sin(w * into))
    acceleration = speed * w * np.where(out > 0.0, -np.sin(w * out), np.cos(w * into))
    return np.where(direction > 0.0, path, 2.0 * amplitude - path), direction * velocity, direction * acceleration


def _dwell(amplitude: float, frequency: float, rest: float, t: Array) -> Kinematics:
    """Return minimum-jerk moves, each followed by a rest."""
    length = 0.5 * (1.0 - rest) / frequency
    since, direction = _there_and_back(frequency, t)
    s, ds, dds = _smooth_step(since / length)
    stroke = 2.0 * amplitude
    position = np.where(direction > 0.0, stroke * s, stroke * (1.0 - s))
    return position, direction * stroke * ds / length, direction * stroke * dds / length**2
