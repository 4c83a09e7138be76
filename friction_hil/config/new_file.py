"""Text of a new configuration: the keys that a newcomer needs, each with its meaning; all others have defaults.

Meanings, units and defaults are those of the sections; a driver adds its own keys by the classmethod ``new_keys``, see
`friction_hil.drive.Driver`.
"""

import math
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from friction_hil.config.annotated import FILL_IN, Page
from friction_hil.config.axis import AxisConfig, AxisLimits, Compensation, Controller
from friction_hil.config.bus import MULTICAST, BusConfig
from friction_hil.config.drivers import load_driver
from friction_hil.config.own_loop import OWN_LOOP
from friction_hil.config.recording import RecordingConfig
from friction_hil.config.schema import Configuration, Realtime
from friction_hil.config.trajectories import AxisExperiment, Sine
from friction_hil.errors import UsageError, choices
from friction_hil.friction import describe
from friction_hil.models import library
from friction_hil.models.model_file import NOT_IDENTIFIED

SCHEMA_FILE = "friction_hil.schema.json"
_MODES = ("csp", "csv", "cst")
_SPEED_FRACTION = 0.5  # of the velocity limit, reached by the trajectory
_EXPERIMENT_FRACTION = 0.6  # of the velocity limit, reached by `tune`
_ERROR_FRACTIONS = (0.1, 0.5)  # of the travel, limit of the following error; loops over the bus (cst) are softer
_HIGHEST_HZ = 0.5
_MISSED_IN_SIMULATION = 20  # periods: nothing real moves meanwhile, and the drives compute on the same computer
_OF_POSITION = ("ripple",)  # modifiers that belong to the other axis alone
_FOREIGN_GAIN = 0.5  # of a model of another axis, whose friction may be much higher than that of this one
_LOWER, _ASSUMED = ("coulomb", "static"), 0.9  # of the simulated friction, in the model of a simulated axis


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is known about a machine whose configuration is to be written; None where it is not known."""

    driver: str = "canopen"
    bus: str | None = None  # CAN bus as ``can0`` or ``INTERFACE:CHANNEL[:PORT]``; of a serial driver the port
    bitrate: int | None = None  # of the CAN bus, or baud rate of the line
    node: str | None = None  # address of the drive on the bus or line
    description: str | None = None  # of a serial drive
    mode: str | None = None
    torque: float | None = None  # limit, N m (N)
    velocity: float | None = None  # limit, rad/s (m/s)
    travel: float | None = None  # distance from the present position that the axis may move to either side, rad (m)
    is_linear: bool = False
    is_simulated: bool = False  # the drive is to be simulated on this machine: what is not known is chosen
    port: int = 43113  # UDP port of a simulated CAN bus
    like: str | None = None  # actuator of `friction_hil.models.library` whose friction the model has to begin with
    path: Path = Path("machine.yaml")  # of the configuration; those in it are relative to its folder

    @property
    def name(self) -> str:
        """Name of the configuration without suffix, for files that belong to it."""
        return self.path.stem


@dataclass(frozen=True, slots=True)
class DriverKeys:
    """Keys of a driver in a new configuration."""

    keys: dict[str, Any]  # values by name, also in groups; `FILL_IN` where only the user can know it
    # comments that replace the meaning of a key, by its name; of a key in a group ``line.port``
    notes: dict[str, str] = field(default_factory=dict)
    modes: tuple[str, ...] = _MODES  # that the drive has, the best first
    period_s: float = 1e-3
    bus: dict[str, Any] | None = None  # section ``bus``


def new_configuration(wanted: Wanted) -> str:
    """Return the text of a configuration of one axis.

    Raises `UsageError`: there is no such driver, mode, description or actuator, or the driver has no such option.
    """
    if wanted.is_simulated and wanted.is_linear:
        raise UsageError("--simulated: the simulated drive is rotary; leave --linear out")
    if wanted.like is not None:
        _refuse_other_kind(wanted, wanted.like)
    if wanted.driver == OWN_LOOP:
        raise UsageError(
            "--driver own_loop: axes of a loop of your own have no drive; 'friction-hil config new --example own_loop' "
            "copies a configuration of two"
        )
    driver = load_driver(wanted.driver)
    given = driver.new_keys(wanted) or _required_keys(driver.Options)
    if wanted.mode is not None and wanted.mode not in given.modes:
        raise UsageError(f"--mode: this drive has no mode {wanted.mode!r}; {choices(wanted.mode, given.modes)}")
    mode = wanted.mode or given.modes[0]
    page = Page(is_linear=wanted.is_linear)
    page.lines += _header(wanted)
    page.key(0, "version", 1, "version of this format")
    page.of(0, Configuration, "period_s", given.period_s)
    page.blank()
    if given.bus is not None:
        page.key(0, "bus", None)
        for name, value in given.bus.items():
            page.of(1, BusConfig, name, value)
        page.blank()
    page.key(0, "axes", None)
    page.key(1, "x", None, "name of the axis: small letters, digits and _")
    page.of(2, AxisConfig, "driver", wanted.driver)
    page.group(2, driver.Options, given.keys, given.notes)
    page.blank()
    page.of(2, AxisConfig, "mode", mode)
    page.blank()
    _motion(page, wanted, mode)
    if wanted.is_simulated:
        page.blank()
        page.key(2, "simulation", {}, "the simulated drive, all at its defaults; remove it for a real drive")
        page.blank()
        page.key(0, "realtime", None)
        page.of(1, Realtime, "max_missed", _MISSED_IN_SIMULATION, "; twice the default, for a busy computer")
    page.blank()
    page.key(0, "recording", None)
    page.of(1, RecordingConfig, "path", f"out/{wanted.name}.mcap")
    return "\n".join(page.lines) + "\n"


def parse_bus(wanted: Wanted) -> dict[str, Any]:
    """Return the section ``bus`` of a CAN bus given as ``can0`` or ``INTERFACE:CHANNEL[:PORT]``.

    Raises `UsageError`: the interface or the channel is empty.
    """
    if wanted.bus is None and wanted.is_simulated:
        return {"interface": "udp_multicast", "channel": MULTICAST, "port": wanted.port}
    if wanted.bus is None:
        return {"interface": "socketcan", "channel": FILL_IN, "bitrate": wanted.bitrate}
    interface, colon, channel = wanted.bus.partition(":")
    if not colon:
        interface, channel = "socketcan", wanted.bus
    if not interface or not channel:
        raise UsageError(f"--bus {wanted.bus}: must be a CAN interface such as can0, or INTERFACE:CHANNEL[:PORT]")
    section: dict[str, Any] = {"interface": interface, "channel": channel}
    if interface == "udp_multicast" and ":" in channel:
        section["channel"], _, port = channel.rpartition(":")
        section["port"] = int(port) if port.isdecimal() else port
    if wanted.bitrate is not None or interface != "udp_multicast":
        section["bitrate"] = wanted.bitrate
    return section


def as_address(node: str | None, *, is_simulated: bool) -> Any:
    """Return the address of a drive as a value of YAML."""
    if node is None:
        return 1 if is_simulated else FILL_IN
    return int(node) if node.isdecimal() else node


def _required_keys(options: type[BaseModel]) -> DriverKeys:
    """Return the keys of a driver that does not say which a new file needs."""
    return DriverKeys({name: FILL_IN for name, info in options.model_fields.items() if info.is_required()})


def _header(wanted: Wanted) -> list[str]:
    file = shlex.quote(wanted.path.name)
    steps = {f"config check {file}": "mistakes, and what is left to fill in"}
    if wanted.is_simulated:
        steps[f"run {file} --simulate --duration 20"] = "compensate; the drive starts and ends with it"
        steps[f"simulate {file}"] = "the simulated drive alone, for other programs"
    else:
        steps[f"doctor {file}"] = "what stands between this machine and the drive"
        steps[f"run {file} --dry-run --duration 5"] = "listen and compute, without commanding the drive"
        tune = "identify the friction; writes the file that `model` names"
        steps[f"tune {file}" + (" --apply" if wanted.like else "")] = "identify the friction" if wanted.like else tune
        steps[f"run {file} --duration 20"] = "compensate"
    width = max(map(len, steps)) + 2
    what = (
        "One simulated drive."
        if wanted.is_simulated
        else "One drive. The axis moves! Choose limits and motion accordingly."
    )
    return [
        f"# yaml-language-server: $schema={SCHEMA_FILE}",
        "#",
        f"# {what}",
        "#",
        *(f"#   friction-hil {words:{width}}{purpose}" for words, purpose in steps.items()),
        "#",
        f"# Other keys have defaults: 'friction-hil config show {file}' prints them all. null: not given.",
        "",
    ]


def _motion(page: Page, wanted: Wanted, mode: str) -> None:
    """Write what says how far and how fast the axis may move, and what compensates its friction."""
    chosen = (0.3, 10.0, 1.0) if wanted.is_simulated else (None, None, None)
    asked = (wanted.torque, wanted.velocity, wanted.travel)
    torque, velocity, travel = (b if a is None else a for a, b in zip(asked, chosen, strict=True))
    page.key(2, "limits", None, "checked in every cycle")
    page.of(3, AxisLimits, "torque", _or_fill_in(torque))
    page.of(3, AxisLimits, "torque_slew", None if torque is None else _rounded(1e3 * torque))
    page.of(3, AxisLimits, "velocity", _or_fill_in(velocity), "; a higher one is a fault")
    error = None if travel is None else _rounded(_ERROR_FRACTIONS[mode == "cst"] * travel)
    page.of(3, AxisLimits, "following_error", error, "; a larger one is a fault")
    page.of(3, AxisLimits, "position", None, ", as [-2.0, 2.0]; a position outside is a fault")
    page.blank()
    if wanted.is_simulated:
        _simulated_model(page)
    elif wanted.like is not None:
        _foreign_model(page, wanted.like)
    else:
        note = "friction model: a file beside this one; 'friction-hil tune' makes it"
        page.key(2, "model", f"{wanted.name}_x.yaml", note)
    page.blank()
    page.key(2, "compensation", None)
    page.of(3, Compensation, "gain", 0.9 if wanted.like is None else _FOREIGN_GAIN)
    page.of(3, Compensation, "baseline_s", 4.0)
    if mode == "cst":
        gains = (20.0, 0.03, 1.0) if wanted.is_simulated else (FILL_IN, FILL_IN, 0.0)
        page.blank()
        page.key(2, "controller", None, "the daemon closes the loops; softer than a drive could: the bus delays them")
        for name, gain in zip(("position_gain", "velocity_gain", "integral_hz"), gains, strict=True):
            page.of(3, Controller, name, gain)
    amplitude = None if travel is None else _rounded(0.5 * travel)
    frequency: Any = FILL_IN
    if amplitude is not None and velocity is not None:
        frequency = _rounded(min(_HIGHEST_HZ, _SPEED_FRACTION * velocity / (math.tau * amplitude)))
    page.blank()
    page.key(2, "trajectory", None, "motion of 'friction-hil run'; it begins at the present position")
    page.key(3, "kind", "sine", "or circle, triangle, experiment, hold; none (only in cst): the axis is moved by hand")
    page.of(3, Sine, "amplitude", _or_fill_in(amplitude))
    page.of(3, Sine, "frequency", frequency)
    page.blank()
    page.key(2, "experiment", None, "bounds of the motion of 'friction-hil tune'")
    speed = None if velocity is None else _rounded(_EXPERIMENT_FRACTION * velocity)
    page.of(3, AxisExperiment, "velocity", _or_fill_in(speed))
    page.of(3, AxisExperiment, "travel", _or_fill_in(travel))
    if wanted.is_linear:
        page.of(3, AxisExperiment, "axis", "linear")


def _simulated_model(page: Page) -> None:
    """Write a model whose friction is lower than that of the simulated drive."""
    percent = f"{1.0 - _ASSUMED:.0%}".replace("%", " %")
    page.key(
        2, "model", None, f"friction that the compensation assumes: {percent} lower than that of the simulated drive"
    )
    page.key(3, "axis", "rotary")
    page.key(3, "friction", None)
    page.key(4, "model", "lugre", "'friction-hil models' lists them all")
    page.key(4, "parameters", None)
    lugre = describe("lugre")
    for parameter in lugre.parameters:
        value = lugre.example[parameter.name]
        if parameter.name in _LOWER:
            value = _rounded(_ASSUMED * value)
        page.key(5, parameter.name, value, f"{parameter.unit}; {parameter.meaning}")
    page.key(3, "mechanics", {"inertia": 2e-4}, "kg m^2")


def _refuse_other_kind(wanted: Wanted, like: str) -> None:
    if wanted.is_simulated:
        raise UsageError("--simulated: the simulated drive has a model of its own; leave --like out")
    kind = library.load(like).axis
    if (kind == "linear") != wanted.is_linear:
        raise UsageError(f"--like {like}: that axis is {kind}; {'give' if kind == 'linear' else 'leave out'} --linear")


def _foreign_model(page: Page, like: str) -> None:
    """Write the friction of another axis, without its rig's mechanics, marked as such."""
    actuator, friction = library.describe(like), library.load(like).friction
    flag = f"{NOT_IDENTIFIED} on this axis: friction of {like}"
    page.key(2, "model", None, f"{flag} ({actuator.what}); 'friction-hil tune' identifies that of this axis")
    page.key(3, "axis", actuator.axis)
    page.key(3, "friction", None)
    page.key(4, "model", friction.model)
    page.key(4, "parameters", friction.parameters)
    if modifiers := {name: value for name, value in friction.modifiers.items() if name not in _OF_POSITION}:
        page.key(4, "modifiers", modifiers)
    page.key(3, "fit", {"flags": [flag]}, "remove it once the friction is that of this axis")


def _or_fill_in(value: Any) -> Any:
    return FILL_IN if value is None else value


def _rounded(value: float) -> float:
    """Return a number with two digits."""
    return float(f"{value:.2g}")
