"""Long signals in pictures and pages: no peak is lost, in Python and in the page's JavaScript."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from friction_hil.reports.decimation import bucket_size, decimated, decimated_time

PAGE = Path(__file__).parents[2] / "friction_hil/reports/run/page.js"
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


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node here to run the page's JavaScript")
def test_the_page_keeps_the_peaks_of_the_visible_range():
    rng = np.random.default_rng(7)
    time, values = np.arange(20_000) * 1e-3, rng.normal(size=20_000)
    values[12_345], values[3_210], values[5_000:5_010] = 99.0, -99.0, np.nan
    program = f"""
        const {{decoded, firstFrom, reduced}} = require({json.dumps(str(PAGE))});
        const given = JSON.parse(require("fs").readFileSync(0, "utf8"));
        const values = Float64Array.from(given.values.map((each) => (each === null ? NaN : each)));
        const time = Float64Array.from(given.time);
        console.log(JSON.stringify({{
          whole: reduced(time, values, 0, 100, 1000), part: reduced(time, values, 3.2, 3.25, 1000),
          first: [firstFrom(time, -1), firstFrom(time, 0.0005), firstFrom(time, 99)],
          bytes: Array.from(decoded(Buffer.from(new Float32Array([1.5, -2]).buffer).toString("base64"), Float32Array)),
        }}));
    """
    given_text = json.dumps({"time": time.tolist(), "values": [None if np.isnan(v) else v for v in values]})
    done = subprocess.run(["node", "-e", program], input=given_text, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert len(found["whole"]["x"]) <= 1000
    assert max(y for y in found["whole"]["y"] if y is not None) == 99.0
    assert min(y for y in found["whole"]["y"] if y is not None) == -99.0
    at = found["whole"]["y"].index(99.0)
    assert found["whole"]["x"][at] == time[12_345]
    rows = slice(round(3.2 / 1e-3) - 1, round(3.25 / 1e-3) + 2)
    assert found["part"]["x"] == pytest.approx(time[rows].tolist())
    assert found["part"]["y"] == values[rows].tolist()
    assert found["first"] == [0, 1, 20_000]
    assert found["bytes"] == [1.5, -2.0]
