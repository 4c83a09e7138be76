"""`tune`: commissioning on the drive; the work of ``friction-hil tune`` too."""

import html
import json
import threading
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from friction_hil.api.arguments import Progress, check_choice, families, shown_by
from friction_hil.api.joints import IdentifiedJoints, identify_joints
from friction_hil.checked_yaml.output import check_model_path
from friction_hil.checked_yaml.text import dump
from friction_hil.config import located
from friction_hil.config.arm import ArmConfig
from friction_hil.daemon.companion import free_path
from friction_hil.daemon.simulated_drives import simulated_drives
from friction_hil.errors import FrictionHilError, OptionError, UsageError, choices, internal_error
from friction_hil.friction import describe
from friction_hil.identification import thresholds as th
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.json_values import to_json
from friction_hil.tuning import AxisTuning, TuneSettings, Tuning
from friction_hil.tuning import tune as tuned_by
from friction_hil.tuning.outcome import apply_recommended, as_dict, checked, refuse_unchangeable
from friction_hil.tuning.settings import Dialog, ShowStep

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FOLDER = Path("out/tune")  # of the results, if none is named


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tuned:
    """Result of `tune`.

    Attributes
    ----------
    found : Tuning
        All that was tried, recorded and found, by axis.
    facts : dict
        What ``tune --json`` prints; values are not yet those of JSON (`to_dict`).
    """

    found: Tuning
    facts: Mapping[str, Any] = field(repr=False)

    @property
    def models(self) -> dict[str, ModelFile]:
        """Best model of each axis; one that did not help is among them, and in ``flags``."""
        return {name: ModelFile.model_validate(axis.best.content) for name, axis in self.found.axes.items()}

    @property
    def model(self) -> ModelFile:
        """Best model of the only axis.

        Raises
        ------
        UsageError
            There are several axes: `models` has all.
        """
        return self.models[self._only(None)]

    @property
    def standard_errors(self) -> dict[str, dict[str, float]]:
        """Standard errors of the parameters of the best models, by axis."""
        return {name: dict((model.fit or {}).get("standard_errors", {})) for name, model in self.models.items()}

    @property
    def reason(self) -> str:
        """What the best models are worth on the machine."""
        return "; ".join(f"{name}: {axis.best.label}, {_worth(axis)}" for name, axis in self.found.axes.items())

    @property
    def has_helped(self) -> bool:
        """True if the compensation of every axis reduced its following error and did no harm."""
        return all(axis.recommended.trial.has_helped for axis in self.found.axes.values())

    @property
    def flags(self) -> tuple[str, ...]:
        """Models that did not help, remarks on the fits, warnings of the daemon, and what drives were left with."""
        found = []
        for name, axis in self.found.axes.items():
            if not axis.recommended.trial.has_helped:
                found.append(f"{name}: compensation did not help: its model is not to be used")
            found += [f"{name}: {text}" for text in (*axis.recommended.trial.problems, *axis.best.fit.flags)]
        return (*found, *self.found.warnings, *self.found.leftovers)

    def save(self, path: str | Path, axis: str | None = None) -> None:
        """Write the model file of an axis; the folder of the tuning has it too.

        Parameters
        ----------
        path : path
            File to write, with the suffix .yaml; an existing one is replaced.
        axis : str, optional
            Its name, if there are several.

        Raises
        ------
        UsageError
            There is no such axis, the suffix is wrong, or the file cannot be written.
        """
        check_model_path(Path(path))
        Path(path).write_text(dump(self.found.axes[self._only(axis)].best.content), encoding="utf-8")

    def to_dict(self) -> dict[str, Any]:
        """Return what ``tune --json`` prints.

        Returns
        -------
        dict
            Values that JSON can hold: NaN and infinity are None.
        """
        found: dict[str, Any] = to_json(self.facts)
        return found

    def plot(self, ax: "Axes | None" = None, axis: str | None = None) -> "Axes":
        """Draw the following error of an axis's own motion, without and with compensation.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw into; new ones by default.
        axis : str, optional
            Name of the axis of the machine, if there are several.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        UsageError
            There is no such axis, or matplotlib is not installed.
        """
        from friction_hil.reports.result_pictures import draw_tuned  # imported here: it needs matplotlib

        return draw_tuned(self.found.axes[self._only(axis)], ax)

    def _only(self, axis: str | None) -> str:
        if axis is None and len(self.found.axes) == 1:
            return next(iter(self.found.axes))
        if axis not in self.found.axes:
            raise UsageError(f"choose an axis; {choices(axis or '', self.found.axes)}")
        return axis

    def __repr__(self) -> str:
        """Return the best models and what they are worth."""
        return f"Tuned({self.reason})"

    def _repr_html_(self) -> str:
        """Return what each model is worth, and flags, for a notebook."""
        from friction_hil.reports.page import table, unordered_list  # imported here: few need it

        rows = [
            tuple(map(html.escape, (name, axis.best.label, _worth(axis)))) for name, axis in self.found.axes.items()
        ]
        return table(("axis", "model", "following error"), rows, ("text", "text")) + unordered_list(self.flags)


