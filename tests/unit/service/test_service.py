"""Files of a service of systemd, and the messages to it."""

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.cli import main
from friction_hil.daemon.control.names import is_name
from friction_hil.daemon.notify import NotifyingSink, ServiceManager
from friction_hil.errors import ConfigurationError, UsageError
from friction_hil.live.web.token import token_of
from friction_hil.service import files, install, remove
from friction_hil.service.install import services
from friction_hil.service.state import parse
from tests.processes import write_configuration
from tests.servo_drives import axis_dict

EXECUTABLE = "/opt/friction-hil/bin/friction-hil"


@pytest.fixture
def configuration(tmp_path):
    """A configuration on SocketCAN, with a model file beside it."""
    path = write_configuration(tmp_path, bus={"interface": "socketcan", "channel": "can0"})
    (tmp_path / "models").mkdir()
    model = {"version": 1, **axis_dict()["model"]}
    (tmp_path / "models/x.yaml").write_text(yaml.safe_dump(model))
    return changed(path, lambda values: values["axes"]["x"].update(model="models/x.yaml"))


def changed(path, change, to=None):
    """A configuration with a change, in its place or at another path."""
    values = yaml.safe_load(path.read_text())
    change(values)
    to = to or path
    to.parent.mkdir(exist_ok=True)
    to.write_text(yaml.safe_dump(values))
    return to


def installed(root, configuration, name="table", **options):
    return install(name, configuration, root, EXECUTABLE, **{"overwrite": False, **options})


def test_systemd_finds_no_mistake_in_the_unit(configuration, tmp_path):
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not installed")
    root = tmp_path / "root"
    installed(root, configuration)
    command = root / EXECUTABLE[1:]
    command.parent.mkdir(parents=True)
    command.touch(mode=0o755)
    for folder in ("usr/lib/systemd/system", "lib/systemd/system"):  # what the unit refers to: basic.target and others
        if Path("/", folder).is_dir() and not (root / folder).exists():
            (root / folder).parent.mkdir(parents=True, exist_ok=True)
            (root / folder).symlink_to(Path("/", folder))
    words = [analyze, "verify", "--man=no", "--recursive-errors=one", f"--root={root}", "friction-hil@table.service"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    about = [line for line in done.stderr.splitlines() if "friction" in line]
    assert (done.returncode, about) == (0, [])


def test_a_service_has_unit_devices_user_and_a_copy_of_what_it_needs(configuration, tmp_path):
    root = tmp_path / "root"
    done = installed(root, configuration)
    assert set(done.written) == {path for path in root.rglob("*") if path.is_file()}
    folder = root / "etc/friction-hil/table"
    assert (folder / "config.yaml").read_bytes() == configuration.read_bytes()
    assert (folder / "models/x.yaml").read_bytes() == (tmp_path / "models/x.yaml").read_bytes()
    unit = (root / "etc/systemd/system/friction-hil@.service").read_text()
    start = f"ExecStart={EXECUTABLE} run /etc/friction-hil/%i/config.yaml --name %i --group friction-hil --wait"
    assert start in unit.splitlines()
    assert "RestartPreventExitStatus=1 2" in unit.splitlines()
    devices = (root / "etc/systemd/system/friction-hil@table.service.d/devices.conf").read_text()
    assert "BindsTo=sys-subsystem-net-devices-can0.device" in devices.splitlines()
    assert "systemctl daemon-reload" in done.to_run
    assert not done.commands

    with pytest.raises(UsageError, match="table exists already; --force"):
        installed(root, configuration)
    installed(root, configuration, overwrite=True)
    installed(root, configuration, "other")

    data = root / "var/lib/friction-hil/other"
    data.mkdir(parents=True)
    assert remove("table", root).removed[0] == folder
    assert services(root) == ["other"]
    with pytest.raises(UsageError, match=r"'table'.*: other"):
        remove("table", root)
    assert remove("other", root).kept == [data]
    assert [path for path in root.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077])
def test_nobody_else_reads_the_copy_of_a_token(configuration, tmp_path, umask):
    changed(configuration, lambda values: values.update(live={"dashboard": 8080, "token_file": "mill.token"}))
    (tmp_path / "mill.token").write_text("abcdefghijklmnopqrstuvwxyz\n")
    (tmp_path / "mill.token").chmod(0o600)
    folder, before = tmp_path / "root/etc/friction-hil/table", os.umask(umask)
    try:
        installed(tmp_path / "root", configuration)
        (folder / "mill.token").chmod(0o644)  # as an earlier version has left it
        with (folder / "mill.token").open() as opened_before:
            done = installed(tmp_path / "root", configuration, overwrite=True)
            assert not os.path.samestat(os.fstat(opened_before.fileno()), (folder / "mill.token").stat())
    finally:
        os.umask(before)
    modes = {path.name: path.stat().st_mode & 0o777 for path in done.written}
    assert modes == dict.fromkeys(modes, 0o644) | {"mill.token": 0o600}
    assert (folder / "models").stat().st_mode & 0o055 == 0o055  # another user may read what root wrote
    assert token_of(folder / "mill.token") == "abcdefghijklmnopqrstuvwxyz"
    assert f"chown friction-hil: {folder / 'mill.token'}" in done.to_run


