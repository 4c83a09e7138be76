"""Motions of a trial: the axis's own, slow, small and tiny ones, strokes with rests, and the fastest. Pure."""

import math
from collections.abc import Mapping

from friction_hil.analysis.following import SETTLE_S
from friction_hil.config import Circle, ExperimentBounds, MotionSequence, SequencePart, Sine, Strokes, Triangle
from friction_hil.config.trajectories import PeriodicMotion, peak_speed
from friction_hil.daemon.assembly import periodic_path
from friction_hil.motion.experiment import LEAST_COUNTS
from friction_hil.motion.sequence import STROKE_ACCELERATION, STROKE_SPEED
from friction_hil.motion.trajectory import extent
from friction_hil.tuning import thresholds as th

MOTIONS = OWN, SLOW, SMALL, TINY, RESTS, FAST = "own", "slow", "small", "tiny", "rests", "fast"


def trial_motions(own: PeriodicMotion, bounds: ExperimentBounds, resolution: float) -> dict[str, PeriodicMotion]:
    """Return the motions of the trial of one axis by name, its own first.

    They stay within the stroke, the speed and the acceleration of the own motion or of the experiment, whichever allows
    more. A stroke that the encoder does not show is left out, and so is the fastest motion if it is the own one.
    ``own``: motion that the axis is for. ``resolution``: one count of the encoder, rad or m.
    """
    speed, amplitude, shown = peak_speed(own), amplitude_of(own), LEAST_COUNTS * resolution
    most = math.inf if bounds.acceleration is None else max(th.ACCELERATION * bounds.acceleration, _acceleration(own))
    per_speed, per_acceleration = _factors(own)
    frequency = own.frequency
    found: dict[str, PeriodicMotion] = {OWN: own}

    slowest_hz = max(frequency * th.SLOW_RATIO, th.SLOW_HZ)
    slow_hz = min(slowest_hz, most * per_speed / (per_acceleration * th.SLOW_RATIO * speed))
    slow = th.SLOW_RATIO * speed / (per_speed * slow_hz)
    if shown <= slow <= amplitude * (1.0 + 1e-9):
        found[SLOW] = _shaped(own, slow, slow_hz)

    small, tiny = th.SMALL_RATIO * amplitude, max(th.TINY_RATIO * amplitude, shown)
    for name, stroke, largest in ((SMALL, small, small), (TINY, tiny, 0.5 * small)):
        if shown <= stroke <= largest:
            fastest_hz = min(speed / (per_speed * stroke), math.sqrt(most / (per_acceleration * stroke)))
            found[name] = _shaped(own, stroke, min(max(frequency, th.SMALL_HZ), fastest_hz))

    room = max(th.TRAVEL * bounds.travel, extent(periodic_path(own), 1.0 / frequency)[1])
    stroke = min(0.5 * amplitude, room, speed * th.STROKE_S / STROKE_SPEED, most * th.STROKE_S**2 / STROKE_ACCELERATION)
    if stroke >= shown:
        cycle_s = 2.0 * (th.STROKE_S + th.BETWEEN_STROKES_S)
        found[RESTS] = Strokes(
            kind="strokes", stroke=stroke, frequency=1.0 / cycle_s, rest=2.0 * th.BETWEEN_STROKES_S / cycle_s
        )

    if (fast := _fastest(bounds)) is not None and peak_speed(fast) > th.FASTER * speed:
        found[FAST] = fast
    return found


def sequences(
    motions: Mapping[str, Mapping[str, PeriodicMotion]], ramp_s: float, fade_s: float, limits: Mapping[str, float]
) -> dict[str, MotionSequence]:
    """Return the sequence of each axis: all axes begin each of their motions at the same time.

    An axis whose motion takes less time makes more periods of it, then rests; one without a motion of a kind rests.

    ``motions``: from `trial_motions`, by axis. ``ramp_s``: in which all axes start and stop. ``fade_s``: in which the
    compensation fades in; the own motion goes on steadily after it. ``limits``: highest acceleration of the experiment
    by axis, SI; infinity for none.
    """
    names = [name for name in MOTIONS if any(name in each for each in motions.values())]
    parts: dict[str, list[SequencePart]] = {axis: [] for axis in motions}
    for name in names:
        first = {
            axis: _part(name, each[name], ramp_s, fade_s, limits[axis])
            for axis, each in motions.items()
            if name in each
        }
        end_s = max(part.moving_s for part in first.values())
        for axis, own in parts.items():
            if axis in first:
                own.append(_filling(first[axis], end_s))
            else:
                own[-1] = own[-1].model_copy(update={"rest_s": own[-1].rest_s + end_s + th.PAUSE_S})
    return {axis: MotionSequence(kind="sequence", motions=tuple(each), ramp_s=ramp_s) for axis, each in parts.items()}


