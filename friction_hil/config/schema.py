"""Top level of the configuration file: keys with meaning, unit, default and bounds."""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal, Self

from pydantic import PrivateAttr, model_validator

from friction_hil.checked_yaml.messages import Mistake, refuse
from friction_hil.checked_yaml.section import Section, key
from friction_hil.config.arm import ArmConfig, arm_mistakes
from friction_hil.config.axis import AxisConfig, Name
from friction_hil.config.bus import BusConfig
from friction_hil.config.live import LiveConfig
from friction_hil.config.own_loop import OWN_LOOP
from friction_hil.config.recording import RecordingConfig
from friction_hil.config.simulation import SimulationConfig, mechanism_mistakes
from friction_hil.drive.driver import OptionChecks
from friction_hil.ros import JOINT_STATES


class Realtime(Section):
    """Scheduling of the loop."""

    priority: int = key("SCHED_FIFO priority; 0: ordinary scheduling", default=80, ge=0, le=99)
    spin_us: int = key("busy waiting before each deadline, to reduce the wake-up latency", "µs", default=200, ge=0)
    max_missed: int = key(
        "number of consecutive periods, missed or without feedback, that are bridged before a fault",
        default=10,
        ge=1,
        le=1_000_000,
    )


class Configuration(Section):
    """Configuration of ``run``, ``simulate`` and ``tune``."""

    version: Literal[1] = key("version of this format: 1")
    period_s: float = key("period of the loop", "s", ge=1e-4, le=1)
    bus: BusConfig | None = key("CAN bus; not needed for drives on serial lines", default=None)
    axes: dict[Name, AxisConfig] = key("axes by name", min_length=1)
    arm: ArmConfig | None = key("the arm that axes move", default=None)
    recording: RecordingConfig | None = key("recording of the run", default=None)
    live: LiveConfig | None = key("live data over the network", default=None)
    enable_timeout_s: float = key(
        "time within which all drives must be enabled; longer for slow brakes or charging",
        "s",
        default=5.0,
        ge=1,
        le=60,
    )
    realtime: Realtime = key("scheduling of the loop", default=Realtime())
    simulation: SimulationConfig | None = key("what the simulated drives of several axes share", default=None)

    _source_path: Path | None = PrivateAttr(default=None)
    _lacks_period: bool = PrivateAttr(default=False)

    @property
    def source_path(self) -> Path | None:
        """Path of the file from which this was loaded; relative paths of drivers start in its directory."""
        return self._source_path

    @property
    def lacks_period(self) -> bool:
        """True if the file has no period, which the program with the loop then gives: ``period_s`` is a stand-in."""
        return self._lacks_period

    @property
    def is_own_loop(self) -> bool:
        """True if an axis has no driver: they are those of a loop of the user's own."""
        return any(axis.driver == OWN_LOOP for axis in self.axes.values())

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(self, _mistakes(self))
        return self


def _mistakes(configuration: Configuration) -> Iterator[Mistake]:
    """Check axes and bus against each other; drivers add their own checks.

    ``Options.check(axes, bus)`` and ``Options.check_timing(axes, period_s, max_missed)`` yield (axis, key, message).
    """
    period_us = 1e6 * configuration.period_s
    if configuration.realtime.spin_us >= period_us:
        yield ("realtime", "spin_us"), f"must be below the period, {period_us:g} µs"
    recording = configuration.recording
    if recording is not None and recording.ros and JOINT_STATES in configuration.axes:
        yield ("axes", JOINT_STATES), "is the name of a topic of recording.ros, too: give the axis another name"
    is_sidecar = configuration.bus is not None and configuration.bus.role == "sidecar"
    for name, axis in configuration.axes.items():
        if is_sidecar and axis.trajectory.kind != "master":
            text = "must be 'master' with bus.role: sidecar, where another controller moves the axis"
            yield ("axes", name, "trajectory", "kind"), text
        elif axis.trajectory.kind == "master" and not is_sidecar and axis.driver != OWN_LOOP:
            text = "'master' needs bus.role: sidecar; without it the daemon itself moves the axis"
            yield ("axes", name, "trajectory", "kind"), text
        highest = 0.5 / configuration.period_s
        for field in ("frequency", "high_hz"):
            frequency = getattr(axis.trajectory, field, None) or 0.0
            if frequency >= highest:
                text = f"must be below half of the set-points per second, {highest:g} Hz, not {frequency:g}"
                yield ("axes", name, "trajectory", field), text
    if configuration.simulation is not None:
        yield from mechanism_mistakes(configuration.simulation.mechanism, configuration.axes)
    if configuration.arm is not None:
        yield from arm_mistakes(configuration.arm, configuration.axes)
    by_driver: dict[str, dict[str, AxisConfig]] = {}
    for name, axis in configuration.axes.items():
        by_driver.setdefault(axis.driver, {})[name] = axis
    for axes in by_driver.values():
        options = type(next(iter(axes.values())).options)
        assert issubclass(options, OptionChecks)  # load_driver sees to it
        found = [
            *options.check(axes, configuration.bus),
            *options.check_timing(axes, configuration.period_s, configuration.realtime.max_missed),
        ]
        for name, field, message in found:
            yield ("axes", name, *field.split(".")), message
