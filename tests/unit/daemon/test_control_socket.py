"""The control socket: names, lock, permissions, protocol."""

import contextlib
import json
import os
import socket
import stat
import threading

import pytest

from friction_hil.daemon.control import lock
from friction_hil.daemon.control.ask import Question, ask
from friction_hil.daemon.control.desk import _request
from friction_hil.daemon.control.lock import ControlSocket, control_socket
from friction_hil.daemon.control.names import default_name, find, is_live, running, socket_path
from friction_hil.daemon.control.server import LONGEST_LINE, MOST_CLIENTS, ControlServer
from friction_hil.errors import FrictionHilError, UsageError


@pytest.fixture
def folder(tmp_path_factory, monkeypatch):
    """A folder of this test for sockets, with a short path."""
    found = tmp_path_factory.mktemp("s")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(found))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    return found / "friction-hil"


@pytest.fixture
def daemon(folder):
    """A daemon that answers with what it was asked."""
    opened = ControlSocket("echo")

    def answer(line, user):
        return {"ok": True, "user": user, "asked": line.decode()}

    with ControlServer(opened.descriptor, lambda: answer) as server:
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        yield opened
        server.shutdown()
    opened.close()


def test_the_name_of_a_daemon_is_that_of_its_configuration(folder):
    from pathlib import Path

    assert default_name(Path("config/two_axes.yaml")) == "two_axes"
    assert default_name(Path("Prüfstand 1.yaml")) == "Pr-fstand-1"
    assert default_name(Path(".yaml")) == "yaml"
    assert socket_path("mill.2") == folder / "mill.2.sock"
    for wrong in ("", "../x", "a/b", ".hidden", "a b", "x\n"):
        with pytest.raises(UsageError, match="is no name of a daemon"):
            socket_path(wrong)


def test_a_path_that_no_socket_can_have_is_answered_by_a_message(folder, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/" + "d" * 79)
    assert len(str(socket_path("x" * 8))) == 107
    with pytest.raises(UsageError, match="is 1 bytes longer than the 107 bytes that the system allows"):
        ControlSocket("x" * 9)


def test_a_service_has_the_folder_that_systemd_made_for_it(folder, monkeypatch, tmp_path):
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    assert socket_path("mill") == tmp_path / "mill.sock"


def test_a_second_daemon_of_a_name_is_refused_and_the_first_stays(folder):
    first = ControlSocket("mill")
    with pytest.raises(UsageError, match=rf"called 'mill' runs already \(process {os.getpid()}\); --name gives"):
        ControlSocket("mill")
    assert is_live(first.path)
    second = control_socket("mill", None, is_next_taken=True)
    assert {name for name, _ in running() if name.startswith("mill")} == {"mill", "mill-2"}
    first.close()
    second.close()
    assert not list(folder.glob("*.sock"))
    ControlSocket("mill").close()


def test_the_socket_of_a_killed_daemon_is_replaced(folder):
    folder.mkdir()
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(folder / "mill.sock"))
    assert (folder / "mill.sock").exists()
    assert "mill" not in dict(running())
    opened = ControlSocket("mill")
    assert is_live(opened.path)
    opened.close()


def test_a_socket_that_somebody_serves_is_never_replaced(folder, monkeypatch):
    """In a container that shares the folder, the lock is not seen."""
    folder.mkdir()
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(folder / "mill.sock"))
        other.listen()
        monkeypatch.setattr(lock, "_ORPHAN_S", 0.0)
        inode = (folder / "mill.sock").stat().st_ino
        with pytest.raises(UsageError, match="called 'mill' runs already"):
            ControlSocket("mill")
        assert (folder / "mill.sock").stat().st_ino == inode


