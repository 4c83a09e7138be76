"""Long signals in pictures and pages: no peak is lost."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from friction_hil.reports.decimation import bucket_size, decimated, decimated_time

VALUES = arrays(np.float64, st.integers(1, 300), elements=st.floats(-1e9, 1e9) | st.just(np.nan))


@given(VALUES, st.integers(2, 50))
def test_each_bucket_keeps_its_extremes_in_their_order(values, size):
    kept = decimated(values, size)
    assert len(kept) == 2 * -(-len(values) // size) == len(decimated_time(np.arange(len(values), dtype=float), size))
    for k, pair in enumerate(kept.reshape(-1, 2)):
        bucket = values[k * size : (k + 1) * size]
        known = bucket[~np.isnan(bucket)]
        if not known.size:
            assert np.isnan(pair).all()
            continue
        assert sorted(pair) == [known.min(), known.max()]
        first, second = (int(np.flatnonzero(bucket == each)[0]) for each in (known.min(), known.max()))
        assert pair[0] == (known.min() if first <= second else known.max())


@given(st.integers(1, 10**7), st.integers(2, 10**5))
def test_no_more_points_than_asked_for_are_left(rows, most):
    size = bucket_size(rows, most)
    assert size == 1 if rows <= most else 2 * -(-rows // size) <= most + 2


@given(st.integers(2, 500), st.integers(2, 40))
def test_times_do_not_decrease_and_stay_within_their_bucket(rows, size):
    time = np.cumsum(np.linspace(0.5, 2.0, rows))
    kept = decimated_time(time, size)
    assert np.all(np.diff(kept) >= 0.0)
    assert kept[0] == time[0]
    starts = np.repeat(time[::size], 2)
    assert np.all(kept >= starts)
