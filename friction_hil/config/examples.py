"""The example configurations: in a wheel they are data of this package, in a clone the folder ``config``."""

import re
from pathlib import Path

from friction_hil.checked_yaml import text as yaml_text
from friction_hil.config.new_file import SCHEMA_FILE
from friction_hil.errors import UsageError, choices

_PACKAGED = Path(__file__).parents[1] / "examples"
_IN_CLONE = Path(__file__).parents[2] / "config"


def examples() -> dict[str, Path]:
    """Return the paths of the example configurations by name; a `UsageError`: this installation has none."""
    folder = _PACKAGED if _PACKAGED.is_dir() else _IN_CLONE
    found = {path.stem: path for path in sorted(folder.glob("*.yaml"))}
    if not found:
        raise UsageError(f"this installation of friction_hil has no examples: {_PACKAGED} is missing")
    return found


def example_models() -> dict[str, Path]:
    """Return the paths of the example model files by name; a `UsageError`: this installation has none."""
    folder = next(iter(examples().values())).parent / "models"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def summary(path: Path) -> str:
    """Return the first sentence of an example's comment."""
    lines = path.read_text(encoding="utf-8").splitlines()
    comment = [line.removeprefix("#").strip() for line in lines if line.startswith("#") and "$schema" not in line]
    words = " ".join(comment).strip()
    return re.split(r"(?<=[.!])\s", words, maxsplit=1)[0]


def copied(name: str, target: Path) -> dict[Path, str]:
    """Return the text of an example, and of the model files that it names, by the paths that they get.

    Comments that name the example name the copy. ``target``: path of the copy. Raises `UsageError`: there is no example
    of this name; the message lists them.
    """
    known = examples()
    if name not in known:
        raise UsageError(f"--example: no example is called {name!r}; {choices(name, known)}")
    source = known[name]
    text = source.read_text(encoding="utf-8")
    models = {axis["model"] for axis in yaml_text.read(source).value["axes"].values() if isinstance(axis["model"], str)}
    copies = {target.parent / model: (source.parent / model).read_text(encoding="utf-8") for model in sorted(models)}
    text = _renamed(text, f"config/{source.name}", str(target))
    text = text.replace("$schema=schema.json", f"$schema={SCHEMA_FILE}")
    return {target: text, **copies}


def _renamed(text: str, old: str, new: str) -> str:
    """Replace a file name in commands; the explanations after them stay in their column if there is room."""

    def command(found: re.Match[str]) -> str:
        words = new + found[1]
        return words if not found[2] else f"{words}{'':{max(2, len(found[0]) - len(words))}}"

    return re.sub(re.escape(old) + r"((?: ?[^ \n])*)( {2,})?", command, text)
