"""What users install: the content of wheel and source archive, and README's commands from the wheel."""

import contextlib
import re
import shlex
import shutil
import subprocess
import zipfile
from email import message_from_string
from pathlib import Path

import click
import numpy as np
import pytest
import scipy.io
import yaml
from packaging.requirements import Requirement

from friction_hil import __version__, recordings
from friction_hil.errors import FrictionHilError
from tests.installed_wheel import build, install, share_compiled_code
from tests.launcher import installed_in
from tests.processes import GROUP, free_port, run, simulated_drives, write_configuration
from tests.readme_commands import ROOT, resolve, shown_commands

pytestmark = pytest.mark.deep

PACKAGES = {"friction_hil": ROOT / "friction_hil", "friction_hil_drivers": ROOT / "drivers/friction_hil_drivers"}
PAGE = ROOT / "friction_hil/cli/README.md"
EXTRAS = {
    "report": {"matplotlib"},
    "formats": {"pyarrow", "h5py", "asammdf"},
    "onnx": {"onnx"},
    "cluster": {"distributed", "fsspec"},
    "dynamixel": {"dynamixel-sdk"},
    "dashboard": {"starlette", "uvicorn", "prometheus-client"},
    "live": {"foxglove-sdk"},
}

# Options that are added to README's commands: simulated time, no questions, and work for seconds instead of minutes.
ADDED = {
    "friction-hil run": ("--pace", "sync"),
    "friction-hil tune": ("--pace", "sync", "--yes", "--models", "coulomb"),
    "friction-hil identify": ("--models", "coulomb"),
}
LONGEST_S = 2.0  # of a run, in simulated time
TRIAL_S = 8.0  # of the first one; its first 4 s are without compensation, and a period with it is 2 s
PERIOD_S = 4e-3
EXPERIMENT = {"velocity": 4.0, "travel": 1.0, "duration_s": 5.0, "ramp_s": 0.25}
LIMITS = {"torque": 0.3, "torque_slew": 300.0, "velocity": 30.0, "following_error": 2.0}
TRAJECTORY = {"kind": "sine", "amplitude": 0.5, "frequency": 0.5, "ramp_s": 0.25}


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """Source archive and wheel."""
    return build(ROOT, tmp_path_factory.mktemp("dist"), "sdist", "wheel")


@pytest.fixture(scope="module")
def wheel(archives):
    (path,) = (path for path in archives if path.suffix == ".whl")
    return path