def test_only_the_user_may_use_the_socket_and_the_group_if_one_is_given(folder):
    alone = ControlSocket("alone")
    assert stat.S_IMODE(alone.path.stat().st_mode) == 0o600
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    alone.close()
    with pytest.raises(UsageError, match="--group nobody-here: there is no such group"):
        ControlSocket("shared", "nobody-here")
    import grp

    group = grp.getgrgid(os.getgid()).gr_name
    shared = ControlSocket("shared", group)
    status = shared.path.stat()
    assert (stat.S_IMODE(status.st_mode), status.st_gid) == (0o660, os.getgid())
    shared.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_another_user_is_refused_by_the_kernel(folder, daemon):
    for part in (folder, *folder.parents[:3]):
        part.chmod(0o755)
    read_end, write_end = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.setgroups([])
            os.setgid(65534)
            os.setuid(65534)
            ask(daemon.path, {"do": "status"})
            os.write(write_end, b"it was allowed")
        except FrictionHilError as error:
            os.write(write_end, str(error).encode())
        finally:
            os._exit(0)
    os.close(write_end)
    with os.fdopen(read_end, "rb") as answer:
        assert b"this user may not use the control socket" in answer.read()
    os.waitpid(pid, 0)


def test_a_line_is_answered_by_a_line_with_the_user_whom_the_kernel_names(daemon):
    assert find("echo") == daemon.path
    answer = ask(daemon.path, {"do": "status"})
    assert (answer["user"], json.loads(answer["asked"])) == (os.geteuid(), {"do": "status"})
    with socket.socket(socket.AF_UNIX) as client, client.makefile("rb") as file:
        client.connect(str(daemon.path))
        client.sendall(b"one\n\xff\ntwo\n")
        first, error, second = (json.loads(file.readline()) for _ in range(3))
    assert (first["asked"], second["asked"]) == ("one\n", "two\n")
    assert (error["ok"], "UnicodeDecodeError" in error["problems"][0]) == (False, True)  # it keeps nobody from asking


def idle(client):
    """Sends nothing."""


def half_a_request(client):
    client.sendall(b'{"do": "sta')


def asks_and_stays(client):
    """Has had its answer."""
    client.sendall(b'{"do": "observe"}\n')
    assert client.recv(1 << 16)


def never_reads(client):
    """Asks until the server cannot send its answers any more."""
    client.settimeout(0.05)
    with contextlib.suppress(TimeoutError):
        while client.send(b"x" * 60_000 + b"\n"):
            pass


@pytest.fixture
def crowd(daemon):
    """A function that lets more clients than there are places do something, and stay."""
    clients = []

    def come(do):
        for _ in range(MOST_CLIENTS + 8):
            clients.append(socket.socket(socket.AF_UNIX))
            clients[-1].connect(str(daemon.path))
            do(clients[-1])
        return clients

    yield come
    for each in clients:
        each.close()


@pytest.mark.parametrize("do", [idle, half_a_request, asks_and_stays, never_reads])
def test_clients_that_only_keep_their_places_shut_nobody_out(daemon, crowd, do):
    crowd(do)
    for request in ({"do": "stop"}, {"do": "status"}) * MOST_CLIENTS:
        assert json.loads(ask(daemon.path, request)["asked"]) == request


def test_clients_that_send_a_byte_now_and_then_shut_nobody_out(daemon, crowd):
    """Each byte makes a client the last one that has sent something, but never one that has asked."""
    clients = crowd(half_a_request)
    for _ in range(3):
        for each in clients:
            with contextlib.suppress(BrokenPipeError):
                each.send(b"t")
        assert ask(daemon.path, {"do": "stop"})["ok"]


def test_who_is_hung_up_is_told_why_and_it_is_who_was_silent_for_the_longest_time(daemon):
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(socket.socket(socket.AF_UNIX)) for _ in range(MOST_CLIENTS + 1)]
        files = [stack.enter_context(each.makefile("rb")) for each in clients]
        for each in clients[:-1]:
            each.connect(str(daemon.path))
        for k in (*range(MOST_CLIENTS), 0, *range(2, MOST_CLIENTS)):
            clients[k].sendall(b"here\n")
            assert json.loads(files[k].readline())["ok"]
        clients[-1].connect(str(daemon.path))
        assert "this one was silent for the longest time" in json.loads(files[1].readline())["problems"][0]
        assert files[1].readline() == b""
        for k in (0, *range(2, MOST_CLIENTS + 1)):
            clients[k].sendall(b"still here\n")
            assert json.loads(files[k].readline())["asked"] == "still here\n"


