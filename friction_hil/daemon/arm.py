"""The arm that axes move: load of their gears and torque to feed forward, of all joints before the first command."""

from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from friction_hil.daemon.axis import AxisLoop
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import Feedback
from friction_hil.drive.codes import FaultCode
from friction_hil.dynamics import torques
from friction_hil.numerics.jit import ready

if TYPE_CHECKING:
    from friction_hil.config.arm import ArmConfig


class ArmTorques:
    """Loads and feed-forward of the axes of an arm, from the demanded motion of all of them.

    A joint without a demand, as outside of the motion, counts as at rest where it was in the cycle before: what is left
    is gravity. Each position is demanded, or has passed the checks of its axis.
    """

    def __init__(self, arm: "ArmConfig", axes: Sequence[AxisLoop]) -> None:
        names = [axis.name for axis in axes]
        self._places = [names.index(name) for name in arm.joints]
        self._axes = [axes[k] for k in self._places]
        dynamics, (work, known) = arm.dynamics, torques.workspace(len(arm.joints))
        for k, axis in enumerate(self._axes):  # in cst the drive has nothing to feed forward
            work[torques.LEFT, k] = 0.0 if axis.is_by_torque else arm.drive_inertia.get(axis.name, np.nan)
        self._find: Any = ready(torques.find_torques)
        self._arguments = dynamics.links, dynamics.gravity_vector, work, known
        self._cells = cast("memoryview[float]", work.data)
        self._find(*self._arguments)

    def update(self, cycle: int, state: LoopState, feedback: Sequence[Feedback]) -> str | None:
        """Give each axis its load and its torque of this cycle; return a fault, once.

        After an exception the weight is left: the arm is stopped, and must not fall.
        """
        if self._axes[0].is_arm_lost:
            return None
        try:
            self._update(cycle, state, feedback)
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - whatever it is, the machine must come to rest
            for axis in self._axes:
                axis.is_arm_lost = True
            with suppress(Exception):  # else the torques stay what they were
                self._leave_weight()
            text = f"arm: the computation failed: {type(error).__name__}: {error}"
            return FaultCode.COMPUTATION_FAILED.append_to(text)
        return None

    def _update(self, cycle: int, state: LoopState, feedback: Sequence[Feedback]) -> None:
        cells: Any = self._cells
        for k, axis in enumerate(self._axes):
            motion = axis.arm_motion(cycle, state, feedback[self._places[k]])
            cells[torques.Q, k], cells[torques.DQ, k], cells[torques.DDQ, k] = motion
        self._give()

    def _leave_weight(self) -> None:
        """Give the torques that hold the arm where its joints were last."""
        cells: Any = self._cells
        for k in range(len(self._axes)):
            cells[torques.DQ, k] = cells[torques.DDQ, k] = 0.0
        self._give()

    def _give(self) -> None:
        cells: Any = self._cells
        self._find(*self._arguments)
        for k, axis in enumerate(self._axes):
            axis.take_arm(cells[torques.LOAD, k], cells[torques.FED, k])
