"""`compare` and `verify`: recordings through models, and through the daemon's compensator, as ``replay`` does."""

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.api.arguments import Progress, check_numbers, model_of, read, require_recording, shown_by
from friction_hil.config import Configuration, load
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.json_values import to_json
from friction_hil.recordings.given import Given
from friction_hil.replay.comparison import Replay, replay
from friction_hil.replay.task import NEEDED, facts, own_model
from friction_hil.replay.verify import Verification
from friction_hil.replay.verify import verify as verified

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Comparison:
    """Result of `compare`.

    Attributes
    ----------
    replays : tuple of Replay
        Measured and predicted torque of each recording.
    models : dict of str to ModelFile
        The models by their names in the result.
    facts : list of dict
        An entry for each recording, as in the JSON of ``replay``.
    """

    replays: tuple[Replay, ...]
    models: Mapping[str, ModelFile]
    facts: Sequence[Mapping[str, Any]]

    @property
    def relative_errors(self) -> dict[str, float]:
        """Relative error of each model, over all recordings: norm of measured minus predicted torque over measured."""
        squares: dict[str, list[float]] = {}
        for each in (each for one in self.replays for each in one.predictions):
            left = squares.setdefault(each.model, [0.0, 0.0])
            left[0] += len(each.measured) * each.rmse**2
            left[1] += float(each.measured @ each.measured)
        return {name: math.sqrt(left / whole) if whole > 0.0 else math.nan for name, (left, whole) in squares.items()}

    @property
    def best(self) -> str:
        """Name of the model with the lowest relative error."""
        errors = self.relative_errors
        return min(errors, key=lambda name: errors[name] if math.isfinite(errors[name]) else math.inf)

    @property
    def model(self) -> ModelFile:
        """The model with the lowest relative error."""
        return self.models[self.best]

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors of the parameters of that model, if its file has them."""
        return dict((self.model.fit or {}).get("standard_errors", {}))

    @property
    def reason(self) -> str:
        """Why it is the best."""
        return f"{self.best} has the lowest relative error, {self.relative_errors[self.best]:.3%}"

    @property
    def flags(self) -> tuple[str, ...]:
        """What is wrong with the recordings, one sentence each."""
        return tuple(f"{each.path}: {text}" for each in self.replays for text in each.problems)

    def to_dict(self) -> dict[str, Any]:
        """Return what ``replay --json`` prints.

        Returns
        -------
        dict
            Values that JSON can hold: NaN and infinity are None.
        """
        found: dict[str, Any] = to_json({"recordings": self.facts})
        return found

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the torque of the first recording over time, measured and predicted.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw into; new ones by default.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        UsageError
            matplotlib is not installed.
        """
        from friction_hil.reports.result_pictures import draw_replay  # imported here: it needs matplotlib

        return draw_replay(self.replays[0], ax)

    def __repr__(self) -> str:
        """Return the number of recordings and the best model."""
        return f"Comparison({len(self.replays)} recordings, {len(self.models)} models: {self.reason})"

    def _repr_html_(self) -> str:
        """Return the errors of all models, for a notebook."""
        from friction_hil.reports.page import table, unordered_list  # imported here: few need it

        rows = [
            (
                html.escape(f"{each['path']}, {each['axis']}"),
                html.escape(model["model"]),
                f"{model['rmse']:.4g} {model['unit']}",
                f"{model['relative_error']:.3%}",
            )
            for each in self.facts
            for model in each["models"]
        ]
        header = ("recording", "model", "rmse", "relative error")
        return f"<p>{html.escape(self.reason)}</p>{table(header, rows, ('text',))}{unordered_list(self.flags)}"


