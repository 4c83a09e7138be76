"""The control socket: names, lock, permissions, protocol."""

import contextlib
import grp
import json
import os
import socket
import stat
import threading
from pathlib import Path

import pytest

from friction_hil.daemon.control import lock
from friction_hil.daemon.control.ask import Question, ask
from friction_hil.daemon.control.desk import _request
from friction_hil.daemon.control.lock import ControlSocket, control_socket
from friction_hil.daemon.control.names import default_name, find, is_live, running, socket_path
from friction_hil.daemon.control.server import LONGEST_LINE, MOST_CLIENTS, ControlServer, Places
from friction_hil.errors import FrictionHilError, UsageError


@pytest.fixture
def folder(tmp_path_factory, monkeypatch):
    """A folder of this test for sockets, with a short path."""
    found = tmp_path_factory.mktemp("s")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(found))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    return found / "friction-hil"


@contextlib.contextmanager
def served(name, answer):
    """A daemon of this name that answers by a function."""
    opened = ControlSocket(name)
    with ControlServer(opened.descriptor, lambda: answer) as server:
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        yield opened
        server.shutdown()
    opened.close()


@pytest.fixture
def daemon(folder):
    """A daemon that answers with what it was asked."""
    with served("echo", lambda line, user: {"ok": True, "user": user, "asked": line.decode()}) as opened:
        yield opened


@contextlib.contextmanager
def asking(path, count=1):
    """So many clients with their files; they hang up in the end."""
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(socket.socket(socket.AF_UNIX)) for _ in range(count)]
        for each in clients:
            each.connect(str(path))
        yield [(each, stack.enter_context(each.makefile("rb"))) for each in clients]


@pytest.mark.parametrize(
    ("path", "name"), [("config/two_axes.yaml", "two_axes"), ("Prüfstand 1.yaml", "Pr-fstand-1"), (".yaml", "yaml")]
)
def test_the_name_of_a_daemon_is_that_of_its_configuration(path, name):
    assert default_name(Path(path)) == name


def test_a_path_that_no_socket_can_have_is_answered_by_a_message(folder, monkeypatch, tmp_path):
    assert socket_path("mill.2") == folder / "mill.2.sock"
    for wrong in ("", "../x", "a/b", ".hidden", "a b", "x\n"):
        with pytest.raises(UsageError, match="name"):
            socket_path(wrong)
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/" + "d" * 79)
    assert len(str(socket_path("x" * 8))) == 107
    with pytest.raises(UsageError, match="1 bytes longer than the 107 bytes"):
        ControlSocket("x" * 9)
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))  # that systemd made for a service
    assert socket_path("mill") == tmp_path / "mill.sock"


def test_a_second_daemon_of_a_name_is_refused_and_the_first_stays(folder):
    first = ControlSocket("mill")
    with pytest.raises(UsageError, match=rf"'mill' .* \(process {os.getpid()}\); --name "):
        ControlSocket("mill")
    assert is_live(first.path)
    second = control_socket("mill", None, is_next_taken=True)
    assert {name for name, _ in running() if name.startswith("mill")} == {"mill", "mill-2"}
    first.close()
    second.close()
    assert not list(folder.glob("*.sock"))
    ControlSocket("mill").close()


@pytest.mark.parametrize("is_served", [False, True])
def test_the_socket_of_a_killed_daemon_is_replaced_and_one_that_somebody_serves_never(folder, monkeypatch, is_served):
    """In a container that shares the folder, the lock is not seen."""
    path = folder / "mill.sock"
    folder.mkdir()
    monkeypatch.setattr(lock, "_ORPHAN_S", 0.0)
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(path))
        if is_served:
            other.listen()
            inode = path.stat().st_ino
            with pytest.raises(UsageError, match="'mill' runs already"):
                ControlSocket("mill")
            assert path.stat().st_ino == inode
            return
    assert path.exists()
    assert "mill" not in dict(running())
    opened = ControlSocket("mill")
    assert is_live(opened.path)
    opened.close()


def test_only_the_user_may_use_the_socket_and_the_group_if_one_is_given(folder):
    alone = ControlSocket("alone")
    assert stat.S_IMODE(alone.path.stat().st_mode) == 0o600
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    alone.close()
    with pytest.raises(UsageError, match="--group nobody-here"):
        ControlSocket("shared", "nobody-here")
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
    with asking(daemon.path) as [(client, file)]:
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
    with contextlib.suppress(TimeoutError, BrokenPipeError):
        while client.send(b"x" * 60_000 + b"\n"):
            pass


@pytest.fixture
def crowd(daemon):
    """A function that lets more clients than there are places do something, and stay."""
    with contextlib.ExitStack() as stack:

        def come(do):
            clients = [client for client, _ in stack.enter_context(asking(daemon.path, MOST_CLIENTS + 8))]
            for each in clients:
                do(each)
            return clients

        yield come


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
    def say(client, file):
        client.sendall(b"here\n")
        assert json.loads(file.readline())["asked"] == "here\n"

    with asking(daemon.path, MOST_CLIENTS) as clients:
        for k in (*range(MOST_CLIENTS), 0, *range(2, MOST_CLIENTS)):
            say(*clients[k])
        with asking(daemon.path) as [last]:
            assert "silent for the longest time" in json.loads(clients[1][1].readline())["problems"][0]
            assert clients[1][1].readline() == b""
            for each in (clients[0], *clients[2:], last):
                say(*each)


def test_who_comes_while_all_are_being_answered_waits_for_a_place(folder):
    begun, goes_on = threading.Semaphore(0), threading.Event()

    def answer(line, user):
        begun.release()
        if line != b"stop\n":
            goes_on.wait()
        return {"ok": True}

    with served("slow", answer) as opened, asking(opened.path, MOST_CLIENTS) as first:
        for client, _ in first:
            client.sendall(b"slow\n")
            begun.acquire()
        with asking(opened.path, 2) as late:
            for client, _ in late:
                client.sendall(b"stop\n")
            assert not begun.acquire(timeout=0.05)
            goes_on.set()
            assert all(json.loads(file.readline())["ok"] for _, file in (*first, *late))


def test_an_answer_is_sent_before_its_place_can_be_given_to_another_client(folder, monkeypatch):
    """Else whoever asks for a stop may be told that it was silent for the longest time, though it was carried out."""
    end_answer = Places.end_answer

    def robbed(places, connection):
        end_answer(places, connection)
        with places._changed:
            places._hang_up(connection)

    monkeypatch.setattr(Places, "end_answer", robbed)
    with served("quick", lambda line, user: {"ok": True}) as opened:
        assert ask(opened.path, {"do": "stop"})["ok"]


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
    with asking(daemon.path) as [(client, file)]:
        client.sendall(b"x" * LONGEST_LINE)
        assert "1048576 bytes" in json.loads(file.readline())["problems"][0]
        assert file.readline() == b""


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"\xff\n", "one JSON object a line"),
        (b"[1]\n", "is a JSON object"),
        (b"[" * 100_000, "one JSON object a line"),
        (b'{"do": "stauts"}', "'stauts'; did you mean 'status'"),
        (b'{"do": 7}', "nothing is called 7"),
        (b'{"do": "set"}', "values: "),
        (b'{"do": "stop", "now": true}', "now: .*: do$"),
    ],
)
def test_what_is_no_request_is_answered_with_what_would_be_one(line, message):
    with pytest.raises(FrictionHilError, match=message):
        _request(line)


def test_a_name_that_nobody_has_lists_those_that_run(daemon):
    with pytest.raises(UsageError, match=r"'ehco' .*'echo'"):
        find("ehco")
