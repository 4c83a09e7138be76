"""Run all experiments with all models."""

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

from friction_hil import friction as models
from friction_hil.errors import UsageError
from friction_hil.study.circle import reversal
from friction_hil.study.closed_loop import hunting, stick_slip
from friction_hil.study.given_force import break_away_force, presliding
from friction_hil.study.given_motion import frictional_lag, static_curve, stress_strain, velocity_pulse
from friction_hil.study.result import ExperimentResult
from friction_hil.study.subjects import DEFAULT, StudySettings

SINGLE: dict[str, Callable[..., ExperimentResult]] = {
    "static_curve": static_curve,
    "velocity_pulse": velocity_pulse,
    "presliding": presliding,
    "stress_strain": stress_strain,
    "frictional_lag": frictional_lag,
    "break_away": break_away_force,
}
PAIRED: dict[str, Callable[..., ExperimentResult]] = {
    "stick_slip": stick_slip,
    "hunting": hunting,
    "reversal": reversal,
}

OnProgress = Callable[[str, float], None]
"""Receives the name of the finished experiment and the finished fraction of all work."""


@dataclass(frozen=True, slots=True)
class Study:
    """Results of all experiments."""

    models: tuple[str, ...]
    single: dict[str, dict[str, ExperimentResult]]  # experiments without a closed loop, by experiment and model
    # experiments with a closed loop, by experiment and pair: the model that acts, and the model that the compensator
    # assumes (None: no compensation)
    paired: dict[str, dict[tuple[str, str | None], ExperimentResult]]
    settings: StudySettings = DEFAULT

    @property
    def facts(self) -> dict[str, dict[str, float]]:
        """All numbers by model and name; the names end with the unit."""
        return {name: self._facts(name) for name in self.models}

    def _facts(self, name: str) -> dict[str, float]:
        facts: dict[str, float] = {}
        for results in self.single.values():
            facts.update(results[name].facts)
        for experiment, pairs in self.paired.items():
            without = pairs[name, None].facts
            facts.update({f"{experiment}_{fact}": value for fact, value in without.items()})
            for assumed in self.models:
                with_it = pairs[name, assumed].facts
                facts.update({f"{experiment}_{fact}_with_{assumed}": value for fact, value in with_it.items()})
        for assumed in self.models:
            before, after = (self.paired["reversal"][name, each].facts["peak_urad"] for each in (None, assumed))
            facts[f"reversal_reduction_by_{assumed}"] = before / after
        return facts


def check_names(names: Sequence[str] | None) -> tuple[str, ...]:
    """Return the models to study without repetitions; all models if ``names`` is None.

    Raises `UsageError`: a name is unknown, or the list is empty.
    """
    if names is None:
        return tuple(models.names())
    if not names:
        raise UsageError(f"no model is named; there are: {', '.join(models.names())}")
    return tuple(models.describe(name).name for name in dict.fromkeys(names))


def run(
    names: Sequence[str] | None = None,  # of the models; None: all
    # called after each experiment with each model or pair of models
    on_progress: OnProgress = lambda text, fraction: None,
    workers: int = 2,  # threads; the results do not depend on it
    settings: StudySettings = DEFAULT,
) -> Study:
    """Run all experiments.

    Raises `UsageError`: a name is unknown, or the list is empty.
    """
    chosen = check_names(names)
    single: dict[str, dict[str, ExperimentResult]] = {experiment: {} for experiment in SINGLE}
    paired: dict[str, dict[tuple[str, str | None], ExperimentResult]] = {experiment: {} for experiment in PAIRED}
    pairs = list(itertools.product(chosen, (None, *chosen)))
    done, whole = 0, len(SINGLE) * len(chosen) + len(PAIRED) * len(pairs)
    with ThreadPoolExecutor(workers) as pool:
        try:
            for experiment, one in SINGLE.items():
                for name, result in zip(chosen, pool.map(partial(one, given=settings), chosen), strict=True):
                    single[experiment][name] = result
                    done += 1
                    on_progress(experiment, done / whole)
            for closed_loop, two in PAIRED.items():
                apply = map if two is reversal else pool.map  # a Python loop holds the lock, so threads do not help
                results = apply(partial(two, given=settings), *zip(*pairs, strict=True))
                for pair, result in zip(pairs, results, strict=True):
                    paired[closed_loop][pair] = result
                    done += 1
                    on_progress(closed_loop, done / whole)
        except BaseException:
            pool.shutdown(cancel_futures=True)  # otherwise Ctrl-C would wait for all queued work
            raise
    return Study(chosen, single, paired, settings)