def compare(
    recording: Given,
    model: Any = (),
    *,
    config: str | Path | Configuration | None = None,
    axis: str | None = None,
    column: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    rate: float | None = None,
    where: str | None = None,
    lowpass: float | None = None,
    decimate: int | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Predict the torque of recordings with models, and compare it with the measured torque.

    ``friction-hil replay`` does the same with the options of these names; its help says more of each.

    Parameters
    ----------
    recording : path, Recording, dict of arrays, data frame, or a list of these
        Motion and torque of an axis.
    model : path, str, ModelFile, result, or a list of these
        A model file, ``"coulomb:coulomb=0.08,viscous=2e-3"``, or what `identify` and `train` return. Without any, a
        recording of the daemon is compared with the model that it ran with.
    config : path or Configuration, optional
        Configuration that replaces the one inside a recording.
    axis : str, optional
        Axis to read from a recording that has several; all by default.
    column, scale, rate, where
        As of `identify`.
    lowpass : float, optional
        All signals are low-passed at this frequency without delay, Hz.
    decimate : int, optional
        Every n-th sample is used; by default as `identify` does.
    progress : callable, optional
        As of `identify`.

    Returns
    -------
    Comparison

    Raises
    ------
    RecordingError
        A recording cannot be read or lacks a column.
    UsageError
        There is no such model, or an argument is wrong.

    Examples
    --------
    >>> import numpy as np
    >>> import friction_hil as fh
    >>> t = np.arange(2000) * 0.005
    >>> v = np.sin(5.0 * t)
    >>> log = {"time_s": t, "position": -np.cos(5.0 * t) / 5.0, "velocity": v, "torque": 0.3 * np.sign(v)}
    >>> found = fh.compare(log, ["coulomb:coulomb=0.3", "coulomb:coulomb=0.2"])
    >>> found.best
    'coulomb:coulomb=0.3'
    """
    require_recording(recording)
    check_numbers(1, decimate=decimate)
    given, configuration = _named(model), _configuration(config)
    options: dict[str, Any] = {"only": NEEDED, "configuration": configuration, "has_all_axes": True}
    recordings = read(recording, axis=axis, column=column, scale=scale, rate=rate, where=where, **options)
    show = shown_by(progress)
    replays, models, entries = [], dict(given), []
    for number, each in enumerate(recordings, start=1):
        show(each.path, number, len(recordings))
        own = given or own_model(each, configuration)
        models |= own
        replays.append(replay(each, own, lowpass_hz=lowpass, decimate=decimate))
        entries.append(facts(each, replays[-1], None))
    return Comparison(tuple(replays), models, entries)


def _named(model: Any) -> dict[str, ModelFile]:
    """Return models by their names: as they were given, or by their kind."""
    found: dict[str, ModelFile] = {}
    for each in model if isinstance(model, list | tuple) else [model]:
        file = model_of(each)
        name = str(each) if isinstance(each, str | Path) else str(getattr(each, "label", file.friction.model))
        found[name if name not in found else f"{name} {len(found) + 1}"] = file
    return found


def _configuration(config: str | Path | Configuration | None) -> Configuration | None:
    return load(config) if isinstance(config, str | Path) else config


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Verified:
    """Result of `verify`.

    Attributes
    ----------
    verifications : tuple of Verification
        One for each recording.
    facts : list of dict
        An entry for each recording, as in the JSON of ``replay --verify``.
    """

    verifications: tuple[Verification, ...]
    facts: Sequence[Mapping[str, Any]]

    @property
    def is_verified(self) -> bool:
        """True if all recordings are reproduced."""
        return all(each.is_verified for each in self.verifications)

    def __bool__(self) -> bool:
        return self.is_verified

    @property
    def reason(self) -> str:
        """First difference of the first recording that is not reproduced; empty if there is none."""
        return next((each.reason for each in self.verifications if not each.is_verified), "")

    @property
    def flags(self) -> tuple[str, ...]:
        """Differences of machine and software from those of the recordings, and what is wrong with the recordings."""
        found = [f"{each.axis}: recorded elsewhere: {text}" for each in self.verifications for text in each.differences]
        return (*found, *(f"{each['path']}: {text}" for each in self.facts for text in each["problems"]))

    def to_dict(self) -> dict[str, Any]:
        """Return what ``replay --verify --json`` prints.

        Returns
        -------
        dict
            Values that JSON can hold.
        """
        found: dict[str, Any] = to_json({"recordings": self.facts})
        return found

    def __repr__(self) -> str:
        """Return whether the recordings are reproduced."""
        return f"Verified({len(self.verifications)} recordings: {self.reason or 'reproduced'})"

    def _repr_html_(self) -> str:
        """Return the verdict on each recording, for a notebook."""
        from friction_hil.reports.page import table, unordered_list  # imported here: few need it

        rows = [
            (html.escape(f"{entry['path']}, {each.axis}"), str(each.rows), html.escape(each.reason or "reproduced"))
            for entry, each in zip(self.facts, self.verifications, strict=True)
        ]
        return table(("recording", "rows", "verdict"), rows) + unordered_list(self.flags)


def verify(
    recording: Given,
    *,
    config: str | Path | Configuration | None = None,
    axis: str | None = None,
    progress: Progress | None = None,
) -> Verified:
    """Run the daemon's compensator again on its recordings and compare every bit, as ``friction-hil replay --verify``.

    Parameters
    ----------
    recording : path, Recording, or a list of these
        MCAP recordings of the daemon.
    config : path or Configuration, optional
        Configuration that replaces the one inside a recording.
    axis : str, optional
        Axis to read from a recording that has several; all by default.
    progress : callable, optional
        As of `identify`.

    Returns
    -------
    Verified
        True where a truth value is needed, if all is reproduced.

    Raises
    ------
    RecordingError
        It is no recording of the daemon.

    Examples
    --------
    >>> import friction_hil as fh
    >>> fh.verify("run.mcap").is_verified                                # doctest: +SKIP
    True
    >>> fh.verify({"time_s": [0.0, 0.001], "position": [0.0, 0.1]})
    Traceback (most recent call last):
        ...
    friction_hil.errors.RecordingError: table1: only the daemon's own MCAP recording can be verified; ...
    """
    require_recording(recording)
    configuration, show = _configuration(config), shown_by(progress)
    options: dict[str, Any] = dict.fromkeys(("column", "scale", "rate", "where"))
    recordings = read(recording, axis=axis, configuration=configuration, has_all_axes=True, **options)
    found, entries = [], []
    for number, each in enumerate(recordings, start=1):
        show(each.path, number, len(recordings))
        found.append(verified(each, configuration))
        entries.append(facts(each, None, found[-1]))
    return Verified(tuple(found), entries)
