"""Models that were judged on held-out data, and the choice among them."""

from collections.abc import Sequence
from dataclasses import dataclass

from friction_hil.identification.prediction_errors import PredictionError
from friction_hil.training import held_out
from friction_hil.training.held_out import Gain, gain


@dataclass(frozen=True, slots=True, eq=False)
class Contender:
    """A model that was judged on held-out data."""

    label: str
    inputs: tuple[str, ...] | None  # of the network besides the velocity; None: no network
    errors: dict[str, PredictionError]  # by kind of held-out data
    slow: float = 0.0  # mean square error of the slowest held-out rows

    @property
    def first(self) -> PredictionError:
        """Error on the kind of held-out data that decides."""
        return next(iter(self.errors.values()))

    def gains(self, other: "Contender") -> dict[str, Gain]:
        """Return the decrease of the mean square error against another contender, by kind of held-out data."""
        return {
            kind: gain(error.blocks, other.errors[kind].blocks)
            for kind, error in self.errors.items()
            if kind in other.errors and len(other.errors[kind].blocks) == len(error.blocks)
        }


def choose(alone: Contender, tried: Sequence[Contender], others: Sequence[Contender]) -> tuple[Contender, str]:
    """Return the simplest network within a standard error of the best one, if it is better than all physical models."""
    kind = next(iter(alone.errors))
    better = [
        each
        for each in tried
        if all(value.is_clear for value in each.gains(alone).values()) and each.slow <= alone.slow
    ]
    better = [each for each in better if all(_first_gain(each, other).mean > 0.0 for other in others)]
    where = f"{kind}, held out in turn" if kind != held_out.OTHERS else kind
    if not better:
        best = min(tried, key=lambda each: each.first.rmse)
        first = _first_gain(best, alone)
        why = f"its mean square error there is {first.words}"
        if first.is_clear:
            unclear = [f"{value.words} on {name}" for name, value in best.gains(alone).items() if not value.is_clear]
            worse = [other.label for other in others if _first_gain(best, other).mean <= 0.0]
            if unclear:
                why += f", but {unclear[0]}"
            elif worse:
                why += f", but {worse[0]} predicts them better without a network"
            else:
                why += ", but in slow motion it is higher"
        inputs = " and ".join(("velocity", *(best.inputs or ())))
        return alone, (
            f"no network is better than {alone.label}: on {where}, the best one, of {inputs}, leaves {_percent(best)}, "
            f"{alone.label} {_percent(alone)}; {why}"
        )
    best = min(better, key=lambda each: each.first.rmse)
    near = [each for each in better if not _first_gain(best, each).is_clear]
    chosen = min(near, key=lambda each: (len(each.inputs or ()), each.first.rmse))
    gains = " and ".join(f"{value.words} on {name}" for name, value in chosen.gains(alone).items())
    return chosen, (
        f"on {where}, {chosen.label} leaves {_percent(chosen)}, {alone.label} alone {_percent(alone)}: the mean square "
        f"error is {gains}"
    )


def _first_gain(one: Contender, other: Contender) -> Gain:
    return next(iter(one.gains(other).values()), Gain(1.0, 0.0))


def _percent(contender: Contender) -> str:
    return f"{100.0 * contender.first.relative_error:.2f} %"
