"""Settings of an identification: model families, mechanics, filters and loss. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from friction_hil import friction as models
from friction_hil.errors import UsageError, choices
from friction_hil.identification import structures
from friction_hil.identification.structures import EQUAL_IN_FEEDFORWARD
from friction_hil.identification.thresholds import REPLICAS

GravityKind = Literal["auto", "none", "constant", "pendulum"]


@dataclass(frozen=True, slots=True)
class FitStep:
    """A fit that begins."""

    stage: str  # of the identification: families, modifiers, age of the torque, refinement or refined modifiers
    number: int  # of the fit in its stage, from 1
    count: int | None  # most fits in the stage, of which results may save some; None: not known
    label: str  # of the candidate


@dataclass(frozen=True, slots=True)
class IdentificationSettings:
    """Settings of `friction_hil.identification.identify`."""

    families: tuple[str, ...] = ()  # names of the model families to fit; empty: all
    axis: Literal["rotary", "linear"] = "rotary"
    # ``none``, ``constant`` (vertical axis), ``pendulum`` (sine and cosine of the position), or ``auto``: pendulum if
    # it predicts held-out blocks better
    gravity: GravityKind = "auto"
    held: Mapping[str, float] = field(default_factory=dict)  # parameters held at a given value, by name
    is_robust: bool = False  # Huber's loss instead of least squares
    has_modifiers: bool = True  # modifiers other than direction are tried
    # The column ``torque`` is a signal in a unit of its own (V, A), with torque = gain signal - back_emf velocity. Gain
    # and back-EMF are then identified, and the held inertia or gravity sets the scale
    # (`friction_hil.identification.unknown_gain`).
    has_unknown_gain: bool = False
    least_speed: float = 0.0  # this and the next three: see `friction_hil.identification.data.prepare`
    sliding_s: float = 0.0
    sliding_distance: float = 0.0
    group_by: str | None = None  # groups are held out one after the other
    seed: int = 0  # of the random starting points
    lowpass_hz: float | None = None  # this and the decimation: see `friction_hil.identification.data.prepare`
    decimation: int | None = None
    # Fit dynamic models once more at the full resolution of the encoder (`friction_hil.identification.refine`). None:
    # if all recordings show presliding: position in known steps, sampled at 500 Hz or more, with oscillations faster
    # than 8 Hz.
    refine: bool | None = None
    # Meaning of a measured torque, which the refinement needs: ``mean`` over the period that ends at the sample, the
    # value at that ``instant``, or ``auto``: found from the recordings, and a mean if they do not tell
    # (`friction_hil.identification.torque_timing`).
    torque: Literal["auto", "mean", "instant"] = "auto"
    orders: tuple[float, ...] = ()  # of ripple that every candidate has, per revolution or per metre
    replicas: int = REPLICAS  # simulated experiments that the refinement uses to estimate its bias


def chosen_families(names: Sequence[str]) -> tuple[str, ...]:
    """Return the families of friction models to fit: the named ones, or all if ``names`` is empty.

    Raises `UsageError`: a name is unknown, or that family cannot be fitted to recordings.
    """
    if not names:
        return structures.families()
    known = (*structures.families(), *EQUAL_IN_FEEDFORWARD)
    for name in names:
        models.describe(name)
        if name not in known:
            raise UsageError(f"no recording can be fitted with {name!r}; {choices(name, known)}")
    return tuple(dict.fromkeys(names))
