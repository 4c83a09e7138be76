"""The demo: real processes on a real bus, in simulated time. Physics, files, and that nothing is left behind."""

import json
import os
import select
import shutil
import signal
import subprocess
import sys
import uuid
from contextlib import closing
from pathlib import Path

import pytest

from friction_hil.analysis.circularity import analyse
from friction_hil.cli import main
from friction_hil.daemon.control.lock import ControlSocket
from friction_hil.daemon.learning_board import first_report
from friction_hil.demo import demonstration as demo
from friction_hil.errors import UsageError
from friction_hil.recordings import read_all
from friction_hil.replay.verify import verify
from tests.loop_run import LateClock
from tests.unit.reports.test_circularity import make_circle, make_learned

COMMAND = [sys.executable, "-m", "friction_hil", "demo"]


def marked(mark):
    """Processes that inherited ``mark``: the demo, its children and theirs."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (process / "environ").read_bytes():
                found.append(process.name)
        except (FileNotFoundError, ProcessLookupError, PermissionError):
            continue
    return found


class Outcome:
    """A demo that has run to its end."""

    def __init__(self, output, *under):
        self.output, self.mark = output, f"FRICTION_HIL_TEST={uuid.uuid4()}"
        self.done = subprocess.run(
            [*under, *COMMAND, "--pace", "sync", "--json", "--output", str(output)],
            env={**os.environ, "FRICTION_HIL_TEST": self.mark.partition("=")[2]},
            capture_output=True,
            text=True,
            timeout=240,
        )


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    with closing(ControlSocket("demo")):  # a daemon of the same configuration runs already
        return Outcome(tmp_path_factory.mktemp("demo") / "deeper" / "folder")


@pytest.mark.deep
def test_compensation_takes_the_friction_out_of_the_circle(outcome):
    assert outcome.done.returncode == 0, outcome.done.stderr
    for axis in json.loads(outcome.done.stdout)["axes"].values():
        before, after = axis["uncompensated"], axis["compensated"]
        assert before["rms"] > 3.0 * after["rms"]
        assert before["peak"] > 2.0 * after["peak"]
        assert after["rms"] > 1e-6  # wrong parameters cannot do better than this


@pytest.mark.deep
def test_learning_lowers_what_the_model_as_given_leaves(outcome):
    result = json.loads(outcome.done.stdout)
    for name, axis in result["axes"].items():
        assert axis["learned"]["rms"] < 0.8 * axis["compensated"]["rms"]
        assert axis["learned"]["peak"] < 0.9 * axis["compensated"]["peak"]
        learned = result["learning"]["axes"][name]
        assert learned["re_identified"] >= 1
        assert learned["residual_layer"]["state"] == "on"  # the cogging, of which the model knows nothing
        assert learned["error_after"] == pytest.approx(axis["learned"]["rms"], rel=0.05)


@pytest.mark.deep
def test_no_process_is_left(outcome):
    assert marked(outcome.mark) == []


@pytest.mark.deep
def test_the_recording_gives_the_same_figures_and_replays(outcome):
    recordings = read_all(outcome.output / "recording.mcap")
    circularity = analyse(recordings)
    assert [laps.left_out for laps in circularity.laps] == [0, 0, 0]
    shown = json.loads(outcome.done.stdout)["axes"]
    for name, recording in recordings.items():
        assert shown[name]["compensated"]["rms"] == circularity.compensated.figures[name].rms
        assert recording["change"].max() >= 2.0
        assert verify(recording).is_verified
        assert not any(recording["compensation"][recording["is_enabled"] == 0.0][:1000])


@pytest.mark.deep
def test_a_former_demo_may_be_replaced_and_nothing_else(outcome, tmp_path):
    demo.claim(outcome.output)
    for name in (demo.REPORT, demo.PICTURE, demo.RECORDING):
        foreign = tmp_path / name
        foreign.write_text("mine")
        with pytest.raises(UsageError, match=name):
            demo.claim(tmp_path)
        assert foreign.read_text() == "mine"
        foreign.unlink()


def test_foreign_files_are_refused_before_anything_starts(tmp_path, capsys):
    (tmp_path / demo.PICTURE).write_text("mine")
    assert main(["demo", "--output", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "no former demo made it" in said
    assert "starting" not in said
    assert [path.name for path in tmp_path.iterdir()] == [demo.PICTURE]


@pytest.mark.deep
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interruption_ends_everything(tmp_path, number):
    mark = str(uuid.uuid4())
    process = subprocess.Popen(
        [*COMMAND, "--pace", "sync", "--output", str(tmp_path)],
        env={**os.environ, "FRICTION_HIL_TEST": mark},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        while not process.stderr.readline().startswith("drawing"):
            assert process.poll() is None
        assert len(marked(mark)) >= 3
        process.send_signal(number)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in said
    assert marked(mark) == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.deep
def test_a_killed_demo_leaves_no_process(tmp_path):
    mark = str(uuid.uuid4())
    process = subprocess.Popen(
        [*COMMAND, "--pace", "sync", "--output", str(tmp_path)],
        env={**os.environ, "FRICTION_HIL_TEST": mark},
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        while not process.stderr.readline().startswith("drawing"):
            assert process.poll() is None
        children = [int(pid) for pid in marked(mark) if int(pid) != process.pid]
        handles = [os.pidfd_open(pid) for pid in children]
        process.kill()
    poll = select.poll()
    for handle in handles:
        poll.register(handle, select.POLLIN)
    waiting = set(handles)
    while waiting:
        ended = poll.poll(60_000)
        assert ended, "a child outlives the demo"
        for handle, _ in ended:
            poll.unregister(handle)
            os.close(handle)
            waiting.discard(handle)


@pytest.mark.parametrize(
    ("size", "learned", "status", "said"),
    [
        (5e-4, 2e-4, 0, []),
        (5e-4, None, 0, []),
        (4e-3, None, 1, ["compensation did not help: x rms"]),
        (5e-4, 6e-4, 0, ["learning did not help: x rms"]),
        (5e-4, 4e-3, 1, ["learning made it worse: x rms", "learning did not help: y peak"]),
    ],
)
def test_exit_status_tells_whether_compensation_helped(size, learned, status, said, tmp_path, monkeypatch, capsys):
    def compensated(angle):
        return size + 0.0 * angle

    recordings = make_circle(compensated=compensated)
    if learned is not None:
        recordings = make_learned(lambda angle: learned + 0.0 * angle, compensated=compensated)
    loop = {"cycles": 1, "late_p50_us": 1.0, "late_p99_us": 2.0, "missed": 0}
    learning = {"axes": {"x": first_report("on", "rad", 0.97)}, "cpu_share": 0.1}
    made = demo.Demo(
        analyse(recordings), {**loop, "learning": learning}, "real", tmp_path / "a", tmp_path / "b", tmp_path / "c"
    )
    monkeypatch.setattr(demo, "run_demo", lambda *_: made)
    for options in ([], ["--json"]):
        assert main(["demo", *options]) == status
        shown = capsys.readouterr()
        assert all(each in shown.err for each in said)
        assert bool(shown.err) == bool(said)
        if not options:
            assert ("was learned  lower" in shown.out) == (learned is not None)
            assert ("no laps with what was learned" in shown.out) == (learned is None)
            assert "x: re-identified 0 times" in shown.out
    result = json.loads(shown.out)
    assert result["axes"]["x"]["uncompensated"]["peak"] == pytest.approx(2e-3)
    assert result["axes"]["x"]["learned"] == (learned and pytest.approx({"rms": learned / 2**0.5, "peak": learned}))
    assert result["loop"] == {"period_s": 1e-3, **loop}
    assert result["learning"] == learning


@pytest.fixture
def busy_computer(outcome, monkeypatch):
    """Processes that meet a fault in real time, and in simulated time record what they did before."""
    asked = []

    def run_processes(path, pace, tell):
        asked.append(pace)
        if pace == "real":
            raise demo.LoopFaultError("fault: the loop was late")
        shutil.copy(outcome.output / demo.RECORDING, path.parent)
        return {"cycles": 1, "late_p50_us": 0.0, "late_p99_us": 0.0, "missed": 0}, "notes"

    monkeypatch.setattr(demo, "_run_processes", run_processes)
    return asked


LATE, ON_TIME = LateClock(dict.fromkeys(range(1000), 1_500_000)), LateClock({})


@pytest.mark.deep
@pytest.mark.parametrize(
    ("clock", "paces", "reason"), [(ON_TIME, ["real", "sync"], "the loop was late"), (LATE, ["sync"], "misses 50 %")]
)
def test_a_busy_computer_gets_its_circle_in_simulated_time_and_is_reported(
    clock, paces, reason, busy_computer, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr("friction_hil.daemon.realtime.RealClock", lambda spin_us: clock)
    assert main(["demo", "--output", str(tmp_path)]) == 0
    assert busy_computer == paces
    said = capsys.readouterr()
    assert reason in next(line for line in said.err.splitlines() if line.startswith("this computer is too busy"))
    assert "in simulated time" in said.out
    assert "in simulated time" in (tmp_path / demo.REPORT).read_text()


@pytest.mark.deep
def test_real_time_means_real_time(busy_computer, tmp_path, capsys):
    assert main(["demo", "--pace", "real", "--output", str(tmp_path)]) == 1
    assert busy_computer == ["real"]
    assert "fault: the loop was late" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
