"""The server of live data without a real daemon, and what learning does as everybody sees it."""

import contextlib
import http.client
import json
import os
import socket
import struct
import threading
import time
from dataclasses import asdict

import pytest
from prometheus_client.parser import text_string_to_metric_families

from friction_hil.cli import main
from friction_hil.cli.output import to_json
from friction_hil.cli.work import live
from friction_hil.cli.work.control import _lines
from friction_hil.cli.work.monitor_screen import brief_line, screen
from friction_hil.daemon import learning_service, learning_words
from friction_hil.daemon.control.ask import ask
from friction_hil.daemon.control.message import TEXT_BYTES
from friction_hil.daemon.control.names import find
from friction_hil.daemon.learning_board import STARTING, LearningBoard, first_report
from friction_hil.daemon.learning_service import LearningService
from friction_hil.learning.proposal import Proposal, Step, described, fitting
from friction_hil.live import LiveFigures, attach
from friction_hil.live.values import values_of
from friction_hil.live.web import app, hub
from friction_hil.live.web import serve as serving
from friction_hil.live.web.feed import Feed
from friction_hil.live.web.metrics import metrics_text
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


LEARNED = {
    **{"mode": "on", "unit": "rad", "doing": "resting", "reason": "no further change within 12 s of motion"},
    "last": "learning takes back: error 1.90 mrad -> 1.89 mrad: no gain",
    **{"re_identified": 3, "taken_back": 1, "stopped": 0, "gain": 0.97, "error_before": 5.1e-3, "error_after": 1.9e-3},
    **{"in_use": {"coulomb": 0.07, "sigma2": 2e-3}, "parameters": {"coulomb": 0.08, "sigma2": 2.01e-3}},
    **{"relative_errors": {"coulomb": 0.012, "sigma2": 0.2}, "proposed": None, "residual_layer": {"state": ""}},
    "family": {"of_file": "lugre", "in_use": "lugre", "state": "none explains more", "tried": 0},
}
SUMMARY = (
    "on: resting (no further change within 12 s of motion); re-identified 3 times, error 5.10 mrad -> 1.90 mrad, "
    "1 taken back; gain 0.97"
)
PARAMETERS = "coulomb 0.07 (estimate 0.08 ±1.2 %), sigma2 0.002 ±20 %"


@pytest.fixture
def daemon(folder):  # noqa: F811
    found = Daemon()
    found.serve()
    yield found
    found.end()


def shown_after(daemon, report):
    """What is known of the daemon once its learning has reported this."""
    daemon.board.say(250, {"axes": {"x": report}, "cpu_share": 0.01})
    with attach("mill") as live:
        daemon.push(3, time_s=1.0, change=0.0, state=3.0)
        figures = LiveFigures(live.facts)
        figures.take(live.read())
    return figures.snapshot()


def test_the_status_the_monitor_the_page_and_the_metrics_have_it(daemon):
    assert ask(find("mill"), {"do": "status"})["axes"]["x"]["learning"] is None
    shown = shown_after(daemon, LEARNED)
    lines = [line.strip() for line in _lines("mill", ask(find("mill"), {"do": "status"}))]
    assert [f"learning {SUMMARY}", PARAMETERS, f"last: {LEARNED['last']}"] == lines[-4:-1]
    assert json.loads(json.dumps(to_json(asdict(shown))))["axes"]["x"]["learning"] == LEARNED
    assert f"learning {SUMMARY}" in brief_line(shown)
    text = " ".join(line.strip() for line in screen(shown, 200, 30, 0, is_coloured=False, is_live=False))
    assert f"x learning {SUMMARY} {PARAMETERS}" in text
    page = dict(values_of(shown.axes["x"]))
    assert [page["Learning"], page["Parameters with standard errors"]] == [SUMMARY, PARAMETERS]
    families = {each.name: each for each in text_string_to_metric_families(metrics_text("mill", shown, {}))}
    samples = {
        (each.name.removeprefix("friction_hil_"), *list(each.labels.values())[2:]): each.value
        for family in families.values()
        for each in family.samples
        if each.labels.get("axis") == "x"
    }
    expected = {
        ("learned_parameter", "lugre", "coulomb"): 0.08,
        ("learned_parameter_error_ratio", "lugre", "sigma2"): 0.2,
        ("learning_state", "resting"): 1.0,
        ("learning_state", "trying"): 0.0,
        ("learning_error_rms_radians", "file"): 5.1e-3,
        ("learning_error_rms_radians", "kept"): 1.9e-3,
        ("learning_kept_total",): 3.0,
        ("learning_taken_back_total",): 1.0,
    }
    assert {name: samples[name] for name in expected} == expected
    assert {families[f"friction_hil_learning_{each}"].type for each in ("kept", "stopped")} == {"counter"}


