"""Two simulated servos that share a mechanism, as objects."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.numerics.jit import Array, StructuredArray
from friction_hil.servo import coupled, mechanics
from friction_hil.servo.assembly import machine_record
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.mechanisms import Gantry, TwoLinkArm, axis_mistakes, mechanism_record, reflected_inertias
from friction_hil.servo.records import MECHANISM_STATE
from friction_hil.servo.servo import Energy, Servo


class _CoupledServo(Servo):
    """One of the servos: it lets the mechanism move whenever its own time passes."""

    def __init__(
        self,
        config: ServoConfig,
        position: float,
        external: Array | None,
        inertia: float,
        advance: Callable[[int], None],
    ) -> None:
        self._inertia = inertia
        self._advance = advance
        super().__init__(config, position, external)

    def _plant_record(self) -> StructuredArray:
        return machine_record(self.config, self._external)

    @property
    def total_inertia(self) -> float:
        """Of the motor and its share of the mechanism, kg m^2 or kg; see `mechanisms.reflected_inertias`."""
        return self.config.mechanics.inertia + self._inertia

    def advance(self, steps: int) -> None:
        """Let ``steps`` integration steps pass for this servo; see `CoupledServos`."""
        self._advance(steps)

    @property
    def energy(self) -> Energy:
        """Not kept for one axis: always raises a `UsageError`, because the mechanism is shared."""
        raise UsageError("an axis of a mechanism keeps no account of its own: ask CoupledServos.energy")


class CoupledServos:
    """Two servos and the mechanism that they move.

    Each of `servos` is a `Servo` like any other: it has set-points, and `Servo.advance` lets its time pass. The
    mechanism, and the other servo with it, moves up to the latest time that any of them has reached; the other one's
    calls then take it there without moving anything again. So it makes no difference which of two drives is served
    first at a SYNC, as long as both have their set-points before the next one. Raises `UsageError`: a servo does not go
    with the mechanism.
    """

    def __init__(
        self,
        mechanism: Gantry | TwoLinkArm,  # its `axes` name the servos, in messages
        configs: Sequence[ServoConfig],  # two, in the order of `axes`, with one `integration_hz`
        positions: Sequence[float] = (0.0, 0.0),  # initial ones, at rest, rad or m
        externals: Sequence[Array | None] = (None, None),  # see `Servo`
    ) -> None:
        for name, config in zip(mechanism.axes, configs, strict=True):
            for key, text in axis_mistakes(mechanism, name, config):
                raise UsageError(f"{name}: {key} {text}")
        if configs[0].integration_hz != configs[1].integration_hz:
            raise UsageError(f"{' and '.join(mechanism.axes)} need the same integration_hz")
        self.mechanism = mechanism
        self._record = mechanism_record(mechanism)
        self._state = np.zeros(1, MECHANISM_STATE)
        self._ahead = [0, 0]  # steps that a servo has moved, but that have not passed for it
        inertias = reflected_inertias(mechanism)
        self.servos: tuple[Servo, Servo] = (
            _CoupledServo(configs[0], positions[0], externals[0], inertias[0], lambda steps: self._pass(0, steps)),
            _CoupledServo(configs[1], positions[1], externals[1], inertias[1], lambda steps: self._pass(1, steps)),
        )
        self._axes = (*self.servos[0].records, *self.servos[1].records)

    def advance(self, steps: int) -> None:
        """Simulate ``steps`` integration steps of both servos."""
        for servo in self.servos:
            servo.advance(steps)

    def _pass(self, index: int, steps: int) -> None:
        """Let time pass for one of the servos."""
        done = min(self._ahead[index], steps)
        self._ahead[index] -= done
        if steps > done:
            coupled.advance(self._record, self._state, *self._axes, steps - done)
            self._ahead[1 - index] += steps - done

    @property
    def records(self) -> tuple[StructuredArray, StructuredArray]:
        """Mechanism and its state as the compiled functions of `friction_hil.servo.coupled` take them, live."""
        return self._record, self._state

    @property
    def energy(self) -> Energy:
        """Energies of both axes and the mechanism since the start, J.

        ``load_work`` includes that of the force at the tool; ``coupling_heat`` is that of the yaw damping.
        """
        first, second = self.servos
        stored = coupled.stored_energy(
            self._record, first.true_position, second.true_position, first.true_velocity, second.true_velocity
        )
        works = {"motor_work": 0.0, "load_work": float(self._state[0]["tool_work"]), "friction_heat": 0.0}
        for servo in self.servos:
            plant, _, state = servo.records
            stored += mechanics.stored_energy(plant, state)
            for name in works:
                works[name] += float(state[0][name])
        return Energy(stored=stored, load_friction_heat=0.0, coupling_heat=float(self._state[0]["heat"]), **works)

    @property
    def tool(self) -> tuple[float, float]:
        """What the motors move.

        Arm: position of the tool from the shoulder, x to the right and y upwards, m. Gantry: position of the payload,
        m, and yaw of the beam, rad.
        """
        q1, q2 = (servo.true_position for servo in self.servos)
        if isinstance(self.mechanism, Gantry):
            yaw = (q2 - q1) / self.mechanism.span
            return 0.5 * (q1 + q2) + yaw * self.mechanism.payload.position, yaw
        first, second = (link.length for link in self.mechanism.links)
        return (
            first * math.sin(q1) + second * math.sin(q1 + q2),
            -first * math.cos(q1) - second * math.cos(q1 + q2),
        )
