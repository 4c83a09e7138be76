"""``friction-hil explain``: cause and remedy of a message."""

import json

import click

from friction_hil.cli.options import option_json


@click.command("explain")
@click.argument("code", required=False)
@option_json
def command(code: str | None, as_json: bool) -> int:
    """Print message, cause and remedy of CODE, such as FH-113; without CODE, of all codes."""
    from friction_hil.cli.work.tables import new_table, print_table, prose  # imported here: --help must not wait for it
    from friction_hil.doctor.explanations import explanations
    from friction_hil.errors import UsageError

    shown = explanations()
    if code is not None:
        key = f"FH-{code.upper().removeprefix('FH-')}"
        if key not in shown:
            raise UsageError(f"no message has the code {code!r}; 'friction-hil explain' lists all")
        shown = {key: shown[key]}
    if as_json:
        click.echo(json.dumps({key: each._asdict() for key, each in shown.items()}))
    elif code is not None:
        for name, text in next(iter(shown.values()))._asdict().items():
            click.echo(f"{name}: {text}")
    else:
        table = new_table("code", prose("message"), prose("cause"), prose("remedy"))
        for key, each in shown.items():
            table.add_row(key, *each)
        print_table(table)
    return 0
