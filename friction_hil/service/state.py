"""State of a service, from the service manager."""

import subprocess
from dataclasses import dataclass

from friction_hil.errors import FrictionHilError

_KEYS = ("LoadState", "ActiveState", "SubState", "StatusText", "MainPID", "NRestarts", "Result", "ExecMainStatus")
_PATIENCE_S = 10.0


@dataclass(frozen=True, slots=True)
class ServiceState:
    """State of a service as systemd reports it."""

    is_loaded: bool  # systemd has read the unit
    active: str  # its ActiveState: ``active``, ``inactive``, ``failed``, ...
    sub: str  # its SubState
    status: str  # text that the daemon has given
    pid: int | None  # of the daemon
    restarts: int  # by systemd
    result: str  # why it ended: ``success``, ``exit-code``, ``watchdog``, ``signal``, ...
    exit_status: int  # exit status, or signal, with which it ended last


def service_state(name: str) -> ServiceState:
    """Ask systemd about the service ``name``; a `FrictionHilError`: systemd does not answer here."""
    command = ["systemctl", "show", f"friction-hil@{name}.service", f"--property={','.join(_KEYS)}"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise FrictionHilError(f"the state of the service is unknown: systemctl did not answer ({error})") from None
    if done.returncode:
        raise FrictionHilError(f"the state of the service is unknown: {done.stderr.strip()}")
    return parse(done.stdout)


def parse(text: str) -> ServiceState:
    """Return the state from the lines ``KEY=VALUE`` of ``systemctl show``."""
    values = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)
    pid = int(values.get("MainPID") or 0)
    return ServiceState(
        is_loaded=values.get("LoadState") == "loaded",
        active=values.get("ActiveState", "unknown"),
        sub=values.get("SubState", "unknown"),
        status=values.get("StatusText", ""),
        pid=pid or None,
        restarts=int(values.get("NRestarts") or 0),
        result=values.get("Result", "success"),
        exit_status=int(values.get("ExecMainStatus") or 0),
    )
