"""`train`: a network that learns friction; the work of ``friction-hil train`` too."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from friction_hil import training
from friction_hil.api.arguments import Progress, check_choice, check_numbers, is_empty, model_of, read, shown_by
from friction_hil.api.result import Result
from friction_hil.errors import UsageError
from friction_hil.identification import IdentificationSettings
from friction_hil.models.model_file import ModelFile
from friction_hil.recordings.given import Given, kind_of
from friction_hil.training import Selection, TrainedModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STRUCTURES = ("auto", "gated", "narx", "static", "residual")
_LEAST_SAMPLES = 1000
Watch = Callable[[training.Progress], object]
"""Called after each iteration of a training, which ends where it returns False."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Trained(Result):
    """Result of `train`.

    Attributes
    ----------
    found : Selection or TrainedModel
        The choice between models, or the network of a given structure.
    seconds : float
        How long it took, s.
    """

    found: Selection | TrainedModel
    seconds: float

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw over velocity the friction that the network was trained on, and its own; see `Result.plot`."""
        from friction_hil.reports.result_pictures import draw_trained  # imported here: it needs matplotlib

        return draw_trained(self.found, ax)


def train(
    recording: Given = (),
    *,
    structure: Literal["auto", "gated", "narx", "static", "residual"] = "auto",
    hidden: Sequence[int] = (),
    inputs: Sequence[str] = (),
    validate: Given = (),
    from_model: Any = None,
    samples: int = 20000,
    period: float = 1e-3,
    speed: float | None = None,
    base: Any = None,
    linear: bool = False,
    axis: str | None = None,
    column: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    rate: float | None = None,
    where: str | None = None,
    lowpass: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Trained:
    """Train a network on the friction of an axis, from recordings or from a model.

    ``friction-hil train`` does the same with the options of these names; its help says more of each.

    Parameters
    ----------
    recording : path, Recording, dict of arrays, data frame, or a list of these
        Motion and torque of the axis; none with ``from_model``.
    structure : str
        ``auto`` (a network is kept only if it predicts held-out data better than the identified model), ``gated``,
        ``narx``, ``static`` or ``residual``.
    hidden : sequence of int
        Number of units of one or two layers; not with ``auto``.
    inputs : sequence of str
        Inputs besides the velocity: position, load_torque, temperature.
    validate : as recording
        Recordings to judge by; without any, parts of the others are held out.
    from_model : path, str or ModelFile, optional
        Learn this model, along a designed excitation.
    samples, period, speed
        With ``from_model``: number of samples, sampling period in s, top speed in rad/s or m/s.
    base : path, str or ModelFile, optional
        Model with the mechanics of the axis and, for a residual, its friction; without it both are identified.
    linear : bool
        True for a linear axis: m, N, kg.
    axis, column, scale, rate, where
        As of `identify`.
    lowpass : float, optional
        All signals are low-passed at this frequency without delay, Hz.
    seed : int
        Seed of the random starts: the same one gives the same bits.
    progress : callable, optional
        As of `identify`. What it raises ends the training, KeyboardInterrupt too.

    Returns
    -------
    Trained

    Raises
    ------
    RecordingError
        A recording cannot be read, lacks a column or is too short.
    UsageError
        An argument is wrong.

    Examples
    --------
    >>> import friction_hil as fh
    >>> found = fh.train(from_model="coulomb:coulomb=0.1,viscous=0.01", structure="static", samples=1000, speed=2.0)
    >>> found.model.friction.network is not None, found.to_dict()["validation"]["free_run"] < 0.2
    (True, True)
    """
    show = shown_by(progress)

    @contextmanager
    def watched() -> Iterator[Watch]:
        def watch(now: training.Progress) -> bool:
            show(f"start {now.start + 1} of {now.starts}", now.iteration, now.most_iterations)
            return True

        yield watch

    return trained(
        recording,
        show,
        watched,
        structure=structure,
        hidden=hidden,
        inputs=inputs,
        validate=validate,
        from_model=from_model,
        samples=samples,
        period=period,
        speed=speed,
        base=base,
        linear=linear,
        reading={"axis": axis, "column": column, "scale": scale, "rate": rate, "where": where},
        lowpass=lowpass,
        seed=seed,
    )


def trained(
    given: Given,
    show: Callable[[str], None],  # told of the steps of `auto`
    watched: Callable[[], AbstractContextManager[Watch]],  # around the training of a network of another structure
    *,
    structure: Any,
    hidden: Sequence[int],
    inputs: Sequence[str],
    validate: Given,
    from_model: Any,
    samples: int,
    period: float,
    speed: float | None,
    base: Any,
    linear: bool,
    reading: Mapping[str, Any],  # axis, column, scale, rate and where
    lowpass: float | None,
    seed: int,
) -> Trained:
    """Train a network; see `train`."""
    check_choice("structure", structure, STRUCTURES)
    check_numbers(0.0, period=period, speed=speed, seed=seed)
    check_numbers(_LEAST_SAMPLES, samples=samples)
    hidden, inputs = tuple(hidden), tuple(inputs)
    if is_empty(given) == (from_model is None):
        raise UsageError("train needs recordings or --from-model, one of them")
    known = None if base is None else model_of(base)
    begin = time.monotonic()
    if structure == "auto" and from_model is None:
        if hidden:
            raise UsageError("--hidden needs a --structure: auto averages small networks of its own")
        training.NetworkSpec(inputs=inputs)  # raises on an unknown input
        found = _selected(given, validate, known, inputs, seed, linear, lowpass, reading, show)
        content = found.model_file()
        return _result(found, found.chosen.label, found.reason, content, time.monotonic() - begin)
    structure = "gated" if structure == "auto" else structure
    spec = training.NetworkSpec(structure=structure, hidden=hidden, inputs=inputs, seed=seed)
    if structure == "residual" and from_model is not None:
        raise UsageError("a residual learns what a model misses in recordings: give recordings, not --from-model")
    if from_model is not None:
        model = model_of(from_model)
        task = training.task_of_model(model, period_s=period, samples=samples, top_speed=speed, seed=seed)
    else:
        show("reading")
        recordings, validation = read(given, **reading), read(validate, **reading)
        task = training.task_of_recordings(
            recordings,
            validation,
            known,
            is_linear=known is None and kind_of([*recordings, *validation], is_linear=linear) == "linear",
            is_static=structure in ("static", "residual"),
            is_residual=structure == "residual",
            lowpass_hz=lowpass,
        )
    begin = time.monotonic()
    with watched() as watch:
        network = training.train_task(task, spec, lambda progress: watch(progress) is not False)
    reason = "the lowest error in free run on validation data"
    return _result(network, str(network.network), reason, network.model_file(), time.monotonic() - begin)


def _selected(
    given: Given,
    validate: Given,
    known: ModelFile | None,
    inputs: Sequence[str],
    seed: int,
    is_linear: bool,
    lowpass: float | None,
    reading: Mapping[str, Any],
    show: Callable[[str], None],
) -> Selection:
    """Choose a network and its physical model."""
    show("reading")
    recordings, validation = read(given, **reading), read(validate, **reading)
    kind = known.axis if known is not None else kind_of([*recordings, *validation], is_linear=is_linear)
    return training.select(
        recordings,
        validation,
        known,
        settings=IdentificationSettings(axis=kind, lowpass_hz=lowpass, seed=seed),
        inputs=inputs or None,
        seed=seed,
        progress=show,
    )


def _result(
    found: Selection | TrainedModel, label: str, reason: str, content: dict[str, Any], seconds: float
) -> Trained:
    facts = {**found.as_json(seconds), "output": None, "report": None}
    not_for = [f"not for motion {each}" for each in facts.get("not_for", ())]
    errors = content.get("fit", {}).get("standard_errors", {})
    return Trained(label, reason, (*facts["flags"], *not_for), errors, content, facts, found, seconds)
