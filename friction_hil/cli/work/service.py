"""The work of ``friction-hil service``."""

import os
import shutil
import sys
from dataclasses import asdict
from pathlib import Path

from friction_hil import service
from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import say
from friction_hil.service.install import Installation, services


def install(*, name: str, config: Path, root: Path, force: bool, as_json: bool) -> int:
    """Install a service, and say what was written and what comes next."""
    done = service.install(name, config, root.absolute(), executable(), overwrite=force)
    _print(done, as_json=as_json)
    if as_json:
        return 0
    if done.to_run:
        say(
            f"next, where systemd runs: the commands above, then systemctl enable --now friction-hil@{name}",
            stderr=False,
        )
    else:
        say(f"next: systemctl enable --now friction-hil@{name}; it waits, and enables no axis", stderr=False)
    say(f"then: friction-hil start {name}; its axes move", stderr=False)
    return 0


def remove(*, name: str, root: Path, as_json: bool) -> int:
    """Remove a service, and say what was removed."""
    _print(service.remove(name, root.absolute()), as_json=as_json)
    return 0


def status(*, name: str | None, as_json: bool) -> int:
    """Print the state of services; return 1 unless each is active."""
    names = services(Path("/")) if name is None else [name]
    states = {each: service.service_state(each) for each in names}
    if as_json:
        print_json({"services": {each: asdict(state) for each, state in states.items()}})
    elif not states:
        say("no service is installed", stderr=False)
    else:
        for each, state in states.items():
            say(_line(each, state), stderr=False)
    return 0 if all(state.active == "active" for state in states.values()) else 1


def executable() -> str:
    """Return the absolute path of the command that is running, without resolving the links of an environment."""
    found = shutil.which(sys.argv[0]) or shutil.which("friction-hil") or sys.argv[0]
    return os.path.abspath(found)


def _print(done: Installation, *, as_json: bool) -> None:
    if as_json:
        print_json(
            {
                "written": list(map(str, done.written)),
                "removed": list(map(str, done.removed)),
                "kept": list(map(str, done.kept)),
                "commands": done.commands,
                "to_run": done.to_run,
            }
        )
        return
    for word, paths in (("written", done.written), ("removed", done.removed), ("kept", done.kept)):
        for path in paths:
            say(f"{word}: {path}", stderr=False)
    for command in done.commands:
        say(f"done: {command}", stderr=False)
    for command in done.to_run:
        say(f"not done, systemd does not run there: {command}", stderr=False)


def _line(name: str, state: service.ServiceState) -> str:
    if not state.is_loaded:
        return f"{name}: systemd knows no such service"
    pid = "" if state.pid is None else f", process {state.pid}"
    restarts = f", {state.restarts} restarts" if state.restarts else ""
    ended = "" if state.result == "success" else f"; it ended by {state.result}, status {state.exit_status}"
    said = f": {state.status}" if state.status else ""
    return f"{name}: {state.active} ({state.sub}{pid}{restarts}){said}{ended}"