@pytest.fixture(scope="module")
def metadata(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return message_from_string(archive.read(name).decode())


def content(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_the_wheel_has_every_file_of_the_packages_and_nothing_else(wheel):
    found = {name for name in content(wheel) if ".dist-info/" not in name}
    expected = {
        f"{package}/{path.relative_to(folder)}"
        for package, folder in PACKAGES.items()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert expected <= found
    assert {name.partition("/")[0] for name in found} == set(PACKAGES)
    assert not [name for name in found if name.endswith((".png", ".pyc")) or "test" in name.rpartition("/")[2]]
    assert {f"{package}/py.typed" for package in PACKAGES} < found
    assert "friction_hil_drivers/ascii/descriptions/odrive.yaml" in found


def test_a_wheel_from_the_source_archive_is_the_same(archives, wheel, tmp_path):
    (source,) = (path for path in archives if path.name.endswith(".tar.gz"))
    shutil.unpack_archive(source, tmp_path)
    (project,) = tmp_path.iterdir()
    for needed in (
        "LICENSE",
        "CHANGELOG.md",
        "tests/conftest.py",
        "tools/pictures/circularity.png",
        "config/demo.yaml",
    ):
        assert (project / needed).is_file()
    (again,) = build(project, tmp_path / "dist", "wheel")
    assert content(again) == content(wheel)


def test_metadata(metadata):
    assert metadata["Version"] == __version__
    assert metadata["Author"] == "friction_hil contributors"
    assert metadata["License-Expression"] == "Apache-2.0"
    assert metadata["Requires-Python"] == ">=3.11"
    for url in metadata.get_all("Project-URL", ()):
        assert re.fullmatch(r"\w+, https://\S+", url)


def test_the_page_of_an_index_has_no_relative_link(metadata):
    page = metadata.get_payload()
    assert page.startswith("# friction_hil")
    links = re.findall(r"\]\(([^)]+)\)", page)
    assert [link for link in links if not link.startswith(("https://", "#"))] == []


def test_each_extra_installs_what_its_name_says_and_all_of_them_no_tool_of_developers(metadata):
    requirements = [Requirement(text) for text in metadata.get_all("Requires-Dist")]

    def packages(extra):
        return {each.name for each in requirements if each.marker and each.marker.evaluate({"extra": extra})}

    assert {name: packages(name) for name in EXTRAS} == EXTRAS
    assert packages("all") == set.union(*EXTRAS.values())
    assert set(metadata.get_all("Provides-Extra")) == {*EXTRAS, "all", "dev"}
    assert re.findall(r"^\| `(\w+)` \|", PAGE.read_text(), re.MULTILINE)[: len(EXTRAS) + 2] == [*EXTRAS, "all", "dev"]


def test_each_extra_that_a_message_or_a_page_names_is_one():
    files = [*ROOT.glob("*.md"), *(path for top in PACKAGES.values() for path in top.rglob("*.[pm][yd]"))]
    named = {extra for path in files for extra in re.findall(r"friction-hil\[([\w,]+)\]", path.read_text())}
    assert named
    assert named <= {*EXTRAS, "all", "dev"}


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The interpreter of an environment with the wheel; its commands find what numba has compiled."""
    folder = tmp_path_factory.mktemp("installed")
    python = install(wheel, folder / "environment")
    share_compiled_code(python, folder / "cache")
    with pytest.MonkeyPatch.context() as patch, installed_in(str(python)):
        patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
        yield python


def test_the_command_and_its_drivers_come_from_the_wheel(installed, tmp_path):
    where = "import friction_hil, friction_hil_drivers; print(friction_hil.__file__, friction_hil_drivers.__file__)"
    done = subprocess.run([installed, "-c", where], cwd=tmp_path, capture_output=True, text=True, check=True)
    environment = installed.parents[1]
    assert all(Path(path).is_relative_to(environment) for path in done.stdout.split())
    command = environment / "bin/friction-hil"
    done = subprocess.run([command, "--version"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == f"friction-hil {__version__}\n"


def complete_commands():
    """README's commands that can be run as they stand, in their order; its tables are for reference."""
    for shown in shown_commands():
        if shown.page == "README.md" and shown.words[0] == "friction-hil" and not shown.is_in_table:
            with contextlib.suppress(click.ClickException, FrictionHilError):  # one that a sentence names in part
                yield resolve(shown.words)[0], list(shown.words[1:])


def prepare(folder, commands):
    """What README takes as given: the configurations that no command of it writes, and the public recording."""
    if not any(name == "friction-hil config new" and "machine.yaml" in words for name, words in commands):
        axis = {"experiment": EXPERIMENT, "limits": LIMITS, "trajectory": TRAJECTORY}
        write_configuration(folder, period_s=PERIOD_S, x=axis).rename(folder / "machine.yaml")
    values = yaml.safe_load((ROOT / "config/sidecar.yaml").read_text())
    values["bus"]["port"], values["realtime"]["priority"] = free_port(), 0
    (folder / "config").mkdir()
    (folder / "config/sidecar.yaml").write_text(yaml.safe_dump(values))
    # the columns of the recording that users download; its axis is one of Coulomb friction
    time_s = np.arange(0.0, 5.0, 1e-3)
    velocity = 0.2 * np.sin(2.0 * np.pi * 0.5 * time_s)
    force = 95.0 * np.gradient(velocity, 1e-3) + 20.0 * np.tanh(velocity / 1e-3) + 200.0 * velocity
    position = np.cumsum(velocity) * 1e-3
    columns = {"t": time_s, "qm": position, "vir": force / 35.150651}
    scipy.io.savemat(folder / "DATA_EMPS.mat", {name: values[:, None] for name, values in columns.items()})


def as_run(name, words, bus):
    """A command on a machine without CAN, in simulated time and less of it."""
    words = [bus if word == "can0" else word for word in words]
    if "--simulated" in words:
        words += ["--bus", bus, "--bitrate", "1000000"]  # a bit rate may stay in a file for udp_multicast
    if "--duration" in words:
        at, longest_s = words.index("--duration") + 1, TRIAL_S if "trial.yaml" in words else LONGEST_S
        words[at] = str(min(float(words[at]), longest_s))
    return [*words, *ADDED.get(name, ())]


def fill_in(path):
    """What a user may change in a new file: a longer period and a shorter experiment take less time here."""
    text = re.sub(r"(?<=duration_s: )[\d.]+", str(EXPERIMENT["duration_s"]), path.read_text())
    path.write_text(re.sub(r"(?<=period_s: )\S+", str(PERIOD_S), text))


def following_error(path, start_s, end_s):
    """RMS of the following error within a time."""
    recording = recordings.read(path)
    time = recording["time_s"]
    error = recording["position_demand"] - recording["position"]
    return float(np.sqrt(np.nanmean(error[(time >= start_s) & (time < end_s)] ** 2)))


def check_that_a_model_is_missing(outputs):
    """Before tune, each command says what is not there yet, and what makes it; a run is refused."""
    for step in ("config check machine.yaml", "doctor machine.yaml", "run machine.yaml --dry-run"):
        assert "machine_x.yaml" in outputs[step]
        assert "tune" in outputs[step]
    assert "machine.yaml: ok\n" in outputs["config check machine.yaml"]
    refused = run("run", "machine.yaml", check=False)
    assert refused.returncode == 2
    assert "machine_x.yaml; 'friction-hil tune' identifies" in refused.stderr


def test_readmes_commands_in_their_order_in_an_empty_folder(installed, tmp_path, monkeypatch):
    """They lead to a compensated turn; each ends well, with simulated drives in the place of the user's."""
    commands = list(complete_commands())
    bus = f"udp_multicast:{GROUP}:{free_port()}"
    prepare(tmp_path, commands)
    monkeypatch.chdir(tmp_path)
    outputs = {}
    with contextlib.ExitStack() as drives:
        for name, words in commands:
            if name == "friction-hil tune":
                check_that_a_model_is_missing(outputs)
            if name == "friction-hil simulate":
                drives.close()  # the user has stopped the ones before
                path, options = words[-1], words[1:-1]
                drives.enter_context(simulated_drives(Path(path), *options))
                continue
            done = run(*as_run(name, words, bus), check=False)
            assert done.returncode == 0, f"{shlex.join(words)}:\n{done.stderr}{done.stdout}"
            outputs[" ".join(words[:3])] = done.stdout + done.stderr
            if name == "friction-hil config new":
                fill_in(Path(words[2]))
            if words[:3] == ["run", "trial.yaml", "--simulate"]:  # from here on a drive on the bus is the user's
                drives.enter_context(simulated_drives(Path("trial.yaml")))
    assert "times" in outputs["run trial.yaml --simulate"]
    assert following_error("out/trial.mcap", 5.0, 6.0) < 0.7 * following_error("out/trial.mcap", 2.0, 4.0)
    assert np.ptp(recordings.read("listen.mcap")["position"]) < 1e-3
    used = {name for name, _ in commands}
    assert {"friction-hil run", "friction-hil tune", "friction-hil config check"} <= used
    for made in ("listen.mcap", "run.mcap", "run.png", "emps.yaml", "emps.html"):
        assert (tmp_path / made).stat().st_size > 100
