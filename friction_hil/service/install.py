"""Writing and removing the files of a service."""

import os
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from friction_hil.checked_yaml import text as yaml_text
from friction_hil.config import Configuration, file_problems, load
from friction_hil.daemon.control.names import is_name
from friction_hil.errors import ConfigurationError, UsageError
from friction_hil.service import files

CONFIGURATIONS = "etc/friction-hil"
UNITS = "etc/systemd/system"
UDEV_RULES = "etc/udev/rules.d/70-friction-hil.rules"
SYSUSERS = "etc/sysusers.d/friction-hil.conf"
DATA = "var/lib/friction-hil"
_SEEN = f"/{DATA}"  # by the service
_LONGEST_NAME = 48  # characters
_HIDDEN = ("/home/", "/root/", "/run/user/", "/tmp/", "/var/tmp/")  # from the service, by ProtectHome and PrivateTmp
_BOOTED = "/run/systemd/system"  # exists where systemd is the service manager; see sd_booted(3)
_PATIENCE_S = 60.0


@dataclass(slots=True)
class Installation:
    """What an installation or removal did."""

    written: list[Path] = field(default_factory=list)
    removed: list[Path] = field(default_factory=list)
    kept: list[Path] = field(default_factory=list)  # files that were left where they are
    commands: list[str] = field(default_factory=list)  # that were run
    # commands that are left to the user, because this is not the running system
    to_run: list[str] = field(default_factory=list)


def install(name: str, configuration: Path, root: Path, executable: str, *, overwrite: bool) -> Installation:
    """Write the files of the service ``name``, without enabling or starting it.

    ``name``: of the service and of its daemon. ``configuration`` is copied, with the files beside it that it names.
    ``root``: directory that counts as root of the file system. ``executable``: absolute path of the command
    ``friction-hil``. ``overwrite``: a service of this name may be replaced.

    Raises `ConfigurationError`: the configuration has mistakes; `UsageError`: the name or the place of the executable
    is unsuitable, or there is such a service already.
    """
    _check_name(name)
    _check_executable(executable)
    checked = load(configuration)
    if problems := file_problems(configuration, checked):
        raise ConfigurationError(problems)
    folder = root / CONFIGURATIONS / name
    if folder.exists() and not overwrite:
        raise UsageError(f"{folder} exists already; --force replaces the service {name}, another name keeps it")
    document = yaml_text.read(configuration).value
    _check_recordings(checked)
    secret = {folder / each for each in _named_files(_secrets(document), configuration.parent)}
    texts: dict[Path, bytes] = {
        root / UNITS / files.UNIT: files.unit(executable, f"/{CONFIGURATIONS}").encode(),
        root / UDEV_RULES: files.UDEV_RULES.encode(),
        root / SYSUSERS: files.SYSUSERS.encode(),
        folder / "config.yaml": configuration.read_bytes(),
    }
    read = {key: value for key, value in document.items() if key != "recording"}  # those that the daemon writes stay
    for relative in sorted(_named_files(read, configuration.parent)):
        texts[folder / relative] = (configuration.parent / relative).read_bytes()
    if devices := _devices(document):
        texts[_drop_in(root, name)] = files.drop_in(devices).encode()
    done = Installation()
    if not devices and (former := _drop_in(root, name)).exists():  # the service would wait for a device of the past
        former.unlink()
        done.removed.append(former)
    for path, text in texts.items():
        _write(path, text, is_secret=path in secret)
        done.written.append(path)
    load(folder / "config.yaml")  # the copy has what it needs
    own = [f"chown {files.USER}: {shlex.quote(str(path))}" for path in sorted(secret)]  # its user is there by then
    commands = ["udevadm control --reload", "udevadm trigger", "systemctl daemon-reload"]
    _carry_out(done, root, ["systemd-sysusers", *own, *commands])
    return done


def remove(name: str, root: Path) -> Installation:
    """Remove the service ``name``: stop and disable it, and remove its files.

    Recordings stay. What all services share goes with the last of them. Raises `UsageError`: there is no such service.
    """
    _check_name(name)
    folder = root / CONFIGURATIONS / name
    if not folder.is_dir():
        there = ", ".join(services(root)) or "none"
        raise UsageError(f"no service is called {name!r}: {folder} does not exist. There are: {there}")
    done = Installation()
    _carry_out(done, root, [f"systemctl disable --now friction-hil@{name}"])
    drop_in = _drop_in(root, name)
    for path in (folder, drop_in.parent):
        if path.exists():
            shutil.rmtree(path)
            done.removed.append(path)
    if not services(root):
        for relative in (f"{UNITS}/{files.UNIT}", UDEV_RULES, SYSUSERS):
            if (root / relative).exists():
                (root / relative).unlink()
                done.removed.append(root / relative)
    if (data := root / DATA / name).exists():
        done.kept.append(data)
    _carry_out(done, root, ["systemctl daemon-reload"])
    return done


def services(root: Path) -> list[str]:
    """Return the names of the installed services."""
    folder = root / CONFIGURATIONS
    return sorted(path.parent.name for path in folder.glob("*/config.yaml"))


