"""The set-up tools, in a copy of the project where stubs stand for what is slow: pip, pytest, the kernel."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from friction_hil.errors import FrictionHilError
from friction_hil.recordings import formats, read, write
from tools.benchmarks import health, latency, loop, models, neural, recordings
from tools.benchmarks.report import Row, compare, percentile, show

PROJECT = Path(__file__).parents[3]
SHELL_TOOLS = (".ci/run", *(f"tools/{name}" for name in ("demo", "test", "bench", "campaign", "mutants")))
MISSING = "#!/bin/sh\nexit 127\n"
CANDIDATES = ("python3", "python3.11", "python3.12", "python3.13", "python3.14")

# Stands in for python3 where an environment is made: puts the interpreter below into it.
PYTHON3 = """#!/bin/bash
[ "$1 $2" = "-m venv" ] || exec {python} "$@"
mkdir -p "$3/bin" && cp {folder}/venv_python "$3/bin/python"
"""

# The environment's interpreter; in place of pip it notes the call and fails when told to.
VENV_PYTHON = """#!/bin/bash
[ "$1 $2" = "-m pip" ] || exec {python} "$@"
echo "${{*:3}}" >> {folder}/pip_calls
echo what pip says
[ ! -e {folder}/pip_fails ]
"""


def executable(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)


class Copy:
    """A copy of the tools in a folder with a blank in its name, and a PATH with stubs in front."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "my project"
        (self.root / "tools").mkdir(parents=True)
        for name in ("tools/demo", "tools/test", "tools/_environment", "pyproject.toml"):
            shutil.copy(PROJECT / name, self.root / name)
        self.bin = folder / "bin"
        self.stamp = self.root / ".venv/complete"
        self.pip_calls = folder / "pip_calls"
        self.pip_fails = folder / "pip_fails"
        for name in CANDIDATES:
            executable(self.bin / name, MISSING)
        executable(self.bin / "python3", PYTHON3.format(python=sys.executable, folder=folder))
        executable(folder / "venv_python", VENV_PYTHON.format(python=sys.executable, folder=folder))

    def run(self, *command: str) -> "subprocess.CompletedProcess[str]":
        environment = os.environ | {"PATH": f"{self.bin}:{os.environ['PATH']}"}
        return subprocess.run(command, cwd="/", env=environment, text=True, capture_output=True)

    def ensure(self, call: str = "ensure_environment") -> "subprocess.CompletedProcess[str]":
        return self.run("bash", "-c", f"source '{self.root}/tools/_environment'; {call}; echo ready")

    def edit(self, old: str, new: str) -> None:
        path = self.root / "pyproject.toml"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))


@pytest.fixture
def copy(tmp_path: Path) -> Copy:
    return Copy(tmp_path)


