"""Description of a drive, read from a YAML file: its signals, states and sequences."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal, Self, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator

from friction_hil.checked_yaml.files import read_section
from friction_hil.checked_yaml.messages import Mistake, refuse
from friction_hil.checked_yaml.text import FieldPath, resolve
from friction_hil.drive import DriveState
from friction_hil.errors import UsageError, choices
from friction_hil_drivers.serial_line import protocol
from friction_hil_drivers.serial_line.units import POSITIONS, TEMPERATURES, TORQUES, UNITS, VELOCITIES

STATES = {state.name.lower(): state for state in DriveState}
_UNITS_OF = {
    "position": POSITIONS,
    "velocity": VELOCITIES,
    "torque": TORQUES,
    "temperature": TEMPERATURES,
    "position_command": POSITIONS,
    "velocity_command": VELOCITIES,
    "torque_command": TORQUES,
}
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
StateName = Literal[
    "not_ready",
    "switch_on_disabled",
    "ready_to_switch_on",
    "switched_on",
    "operation_enabled",
    "quick_stop_active",
    "fault_reaction_active",
    "fault",
]


def _error_number(key: object) -> object:
    """Convert a key of ``errors``, which is text like all keys, as YAML converts a value."""
    try:
        number = resolve(key) if isinstance(key, str) else key
    except OverflowError:
        number = None
    if type(number) is not int:
        raise ValueError(
            "is no whole number; give the number of the signal error that the text explains, e.g. 16: or 0x10:"
        )
    return number


ErrorNumber = Annotated[int, BeforeValidator(_error_number)]


class Part(BaseModel):
    """Group of keys of a description."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Signal(Part):
    """Value of the drive; each protocol adds its address or format."""

    unit: str = Field("", description="unit of the drive's number times `scale`")
    scale: Finite = Field(1.0, description="factor from the drive's number to the unit, e.g. 0.1 for tenths")

    resolution: Positive | None = Field(
        None, description="smallest step of the drive's number; when not given, 1 for an integer"
    )

    @property
    def has_sign(self) -> bool:
        """True if the drive's number can be negative."""
        return True

    @property
    def step(self) -> float:
        """Smallest step of the drive's number."""
        return self.resolution or 1.0

    @property
    def counter_bits(self) -> int | None:
        """Width of the drive's number if that is an integer, which wraps; else None."""
        return None

    @property
    def bounds(self) -> tuple[int, int] | None:
        """Least and greatest number of the drive if its numbers are integers; else None."""
        return None

    @field_validator("unit")
    @classmethod
    def _is_known(cls, unit: str) -> str:
        if unit not in UNITS:
            raise ValueError(f"no such unit; {choices(unit, filter(None, UNITS))}")
        return unit

    @field_validator("scale")
    @classmethod
    def _is_not_zero(cls, scale: float) -> float:
        if scale == 0.0:
            raise ValueError("must not be zero")
        return scale


class Rule(Part):
    """Condition for a state: the masked bits of the signal have the value."""

    state: StateName
    signal: str = "status"
    mask: int | None = Field(None, ge=1, description="bits that are compared; all when not given")
    value: int | None = Field(None, description="number that they must equal")
    value_not: int | None = Field(None, description="number that they must not equal")
    meaning: str = Field("", description="what the number means, for messages: why the drive is in fault")

    @model_validator(mode="after")
    def _has_one(self) -> Self:
        if (self.value is None) == (self.value_not is None):
            raise ValueError("needs either value or value_not")
        number = self.value_not if self.value is None else self.value
        if self.mask is not None and number is not None and number & ~self.mask:
            raise ValueError(f"{number} has bits that are not in the mask {self.mask}: no masked number equals it")
        return self

    def fits(self, number: float) -> bool:
        """Return True if the drive's number fulfils the condition."""
        bits = int(number) if self.mask is None else int(number) & self.mask
        return bits == self.value if self.value is not None else bits != self.value_not