def windows(sequence: MotionSequence, fade_s: float) -> dict[str, tuple[float, float]]:
    """Return the part of each motion by which a model is judged: begin and end in the time of the path, s.

    Of the own motion these are the last whole periods of steady motion, with the compensation faded in. Of the others
    it is everything, with start, stop and the pause after it.
    """
    found, begin_s = {}, 0.0
    for part in sequence.motions:
        if part.name == OWN:
            end_s = begin_s + part.length_s  # there it begins to stop
            period_s = 1.0 / part.motion.frequency
            periods = max(1, math.floor((part.length_s - _settled_s(part.ramp_s, fade_s)) / period_s + 1e-6))
            found[part.name] = (end_s - periods * period_s, end_s)
        else:
            found[part.name] = (begin_s, begin_s + part.moving_s + min(part.rest_s, th.PAUSE_S))
        begin_s += part.duration_s
    return found


def _settled_s(ramp_s: float, fade_s: float) -> float:
    """Return the time after the start from which on the own motion is steady and compensated, s."""
    return max(ramp_s, fade_s) + SETTLE_S


def _part(name: str, motion: PeriodicMotion, ramp_s: float, fade_s: float, acceleration: float) -> SequencePart:
    period_s = 1.0 / motion.frequency
    if name == OWN:
        steady_s = period_s * max(th.LEAST_PERIODS, math.ceil(th.STEADY_S / period_s - 1e-9))
        periods = math.ceil((_settled_s(ramp_s, fade_s) + steady_s) / period_s - 1e-9)
    elif name in (SMALL, TINY, FAST):
        least_s = th.FAST_S if name == FAST else th.SMALL_S
        periods = max(th.LEAST_PERIODS, math.ceil(least_s / period_s - 1e-9))
    else:
        periods = 1
    if name == RESTS:
        ramp_s = 0.0
    elif name == FAST or (name != OWN and 1.5 * peak_speed(motion) > th.ACCELERATION * acceleration * ramp_s):
        ramp_s = max(ramp_s, 0.5 * period_s)
    return SequencePart(name=name, motion=motion, periods=periods, ramp_s=ramp_s, rest_s=th.PAUSE_S)


def _filling(part: SequencePart, end_s: float) -> SequencePart:
    """Return a part with as many periods as fit until ``end_s``, and rest after them."""
    more = math.floor((end_s - part.moving_s) * part.motion.frequency + 1e-6)
    part = part.model_copy(update={"periods": part.periods + max(more, 0)})
    return part.model_copy(update={"rest_s": max(end_s - part.moving_s, 0.0) + th.PAUSE_S})


def _fastest(bounds: ExperimentBounds) -> Sine | None:
    """Return a sine as fast as the experiment allows, at the largest stroke that takes no longer than it must."""
    most = math.inf if bounds.acceleration is None else th.FAST_ACCELERATION * bounds.acceleration
    slowest, quickest = (math.tau * each for each in th.FAST_HZ)
    amplitude = min(th.TRAVEL * bounds.travel, bounds.velocity / slowest, most / slowest**2)
    speed = min(bounds.velocity, math.sqrt(most * amplitude), quickest * amplitude)
    return Sine(kind="sine", amplitude=amplitude, frequency=speed / (math.tau * amplitude), ramp_s=bounds.ramp_s)


def amplitude_of(motion: PeriodicMotion) -> float:
    """Return the largest distance of a motion from its middle, rad or m."""
    if isinstance(motion, Circle):
        return motion.radius
    return 0.5 * motion.stroke if isinstance(motion, Strokes) else motion.amplitude


def _factors(motion: PeriodicMotion) -> tuple[float, float]:
    """Return largest speed and acceleration of motions of this shape, for an amplitude and a frequency of 1."""
    if isinstance(motion, Triangle):
        return 4.0, 16.0 / motion.rounding
    if isinstance(motion, Strokes):
        quickness = 2.0 / (1.0 - motion.rest)  # strokes in the time of a period
        return 2.0 * STROKE_SPEED * quickness, 2.0 * STROKE_ACCELERATION * quickness**2
    return math.tau, math.tau**2


def _acceleration(motion: PeriodicMotion) -> float:
    return _factors(motion)[1] * amplitude_of(motion) * motion.frequency**2


def _shaped(own: PeriodicMotion, amplitude: float, frequency: float) -> PeriodicMotion:
    """Return the own motion in another size: where the axis begins, it has the same room to either side."""
    size = {"radius": amplitude} if isinstance(own, Circle) else {"amplitude": amplitude}
    if isinstance(own, Strokes):
        size = {"stroke": 2.0 * amplitude}
    return own.model_copy(update={**size, "frequency": frequency})