def _check_name(name: str) -> None:
    if not is_name(name) or len(name) > _LONGEST_NAME:
        raise UsageError(
            f"NAME: {name!r} is no name of a service; write up to {_LONGEST_NAME} letters, digits, '.', '_' and '-', "
            "beginning with a letter or digit, e.g. x_axis"
        )


def _check_executable(executable: str) -> None:
    if not os.path.isabs(executable):
        raise UsageError(f"{executable}: the unit needs the absolute path of the command friction-hil")
    if unfit := next((each for each in executable if each.isspace() or each in "%$\"'\\;"), None):
        raise UsageError(f"{executable}: a unit cannot run a command whose path has {unfit!r}; install it elsewhere")
    interpreter = os.path.join(os.path.dirname(executable), "python")  # of its environment: a link to elsewhere
    if hidden := _hidden(executable) or _hidden(interpreter):
        raise UsageError(
            f"{executable} lies below {hidden}, which the service does not see; install friction_hil for the whole "
            "machine, e.g.: sudo python3 -m venv /opt/friction-hil && sudo /opt/friction-hil/bin/pip install "
            "friction-hil; then run /opt/friction-hil/bin/friction-hil service install"
        )


def _hidden(path: str) -> str | None:
    """Return the directory, hidden from the service, in which a file lies; None if the service sees it."""
    return next((each for each in _HIDDEN if os.path.realpath(path).startswith(each)), None)


def _check_recordings(configuration: Configuration) -> None:
    """Refuse recordings where the service may not write.

    Raises `UsageError`: a path of ``recording`` is not relative, nor below the directory of the service's data.
    """
    given = configuration.recording
    for key in () if given is None else ("path", "black_box"):
        path = getattr(given, key)
        inside = path is None or Path(os.path.normpath(Path(_SEEN) / "NAME" / path)).is_relative_to(_SEEN)
        if not inside:
            raise UsageError(
                f"recording.{key}: the service may not write to {path}; a relative path is one below {_SEEN}/NAME"
            )


def _named_files(value: Any, folder: Path) -> Iterator[Path]:
    """Yield the relative paths of files in ``folder`` and below that the values of a configuration name.

    Raises `UsageError`: a file lies elsewhere, relative to the configuration: its copy would not find it.
    """
    if isinstance(value, dict):
        for each in value.values():
            yield from _named_files(each, folder)
    elif isinstance(value, list):
        for each in value:
            yield from _named_files(each, folder)
    elif isinstance(value, str) and os.path.isabs(value) and os.path.isfile(value):
        if hidden := _hidden(value):
            raise UsageError(
                f"{value} lies below {hidden}, which the service does not see; move it beside the configuration, which "
                "is copied, and name it by its relative path"
            )
    elif isinstance(value, str) and _is_relative_file(value, folder):
        path = Path(os.path.normpath(value))
        if path.parts[0] == "..":
            raise UsageError(f"{value} lies outside of {folder}; move it beside the configuration, which is copied")
        yield path


def _is_relative_file(value: str, folder: Path) -> bool:
    return bool(value) and "\0" not in value and not os.path.isabs(value) and os.path.isfile(folder / value)


def _devices(document: dict[str, Any]) -> list[str]:
    """Return the units of the devices that the configuration names: CAN interface, serial ports."""
    bus = document.get("bus") or {}
    found = [files.network_device(str(bus["channel"]))] if bus.get("interface") == "socketcan" else []
    return list(dict.fromkeys([*found, *(files.file_device(path) for path in _device_files(document))]))


def _device_files(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        for each in value.values():
            yield from _device_files(each)
    elif isinstance(value, list):
        for each in value:
            yield from _device_files(each)
    elif isinstance(value, str) and value.startswith("/dev/tty"):
        yield value.partition("@")[0]  # slcan: /dev/ttyACM0@115200


def _drop_in(root: Path, name: str) -> Path:
    return root / UNITS / f"friction-hil@{name}.service.d" / "devices.conf"


def _secrets(document: dict[str, Any]) -> Any:
    """Return what names files that nobody but the service may read."""
    live = document.get("live")
    return live.get("token_file") if isinstance(live, dict) else None


def _write(path: Path, text: bytes, *, is_secret: bool) -> None:
    """Write a file that everybody may read, or the service alone; a secret never has a wider mode, not for a moment."""
    try:
        before = os.umask(0o022)  # the service, which is another user, reads them
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        finally:
            os.umask(before)
        path.unlink(missing_ok=True)  # whoever has opened the former one does not see this one
        mode = 0o600 if is_secret else 0o644
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
            path.chmod(mode)  # whatever the umask is
            file.write(text)
    except PermissionError:
        raise UsageError(f"{path}: no permission to write; run this command with sudo") from None
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None


def _carry_out(done: Installation, root: Path, commands: list[str]) -> None:
    """Run ``commands`` if ``root`` is the running system; leave them to the user otherwise.

    Raises `UsageError`: a command failed.
    """
    if root != Path("/") or not os.path.isdir(_BOOTED):
        done.to_run += commands
        return
    for command in commands:
        result = subprocess.run(shlex.split(command), capture_output=True, text=True, timeout=_PATIENCE_S, check=False)
        if result.returncode:
            raise UsageError(f"{command} failed with status {result.returncode}: {result.stderr.strip()}")
        done.commands.append(command)
