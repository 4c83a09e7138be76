"""The server of live data without a real daemon: what it does with failures, idle clients and wrong addresses."""

import contextlib
import http.client
import json
import socket
import threading
import time

import pytest

from friction_hil.cli import main
from friction_hil.cli.work import live
from friction_hil.live.web import app, hub
from friction_hil.live.web import serve as serving
from friction_hil.live.web.feed import Feed
from friction_hil.live.web.serve import Serving, serve
from tests.unit.live.test_live import Daemon, folder  # noqa: F401  a fixture

TOKEN = "a-token-of-this-test-0123456789"


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return taken.getsockname()[1]


@contextlib.contextmanager
def beside(work, ending):
    """Do something in a thread while this one serves; then the server ends."""
    failures = []

    def run():
        try:
            work()
        except BaseException as error:  # noqa: BLE001
            failures.append(error)
        finally:
            ending.set()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()
    if failures:
        raise failures[0]


def until(condition, timeout_s=20.0):
    end_s = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < end_s
        time.sleep(0.02)
    return value


def asked(port, path, method="GET", content=None, host="127.0.0.1"):
    """Status and text of an answer; None while there is none."""
    connection = http.client.HTTPConnection(host, port, timeout=10)
    headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"}
    try:
        connection.request(
            method, path, None if content is None else json.dumps(content), headers if method == "POST" else {}
        )
        answer = connection.getresponse()
        return answer.status, answer.read().decode()
    except OSError:
        return None
    finally:
        connection.close()


def test_a_server_whose_reader_fails_ends_and_does_not_show_old_values_as_live(folder):  # noqa: F811
    daemon = Daemon()
    daemon.serve()
    daemon.push(1, state=99.0)  # of a version that is not known yet
    try:
        with pytest.raises(ValueError, match="99 is not a valid LoopState"):
            serve(Serving("mill", free_port(), None, "127.0.0.1", (), TOKEN), threading.Event(), lambda line: None)
    finally:
        daemon.end()


def test_clients_that_ask_for_nothing_keep_nobody_out(folder, monkeypatch):  # noqa: F811
    monkeypatch.setattr(serving, "_MOST_HEAD_S", 0.3)
    port, ending = free_port(), threading.Event()

    def work():
        until(lambda: asked(port, "/"))
        with contextlib.ExitStack() as stack:
            idle = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(80)]
            idle[0].sendall(b"GET / HTTP/1.1\r\nHost: ")
            for each in idle:
                each.settimeout(10.0)
                with contextlib.suppress(ConnectionResetError):
                    assert each.recv(1) == b""
            assert asked(port, "/")[0] == 200

    with beside(work, ending):
        serve(Serving("mill", port, None, "127.0.0.1", (), TOKEN), ending, lambda line: None)


HEAD = f"Host: localhost\r\nAuthorization: Bearer {TOKEN}\r\nContent-Type: application/json\r\n"


@pytest.mark.parametrize(
    "sent",
    [
        "",
        "GET / HTTP/1.1\r\nHost: ",
        "GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",  # and stays
        f"POST /api/set HTTP/1.1\r\n{HEAD}Content-Length: 1000\r\n\r\n{{",  # and no more
        "GET /uPlot.iife.min.js HTTP/1.1\r\nHost: localhost\r\n\r\n" * 400,  # and reads nothing
    ],
    ids=["nothing", "half a head", "one request", "half a body", "no answer read"],
)
def test_a_stop_has_a_place_whatever_others_do_with_theirs(folder, sent):  # noqa: F811
    port, ending = free_port(), threading.Event()

    def work():
        until(lambda: asked(port, "/"))
        with contextlib.ExitStack() as stack:
            for _ in range(serving._MOST_CONNECTIONS + 8):
                client = stack.enter_context(socket.socket())
                client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                client.connect(("127.0.0.1", port))
                with contextlib.suppress(ConnectionError):
                    client.sendall(sent.encode())
            for _ in range(3):
                status, text = asked(port, "/api/stop", "POST", {})
                assert (status, "no daemon called 'mill' runs here" in text) == (409, True)

    with beside(work, ending):
        serve(Serving("mill", port, None, "127.0.0.1", (), TOKEN), ending, lambda line: None)