@pytest.mark.parametrize("name", [*SHELL_TOOLS, "tools/_environment"])
def test_shell_tools_parse_and_can_be_called(name: str) -> None:
    done = subprocess.run(["bash", "-n", PROJECT / name], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert name == "tools/_environment" or os.access(PROJECT / name, os.X_OK)


def test_first_call_installs_everything_and_the_second_nothing(copy: Copy) -> None:
    first = copy.ensure()
    assert (first.returncode, first.stdout) == (0, "ready\n")
    assert "setting up" in first.stderr
    assert "what pip says" not in first.stderr
    (call,) = copy.pip_calls.read_text().splitlines()
    assert call.startswith("install ")
    assert call.endswith(" --editable .[all,dev]")
    second = copy.ensure()
    assert (second.returncode, second.stdout, second.stderr) == (0, "ready\n", "")
    assert copy.pip_calls.read_text().count("install") == 1


def test_the_demo_installs_less_and_an_environment_for_tests_serves_it_too(copy: Copy) -> None:
    """A changed dependency updates in place, and what is there already stays."""
    first = copy.ensure("ensure_level demo")
    assert re.search(r"the packages: \d+ s, \d+ MB in .venv", first.stderr)
    assert copy.ensure("ensure_level demo").stderr == ""
    kept = copy.root / ".venv/kept"
    kept.touch()
    copy.ensure()
    assert [call.split()[-1] for call in copy.pip_calls.read_text().splitlines()] == [".[report]", ".[all,dev]"]
    assert copy.ensure("ensure_level demo").stderr == ""
    copy.edit('"pyserial>=3.5"', '"pyserial>=3.6"')  # the update for the demo takes nothing away
    updated = copy.ensure("ensure_level demo")
    assert (updated.returncode, kept.exists()) == (0, True)
    assert "dependencies have changed" in updated.stderr
    assert copy.pip_calls.read_text().splitlines()[2].endswith(".[all,dev]")
    assert copy.ensure().stderr == ""


def test_failed_installation_is_shown_and_repeated_from_scratch(copy: Copy) -> None:
    copy.pip_fails.touch()
    failed = copy.ensure()
    assert (failed.returncode, failed.stdout) == (1, "")
    assert "what pip says" in failed.stderr
    assert str(copy.root / ".venv/install.log") in failed.stderr
    assert not copy.stamp.exists()
    leftover = copy.root / ".venv/half-installed"
    leftover.touch()
    copy.pip_fails.unlink()
    assert copy.ensure().returncode == 0
    assert not leftover.exists()


@pytest.mark.parametrize("other", ["cpython-39", "cpython-399", None])
def test_another_interpreter_or_a_moved_project_rebuilds(copy: Copy, other: str | None) -> None:
    copy.ensure()
    if other is None:
        copy.root = copy.root.rename(copy.root.with_name("moved project"))
        assert "setting up" in copy.ensure().stderr
        return
    made_for = copy.stamp.read_text()
    copy.stamp.write_text(made_for.replace(sys.implementation.cache_tag, other))
    assert "setting up" in copy.ensure().stderr
    assert copy.stamp.read_text() == made_for


def test_three_calls_at_once_install_once(copy: Copy) -> None:
    with ThreadPoolExecutor(3) as pool:
        done = list(pool.map(lambda _: copy.ensure(), range(3)))
    assert [each.returncode for each in done] == [0, 0, 0]
    assert copy.pip_calls.read_text().count("install") == 1


@pytest.mark.parametrize("tool", ["demo", "test"])
def test_missing_venv_package_gives_the_apt_line(copy: Copy, tmp_path: Path, tool: str) -> None:
    blocked = tmp_path / "blocked/ensurepip.py"
    executable(blocked, "raise ImportError")
    executable(copy.bin / "python3", f'#!/bin/sh\nPYTHONPATH="{blocked.parent}" exec {sys.executable} "$@"\n')
    done = copy.run(str(copy.root / "tools" / tool))
    assert (done.returncode, done.stdout) == (1, "")
    assert "    sudo apt install python3-venv\n" in done.stderr
    assert not (copy.root / ".venv").exists()


OLD = "#!/bin/sh\ncase $2 in *'(3, 11)'*) exit 1;; *) echo 3.9;; esac\n"


@pytest.mark.parametrize(
    ("python3", "words"),
    [
        (OLD, ["Python 3.11 or newer is needed; python3 here is Python 3.9", "apt install python3.11 python3.11-venv"]),
        (MISSING, ["there is no python3 here"]),
    ],
)
def test_an_old_python_and_none_are_named(copy: Copy, python3: str, words: list[str]) -> None:
    executable(copy.bin / "python3", python3)
    done = copy.ensure()
    assert done.returncode == 1
    assert [each for each in words if each not in done.stderr] == []


def test_newer_python_beside_an_old_python3_is_taken(copy: Copy) -> None:
    (copy.bin / "python3").rename(copy.bin / "python3.12")
    executable(copy.bin / "python3", OLD)
    assert copy.ensure().returncode == 0


def test_demo_hands_its_arguments_on(copy: Copy) -> None:
    copy.ensure()
    executable(copy.root / ".venv/bin/friction-hil", '#!/bin/sh\npwd; printf "<%s>" "$@"\nexit 7\n')
    done = copy.run(str(copy.root / "tools/demo"), "--output", "a b")
    assert (done.returncode, done.stdout, done.stderr) == (7, "/\n<demo><--output><a b>", "")


# An interpreter that notes what pytest is called with and answers with the status it is told.
PYTEST = """#!/bin/bash
[ "$2" = pytest ] || exec {python} "$@"
[[ " $* " == *" --collect-only "* ]] && exit "$(cat {answers}/collected)"
[[ " $* " == *" -m socketcan "* ]] && half=socketcan || half=rest
printf '%s\\n' "${{@:3}}" > {answers}/$half.called
exit "$(cat {answers}/$half)"
"""


class Pytest(Copy):
    """A copy with an environment whose pytest answers ``rest`` and ``socketcan`` with given statuses."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.ensure()
        (self.root / "tests").mkdir()
        self.answers = folder / "answers"
        self.answers.mkdir()
        python = self.root / ".venv/bin/python"
        python.unlink()
        executable(python, PYTEST.format(python=sys.executable, answers=self.answers))

    def reset(self) -> "Pytest":
        for path in self.answers.iterdir():
            path.unlink()
        executable(self.root / "tools/vcan-run", '#!/bin/sh\n[ "$1" = --setup ] || { shift 3; exec "$@"; }\n')
        return self

    def run_tests(self, *arguments: str, **statuses: int) -> "subprocess.CompletedProcess[str]":
        for name, status in ({"collected": 0, "rest": 0, "socketcan": 0} | statuses).items():
            (self.answers / name).write_text(str(status))
        return self.run(str(self.root / "tools/test"), *arguments)

    def called(self, half: str) -> list[str] | None:
        path = self.answers / f"{half}.called"
        return path.read_text().splitlines() if path.exists() else None


@pytest.fixture(scope="module")
def made_project(tmp_path_factory: pytest.TempPathFactory) -> Pytest:
    return Pytest(tmp_path_factory.mktemp("tools"))


@pytest.fixture
def project(made_project: Pytest) -> Pytest:
    return made_project.reset()


@pytest.mark.parametrize(
    ("rest", "socketcan", "status"), [(0, 0, 0), (1, 0, 1), (0, 1, 1), (1, 1, 1), (5, 0, 0), (0, 125, 1)]
)
def test_status_is_of_both_halves(project: Pytest, rest: int, socketcan: int, status: int) -> None:
    assert project.run_tests(rest=rest, socketcan=socketcan).returncode == status
    assert project.called("socketcan") is not None


@pytest.mark.parametrize(
    ("words", "collected", "status"),
    [*(((), 0, status) for status in (2, 3, 4)), *((("-k", "foo"), 5, status) for status in (0, 1, 5))],
)
def test_interruption_wrong_use_and_a_selection_without_socketcan_boot_nothing(project, words, collected, status):
    assert project.run_tests(*words, collected=collected, rest=status).returncode == status
    assert project.called("socketcan") is None


def test_arguments_reach_pytest(project: Pytest) -> None:
    project.run_tests("tests/unit", "-k", "a or b")
    called = project.called("rest") or []
    assert called[-3:] == ["tests/unit", "-k", "a or b"]
    assert 2 <= int(called[called.index("-n") + 1]) <= 4
    assert called[called.index("-m") + 1] == "not socketcan and not deep"


@pytest.mark.parametrize("path", ["tests/unit/test_a.py", "tests/unit/test_a.py::test_b[1]"])
def test_single_files_need_no_workers_and_are_run_whole(project: Pytest, path: str) -> None:
    project.run_tests(path)
    called = project.called("rest") or ["-n"]
    assert "-n" not in called
    assert called[called.index("-m") + 1] == "not socketcan"


def test_files_without_socketcan_tests_are_not_imported_there(project: Pytest) -> None:
    (project.root / "tests/test_a.py").write_text("import numba\n")
    (project.root / "tests/test_b.py").write_text("@pytest.mark.socketcan\n")
    project.run_tests()
    called = project.called("socketcan") or []
    assert [word for word in called if "ignore" in word] == ["--ignore=tests/test_a.py"]


@pytest.mark.parametrize("mark", [["-m", "socketcan"], ["-msocketcan"]])
def test_socketcan_alone(project: Pytest, mark: list[str]) -> None:
    assert project.run_tests(*mark, socketcan=1).returncode == 1
    assert project.called("rest") is None


def test_other_mark_expression_is_taken_as_it_is(project: Pytest) -> None:
    project.run_tests("-m", "not socketcan")
    called = project.called("rest") or []
    assert called[-2:] == ["-m", "not socketcan"]
    assert called.count("-m") == 1
    assert project.called("socketcan") is None


@pytest.mark.skipif(Path("/sys/class/net/vcan0").exists(), reason="this machine has vcan0")
@pytest.mark.parametrize(("arguments", "status"), [([], 0), (["-m", "socketcan"], 1)])
def test_no_kernel_for_socketcan_is_said(project: Pytest, arguments: list[str], status: int) -> None:
    executable(project.root / "tools/vcan-run", "#!/bin/sh\necho vcan-run: no kernel >&2\nexit 125\n")
    done = project.run_tests(*arguments)
    assert done.returncode == status
    assert "no interface vcan0 here" in done.stderr
    assert "vcan-run: no kernel" in done.stderr
    assert project.called("socketcan") is None


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        ([], 2, "no COMMAND"),
        (["--timeout", "nan", "true"], 2, "--timeout nan"),
        (["--timeout", "-1", "true"], 2, "--timeout -1"),
        (["--rw", "/does/not/exist", "true"], 125, "/does/not/exist: no such folder"),
    ],
)
def test_wrong_use_of_vcan_run(arguments: list[str], status: int, message: str) -> None:
    command = [sys.executable, str(PROJECT / "tools/vcan-run"), *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, "Traceback" in done.stderr) == (status, False)
    assert message in done.stderr


@pytest.mark.parametrize("words", [["latenzy"], []])
def test_no_benchmark_is_answered_with_what_there_is(words: list[str]) -> None:
    command = [sys.executable, "-m", "tools.benchmarks", *words]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True)
    assert done.returncode == 2
    assert not words or "did you mean 'latency'?" in done.stderr
    for name in ("compensation", "exchange", "health", "learning", "loop", "models", "neural", "recordings", "tune"):
        assert re.search(rf"\b{name}\b", done.stdout + done.stderr), name


def test_benchmark_of_recordings_has_every_format(monkeypatch, capsys):
    monkeypatch.setattr(models, "ROUNDS", 1)
    monkeypatch.setattr(recordings, "ROWS", 300)
    monkeypatch.setattr(recordings, "TEXT_ROWS", 200)
    show(recordings.run(), as_json=True)
    result = json.loads(capsys.readouterr().out)
    assert set(result) == {"machine", "rows"}
    for row in result["rows"]:
        assert set(row) == {"name", "value", "unit", "reference", "ratio"}
        assert all(row[number] > 0.0 for number in ("value", "reference", "ratio")), row
    names = [row["name"] for row in result["rows"]]
    measured = {name.partition(",")[0] for name in names if name.startswith(".")}
    assert {".hdf5", *measured} == set(formats(to_write=True))  # .hdf5 and .h5 are one format
    assert [row["unit"] for row in result["rows"][-3:]] == ["M rows/s", "M rows/s", "M samples/s"]


def test_benchmark_of_recordings_compares_equal_work(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    write(path, recordings.recording(50))
    ours = read(path).columns
    recordings.check(path, ours, recordings.npz(path))
    other = ours | {"torque": ours["torque"] + 1e-15}
    with pytest.raises(FrictionHilError, match="other columns or values"):
        recordings.check(path, ours, other)


def test_rows_of_benchmarks_have_ratios_of_single_rounds_samples_and_null_for_what_is_no_number(capsys) -> None:
    # the medians alone would say 1: both programs were slow in one round of three, but not in the same one
    row = compare("a (b)", "us", [2.0, 9.0, 4.0], [1.0, 4.0, 8.0])
    assert (row.value, row.reference, row.ratio) == (4.0, 4.0, 2.0)
    shares = {0.5: 2.0, 0.51: 3.0, 0.99: 4.0, 0.25: 1.0}
    assert {share: percentile([1.0, 2.0, 3.0, 4.0], share) for share in shares} == shares
    show([Row("a", math.nan, "us"), Row("b", 1.0, "us", 2.0, math.inf)], as_json=True)
    first, second = json.loads(capsys.readouterr().out)["rows"]
    assert first == {"name": "a", "value": None, "unit": "us", "reference": None, "ratio": None}
    assert second["ratio"] is None


@pytest.mark.deep
def test_the_benchmark_of_networks_measures_an_iteration(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(neural, "ROUNDS", 1)
    rows = neural.iterations()
    assert [(row.name.partition(":")[0], row.unit) for row in rows] == [("gated", "ms"), ("narx", "ms")]
    assert all(0.0 < row.value < math.inf and row.ratio is not None for row in rows)


def test_the_benchmark_of_latency_compares_sleeping_and_spinning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latency, "ROUNDS", 1)
    monkeypatch.setattr(latency, "CYCLES", 20)
    monkeypatch.setattr(latency, "has_cyclictest", lambda: True)
    monkeypatch.setattr(latency, "cyclictest", lambda *_: latency.Latency(np.full(20, 50.0), 0))
    monkeypatch.setattr(latency, "is_fifo_allowed", lambda priority: False)
    rows = latency.run()
    assert [row.reference for row in rows] == [50.0] * 4
    assert all(row.unit == "us" and row.value > 0.0 for row in rows)


@pytest.mark.deep
def test_the_benchmark_of_the_exchange_times_each_part() -> None:
    half_a_second = "exchange.DURATION_S = 0.5; report.show(exchange.run(), as_json=True)"
    command = [sys.executable, "-c", f"from tools.benchmarks import exchange, report; {half_a_second}"]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    names = [row["name"] for row in json.loads(done.stdout)["rows"]]
    parts = ["receive", "step", "send", "whole cycle", "journal without news"]
    assert [name.split(" p")[0] for name in names[2:]] == parts


def test_the_benchmark_of_health_has_every_change(monkeypatch: pytest.MonkeyPatch) -> None:
    small = {"DURATION_S": 8.0, "BEGIN": 31, "YEAR_DAYS": 40, "CHANGES": health.CHANGES[2:3]}
    for name, value in small.items():
        monkeypatch.setattr(health, name, value)
    done = CliRunner().invoke(health.command, ["--axes", "1", "--json"])
    assert done.exit_code == 0, done.output
    quiet, tightened = json.loads(done.stdout)["rows"]
    assert quiet["noticed"] is None
    assert tightened["noticed"] in (0, 1)
    assert quiet["false_alarms_per_year"] >= 0.0


@pytest.mark.deep
def test_the_benchmark_of_the_loop_starts_a_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "STARTS", 1)
    done = CliRunner().invoke(loop.command, ["start", "--json"])
    assert done.exit_code == 0, done.output
    ready, enabled = json.loads(done.stdout)["rows"]
    assert 0.0 < ready["value"] < enabled["value"]
