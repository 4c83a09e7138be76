"""A good configuration to be spoilt by tests, its mistakes, and a distribution with the drivers that it names."""

from pathlib import Path

import pytest
import yaml

from friction_hil.config import from_dict, load
from friction_hil.errors import ConfigurationError

FAKE_DRIVER = """
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field


class Wiring(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    pins: tuple[int, ...] = ()
    table: Path | None = None


class Options(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    node: int = Field(ge=1, le=9)
    gear: float = Field(1.0, gt=0, allow_inf_nan=False, json_schema_extra={"unit": "furlong"})
    is_inverted: bool = False
    table: Path | None = None
    wiring: Wiring = Wiring()

    @classmethod
    def check(cls, axes, bus):
        seen = set()
        for name, axis in axes.items():
            if axis.options.node in seen:
                yield name, "node", "has this node already"
            seen.add(axis.options.node)
            if bus is None:
                yield name, "driver", "needs a bus"


class Drives:
    Options = Options


class Simulation(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    rate_hz: float = 8000.0
    quirks: Wiring = Wiring()


class SimulatedDrives:
    Options = Simulation
"""

GOOD = """\
version: 1
period_s: 1e-3
bus:
  interface: udp_multicast
  channel: 239.74.163.2
  port: 43113
axes:
  x:
    driver: fake
    node: 1
    mode: csp
    limits:
      torque: 0.3
      torque_slew: 300.0
      velocity: 30.0
      following_error: 0.1
      position: [-10.0, 10]
    model:
      axis: rotary
      friction:
        model: lugre
        parameters:
          sigma0: 2000
          coulomb: 0.1
          stribeck_velocity: 0.1
          damping_velocity: .inf
      mechanics:
        inertia: 2e-4
    compensation:
      gain: 0.8
    shadows:
      - name: plain
        model:
          axis: rotary
          friction:
            model: coulomb
            parameters:
              coulomb: 0.1
    trajectory:
      kind: circle
      radius: 1.0
      frequency: 0.5
    simulation:
      rate_hz: 4000.0
recording:
  path: out/run.mcap
realtime:
  priority: 0
"""


def install(directory: Path) -> Path:
    """Lay a distribution with the drivers ``fake``, ``unsimulated`` and ``broken`` into ``directory``."""
    (directory / "fake_friction_drives.py").write_text(FAKE_DRIVER)
    metadata = directory / "fake_friction_drives-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: fake-friction-drives\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(
        "[friction_hil.drivers]\n"
        "fake = fake_friction_drives:Drives\n"
        "unsimulated = fake_friction_drives:Drives\n"
        "broken = fake_friction_drives.missing:Drives\n"
        "[friction_hil.simulated_drives]\n"
        "fake = fake_friction_drives:SimulatedDrives\n"
    )
    return directory


def good():
    return yaml.safe_load(GOOD.replace("1e-3", "0.001").replace("2e-4", "0.0002"))


def changed(**changes):
    """The good values with some of them replaced; names as ``axes__x__node``; None removes."""
    values = good()
    for name, value in changes.items():
        *steps, last = name.split("__")
        place = values
        for step in steps:
            place = place[step]
        if value is None:
            del place[last]
        else:
            place[last] = value
    return values


def problems_of(values):
    with pytest.raises(ConfigurationError) as caught:
        from_dict(values, "test")
    return {problem.field: problem.message for problem in caught.value.problems}


def outcome(path):
    """The configuration, or None, and the problems."""
    try:
        return load(path), ()
    except ConfigurationError as error:
        return None, error.problems


def problems_in(path, text):
    path.write_text(text)
    configuration, problems = outcome(path)
    assert configuration is None
    return problems
