"""``friction-hil import``: a model file from the friction that another program states."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.options import option_json

_SOURCES = ("mjcf", "urdf", "bam")  # as friction_hil.models.foreign has them, which is slow to import


@click.command("import")
@click.argument("file", metavar="FILE", type=click.Path(path_type=Path))
@click.option("--from", "source", type=click.Choice(_SOURCES), required=True, help="What FILE is.")
@click.option("--joint", metavar="NAME", help="Joint of FILE, if several have friction.")
@click.option("--output", type=click.Path(path_type=Path), metavar="MODEL", required=True, help="Model file to write.")
@click.option("--force", is_flag=True, help="Overwrite MODEL if it exists.")
@option_json
def command(**options: Any) -> None:
    """Write a model file from the friction in FILE.

    mjcf: a joint of MuJoCo: frictionloss, damping, armature; LuGre friction and cogging of a dcmotor. Default classes
    are resolved; included files are not read.

    urdf: <dynamics friction damping> of a joint.

    bam: parameters of BAM, m1 to m6, also of the package better-actuator-models; of a configuration with several
    actuators --joint names one. Load shares that differ near rest are left out.

    Such a file states no errors, no range of validity and often no inertia: what is missing is printed, and stands in
    MODEL. Identify the axis for a model that carries them.
    """
    from friction_hil.cli.work.import_model import import_model  # imported here: --help must not wait for numba

    import_model(**options)
