"""``friction-hil study``: the effect of each friction model on a servo, and of compensation on a machine."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.completion import complete_models
from friction_hil.cli.options import folder_option, numbers, option_json, option_verbose


@click.command("study")
@click.argument("machine", required=False, type=click.Path(path_type=Path))
@click.option(
    "--models",
    "names",
    metavar="A,B,...",
    shell_complete=complete_models,
    help="Friction models of the experiments, separated by commas.  [default: all]",
)
@click.option(
    "--friction",
    metavar="KEY=X,...",
    callback=numbers,
    help="Levels of the mass of experiments 1 to 8, N and m: coulomb (1), static (1.5), stribeck_velocity (1e-3), "
    "viscous (0.4), stiffness (1e5), damping (316). Paths and forces of the experiments "
    "change in proportion.",
)
@click.option(
    "--servo",
    metavar="KEY=X,...",
    callback=numbers,
    help="The same of the servo of experiment 9, N m and rad.  [default: the example of lugre]",
)
@click.option(
    "--motion",
    metavar="KEY=X,...",
    callback=numbers,
    help="mass (1 kg); spring (2 N/m) and pull (0.1 m/s) of stick-slip; radius (1 rad) and frequency (0.5 Hz) of the "
    "circle.",
)
@folder_option("out/study", "the report")
@option_verbose
@option_json
def command(machine: Path | None, names: str | None, verbose: bool, **options: Any) -> int:
    """Show what friction does to a servo, model by model, or what compensation does on a MACHINE.

    Without MACHINE: nine experiments with each friction model. Static curves, velocity pulse, presliding, stress and
    strain, frictional lag, break-away, stick-slip, hunting and reversal spikes; the last three without and with
    compensation by each model.

    MACHINE is a configuration file whose axes have a simulation, e.g. the one that "friction-hil config new --example
    single_axis_csp" writes. Each axis makes its own motion, and a slow, a fast and a small one, without and with the
    compensation and the model of the file. Axes of one mechanism (gantry, arm) move together. RMS and peak of the
    following error are printed, at the motor and at the load.

    Writes report.html with figures, numbers and explanations; this takes less than a minute, and gives the same numbers
    each time for the same options. Exit status 1 if a number is not finite.
    """
    if machine is not None:
        if names is not None or any(options.pop(name) for name in ("friction", "servo", "motion")):
            raise click.UsageError(
                "--models, --friction, --servo and --motion go without MACHINE, whose file has model and motion"
            )
        from friction_hil.cli.work.study_machine import run_machine_study  # imported here: as below

        return run_machine_study(machine=machine, **options)
    from friction_hil.cli.work.study import run_study  # imported here: --help must not wait for numba

    return run_study(names=names, verbose=verbose, **options)
