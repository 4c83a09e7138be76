"""The work of ``friction-hil import``."""

from pathlib import Path

import click

from friction_hil.checked_yaml import text
from friction_hil.cli.output import print_json
from friction_hil.errors import UsageError
from friction_hil.models import foreign
from friction_hil.printable import on_one_line


def import_model(*, file: Path, source: str, joint: str | None, output: Path, force: bool, as_json: bool) -> None:
    """Write the model file, and say what is missing in it."""
    if not output.parent.is_dir():
        raise UsageError(f"--output {output}: there is no folder {output.parent} to write to; create it first")
    if output.is_dir():
        raise UsageError(f"--output {output} is a folder; name the model file to write, such as {output / 'axis.yaml'}")
    if output.exists() and not force:
        raise UsageError(f"{output} exists already; --force replaces it")
    found = foreign.read(file, source, joint)
    remarks = [f"Read from {file.name}, which does not state:", *(f"- {each}" for each in found.missing)]
    remarks += ["Remarks:", *(f"- {each}" for each in found.notes)] if found.notes else []
    comment = "".join(f"# {on_one_line(line)}\n" for line in remarks)
    output.write_text(f"{comment}\n{text.dump(found.content)}", encoding="utf-8")
    if as_json:
        print_json({"written": str(output), "model": found.content, "missing": found.missing, "notes": found.notes})
        return
    click.echo(f"{output}: {found.content['friction']['model']}")
    for line in remarks:
        click.echo(line)
