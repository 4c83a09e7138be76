"""Data of one training: samples from recordings or from a model, and what the network is compared with."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from friction_hil.friction import FrictionModel
from friction_hil.identification import IdentificationSettings, fine, identify
from friction_hil.identification.data import RegressionSegment, prepare
from friction_hil.identification.export import model_file
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.training import data
from friction_hil.training import thresholds as th
from friction_hil.training.excitation import excitation
from friction_hil.training.layout import Samples
from friction_hil.training.visited import least_speed

_UNSEEN_SEED = 1_000_003  # added to the seed of the training for signals that it has not seen


@dataclass(frozen=True, slots=True, eq=False)
class TrainingTask:
    """Data of one training and of its comparison with physical models."""

    samples: Samples  # friction torque minus that of the model beside the network, as in ``validation``
    validation: Samples
    known: ModelFile  # axis and mechanics, and for a residual the friction of the model beside the network
    is_residual: bool  # the network learns what that model leaves
    sources: dict[str, Any]  # origin of the data, for the provenance in the model file
    notes: tuple[str, ...] = ()
    # by name; used neither for training nor for validation; for the report
    unseen: dict[str, Samples] = field(default_factory=dict)
    # measured torque of the judged samples, to which errors are related; empty without recordings
    total: Array = field(default_factory=lambda: np.zeros(0))
    physical: str = ""  # name of the model beside the network, or of the best physical one
    # slowest speed that the recordings visit and the encoder shows, see `visited.least_speed`; 0 without recordings
    least_speed: float = 0.0
    # records of the validation samples as `identify` and `replay` prepare them, for the relative error
    prepared: tuple[RegressionSegment, ...] = ()
    judged: Samples | None = None  # samples of these records, as ``validation``

    @property
    def base(self) -> FrictionModel | None:
        """Model beside the network, if any."""
        return self.known.friction_model if self.is_residual else None


def task_of_model(
    known: ModelFile, *, period_s: float, samples: int, top_speed: float | None = None, seed: int = 0
) -> TrainingTask:
    """Make a task from a model of the library, simulated along designed motions; see `data.of_model`."""
    model = known.friction_model
    first = data.of_model(model, period_s=period_s, samples=samples, top_speed=top_speed, seed=seed)
    reach = float(np.max(np.abs(first.velocity)))

    def unseen(number: int) -> Samples:
        return data.of_model(
            model, period_s=period_s, samples=samples // 2, top_speed=reach, seed=seed + number * _UNSEEN_SEED
        )

    return TrainingTask(
        first,
        unseen(1),
        known,
        is_residual=False,
        sources={"from_model": repr(model), "rows": len(first)},
        unseen={"multi-sines, ramps and pulses": unseen(2), "half as fast": _slower(model, period_s, reach, seed)},
    )


def _slower(model: FrictionModel, period_s: float, reach: float, seed: int) -> Samples:
    velocity = 0.5 * excitation(reach, period_s, 10_000, seed=seed + 3 * _UNSEEN_SEED)
    position = np.cumsum(velocity) * period_s
    return Samples(period_s, velocity, model.simulate(velocity, period_s, position=position), position=position)


def task_of_recordings(
    recordings: Sequence[Recording],
    validation: Sequence[Recording],  # if there is none, blocks of ``recordings`` are held out
    # mechanics of the axis, and the friction beside a residual; None: identified from the recordings
    known: ModelFile | None,
    *,
    is_linear: bool = False,  # used if ``known`` is None
    is_static: bool = False,  # the network has no state
    is_residual: bool = False,  # the network is beside the known friction
    # Cut-off of a low-pass for all signals. None: a static network uses the one of `identify`: a map needs no more, and
    # the noise of the acceleration lies above. A network with a state learns from the encoder's counts if there is no
    # better velocity: the velocity is derived in bands and the torque stays as measured
    # (`identification.fine.at_full_rate`), because a low-pass would remove the reversals, which show the state. Without
    # counts, the low-pass of `identification.data.prepare` is used.
    lowpass_hz: float | None = None,
) -> TrainingTask:
    """Make a task from the friction in recordings."""
    notes: list[str] = []
    asked_hz = lowpass_hz
    if lowpass_hz is None and is_static:
        lowpass_hz = th.STATIC_LOWPASS * prepare(recordings[0])[0].rate_hz
    name = "the model of --base"
    if known is None:
        known, name = _identify(recordings, is_linear, lowpass_hz)
        notes.append(f"inertia, offset and gravity as identified with {name}")
    records = [record for each in recordings for record in prepare(each, lowpass_hz=lowpass_hz)]
    others = [record for each in validation for record in prepare(each, lowpass_hz=lowpass_hz)]
    slowest = least_speed(records)
    notes += dict.fromkeys(problem for record in (*records, *others) for problem in record.problems)
    if lowpass_hz is None and all(map(_is_counted, (*records, *others))):
        records, others = [list(map(fine.at_full_rate, each)) for each in (records, others)]
        notes.append("velocity derived from the counts of the encoder, in bands, each as far as it exceeds their noise")
    records, others = _in_torque(records, recordings, known), _in_torque(others, validation, known)
    base = known.friction_model
    own = data.of_records(records, known.mechanics, base if is_residual else None)
    if others:
        samples, judged = own, data.of_records(others, known.mechanics, base if is_residual else None)
    else:
        samples, judged = data.held_out(own)
        notes.append(
            "without --validate, every fourth of twenty blocks of time is held out; if the motion repeats itself, they "
            "resemble the others, which flatters a network. Without --structure, strokes of other speeds are held out"
        )
    shown = validation or recordings
    prepared = _in_torque([part for each in shown for part in prepare(each, lowpass_hz=asked_hz)], shown, known)
    error_of = data.of_records(prepared, known.mechanics, base if is_residual else None)
    return TrainingTask(
        samples,
        judged,
        known,
        is_residual=is_residual,
        sources={"recordings": [{"path": each.path, "rows": len(each)} for each in recordings]},
        notes=tuple(notes),
        total=data.total_torque(prepared),
        physical=name,
        least_speed=slowest,
        prepared=tuple(prepared),
        judged=error_of if others else data.held_out(error_of)[1],
    )


def _in_torque(
    records: Sequence[RegressionSegment], recordings: Sequence[Recording], known: ModelFile
) -> list[RegressionSegment]:
    """Apply gain and back-EMF of a model that was identified from a signal of unknown gain."""
    signal = known.signal
    of_daemon = {each.path for each in recordings if "configuration" in each.metadata}  # these are in N m or N
    return [
        each
        if signal is None or each.path in of_daemon
        else replace(each, torque=signal.gain * each.torque - signal.back_emf * each.velocity)
        for each in records
    ]


def _is_counted(record: RegressionSegment) -> bool:
    """Return True if no better velocity is known than the one from the encoder's counts."""
    return record.lowpass_hz is not None and fine.is_fine(record)


def _identify(recordings: Sequence[Recording], is_linear: bool, lowpass_hz: float | None) -> tuple[ModelFile, str]:
    """Identify the mechanics and LuGre friction of an axis; return the model and its label."""
    settings = IdentificationSettings(
        families=("lugre",), axis="linear" if is_linear else "rotary", lowpass_hz=lowpass_hz
    )
    found = identify(recordings, settings)
    return model_file(found), found.best.label
