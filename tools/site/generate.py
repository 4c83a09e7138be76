"""Write the pages of the site that come from the code: all messages, and the Python interface."""

import importlib
import inspect
from pathlib import Path

import friction_hil
from friction_hil.doctor.explanations import explanations

FOLDER = Path("out/generated")
NAMES = (*friction_hil.__all__, "drive")  # the last one for those who write a driver


def main() -> None:
    """Write both pages."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    (FOLDER / "messages.md").write_text("\n".join(messages()) + "\n", encoding="utf-8")
    (FOLDER / "api.md").write_text("\n".join(interface()) + "\n", encoding="utf-8")


def messages() -> list[str]:
    """Return the lines of the page of all codes, which `friction-hil explain` prints too."""
    lines = ["# Messages", "", "A message ends in its code; `friction-hil explain FH-113` prints its row.", ""]
    lines += ["| code | message | cause | remedy |", "|---|---|---|---|"]
    return lines + [
        "| " + " | ".join((code, *(text.replace("|", r"\|") for text in each))) + " |"
        for code, each in explanations().items()
    ]


def interface() -> list[str]:
    """Return the lines of the page of all public names."""
    lines = ["# Python interface", ""]
    for name in sorted(NAMES, key=str.lower):
        each = importlib.import_module("friction_hil.drive") if name == "drive" else getattr(friction_hil, name)
        kind = "module" if inspect.ismodule(each) else "class" if inspect.isclass(each) else "function"
        target = each.__name__ if kind == "module" else f"friction_hil.{name}"
        lines += [f"## friction_hil.{name}", "", "```{eval-rst}", f".. auto{kind}:: {target}"]
        if kind != "function":
            lines += ["   :members:", "   :imported-members:" if kind == "module" else "   :inherited-members:"]
        lines += ["```", ""]
    return lines


if __name__ == "__main__":
    main()
