"""All experiments with all models."""

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from friction_hil import friction as models
from friction_hil.errors import UsageError
from friction_hil.study.circle import reversal
from friction_hil.study.closed_loop import hunting, stick_slip
from friction_hil.study.given_force import break_away_force, presliding
from friction_hil.study.given_motion import frictional_lag, static_curve, stress_strain, velocity_pulse
from friction_hil.study.outcome import Outcome

SINGLE: dict[str, Callable[[str], Outcome]] = {
    "static_curve": static_curve,
    "velocity_pulse": velocity_pulse,
    "presliding": presliding,
    "stress_strain": stress_strain,
    "frictional_lag": frictional_lag,
    "break_away": break_away_force,
}
PAIRED: dict[str, Callable[[str, str | None], Outcome]] = {
    "stick_slip": stick_slip,
    "hunting": hunting,
    "reversal": reversal,
}

Tell = Callable[[str, float], None]
"""Takes what has been done, and the share of the whole that is done."""


@dataclass(frozen=True, slots=True)
class Study:
    """What all experiments gave.

    Attributes
    ----------
    models : tuple of str
    single : dict of dict of Outcome
        By experiment and model: those without a closed loop.
    paired : dict of dict of Outcome
        By experiment and pair: the model that acts, and the one that compensates it (None: no compensation).
    """

    models: tuple[str, ...]
    single: dict[str, dict[str, Outcome]]
    paired: dict[str, dict[tuple[str, str | None], Outcome]]

    @property
    def facts(self) -> dict[str, dict[str, float]]:
        """Every number by model and name; names end in the unit."""
        return {name: self._facts(name) for name in self.models}

    def _facts(self, name: str) -> dict[str, float]:
        facts: dict[str, float] = {}
        for outcomes in self.single.values():
            facts.update(outcomes[name].facts)
        for experiment, pairs in self.paired.items():
            without = pairs[name, None].facts
            facts.update({f"{experiment}_{fact}": value for fact, value in without.items()})
            for believed in self.models:
                with_it = pairs[name, believed].facts
                facts.update({f"{experiment}_{fact}_with_{believed}": value for fact, value in with_it.items()})
        for believed in self.models:
            before, after = (self.paired["reversal"][name, each].facts["peak_urad"] for each in (None, believed))
            facts[f"reversal_reduction_by_{believed}"] = before / after
        return facts


def check_names(names: Sequence[str] | None) -> tuple[str, ...]:
    """Return the models to study, each once; all when None.

    Raises
    ------
    UsageError
        No model has that name, or none is named.
    """
    if names is None:
        return tuple(models.names())
    if not names:
        raise UsageError(f"no model is named; there are: {', '.join(models.names())}")
    return tuple(models.describe(name).name for name in dict.fromkeys(names))


def run(names: Sequence[str] | None = None, tell: Tell = lambda text, share: None, workers: int = 2) -> Study:
    """Run all experiments.

    Parameters
    ----------
    names : sequence of str, optional
        Models, each once; all when not given.
    tell : callable, optional
        Told after each piece of work.
    workers : int
        Threads; the numbers do not depend on it.

    Raises
    ------
    UsageError
        No model has that name.
    """
    chosen = check_names(names)
    single: dict[str, dict[str, Outcome]] = {experiment: {} for experiment in SINGLE}
    paired: dict[str, dict[tuple[str, str | None], Outcome]] = {experiment: {} for experiment in PAIRED}
    pairs = list(itertools.product(chosen, (None, *chosen)))
    done, whole = 0, len(SINGLE) * len(chosen) + len(PAIRED) * len(pairs)
    with ThreadPoolExecutor(workers) as pool:
        try:
            for experiment, one in SINGLE.items():
                for name, outcome in zip(chosen, pool.map(one, chosen), strict=True):
                    single[experiment][name] = outcome
                    done += 1
                    tell(experiment, done / whole)
            for closed_loop, two in PAIRED.items():
                apply = map if two is reversal else pool.map  # a loop in Python: threads would only wait for each other
                for pair, outcome in zip(pairs, apply(two, *zip(*pairs, strict=True)), strict=True):
                    paired[closed_loop][pair] = outcome
                    done += 1
                    tell(closed_loop, done / whole)
        except BaseException:
            pool.shutdown(cancel_futures=True)  # Ctrl-C is not to wait for all that was planned
            raise
    return Study(chosen, single, paired)
