"""What the shell's Tab key completes besides commands, options and files: friction models and axes."""

from collections.abc import Iterable
from pathlib import Path

import click
from click.shell_completion import CompletionItem

# The models stand here, so that Tab waits for no import. No commas: fish would end the description there.
MODELS = {
    "armstrong": "seven parameters: frictional lag and a break-away level that rises with time",
    "bouc_wen": "smooth hysteresis of gears and harmonic drives",
    "coulomb": "Coulomb level with break-away level and viscous friction",
    "dahl": "presliding spring that yields towards the Coulomb level",
    "elasto_plastic": "LuGre with an elastic range below break-away",
    "gms": "Maxwell-slip elements: presliding hysteresis with non-local memory",
    "karnopp": "Stribeck friction that sticks exactly inside a velocity band",
    "lugre": "bristle model: presliding with Stribeck curve and frictional lag",
    "power_law": "Coulomb level plus a power of the velocity",
    "stribeck": "static map with a Stribeck curve",
    "table": "points of torque over speed per direction",
}
_LARGEST_CONFIGURATION = 1 << 20  # bytes; a larger file is none


def complete_model(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete the name of a model; where none begins so, the name of a file."""
    found = [CompletionItem(name, help=text) for name, text in MODELS.items() if name.startswith(incomplete)]
    return found or [CompletionItem(incomplete, type="file")]


def complete_models(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete the last name of a list of models, ``coulomb,lug``; names that stand before it are left out."""
    before, comma, last = incomplete.rpartition(",")
    return [
        CompletionItem(f"{before}{comma}{name}", help=text)
        for name, text in MODELS.items()
        if name.startswith(last) and name not in before.split(",")
    ]


def complete_axis(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete the name of an axis of the configuration or recording that stands on the command line already."""
    # behind an option that has no value yet, click leaves the arguments unparsed
    given = [*context.args, *(context.params.get(name) for name in ("config", "source", "sources"))]
    paths = [path for each in given if each for path in (each if isinstance(each, tuple | list) else (each,))]
    names = dict.fromkeys(name for path in paths for name in _axes(Path(path)))
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def complete_daemon(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Complete the name of a daemon; where the command takes a file too and none begins so, that of a file."""
    from friction_hil.daemon.control.names import running  # imported here: only this needs it

    found = [CompletionItem(name) for name, _ in running() if name.startswith(incomplete)]
    return found if found or parameter.name != "config" else [CompletionItem(incomplete, type="file")]


def _axes(path: Path) -> Iterable[str]:
    """Return the names of the axes in a file; none if it cannot be read: Tab has no place for a message."""
    try:
        if path.suffix == ".mcap":
            return _axes_of_recording(path)
        if path.stat().st_size <= _LARGEST_CONFIGURATION:
            return _axes_of_configuration(path)
    except Exception:  # noqa: BLE001 - whatever is wrong with the file, the command itself reports it
        return ()
    return ()


def _axes_of_configuration(path: Path) -> list[str]:
    import yaml  # imported here: only this needs it

    content = yaml.load(path.read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    axes = content.get("axes") if isinstance(content, dict) else None
    return [str(name) for name in axes] if isinstance(axes, dict) else []


def _axes_of_recording(path: Path) -> list[str]:
    from mcap.reader import make_reader  # imported here: only this needs it

    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    topics = [] if summary is None else [channel.topic for channel in summary.channels.values()]
    # an axis has the topic of its name; the others are /x/state and /events
    return sorted(topic[1:] for topic in topics if topic.rfind("/") == 0 and topic != "/events")
