"""Verification of a recording of the daemon: the compensator, run again, must give the same torque bit for bit."""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Any

import numpy as np

from friction_hil.compensator import INPUTS, RESULTS, Compensator
from friction_hil.compensator.velocity_offset import VelocityOffset
from friction_hil.config import AxisConfig, Configuration, from_dict
from friction_hil.daemon.assembly import make_compensator, make_shadows, make_velocity_offset
from friction_hil.drive import AxisFacts
from friction_hil.errors import RecordingError
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording, columns, fingerprint
from friction_hil.replay.changes import RecordedChanges, inputs_of

_RELATIVE_TOLERANCE = 1e-9
_VELOCITY_OFFSET = "velocity_offset"


@dataclass(frozen=True, slots=True)
class Verification:
    """Result of running the compensator of one axis again."""

    axis: str
    is_verified: bool  # no difference was found
    rows: int  # that were compared
    tolerance: float  # allowed difference, N m; 0 if all bits must be equal
    differences: tuple[str, ...]  # of machine and software from those of the recording
    reason: str  # cycle and values of the first difference; empty if there is none


def verify(recording: Recording, configuration: Configuration | None = None) -> Verification:
    """Run the compensator of a recording again and compare.

    The run starts from the recorded state, and anew from each further one: the daemon writes one at the start of every
    chunk and after every gap.

    ``configuration`` replaces the one inside the recording. Raises `RecordingError`: configuration, states or columns
    are missing: it is not a recording of the daemon.
    """
    metadata = recording.metadata
    has_inputs = all(name in recording.columns for name in (*INPUTS, *RESULTS)) and "checksum" in recording
    is_ours = has_inputs and "configuration" in metadata and "facts" in metadata
    # checked first: an altered cycle number may be why no state matches a row
    altered = _altered_row(recording) if is_ours else None
    if not is_ours or (altered is None and not recording.restarts):
        if "configuration" in metadata and "facts" in metadata and "checksum" in recording:
            missing = [name for name in (*INPUTS, *RESULTS) if name not in recording.columns]
            if missing:
                raise RecordingError(
                    f"{recording.path}: it has no column {', '.join(missing)}; another version of friction_hil made it "
                    "and can verify it"
                )
        raise RecordingError(
            f"{recording.path}: only the daemon's own MCAP recording can be verified; this one has no states of the "
            "compensator"
        )
    recording.require("compensation", "velocity_estimate", "checksum", "cycle", "position")
    configuration = configuration or from_dict(
        metadata["configuration"], f"{recording.path} (configuration inside)", reads_files=False
    )
    if recording.axis not in configuration.axes:
        raise RecordingError(
            f"{recording.path}: its axis {recording.axis!r} is not in the configuration, which has "
            f"{', '.join(configuration.axes)}"
        )
    axis = configuration.axes[recording.axis]
    facts = facts_of(metadata, recording)
    compensators = _compensators(axis, facts, configuration.period_s)
    changes = RecordedChanges(recording, configuration, facts)
    differences = tuple(fingerprint.differences(metadata.get("fingerprint", {}), fingerprint.fingerprint()))
    tolerance = _RELATIVE_TOLERANCE * axis.model.friction_model.level if differences else 0.0
    velocity_offset = make_velocity_offset(axis, facts, configuration.period_s)
    recording.require(*compensators, *((_VELOCITY_OFFSET,) if velocity_offset is not None else ()))
    rows = len(recording) - recording.restarts[0][0] if recording.restarts else 0
    if altered is not None:
        row, reason = altered, "the recorded inputs are not those that the daemon saw (checksum)"
    else:
        row, reason = _first_difference(recording, compensators, velocity_offset, changes, tolerance)
    if reason:
        # computed from the time: the recorded cycle number is an input too and may be what was altered
        reason = f"cycle {round(float(recording.columns[columns.TIME][row]) / configuration.period_s)}: {reason}"
    return Verification(recording.axis, not reason, rows, tolerance, differences, reason)