def _worth(axis: AxisTuning) -> str:
    reduction = axis.recommended.trial.own.reduction
    return f"{reduction.rms:.3g} times lower (RMS), {reduction.peak:.3g} times (peak)"


def tune(
    configuration: str | Path,
    *,
    axis: str | Sequence[str] = (),
    models: str | Sequence[str] = "all",
    output: str | Path | None = None,
    mechanics: bool = False,
    apply: bool = False,
    confirm: bool = False,
    simulate: bool = False,
    reset_fault: bool = False,
    pace: Literal["real", "sync"] = "real",
    progress: Progress | None = None,
) -> Tuned:
    """Move the axes of a configuration, identify their friction, and test the compensation on the drives.

    ``friction-hil tune`` does the same with the options of these names; its help says more of each. **The machine moves
    several times, minutes apart.** KeyboardInterrupt brings the axes to rest.

    Parameters
    ----------
    configuration : path
        Configuration with limits and an ``experiment`` for each axis.
    axis : str or sequence of str
        Axes to tune; all by default.
    models : str or sequence of str
        Families of models to try, by name.
    output : path, optional
        Folder for recordings and models, new or empty; by default ``out/tune``, with the time in its name if it exists.
    mechanics : bool
        True to shake each axis too, to find masses and resonance behind the motor.
    apply : bool
        True to write model and gain that helped into the configuration.
    confirm : bool
        True confirms that the way is clear, and stays clear; required unless ``simulate``.
    simulate : bool
        True to use simulated drives in place of the real ones.
    reset_fault : bool
        True to reset a fault of a drive before enabling it.
    pace : str
        ``real``, or ``sync``: as fast as drives that are simulated so reply.
    progress : callable, optional
        As of `identify`; it is also told what moves, before it does.

    Returns
    -------
    Tuned

    Raises
    ------
    UsageError
        The motion is not confirmed, another thread than the main one calls this, the configuration lacks a key that
        tuning needs, or the folder is not empty.
    DriveError, BusError
        A drive does not answer, or the bus cannot be opened.
    FrictionHilError
        A run met a fault.

    Examples
    --------
    >>> import friction_hil as fh
    >>> fh.tune("machine.yaml")                                   # nothing moves
    Traceback (most recent call last):
        ...
    friction_hil.errors.UsageError: the machine moves: confirm=True says that the way is clear, ...
    >>> found = fh.tune("machine.yaml", confirm=True)             # doctest: +SKIP
    >>> found.has_helped, found.models["x"]                       # doctest: +SKIP
    """
    if not (confirm or simulate):
        raise UsageError(
            "the machine moves: confirm=True says that the way is clear, simulate=True uses simulated drives instead"
        )
    if threading.current_thread() is not threading.main_thread():
        raise UsageError("tune is called in the main thread, which receives Ctrl-C: it brings the axes to rest")
    check_choice("pace", pace, ("real", "sync"))
    config = Path(configuration)
    settings = TuneSettings(
        folder=free_path(FOLDER, 0) if output is None else Path(output),
        names=(axis,) if isinstance(axis, str) else tuple(axis),
        families=families(models),
        is_fault_reset_wanted=reset_fault,
        is_paced_by_sync=pace == "sync",
        is_shaken=mechanics,
        is_simulated=simulate,
    )
    found = tuned(config, settings, _Told(shown_by(progress)), pace, is_applied=apply)
    applied: dict[str, Any] = {}
    if apply:
        try:
            applied = apply_recommended(found, config)
        except FrictionHilError as error:  # hours on a machine are not lost with it
            found.warnings.append(str(error))
    return Tuned(found, as_dict(found, config, applied))


