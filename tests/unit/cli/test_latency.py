"""``friction-hil latency``: the pacing of the loop, timed with a clock of the test, and cyclictest beside it."""

import json
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.cli import main
from friction_hil.cli.work import latency as command
from friction_hil.daemon import latency
from tests.loop_run import LateClock

PERIOD_S = 1e-3
# What cyclictest of rt-tests 2.4 prints with --histogram; the numbers are made up.
OUTPUT = """\
# /dev/cpu_dma_latency set to 0us
# Histogram
000000 000000
000016 000004
000017 000015
000030 000001
# Total: 000000020
# Min Latencies: 00016
# Avg Latencies: 00017
# Max Latencies: 02500
# Histogram Overflows: 00002
# Histogram Overflow at cycle number:
# Thread 0: 00003 00007
"""


@given(st.lists(st.integers(0, 5_000_000), min_size=1, max_size=50))
def test_lateness_and_missed_periods_are_those_of_the_clock(late_ns):
    """Against a clock that oversleeps by known times."""
    found = latency.measure(LateClock(dict(enumerate(late_ns))), PERIOD_S, len(late_ns))
    np.testing.assert_array_equal(found.late_us, np.sort(np.array(late_ns) * 1e-3))
    assert found.missed == sum(each // 1_000_000 for each in late_ns)
    assert found.max_us == max(late_ns) * 1e-3
    assert sum(found.histogram((0.0, 10.0, 1000.0))) == len(late_ns)
    for share in (0.5, 0.99):
        below = np.count_nonzero(found.late_us <= found.percentile_us(share))
        assert below >= share * len(late_ns)
        assert found.percentile_us(share) in found.late_us


@given(st.integers(0, 1000), st.integers(0, 5))
def test_simulated_drives_need_most_periods(count, periods):
    late = LateClock(dict.fromkeys(range(count), periods * 1_000_000))
    reason = latency.why_not_real_time(late, PERIOD_S)
    missed = count * periods
    assert bool(reason) == (missed / (1000 + missed) > 0.05)


def test_output_of_cyclictest_is_read():
    found = latency.parse_cyclictest(OUTPUT, PERIOD_S)
    assert found is not None
    assert found.late_us.tolist() == [16.5] * 4 + [17.5] * 15 + [30.5, 2500.0, 2500.0]
    assert found.missed == 4
    assert latency.parse_cyclictest("# Histogram\n", PERIOD_S) is None


def test_a_cyclictest_that_fails_is_reported(monkeypatch, answered, capsys):
    failed = subprocess.CompletedProcess([], 1, "", "unable to set affinity")
    monkeypatch.setattr(latency.subprocess, "run", lambda *_, **__: failed)
    assert main(["latency", "--duration", "0.01", "--priority", "0"]) == 1
    assert "(1): unable to set affinity" in capsys.readouterr().err


@pytest.fixture
def answered(monkeypatch):
    """cyclictest as it would answer; the list is of its command lines."""
    asked = []

    def run(words, **_):
        asked.append(words)
        return SimpleNamespace(stdout=OUTPUT, stderr="", returncode=0)

    monkeypatch.setattr(latency.shutil, "which", lambda _: "/usr/bin/cyclictest")
    monkeypatch.setattr(latency.subprocess, "run", run)
    return asked


def test_json_has_all_measurements(answered, capsys):
    words = ["--duration", "0.05", "--period", "0.005", "--spin", "100", "--priority", "0"]
    assert main(["latency", "--json", *words]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert list(summary) == ["period_s", "priority", "measurements", "note", "picture"]
    assert [each["name"] for each in summary["measurements"]] == ["loop, spin 100 µs", "loop, no spin", "cyclictest"]
    for each in summary["measurements"]:
        assert 0.0 <= each["p50_us"] <= each["p99_us"] <= each["max_us"]
        assert sum(each["histogram"]["wake_ups"]) == each["wake_ups"]
        assert len(each["histogram"]["from_us"]) == len(each["histogram"]["wake_ups"])
    assert [each["wake_ups"] for each in summary["measurements"]] == [10, 10, 22]
    assert (summary["measurements"][2]["missed"], summary["note"]) == (0, None)
    (asked,) = answered
    assert {"--interval=5000", "--loops=10", "--policy=other"} <= set(asked)


def test_a_terminal_gets_figures_histogram_and_picture(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(latency.shutil, "which", lambda _: None)
    clock = LateClock({k: 150_000 if k == 7 else 1500 for k in range(100)})
    monkeypatch.setattr(command, "RealClock", lambda spin_us: clock)
    picture = tmp_path / "latency.svg"
    words = ["--duration", "0.1", "--spin", "0", "--priority", "0", "--output", str(picture)]
    assert main(["latency", *words]) == 0
    out = capsys.readouterr().out
    assert "100 wake-ups of each, 1 ms apart; ordinary scheduling" in out
    assert next(line.split() for line in out.splitlines() if "no spin" in line)[3:] == ["1.5", "1.5", "150.0", "0"]
    rows = {line.split()[0]: line.split()[1:] for line in out.splitlines() if line.strip()[:1].isdigit()}
    assert (rows["1"][0], rows["2"], rows["100"][0]) == ("99", ["0"], "1")
    assert len(rows["1"][1]) > len(rows["100"][1]) > 0
    assert "sudo apt install rt-tests" in out
    assert "at most 150 µs late: 15 % of its period" in out
    assert "150" in picture.read_text()


def test_a_configuration_gives_period_spin_and_priority(monkeypatch, capsys, answered):
    asked = []

    def measure(clock, period_s, cycles):
        asked.append((clock.spin_ns, period_s, cycles))
        return latency.Latency(np.ones(1), 0)

    monkeypatch.setattr(command, "measure", measure)
    assert main(["latency", "config/serial_modbus.yaml", "--json", "--duration", "1", "--priority", "0"]) == 0
    period_s = json.loads(capsys.readouterr().out)["period_s"]
    assert asked == [(200_000, period_s, round(1.0 / period_s)), (0, period_s, round(1.0 / period_s))]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--period", "0"], "between 0.0001 and 1 s"),
        (["--period", "nan"], "between 0.0001 and 1 s"),
        (["--spin", "1000"], "1000 µs"),
        (["--duration", "inf"], "must be above 0"),
        (["--output", "x.nonsense"], "no picture format"),
        (["missing.yaml"], "missing.yaml"),
    ],
)
def test_mistakes_are_refused_before_anything_is_measured(words, message, monkeypatch, capsys):
    monkeypatch.setattr(command, "measure", pytest.fail)
    assert main(["latency", *words]) == 2
    assert message in capsys.readouterr().err
