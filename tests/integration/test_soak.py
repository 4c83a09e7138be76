"""A long run in simulated time, against a short one: what grows, fills up or drifts shows here."""

import json
import os

import pytest
import yaml

from tests.launcher import start
from tests.processes import run, simulated_drives, write_configuration

pytestmark = pytest.mark.deep

SHORT_S, LONG_S, PERIOD_S = 20.0, 200.0, 4e-3
BUDGET_MB, MB = 10.0, 1e6
EMERGENCIES = [{"at_s": 12.0 + 2.0 * k, "do": "emergency", "code": 0x2310, "for_s": 0.5} for k in range(90)]


def ended(folder, duration_s):
    """The result of a run, and the most memory that one of its processes had, bytes."""
    folder.mkdir()
    path = write_configuration(folder, period_s=PERIOD_S, x={"simulation": {"canopen": {"events": EMERGENCIES}}})
    data = yaml.safe_load(path.read_text())
    data["axes"]["x"]["limits"]["torque_slew"] = 100.0
    data["recording"] = {"path": "run.mcap", "budget_mb": BUDGET_MB}
    path.write_text(yaml.safe_dump(data))
    output = folder / "result.json"
    words = ("run", path, "--pace", "sync", "--json", "--duration", duration_s)
    with simulated_drives(path), output.open("w") as stdout, (folder / "errors").open("w") as stderr:
        daemon = start(*words, stdout=stdout, stderr=stderr, cwd=folder)
        _, status, usage = os.wait4(daemon.pid, 0)
        daemon.returncode = os.waitstatus_to_exitcode(status)
    assert daemon.returncode == 0, (folder / "errors").read_text()
    return json.loads(output.read_text()), usage.ru_maxrss * 1024


def test_a_long_run_is_as_good_as_a_short_one(tmp_path):
    short, short_bytes = ended(tmp_path / "short", SHORT_S)
    long, long_bytes = ended(tmp_path / "long", LONG_S)
    assert long["cycles"] > LONG_S / PERIOD_S
    assert not long["faults"]
    assert not long["not_restored"]
    assert long_bytes < short_bytes + 24 * MB
    assert long["axes"]["x"]["compensated"]["rms"] == pytest.approx(short["axes"]["x"]["compensated"]["rms"], rel=0.05)

    parts = [tmp_path / "long" / name for name in long["recordings"]]
    assert sum(each.stat().st_size for each in parts if each.exists()) <= BUDGET_MB * MB
    run("replay", parts[-1], "--verify")