def tuned(config: Path, settings: TuneSettings, dialog: Dialog, pace: str, *, is_applied: bool) -> Tuning:
    """Tune the axes of a configuration on their drives, or on simulated ones; ``is_applied``: the file is changed."""
    configuration = checked(config)
    if is_applied:
        refuse_unchangeable(config, settings.names or configuration.axes)
    is_simulated = settings.is_simulated
    try:
        with simulated_drives(configuration, pace, dialog.tell) if is_simulated else nullcontext(configuration) as own:
            found = tuned_by(own, settings, dialog)
    except OptionError as error:
        raise located(config, error) from None
    if configuration.arm is not None:
        _identify_arm(found, configuration.arm, settings, dialog)
    return found


def _identify_arm(found: Tuning, arm: ArmConfig, settings: TuneSettings, dialog: Dialog) -> None:
    """Identify all joints of an arm from the runs of the trial, in which they move at once; a failure is a warning."""
    runs = [path for path in found.recordings if path.name.startswith("trial_")]
    static = [name for name in settings.families if describe(name).is_static]
    try:
        with dialog.working("arm: identifying all joints at once") as show:
            joints = identify_joints(
                runs,
                ",".join(arm.joints),
                arm=arm.dynamics,
                models=static or "all",
                progress=lambda text, share: show(f"arm: {text}"),
            )
        joints.save(settings.folder / "arm.yaml")
        found.arm = joints.to_dict()
        text = json.dumps(found.arm, indent=2, ensure_ascii=False)
        (settings.folder / "arm_identified.json").write_text(text, encoding="utf-8")
    except (FrictionHilError, OSError) as error:
        found.warnings.append(f"arm: not identified from the trial: {error}")
    except Exception as error:  # noqa: BLE001  hours on a machine are not lost with it
        found.warnings.append(f"arm: not identified from the trial, because of {internal_error(error)}")
    else:
        found.arm_text, flags = _of_arm(joints, found.axes, settings.folder)
        found.warnings += flags


def _of_arm(found: IdentifiedJoints, moved: Collection[str], folder: Path) -> tuple[str, list[str]]:
    """Return what was found of the joints that moved in a line, and what was not."""
    fit = found.fit
    assert fit is not None
    said, flags = [], [f"arm: {name}: {reason}" for name, reason in found.failures.items() if name in moved]
    for name, joint, off in zip(found.names, fit.joints, fit.error_of_file, strict=True):
        if name not in moved:  # it was held: nothing of it can be determined
            continue
        keys = {"coulomb": "coulomb", "load": "per load"}
        known = [
            f"{text} {joint.values[key]:.3g} ({joint.errors[key]:.1g})"
            for key, text in keys.items()
            if key in joint.values
        ]
        said.append(f"{name} {', '.join(known) or 'not determined'}, torque of the file off by {100.0 * off:.2g} %")
        flags += [f"arm: {name}: {flag}" for flag in joint.flags if name not in found.failures]
    text = (
        f"all joints at once, SI (standard errors): {'; '.join(said)}; the trial determines {fit.determined} of "
        f"{fit.combinations} combinations of weight and inertia better than the file; {folder / 'arm_identified.json'} "
        f"and {folder / 'arm_JOINT.yaml'}"
    )
    if fit.determined < fit.combinations:
        text += "; a run in which all joints move further and at several speeds shows more (identify --urdf)"
    if fit.contradiction > th.ARM_CONTRADICTED:
        flags.append(f"arm: the trial contradicts the file, {fit.contradiction:.1f} times what is usual")
    return text, flags


class _Told:
    """Tells a callback of the steps; the motion was confirmed before."""

    def __init__(self, show: ShowStep) -> None:
        self._show = show

    def report(self, line: str) -> None:
        self._show(line)

    def tell(self, line: str) -> None:
        self._show(line)

    def confirm(self, motion: str) -> None:
        self._show(motion)

    @contextmanager
    def working(self, text: str) -> Iterator[ShowStep]:
        self._show(text)
        yield self._show
