"""`run --simulate` and `tune --simulate`: simulated drives that begin and end with the command, whatever ends it."""

import json
import os
import re
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

import friction_hil as fh
from friction_hil.daemon.figures import SETTLE_S
from friction_hil.daemon.safety import LoopState
from tests.integration.test_tune import AXIS
from tests.launcher import start
from tests.processes import listening, run
from tests.servo_drives import axis_dict

CAN0 = {"interface": "socketcan", "channel": "can0"}
SINE = {"kind": "sine", "amplitude": 0.3, "frequency": 2.0, "ramp_s": 0.1}


def write(folder, *, bus=CAN0, period_s=2e-3, **changes):
    """A configuration of one axis on a real bus, without ``simulation``."""
    values = {"version": 1, "period_s": period_s, "bus": bus, "realtime": {"priority": 0}}
    path = folder / "machine.yaml"
    path.write_text(yaml.safe_dump({**values, "axes": {"x": axis_dict(trajectory=SINE, **changes)}}))
    return path


def children(process):
    """Process ids of the simulated drives that a command has started."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            words = (folder / "cmdline").read_text().split("\0")
        except OSError:
            continue
        if int(fields[1]) == process.pid and "simulate" in words and fields[0] != "Z":
            found.append(int(folder.name))
    return found


def has_ended(pid):
    """True if a process is gone; one that nobody waits for any more stays as a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def wait_until(condition, timeout_s=30.0):
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.deep
def test_a_machine_on_a_real_bus_is_simulated_and_judged(tmp_path):
    path = write(tmp_path, compensation={"baseline_s": 2.0, "fade_s": 0.1})
    record = tmp_path / "run.mcap"
    words = ("run", "--simulate", path, "--pace", "sync", "--duration", "4", "--record", record)
    done = run(*words)
    where = r"simulated drives: x=node 1 on \S+ 239.74.163.\d+:\d+, on a private bus instead of socketcan can0"
    assert re.match(where, done.stderr)

    # the table shows what the recording holds: one figure without, one with compensation
    recording = fh.recordings.read(record, "x")
    running = recording["state"] == LoopState.RUNNING
    error = (recording["position_demand"] - recording["position"])[running]
    enabled = recording["is_enabled"][running] == 1.0
    lap, settled = 250, round(SETTLE_S / 2e-3)
    without = error[~enabled][50 + settled :][: 2 * lap]
    compensated = error[enabled][50 + settled + 1 :][: 2 * lap]
    lines = done.stdout.splitlines()
    rms = next(line for line in lines if "rms [" in line).split()
    assert rms[:3] == ["x", "rms", "[µrad]"]
    expected = [1e6 * float(np.sqrt(np.mean(part**2))) for part in (without, compensated)]
    assert [float(each) for each in rms[3:5]] == pytest.approx(expected, rel=0.02)
    assert float(rms[5]) == pytest.approx(expected[0] / expected[1], rel=0.03)
    assert float(rms[5]) > 2.0
    assert "in simulated time" in lines[0]


@pytest.mark.deep
def test_without_a_baseline_or_a_model_the_run_says_what_to_do(tmp_path):
    path = write(tmp_path, model="later.yaml", limits={"torque": 0.1, "velocity": 30.0})
    done = run("run", "--simulate", path, "--pace", "sync", "--duration", "1.5", "--json")
    summary = json.loads(done.stdout)
    (note,) = (line for line in done.stderr.splitlines() if line.startswith("note: "))
    assert "axes.x.model: there is no model file" in note
    assert "later.yaml; 'friction-hil tune' identifies the friction" in note
    assert note.endswith("; until then its friction counts as zero")
    x = summary["axes"]["x"]
    assert (x["baseline"], x["reduction"], x["unit"]) == (None, None, "rad")
    assert x["rms"] == x["compensated"]["rms"] > 0.0
    refused = run("run", path, check=False)
    assert (refused.returncode, "there is no model file" in refused.stderr) == (2, True)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_whatever_ends_the_run_ends_its_drives(number, tmp_path):
    path = write(tmp_path)
    with start("run", "--simulate", path, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as daemon:
        wait_until(lambda: daemon.stderr.readline().startswith("simulated drives: "))
        [drives] = children(daemon)
        wait_until(lambda: "watches the daemon" in daemon.stderr.readline())
        os.killpg(os.getpgid(drives), 0)  # a group of its own: Ctrl-C of a terminal does not reach it
        assert os.getpgid(drives) != os.getpgid(daemon.pid)
        daemon.send_signal(number)
        daemon.communicate(timeout=60)
    wait_until(lambda: has_ended(drives), 10.0)
    # 130: it was interrupted before anything was enabled
    assert daemon.returncode in ((-signal.SIGKILL,) if number == signal.SIGKILL else (0, 130))


@pytest.mark.deep
def test_a_fault_and_drives_that_do_not_start_leave_nothing_behind(tmp_path):
    path = write(tmp_path, limits={"torque": 0.1, "velocity": 30.0, "following_error": 1e-6})
    faulty = run("run", "--simulate", path, "--pace", "sync", check=False)
    assert (faulty.returncode, "[FH-109]" in faulty.stderr) == (1, True)
    broken = run("run", "--simulate", write(tmp_path, simulation={"canopen": {"eds": "gone.eds"}}), check=False)
    assert broken.returncode == 1
    assert "'friction-hil simulate' failed" in broken.stderr
    assert "gone.eds" in broken.stderr
    assert "Traceback" not in faulty.stderr + broken.stderr


@pytest.mark.deep
def test_a_sidecar_gets_its_master_and_the_bus_of_the_file_stays_silent(tmp_path):
    values = yaml.safe_load((Path(__file__).parents[2] / "config/sidecar.yaml").read_text())
    values["realtime"] = {"priority": 0}
    values["axes"]["x"]["compensation"]["baseline_s"] = 2.6
    del values["recording"]
    path = tmp_path / "sidecar.yaml"
    path.write_text(yaml.safe_dump(values))
    with listening(path) as bus:
        done = run("run", "--simulate", path, "--pace", "sync", "--duration", "5.6", "--json")
        assert bus.recv(0.0) is None
    x = json.loads(done.stdout)["axes"]["x"]
    assert x["reduction"]["rms"] > 2.0


@pytest.mark.deep
def test_simulated_drives_are_tuned_and_the_model_of_the_machine_stays_as_it_is(tmp_path):
    path = write(tmp_path, period_s=4e-3, **{key: value for key, value in AXIS.items() if key != "trajectory"})
    words = (
        "tune",
        path,
        "--simulate",
        "--pace",
        "sync",
        "--yes",
        "--models",
        "coulomb",
        "--output",
        tmp_path / "tuned",
    )
    before = yaml.safe_load(path.read_text())
    path.write_text("# mine\n" + path.read_text())
    done = run(*words, "--apply")
    assert "simulated drives: x=node 1" in done.stderr
    assert "the friction of the simulated drive, not that of the machine" in done.stdout
    assert f"friction-hil run {path} --simulate " in " ".join(done.stdout.split())
    assert (tmp_path / "tuned/x.yaml").exists()
    assert not (tmp_path / "learned.yaml").exists()
    text = path.read_text()
    assert text.startswith("# mine\n")
    before["axes"]["x"]["model"] = "tuned/x.yaml"
    found = yaml.safe_load(text)
    before["axes"]["x"].setdefault("compensation", {})["gain"] = found["axes"]["x"]["compensation"]["gain"]
    assert found == before