def facts_of(metadata: Mapping[str, Any], recording: Recording) -> AxisFacts:
    """Return what the driver stated about the drive of a recording of the daemon.

    Raises `RecordingError`: another version made the recording, or another program did.
    """
    known = fields(AxisFacts)
    needed = [field.name for field in known if field.default is MISSING]
    for facts in metadata["facts"]:
        if facts["name"] != recording.axis:
            continue
        if missing := [name for name in needed if name not in facts]:
            raise RecordingError(
                f"{recording.path}: what it says about the drive of axis {recording.axis!r} lacks "
                f"{', '.join(missing)}; another version of friction_hil made it and can verify it"
            )
        return AxisFacts(**{field.name: facts[field.name] for field in known if field.name in facts})
    raise RecordingError(f"{recording.path}: it says nothing about the drive of axis {recording.axis!r}")


def _compensators(axis: AxisConfig, facts: AxisFacts, period_s: float) -> dict[str, Compensator]:
    """Return the compensator and the shadows by the column that each of them filled."""
    shadows = make_shadows(axis, facts, period_s)
    return {
        "compensation": make_compensator(axis, axis.model, facts, period_s),
        **{columns.shadow(name): shadow for name, shadow in shadows.items()},
    }


def _altered_row(recording: Recording) -> int | None:
    """Return the first row whose inputs do not match their checksum, if there is one."""
    inputs = zip(*(recording.columns[name] for name in INPUTS), strict=True)
    for row, (values, checksum) in enumerate(zip(inputs, recording.columns["checksum"], strict=True)):
        if columns.input_checksum(*values) != checksum:
            return row
    return None


def _first_difference(
    recording: Recording,
    compensators: Mapping[str, Compensator],
    velocity_offset: VelocityOffset | None,
    changes: RecordedChanges,
    tolerance: float,
) -> tuple[int, str]:
    """Return row and description of the first difference; the description is empty if there is none."""
    parts: dict[str, Compensator | VelocityOffset] = dict(compensators)
    if velocity_offset is not None:
        parts[_VELOCITY_OFFSET] = velocity_offset
    needed = sum(part.state.size for part in parts.values())
    bounds = [row for row, _ in recording.restarts] + [len(recording)]
    for (first, state), end in zip(recording.restarts, bounds[1:], strict=True):
        if state.size < needed:
            raise RecordingError(
                f"{recording.path}: the recorded state has {state.size} numbers, but these compensators have {needed}: "
                "it was recorded with other models, or by another version"
            )
        offset = 0
        worst: tuple[int, str] | None = None
        for column, part in parts.items():
            size = part.state.size
            part.state[:] = state[offset : offset + size]
            offset += size
            if isinstance(part, VelocityOffset):
                inputs = (recording.columns[name][first:end] for name in ("cycle", "compensation"))
                results = {column: part.replay(*inputs)}
            elif column == "compensation":
                results = changes.replay(part, first, end)
            else:
                results = {column: part.replay_all(inputs_of(recording, first, end))["compensation"]}
            for name, values in results.items():
                row = _first_unequal(recording.columns[name][first:end], values, tolerance)
                if row is not None and (worst is None or first + row < worst[0]):
                    recorded = recording.columns[name][first + row]
                    worst = (
                        first + row,
                        f"{name} was {float(recorded)!r} and comes out as {float(values[row])!r}",
                    )
        if worst is not None:
            return worst
    return 0, ""


def _first_unequal(recorded: Array, values: Array, tolerance: float) -> int | None:
    if tolerance == 0.0:
        unequal = np.ascontiguousarray(recorded).view(np.int64) != values.view(np.int64)
    else:
        unequal = ~((np.abs(values - recorded) <= tolerance) | (np.isnan(values) & np.isnan(recorded)))
    rows = np.flatnonzero(unequal)
    return int(rows[0]) if rows.size else None
