"""What ``tools/bench serial`` makes of drives that leave its cycles no time."""

import math

import pytest

from tools.benchmarks import serial

pytestmark = pytest.mark.deep  # of the tools, not of the product


class SlowDrives:
    """Never answer in time, and note calls of warm_caches."""

    is_warmed = False

    def receive(self, feedback, end_ns):
        feedback[0].is_fresh = False

    def send(self, commands):
        pass

    def warm_caches(self):
        self.is_warmed = True


def test_cycles_without_time_for_a_rehearsal_are_measured_all_the_same(capsys):
    drives = SlowDrives()
    fresh, used_s, warming_s = serial.paced(drives, 1e-9)  # each deadline has passed when it is looked at
    assert not drives.is_warmed
    assert (fresh, math.isnan(warming_s)) == (0.0, True)
    assert 0.0 <= used_s < 1.0
    assert "no cycle left time to warm the caches" in capsys.readouterr().err
