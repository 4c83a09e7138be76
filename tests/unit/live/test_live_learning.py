"""What learning does, as everybody sees it: status, monitor, page and metrics."""

import json
import os
import struct
import threading
from dataclasses import asdict

import pytest
from prometheus_client.parser import text_string_to_metric_families

from friction_hil.cli.output import to_json
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
from friction_hil.live.web.metrics import metrics_text
from tests.unit.live.test_live import Daemon, folder  # noqa: F401

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