@pytest.mark.parametrize("name", ["", "../x", "a/b", "x y", ".x", "-x", "x" * 49, "x\n", "é"])
def test_a_name_that_is_none_writes_nothing_and_a_daemon_may_be_called_as_its_service(name, configuration, tmp_path):
    with pytest.raises(UsageError, match="name of a service"):
        installed(tmp_path / "root", configuration, name)
    assert not (tmp_path / "root").exists()
    installed(tmp_path / "root", configuration, "x-axis_1.b")
    assert services(tmp_path / "root") == ["x-axis_1.b"]
    assert is_name("x-axis_1.b")


def with_model(path):
    return lambda values: values["axes"]["x"].update(model=str(path))


def test_what_the_service_could_not_run_is_refused_before_anything_is_written(configuration, tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[install.__module__], "_HIDDEN", (f"{tmp_path}/home/", "/home/"))
    root, hidden = tmp_path / "root", tmp_path / "home"
    hidden.mkdir()
    (hidden / "x.yaml").write_bytes((tmp_path / "models/x.yaml").read_bytes())
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/python").symlink_to(hidden / "python")  # of an environment whose interpreter is a user's

    broken = changed(
        configuration, lambda values: values["axes"]["x"]["compensation"].update(gain=7.0), tmp_path / "broken.yaml"
    )
    with pytest.raises(ConfigurationError, match=r"broken\.yaml:\d+: axes\.x\.compensation\.gain"):
        installed(root, broken)
    outside = changed(configuration, with_model("../models/x.yaml"), tmp_path / "inner/machine.yaml")
    with pytest.raises(UsageError, match=r"\.\./models/x\.yaml .*inner"):
        installed(root, outside)
    with pytest.raises(UsageError, match=r"home/x\.yaml .*home/"):
        installed(root, changed(configuration, with_model(hidden / "x.yaml"), tmp_path / "named.yaml"))
    for executable, words in (
        ("/home/someone/.venv/bin/friction-hil", "/home/.*/opt/friction-hil"),
        (f"{tmp_path}/bin/friction-hil", "home/.*; install friction_hil"),
        ("/opt/my machine/friction-hil", "' '"),
    ):
        with pytest.raises(UsageError, match=words):
            install("table", configuration, root, executable, overwrite=False)
    assert not root.exists()


def test_recordings_are_not_copied_and_are_refused_where_the_service_may_not_write(configuration, tmp_path):
    def install_with(path, root):
        changed(configuration, lambda values: values.update(recording={"path": path}))
        return installed(tmp_path / root, configuration)

    (tmp_path / "run.mcap").write_bytes(b"gigabytes")
    assert not [path for path in install_with("run.mcap", "root").written if path.suffix == ".mcap"]
    for path in ("/data/run.mcap", "../../run.mcap"):
        with pytest.raises(UsageError, match=r"recording\.path: "):
            install_with(path, "other")
    assert not (tmp_path / "other").exists()


def test_a_service_that_is_replaced_does_not_wait_for_the_former_device(configuration, tmp_path):
    root = tmp_path / "root"
    devices = root / "etc/systemd/system/friction-hil@table.service.d/devices.conf"
    installed(root, configuration)
    assert devices.exists()
    multicast = {"interface": "udp_multicast", "channel": "239.74.163.2", "port": 43113}
    changed(configuration, lambda values: values.update(bus=multicast))
    assert installed(root, configuration, overwrite=True).removed == [devices]
    assert not devices.exists()


def test_what_cannot_be_written_is_named(configuration, tmp_path):
    (tmp_path / "file").mkdir()
    (tmp_path / "file/etc").touch()
    with pytest.raises(UsageError, match="Not a directory"):
        installed(tmp_path / "file", configuration)


@given(st.text(st.characters(codec="utf-8", exclude_characters="\0\n"), min_size=1, max_size=30))
def test_escaped_names_have_allowed_characters_and_tell_the_name_again(name):
    escaped = files.escape(name)
    assert all(each.isascii() and (each.isalnum() or each in ":_.\\-") for each in escaped)
    raw = escaped.replace("-", "/").encode().decode("unicode_escape").encode("latin-1").decode()
    assert raw == name


@pytest.mark.parametrize(
    ("path", "unit"),
    [
        ("/dev/ttyUSB0", "dev-ttyUSB0.device"),
        ("/dev/serial/by-id/usb-1", r"dev-serial-by\x2did-usb\x2d1.device"),  # systemd-escape --path prints this
    ],
)
def test_devices_have_the_names_of_systemd(path, unit):
    assert files.file_device(path) == unit


