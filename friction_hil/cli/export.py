"""``friction-hil export``: a model, and its compensator, in another language."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.completion import complete_axis, complete_model
from friction_hil.cli.options import option_json
from friction_hil.export import FORMATS, INSTEAD


class _Format(click.Choice[str]):
    """Names of formats, and what to take in place of one that there is no more."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if value in INSTEAD:
            self.fail(f"there is no format {value!r}; {INSTEAD[value]}", param, ctx)
        return super().convert(value, param, ctx)


@click.command("export")
@click.argument("model", metavar="[MODEL]", required=False, shell_complete=complete_model)
@click.option("--to", type=_Format(list(FORMATS)), required=True, help="Language of the export.")
@click.option(
    "--output",
    metavar="PATH",
    help="Folder that exists, or name of the files without or with suffix. Default: the name of the model file, in "
    "this folder; of mjcf, mjcf_lugre, bam, isaaclab and ax8000 with that of the format behind it.",
)
@click.option("--config", type=click.Path(path_type=Path), metavar="CONFIG", help="Export the compensator, too.")
@click.option(
    "--axis",
    metavar="NAME",
    shell_complete=complete_axis,
    help="Axis of CONFIG or of the recording, if it has several.",
)
@click.option("--resolution", type=float, metavar="SI", help="Smallest step of the position, rad or m; with --config.")
@click.option(
    "--delay",
    "delay_s",
    type=float,
    metavar="S",
    help="Time from sampling the position until its torque begins to act in the target. Default: that of the model "
    "file, or one period.",
)
@click.option(
    "--recording",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Recording whose speeds weigh the fit of a format that loses torque. Default: all speeds alike.",
)
@click.option("--speed", type=float, metavar="SI", help="Largest speed of that fit, rad/s or m/s.")
@click.option("--force", is_flag=True, help="Overwrite files that exist.")
@option_json
def command(**options: Any) -> None:
    """Export MODEL, a model file or a model such as coulomb:coulomb=0.1, for use elsewhere.

    c: C99 source and header without allocation and without any library but libm, in double or single precision, from
    the same equations as this program's own; all models, modifiers and networks.

    st: the same as function blocks in Structured Text (IEC 61131-3), for CODESYS, TwinCAT and other controllers.

    fmu: the same as functional mock-up units for co-simulation, FMI 2.0 and 3.0; it needs a C compiler.

    urdf, mjcf, mjcf_lugre, bam, isaaclab, ax8000, csv: what a simulator, a drive or a table can hold of the friction,
    fitted so that the least torque is lost over the range of the identification (--speed, or the speeds of
    --recording). What is lost is printed and stands in the file: RMS, largest and where, and what no form of this kind
    can know.

    With --config the whole compensator is exported, with the settings of an axis of CONFIG: velocity estimate, lead,
    gain, limits, adaptation. MODEL takes the place of the axis's model.

    Without MODEL, all axes of CONFIG are exported to c with their own models, as one struct for a loop of your own.
    """
    from friction_hil.cli.work.export import export  # imported here: --help must not wait for it

    export(**options)