def test_a_learning_that_has_ended_claims_no_parameters(daemon):
    ended = {**LEARNED, "doing": "ended", "reason": "the settings were changed by somebody else"}
    shown = shown_after(daemon, ended)
    assert "learned_parameter" not in metrics_text("mill", shown, {})
    assert learning_words.parameters(ended) == ""
    assert f"ended ({ended['reason']})" in brief_line(shown)


@pytest.fixture
def board():
    made = LearningBoard()
    yield made
    made.close()


def test_who_looks_cannot_write(board):
    looking = os.open(f"/proc/self/fd/{board.descriptor}", os.O_RDONLY)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.pwrite(looking, b"x", 0)
    os.close(looking)


def test_nobody_reads_half_of_a_report(board):
    texts, is_over, seen = ["a" * 100, "b" * 30000], threading.Event(), []

    def look():
        while not is_over.is_set():
            seen.append(board.report().get("text"))

    reader = threading.Thread(target=look)
    reader.start()
    for number in range(300):
        board.say(number, {"text": texts[number % 2]})
    is_over.set()
    reader.join()
    assert set(seen) <= {*texts, None}
    assert board.done_cycle == 299
    # a process that died while it wrote: nothing is read until the next one writes
    os.pwrite(board.descriptor, struct.pack("<q", 601), 0)
    assert board.report() == {}
    board.say(300, {"text": "whole"})
    assert (board.report(), board.done_cycle) == ({"text": "whole"}, 300)


def test_an_axis_whose_process_has_said_nothing_yet_is_shown_as_starting():
    words = {mode: learning_words.summary(first_report(mode, "m", 0.9)) for mode in ("on", "propose")}
    assert words["on"] == f"on: waiting ({STARTING}); re-identified 0 times; gain 0.9"
    assert words["propose"] == f"propose: waiting ({STARTING}); learning would try nothing; gain 0.9"
    assert learning_words.parameters(first_report("on", "m", 0.9)) == ""


def test_an_axis_that_only_proposes_says_what_it_would_do():
    words = "learning would try coulomb +14 %: torque changes by 9.3 % of the friction level, gain 0.90 -> 0.97"
    proposing = {**LEARNED, "mode": "propose", "doing": "watching", "reason": "", "gain": 0.9}
    assert learning_words.result(proposing) == "learning would try nothing"
    proposing["proposed"] = {"parameters": LEARNED["parameters"], "gain": 0.97, "text": words}
    assert learning_words.result(proposing) == words


def test_a_process_that_is_not_started_any_more_is_not_shown_as_learning(board):
    board.say(250, {"axes": {"x": LEARNED}, "cpu_share": 0.01})
    LearningService(board, 1e-3, is_simulated=False).give_up()
    found = board.report()["axes"]["x"]
    assert (found["doing"], found["reason"], found["re_identified"]) == ("ended", "its process died", 3)
    assert board.done_cycle == 250


def test_simulated_time_does_not_wait_for_ever_for_a_process_that_hangs(board, monkeypatch):
    monkeypatch.setattr(learning_service, "_PATIENCE_S", 0.05)
    service = LearningService(board, 1e-3, is_simulated=True)
    first, second = (service.await_tick(cycle, lambda: False, lambda: None) for cycle in (249, 499))
    assert ("nothing for 0.05 s" in first, second) == (True, "")


def test_a_notice_names_as_many_parameters_as_it_has_room_for_and_never_loses_the_gain():
    proposal = Proposal(Step.PARAMETERS, None, 0.97, "torque changes by 8.3 % of the friction level, gain 0.90 -> 0.97")
    before = {f"direction.{side}.{name}": 1.0 for side in ("positive", "negative") for name in ("coulomb", "static")}
    after = dict(zip(before, (1.2, 0.7, 1.001, 1.1), strict=True))
    text = described(proposal, before, after, "x", is_tried=True)
    whole = "learning tries direction.positive.static -30 %, direction.positive.coulomb +20 %, 1 more: "
    assert text == whole + proposal.text
    text = described(proposal, before, after, "a_long_name_of_an_axis", is_tried=False)
    assert text == f"learning would try direction.positive.static -30 %, 2 more: {proposal.text}"
    assert described(proposal, before, before, "x", is_tried=True) == f"learning tries {proposal.text}"
    kept = [f"{axis}: learning keeps the gain: error 1.23 mrad -> 1.11 mrad" for axis in ("y", "z")]
    texts = [f"x: {text}", *kept]
    assert [fitting(texts), fitting(texts), texts] == [f"x: {text}", "; ".join(kept), []]
    assert len("; ".join(kept).encode()) <= TEXT_BYTES < len("; ".join([text, kept[0]]).encode())