def test_the_state_is_read_from_systemctl():
    text = "LoadState=loaded\nActiveState=failed\nSubState=failed\nStatusText=fault: x: a=b [FH-103]\nMainPID=0\n"
    state = parse(text + "NRestarts=2\nResult=watchdog\nExecMainStatus=6\n")
    assert (state.active, state.pid, state.restarts) == ("failed", None, 2)
    assert (state.result, state.exit_status, state.status) == ("watchdog", 6, "fault: x: a=b [FH-103]")
    assert not parse("LoadState=not-found\n").is_loaded


def test_the_command_says_what_it_wrote_and_what_comes_next(configuration, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("friction_hil.cli.work.service.executable", lambda: EXECUTABLE)
    root = str(tmp_path / "root")
    assert main(["service", "install", "table", str(configuration), "--root", root]) == 0
    said = capsys.readouterr().out.splitlines()
    assert f"written: {root}/etc/friction-hil/table/models/x.yaml" in said
    assert said[-2:] == [
        "next, where systemd runs: the commands above, then systemctl enable --now friction-hil@table",
        "then: friction-hil start table; its axes move",
    ]
    assert main(["service", "remove", "table", "--root", root, "--json"]) == 0
    assert f"{root}/etc/friction-hil/table" in json.loads(capsys.readouterr().out)["removed"]


def test_services_that_are_not_active_are_exit_status_1(tmp_path, monkeypatch, capsys):
    systemctl, shown = tmp_path / "systemctl", "LoadState=loaded\nActiveState=$STATE\nSubState=$2\nMainPID=7"
    systemctl.write_text(f'#!/bin/sh\necho "{shown}"\n')
    systemctl.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setenv("STATE", "active")
    assert main(["service", "status", "table"]) == 0
    assert capsys.readouterr().out == "table: active (friction-hil@table.service, process 7)\n"
    monkeypatch.setenv("STATE", "failed")
    assert main(["service", "status", "table", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["services"]["table"]["pid"] == 7
    systemctl.write_text("#!/bin/sh\necho no bus >&2; exit 1\n")
    assert main(["service", "status", "table"]) == 1
    assert "unknown: no bus" in capsys.readouterr().err


@pytest.fixture
def manager_socket(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "n"))
        listening.setblocking(False)
        yield listening


def received(listening):
    messages = []
    with contextlib.suppress(BlockingIOError):
        while True:
            messages.append(listening.recv(4096).decode())
    return messages


def test_rows_and_nothing_else_feed_the_watchdog(manager_socket):
    environment = {"NOTIFY_SOCKET": manager_socket.getsockname(), "WATCHDOG_USEC": "2000000"}
    manager, rows, events = ServiceManager.from_environment(environment), [], []
    behind = SimpleNamespace(push=rows.append, event=lambda *event: events.append(event))
    sink = NotifyingSink(behind, manager, 1e-3)
    sink.event(0, "state", "idle")
    for _ in range(1000):
        sink.push(np.zeros(1))
    assert received(manager_socket) == ["STATUS=idle", "READY=1", "WATCHDOG=1", "WATCHDOG=1"]  # every 0.5 s
    sink.event(1, "fault", "x: the drive\nis gone")
    sink.event(1, "warning", "late")
    assert received(manager_socket) == ["STATUS=fault: x: the drive is gone"]
    assert (len(rows), len(events)) == (1000, 3)
    manager.close()


def test_without_a_manager_or_with_one_that_is_gone_the_loop_goes_on(tmp_path):
    assert ServiceManager.from_environment({}) is None
    gone = ServiceManager.from_environment({"NOTIFY_SOCKET": str(tmp_path / "gone")})
    assert gone.watchdog_s is None
    gone.ready()
    other = {"NOTIFY_SOCKET": str(tmp_path / "gone"), "WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}
    assert ServiceManager.from_environment(other).watchdog_s is None
    gone.close()
    for odd in ("vsock:2:1234", "x" * 200, str(tmp_path), "/proc/version/n"):
        manager = ServiceManager.from_environment({"NOTIFY_SOCKET": odd})
        manager.alive()
        manager.close()


def test_an_abstract_socket_is_reached():
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind("")  # the kernel chooses a name
        listening.setblocking(False)
        manager = ServiceManager.from_environment({"NOTIFY_SOCKET": "@" + listening.getsockname()[1:].decode()})
        manager.ready()
        manager.close()
        assert received(listening) == ["READY=1"]


def test_a_full_queue_never_makes_the_loop_wait(manager_socket):
    manager = ServiceManager(manager_socket.getsockname(), None)
    for _ in range(5000):  # more than a queue holds
        manager.alive()
    assert 0 < len(received(manager_socket)) < 5000
    manager.close()
