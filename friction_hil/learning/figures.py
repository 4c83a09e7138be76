"""What learning has done for an axis so far, as it is reported."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(slots=True)
class LayerFigures:
    """What has happened to the residual layer so far."""

    # empty as long as nothing was looked at, then "noise only", "on trial", "no gain", "without a verdict" (the motion
    # changed during the trial), "refused" (by the daemon or the user), "on", "no longer a gain": it was on; or "not
    # proven for this motion"
    state: str = ""
    # share of the mean square of what the model leaves of the torque that the layer explains, of rows that it was not
    # learned from, in the last window
    explained: float = 0.0
    tried: int = 0
    error_before: float | None = None  # root mean square of the following error without the layer in use or tried last
    error_after: float | None = None  # the same with it
    text: str = ""  # what the layer consists of; empty where there is none


@dataclass(slots=True)
class FamilyFigures:
    """What has happened to the family of the model so far."""

    of_file: str = ""  # family of the model file
    in_use: str = ""  # family of the model that the compensator has
    # empty as long as none was compared, then "none explains more", "on trial", "no gain", "without a verdict" (the
    # motion changed during the trial), "refused" (by the daemon or the user) or "kept"
    state: str = ""
    tried: int = 0
    text: str = ""  # family that was tried last
    # by family, the share of the mean square of the torque that the present one leaves which it explains in addition,
    # of windows before it has learned from them, on the average of the last ones
    explained: dict[str, float] = field(default_factory=dict)
    error_before: float | None = None  # root mean square of the following error without the family tried last
    error_after: float | None = None  # the same with it


@dataclass(slots=True)
class Figures:
    """What has happened so far."""

    kept: int = 0  # hand-overs of parameters that were kept
    taken_back: int = 0  # changes that were taken back
    stopped: int = 0  # times that learning stopped because the axis was not what it was
    gain: float = 1.0  # in force
    first_error: float | None = None  # root mean square of the following error with the model file
    error: float | None = None  # the same with what was kept last, of the same work
    errors: Mapping[str, float] | None = None  # relative standard errors of the parameters
    layer: LayerFigures = field(default_factory=LayerFigures)  # of the residual layer
    family: FamilyFigures = field(default_factory=FamilyFigures)  # of the family of the model
