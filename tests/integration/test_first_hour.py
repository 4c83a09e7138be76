"""The first steps of README, in their order, in an empty folder: with no hardware and no file of this repository."""

import contextlib
import shlex

import numpy as np
import pytest

from friction_hil import recordings
from tests.processes import GROUP, free_port, run, simulated_drives
from tests.readme_commands import first_steps

# What README's steps mean for a machine without a CAN adapter, and in simulated time.
PACED = ("run",)
SHORTER = {"20": "6", "5": "0.5"}  # durations, s; the first 4 s are without compensation


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def following_error(path, start_s, end_s):
    """RMS of the following error within a time."""
    recording = recordings.read(path)
    time = recording["time_s"]
    error = recording["position_demand"] - recording["position"]
    return float(np.sqrt(np.nanmean(error[(time >= start_s) & (time < end_s)] ** 2)))


def words_of(step, bus):
    """The words of a step, with the bus of the simulated drive and shorter durations."""
    words = shlex.split(step)[1:]
    for option, values in (("--bus", {"can0": bus}), ("--duration", SHORTER)):
        if option in words:
            place = words.index(option) + 1
            words[place] = values[words[place]]
    if "--simulated" in words:
        words += ["--bus", bus, "--bitrate", "1000000"]  # a bit rate may stay in a file for udp_multicast
    return [*words, "--pace", "sync"] if words[0] in PACED else words


def test_readme_leads_from_an_empty_folder_to_a_compensated_turn(folder):
    bus = f"udp_multicast:{GROUP}:{free_port()}"
    steps = [words_of(step, bus) for step in first_steps()]
    outputs = {}
    with contextlib.ExitStack() as stack:
        for words in steps:
            done = run(*words)
            outputs[" ".join(words[:3])] = done.stdout + done.stderr
            if "--simulate" in words:  # from here on a drive on the bus stands for the user's
                stack.enter_context(simulated_drives("trial.yaml"))
    assert [words[0] for words in steps] == ["config", "run", "config", "config", "doctor", "run"]
    assert "times" in outputs["run trial.yaml --simulate"]
    assert following_error("out/trial.mcap", 5.0, 6.0) < 0.7 * following_error("out/trial.mcap", 2.0, 4.0)
    assert "machine.yaml: ok\n" in outputs["config check machine.yaml"]
    for step in ("config check machine.yaml", "doctor machine.yaml", "run machine.yaml --dry-run"):
        assert "machine_x.yaml" in outputs[step]
        assert "tune" in outputs[step]
    assert np.ptp(recordings.read("listen.mcap")["position"]) < 1e-3
    refused = run("run", "machine.yaml", check=False)
    assert refused.returncode == 2
    assert "machine_x.yaml; 'friction-hil tune' identifies" in refused.stderr


@pytest.mark.parametrize("driver", ["modbus", "ascii"])
def test_a_simulated_serial_drive_runs_from_a_new_file(driver, folder):
    port = str(folder / "line")
    run("config", "new", "trial", "--driver", driver, "--simulated", "--bus", port)
    with simulated_drives("trial.yaml"):
        run("run", "trial.yaml", "--pace", "sync", "--duration", "0.5", "--record", "run.mcap")
    assert recordings.read("run.mcap")["position"].size > 20
