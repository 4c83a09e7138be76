"""One axis's part of a row of the recording: columns by name, then the shadow models, then the states."""

import math
from collections.abc import Sequence
from typing import cast

from friction_hil.compensator import CompensatorInputs
from friction_hil.numerics.jit import Array
from friction_hil.recordings import columns

_TIME = columns.NAMES.index(columns.TIME)
_CYCLE = columns.NAMES.index("cycle")
_POSITION = columns.NAMES.index("position")
_VELOCITY = columns.NAMES.index("velocity")
_LOAD_POSITION = columns.NAMES.index("load_position")
_TORQUE = columns.NAMES.index("torque")
_POSITION_DEMAND = columns.NAMES.index("position_demand")
_VELOCITY_DEMAND = columns.NAMES.index("velocity_demand")
_VELOCITY_DEMAND_AHEAD = columns.NAMES.index("velocity_demand_ahead")
_ACCELERATION_DEMAND_AHEAD = columns.NAMES.index("acceleration_demand_ahead")
_LOAD_TORQUE = columns.NAMES.index("load_torque")
_TEMPERATURE = columns.NAMES.index("temperature")
_IS_FRESH = columns.NAMES.index("is_fresh")
_IS_ENABLED = columns.NAMES.index("is_enabled")
_VELOCITY_ESTIMATE = columns.NAMES.index("velocity_estimate")
_LOAD_ESTIMATE = columns.NAMES.index("load_estimate")
_TEMPERATURE_ESTIMATE = columns.NAMES.index("temperature_estimate")
_MOTOR_OFFSET = columns.NAMES.index("motor_offset")
_VELOCITY_OFFSET = columns.NAMES.index("velocity_offset")
_COMPENSATION = columns.NAMES.index("compensation")
_FEEDFORWARD = columns.NAMES.index("feedforward")
_COMMAND = columns.NAMES.index("command")
_STATE = columns.NAMES.index("state")
_DRIVE_STATE = columns.NAMES.index("drive_state")
_CHECKSUM = columns.NAMES.index("checksum")
_LATE_US = columns.NAMES.index("late_us")
_EXCHANGE_US = columns.NAMES.index("exchange_us")
_PATH_LAG_S = columns.NAMES.index("path_lag_s")
_CHANGE = columns.NAMES.index(columns.CHANGE)


def row_width(shadow_names: Sequence[str]) -> int:
    """Return the number of columns: those of every recording and one for each shadow model."""
    return len(columns.NAMES) + len(shadow_names)


class AxisRow:
    """Writer of one axis's part of a row."""

    __slots__ = ("_cells", "_first_shadow", "_first_state", "_shadow_names", "values")

    def __init__(self, values: Array, shadow_names: Sequence[str]) -> None:
        self.values = values  # (width,) `row_width` columns, then the states of the compensators; kept, and written to
        self._cells = cast("memoryview[float]", values.data)
        self._shadow_names = list(shadow_names)  # of all axes, in the order of their columns
        self._first_shadow = len(columns.NAMES)
        self._first_state = row_width(shadow_names)

    def write_cycle(
        self,
        time_s: float,
        inputs: CompensatorInputs,
        velocity_estimate: float,
        compensation: float,
        command: float,
        state: int,
        drive_state: int,
    ) -> None:
        """Write the columns of a cycle; those that nothing is known of stay NaN, the timing is written later."""
        cells = self._cells
        cells[_TIME] = time_s
        cells[_CYCLE] = inputs.cycle
        cells[_POSITION] = inputs.position
        cells[_VELOCITY] = inputs.velocity
        cells[_TORQUE] = inputs.torque
        cells[_POSITION_DEMAND] = inputs.position_demand
        cells[_VELOCITY_DEMAND] = inputs.velocity_demand
        cells[_VELOCITY_DEMAND_AHEAD] = inputs.velocity_demand_ahead
        cells[_ACCELERATION_DEMAND_AHEAD] = inputs.acceleration_demand_ahead
        cells[_LOAD_TORQUE] = inputs.load_torque
        cells[_TEMPERATURE] = inputs.temperature
        cells[_IS_FRESH] = inputs.is_fresh
        cells[_IS_ENABLED] = inputs.is_enabled
        cells[_VELOCITY_ESTIMATE] = velocity_estimate
        cells[_COMPENSATION] = compensation
        cells[_COMMAND] = command
        cells[_STATE] = state
        cells[_DRIVE_STATE] = drive_state
        cells[_CHECKSUM] = columns.input_checksum(*inputs)

    def write_feedforward(self, torque: float) -> None:
        """Write the torque that is fed forward beside the compensation, N m."""
        self._cells[_FEEDFORWARD] = torque

    def write_load(self, position: float) -> None:
        """Write the position by an encoder at the load."""
        self._cells[_LOAD_POSITION] = position

    def write_estimates(self, load_torque: float, temperature: float, motor_offset: float) -> None:
        """Write load and temperature that the model was given, and the offset of the motor from the demand."""
        self._cells[_LOAD_ESTIMATE] = load_torque
        self._cells[_TEMPERATURE_ESTIMATE] = temperature
        self._cells[_MOTOR_OFFSET] = motor_offset

    def write_velocity_offset(self, offset: float) -> None:
        """Write the velocity offset that gives the compensation."""
        self._cells[_VELOCITY_OFFSET] = offset

    def write_shadow(self, name: str, torque: float) -> None:
        """Write the torque of a shadow model, N m."""
        self.values[self._first_shadow + self._shadow_names.index(name)] = torque

    def write_states(self, states: Sequence[Array]) -> None:
        """Write the flat states of the compensator and the shadow models, one after the other."""
        start = self._first_state
        for state in states:
            self.values[start : start + state.size] = state
            start += state.size

    def write_timing(self, late_us: float, exchange_us: float, path_lag_s: float, change: float = 0.0) -> None:
        """Write how late the cycle began, how long its exchange took, the lag of the path, and the last change."""
        self._cells[_LATE_US] = late_us
        self._cells[_EXCHANGE_US] = exchange_us
        self._cells[_PATH_LAG_S] = path_lag_s
        self._cells[_CHANGE] = change

    def clear(self, time_s: float, cycle: int) -> None:
        """Write NaN to everything but time and cycle."""
        self.values.fill(math.nan)
        self.values[_TIME], self.values[_CYCLE] = time_s, cycle
