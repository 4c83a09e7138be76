"""A friction model with parameters: simulate a record, compute its gradient, or run sample by sample."""

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
from friction_hil.numerics.jit import Array, ready

Axis = Literal["rotary", "linear"]
Purpose = Literal["feedforward", "simulation"]

# Default of velocity_epsilon, as a fraction of the Stribeck velocity: small enough to keep the Stribeck hump
_EPSILON_FRACTION = 0.05
DEFAULT_VELOCITY_EPSILON = 1e-3

_ZERO, _NAN = np.zeros(1), np.full(1, math.nan)


class FrictionModel:
    """A friction model with values for its parameters, created by `friction_hil.models.create`.

    Friction is positive when it opposes positive velocity: J dv/dt = tau - F - load. Units are those of a rotary
    axis; on a linear axis N m becomes N and rad becomes m.

    Attributes
    ----------
    family : Family
        Name, formula, source and parameter table.
    given : dict
        Parameters by name as the user gave them, and as a model file contains them.
    parameters : dict
        All parameters by name with defaults filled in, SI.
    modifiers : dict
        Modifiers by name with defaults filled in; see `friction_hil.friction.modifiers`.
    network : Network or None
        Trained network whose torque is added. In the family `NETWORK_ALONE` it is the only source of torque.
    free : tuple of str
        Names of all numbers that have a gradient, e.g. ``coulomb``, ``weight[1]``, ``load.motoring``.
    kind : int
        Number of the family in `friction_hil.friction.kernel`.
    values : array
        Parameters and modifiers in the layout of the kernel; its length is `kernel.PLAIN_ROOM`, and
        `kernel.PARAMETER_ROOM` with a network.
    notes : tuple of str
        Remarks about unusual but allowed parameters.
    """

    __slots__ = (
        "_packed_names",
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
        # a network alone has Coulomb friction of zero
        self.kind = getattr(dispatch.KIND, family.name, dispatch.KIND.coulomb)
        self.values, self._packed_names = self._pack()
        self.free = tuple(dict.fromkeys(name for name, _ in self._packed_names if name is not None))
        self.notes = tuple(self._notes())

    @property
    def _is_extended(self) -> bool:
        """True if the model has modifiers or a network."""
        return bool(self.modifiers) or self.network is not None

    def __repr__(self) -> str:
        words = [f"{name}={_brief(value)}" for name, value in self.parameters.items()]
        words += [f"modifiers={self.modifiers}"] if self.modifiers else []
        words += [f"network={self.network}"] if self.network is not None else []
        return f"{self.family.name}({', '.join(words)})"

    def _side(self, side: str) -> dict[str, Any]:
        """Return all parameters for one direction of motion; defaults follow the values of that direction."""
        changes = self.modifiers.get("direction", {}).get(side, {})
        return check_all(self.name, self.family.parameters, {**self.given, **changes})

    @property
    def _default_sources(self) -> dict[str, str]:
        """Parameters whose default is another parameter, with the name of that parameter."""
        names = {parameter.name for parameter in self.family.parameters}
        return {each.name: each.default for each in self.family.parameters if each.default in names}

    def _pack(self) -> tuple[Array, list[tuple[str | None, float]]]:
        """Return the values in the layout of `kernel`, and name and factor of the parameter in each element."""
        packs: list[Sequence[float]] = []
        packed: list[tuple[str | None, float]] = [(None, 1.0)] * kernel.HEADER
        for side in SIDES if "direction" in self.modifiers else SIDES[:1]:
            own = self._side(side)
            pack = self.family.pack(own)
            packs.append(pack.values)
            names = [self._name(name, side, own) for name in pack.names]
            packed += zip(names, pack.factors or [1.0] * len(names), strict=True)
        begins = [kernel.HEADER, *(kernel.HEADER + end for end in accumulate(map(len, packs)))]
        changes = pack_modifiers(self.modifiers, 2.0 * math.pi if self.axis == "linear" else 1.0)
        content = [*chain(*packs), *changes.values]
        end = kernel.HEADER + len(content)
        values = np.zeros(kernel.PLAIN_ROOM if self.network is None else kernel.PARAMETER_ROOM)
        values[:4] = self._is_extended, begins[len(packs) - 1], begins[-1], 0.0 if self.network is None else end
        values[kernel.HEADER : end] = content
        if self.network is not None:
            learned = self.network.values
            room = kernel.PARAMETER_ROOM - end
            if learned.size > room:
                raise UsageError(
                    f"the network has {learned.size} numbers; together with {self.family.name} at most {room} fit"
                )
            values[end : end + learned.size] = learned
        return values, [*packed, *((name, 1.0) for name in changes.names)]

    def _name(self, name: str | None, side: str, own: Mapping[str, Any]) -> str | None:
        """Return the name of a parameter in `free`; parameters that differ between the directions get two names."""
        if name is None:
            return None
        parameter = name.partition("[")[0]
        source = self._default_sources.get(parameter)
        if source is not None and parameter not in {**self.given, **self.modifiers.get("direction", {}).get(side, {})}:
            return self._name(source, side, own)  # a default that follows another parameter changes with it
        is_own = parameter in self.modifiers.get("direction", {}).get(side, {})
        return f"direction.{side}.{name}" if is_own or own[parameter] != self.parameters[parameter] else name

    def _notes(self) -> Iterator[str]:
        sides = [self._side(side) for side in SIDES]
        if any(side.get("static", math.inf) < side.get("coulomb", 0.0) for side in sides):
            yield "static is below coulomb: this axis has no Stribeck hump"
        if "temperature" in self.modifiers and self.modifiers["temperature"]["coefficient"] != 0.0:
            yield "the level depends on temperature; where none is known, the reference is assumed"
        stiff = {"sigma0", "stiffness"}
        if not self.family.is_static and any(
            stiff & set(each) for each in self.modifiers.get("direction", {}).values()
        ):
            yield "stiffness differs between the directions: the torque may jump at a reversal and release energy"
        if self.name == "bouc_wen" and any(side["gamma"] > side["beta"] for side in sides):
            yield "gamma is above beta: this hysteresis can release energy"

    @property
    def packed_names(self) -> tuple[str | None, ...]:
        """Names of the elements of ``values`` before a network, as in ``free``; None for what is not fitted."""
        return tuple(name for name, _ in self._packed_names)

    @property
    def name(self) -> str:
        """Name of the family."""
        return self.family.name

    @property
    def level(self) -> float:
        """Largest torque of slow motion in either direction, without other modifiers, N m."""
        own = max(self.family.level(self._side(side)) for side in SIDES)
        return own if self.network is None else max(own, self.network.level)

    @property
    def depends_on_temperature(self) -> bool:
        """True if the friction changes with temperature."""
        return not math.isnan(self.reference_temperature)

    @property
    def depends_on_load(self) -> bool:
        """True if the friction changes with the load torque."""
        return "load" in self.modifiers or (self.network is not None and self.network.structure.has_load)

    @property
    def reference_temperature(self) -> float:
        """Temperature at which the parameters hold, deg C: of the modifier, or the middle of a network's range.

        NaN for a model that does not depend on temperature.
        """
        modifier = self.modifiers.get("temperature")
        if modifier is not None and modifier["coefficient"] != 0.0:
            return float(modifier["reference"])
        if self.network is not None and self.network.structure.has_temperature:
            low, high = self.network.ranges["temperature"]
            return 0.5 * (low + high)
        return math.nan

    @property
    def presliding_stiffness(self) -> float:
        """Slope of torque over position at the start of motion, in the stiffer direction, N m/rad; 0: static map."""
        learned = 0.0 if self.network is None else self.network.presliding_stiffness
        if self.family.is_static or self.family is NETWORK_ALONE:
            return learned
        return max(self.family.stiffness(self._side(side)) for side in SIDES) + learned

    def initial_state(self) -> Array:
        """Return the state at rest without any deflection."""
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
        """Compute the friction torque of a velocity record, starting at rest.

        Parameters
        ----------
        velocity : (n,) array
            Velocity, held over each sample, rad/s.
        dt : float or (n,) array
            Length of the sample(s), s, above zero.
        position : float or (n,) array, optional
            Position at the end of each sample, rad; required by a model with ripple.
        load_torque : float or (n,) array, optional
            Load torque, N m, positive if it opposes positive motion; required by a model with load dependence.
        temperature : float or (n,) array, optional
            Temperature, deg C; the reference temperature when not given.
        applied_torque : float or (n,) array, optional
            Torque that a static map balances while the velocity is zero, N m; 0 when not given.
        out : (n,) array, optional
            Contiguous float64 array for the result.

        Returns
        -------
        (n,) array
            Torque at the end of each sample, N m.

        Raises
        ------
        UsageError
            A shape is wrong, a value is not finite, or a required input is missing.
        """
        inputs = self._inputs(velocity, dt, position, load_torque, temperature, applied_torque)
        torque = np.empty(inputs[0].size) if out is None else checked_out(out, (inputs[0].size,))
        if out is not None and np.may_share_memory(out, inputs[0]):
            raise UsageError("out must not share memory with the velocity")
        kind, state = dispatch.tag(self.kind, has_network=self.network is not None), self.initial_state()
        v, steps, positions, loads, celsius, applied = inputs
        if self.network is not None and self.family is NETWORK_ALONE and not self.modifiers and steps.size == 1:
            require_finite("velocity", v)
            network_runs.run(self.network.values, state, v, steps[0], positions, loads, celsius, torque)
            return torque
        if self._is_plain(inputs):
            is_finite = kernel.run_plain(kind, self.values, state, v, steps[0], applied[0], torque)
        else:
            is_finite = kernel.run(kind, self.values, state, *inputs, torque)
        if not is_finite:
            require_finite("velocity", v)
        return torque

    def _is_plain(self, inputs: tuple[Array, ...]) -> bool:
        """Return True if `kernel.run_plain` can do the work of `kernel.run`, for which it compiles much faster."""
        return not self._is_extended and inputs[1].size == 1 and inputs[5].size == 1

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
        """Compute the torque of `simulate` and its derivatives with respect to parameters.

        The derivatives are exact for the discrete model including its states (forward sensitivities by automatic
        differentiation). At a kink, such as the instant of sticking, they are those of the branch taken.

        Parameters
        ----------
        velocity, dt, position, load_torque, temperature, applied_torque
            See `simulate`.
        free : sequence of str or mapping, optional
            Names from the attribute `free`; all of them when not given. A mapping from names to weights gives the
            directional derivative, i.e. the weighted sum of the columns of these names, in one column.
        out : pair of arrays, optional
            Contiguous float64 arrays for torque (n,) and gradient (n, m). Useful for a fit with many calls, because
            allocating large arrays costs more time than the simulation.

        Returns
        -------
        torque : (n,) array
            Friction torque, N m, with the same bits as from `simulate`.
        gradient : (n, m) array
            One column per free parameter, in N m per unit of the parameter.

        Raises
        ------
        UsageError
            As `simulate`; or a name is not in `free`.
        """
        if self.network is not None:
            raise UsageError("a model with a network has no gradient; networks are trained, not fitted")
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
                for index, (free_name, factor) in enumerate(self._packed_names):
                    if free_name is not None and free_name in weights:
                        seeds[index, column] = factor * weights[free_name]
            state, state_gradient = self.initial_state(), np.zeros((kernel.STATE_ROOM, WIDTH))
            model = dispatch.tag(self.kind), self.values, seeds, state, state_gradient
            if self._is_plain(inputs):
                v, steps, _, _, _, applied = inputs
                sensitivity.run_plain(*model, v, steps[0], applied[0], torque, gradient, first)
            else:
                sensitivity.run(*model, *inputs, torque, gradient, first)
        return torque, gradient

    def steady_state(
        self, velocity: ArrayLike, *, load_torque: float | None = None, temperature: float | None = None
    ) -> Array:
        """Compute the steady torque at constant velocity.

        Parameters
        ----------
        velocity : (n,) array
            Velocity, rad/s.
        load_torque, temperature : float, optional
            See `simulate`.

        Returns
        -------
        (n,) array
            Torque without ripple, N m; 0 at rest.
        """
        v = vector("velocity", velocity)
        require_finite("velocity", v)
        dt = 1.0 if self.network is None else self.network.period_s  # a narx runs at no other
        _, _, _, load, celsius, _ = self._inputs(v[:1], dt, 0.0, load_torque, temperature, None)
        torque = np.empty(v.size)
        kernel.steady_curve(dispatch.tag(self.kind), self.values, v, load[0], celsius[0], torque)
        if self.network is not None:
            network_runs.add_steady_curve(self.network.values, v, load[0], celsius[0], torque)
        return torque

    def places_of(self, name: str) -> list[tuple[int, float]]:
        """Return index and factor of each element of ``values`` in which the number called ``name`` is."""
        return [(index, factor) for index, (each, factor) in enumerate(self._packed_names) if each == name]

    def dissipated_energy(self, velocity: ArrayLike, dt: ArrayLike, **inputs: Any) -> Array:
        """Compute the work done against friction, from the start of the record to the end of each sample.

        Parameters
        ----------
        velocity, dt, **inputs
            See `simulate`.

        Returns
        -------
        (n,) array
            Cumulative sum of F v dt, J. A dynamic model stores a part of it in its state and returns that part later;
            over a cycle that returns to the same velocity and state, all of it is dissipated.
        """
        torque = self.simulate(velocity, dt, **inputs)
        work: Array = np.cumsum(torque * vector("velocity", velocity) * np.asarray(dt, dtype=np.float64))
        return work

    def start(self, purpose: Purpose = "feedforward", velocity_epsilon: float | None = None) -> "Runner":
        """Return a runner at rest, which computes one sample at a time.

        Parameters
        ----------
        purpose : {"feedforward", "simulation"}
            A feed-forward smooths the jump of a static map at zero velocity; a simulation sticks exactly.
        velocity_epsilon : float, optional
            Width of that smoothing, rad/s; two to three times the velocity noise is suitable. The default is a
            twentieth of the Stribeck velocity, or `DEFAULT_VELOCITY_EPSILON` for a model without one.
        """
        if purpose not in ("feedforward", "simulation"):
            raise UsageError(f"purpose is 'feedforward' or 'simulation', not {purpose!r}")
        if purpose == "simulation":
            if velocity_epsilon is not None:
                raise UsageError("velocity_epsilon belongs to the purpose 'feedforward'; a simulation sticks exactly")
            return Runner(self, 0.0)
        scale = self.parameters.get("stribeck_velocity", DEFAULT_VELOCITY_EPSILON / _EPSILON_FRACTION)
        epsilon = _EPSILON_FRACTION * scale if velocity_epsilon is None else float(velocity_epsilon)
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
        """Convert the inputs of a simulation to arrays of one or n elements; only the velocity may be non-finite."""
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
    """A model together with its state, which `step` advances."""

    __slots__ = ("_address", "_is_modified", "_state", "_step_plain", "_step_whole", "_whole")

    def __init__(self, model: FrictionModel, epsilon: float) -> None:
        whole = np.zeros(kernel.WHOLE_ROOM)
        whole[0], whole[1] = model.kind, epsilon
        whole[2 : 2 + model.values.size] = model.values
        self.__setstate__((whole, model._is_extended))

    def __getstate__(self) -> tuple[Array, bool]:
        return self._whole.copy(), self._is_modified

    def __setstate__(self, saved: tuple[Array, bool]) -> None:
        # one array passed by its address: a scalar argument costs a tenth of a microsecond, an array two
        whole, self._is_modified = saved
        self._whole = np.array(whole)  # a writeable copy
        self._address = self._whole.ctypes.data
        self._state = self._whole[-kernel.STATE_ROOM :]
        has_network = whole[2 + kernel.BEGIN_OF_NETWORK] > 0.0  # without one, the other kernel compiles much faster
        self._step_plain = ready(kernel.step_plain)
        self._step_whole = ready(kernel.step_with_network if has_network else kernel.step_whole)
        kernel.prepare(self._step_plain, 2)
        kernel.prepare(self._step_whole, 6)

    @property
    def state(self) -> Array:
        """State, as a live view: copy it to save it, assign to its elements to restore it."""
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
        """Advance the state by ``dt`` seconds with ``velocity`` held, and return the torque, N m.

        The inputs are those of `FrictionModel.simulate`. For speed they are not checked: they must be finite, and
        ``dt`` must be above zero.
        """
        if not self._is_modified and applied_torque == 0.0:
            return self._step_plain(self._address, velocity, dt)
        celsius = math.nan if temperature is None else temperature
        return self._step_whole(self._address, velocity, dt, position, load_torque, celsius, applied_torque)


def _brief(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def as_dict(model: FrictionModel) -> dict[str, Any]:
    """Return the content of a model file under ``friction``."""
    content: dict[str, Any] = {"model": model.name, "parameters": dict(model.given)}
    return {**content, "modifiers": dict(model.modifiers)} if model.modifiers else content
