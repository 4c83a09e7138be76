"""Who may ask what of the page's server and of the Foxglove WebSocket, and where the token comes from."""

import os
import socket
import string
import threading

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from friction_hil.errors import UsageError
from friction_hil.live.web.door import Door
from friction_hil.live.web.foxglove_feed import FoxgloveFeed
from friction_hil.live.web.gate import Gate, host_name, is_loopback
from friction_hil.live.web.token import new_token, token_of

TOKEN = new_token()
LOCAL = Gate(TOKEN, frozenset({"mill.example"}), is_reading_free=True)
OPEN = Gate(TOKEN, frozenset(), is_reading_free=False)
CHANGE = {"host": "127.0.0.1:8080", "authorization": f"Bearer {TOKEN}"}
CHANGE |= {"content-type": "application/json", "content-length": "2"}


def refusal(gate, method, path, headers):
    found = gate.refusal(method, path, [(key.encode(), value.encode("latin-1")) for key, value in headers.items()])
    return None if found is None else found.status


@pytest.mark.parametrize(
    "host", ["localhost", "127.0.0.1:8080", "[::1]:8080", "[::1]", "MILL.example:1", "192.168.7.9"]
)
def test_addresses_and_names_that_were_allowed_are_served(host):
    assert refusal(LOCAL, "GET", "/api/stream", {"host": host}) is None
    assert refusal(LOCAL, "POST", "/api/set", CHANGE | {"host": host, "origin": f"http://{host}"}) is None


@given(st.text(string.ascii_letters + string.digits + ".-:[]@/\\ \xe9\0", max_size=40))
@example("evil:1:80")
def test_no_other_name_is_served(host):
    known = host_name(host)
    is_known = known in ("localhost", "mill.example") or (known is not None and known.replace(".", "").isdigit())
    if not is_known and ":" not in (known or ""):
        assert refusal(LOCAL, "GET", "/", {"host": host}) == 403


@given(st.text(max_size=60), st.sampled_from(["Bearer ", "bearer ", "Basic ", ""]))
def test_only_the_token_lets_something_be_changed(text, kind):
    given_token = {"authorization": (kind + text).encode("utf-8").decode("latin-1")}
    assert refusal(LOCAL, "POST", "/api/stop", CHANGE | given_token) == 401
    assert refusal(OPEN, "GET", "/metrics", CHANGE | given_token) == 401


def test_beyond_loopback_data_need_the_token_and_the_page_itself_does_not():
    assert refusal(OPEN, "GET", "/", {"host": "10.0.0.7:8080"}) is None
    for path in ("/api/stream", "/metrics"):
        assert refusal(OPEN, "GET", path, {"host": "10.0.0.7:8080"}) == 401
        assert refusal(OPEN, "GET", path, {"host": "10.0.0.7:8080", "authorization": f"Bearer {TOKEN}"}) is None
    assert [is_loopback(each) for each in ("localhost", "127.0.0.1", "127.9.9.9", "::1")] == [True] * 4
    assert [is_loopback(each) for each in ("0.0.0.0", "::", "", "10.0.0.7", "mill")] == [False] * 5


@pytest.mark.parametrize("method", ["PUT", "DELETE", "OPTIONS", "PATCH", "CONNECT", "TRACE"])
def test_nothing_but_reading_and_post_and_no_header_twice(method):
    assert refusal(LOCAL, method, "/api/set", CHANGE) == 405
    assert LOCAL.refusal("GET", "/", [(b"host", b"127.0.0.1"), (b"host", b"evil.example")]).status == 400


def test_a_token_file_is_made_once_for_this_user_alone_and_refused_where_others_read_it(tmp_path):
    path = tmp_path / "token"
    token = token_of(path)
    assert (path.stat().st_mode & 0o777, token_of(path), len(token) >= 32) == (0o600, token, True)
    path.chmod(0o640)
    with pytest.raises(UsageError, match=r"others may use it \(mode 640\); chmod 600"):
        token_of(path)
    path.chmod(0o600)
    for text in ("short", "two words of enough length", "x" * 600, ""):
        path.write_text(text)
        with pytest.raises(UsageError, match="16 to 512 characters"):
            token_of(path)
    with pytest.raises(UsageError, match="directory"):
        token_of(tmp_path)
    with pytest.raises(UsageError, match=os.strerror(2)):
        token_of(tmp_path / "no" / "folder")