def test_who_comes_while_all_are_being_answered_waits_for_a_place(folder):
    opened, begun, goes_on = ControlSocket("slow"), threading.Semaphore(0), threading.Event()

    def answer(line, user):
        begun.release()
        if line != b"stop\n":
            goes_on.wait()
        return {"ok": True, "asked": line.decode()}

    with contextlib.ExitStack() as stack:
        server = stack.enter_context(ControlServer(opened.descriptor, lambda: answer))
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        stack.callback(server.shutdown)
        stack.callback(goes_on.set)
        clients = [stack.enter_context(socket.socket(socket.AF_UNIX)) for _ in range(MOST_CLIENTS + 2)]
        for each in clients[:MOST_CLIENTS]:
            each.connect(str(opened.path))
            each.sendall(b"slow\n")
            begun.acquire()
        for each in clients[MOST_CLIENTS:]:
            each.connect(str(opened.path))
            each.sendall(b"stop\n")
        assert not begun.acquire(timeout=0.05)
        goes_on.set()
        for each in clients:
            assert json.loads(stack.enter_context(each.makefile("rb")).readline())["ok"]
    opened.close()


def test_who_hangs_up_before_the_answer_leaves_nothing_on_the_terminal(daemon, crowd, capsys):
    for do in (half_a_request, lambda client: client.sendall(b'{"do": "status"}\n' * 3)):
        for each in crowd(do):
            each.close()
    assert ask(daemon.path, {"do": "status"})["ok"]
    assert capsys.readouterr().err == ""


def test_a_client_waits_where_more_ask_than_the_system_lets_wait(folder):
    """Nobody accepts yet: the queue is full, and a stop must not fail for that."""
    with socket.socket(socket.AF_UNIX) as listening, contextlib.ExitStack() as stack:
        path = folder.parent / "full.sock"
        listening.bind(str(path))
        listening.listen(0)
        first = stack.enter_context(socket.socket(socket.AF_UNIX))
        first.connect(str(path))
        with pytest.raises(FrictionHilError, match=r"no answer within 0\.05 s"):
            Question(path, {"do": "stop"}, 0.05)
        asking = threading.Thread(target=lambda: stack.enter_context(Question(path, {"do": "stop"}, 60.0)))
        asking.start()
        stack.enter_context(listening.accept()[0])
        second = stack.enter_context(listening.accept()[0])
        assert second.recv(100) == b'{"do": "stop"}\n'
        asking.join()


def test_a_line_without_an_end_is_refused(daemon):
    with socket.socket(socket.AF_UNIX) as client, client.makefile("rb") as file:
        client.connect(str(daemon.path))
        client.sendall(b"x" * LONGEST_LINE)
        assert "within 1048576 bytes" in json.loads(file.readline())["problems"][0]
        assert file.readline() == b""


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"\xff\n", "a request is one JSON object a line"),
        (b"[1]\n", "a request is a JSON object"),
        (b"[" * 100_000, "a request is one JSON object a line"),
        (b'{"do": "stauts"}', "nothing is called 'stauts'; did you mean 'status'?"),
        (b'{"do": 7}', "nothing is called 7"),
        (b'{"do": "set"}', "values: is missing"),
        (b'{"do": "stop", "now": true}', "now: is not a key here; there are: do"),
    ],
)
def test_what_is_no_request_is_answered_with_what_would_be_one(line, message):
    with pytest.raises(FrictionHilError) as caught:
        _request(line)
    assert message in str(caught.value)


def test_a_name_that_nobody_has_lists_those_that_run(daemon):
    with pytest.raises(UsageError, match="no daemon called 'ehco' runs here; did you mean 'echo'"):
        find("ehco")
