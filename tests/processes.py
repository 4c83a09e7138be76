"""Real processes on a real bus: simulated drives and the daemon, for integration tests. Paced by SYNC, so no clock."""

import contextlib
import json
import random
import subprocess
from pathlib import Path

import can
import yaml

from tests.launcher import start
from tests.peers.own_group import keep_to_own_group
from tests.servo_drives import axis_dict

GROUP = "239.74.163.2"


def free_port():
    """A port of its own for each run, so that parallel runs do not hear each other."""
    return random.SystemRandom().randrange(20000, 60000)


def write_configuration(folder: Path, *, port=None, bus=None, period_s=1e-3, **axes) -> Path:
    """A configuration file with simulated axes; an axis may change keys of `axis_dict`."""
    data = {
        "version": 1,
        "period_s": period_s,
        "bus": bus or {"interface": "udp_multicast", "channel": GROUP, "port": port or free_port(), "hop_limit": 0},
        "axes": {name: {"simulation": {}, **axis_dict(**changes)} for name, changes in (axes or {"x": {}}).items()},
        "realtime": {"priority": 0},
    }
    path = folder / "axes.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


@contextlib.contextmanager
def simulated_drives(configuration: Path, *options: str, pace: str = "sync"):
    """Simulated drives on the bus; they end with this test, however it ends."""
    process = start(
        *("simulate", configuration, "--pace", pace, "--exit-with-stdin", *options),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    try:
        ready = process.stdout.readline()
        assert ready.startswith("ready:"), process.stderr.read()
        yield process
    finally:
        process.stdin.close()
        process.wait(30)
        process.stdout.close()
        process.stderr.close()


def run(*arguments, check=True, **options) -> subprocess.CompletedProcess:
    """One command of friction-hil, to its end."""
    with start(*arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options) as process:
        try:
            output, errors = process.communicate(timeout=240)
        except BaseException:
            process.kill()
            raise
    done = subprocess.CompletedProcess(process.args, process.returncode, output, errors)
    if check:
        assert done.returncode == 0, done.stderr + done.stdout
    return done


def run_daemon(configuration: Path, *options, check=True) -> tuple[dict, subprocess.CompletedProcess]:
    """The daemon, paced by SYNC; its JSON (empty when it printed none) and the process."""
    done = run("run", configuration, "--pace", "sync", "--json", *options, check=check)
    return (json.loads(done.stdout) if done.stdout else {}), done


def start_daemon(configuration: Path, *options) -> subprocess.Popen:
    """The daemon in the background; the caller ends it."""
    words = ("run", configuration, "--pace", "sync", "--json", *options)
    return start(*words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def multicast_bus(group, port) -> can.BusABC:
    """A bus of python-can alone; without the last line it would also hear the other groups on its port."""
    bus = can.Bus(interface="udp_multicast", channel=group, port=port, hop_limit=0, fd=False)
    keep_to_own_group(bus)
    return bus


@contextlib.contextmanager
def listening(configuration: Path):
    """A python-can bus beside the processes."""
    config = yaml.safe_load(configuration.read_text())["bus"]
    bus = multicast_bus(config["channel"], config["port"])
    try:
        yield bus
    finally:
        bus.shutdown()


def wait_for_frames(bus, can_id: int, count: int) -> list[can.Message]:
    """All frames up to the ``count``-th with ``can_id``."""
    frames = []
    while count:
        message = bus.recv(30.0)
        assert message is not None, f"no frame for 30 s, {count} more of {can_id:X}h expected"
        frames.append(message)
        count -= message.arbitration_id == can_id
    return frames
