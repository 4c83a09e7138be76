"""Where masters find simulated drives: a link to a pseudo-terminal, or a TCP port."""

import os
import select
import socket
import termios
import time
import tty
from pathlib import Path

import pytest
from friction_hil_drivers.serial_line.options import LineOptions
from friction_hil_drivers.serial_line.simulated.port import PtyPort, TcpPort, open_port
from pydantic import ValidationError

from friction_hil.errors import BusError
from tests.peers.serial_processes import free_tcp_port
from tests.serial_bench import LONG_S, Master


def heard(port):
    """What comes next, once it has come."""
    assert select.select(port.descriptors, [], [], LONG_S)[0]
    return port.read()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "line"


@pytest.fixture
def pty(path):
    port = PtyPort(path)
    yield port
    port.close()
    port.close()
    assert not path.is_symlink()


def test_bytes_pass_both_ways_as_they_are_while_masters_come_and_go(pty, path):
    assert pty.where == f"{path} (pseudo-terminal {os.readlink(path)})"
    everything = bytes(range(256))
    for _ in range(2):
        master = Master(path)
        tty.setcbreak(os.open(path, os.O_RDWR | os.O_NOCTTY), termios.TCSANOW)
        master.send(everything)
        received = b""
        while len(received) < 256:
            received += heard(pty) or b""
        assert received == everything
        assert pty.read() == b""
        pty.write(everything)
        assert master.receive(256) == everything
        master.close()
        assert pty.read() == b""


def test_what_a_dead_master_left_unread_is_no_reply_to_the_next_one(pty, path, monkeypatch):
    now_s = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    dead, following = Master(path), Master(path)
    for request in (b"a", b"b"):
        dead.send(request)
        assert heard(pty) == request
        pty.write(request + b": enabled")
    assert dead.receive(10) == b"a: enabled"
    pty.idle()
    assert dead.receive(1) == b"b", "who is only late loses nothing"
    now_s += 1.0
    pty.idle()
    following.send(b"c")
    assert heard(pty) == b"c"
    pty.write(b"c: fault")
    assert following.receive(8) == b"c: fault"
    dead.close()
    following.close()


def test_nobody_reads_and_nothing_blocks(pty, path):
    for _ in range(100):
        pty.write(bytes(1000))
    master = Master(path)
    received = master.receive(1) + master.receive(100_000, timeout_s=0.0)
    assert len(received) < 100_000, "what does not fit into the terminal's buffer is lost"
    master.close()


@pytest.mark.parametrize("target", ["/dev/pts/99999", "nowhere", "the terminal of somebody else by now"])
def test_a_link_left_behind_is_replaced(path, target):
    master, slave = os.openpty()
    target = os.ttyname(slave) if " " in target else target
    path.symlink_to(target)
    port = PtyPort(path)
    assert os.readlink(path) != target
    port.close()
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize("kind", ["file", "directory", "link to a file", "device"])
def test_what_is_no_such_link_stays(path, kind):
    if kind == "file":
        path.write_text("precious")
    elif kind == "directory":
        path.mkdir()
    elif kind == "link to a file":
        (path.parent / "precious").write_text("precious")
        path.symlink_to("precious")
    else:
        path = Path("/dev/null")
    before = os.lstat(path)
    with pytest.raises(BusError, match="is not replaced"):
        PtyPort(path)
    assert os.path.samestat(os.lstat(path), before)


def test_two_simulations_cannot_share_a_link(path):
    first = PtyPort(path)
    target = os.readlink(path)
    with pytest.raises(BusError, match="another process"):
        PtyPort(path.parent / "." / path.name)
    assert os.readlink(path) == target
    first.close()
    second = PtyPort(path)
    path.unlink()
    path.write_text("precious")
    second.close()
    assert path.read_text() == "precious", "it was another's by then"


def test_a_link_that_cannot_be_made_is_told(tmp_path):
    with pytest.raises(BusError, match=r"missing/line .*No such file"):
        PtyPort(tmp_path / "missing" / "line")
    (tmp_path / "missing").mkdir()
    PtyPort(tmp_path / "missing" / "line").close()  # nothing of the failure is left


@pytest.fixture
def tcp():
    port = open_port(LineOptions(port=f"tcp://127.0.0.1:{free_tcp_port()}"))
    assert isinstance(port, TcpPort)
    yield port
    port.close()


def connect(port, is_heard=True):
    number = int(port.where.rsplit(":")[-1])
    client = socket.create_connection(("127.0.0.1", number), LONG_S)
    assert not is_heard or heard(port) == b""
    return client


def test_tcp_passes_bytes_and_masters_come_and_go(tcp):
    tcp.write(b"nobody hears this")
    for _ in range(3):
        with connect(tcp) as client:
            client.sendall(b"hello")
            assert heard(tcp) == b"hello"
            tcp.write(b"you")
            assert client.recv(10) == b"you"
            client.sendall(b"half a req")
        assert heard(tcp) is None  # what it left half-said is void
        tcp.write(b"nobody hears this")


def test_tcp_serves_one_master_at_a_time(tcp):
    with connect(tcp) as first:
        with connect(tcp) as second:
            second.settimeout(LONG_S)
            assert second.recv(1) == b""  # sent away
        first.sendall(b"still here")
        assert heard(tcp) == b"still here"


def test_tcp_takes_the_next_master_in_the_moment_the_last_one_goes(tcp):
    first = connect(tcp)
    first.close()
    with connect(tcp, is_heard=False) as second:
        assert heard(tcp) is None
        second.sendall(b"next")
        assert next(filter(None, iter(lambda: heard(tcp), None))) == b"next"


def test_a_port_in_use_is_told(tcp):
    with pytest.raises(BusError, match="in use"):
        TcpPort(tcp.where)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:0", "tcp://127.0.0.1", "tcp://:5020", "tcp://127.0.0.1:66000"])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(ValidationError, match="tcp://HOST:PORT"):
        LineOptions(port=address)
