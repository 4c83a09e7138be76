"""The fingerprint of machine and software."""

import json

import numpy as np

from friction_hil.recordings.fingerprint import differences, fingerprint


def test_it_is_the_same_twice_and_fits_into_json() -> None:
    ours = fingerprint()
    assert differences(ours, fingerprint()) == []
    assert json.loads(json.dumps(ours)) == ours
    assert ours["numpy"] == np.__version__
    assert all(isinstance(value, str) for value in ours.values())
    assert ours["libc"] != "unknown"


def test_differences_name_both_sides() -> None:
    a = {"cpu": "A", "numpy": "2.0", "gone": "1"}
    b = {"cpu": "A", "numpy": "2.1", "new": "3"}
    assert differences(a, b) == ["numpy: 2.0, here 2.1", "gone: 1, here not reported", "new: not reported, here 3"]
