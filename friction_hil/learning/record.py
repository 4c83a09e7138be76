"""The latest rows of an axis, in ticks: what they show of its work, and of compensations that it has or might have."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

from friction_hil.friction import FrictionModel
from friction_hil.learning import oddity
from friction_hil.learning import thresholds as th
from friction_hil.learning.estimate import Belief, Uncompensated, uncompensated
from friction_hil.learning.judge import Work, rms, work_of
from friction_hil.learning.layer import Layer
from friction_hil.learning.motions import Used
from friction_hil.learning.proposal import Trial
from friction_hil.learning.window import Window, errors_of, joined, velocity_of, window_of
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import POSITION_UNITS, quantity


class Record:
    """Rows of the last window, and those before that bring a model's state to where it was."""

    def __init__(self, period_s: float, resolution: float) -> None:
        self.period_s, self.resolution = period_s, resolution  # step of the position, rad or m
        # rows of each, `friction_hil.learning.window.COLUMNS`
        self.ticks: deque[dict[str, Array]] = deque(maxlen=th.WARM_TICKS + th.WINDOW_TICKS)

    @property
    def rows_per_tick(self) -> int:
        """Number of rows of a tick."""
        return round(th.TICK_S / self.period_s)

    @property
    def warm_s(self) -> float:
        """Beginning of the record that only brings the model's state to where it was, s."""
        return th.TICK_S * (len(self.ticks) - th.WINDOW_TICKS if len(self.ticks) > th.WINDOW_TICKS else 2)

    def rows(self, ticks: int) -> dict[str, Array]:
        """Return the rows of the last ticks, one after the other."""
        return joined(list(self.ticks)[-ticks:])

    def window(self, layer: Layer | None = None, model: FrictionModel | None = None) -> Window:
        """Return the motion, and the torque without that of a layer on a model."""
        window = window_of(joined(list(self.ticks)), self.period_s)
        if layer is None or model is None:
            return window
        velocity = velocity_of(window, self.resolution)
        friction = [each.simulate(velocity, self.period_s, **window.inputs()) for each in (layer.on(model), model)]
        return replace(window, torque=window.torque - (friction[0] - friction[1]))

    def work(self, settled: int) -> Work:
        """Return what the last window shows; of its errors, those of the last ``settled`` ticks, one at least."""
        rows = self.rows(th.WINDOW_TICKS)
        error = self.errors(min(max(settled, 1), th.WINDOW_TICKS))
        return work_of(error, rows["position_demand"], rows["velocity_demand"], rows["compensation"], self.period_s)

    def errors(self, ticks: int) -> Array:
        """Return the following errors of the last ticks, (k,), rad or m, without those of missed periods."""
        return errors_of(self.rows(ticks))

    def torques(self, *compensations: Used) -> list[Array]:
        """Return the friction torques (n,) of models without their layers, N m."""
        window = self.window()
        velocity = velocity_of(window, self.resolution)
        return [each.own.simulate(velocity, self.period_s, **window.inputs()) for each in compensations]

    def left(self, belief: Belief, *compensations: Used) -> list[Uncompensated]:
        """Return the friction that each would have left in the last window."""
        models = [(each.model, each.gain) for each in compensations]
        return uncompensated(self.window(), belief, self.resolution, models, self.warm_s)

    def promises(self, belief: Belief, tried: Used, in_use: Used) -> bool:
        """Return True if a change would have left less of the friction in the last window than what is in use.

        A truer model may leave a little more with its gain: what a drive cannot correct is the part that changes fast.
        White noise of the torque feedback is left by both, and hides no difference.
        """
        whole = replace(tried, gain=1.0), replace(in_use, gain=1.0)
        after, before, true_after, true_before = (each.lasting for each in self.left(belief, tried, in_use, *whole))
        return after < th.HELPS * before or (true_after < th.HELPS * true_before and after < th.MORE_LEFT * before)

    def expected(self, belief: Belief, trial: Trial) -> Work:
        """Return what the axis would have done meanwhile without a trial, where friction has drifted.

        The more of the friction the former compensation would leave now, the larger its error would be. Only what is in
        proportion to the friction shows drift: the rest depends on how the axis moves with what is tried.
        """
        size, _, lack = trial.left  # with its noise: the less of it is friction, the less is a difference
        lack_now = self.left(belief, trial.former)[0].lack
        drifted = math.sqrt(max(size**2 - lack**2, 0.0) + lack_now**2) / size
        if abs(drifted - 1.0) <= th.STEADY_DRIFT:
            return trial.before
        return trial.before.scaled(min(max(drifted, 1.0 / th.MOST_DRIFTED), th.MOST_DRIFTED))

    def explains_more(self, belief: Belief, tried: Used, former: Used) -> bool:
        """Return True if a trial explains the torque since then, which it was not estimated from, clearly better.

        Where friction drifts, the error with the former parameters would have risen meanwhile: no gain over before may
        be one over what would be now.
        """
        left = [rms(self.unexplained(each, belief)[th.WARM_TICKS :]) for each in (tried, former)]
        return left[0] < th.EXPLAINS * left[1]

    def unexplained(self, used: Used, belief: Belief, ticks: Sequence[Mapping[str, Array]] | None = None) -> Array:
        """Return the root mean square of each tick's torque (n,) that a model leaves unexplained, N m.

        Of ``belief`` the mechanics count. ``ticks``: all by default.
        """
        given = list(self.ticks) if ticks is None else ticks
        return oddity.unexplained(used, given, belief, self.period_s, self.resolution)

    def oddity(self, tick: Mapping[str, Array], settled: int, own: Used | None, belief: Belief, usual: float) -> str:
        """Return why an axis is not what it was in the same motion; empty if it is.

        ``tick``: the next one. ``settled``: ticks of the record with the present compensation. ``own``: what explains
        the torque best; None before the first estimate. ``usual``: torque that it left unexplained, N m.
        """
        if len(self.ticks) < th.WARM_TICKS:
            return ""
        past = list(self.ticks)
        is_known = len(past) >= th.WINDOW_TICKS
        if jump := oddity.jump(joined(past), tick, self.resolution, is_known=is_known):
            return f"the position jumps by {quantity(jump, POSITION_UNITS[belief.coordinates.model.axis])}"
        same = [*past[-settled:], tick] if settled > 0 else []
        if times := oddity.follows_otherwise(same, self.resolution, self.period_s):
            return (
                f"the following error is {times:.2g} times what it was, in the same motion with the same compensation"
            )
        if own is not None:
            left = self.unexplained(own, belief, [*past[-th.WARM_TICKS :], tick])
            if oddity.is_other_axis(left, usual, belief.coordinates.model.level):
                return "the torque is not that of the model any more"
        return ""
