"""The kind of an axis: rotary or linear, as the daemon has recorded it, or as the user says."""

import numpy as np
import pytest

from friction_hil.errors import UsageError
from friction_hil.recordings import Recording
from friction_hil.recordings.given import kind_of


def recorded(kind=None, path="log.mcap"):
    axes = {} if kind is None else {"x": {"model": {"axis": kind}}}
    return Recording(path, "x", {"time_s": np.arange(3.0)}, metadata={"configuration": {"axes": axes}})


@pytest.mark.parametrize("is_linear", [False, True])
def test_a_recording_of_the_daemon_needs_no_option_and_of_others_it_decides(is_linear):
    assert kind_of([recorded(), recorded()], is_linear=is_linear) == ("linear" if is_linear else "rotary")
    assert kind_of([recorded(), recorded("linear")], is_linear=is_linear) == "linear"


def test_what_contradicts_is_refused():
    with pytest.raises(UsageError, match=r"^a: axis 'x' .*--linear$"):
        kind_of([recorded("rotary", "a")], is_linear=True)
    with pytest.raises(UsageError, match=r"^b: axis 'x' .*rotary by a$"):
        kind_of([recorded("rotary", "a"), recorded("linear", "b")], is_linear=False)


@pytest.mark.parametrize("metadata", [{}, {"configuration": None}, {"configuration": {"axes": {"x": {"model": 3}}}}])
def test_metadata_of_others_says_nothing(metadata):
    other = Recording("log.csv", "x", {"time_s": np.arange(3.0)}, metadata=metadata)
    assert other.axis_kind is None
