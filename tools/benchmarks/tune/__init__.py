"""What `friction-hil tune` finds on simulated axes, compared with a compensator that is given the truth.

Each axis is tuned by the command itself, against simulated drives and paced by SYNC. The model that it keeps and the
true one then compensate the same simulated axis on motions of other speeds and strokes, without a bus. Of both, the
factor is taken by which RMS and peak of the following error fall.
"""

from pathlib import Path

import click

from friction_hil.cli.options import option_json
from friction_hil.cli.output import print_json
from tools.benchmarks.tune.axes import read_axes
from tools.benchmarks.tune.judge import judge_truth, tune_axis
from tools.benchmarks.tune.report import as_json as to_json
from tools.benchmarks.tune.report import show

OWN = Path(__file__).with_name("axes.yaml")


@click.command()
@click.argument("files", nargs=-1, type=click.Path(path_type=Path, exists=True))
@click.option("--only", help="Names of the axes to tune, separated by commas.")
@click.option("--truth", "gain", type=float, help="Only show what the true friction reaches at this gain, untuned.")
@click.option(
    "--by",
    type=click.Choice(["torque", "velocity", "position"]),
    default="torque",
    show_default=True,
    help="With --truth: what the drive is given, a torque offset, a velocity offset or shifted set-points.",
)
@option_json
def command(files: tuple[Path, ...], only: str | None, gain: float | None, by: str, as_json: bool) -> None:
    """Print how close tune comes to the true friction of simulated axes.

    FILES are configurations of one simulated axis each; by default the axes are those of axes.yaml.
    """
    axes = read_axes(files or (OWN,), tuple(only.split(",")) if only else ())
    results = []
    for name, configuration in axes.items():
        click.echo(f"{name} ...", err=True)
        results.append(tune_axis(name, configuration) if gain is None else judge_truth(name, configuration, gain, by))
    if as_json:
        print_json(to_json(results))
    else:
        show(results, is_truth_alone=gain is not None)
