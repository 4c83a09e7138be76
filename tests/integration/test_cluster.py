"""Replay on a Dask cluster of real processes: the same bits, whoever dies. A FIFO in place of a file holds a worker."""

import contextlib
import errno
import json
import os
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.parallel import cluster
from friction_hil.recordings import Recording
from tests.launcher import COMMAND

pytestmark = pytest.mark.deep

pytest.importorskip("distributed", reason='distributed is not installed: pip install "friction-hil[cluster]"')
psutil = pytest.importorskip("psutil", reason="psutil comes with distributed")

PROJECT = Path(__file__).parents[2]
ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join([str(PROJECT), str(PROJECT / "drivers")])}
LOOPBACK = ["--host", "127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0"]
PATIENCE_S = 60.0  # only a failure takes as long
MODELS = ["--model", "coulomb:coulomb=0.3,viscous=0.01", "--model", "own.yaml"]


def log(path: Path, seed: int) -> Path:
    time_s = np.arange(2000) * 1e-3
    noise = np.random.default_rng(seed).normal(size=time_s.size)
    velocity = (1.0 + seed) * np.cos(8.0 * time_s)
    columns = {"time_s": time_s, "position": (1.0 + seed) * np.sin(8.0 * time_s) / 8.0, "velocity": velocity}
    columns["torque"] = 0.3 * np.sign(velocity) + 0.01 * noise
    fh.recordings.write(path, Recording("", "x", columns))
    return path


def until(found, what):
    """What ``found`` returns as soon as that is true."""
    end = time.monotonic() + PATIENCE_S
    while not (value := found()):
        assert time.monotonic() < end, f"{what} did not happen in {PATIENCE_S:g} s"
        time.sleep(0.02)
    return value


class Cluster:
    """A scheduler and two workers of one thread each, in a folder where none of the recordings is."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.processes: list[subprocess.Popen] = []
        facts = folder / "scheduler.json"
        self._start("dask_scheduler", "--port", "0", "--scheduler-file", facts)
        until(facts.exists, "a scheduler")
        self.address = until(lambda: self._address(facts), "an address")
        self.workers = [self._start("dask_worker", self.address, "--no-nanny", "--nthreads", "1") for _ in range(2)]

    def _start(self, module: str, *options: object) -> subprocess.Popen:
        command = [sys.executable, "-m", f"distributed.cli.{module}", *LOOPBACK, *map(str, options)]
        environment = ENVIRONMENT | {"DASK_TEMPORARY_DIRECTORY": str(self._folder)}
        with (self._folder / f"{module}_{len(self.processes)}.log").open("wb") as output:
            process = subprocess.Popen(command, cwd=self._folder, env=environment, stdout=output, stderr=output)
        self.processes.append(process)
        return process

    @staticmethod
    def _address(facts: Path) -> str | None:
        with contextlib.suppress(json.JSONDecodeError):
            return json.loads(facts.read_text())["address"]
        return None  # half written

    def sockets(self) -> list[str]:
        """Addresses at which a process of the cluster listens."""
        return [
            each.laddr.ip
            for process in self.processes
            if process.poll() is None
            for each in psutil.Process(process.pid).net_connections(kind="inet")
            if each.status == psutil.CONN_LISTEN
        ]

    def stop(self) -> None:
        for process in reversed(self.processes):
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def dask(tmp_path_factory):
    made = Cluster(tmp_path_factory.mktemp("cluster"))
    yield made
    made.stop()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current directory: twelve logs, a model file, and a real log to be put in place of the FIFO."""
    monkeypatch.chdir(tmp_path)
    for seed in range(12):
        log(tmp_path / f"{seed:02}.csv", seed)
    (tmp_path / "own.yaml").write_text(
        "version: 1\naxis: rotary\nfriction: {model: coulomb, parameters: {coulomb: 0.28}}\n"
    )
    return tmp_path


