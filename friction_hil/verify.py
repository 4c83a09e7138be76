"""Re-running the compensator over the daemon's own recording: what it gave must come out again, bit for bit."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from friction_hil import fingerprint
from friction_hil.assembly import make_compensator, make_shadows
from friction_hil.compensator import INPUTS, Compensator, input_checksum
from friction_hil.config import from_dict
from friction_hil.errors import RecordingError
from friction_hil.jit import Array
from friction_hil.recordings import Recording, columns

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration

_RELATIVE_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class Verification:
    """What re-running one axis showed.

    Attributes
    ----------
    is_verified : bool
    rows : int
        Rows that were compared.
    tolerance : float
        0 where equal bits are demanded, else the allowed difference, N m.
    differences : tuple of str
        How the machine or the software differs from those of the recording.
    reason : str
        Where and how the first difference shows; empty if there is none.
    """

    axis: str
    is_verified: bool
    rows: int
    tolerance: float
    differences: tuple[str, ...]
    reason: str


def verify(recording: Recording, configuration: "Configuration | None" = None) -> Verification:
    """Run the compensator of a recording again and compare.

    It starts from the recorded state, and again from each further one, which the daemon wrote at the start of
    every chunk and after every gap.

    Parameters
    ----------
    recording : Recording
        Of the daemon.
    configuration : Configuration, optional
        In place of the one inside the recording.

    Raises
    ------
    RecordingError
        The recording is not the daemon's own: configuration, states or columns are missing.
    """
    metadata = recording.metadata
    if not recording.restarts or "configuration" not in metadata or "facts" not in metadata:
        raise RecordingError(
            f"{recording.path}: only the daemon's own MCAP recording can be verified; this one has no states of the "
            "compensator"
        )
    recording.require("compensation", "velocity_estimate", "checksum", "cycle", "position", "velocity")
    configuration = configuration or from_dict(metadata["configuration"], f"{recording.path} (configuration inside)")
    if recording.axis not in configuration.axes:
        raise RecordingError(
            f"{recording.path}: its axis {recording.axis!r} is not in the configuration, which has "
            f"{', '.join(configuration.axes)}"
        )
    axis = configuration.axes[recording.axis]
    compensators = _compensators(axis, _facts(metadata, recording), configuration.period_s)
    differences = tuple(fingerprint.differences(metadata.get("fingerprint", {}), fingerprint.fingerprint()))
    parameters = axis.model.friction_model.parameters
    level = max(parameters.get("static", 0.0), parameters["coulomb"])
    tolerance = _RELATIVE_TOLERANCE * level if differences else 0.0
    reason = _altered_input(recording) or _first_difference(recording, compensators, tolerance)
    rows = len(recording) - recording.restarts[0][0]
    return Verification(recording.axis, not reason, rows, tolerance, differences, reason)


def _facts(metadata: Mapping[str, Any], recording: Recording) -> Mapping[str, Any]:
    for facts in metadata["facts"]:
        if facts["name"] == recording.axis:
            return dict(facts)
    raise RecordingError(f"{recording.path}: it says nothing about the drive of axis {recording.axis!r}")


def _compensators(axis: "AxisConfig", facts: Mapping[str, Any], period_s: float) -> dict[str, Compensator]:
    """The compensator and the shadows, by the column that each filled."""
    resolution = float(facts["position_resolution"])
    shadows = make_shadows(axis, resolution, period_s)
    return {
        "compensation": make_compensator(axis, axis.model, resolution, period_s),
        **{columns.shadow(name): shadow for name, shadow in shadows.items()},
    }


def _altered_input(recording: Recording) -> str:
    """Name the first row whose inputs are not those that the daemon saw."""
    inputs = zip(*(recording.columns[name] for name in INPUTS), strict=True)
    for row, (values, checksum) in enumerate(zip(inputs, recording.columns["checksum"], strict=True)):
        if input_checksum(*values) != checksum:
            return f"cycle {_cycle(recording, row)}: the recorded inputs are not those that the daemon saw (checksum)"
    return ""


def _first_difference(recording: Recording, compensators: Mapping[str, Compensator], tolerance: float) -> str:
    bounds = [row for row, _ in recording.restarts] + [len(recording)]
    for (first, state), end in zip(recording.restarts, bounds[1:], strict=True):
        inputs = [np.ascontiguousarray(recording.columns[name][first:end]) for name in INPUTS]
        place = 0
        worst: tuple[int, str] | None = None
        for column, compensator in compensators.items():
            size = compensator.state.size
            compensator.state[:] = state[place : place + size]
            place += size
            torque, estimate = compensator.replay(inputs)
            results = [(column, torque)]
            if column == "compensation":
                results.append(("velocity_estimate", estimate))
            for name, values in results:
                row = _first_unequal(recording.columns[name][first:end], values, tolerance)
                if row is not None and (worst is None or first + row < worst[0]):
                    recorded = recording.columns[name][first + row]
                    worst = (
                        first + row,
                        f"{name} was {float(recorded)!r} and comes out as {float(values[row])!r}",
                    )
        if worst is not None:
            return f"cycle {_cycle(recording, worst[0])}: {worst[1]}"
    return ""


def _first_unequal(recorded: Array, values: Array, tolerance: float) -> int | None:
    if tolerance == 0.0:
        unequal = np.ascontiguousarray(recorded).view(np.int64) != values.view(np.int64)
    else:
        unequal = ~(np.abs(values - recorded) <= tolerance)
    rows = np.flatnonzero(unequal)
    return int(rows[0]) if rows.size else None


def _cycle(recording: Recording, row: int) -> int:
    cycle = float(recording.columns["cycle"][row])
    return int(cycle) if math.isfinite(cycle) else row
