"""What is computed from the experiment of an axis before models are tried on it: friction, mechanics, rehearsal. Pure.

It needs nothing but the recordings, so that it is computed by `friction_hil.tuning.beside` while axes move.
"""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from friction_hil.config import Configuration
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import FrictionHilError, RecordingError, internal_error
from friction_hil.identification import Identification, IdentificationSettings, identify
from friction_hil.identification.mechanics import Mechanics, find_mechanics
from friction_hil.identification.settings import chosen_families
from friction_hil.models.model_file import ModelFile
from friction_hil.recordings import Recording
from friction_hil.replay.verify import facts_of
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.candidates import ExperimentPart, closed_loop_starts, identified
from friction_hil.tuning.closed_loop import ClosedLoop, Start, closed_loop_fits
from friction_hil.tuning.cogging import PositionTorque
from friction_hil.tuning.model_files import model_content
from friction_hil.tuning.rehearsed import RehearsedFit, rehearse
from friction_hil.tuning.sequential import Observer
from friction_hil.tuning.settings import ShowStep
from friction_hil.tuning.simulated import drive_loops


@dataclass(frozen=True, slots=True, eq=False)
class Analysis:
    """What the experiment of an axis shows."""

    found: Sequence[Identification]
    mechanics: Mechanics
    rehearsed: tuple[RehearsedFit, ...]  # best first; empty if the models cannot be simulated
    problems: tuple[str, ...]  # what cannot be identified, or what an internal error has cost
    unrehearsed: str = ""  # why the models are not simulated
    is_internal: bool = False  # that is an error of the program


def analysed(
    configuration: Configuration,  # from which the runs were made
    families: Sequence[str],  # to fit; empty: all
    parts: Sequence[ExperimentPart],  # all of the experiment
    shaken: Sequence[Recording],  # while the axis was shaken, if it was
    held: Mapping[str, Recording],  # of the others meanwhile, by axis
    whole: PositionTorque | None,  # what depends on the position, if it is as large as the friction
    show: ShowStep,
) -> Analysis:
    """Identify an axis from its experiment, and rehearse the models.

    Raises `RecordingError`: nothing can be identified.
    """
    name = parts[0].recording.axis
    problems: list[str] = []
    found = identified(
        parts,
        configuration,
        families,
        on_fit=lambda step: show(f"{name}: {step.stage}: {step.label}", step.number, step.count),
        on_problem=problems.append,
        whole=whole,
    )
    show(f"{name}: mechanics behind the motor")
    mechanics = find_mechanics([each.recording for each in parts], found[0], shaken=shaken, held=held)
    try:
        if starts := closed_loop_starts(found, parts, configuration, families):
            found += [_in_closed_loop(starts, parts, configuration, show)]
            problems += found[-1].failures
    except FrictionHilError as error:
        problems.append(f"no model in closed loop: {error}")
    except Exception as error:  # noqa: BLE001  it costs these models, not the others
        problems.append(f"no model in closed loop, because of {internal_error(error)}")
    try:
        rehearsed = rehearse(  # no part is longer
            parts[-1].recording, configuration, found, lambda text, *steps: show(f"{name}: {text}", *steps)
        )
    except RecordingError as error:
        return Analysis(found, mechanics, (), tuple(problems), str(error))
    except FrictionHilError:
        raise
    except Exception as error:  # noqa: BLE001  it costs the rehearsal, not the models
        return Analysis(found, mechanics, (), tuple(problems), internal_error(error), is_internal=True)
    return Analysis(found, mechanics, rehearsed, tuple(problems))


def _in_closed_loop(
    starts: Sequence[Start], parts: Sequence[ExperimentPart], configuration: Configuration, show: ShowStep
) -> Identification:
    """Fit models to the motion of the experiment.

    Raises `RecordingError`: the loops of the drive are not known, or nothing can be fitted.
    """
    recordings = [parts[-1].recording]
    for each in parts[-2::-1]:
        if sum(one.duration_s for one in recordings) < th.ENOUGH_S:
            recordings.append(each.recording)
    loop = _closed_loop(recordings, configuration)
    return closed_loop_fits(loop, starts, lambda text, *steps: show(f"{loop.name}: {text}", *steps))


def _closed_loop(recordings: Sequence[Recording], configuration: Configuration) -> ClosedLoop:
    """Return the loops of the drive as the first recording shows them.

    Raises `RecordingError`: it does not.
    """
    first = recordings[0]
    running = first.at(first["state"] == LoopState.RUNNING)
    resolution = facts_of(first.metadata, first).position_resolution
    return ClosedLoop(recordings, configuration, drive_loops(running, configuration.axes[first.axis], resolution))


def compile_ahead(configuration: Configuration, families: Sequence[str], part: ExperimentPart, _: ShowStep) -> None:
    """Compile what `Observer` and `analysed` need, by simple fits to the first part, which are of no other use."""
    name = part.recording.axis
    kind = configuration.axes[name].model.axis
    settings = IdentificationSettings(chosen_families(tuple(families)), kind, has_modifiers=False, refine=False)
    with contextlib.suppress(Exception):  # what is wrong is met again
        Observer(configuration, name).take(part)
    with contextlib.suppress(Exception):
        found = identify([part.recording], settings)
        model = ModelFile.model_validate(model_content(found, found.best, configuration.axes[name]))
        _closed_loop([part.recording], configuration).errors(model, found.best.mechanics["inertia"])
        rehearse(part.recording, configuration, [replace(found, fits=(found.best,))])