class Gate:
    """A FIFO that holds the worker which reads it, until it is closed or the worker dies."""

    def __init__(self, path: Path) -> None:
        os.mkfifo(path)
        self._path = path
        self._end = -1

    def wait(self, client: subprocess.Popen) -> None:
        """Wait until somebody reads; by then the client must not have ended."""
        until(lambda: self._is_read(client), f"a worker that reads {self._path.name}")

    def _is_read(self, client: subprocess.Popen) -> bool:
        assert client.poll() is None, client.stderr.read()
        try:
            self._end = os.open(self._path, os.O_WRONLY | os.O_NONBLOCK)
        except OSError as error:
            if error.errno == errno.ENXIO:
                return False
            raise
        return True

    def holds(self, process: subprocess.Popen) -> bool:
        """Whether a process has it open."""
        for file in Path(f"/proc/{process.pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                if os.readlink(file) == str(self._path):
                    return True
        return False

    def open(self) -> None:
        if self._end >= 0:
            os.close(self._end)


def start(*words: object) -> subprocess.Popen:
    command = [*COMMAND, "replay", *map(str, words)]
    return subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_worker_that_is_killed_costs_no_bit(dask, folder, capsys):
    files = [f"{seed:02}.csv" for seed in range(6)] + ["gate.csv", "nothing.csv"]
    files += [f"{seed:02}.csv" for seed in range(6, 12)]
    arguments = [*files, *MODELS, "--json"]
    gate = Gate(folder / "gate.csv")
    replay = start(*arguments, "--scheduler", dask.address)
    try:
        gate.wait(replay)
        (held,) = until(lambda: [each for each in dask.workers if gate.holds(each)], "the worker at the gate")
        assert len(addresses := dask.sockets()) >= 3
        assert set(addresses) == {"127.0.0.1"}
        log(folder / "real.csv", 30).replace(folder / "gate.csv")
        os.kill(held.pid, signal.SIGKILL)
        held.wait()
        gate.open()
        output, errors = replay.communicate(timeout=PATIENCE_S)
    finally:
        replay.kill()
    assert replay.returncode == 1, errors
    assert f"Error: {folder / 'nothing.csv'} cannot be read: No such file" in errors
    assert "Traceback" not in errors
    assert main(["replay", *arguments]) == 1
    # only where a file is sought may differ: a relative path starts from the client's directory
    assert output.replace(f"{folder}/", "") == capsys.readouterr().out
    assert len({each["models"][0]["rmse"] for each in json.loads(output)["recordings"] if each["models"]}) == 13


def test_an_interrupt_takes_the_work_back(dask, folder):
    from distributed import Client

    gate = Gate(folder / "gate.csv")
    replay = start("gate.csv", "0*.csv", *MODELS, "--scheduler", dask.address)
    try:
        gate.wait(replay)
        with Client(dask.address, set_as_default=False) as other:

            def known_tasks(dask_scheduler):
                return [state.state for state in dask_scheduler.tasks.values()]

            assert "processing" in other.run_on_scheduler(known_tasks)
            replay.send_signal(signal.SIGINT)
            _, errors = replay.communicate(timeout=PATIENCE_S)
            assert (replay.returncode, "Traceback" in errors) == (130, False), errors
            until(lambda: not other.run_on_scheduler(known_tasks), "an empty list of tasks")
    finally:
        replay.kill()
        gate.open()


def test_pictures_are_written_by_the_client(dask, folder, capsys):
    (folder / "out").mkdir()
    arguments = ["replay", "00.csv", *MODELS, "--output", "out/p.png"]
    assert main([*arguments, "--scheduler", dask.address]) == 0
    assert "picture: out/p.png" in capsys.readouterr().out
    picture = (folder / "out" / "p.png").read_bytes()
    assert main(arguments) == 0
    assert (folder / "out" / "p.png").read_bytes() == picture
    capsys.readouterr()
    arguments[-1] = "nowhere/p.png"
    assert main([*arguments, "--scheduler", dask.address]) == 1
    assert "nowhere/p.png cannot be written: No such file or directory" in capsys.readouterr().err


def test_another_version_on_the_workers_is_refused(dask, folder, monkeypatch, capsys):
    monkeypatch.setattr(cluster, "__version__", "99.0")
    assert main(["replay", "00.csv", *MODELS, "--scheduler", dask.address]) == 2
    errors = capsys.readouterr().err
    assert f"has friction-hil {fh.__version__}, here is 99.0" in errors
    assert "Traceback" not in errors


def test_nobody_at_the_address(folder, monkeypatch, capsys):
    monkeypatch.setattr(cluster, "PATIENCE_S", 0.5)
    assert main(["replay", "00.csv", *MODELS, "--scheduler", "tcp://127.0.0.1:1"]) == 1
    assert "no Dask scheduler answers at tcp://127.0.0.1:1 within 0.5 s" in capsys.readouterr().err
    assert main(["replay", "00.csv", *MODELS, "--scheduler", "127.0.0.1"]) == 2
    assert "missing port number in address '127.0.0.1'; write tcp://HOST:PORT" in capsys.readouterr().err


def test_the_extra_is_named_where_it_is_missing(folder, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["replay", "00.csv", *MODELS, "--scheduler", "tcp://127.0.0.1:1"]) == 2
    assert 'pip install "friction-hil[cluster]"' in capsys.readouterr().err


def test_a_fleet_has_the_same_table_whoever_dies_and_goes_on_with_the_same_command(dask, folder, tmp_path_factory):
    from pyarrow import parquet

    files = [f"{seed:02}.csv" for seed in range(12)]

    def words(output, *sources):
        return ["fleet", "identify", *sources, "--models", "coulomb", "--output", str(output)]

    there = tmp_path_factory.mktemp("fleet")
    gate = Gate(folder / "gate.csv")
    work = subprocess.Popen(
        [*COMMAND, *words(there, *files, "gate.csv"), "--scheduler", dask.address], env=ENVIRONMENT, cwd=folder
    )
    try:
        gate.wait(work)
        until(lambda: (there / "done.jsonl").exists() and work.poll() is None, "a recording that is done")
        work.kill()  # the client; what is done is kept
        work.wait()
    finally:
        work.kill()
        log(folder / "real.csv", 30).replace(folder / "gate.csv")
        gate.open()
    done = len((there / "done.jsonl").read_text().splitlines())
    assert done >= 1
    assert main([*words(there, *files), "--scheduler", dask.address]) == 0
    here = tmp_path_factory.mktemp("here")
    assert main(words(here, *files)) == 0
    assert parquet.read_table(there / "table.parquet") == parquet.read_table(here / "table.parquet")


def test_short_tasks_share_a_request_and_a_killed_worker_costs_none_of_them(tmp_path):
    own = Cluster(tmp_path)  # in the other one a worker has been killed: nobody would be left
    tasks = [0.005] * 400 + [0.3] + [0.005] * 400
    seen = []
    try:
        for index, _ in cluster.run_on_cluster(time.sleep, tasks, own.address, died=lambda *_: pytest.fail("it died")):
            seen.append(index)
            if len(seen) == 100:
                own.workers[0].kill()
    finally:
        own.stop()
    assert sorted(seen) == list(range(len(tasks)))
    assert any(after == before + 1 for before, after in pairwise(seen[:40])), "several come back at once"
