"""A daemon that is changed, stopped and started while it runs: real processes, and a recording that replays."""

import contextlib
import io
import json
import os
import signal
import socket
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.daemon.control.ask import ask
from friction_hil.daemon.control.names import find
from friction_hil.daemon.control.server import MOST_CLIENTS
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import FrictionHilError
from friction_hil.live import Watch
from tests.launcher import start
from tests.servo_drives import axis_dict

PERIOD_S = 2e-3
SLEW = 20.0
STRIBECK = {
    "version": 1,
    "axis": "rotary",
    "friction": {"model": "stribeck", "parameters": {"coulomb": 0.05, "static": 0.07, "stribeck_velocity": 0.2}},
    "mechanics": {"inertia": 2e-4, "torque_lag_s": 3e-4},
}


def children(pid, word):
    """Processes that a process and its supervisor have started, by a word of their command."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            words = (folder / "cmdline").read_text()
            if int(fields[1]) == pid and word in words and fields[0] != "Z":
                found.append(int(folder.name))
            elif int(fields[1]) == pid and "friction_hil.daemon.supervisor" in words:
                found += children(int(folder.name), word)
    return found


def until(condition, timeout_s=60.0):
    """Wait for a condition of other processes; its value."""
    end_s = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < end_s
        time.sleep(0.02)
    return value


def answered(name, request):
    """The answer of a daemon; None while it has none."""
    try:
        return ask(find(name), request)
    except FrictionHilError:
        return None


@pytest.fixture(scope="module")
def controlled(tmp_path_factory):
    """A run through changes, the death of its control process, a stop and a start: answers, output, recording."""
    folder = tmp_path_factory.mktemp("c")
    limits = {"torque": 0.3, "torque_slew": SLEW, "velocity": 30.0, "following_error": 0.5}
    axis = axis_dict(limits=limits, trajectory={"kind": "sine", "amplitude": 0.3, "frequency": 2.0, "ramp_s": 0.1})
    values = {"version": 1, "period_s": PERIOD_S, "bus": {"interface": "socketcan", "channel": "can0"}}
    config, record, model = folder / "mill.yaml", folder / "run.mcap", folder / "other.yaml"
    config.write_text(yaml.safe_dump({**values, "realtime": {"priority": 0}, "axes": {"x": axis}}))
    model.write_text(yaml.safe_dump(STRIBECK))
    found = {"record": record}
    words = ("run", "--simulate", config, "--pace", "sync", "--wait", "--record", record, "--json")
    with start(*words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as daemon:
        reader = threading.Thread(target=lambda: found.update(stderr=daemon.stderr.read()))
        reader.start()
        try:

            def command(*arguments):
                return main([*map(str, arguments)])

            until(lambda: (answered("mill", {"do": "status"}) or {}).get("state") == "waiting")
            found["waiting"] = ask(find("mill"), {"do": "status"})
            found["started"] = command("start", "mill", "--json")
            found["set"] = [
                command("set", "mill", "x.gain=0.7"),
                command("set", "mill", f"x.model={model}", "x.adaptation={time_s: 1}"),
                command("set", "mill", "x.enabled=false"),
                command("set", "mill", "x.enabled=true", "x.gain=1"),
            ]
            found["running"] = ask(find("mill"), {"do": "status"})
            watch, found["readings"] = Watch("mill"), []
            until(watch.poll)
            found["readings"] += [watch.live.read()]
            found["too much"] = answered("mill", {"do": "set", "values": {"x.gain": 9}})
            [control] = children(daemon.pid, "friction_hil.daemon.control")
            os.kill(control, signal.SIGKILL)
            until(lambda: children(daemon.pid, "friction_hil.daemon.control") not in ([], [control]))
            found["after death"] = until(lambda: answered("mill", {"do": "status"}))
            found["set"].append(command("set", "mill", "x.gain=0.8"))
            with contextlib.ExitStack() as crowd:
                for _ in range(2 * MOST_CLIENTS):
                    crowd.enter_context(socket.socket(socket.AF_UNIX)).connect(str(find("mill")))
                found["stopped"] = command("stop", "mill")
            found["at rest"] = ask(find("mill"), {"do": "status"})
            found["reset"] = command("reset", "mill")
            found["again"] = command("start", "mill")
            capture = io.StringIO()
            with contextlib.redirect_stdout(capture):
                found["shown"] = command("status", "--json"), command("status", "mill")
            found["status of all"] = capture.getvalue()
            capture = io.StringIO()
            with contextlib.redirect_stdout(capture):
                found["monitor"] = command("monitor", "mill", "--once", "--json")
            found["figures"] = json.loads(capture.getvalue())
            found["readings"] += [watch.live.read()]
            daemon.send_signal(signal.SIGINT)
            until(lambda: found["readings"].append(watch.live.read()) or watch.live.is_over)
            found["live"] = watch.live.facts, os.fstat(watch.live.ring.descriptor).st_mode
            with pytest.raises(OSError):  # noqa: PT011 - whoever looks cannot write
                os.pwrite(watch.live.ring.descriptor, b"x", 0)
            found["gone"] = watch.poll()
            watch.close()
            found["stdout"] = daemon.stdout.read()
            daemon.wait(60)
        finally:
            daemon.kill()
            reader.join()
    found["status"] = daemon.returncode
    return found


def test_nothing_is_enabled_before_somebody_starts_it_and_again_after_a_stop(controlled):
    assert controlled["waiting"]["axes"]["x"]["drive_state"] == "switch on disabled"
    assert (controlled["started"], controlled["stopped"], controlled["reset"], controlled["again"]) == (0, 0, 0, 0)
    assert controlled["at rest"]["state"] == "waiting"
    assert controlled["at rest"]["axes"]["x"]["drive_state"] == "switch on disabled"
    recording = fh.recordings.read(controlled["record"], "x")
    states = [event.text for event in recording.events if event.name == "state"]
    run = ["enabling", "running", "stopping", "disabling"]
    assert states == ["waiting", *run, "waiting", *run, "done"]
    assert controlled["status"] == 0, controlled["stderr"]
    assert "Traceback" not in controlled["stderr"]


def test_who_looks_from_outside_sees_every_row_as_recorded_and_what_is_in_force(controlled):
    facts, mode = controlled["live"]
    first, last = controlled["readings"][0], controlled["readings"][-1]
    assert (facts.name, facts.axes, facts.period_s) == ("mill", ("x",), PERIOD_S)
    assert facts.remedy("x: position is outside the limits [FH-108]").startswith("check the motion")
    assert facts.remedy("no heartbeat from node 5 [FH-230]").startswith("check supply")
    assert mode & 0o777 == 0o400  # a descriptor for reading cannot be opened again for writing
    assert (first.settings.change, last.settings.change) == (5, 6)  # the start was the first
    x = first.settings.axes["x"]
    assert (x.compensation["gain"], x.model["friction"]["model"]) == (1, "stribeck")
    assert x.model_file.endswith("other.yaml")
    assert first.settings.axes["x"].model == last.settings.axes["x"].model
    assert (last.is_over, controlled["gone"]) == (True, None)
    readings = controlled["readings"]
    recording = fh.recordings.read(controlled["record"], "x")
    seen = np.concatenate([each.rows.of("x", "cycle") for each in readings])
    rows = np.searchsorted(recording["cycle"], seen)
    for column in ("position", "compensation", "checksum"):
        assert np.concatenate([each.rows.of("x", column) for each in readings]).tobytes() == (
            recording[column][rows].tobytes()
        )
    assert len(seen) + sum(each.lost for each in readings) == recording["cycle"][-1] - seen[0] + 1
    assert [event.text for each in readings for event in each.events if event.name == "state"][-1] == "done"


def test_the_monitor_shows_it(controlled):
    assert controlled["monitor"] == 0
    x = controlled["figures"]["axes"]["x"]
    assert controlled["figures"]["name"] == "mill"
    assert x["drive_state"] == "operation enabled"
    assert x["compensation_rms"] > 0.0


def test_every_change_is_in_force_and_named(controlled):
    assert controlled["set"] == [0] * 5
    assert controlled["too much"] is None
    x = controlled["running"]["axes"]["x"]
    assert (x["gain"], x["enabled"], x["model"], x["drive_state"]) == (1.0, True, "stribeck", "operation enabled")
    assert x["model_file"].endswith("other.yaml")
    summary = json.loads(controlled["stdout"])
    who = f"user {os.geteuid()}"
    assert [text.startswith(who) for text in summary["notices"]] == [True] * 9
    assert summary["notices"][1].endswith("set x.gain=0.7")
    assert summary["notices"][2].endswith('set x.model=other.yaml, x.adaptation={"time_s": 1}')


def test_status_shows_every_daemon(controlled):
    assert controlled["shown"] == (0, 0)
    text = controlled["status of all"]
    daemons, end = json.JSONDecoder().raw_decode(text)
    assert daemons["daemons"]["mill"]["changes"] >= 5
    lines = text[end:].strip().splitlines()
    assert lines[0].startswith("mill: running, ")
    assert lines[1] == "  x: drive operation enabled, gain 0.8, stribeck (other.yaml)"
    assert "position" in lines[2]


def test_the_loop_outlives_the_process_of_its_socket_which_knows_what_is_in_force(controlled):
    assert controlled["after death"]["axes"]["x"]["model"] == "stribeck"
    assert controlled["after death"]["axes"]["x"]["gain"] == 1.0
    recording = fh.recordings.read(controlled["record"], "x")
    [warning] = [event.text for event in recording.events if event.name == "warning"]
    assert "the process of the control socket died (signal SIGKILL); the next one takes over" in warning
    assert np.all(np.diff(recording["cycle"]) == 1.0)


def test_replay_reproduces_every_bit(controlled, capsys):
    assert main(["replay", str(controlled["record"]), "--verify", "--json"]) == 0
    [axis] = json.loads(capsys.readouterr().out)["recordings"]
    assert axis["verified"] is True
    recording = fh.recordings.read(controlled["record"], "x")
    assert axis["rows"] == len(recording)
    assert len(set(recording["change"])) == 6
    changes = [json.loads(event.text) for event in recording.events if event.name == "change"]
    assert "model" in changes[1]["axes"]["x"]


def test_no_torque_steps_by_more_than_the_slew_allows(controlled):
    recording = fh.recordings.read(controlled["record"], "x")
    running = recording["state"] == LoopState.RUNNING
    steps = np.abs(np.diff(recording["command"]))[running[1:] & running[:-1]]
    assert steps.max() <= SLEW * PERIOD_S * (1.0 + 1e-9)
    places = np.flatnonzero(np.diff(recording["change"])) + 1
    assert len(places) == 5
    # no more than the motion itself changes it from one cycle to the next
    natural = np.abs(np.diff(recording["compensation"]))
    of_changes = natural[places - 1]
    natural[places - 1] = 0.0
    assert of_changes.max() <= natural.max()
