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

pytestmark = pytest.mark.usefixtures("folder")
TOKEN = "a-token-of-this-test-0123456789"


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return taken.getsockname()[1]


def serve_while(work, host="127.0.0.1"):
    """Serve the page until a thread has done something at its port; return what the server said."""
    port, ending, said, failures = free_port(), threading.Event(), [], []

    def run():
        try:
            until(lambda: asked(port, "/"))
            work(port)
        except BaseException as error:  # noqa: BLE001
            failures.append(error)
        finally:
            ending.set()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        serve(Serving("mill", port, None, host, (), TOKEN), ending, said.append)
    finally:
        ending.set()
        thread.join()
    if failures:
        raise failures[0]
    return said


def connected(stack, port, sent, buffer=4096):
    """A client that has sent something and reads nothing."""
    client = stack.enter_context(socket.socket())
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
    client.connect(("127.0.0.1", port))
    with contextlib.suppress(ConnectionError):
        client.sendall(sent.encode())
    return client


def until(condition, timeout_s=20.0):
    end_s = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < end_s
        time.sleep(0.02)
    return value


def asked(port, path, method="GET", content=None):
    """Status and text of an answer; None while there is none."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"} if method == "POST" else {}
    try:
        connection.request(method, path, None if content is None else json.dumps(content), headers)
        answer = connection.getresponse()
        return answer.status, answer.read().decode()
    except OSError:
        return None
    finally:
        connection.close()


def test_a_server_whose_reader_fails_ends_and_does_not_show_old_values_as_live():
    daemon = Daemon()
    daemon.serve()
    daemon.push(1, state=99.0)  # of a version that is not known yet
    try:
        with pytest.raises(ValueError, match="99 is not a valid LoopState"):
            serve_while(lambda port: time.sleep(60.0))
    finally:
        daemon.end()


def test_clients_that_ask_for_nothing_keep_nobody_out(monkeypatch):
    monkeypatch.setattr(serving, "_MOST_HEAD_S", 0.3)

    def work(port):
        with contextlib.ExitStack() as stack:
            idle = [connected(stack, port, sent) for sent in ("GET / HTTP/1.1\r\nHost: ", *[""] * 79)]
            for each in idle:
                each.settimeout(10.0)
                with contextlib.suppress(ConnectionResetError):
                    assert each.recv(1) == b""
            assert asked(port, "/")[0] == 200

    serve_while(work)


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
def test_a_stop_has_a_place_whatever_others_do_with_theirs(sent):
    def work(port):
        with contextlib.ExitStack() as stack:
            for _ in range(serving._MOST_CONNECTIONS + 8):
                connected(stack, port, sent)
            for _ in range(3):
                status, text = asked(port, "/api/stop", "POST", {})
                assert (status, "no daemon called 'mill'" in text) == (409, True)

    serve_while(work)


@pytest.mark.parametrize("buffer", [2304, 131_072])
def test_pages_that_read_nothing_give_their_places_to_others(monkeypatch, buffer):
    """All places are taken by clients that read nothing of an endless stream; the times are shortened."""
    monkeypatch.setattr(app, "_MOST_SEND_S", 0.2)
    monkeypatch.setattr(hub, "_ALIVE_S", 0.02)
    monkeypatch.setattr(hub, "_ALIVE", b" " * 20_000 + b"\n")
    request = "GET /api/stream HTTP/1.1\r\nHost: localhost\r\n\r\n"

    def streamed(port):
        with contextlib.ExitStack() as stack:
            client = connected(stack, port, request)
            client.settimeout(20.0)
            return int(client.recv(100).split()[1])

    def work(port):
        with contextlib.ExitStack() as stack:
            for _ in range(hub._MOST_CLIENTS):
                connected(stack, port, request, buffer)
            until(lambda: streamed(port) == 200, timeout_s=60.0)

    serve_while(work)


def test_a_page_beyond_loopback_is_read_with_the_token_only_and_says_how_it_is_reached():
    def work(port):
        ports.append(port)
        assert [asked(port, path)[0] for path in ("/api/stream", "/metrics", "/")] == [401, 401, 200]
        assert asked(port, "/api/set", "POST", {"values": {"x.model": "/etc/hostname"}})[0] == 409

    ports = []
    page, reached, waiting = serve_while(work, "0.0.0.0")
    assert page == f"page: http://{socket.gethostname()}:{ports[0]}/#token={TOKEN}"
    assert "from other machines" in reached
    assert waiting == "waiting for mill"


def test_a_page_names_model_files_beside_the_configuration_and_nothing_else():
    ending, said = threading.Event(), []
    feed = Feed("mill", None, said.append)
    (problem,) = feed.act("set", {"values": {"x.model": "/etc/hostname"}})["problems"]
    assert "no daemon called 'mill'" in problem
    daemon = Daemon()
    daemon.serve()
    thread = threading.Thread(target=feed.run, args=(ending,))
    thread.start()
    try:
        until(lambda: any("attached to mill" in line for line in said))
        for value in ("/etc/hostname", ["a"], {"friction": {}}, None):
            answer = feed.act("set", {"values": {"x.model": value}})
            assert (answer["ok"], "no model file" in answer["problems"][0]) == (False, True)
    finally:
        ending.set()
        thread.join()
        daemon.end()


def test_a_port_that_is_in_use_and_extras_that_are_missing_are_named_with_what_to_do(capsys, monkeypatch):
    def refused(*words):
        assert main(["live", *words]) == 2
        return capsys.readouterr().err

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        said = refused("mill", "--port", port)
        assert f" 127.0.0.1:{port}: Address already in use; take another --port" in said
        assert "take another port with --foxglove" in refused("mill", "--foxglove", port)
    assert " nowhere.invalid:8080" in refused("mill", "--host", "nowhere.invalid")
    assert refused("../mill")
    monkeypatch.setattr(live, "find_spec", lambda name: None if name in ("uvicorn", "foxglove") else name)
    assert "uvicorn: pip install 'friction-hil[dashboard]'" in refused("mill")
    assert "foxglove: pip install 'friction-hil[live]'" in refused("mill", "--foxglove", "0")


def test_the_token_of_a_file_is_not_printed_and_that_of_a_descriptor_is(tmp_path, capfd, monkeypatch):
    file = tmp_path / "token"
    file.write_text(TOKEN)
    file.chmod(0o600)
    monkeypatch.setattr(serving, "serve", lambda given, ending, report: report(str(given.token_file)))
    with open(file, encoding="ascii") as opened:
        for path in (str(file), f"/proc/self/fd/{opened.fileno()}"):
            assert main(["live", "mill", "--port", "0", "--token-file", path]) == 0
    assert capfd.readouterr().out.splitlines() == [str(file), "None"]
