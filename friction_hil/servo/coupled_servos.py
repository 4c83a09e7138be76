"""Simulated servos that share a mechanism, as objects."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from friction_hil.dynamics.newton_euler import LINK, potential_energy
from friction_hil.errors import UsageError
from friction_hil.numerics.jit import Array, StructuredArray
from friction_hil.servo import coupled, mechanics
from friction_hil.servo.assembly import machine_record
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.mechanisms import (
    Gantry,
    Linkage,
    TwoLinkArm,
    axis_mistakes,
    mechanism_record,
    planar,
    reflected_inertias,
)
from friction_hil.servo.records import JOINT, MECHANISM_STATE
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

    def share(self, plant: StructuredArray, controller: StructuredArray, state: StructuredArray) -> None:
        """Use these records, of the same content, from now on."""
        self._plant, self._controller, self._state = plant, controller, state
        self._s = state.view(np.float64)
        self._get = self._s.item

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
    """Servos and the mechanism that they move.

    Each of `servos` is a `Servo` like any other: it has set-points, and `Servo.advance` lets its time pass. The
    mechanism, and the other servos with it, moves up to the latest time that any of them has reached; the others' calls
    then take them there without moving anything again. So it makes no difference which of the drives is served first at
    a SYNC, as long as all have their set-points before the next one. Raises `UsageError`: a servo does not go with the
    mechanism.
    """

    def __init__(
        self,
        mechanism: Gantry | TwoLinkArm | Linkage,  # its `axes` name the servos, in messages
        configs: Sequence[ServoConfig],  # in the order of `axes`, with one `integration_hz`
        positions: Sequence[float] | None = None,  # initial ones, at rest, rad or m; 0 by default
        externals: Sequence[Array | None] | None = None,  # see `Servo`
    ) -> None:
        for name, config in zip(mechanism.axes, configs, strict=True):
            for key, text in axis_mistakes(mechanism, name, config):
                raise UsageError(f"{name}: {key} {text}")
        if len({config.integration_hz for config in configs}) > 1:
            raise UsageError(f"{' and '.join(mechanism.axes)} need the same integration_hz")
        n, inertias = len(configs), reflected_inertias(mechanism)
        positions = [0.0] * n if positions is None else positions
        externals = [None] * n if externals is None else externals
        self.mechanism = mechanism
        self._moved, self._passed = 0, [0] * n  # integration steps of the mechanism, and of each servo
        servos = [
            _CoupledServo(configs[i], positions[i], externals[i], inertias[i], partial(self._pass, i)) for i in range(n)
        ]
        plants, controllers, states = map(np.concatenate, zip(*(servo.records for servo in servos), strict=True))
        for i, servo in enumerate(servos):
            servo.share(plants[i : i + 1], controllers[i : i + 1], states[i : i + 1])
        self.servos: tuple[Servo, ...] = tuple(servos)
        moved = planar(mechanism) if isinstance(mechanism, TwoLinkArm) else mechanism
        none = np.zeros(0, LINK)
        self.records = coupled.Coupled(
            mechanism=mechanism_record(moved),
            total=np.zeros(1, MECHANISM_STATE),
            joints=np.zeros(n, JOINT),
            plants=plants,
            controllers=controllers,
            states=states,
            links=none if isinstance(moved, Gantry) else moved.arm.links,
            tool=none if isinstance(moved, Gantry) else moved.tool.links,
            gravity=np.zeros(3) if isinstance(moved, Gantry) else moved.arm.gravity_vector,
            matrix=np.zeros((n, n)),
            factor=np.zeros((n, n)),
        )
        coupled.prepare(self.records)

    def advance(self, steps: int) -> None:
        """Simulate ``steps`` integration steps of all servos."""
        for servo in self.servos:
            servo.advance(steps)

    def _pass(self, index: int, steps: int) -> None:
        """Let time pass for one of the servos."""
        self._passed[index] += steps
        if self._passed[index] > self._moved:
            coupled.advance(self.records, self._passed[index] - self._moved)
            self._moved = self._passed[index]

    @property
    def energy(self) -> Energy:
        """Energies of all axes and the mechanism since the start, J.

        ``load_work`` includes that of the force at the tool; ``coupling_heat`` is that of the yaw damping.
        """
        total = self.records.total[0]
        stored = coupled.stored_energy(self.records)
        works = {"motor_work": 0.0, "load_work": float(total["tool_work"]), "friction_heat": 0.0}
        for servo in self.servos:
            plant, _, state = servo.records
            stored += mechanics.stored_energy(plant, state)
            for name in works:
                works[name] += float(state[0][name])
        return Energy(stored=stored, load_friction_heat=0.0, coupling_heat=float(total["heat"]), **works)

    @property
    def tool(self) -> tuple[float, ...]:
        """What the motors move.

        Arm: position of the tool in the frame of the base, m: x, y and z, or of a two-link arm x to the right and y
        upwards from the shoulder. Gantry: position of the payload, m, and yaw of the beam, rad.
        """
        q = np.array([servo.true_position for servo in self.servos])
        if isinstance(self.mechanism, Gantry):
            yaw = (q[1] - q[0]) / self.mechanism.span
            return float(0.5 * (q[0] + q[1]) + yaw * self.mechanism.payload.position), float(yaw)
        # 1 kg at the tool has the potential of its position where gravity is 1 m/s^2 against an axis
        space = 2 if isinstance(self.mechanism, TwoLinkArm) else 3
        return tuple(potential_energy(self.records.tool, -axis, q, 0.0 * q)[0] for axis in np.eye(3)[:space])
