"""A row of the recording: each value stands in the column of its name."""

import math

import numpy as np

from friction_hil.compensator import CompensatorInputs, input_checksum
from friction_hil.daemon.row import AxisRow, row_width
from friction_hil.recordings import columns

INPUTS = CompensatorInputs(
    cycle=7.0,
    position=1.5,
    velocity=2.5,
    torque=3.5,
    position_demand=4.5,
    velocity_demand=5.5,
    velocity_demand_ahead=6.5,
    is_fresh=True,
    is_enabled=False,
    acceleration_demand_ahead=14.5,
    temperature=15.5,
)
OTHERS = {"velocity_estimate": 7.5, "compensation": 8.5, "command": 9.5, "state": 2, "drive_state": 5}


def row(shadows=(), state_size=0):
    return AxisRow(np.full(row_width(shadows) + state_size, math.nan), shadows)


def test_every_value_stands_in_the_column_of_its_name():
    one = row()
    one.write_cycle(0.007, INPUTS, **OTHERS)
    one.write_timing(11.5, 12.5, 13.5, 19.0)
    one.write_estimates(16.5, 17.5, 18.5)
    expected = INPUTS._asdict() | OTHERS | {"time_s": 0.007, "late_us": 11.5, "exchange_us": 12.5, "path_lag_s": 13.5}
    expected |= {"change": 19.0, "load_estimate": 16.5, "temperature_estimate": 17.5, "motor_offset": 18.5}
    expected |= {"checksum": input_checksum(*INPUTS)}
    unknown = dict.fromkeys(("torque_demand", "load_torque", "load_position", "compensation_uncertainty"), math.nan)
    written = dict(zip(columns.NAMES, one.values.tolist(), strict=True))
    np.testing.assert_equal(written, {name: float(value) for name, value in (expected | unknown).items()})


def test_shadows_follow_the_columns_and_states_follow_the_shadows():
    one = row(["a", "b"], 5)
    one.write_shadow("b", 0.25)
    one.write_states([np.array([1.0, 2.0]), np.array([3.0])])
    np.testing.assert_equal(one.values[len(columns.NAMES) :], [math.nan, 0.25, 1.0, 2.0, 3.0, math.nan, math.nan])


def test_a_cleared_row_keeps_time_and_cycle_alone():
    one = row(["a"], 2)
    one.write_cycle(0.007, INPUTS, **OTHERS)
    one.clear(0.008, 8)
    written = one.values.tolist()
    assert written[:2] == [0.008, 8.0]
    assert np.isnan(written[2:]).all()
