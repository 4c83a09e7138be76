"""Learning of one axis: when it estimates, what it hands over, what it keeps and what it takes back.

Everything happens at ticks of a quarter of a second of rows, so that the same rows give the same decisions. A window of
the record refines the belief; where the compensation would change by it, it is handed over for a trial; the same
work before and after decides. Where parameters and gain together were no gain, the parameters are tried alone.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from friction_hil.daemon.learning_board import FamilyFigures, Report
from friction_hil.friction import FrictionModel
from friction_hil.friction.model import as_dict
from friction_hil.identification.least_squares import NUMERICAL
from friction_hil.learning import oddity
from friction_hil.learning import thresholds as th
from friction_hil.learning.estimate import Belief, Mechanics, first_belief, left_over, refine
from friction_hil.learning.families import Families
from friction_hil.learning.judge import CHANCE, Work, is_harmful, no_help, objection, rms
from friction_hil.learning.motions import Limit, Motions, Used
from friction_hil.learning.proposal import Proposal, Step, Trial
from friction_hil.learning.record import Record
from friction_hil.learning.residual import Residual
from friction_hil.learning.states import TRANSITIONS, Event, Halt, InForce, LearnerSettings, Seen, State
from friction_hil.learning.window import COLUMNS, joined
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import POSITION_UNITS, quantity


class Learner:
    """Learning of one axis.

    ``model``: that of the model file, without a network; ``standard_errors``: see `coordinates_of`.
    """

    def __init__(
        self,
        model: FrictionModel,
        mechanics: Mechanics,
        standard_errors: Mapping[str, float],
        settings: LearnerSettings,
    ) -> None:
        self._settings = settings
        self.belief: Belief = first_belief(model, mechanics, standard_errors)  # what is known now
        self._file = Used(self.belief.x, settings.gain, self.belief.coordinates)
        self._force, self._seen, self._halt = InForce(self._file, self._file, self._file), Seen(), Halt()
        self._motions = Motions(self._file, th.TRIAL_FIRST_PAUSE, settings.period_s)
        self.record = Record(settings.period_s, settings.resolution)
        self._state = State.WATCHING
        self._trial: Trial | None = None
        self._is_turn_of_layer = False  # parameters and layer take turns
        self._is_gain_doubted = False  # after a trial that was taken back: the next one keeps the gain
        self.figures = Report(gain=settings.gain, family=FamilyFigures(str(self._file.form), str(self._file.form)))
        self._residual = Residual(model, self.figures.residual_layer)
        self._families = Families(self.figures.family, self._file.form)
        self.notes: list[str] = []  # what is to be reported; whoever reports it removes it

    def pause(self, reason: str) -> Proposal | None:
        """Forget the rows so far, after some that are not to be learned from; return what is taken back therefore."""
        self.record.ticks.clear()
        self._motions.interrupt()
        self._seen.unused = self._force.ticks = 0
        if self._trial is None:
            return None
        return self._take_back(f"{reason}: nothing to compare with", is_harmless=True)

    def resume(self, parameters: Mapping[str, float], gain: float, model: Mapping[str, Any] | None = None) -> None:
        """Begin with parameters that were kept in an earlier run: they are handed over with the first motion.

        ``parameters``: by name; those of other names are ignored. ``gain`` is limited to what the configuration allows.
        ``model``: as `friction_hil.friction.model.as_dict` returns it, if it is of another family than the model file.
        Raises `UsageError`: there is no such model.
        """
        is_fixed = self._settings.is_gain_fixed or self._settings.gain > 1.0
        gain = self._settings.gain if is_fixed else min(max(gain, self._settings.gain), 1.0)
        if model is not None:
            self._force.resumed = replace(self._families.add(model, self.belief), gain=gain)
            return
        x = self.belief.x.copy()
        names = self.belief.coordinates.names
        x[: len(names)] = self.belief.coordinates.inverse(parameters)
        self.belief = replace(self.belief, x=x)
        self._force.resumed = Used(x, gain, self.belief.coordinates)

    @property
    def proven(self) -> tuple[dict[str, float], float, dict[str, Any] | None]:
        """Parameters by name, and gain, that were kept last; and the model where it is not of the file's family."""
        kept = self._force.kept
        return kept.parameters, kept.gain, None if kept.coordinates is self._file.coordinates else as_dict(kept.own)

    @property
    def in_use(self) -> dict[str, float]:
        """Parameters by name that the compensator has."""
        return self._force.used.parameters

    @property
    def wanted(self) -> tuple[dict[str, float], float]:
        """The same, and the gain, once all of what is on trial is handed over."""
        used = self._force.used if self._trial is None else self._trial.tried
        return used.parameters, used.gain

    @property
    def doing(self) -> tuple[str, str]:
        """What learning does now: ``watching``, ``trying``, ``resting`` or ``stopped``; and why, empty for watching."""
        if self._state is State.STOPPED:
            return "stopped", self._halt.why
        if self._trial is not None:
            return "trying", self._trial.text
        rest_s = self._motions.now.rest * th.WINDOW_TICKS * th.TICK_S
        return self._state.value, f"no further change within {rest_s:g} s of motion" if rest_s else ""

    @property
    def has_trial(self) -> bool:
        """True if something that is not proven is in force."""
        return self._trial is not None or self._force.owed is not None

    def refuse(self) -> None:
        """Take note that the last proposal was not handed over; what is in force unproven is taken back next."""
        back = (
            self._trial.former
            if self._trial is not None
            else self._force.used
            if self._force.is_back
            else self._force.former
        )
        self._force.owed = None if back is self._force.former else back
        if self._trial is None and self._force.owed is None:
            self._motions.now.used = self._force.former
        if not self._note_refused(self._trial, self._force.former, "refused"):
            self._wait(math.inf)
        if self._trial is not None:
            self._go(Event.TAKEN_BACK)
        self._use(self._force.former)

    def take(
        self, rows: Mapping[str, Array], *, is_in_force: bool = True, may_estimate: bool = True
    ) -> Proposal | None:
        """Take the rows of a tick, `COLUMNS`; return what is to be handed over, which then counts as handed over.

        They are older than the last change unless ``is_in_force``. Unless ``may_estimate``, the next estimate waits.
        """
        tick = {name: np.asarray(rows[name]) for name in COLUMNS}
        self.belief = self.belief.older(th.DRIFT, th.TICK_S)
        recent = [*list(self.record.ticks)[1 - th.FROZEN_TICKS :], tick]
        if (reason := oddity.broken(joined(recent), self.belief.coordinates.model.level)) is not None:
            return self._stop(reason)
        if self._motions.take(tick["position_demand"], tick["velocity_demand"]):
            return self._change_motion()
        own = None if self._seen.estimate is None else replace(self._force.used, x=self.belief.x)
        if reason := self.record.oddity(tick, self._ticks_settled, own, self.belief, self._seen.usual):
            return self._stop(reason)
        self.record.ticks.append(tick)
        self._seen.unused += 1
        self._force.ticks += is_in_force
        if self._force.resumed is not None and np.any(tick["velocity_demand"]):
            self._motions.now.used = self._force.kept = self._force.resumed
            self._force.resumed = None
            return self._hand_over(Step.PARAMETERS, self._force.kept, "parameters that were kept in an earlier run")
        if self._force.owed is not None:
            return self._hand_over(Step.BACK, self._force.owed, "what came after it was refused")
        if (proposal := self._fall_back()) is not None:
            return proposal
        if self._state is State.STOPPED:
            self._halt.ticks -= 1
            if not self._halt.ticks:
                self._go(Event.OVER)
            return None
        if is_in_force and self._trial is not None and (proposal := self._judge(self._trial)) is not None:
            return proposal
        # not during a trial, which nobody would take back meanwhile
        if self._trial is None and self._seen.unused >= th.WINDOW_TICKS and may_estimate:
            self._refine()
            if self._force.ticks >= th.WINDOW_TICKS and self._motions.now.ranges is not None:
                before = self.record.work(self._ticks_settled)
                both = (self._propose, self._propose_layer)[:: -1 if self._is_turn_of_layer else 1]
                return both[0](before) or both[1](before) or self._propose_family(before)
        return None

    @property
    def _ticks_settled(self) -> int:
        """Ticks with what is in force whose errors count."""
        return self._force.ticks - self._settings.fade_ticks - th.SETTLING_TICKS

    def _is_seen(self, before: Work) -> bool:
        """Return True if a lower error would be seen."""
        return before.is_moving and before.rms >= th.LEAST_COUNTS * self.record.resolution

    def _go(self, event: Event) -> None:
        """Go to the next state, with which a trial may end."""
        self._state = TRANSITIONS[self._state, event]
        if self._state not in (State.THIRD, State.WHOLE):
            self._trial = None
        self._settle()

    def _settle(self) -> None:
        """Rest while the present motion has to wait for a trial, and no longer."""
        is_waiting = self._motions.now.rest > 0
        if self._state is (State.WATCHING if is_waiting else State.RESTING):
            self._go(Event.WAITS if is_waiting else Event.WAITED)

    def _size(self, length: float) -> str:
        """Return a position or an error in words."""
        return quantity(length, POSITION_UNITS[self.belief.coordinates.model.axis])

    def _refine(self) -> None:
        """Refine the belief by the last window."""
        self._seen.unused, self._seen.finding = 0, None
        warm_s = self.record.warm_s
        if not any(np.any(tick["velocity_demand"]) for tick in self.record.ticks):
            return
        window = self.record.window(self._force.used.layer, self.belief.model)
        if self._settings.has_families:
            self._families.look(window, self.belief, self.record.resolution, warm_s)
        try:
            found = refine(window, self.belief, self.record.resolution, warm_s, self._seen.residual)
        except NUMERICAL:
            return
        self._seen.estimate, self.belief, self._seen.residual = found, found.belief, found.residual
        self._seen.usual = rms(
            self.record.unexplained(replace(self._force.used, x=self.belief.x), self.belief)[th.WARM_TICKS :]
        )
        self.figures.relative_errors = self.belief.errors
        if self._settings.has_layer:
            left = left_over(self.record.window(), self.belief, self.record.resolution, warm_s)
            self._seen.finding = self._residual.look(left, self._force.used.layer)

    def _propose(self, before: Work) -> Proposal | None:
        """Return parameters or a gain that are worth a trial."""
        if self._seen.estimate is None:
            return None
        level, now = self.belief.coordinates.model.level, self._motions.now
        refined = self.belief.shown(self._force.used.x)
        other = replace(self._force.used, x=refined)
        is_waiting = bool(now.rest) and before.rms <= th.WORSE_ERROR * now.refused_error
        if is_waiting and now.refused is not None:  # what else would be tried is due to friction that has changed
            is_waiting = (
                not rms(np.subtract(*self.record.torques(now.refused, other))) > th.OTHER_FRICTION_LEVEL * level
            )
        now.rest = now.rest - 1 if is_waiting else 0
        self._settle()
        if is_waiting or not self._is_seen(before):
            return None
        present, next_one = self.record.torques(self._force.used, other)
        change, decline = rms(next_one - present) / level, 1.0 - rms(next_one) / rms(present)
        falls = decline if decline > th.FALLS and not self._force.used.has_model_of(self._file) else 0.0
        gain = self._next_gain(now.highest_gain(rms(next_one)), falls)
        is_other = change > th.WORTH
        if not is_other and abs(gain - self._force.used.gain) <= th.GAIN_WORTH:
            self._is_gain_doubted = False
            return None
        tried = replace(self._force.used, x=refined if is_other else self._force.used.x, gain=gain)
        # more torque than the friction will be makes an axis swing, which the torque of now does not show
        is_less = falls > 0.0 or not (is_other or gain > self._force.used.gain)
        if not is_less and not self.record.promises(
            self.belief, replace(tried, gain=max(gain, self._force.used.gain)), self._force.used
        ):
            self._is_gain_doubted = False
            return None
        words = [f"torque changes by {100.0 * change:.1f} % of the friction level"] * is_other
        gains = f"{self._force.used.gain:.2f}", f"{gain:.2f}"
        words += [f"gain {gains[0]} -> {gains[1]}"] * (gains[0] != gains[1])
        return self._try(Step.PARAMETERS if is_other else Step.GAIN, tried, before, ", ".join(words))

    def _next_gain(self, highest: float, falls: float) -> float:
        """Return the gain to go on with: the less, the less is known of the torque.

        At least that of the configuration, and 1 at most: more than the friction would drive the axis. Less where the
        known one was no help to this motion, ``highest``, or where friction falls: until the next change it will have
        fallen by as much as since the last one, ``falls``.
        """
        if self._settings.is_gain_fixed:
            return self._force.used.gain
        if self._is_gain_doubted:
            return max(self._force.used.gain - th.LESS_GAIN, self._settings.gain)
        assert self._seen.estimate is not None
        doubt = math.hypot(self._seen.estimate.torque_error, self._seen.estimate.model_error)
        known = max(min(1.0 - th.GAIN_DOUBT * doubt / self.belief.coordinates.model.level, 1.0), self._settings.gain)
        return max(min(known, highest) - falls, self._settings.gain)

    def _propose_layer(self, before: Work) -> Proposal | None:
        """Return a residual layer that is worth a trial, or the end of one that explains nothing any more."""
        found = self._seen.finding
        if found is None:
            return None
        if self._force.used.layer is not None and found.is_spent:
            self._residual.end()
            self._motions.now.used = replace(self._force.used, layer=None)
            return self._hand_over(Step.BACK, self._motions.now.used, "the residual layer explains nothing any more")
        if not (self._residual.is_worth(found, self._force.used.layer) and self._is_seen(before)):
            return None
        tried = replace(self._force.used, layer=found.layer)
        if found.x is not None:
            tried = replace(tried, x=replace(self.belief, x=found.x).shown(self._force.used.x))
            if not self.record.promises(self.belief, tried, self._force.used):
                return None
        self._residual.was_tried(found, self._force.used.layer, before.rms)
        return self._try(Step.LAYER, tried, before, found.text)

    def _propose_family(self, before: Work) -> Proposal | None:
        """Return a model of another family that is worth a trial, with the present gain."""
        best = self._families.best(self._force.used.form)
        if best is None or not self._is_seen(before):
            return None
        self._families.was_tried(best.form, before.rms)
        tried = replace(best, gain=self._force.used.gain, layer=self._force.used.layer)
        return self._try(Step.FAMILY, tried, before, self._families.reason(best.form, self._force.used.form))

    def _try(self, step: Step, tried: Used, before: Work, text: str) -> Proposal:
        self._trial = Trial(
            step, tried, before, self._force.used, self.record.left(self.belief, self._force.used)[0], text
        )
        self._go(Event.PROPOSED)
        self._is_turn_of_layer = step is not Step.LAYER
        if self.figures.error_before is None:
            self.figures.error_before = before.rms
        return self._hand_over(step, self._force.used.towards(tried, th.FIRST_PART), text)

    def _hand_over(self, step: Step, to: Used, text: str) -> Proposal:
        self._force.former, self._force.owed, self._force.is_back = self._force.used, None, step is Step.BACK
        model = None if to.has_model_of(self._force.used) else to.model
        self._use(to)
        return Proposal(step, model, to.gain, text)

    def _use(self, to: Used) -> None:
        """Take note of what the compensator has; what is known of parameters is then that of its family."""
        if to.coordinates is not self.belief.coordinates:
            self.belief, self._seen.estimate = self._families.swap(self.belief, to.coordinates), None
        self._force.used, self._force.ticks = to, 0
        self.figures.gain, self.figures.family.in_use = to.gain, str(to.form)

    def _judge(self, trial: Trial) -> Proposal | None:
        """Look at a trial: it goes on, or it is kept, or it is taken back."""
        ticks = self._force.ticks
        # a family comes as a whole: a drive's integrator has to give way to levels that differ between the directions
        unjudged = self._settings.fade_ticks + th.UNJUDGED_TICKS if trial.step is Step.FAMILY else th.UNJUDGED_TICKS
        error = self.record.errors(max(ticks - unjudged, 1))
        if ticks > unjudged and is_harmful(error, trial.before, self.record.resolution, self.record.period_s):
            return self._take_back(f"the error rose from {self._size(trial.before.rms)} to {self._size(rms(error))}")
        if np.any(np.diff(self.record.rows(2)["gain_factor"]) < 0.0):
            return self._take_back("a limit cycle")
        if self._state is State.THIRD:
            if ticks < self._settings.fade_ticks + th.FIRST_TICKS:
                return None
            if (both := no_help(error, self.record.expected(self.belief, trial), self.record.period_s)) is not None:
                shown, part = " -> ".join(map(self._size, both)), "a third of " * (trial.step is not Step.FAMILY)
                return self._take_back(f"error {shown} with {part}the change")
            self._go(Event.HARMLESS)
            if trial.step is Step.FAMILY:  # there is nothing between two families: the whole has been in force
                return None
            return self._hand_over(trial.step, trial.tried, "the whole of a change of which a third did no harm")
        if self._ticks_settled < th.WINDOW_TICKS:
            return None
        after = self.record.work(self._ticks_settled)
        if not after.is_like(trial.before):
            return self._take_back("the motion changed: nothing to compare with", is_harmless=True)
        expected = self.record.expected(self.belief, trial)
        why = objection(after, expected, self.record.resolution)
        shown = f"{self._size(trial.before.rms)} -> {self._size(after.rms)}"
        if expected is not trial.before:
            shown += f" (without the change {self._size(expected.rms)} by now)"
        if why and not (why == CHANCE and self.record.explains_more(self.belief, trial.tried, trial.former)):
            return self._take_back(f"error {shown}: {why}")
        self._go(Event.KEPT)
        self._force.kept = trial.tried
        self._motions.keep(trial.tried)
        if self._is_gain_doubted and trial.tried.gain < trial.former.gain - th.GAIN_WORTH:
            self._motions.now.limit = Limit(trial.tried.gain, rms(self.record.torques(trial.tried)[0]))
        self._is_gain_doubted = False
        if trial.step is Step.LAYER:
            self._residual.was_kept(trial.tried.layer, after.rms)
        if trial.step is Step.FAMILY:
            self._families.was_kept(trial.tried.form, after.rms)
        self.figures.re_identified += trial.step is Step.PARAMETERS
        self.figures.error_after = after.rms
        words = f"family {trial.tried.form}" if trial.step is Step.FAMILY else trial.step.value
        self.notes.append(f"learning keeps the {words}: error {shown}")
        return None

    def _take_back(self, reason: str, *, is_harmless: bool = False) -> Proposal:
        if (trial := self._trial) is not None:
            self._go(Event.TAKEN_BACK)
        why = "without a verdict" if is_harmless else "no gain"
        if not self._note_refused(trial, self._motions.now.used, why) and not is_harmless:
            assert trial is not None
            self.figures.taken_back += 1
            self._is_gain_doubted = not self._is_gain_doubted
            self._wait(trial.before.rms, trial.tried)
        return self._hand_over(Step.BACK, self._motions.now.used, reason)

    def _note_refused(self, trial: Trial | None, stays: Used, why: str) -> bool:
        """Tell layer or families why their trial was no gain; return False if it was not theirs."""
        if trial is not None and trial.step is Step.LAYER:
            self._residual.was_refused(stays.layer, why)
        elif trial is not None and trial.step is Step.FAMILY:
            self._families.was_refused(trial.tried.form, why)
        else:
            return False
        return True

    def _wait(self, error: float, refused: Used | None = None) -> None:
        """Leave the present motion without a trial for a while, longer each time, or until error or friction change."""
        now = self._motions.now
        now.rest, now.pause = now.pause, min(th.LONGER * now.pause, th.TRIAL_LONGEST_PAUSE)
        now.refused_error, now.refused = error, refused
        self._settle()

    def _change_motion(self) -> Proposal | None:
        """Go on with what is proven for the present motion, which is another one: the model file where nothing is."""
        now = self._motions.now
        self._note_refused(self._trial, now.used, "without a verdict")
        if self._trial is not None:
            self._go(Event.TAKEN_BACK)
        self._settle()
        self._seen.estimate, self._is_gain_doubted = None, False
        self._residual.changed_motion(now.used.layer)
        self.record.ticks.clear()
        self._seen.unused = self._force.ticks = 0
        step, text = Step.KNOWN, "what was kept for this motion"
        if now.used is self._file:
            step, text = Step.BACK, "another motion, for which nothing is proven yet"
        proposal = None if now.used is self._force.used else self._hand_over(step, now.used, text)
        self._families.change_motion()
        return proposal

    def _stop(self, reason: str) -> Proposal | None:
        """Stop learning for a while: what was recorded so far is not of the axis as it is now."""
        if self._state is not State.STOPPED:
            self.figures.stopped += 1
            self.notes.append(f"learning stops for {th.STOPPED_TICKS * th.TICK_S:g} s: {reason}")
        self._halt.ticks, self._halt.why, self._seen.unused = th.STOPPED_TICKS, reason, 0
        self.record.ticks.clear()
        self._motions.interrupt()
        self._seen.estimate = None
        self.belief = self.belief.doubted()
        self._families.doubt()
        if is_layered := self._motions.drop_layers():  # their phase is lost where the position has jumped
            self._residual.end()
        is_back = is_layered or self._trial is not None
        proposal = self._take_back(reason, is_harmless=True) if is_back else None
        self._go(Event.ODD)
        return proposal

    def _fall_back(self) -> Proposal | None:
        """Return to the model file where that explains the torque clearly better than what was kept elsewhere."""
        if (
            self._trial is not None
            or self._force.used.has_model_of(self._file)
            or len(self.record.ticks) < th.WARM_TICKS + 1
        ):
            return None
        ticks = list(self.record.ticks)[-th.WARM_TICKS - 1 :]
        used, file = (self.record.unexplained(each, self.belief, ticks)[-1] for each in (self._force.used, self._file))
        level = self.belief.coordinates.model.level
        self._seen.misled = self._seen.misled + 1 if used > th.MISLED * file + th.MISLED_LEVEL * level else 0
        if self._seen.misled < th.MISLED_TICKS:
            return None
        if self._force.used.layer is not None:
            self._residual.end()
        self._seen.misled, self._motions.now.used = 0, self._file
        return self._hand_over(Step.BACK, self._file, "the model file explains the torque of this motion better")
