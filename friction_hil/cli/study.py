"""``friction-hil study``: the effect of each friction model on a servo."""

from typing import Any

import click

from friction_hil.cli.completion import complete_models
from friction_hil.cli.options import folder_option, option_json


@click.command("study")
@click.option(
    "--models",
    "names",
    metavar="A,B,...",
    shell_complete=complete_models,
    help="Friction models, separated by commas.  [default: all]",
)
@folder_option("out/study", "the report")
@option_json
def command(**options: Any) -> int:
    """Show what friction does to a servo, model by model, in nine experiments.

    Static curves, velocity pulse, presliding, stress and strain, frictional lag, break-away, stick-slip, hunting and
    reversal spikes; the last three without and with compensation by each model. Writes report.html with figures,
    numbers and explanations; this takes less than a minute, and gives the same numbers each time. Exit status 1 if a
    number is not finite.
    """
    from friction_hil.cli.work.study import run_study  # imported here: --help must not wait for numba

    return run_study(**options)
