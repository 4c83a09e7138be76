"""Servo drives on durand as processes beside the daemon, with a log of what happened to them."""

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from tests.processes import write_configuration

ROOT = Path(__file__).parents[1]
PATIENCE_S = 30.0  # only ends a test that hangs
FRICTION = {"model": "coulomb", "parameters": {"coulomb": 0.02}}
MODEL = {"axis": "rotary", "friction": FRICTION, "mechanics": {"inertia": 2e-4}}
LIMITS = {"torque": 0.2, "torque_slew": 300.0, "velocity": 30.0, "following_error": 0.5, "position": [-4.0, 4.0]}
CONTROLLER = {"position_gain": 25.0, "velocity_gain": 0.03, "integral_hz": 4.0}
SINE = {"kind": "sine", "amplitude": 0.3, "frequency": 1.0, "ramp_s": 0.25}


def durand_configuration(
    folder: Path,
    *,
    period_s: float = 1e-3,
    nodes: tuple[int, ...] = (1,),
    max_missed: int | None = None,
    controller: dict[str, float] = CONTROLLER,
    **keys: Any,
) -> Path:
    """Write a configuration for drives on durand; ``keys`` are those of each axis, ``controller`` that in cst."""
    axes = {f"x{node}": {"node": node, "limits": LIMITS, "model": MODEL, "trajectory": SINE, **keys} for node in nodes}
    if keys.get("mode") == "cst":
        for axis in axes.values():
            axis["controller"] = controller
    path = write_configuration(folder, period_s=period_s, **axes)
    data = yaml.safe_load(path.read_text())
    for axis in data["axes"].values():
        del axis["simulation"]
    if max_missed is not None:
        data["realtime"]["max_missed"] = max_missed
    path.write_text(yaml.safe_dump(data))
    return path


@dataclass(frozen=True)
class Event:
    """Something that happened to a drive, at a time of CLOCK_MONOTONIC (or of the simulation)."""

    ns: int
    node: int
    what: str


@dataclass
class DurandDrives:
    """The process and its log."""

    process: "subprocess.Popen[str]"
    log: Path

    @property
    def events(self) -> list[Event]:
        lines = self.log.read_text().splitlines(keepends=True)
        return [Event(**json.loads(line)) for line in lines if line.endswith("\n")]

    @property
    def is_free(self) -> bool:
        """No drive has torque."""
        states = {event.node: event.what for event in self.events if event.what.endswith("torque")}
        return all(what.endswith("no torque") for what in states.values())

    def told(self, node: int = 1) -> list[str]:
        """All that happened to a node, in order."""
        return [event.what for event in self.events if event.node == node]

    def wait_for(self, is_wanted: Callable[[Event], bool]) -> Event:
        """Return the first event of a kind, as soon as it has happened."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            for event in self.events:
                if is_wanted(event):
                    return event
            time.sleep(0.01)
        raise AssertionError(f"it did not happen: {self.events}")


@contextlib.contextmanager
def durand_drives(configuration: Path, *options: object, is_paced_by_sync: bool = False) -> Iterator[DurandDrives]:
    """Servo drives on durand for every axis of a configuration."""
    data = yaml.safe_load(configuration.read_text())
    bus, log = data["bus"], configuration.with_suffix(".durand.jsonl")
    words = ["--group", bus["channel"], "--port", bus["port"], "--log", log, *options]
    for axis in data["axes"].values():
        words += ["--node", axis["node"]]
    if is_paced_by_sync:
        words += ["--sync-us", round(data["period_s"] * 1e6)]
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.peers.durand_servo", *map(str, words)],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "ready\n"
        yield DurandDrives(process, log)
    finally:
        process.stdin.close()
        process.wait(PATIENCE_S)
        process.stdout.close()
