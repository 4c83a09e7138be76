"""A trained network: structure, weights and scales, and their representation in a model file."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from friction_hil.errors import UsageError, choices
from friction_hil.friction import network
from friction_hil.friction.family import Family, Packed
from friction_hil.friction.parameters import InvalidParameterError
from friction_hil.numerics.jit import Array

Kind = Literal["static", "gated", "narx"]
KINDS = {"static": network.STATIC, "gated": network.GATED, "narx": network.NARX}
INPUTS = ("position", "load_torque", "temperature")  # besides the velocity, in the order of the kernel

MOST_UNITS = 64
MOST_STATES = 5
MOST_LAGS = 8
MOST_WEIGHTS = 1400
_SAME_PERIOD = 1e-3  # relative
LARGEST_WEIGHT = 1e4  # a larger weight turns a unit into a switch: the training has diverged

NETWORK_ALONE = Family(
    name="network",
    summary="trained network, from a model file ('friction-hil train')",
    formula=(
        "F = c + l x + sum y + B(x, y) sum dy/dt;  dy/dt = kappa |v| limited(T(x, y) - y, w)  (gated);  "
        "F = T(x, past v, past F)  (narx);  F = T(x)  (static)"
    ),
    source="friction_hil/friction/network.py",
    parameters=(),
    states=("feedback [N m]",),
    example={},
    pack=lambda _: Packed([0.0, 0.0, 0.0], [None, None, None]),
)


@dataclass(frozen=True, slots=True)
class NetworkStructure:
    """Structure of a network.

    Attributes
    ----------
    kind : {"gated", "narx", "static"}
    hidden : tuple of int
        Number of tanh units of each hidden layer; one or two layers.
    states : int
        Number of states of a gated network or of past torques of a narx; 0 for a static one.
    lags : int
        Number of past velocities of a narx; 0 for the others.
    has_position, has_load, has_temperature : bool
        True if position, load torque or temperature are inputs besides the velocity.
    orders : tuple of float
        Orders of the position harmonics that are inputs, per rad.
    """

    kind: Kind = "gated"
    hidden: tuple[int, ...] = (10,)
    states: int = 1
    lags: int = 0
    has_position: bool = False
    has_load: bool = False
    has_temperature: bool = False
    orders: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UsageError(f"no network structure is called {self.kind!r}; {choices(str(self.kind), KINDS)}")
        if not 1 <= len(self.hidden) <= 2 or not all(1 <= units <= MOST_UNITS for units in self.hidden):
            raise UsageError(f"hidden has one or two layers of 1 to {MOST_UNITS} units, not {self.hidden}")
        if (self.kind == "static") != (self.states == 0) or not 0 <= self.states <= MOST_STATES:
            raise UsageError(f"a {self.kind} network has {_states_allowed(self.kind)}, not {self.states}")
        if not 0 <= self.lags <= MOST_LAGS or (self.lags and self.kind != "narx"):
            raise UsageError(f"only a narx has past velocities as inputs, at most {MOST_LAGS}; lags is {self.lags}")
        if len(self.orders) > network.MAX_HARMONICS or not all(map(math.isfinite, self.orders)):
            raise UsageError(f"orders are at most {network.MAX_HARMONICS} finite numbers, not {self.orders}")

    @property
    def inputs(self) -> int:
        """Number of inputs of the first layer, without the feedback."""
        others = self.has_position + self.has_load + self.has_temperature + 2 * len(self.orders)
        return network.VELOCITY_FEATURES * (1 + self.lags) + (self.kind == "gated") + others

    @property
    def feedback_weights(self) -> tuple[int, int]:
        """Indices of the feedback weights of the first layer: the first, and one past the last."""
        begin = self.hidden[0] * (1 + self.inputs)
        return begin, begin + self.hidden[0] * self.states

    @property
    def outputs_begin(self) -> int:
        """Index of the first weight of the outputs."""
        second = self.hidden[1] * (1 + self.hidden[0]) if len(self.hidden) == 2 else 0
        return self.feedback_weights[1] + second

    @property
    def output_weights(self) -> int:
        """Number of weights of each output."""
        return 1 + self.hidden[-1] + self.inputs + (self.states if self.kind == "narx" else 0)

    @property
    def outputs(self) -> int:
        """Number of outputs of the layers: for a gated network, one per state and the damping."""
        return self.states + 1 if self.kind == "gated" else 1

    @property
    def weights(self) -> int:
        """Number of trained weights."""
        direct = 1 + self.inputs + self.states * network.GATES * network.GATE_WEIGHTS if self.kind == "gated" else 0
        return self.outputs_begin + self.outputs * self.output_weights + direct

    def parameter_array(self) -> Array:
        """Return a parameter array of `friction_hil.friction.network.step` with this structure, otherwise zero."""
        p = np.zeros(network.HEADER + self.weights)
        p[network.STRUCTURE] = KINDS[self.kind]
        p[network.INPUTS], p[network.FEEDBACKS], p[network.LAGS] = self.inputs, self.states, self.lags
        p[network.WIDTH] = self.hidden[0]
        p[network.SECOND] = self.hidden[1] if len(self.hidden) == 2 else 0
        p[network.HARMONICS] = len(self.orders)
        p[network.HAS_POSITION], p[network.HAS_LOAD] = self.has_position, self.has_load
        p[network.HAS_TEMPERATURE] = self.has_temperature
        p[network.ORDERS : network.ORDERS + len(self.orders)] = self.orders
        return p

    @property
    def state_room(self) -> int:
        """Length of the state array."""
        past = network.MEMORIES if self.kind == "gated" else network.VELOCITY_FEATURES * self.lags
        return (
            self.states
            + past
            + self.inputs
            + network.GATE_FEATURES
            + 1
            + self.states
            + sum(self.hidden)
            + network.SPARE
        )


def _states_allowed(kind: str) -> str:
    return "no states" if kind == "static" else f"1 to {MOST_STATES} states"


def _rates(p: Array) -> tuple[float, float]:
    middle, half = float(p[network.RATE_MIDDLE]), float(p[network.RATE_HALF])
    return math.exp(middle - half), math.exp(middle + half)


def beyond_speed(is_residual: bool) -> str:
    """Return the behaviour of a network's torque beyond its speed limit, as text."""
    return "its torque fades out" if is_residual else "its torque stays constant"


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """A trained network.

    Attributes
    ----------
    structure : NetworkStructure
    period_s : float
        Sampling period of the training, s; a narx runs only at this period.
    torque_scale : float
        Unit of the torques, N m.
    bound : float
        Largest torque, in torque scales.
    speed_limit : float
        Highest speed of the training, rad/s.
    speeds : tuple of 3 float
        Characteristic speeds of the friction, rad/s.
    rates : (float, float)
        Bounds of the rates of the states of a gated network, rad^-1; empty for the others.
    ranges : mapping of str to (float, float)
        Smallest and largest value of every other input in the training; the names are among `INPUTS`.
    level : float
        Largest torque of slow motion, including that of the base model, N m.
    weights : (structure.weights,) array
    is_residual : bool
        True if the torque is added to that of a base model. It then fades out beyond the speeds, positions, loads and
        temperatures of the training; otherwise the torque stays constant there.
    stroke : float
        Stroke of the stop of a gated network, rad; 0 for the others.
    least_speed : float
        Speed of a residual below which it fades out, because the training did not visit or the encoder did not
        resolve slower motion, rad/s; 0 if it does not fade out.

    Raises
    ------
    InvalidParameterError
        A number is not finite or out of bounds, or a list has the wrong length; ``parameter`` is its name.
    """

    structure: NetworkStructure
    period_s: float
    torque_scale: float
    bound: float
    speed_limit: float
    speeds: Sequence[float]
    rates: Sequence[float]
    ranges: Mapping[str, Sequence[float]]
    level: float
    weights: Array
    is_residual: bool = False
    stroke: float = 0.0
    least_speed: float = 0.0

    def __post_init__(self) -> None:
        for name in ("period_s", "torque_scale", "bound", "speed_limit", "level"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise InvalidParameterError(f"{name} is {value}, but must be finite and above zero", name)
        if len(self.speeds) != 3 or not all(0.0 < speed < math.inf for speed in self.speeds):
            raise InvalidParameterError(f"speeds are three finite numbers above zero, not {self.speeds}", "speeds")
        self._check_rates()
        wanted = [name for name, has in zip(INPUTS, self._has, strict=True) if has]
        for name in wanted:
            low, high = self.ranges.get(name) or (math.nan, math.nan)
            if not -math.inf < low < high < math.inf:
                raise InvalidParameterError(
                    f"ranges.{name} must be the smallest and the largest value in the training, not {[low, high]}",
                    "ranges",
                )
        is_gated = self.structure.kind == "gated"
        if not (0.0 < self.stroke < math.inf if is_gated else self.stroke == 0.0):
            raise InvalidParameterError(
                "stroke must be finite and above zero for a gated network, and 0 for any other, not "
                f"{self.stroke}. Networks of earlier versions have no stroke and must be trained again",
                "stroke",
            )
        if not 0.0 <= self.least_speed < self.speed_limit or (self.least_speed and not self.is_residual):
            raise InvalidParameterError(
                "least_speed must be 0 or above and below speed_limit, and 0 for a network without a base model, not "
                f"{self.least_speed}",
                "least_speed",
            )
        weights = np.ascontiguousarray(self.weights, dtype=np.float64)
        if weights.shape != (self.structure.weights,):
            raise InvalidParameterError(
                f"weights has {weights.size} numbers; this structure has {self.structure.weights}", "weights"
            )
        if weights.size > MOST_WEIGHTS:
            raise InvalidParameterError(
                f"weights has {weights.size} numbers; at most {MOST_WEIGHTS} are allowed", "weights"
            )
        wrong = np.flatnonzero(~(np.abs(weights) <= LARGEST_WEIGHT))
        if wrong.size:
            raise InvalidParameterError(
                f"weights[{wrong[0]}] is {weights[wrong[0]]:g}, but must be finite and within +-{LARGEST_WEIGHT:g}",
                "weights",
            )
        object.__setattr__(self, "weights", weights)

    def _check_rates(self) -> None:
        rates = tuple(self.rates)
        if self.structure.kind != "gated":
            is_right = not rates
        else:
            is_right = len(rates) == 2 and 0.0 < rates[0] < rates[1] < math.inf
        if not is_right:
            raise InvalidParameterError(
                f"rates must be the lowest and the highest rate, finite and above zero, for a gated network, and empty "
                f"for any other, not {list(rates)}",
                "rates",
            )

    def __repr__(self) -> str:
        hidden = "-".join(map(str, self.structure.hidden))
        return f"{self.structure.kind} {self.structure.inputs}-{hidden}-1, {self.weights.size} weights"

    @property
    def _has(self) -> tuple[bool, bool, bool]:
        return self.structure.has_position, self.structure.has_load, self.structure.has_temperature

    @property
    def beyond(self) -> str:
        """Behaviour of the torque beyond the speed limit, as text."""
        return beyond_speed(self.is_residual)

    @property
    def values(self) -> Array:
        """Parameters as the flat array of `friction_hil.friction.network.step`."""
        p = self.structure.parameter_array()
        p[network.TRAINED_DT] = self.period_s
        p[network.TORQUE_SCALE], p[network.BOUND] = self.torque_scale, self.bound
        p[network.SPEED_LIMIT] = self.speed_limit
        if self.rates:
            lowest, highest = np.log(self.rates)
            p[network.RATE_MIDDLE], p[network.RATE_HALF] = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
        p[network.STROKE], p[network.LEAST_SPEED] = self.stroke, self.least_speed
        p[network.SPEEDS : network.SPEEDS + 3] = self.speeds
        p[network.FEATURE_FACTORS : network.FEATURE_FACTORS + 2] = 1.0 / np.arcsinh(
            self.speed_limit / np.array(self.speeds[:2])
        )
        for index, (name, has) in enumerate(zip(INPUTS, self._has, strict=True)):
            low, high = self.ranges[name] if has else (-1.0, 1.0)
            p[network.MIDDLES + index], p[network.HALF_RANGES + index] = 0.5 * (low + high), 0.5 * (high - low)
        p[network.IS_RESIDUAL] = self.is_residual
        p[network.HEADER :] = self.weights
        return p

    @classmethod
    def of_values(cls, p: Array, level: float, *, is_residual: bool = False) -> "Network":
        """Create a network from the flat array of `friction_hil.friction.network.step`."""
        second = int(p[network.SECOND])
        kinds = {number: kind for kind, number in KINDS.items()}
        structure = NetworkStructure(
            kind=kinds[int(p[network.STRUCTURE])],  # type: ignore[arg-type]
            hidden=(int(p[network.WIDTH]), *([second] if second else [])),
            states=int(p[network.FEEDBACKS]),
            lags=int(p[network.LAGS]),
            has_position=bool(p[network.HAS_POSITION]),
            has_load=bool(p[network.HAS_LOAD]),
            has_temperature=bool(p[network.HAS_TEMPERATURE]),
            orders=tuple(p[network.ORDERS : network.ORDERS + int(p[network.HARMONICS])].tolist()),
        )
        middles, halves = p[network.MIDDLES : network.MIDDLES + 3], p[network.HALF_RANGES : network.HALF_RANGES + 3]
        return cls(
            structure=structure,
            period_s=float(p[network.TRAINED_DT]),
            torque_scale=float(p[network.TORQUE_SCALE]),
            bound=float(p[network.BOUND]),
            speed_limit=float(p[network.SPEED_LIMIT]),
            speeds=(float(p[network.SPEEDS]), float(p[network.SPEEDS + 1]), float(p[network.SPEEDS + 2])),
            rates=_rates(p) if structure.kind == "gated" else (),
            ranges={
                name: (float(middle - half), float(middle + half))
                for name, middle, half in zip(INPUTS, middles, halves, strict=True)
            },
            level=level,
            weights=p[network.HEADER :].copy(),
            is_residual=is_residual,
            stroke=float(p[network.STROKE]),
            least_speed=float(p[network.LEAST_SPEED]) if is_residual else 0.0,
        )

    @property
    def presliding_stiffness(self) -> float:
        """Slope of torque over position at the start of motion, N m/rad; 0 if the state is not a deflection."""
        if self.structure.kind != "gated":
            return 0.0
        p, s = self.values, np.zeros(network.STATE_ROOM)
        speed, distance = self.speeds[2], 1e-4 / self.rates[1]
        inputs = (speed, speed, distance / speed, 0.0, 0.0, math.nan)
        first, second = network.step(p, s, *inputs), network.step(p, s, *inputs)
        return max((second - first) / distance, 0.0)

    def require(self, has_position: bool, has_load: bool, period_s: float | None = None) -> None:
        """Check that the inputs of a simulation are complete and that the network runs at its period.

        Raises
        ------
        UsageError
            An input is missing, or the network is a narx that was trained at another period.
        """
        is_narx = self.structure.kind == "narx"
        if is_narx and period_s is not None and abs(period_s / self.period_s - 1.0) > _SAME_PERIOD:
            raise UsageError(
                f"a narx runs only at the period of its training, {self.period_s:g} s, not at {period_s:g} s; a gated "
                "network runs at any period"
            )
        if not has_position and (self.structure.has_position or self.structure.orders):
            raise UsageError("this network needs the position as an input, in rad or m")
        if not has_load and self.structure.has_load:
            raise UsageError("this network needs the load_torque as an input, in N m or N")

    def as_dict(self) -> dict[str, Any]:
        """Return the content of a model file under ``network``, without the base model."""
        structure = self.structure
        named = [name for name, has in zip(INPUTS, self._has, strict=True) if has]
        content: dict[str, Any] = {"structure": structure.kind, "hidden": list(structure.hidden)}
        if structure.states:
            content["states"] = structure.states
        if structure.lags:
            content["lags"] = structure.lags
        if named:
            content["inputs"] = named
        if structure.orders:
            content["orders"] = list(structure.orders)
        return {
            **content,
            "period_s": self.period_s,
            "torque_scale": self.torque_scale,
            "bound": self.bound,
            "speed_limit": self.speed_limit,
            "speeds": list(self.speeds),
            **({"rates": list(self.rates)} if self.rates else {}),
            **({"stroke": self.stroke} if self.stroke else {}),
            **({"least_speed": self.least_speed} if self.least_speed else {}),
            **({"ranges": {name: list(self.ranges[name]) for name in named}} if named else {}),
            "level": self.level,
            "weights": self.weights.tolist(),
        }