def streamed(port):
    """The status of the answer to a page that opens."""
    with socket.create_connection(("127.0.0.1", port), timeout=20.0) as client:
        client.sendall(b"GET /api/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
        return int(client.recv(100).split()[1])


@pytest.mark.parametrize("buffer", [2304, 131_072])
def test_pages_that_read_nothing_give_their_places_to_others(folder, monkeypatch, buffer):  # noqa: F811
    """All places are taken by clients that read nothing of an endless stream; the times are shortened."""
    monkeypatch.setattr(app, "_MOST_SEND_S", 0.2)
    monkeypatch.setattr(hub, "_ALIVE_S", 0.02)
    monkeypatch.setattr(hub, "_ALIVE", b" " * 20_000 + b"\n")
    port, ending = free_port(), threading.Event()

    def work():
        until(lambda: asked(port, "/"))
        with contextlib.ExitStack() as stack:
            for _ in range(hub._MOST_CLIENTS):
                client = stack.enter_context(socket.socket())
                client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
                client.connect(("127.0.0.1", port))
                client.sendall(b"GET /api/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
            until(lambda: streamed(port) == 200, timeout_s=60.0)

    with beside(work, ending):
        serve(Serving("mill", port, None, "127.0.0.1", (), TOKEN), ending, lambda line: None)


def test_a_page_beyond_loopback_is_read_with_the_token_only_and_says_how_it_is_reached(folder):  # noqa: F811
    port, ending, said = free_port(), threading.Event(), []

    def work():
        status, text = until(lambda: asked(port, "/api/stream"))
        assert (status, "this needs the token" in text) == (401, True)
        assert asked(port, "/metrics")[0] == 401
        assert asked(port, "/")[0] == 200
        assert asked(port, "/api/set", "POST", {"values": {"x.model": "/etc/hostname"}})[0] == 409

    with beside(work, ending):
        serve(Serving("mill", port, None, "0.0.0.0", (), TOKEN), ending, said.append)
    assert said[0] == f"page: http://{socket.gethostname()}:{port}/#token={TOKEN}"
    assert "can be reached from other machines" in said[1]
    assert said[2] == "waiting for mill"


def test_a_page_names_model_files_beside_the_configuration_and_nothing_else(folder, tmp_path):  # noqa: F811
    feed, ending, said = Feed("mill", None, lambda line: said.append(line)), threading.Event(), []
    values = {"values": {"x.model": "/etc/hostname"}}
    assert feed.act("set", values)["problems"] == ["no daemon called 'mill' runs here"]
    daemon = Daemon()
    daemon.serve()
    thread = threading.Thread(target=feed.run, args=(ending,))
    thread.start()
    try:
        until(lambda: any("attached to mill" in line for line in said))
        for value in ("/etc/hostname", ["a"], {"friction": {}}, None):
            answer = feed.act("set", {"values": {"x.model": value}})
            assert answer["ok"] is False
            assert "is no model file beside the configuration" in answer["problems"][0]
    finally:
        ending.set()
        thread.join()
        daemon.end()


def test_a_port_that_is_in_use_is_named_with_what_to_do(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert main(["live", "mill", "--port", port]) == 2
        assert f"the page cannot be served at 127.0.0.1:{port}: Address already in use; take another --port" in (
            capsys.readouterr().err
        )
        assert main(["live", "mill", "--foxglove", port]) == 2
        assert "take another port with --foxglove" in capsys.readouterr().err
    assert main(["live", "mill", "--host", "nowhere.invalid"]) == 2
    assert "the page cannot be served at nowhere.invalid:8080" in capsys.readouterr().err
    assert main(["live", "../mill"]) == 2


def test_extras_that_are_missing_are_named_with_the_command_that_brings_them(capsys, monkeypatch):
    monkeypatch.setattr(live, "find_spec", lambda name: None if name in ("uvicorn", "foxglove") else name)
    assert main(["live", "mill"]) == 2
    assert "the page needs uvicorn: pip install 'friction-hil[dashboard]'" in capsys.readouterr().err
    assert main(["live", "mill", "--foxglove", "0"]) == 2
    assert "the Foxglove WebSocket needs foxglove: pip install 'friction-hil[live]'" in capsys.readouterr().err


def test_the_token_of_a_file_is_not_printed_and_that_of_a_descriptor_is(folder, tmp_path, capfd, monkeypatch):  # noqa: F811
    file = tmp_path / "token"
    file.write_text(TOKEN)
    file.chmod(0o600)
    monkeypatch.setattr(serving, "serve", lambda given, ending, report: report(str(given.token_file)))
    with open(file, encoding="ascii") as opened:
        for path in (str(file), f"/proc/self/fd/{opened.fileno()}"):
            assert main(["live", "mill", "--port", "0", "--token-file", path]) == 0
    assert capfd.readouterr().out.splitlines() == [str(file), "None"]
