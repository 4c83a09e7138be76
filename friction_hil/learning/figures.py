"""What learning has done for an axis so far, as it is reported."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(slots=True)
class LayerFigures:
    """What has happened to the residual layer so far.

    Attributes
    ----------
    state : str
        Empty as long as nothing was looked at, then "noise only", "on trial", "no gain", "without a verdict" (the
        motion changed during the trial), "refused" (by the daemon or the user), "on", "no longer a gain": it was on; or
        "not proven for this motion".
    explained : float
        Share of the mean square of what the model leaves of the torque that the layer explains, of rows that it was
        not learned from, in the last window.
    tried : int
    error_before, error_after : float or None
        Root mean square of the following error without the layer in use or tried last, and with it.
    text : str
        What the layer consists of; empty where there is none.
    """

    state: str = ""
    explained: float = 0.0
    tried: int = 0
    error_before: float | None = None
    error_after: float | None = None
    text: str = ""


@dataclass(slots=True)
class FamilyFigures:
    """What has happened to the family of the model so far.

    Attributes
    ----------
    of_file, in_use : str
        Family of the model file, and of the model that the compensator has.
    state : str
        Empty as long as none was compared, then "none explains more", "on trial", "no gain", "without a verdict" (the
        motion changed during the trial), "refused" (by the daemon or the user) or "kept".
    tried : int
    text : str
        Family that was tried last.
    explained : dict
        By family, the share of the mean square of the torque that the present one leaves which it explains in
        addition, of windows before it has learned from them, on the average of the last ones.
    error_before, error_after : float or None
        Root mean square of the following error without the family tried last, and with it.
    """

    of_file: str = ""
    in_use: str = ""
    state: str = ""
    tried: int = 0
    text: str = ""
    explained: dict[str, float] = field(default_factory=dict)
    error_before: float | None = None
    error_after: float | None = None


@dataclass(slots=True)
class Figures:
    """What has happened so far.

    Attributes
    ----------
    kept, taken_back, stopped : int
        Hand-overs of parameters that were kept; changes that were taken back; times that learning stopped because the
        axis was not what it was.
    gain : float
        In force.
    first_error, error : float or None
        Root mean square of the following error with the model file, and with what was kept last, of the same work.
    errors : dict
        Relative standard errors of the parameters.
    layer : LayerFigures
        Of the residual layer.
    family : FamilyFigures
        Of the family of the model.
    """

    kept: int = 0
    taken_back: int = 0
    stopped: int = 0
    gain: float = 1.0
    first_error: float | None = None
    error: float | None = None
    errors: Mapping[str, float] | None = None
    layer: LayerFigures = field(default_factory=LayerFigures)
    family: FamilyFigures = field(default_factory=FamilyFigures)
