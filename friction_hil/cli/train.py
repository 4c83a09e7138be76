"""``friction-hil train``: a network that learns the friction of an axis from recordings, or from a model."""

from pathlib import Path
from typing import Any

import click

from friction_hil.cli.completion import complete_model
from friction_hil.cli.options import option_json, option_lowpass, option_validate, option_verbose, result_options
from friction_hil.cli.recording_options import recording_options


def _numbers(context: click.Context, parameter: click.Parameter, text: str | None) -> tuple[int, ...]:
    if text is None:
        return ()
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text}: one or two whole numbers, as in 10 or 8,4") from None


def _names(context: click.Context, parameter: click.Parameter, text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


@click.command("train")
@click.argument("sources", metavar="RECORDING...", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--structure",
    type=click.Choice(["auto", "gated", "narx", "static", "residual"]),
    default="auto",
    show_default=True,
    help="auto: from recordings, a static network added to the identified model, if that predicts held-out data "
    "better, else the identified model alone; with --from-model, gated. gated: with a state that does not change at "
    "rest. narx: its past torques are inputs. static: no state. residual: a static network added to a model of the "
    "library.",
)
@click.option(
    "--hidden",
    metavar="N[,N]",
    callback=_numbers,
    help="Number of tanh units of one or two layers; not with auto.  [default: 10; of a residual 4]",
)
@click.option(
    "--inputs",
    default="",
    metavar="NAME,NAME",
    callback=_names,
    help="Inputs besides the velocity: position, load_torque, temperature. With auto those that lower the error on "
    "held-out data are found.",
)
@option_validate
@click.option(
    "--from-model",
    "from_model",
    metavar="FILE_OR_NAME",
    shell_complete=complete_model,
    help="Learn this model instead of recordings, along a designed excitation.",
)
@click.option(
    "--samples",
    type=click.IntRange(min=1000),
    default=20000,
    show_default=True,
    help="With --from-model: number of samples.",
)
@click.option(
    "--period",
    type=float,
    default=1e-3,
    show_default=True,
    metavar="S",
    help="With --from-model: sampling period.",
)
@click.option(
    "--speed",
    type=float,
    metavar="V",
    help="With --from-model: top speed.  [default: ten Stribeck velocities]",
)
@click.option(
    "--base",
    metavar="FILE",
    type=click.Path(),
    help="Model file with the mechanics of the axis and, for a residual, its friction. Without it, both are identified "
    "first.",
)
@click.option("--linear", is_flag=True, help="A linear axis; --base or a recording of run says it itself.")
@recording_options
@option_lowpass
@result_options
@option_verbose
@option_json
def command(**options: Any) -> int:
    """Train a network on the friction of an axis, with the Levenberg-Marquardt method.

    From recordings, the axis is identified first, and a network learns what the identified model leaves. It is kept
    only if it predicts held-out data better than the models of the library; otherwise the model file holds the
    identified model.

    With any other --structure than auto the network is trained in any case. The network is trained and judged in free
    run, as it will be used: its own past outputs are fed back. The best network on data that it was not trained on is
    kept. Ctrl-C stops the training and keeps the best network so far.
    """
    from friction_hil.cli.work.train import train  # imported here: --help must not wait for numba

    return train(**options)
