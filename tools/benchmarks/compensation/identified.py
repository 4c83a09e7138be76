"""The models that `tune` identifies on machine files, kept in a folder."""

from collections.abc import Sequence
from pathlib import Path

import click

from friction_hil.config import load
from friction_hil.errors import FrictionHilError, OptionError
from friction_hil.models.files import load_model_file
from friction_hil.models.model_file import ModelFile
from friction_hil.tuning.motions import refuse_shared_beam
from tools.benchmarks.tune.judge import last_line, run_tune


def identified_models(files: Sequence[Path], folder: Path) -> dict[tuple[str, str], ModelFile]:
    """Return the models of all axes, by stem of the file and name of the axis.

    Parameters
    ----------
    files : sequence of Path
        Machine files.
    folder : Path
        Holds STEM/AXIS.yaml. A machine without its subfolder is tuned, into it, but not a gantry.

    Raises
    ------
    FrictionHilError
        `tune` ended without a model.
    """
    found = {}
    for file in files:
        models = folder / file.stem
        configuration = load(file, needs_models=False)
        if not models.exists():
            try:
                for axis in configuration.axes:
                    refuse_shared_beam(axis, configuration)
            except OptionError as error:
                click.echo(f"{file.stem}: there is no {models} with models, and tune makes none. {error}", err=True)
                continue
            click.echo(f"tuning {file.stem} ...", err=True)
            done = run_tune(file, models)
            if done.returncode:
                raise FrictionHilError(f"{file}: tune found no model: {last_line(done)}")
        for axis in configuration.axes:
            path = models / f"{axis}.yaml"
            if path.is_file():
                found[file.stem, axis] = load_model_file(path)
    return found