@pytest.fixture(scope="module")
def feed():
    made = FoxgloveFeed(0, ("Mill", "app.foxglove.dev"))
    yield made
    made.close()


def greeting(port, host=None, origin=None):
    """The first message of the protocol, or the status of the refusal."""
    headers = [] if origin is None else [("Origin", origin)]
    given = {"subprotocols": ["foxglove.sdk.v1"], "additional_headers": headers, "close_timeout": 0.1}
    at = socket.create_connection(("127.0.0.1", port))
    try:
        with connect(f"ws://{host or f'localhost:{port}'}/", sock=at, **given) as client:
            return client.recv()
    except InvalidStatus as error:
        return error.response.status_code


@pytest.mark.parametrize("host", [None, "127.0.0.1", "[::1]", "mill", "MILL."])
@pytest.mark.parametrize("origin", [None, "file://", "app://foxglove", "https://app.foxglove.dev"])
def test_programs_and_allowed_pages_are_let_in(feed, host, origin):
    assert "serverInfo" in greeting(feed.port, host and f"{host}:{feed.port}", origin)


EVIL = [
    "http://evil.example",
    "https://evil.example",
    "null",
    "http://localhost",
    "http://app.foxglove.dev.evil.example",
]


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        *((None, origin) for origin in (*EVIL, "")),
        *((host, None) for host in ("evil.example", "mill.evil.example", "localhost.evil.example")),
    ],
)
def test_pages_of_other_origins_and_names_that_somebody_else_resolves_are_refused(feed, host, origin):
    assert greeting(feed.port, host and f"{host}:{feed.port}", origin) == 403


def test_the_library_listens_where_nobody_knows(feed):
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", feed._server.port), timeout=5.0)


def test_a_port_that_is_in_use_is_named():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UsageError, match=f" 127.0.0.1:{port}: Address already in use"):
            FoxgloveFeed(port)


@pytest.fixture(scope="module")
def echo():
    """A door to a server that sends everything back."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve():
            while True:
                try:
                    client, _ = listening.accept()
                except OSError:
                    return
                with client:
                    while part := client.recv(1 << 16):
                        client.sendall(part)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        door = Door("127.0.0.1", 0, listening.getsockname(), Gate("", (), is_reading_free=True))
        yield door.port
        door.close()
        listening.shutdown(socket.SHUT_RDWR)
        thread.join(10.0)


def answered(port, data):
    with socket.create_connection(("127.0.0.1", port), timeout=10.0) as client:
        client.sendall(data)
        client.shutdown(socket.SHUT_WR)
        with client.makefile("rb") as file:
            return file.read()


@settings(max_examples=40, deadline=None)
@given(st.binary(max_size=60), st.sampled_from([b"", b"GET / HTTP/1.1\r\n", b"GET / HTTP/1.1\r\nOrigin: http://a\r\n"]))
def test_nothing_without_a_proper_host_gets_through(echo, noise, start):
    found = answered(echo, start + noise.replace(b":", b"") + b"\r\n\r\n")
    assert found == b"" or found.startswith(b"HTTP/1.1 4")


@pytest.mark.parametrize("size", [0, 1, 100_000])
def test_what_comes_after_the_head_is_passed_on_as_it_is(echo, size):
    data = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n" + bytes(range(256)) * (size // 256)
    with socket.create_connection(("127.0.0.1", echo), timeout=10.0) as client, client.makefile("rb") as file:
        client.sendall(data)
        assert file.read(len(data)) == data


@pytest.mark.parametrize(
    "head",
    [
        b"Host: localhost\r\nHost: evil.example",
        b"Host: localhost\r\nOrigin: http://localhost\r\nOrigin: http://evil.example",
        b" Host: localhost",
        b"Host : localhost",
    ],
)
def test_headers_that_could_be_read_in_two_ways_are_refused(echo, head):
    assert answered(echo, b"GET / HTTP/1.1\r\n" + head + b"\r\n\r\n").startswith(b"HTTP/1.1 4")


def test_a_door_through_which_nobody_went_closes_in_order(monkeypatch):
    failures = []
    monkeypatch.setattr(threading, "excepthook", failures.append)
    door = Door("127.0.0.1", 0, ("127.0.0.1", 1), Gate("", (), is_reading_free=True))
    door.close()
    assert failures == []
    assert door._loop.is_closed()