class Step(Part):
    """Values to write, and the state to wait for before the next step."""

    write: dict[str, Finite] = Field(min_length=1, description="numbers to write, by signal, in the drive's own units")
    until: StateName | None = Field(
        None, description="state that ends the step; it is written again in each cycle until then"
    )
    timeout_s: Positive = Field(1.0, description="time after which the drive is reported not to follow, s")


class ModeDescription(Part):
    """Commands of one mode, and its preparation."""

    commands: tuple[str, ...] = Field(min_length=1, description="signals that are written in each cycle")
    prepare: tuple[Step, ...] = Field((), description="steps that are written before the drive is enabled")


class WatchdogDescription(Part):
    """Communication watchdog of the drive: after a time without a command it drops its torque."""

    signal: str = Field(description="signal that sets the time")
    enable: tuple[Step, ...] = Field((), description="steps that are written after the time")
    read_back: tuple[str, ...] = Field(
        (), description="further signals on which it depends: each is read back whenever it has been written"
    )


class Description(Part):
    """Keys that all descriptions have; each protocol adds its own."""

    version: Literal[1]
    name: str
    sources: tuple[str, ...] = Field(min_length=1, description="manuals and files from which the description was taken")
    inferred: tuple[str, ...] = Field(
        (), description="signals that were not taken from a manual; reported at each start"
    )
    state_machine: Literal["cia402", "own"] = Field(
        "own", description="cia402: signals control and status are its control- and statusword"
    )
    states: tuple[Rule, ...] = Field((), description="rules for `own`; the first one that fits gives the state")
    modes: dict[Literal["csp", "csv", "cst"], ModeDescription] = Field(min_length=1)
    prepare: tuple[Step, ...] = Field((), description="steps that are written once at the start, in every mode")
    enable: tuple[Step, ...] = ()
    disable: tuple[Step, ...] = ()
    quick_stop: tuple[Step, ...] = Field((), description="steps of `disable` when not given")
    reset_fault: tuple[Step, ...] = ()
    watchdog: WatchdogDescription | None = None
    errors: dict[ErrorNumber, str] = Field({}, description="texts for the numbers of the signal error")

    def units(self) -> dict[str, Signal]:
        """Return the signals by name; each protocol has its own."""
        raise NotImplementedError

    def can_be_read(self, signal: str) -> bool:
        """Return True if a request reads the signal; each protocol has its own rule."""
        return signal in self.units()

    @property
    def watchdog_signals(self) -> frozenset[str]:
        """Signals on which the drive's watchdog depends; empty without one."""
        if self.watchdog is None:
            return frozenset()
        enabling = (name for step in self.watchdog.enable for name in step.write)
        return frozenset((self.watchdog.signal, *enabling, *self.watchdog.read_back))

    @property
    def sequences(self) -> dict[tuple[str, ...], tuple[Step, ...]]:
        """All steps of the description, by the path of their list in the file."""
        found: dict[tuple[str, ...], tuple[Step, ...]] = {
            (key,): getattr(self, key) for key in ("prepare", "enable", "disable", "quick_stop", "reset_fault")
        }
        found |= {("modes", mode, "prepare"): part.prepare for mode, part in self.modes.items()}
        if self.watchdog is not None:
            found["watchdog", "enable"] = self.watchdog.enable
        return found

    def steps(self) -> Iterator[tuple[FieldPath, Step]]:
        """Yield all steps, each with its path in the file."""
        for key, steps in self.sequences.items():
            for k, step in enumerate(steps):
                yield (*key, k), step

    def _scattered_steps(self, blocks: Callable[[tuple[str, ...]], Sequence[object]]) -> Iterator[Mistake]:
        """Yield steps whose signals lie in several blocks, so that no single request can write them."""
        for path, step in self.steps():
            if step.write.keys() <= self.units().keys() and len(blocks(tuple(step.write))) > 1:
                names = ", ".join(step.write)
                yield path, f"writes {names}, which do not lie side by side: make a step of each"

    def _unwritable_numbers(self) -> Iterator[Mistake]:
        signals = self.units()
        for path, step in self.steps():
            for name, number in step.write.items():
                bounds = signals[name].bounds if name in signals else None
                if bounds is not None and not (bounds[0] <= number <= bounds[1] and number.is_integer()):
                    text = f"{name} takes whole numbers from {bounds[0]} to {bounds[1]}, not {number:.12g}"
                    yield (*path, "write", name), text

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        refuse(self, self._mistakes())
        return self

    def _named(self) -> Iterator[tuple[FieldPath, str]]:
        """Yield the path in the file and the signal of each mention of a signal."""
        yield from ((("states", k), rule.signal) for k, rule in enumerate(self.states))
        yield from ((path, name) for path, step in self.steps() for name in step.write)
        yield from ((("modes", mode), name) for mode, part in self.modes.items() for name in part.commands)
        yield from ((("inferred", k), name) for k, name in enumerate(self.inferred))
        if self.watchdog is not None:
            yield ("watchdog",), self.watchdog.signal
            yield from ((("watchdog", "read_back", k), name) for k, name in enumerate(self.watchdog.read_back))

    def _mistakes(self) -> Iterator[Mistake]:
        signals = self.units()
        for path, name in self._named():
            if name not in signals:
                yield path, f"names the signal {name!r}; {choices(name, signals)}"
        yield from self._unwritable_numbers()
        for name, units in _UNITS_OF.items():
            if name in signals and signals[name].unit not in units:
                text = f"{name} is in {signals[name].unit or 'no unit'}; it may be in {', '.join(units)}"
                yield ("signals", name), text
            is_directed = not name.startswith(("position", "temperature"))
            if name in signals and is_directed and not signals[name].has_sign:
                yield ("signals", name), f"{name} has no sign: torques and velocities have two directions"
        if self.watchdog is not None and self.watchdog.signal in signals:
            signal = signals[self.watchdog.signal]
            if signal.unit != "s" or signal.scale <= 0.0:
                text = f"the watchdog's signal {self.watchdog.signal} must be in s, with a positive scale"
                yield ("signals", self.watchdog.signal), text
        if self.watchdog is not None:
            for k, name in enumerate(self.watchdog.read_back):
                if name in signals and not self.can_be_read(name):
                    yield ("watchdog", "read_back", k), f"nothing reads {name} without writing something"
        if "position" not in signals:
            yield ("signals",), "there is no signal position"
        for mode, part in self.modes.items():
            for name in part.commands:
                if name in signals and name not in protocol.COMMANDS:
                    text = f"commands {name}; possible commands are {', '.join(protocol.COMMANDS)}"
                    yield ("modes", mode), text
            needed = ("torque_command", "position_command") if mode == "csp" else ("torque_command",)
            if not set(needed) & set(part.commands):
                yield ("modes", mode), f"has no {' or '.join(needed)}: friction could not be compensated"
        if self.state_machine == "cia402":
            yield from (
                (("signals",), f"cia402 needs the signal {n}") for n in ("control", "status") if n not in signals
            )
            if self.states or self.enable or self.disable or self.quick_stop or self.reset_fault:
                yield ("state_machine",), "cia402 brings its own states and sequences"
        elif not (self.states and self.enable and self.disable):
            yield (), "states, enable and disable are needed, or state_machine: cia402"


Kind = TypeVar("Kind", bound=Description)


def ready(directory: Path) -> dict[str, Path]:
    """Return the paths of the descriptions in ``directory``, by name."""
    return {path.stem: path for path in sorted(directory.glob("*.yaml"))}


def load_description(given: str, beside: Path | None, directory: Path, kind: type[Kind]) -> Kind:
    """Read a description: a file, or one of those in ``directory`` by its name.

    ``given``: path of a file, ending in .yaml, or a name. ``beside``: path of the configuration; a relative path starts
    from its directory. Raises `ConfigurationError`: the file has mistakes; it lists each with its line; `UsageError`:
    no description has that name; it lists the known ones.
    """
    if given.endswith((".yaml", ".yml")):
        return read_section(Path(given) if beside is None else beside.parent / given, kind)
    known = ready(directory)
    if given not in known:
        raise UsageError(
            f"no drive is described as {given!r}; {choices(given, known)}. The path of your own file must end in .yaml"
        )
    return read_section(known[given], kind)
