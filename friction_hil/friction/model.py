"""A friction model with its parameters: simulate a record, differentiate it, or run step by step."""

import math
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from itertools import accumulate, chain
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from friction_hil.errors import UsageError, choices
from friction_hil.friction import dispatch, kernel, network_runs, sensitivity
from friction_hil.friction.arrays import checked_out, per_sample, require_finite, vector
from friction_hil.friction.family import Family
from friction_hil.friction.modifiers import SIDES, check_modifiers, pack_modifiers
from friction_hil.friction.network_model import NETWORK_ALONE, Network
from friction_hil.friction.parameters import check_all
from friction_hil.numerics.dual import WIDTH
from friction_hil.numerics.jit import Array

Axis = Literal["rotary", "linear"]
Purpose = Literal["feedforward", "simulation"]

# Where nobody tells the velocity noise: slow against the Stribeck velocity, so that its hump is left
_EPSILON_SHARE = 0.05
DEFAULT_VELOCITY_EPSILON = 1e-3

_ZERO, _NAN = np.zeros(1), np.full(1, math.nan)


class FrictionModel:
    """A model of the library with values for its parameters; make it with `friction_hil.models.create`.

    Friction is positive when it opposes positive velocity: J dv/dt = tau - F - load. Units are those of a rotary
    axis; on a linear one N m becomes N and rad becomes m.

    Attributes
    ----------
    family : Family
        Name, formula, source and parameter table.
    given : dict
        Parameters by name as they were given: what a model file holds.
    parameters : dict
        Every parameter by name, defaults filled in, SI.
    modifiers : dict
        Modifiers by name, defaults filled in; see `friction_hil.friction.modifiers`.
    network : Network or None
        Trained network whose torque is added; of the family `NETWORK_ALONE`, there is nothing else.
    free : tuple of str
        Names of all numbers that have a gradient, e.g. ``coulomb``, ``weight[1]``, ``load.motoring``.
    kind : int
        Number by which `friction_hil.friction.kernel` knows the model.
    values : array
        Parameters and modifiers in the kernel's order, `kernel.PLAIN_ROOM` of them; with a network
        `kernel.PARAMETER_ROOM`.
    notes : tuple of str
        What is unusual but allowed.
    """

    __slots__ = (
        "_places",
        "axis",
        "family",
        "free",
        "given",
        "kind",
        "modifiers",
        "network",
        "notes",
        "parameters",
        "values",
    )

    def __init__(
        self,
        family: Family,
        parameters: Mapping[str, Any],
        modifiers: Mapping[str, Any] | None = None,
        axis: Axis = "rotary",
        trained: Network | None = None,
    ) -> None:
        self.family = family
        self.network = trained
        self.axis = axis
        if axis not in ("rotary", "linear"):
            raise UsageError(f"axis is 'rotary' or 'linear', not {axis!r}")
        self.given = deepcopy(dict(parameters))
        self.parameters = check_all(family.name, family.parameters, parameters)
        family.check(self.parameters)
        self.modifiers = check_modifiers(family, parameters, modifiers or {})
        self.kind = dispatch.KINDS.get(family.name, dispatch.COULOMB)  # of a network alone: of nothing
        self.values, self._places = self._pack()
        self.free = tuple(dict.fromkeys(name for name, _ in self._places if name is not None))
        self.notes = tuple(self._notes())

    @property
    def _has_more(self) -> bool:
        """Whether there is more than the family itself."""
        return bool(self.modifiers) or self.network is not None

    def __repr__(self) -> str:
        words = [f"{name}={_brief(value)}" for name, value in self.parameters.items()]
        words += [f"modifiers={self.modifiers}"] if self.modifiers else []
        words += [f"network={self.network}"] if self.network is not None else []
        return f"{self.family.name}({', '.join(words)})"

    def _side(self, side: str) -> dict[str, Any]:
        """All parameters for one direction of motion; defaults follow what that direction changes."""
        changes = self.modifiers.get("direction", {}).get(side, {})
        return check_all(self.name, self.family.parameters, {**self.given, **changes})

    @property
    def _sources(self) -> dict[str, str]:
        """Parameters whose default is the value of another one."""
        names = {parameter.name for parameter in self.family.parameters}
        return {each.name: each.default for each in self.family.parameters if each.default in names}

    def _pack(self) -> tuple[Array, list[tuple[str | None, float]]]:
        """Values as `kernel` wants them, and for each place whose value it has, times what."""
        packs: list[Sequence[float]] = []
        places: list[tuple[str | None, float]] = [(None, 1.0)] * kernel.HEADER
        for side in SIDES if "direction" in self.modifiers else SIDES[:1]:
            own = self._side(side)
            pack = self.family.pack(own)
            packs.append(pack.values)
            names = [self._name(name, side, own) for name in pack.names]
            places += zip(names, pack.factors or [1.0] * len(names), strict=True)
        begins = [kernel.HEADER, *(kernel.HEADER + end for end in accumulate(map(len, packs)))]
        changes = pack_modifiers(self.modifiers, 2.0 * math.pi if self.axis == "linear" else 1.0)
        content = [*chain(*packs), *changes.values]
        end = kernel.HEADER + len(content)
        values = np.zeros(kernel.PLAIN_ROOM if self.network is None else kernel.PARAMETER_ROOM)
        values[:4] = self._has_more, begins[len(packs) - 1], begins[-1], 0.0 if self.network is None else end
        values[kernel.HEADER : end] = content
        if self.network is not None:
            learned = self.network.values
            room = kernel.PARAMETER_ROOM - end
            if learned.size > room:
                raise UsageError(f"the network takes {learned.size} numbers; beside {self.family.name} fit {room}")
            values[end : end + learned.size] = learned
        return values, [*places, *((name, 1.0) for name in changes.names)]

    def _name(self, name: str | None, side: str, own: Mapping[str, Any]) -> str | None:
        """Name of a parameter: one for both directions where it is the same in both."""
        if name is None:
            return None
        parameter = name.partition("[")[0]
        source = self._sources.get(parameter)
        if source is not None and parameter not in {**self.given, **self.modifiers.get("direction", {}).get(side, {})}:
            return self._name(source, side, own)  # a default that follows another parameter moves with it
        is_own = parameter in self.modifiers.get("direction", {}).get(side, {})
        return f"direction.{side}.{name}" if is_own or own[parameter] != self.parameters[parameter] else name

    def _notes(self) -> Iterator[str]:
        sides = [self._side(side) for side in SIDES]
        if any(side.get("static", math.inf) < side.get("coulomb", 0.0) for side in sides):
            yield "static is below coulomb: this axis has no Stribeck hump"
        if "temperature" in self.modifiers and self.modifiers["temperature"]["coefficient"] != 0.0:
            yield "it depends on temperature: without one, as in the daemon, the reference counts"
        stiff = {"sigma0", "stiffness"}
        if not self.family.is_static and any(
            stiff & set(each) for each in self.modifiers.get("direction", {}).values()
        ):
            yield "stiffness differs between the directions: the torque may jump at a reversal and give out energy"
        if self.name == "bouc_wen" and any(side["gamma"] > side["beta"] for side in sides):
            yield "gamma is above beta: this hysteresis can give out energy"

    @property
    def name(self) -> str:
        """Name of the family, as in the registry."""
        return self.family.name

    @property
    def level(self) -> float:
        """Break-away level: the largest torque of slow motion in either direction, without other modifiers, N m."""
        own = max(self.family.level(self._side(side)) for side in SIDES)
        return own if self.network is None else max(own, self.network.level)

    @property
    def presliding_stiffness(self) -> float:
        """Slope of torque over position when motion begins, in the stiffer direction, N m/rad; 0 of a static map."""
        learned = 0.0 if self.network is None else self.network.presliding_stiffness
        if self.family.is_static or self.family is NETWORK_ALONE:
            return learned
        time_s = 1e6  # so slowly that no damping shows
        stiffnesses = []
        for side in SIDES:
            plain, stiffness = FrictionModel(self.family, self._side(side)), 1e12
            for _ in range(2):  # the first to learn how far a small part of the level reaches
                position = 1e-6 * plain.level / stiffness
                velocity = np.full(1, position / time_s)
                stiffness = float(kernel.run_any(plain.kind, plain.values, velocity, time_s)[0]) / position
            stiffnesses.append(stiffness)
        return max(stiffnesses) + learned

    def initial_state(self) -> Array:
        """State at rest with nothing deflected."""
        return np.zeros(kernel.STATE_ROOM)

    def simulate(
        self,
        velocity: ArrayLike,
        dt: ArrayLike,
        *,
        position: ArrayLike | None = None,
        load_torque: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        applied_torque: ArrayLike | None = None,
        out: Array | None = None,
    ) -> Array:
        """Friction torque of a velocity record, from rest.

        Parameters
        ----------
        velocity : (n,) array
            Held over each sample, rad/s.
        dt : float or (n,) array
            Length of the sample(s), s, above zero.
        position : float or (n,) array, optional
            At the end of each sample, rad; needed by a model with ripple.
        load_torque : float or (n,) array, optional
            N m, positive where it opposes positive motion; needed by a model that depends on load.
        temperature : float or (n,) array, optional
            deg C; the reference temperature when not given.
        applied_torque : float or (n,) array, optional
            What a static map balances while the velocity is zero, N m; 0 when not given.
        out : (n,) array, optional
            Where to write the torque: contiguous, of float64.

        Returns
        -------
        (n,) array
            Torque at the end of each sample, N m.

        Raises
        ------
        UsageError
            A shape does not fit, a value is not finite, or an input that the model needs is missing.
        """
        inputs = self._inputs(velocity, dt, position, load_torque, temperature, applied_torque)
        torque = np.empty(inputs[0].size) if out is None else checked_out(out, (inputs[0].size,))
        if out is not None and np.may_share_memory(out, inputs[0]):
            raise UsageError("out must not share memory with the velocity")
        kind, state = dispatch.tag(self.kind), self.initial_state()
        v, steps, where, load, warmth, applied = inputs
        if self.network is not None and self.family is NETWORK_ALONE and not self.modifiers and steps.size == 1:
            require_finite("velocity", v)
            network_runs.run(self.network.values, state, v, steps[0], where, load, warmth, torque)
            return torque
        if not self._has_more and steps.size == 1 and applied.size == 1:
            is_finite = kernel.run_plain(kind, self.values, state, v, steps[0], applied[0], torque)
        else:
            is_finite = kernel.run(kind, self.values, state, *inputs, torque)
        if not is_finite:
            require_finite("velocity", v)
        return torque

    def simulate_with_gradient(
        self,
        velocity: ArrayLike,
        dt: ArrayLike,
        *,
        free: Sequence[str | Mapping[str, float]] | None = None,
        position: ArrayLike | None = None,
        load_torque: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        applied_torque: ArrayLike | None = None,
        out: tuple[Array, Array] | None = None,
    ) -> tuple[Array, Array]:
        """`simulate`, and the derivatives of its torque with respect to parameters.

        They are exact for the discrete model, states included (forward sensitivities by automatic
        differentiation). At a kink, such as the instant of sticking, they are those of the side that was taken.

        Parameters
        ----------
        velocity, dt, position, load_torque, temperature, applied_torque
            See `simulate`.
        free : sequence of str or mapping, optional
            Names among `free`, which is taken when not given. A mapping of names to weights stands for the derivative
            in that direction, the weighted sum of theirs: what several parameters have in common costs one column.
        out : pair of arrays, optional
            Where to write torque (n,) and gradient (n, m): contiguous, of float64. For a fit, which wants them many
            times: large new arrays cost more than the model.

        Returns
        -------
        torque : (n,) array
            The bits of `simulate`.
        gradient : (n, m) array
            A column for each free parameter, N m over the unit of the parameter.

        Raises
        ------
        UsageError
            As `simulate`; or a name is not in `free`.
        """
        if self.network is not None:
            raise UsageError("a model with a network has no gradient here: a network is trained, not fitted")
        columns = [{each: 1.0} if isinstance(each, str) else each for each in (self.free if free is None else free)]
        for name in chain.from_iterable(columns):
            if name not in self.free:
                raise UsageError(f"{self.name} has no free parameter {name!r}; {choices(name, self.free)}")
        inputs = self._inputs(velocity, dt, position, load_torque, temperature, applied_torque)
        require_finite("velocity", inputs[0])
        samples = inputs[0].size
        if out is None:
            torque, gradient = np.empty(samples), np.empty((samples, len(columns)))
        else:
            torque, gradient = checked_out(out[0], (samples,)), checked_out(out[1], (samples, len(columns)))
        for first in range(0, max(len(columns), 1), WIDTH):
            seeds = np.zeros((self.values.size, WIDTH))
            for column, weights in enumerate(columns[first : first + WIDTH]):
                for place, (free_name, factor) in enumerate(self._places):
                    if free_name is not None and free_name in weights:
                        seeds[place, column] = factor * weights[free_name]
            state, state_gradient = self.initial_state(), np.zeros((kernel.STATE_ROOM, WIDTH))
            sensitivity.run(
                dispatch.tag(self.kind), self.values, seeds, state, state_gradient, *inputs, torque, gradient, first
            )
        return torque, gradient

    def steady_state(
        self, velocity: ArrayLike, *, load_torque: float | None = None, temperature: float | None = None
    ) -> Array:
        """Torque that the model settles on at constant velocity.

        Parameters
        ----------
        velocity : (n,) array
            rad/s.
        load_torque, temperature : float, optional
            See `simulate`.

        Returns
        -------
        (n,) array
            N m, without ripple; 0 at rest.
        """
        v = vector("velocity", velocity)
        require_finite("velocity", v)
        _, _, _, load, warmth, _ = self._inputs(v[:1], 1.0, 0.0, load_torque, temperature, None)
        torque = np.empty(v.size)
        kernel.steady_curve(dispatch.tag(self.kind), self.values, v, load[0], warmth[0], torque)
        if self.network is not None:
            network_runs.add_steady_curve(self.network.values, v, load[0], warmth[0], torque)
        return torque

    def dissipated_energy(self, velocity: ArrayLike, dt: ArrayLike, **inputs: Any) -> Array:
        """Work done against friction from the start to the end of each sample.

        Parameters
        ----------
        velocity, dt, **inputs
            See `simulate`.

        Returns
        -------
        (n,) array
            J, the sum of F v dt. What the bristles of a dynamic model hold of it comes back when they relax;
            over a cycle that closes velocity and state, all of it has turned into heat.
        """
        torque = self.simulate(velocity, dt, **inputs)
        work: Array = np.cumsum(torque * vector("velocity", velocity) * np.asarray(dt, dtype=np.float64))
        return work

    def start(self, purpose: Purpose = "feedforward", velocity_epsilon: float | None = None) -> "Runner":
        """Start at rest, for one sample at a time.

        Parameters
        ----------
        purpose : {"feedforward", "simulation"}
            A feed-forward smooths a static map's jump at zero velocity; a simulation sticks exactly.
        velocity_epsilon : float, optional
            Width of that smoothing, rad/s: two or three times the velocity noise.
            A twentieth of the Stribeck velocity when not given, or `DEFAULT_VELOCITY_EPSILON` where there is none.
        """
        if purpose not in ("feedforward", "simulation"):
            raise UsageError(f"purpose is 'feedforward' or 'simulation', not {purpose!r}")
        if purpose == "simulation":
            if velocity_epsilon is not None:
                raise UsageError("velocity_epsilon belongs to the purpose 'feedforward'; a simulation sticks exactly")
            return Runner(self, 0.0)
        default = _EPSILON_SHARE * self.parameters.get("stribeck_velocity", DEFAULT_VELOCITY_EPSILON / _EPSILON_SHARE)
        epsilon = default if velocity_epsilon is None else float(velocity_epsilon)
        if not (np.isfinite(epsilon) and epsilon > 0.0):
            raise UsageError(f"velocity_epsilon must be finite and above zero, in rad/s, not {epsilon:g}")
        return Runner(self, epsilon)

    def _inputs(
        self,
        velocity: ArrayLike,
        dt: ArrayLike,
        position: ArrayLike | None,
        load_torque: ArrayLike | None,
        temperature: ArrayLike | None,
        applied_torque: ArrayLike | None,
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Make arrays of a simulation's inputs, of one element or n; only the first may not be finite."""
        if position is None and self.modifiers.get("ripple"):
            raise UsageError(f"{self.name} with ripple needs the position, in rad or m")
        if load_torque is None and "load" in self.modifiers:
            raise UsageError(f"{self.name} with load dependence needs the load_torque, in N m or N")
        v = vector("velocity", velocity)
        steps = per_sample("dt", dt, v.size)
        if not kernel.is_positive(steps):
            raise UsageError(f"dt must be above zero, in s; its smallest value is {steps.min():g}")
        if self.network is not None:
            self.network.require(position is not None, load_torque is not None, float(steps[0]))
        return (
            v,
            steps,
            _ZERO if position is None else per_sample("position", position, v.size),
            _ZERO if load_torque is None else per_sample("load_torque", load_torque, v.size),
            _NAN if temperature is None else per_sample("temperature", temperature, v.size),
            _ZERO if applied_torque is None else per_sample("applied_torque", applied_torque, v.size),
        )


class Runner:
    """A model in motion: its state, advanced by `step`."""

    __slots__ = ("_address", "_is_modified", "_state", "_whole")

    def __init__(self, model: FrictionModel, epsilon: float) -> None:
        whole = np.zeros(kernel.WHOLE_ROOM)
        whole[0], whole[1] = model.kind, epsilon
        whole[2 : 2 + model.values.size] = model.values
        self.__setstate__((whole, model._has_more))

    def __getstate__(self) -> tuple[Array, bool]:
        return self._whole.copy(), self._is_modified

    def __setstate__(self, saved: tuple[Array, bool]) -> None:
        # one array for all, known by its address: each argument costs a tenth of a microsecond, an array two
        whole, self._is_modified = saved
        self._whole = np.array(whole)  # memory of its own, that may be written to
        self._address = self._whole.ctypes.data
        self._state = self._whole[-kernel.STATE_ROOM :]
        kernel.prepare(kernel.step_plain, 2)
        kernel.prepare(kernel.step_whole, 6)

    @property
    def state(self) -> Array:
        """The state, a live view: copy it to keep it, assign to its elements to restore it."""
        return self._state

    def step(
        self,
        velocity: float,
        dt: float,
        *,
        position: float = 0.0,
        load_torque: float = 0.0,
        temperature: float | None = None,
        applied_torque: float = 0.0,
    ) -> float:
        """Advance over ``dt`` seconds with ``velocity`` held and return the torque, N m.

        The inputs are those of `FrictionModel.simulate`. They are not checked, for speed: they must be finite
        and ``dt`` above zero.
        """
        if not self._is_modified and applied_torque == 0.0:
            return kernel.step_plain(self._address, velocity, dt)
        warmth = math.nan if temperature is None else temperature
        return kernel.step_whole(self._address, velocity, dt, position, load_torque, warmth, applied_torque)


def _brief(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def as_dict(model: FrictionModel) -> dict[str, Any]:
    """What a model file says under ``friction``."""
    content: dict[str, Any] = {"model": model.name, "parameters": dict(model.given)}
    return {**content, "modifiers": dict(model.modifiers)} if model.modifiers else content
