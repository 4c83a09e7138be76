"""Who may ask what of the page's server, and where its token comes from."""

import os
import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.errors import UsageError
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
