"""``friction-hil plot``: pictures and pages of recorded runs, their figures, and what is said about missing columns."""

import base64
import json
import re
import time
from pathlib import Path

import numpy as np
import pytest

from friction_hil import recordings
from friction_hil.analysis.following import SETTLE_S
from friction_hil.cli import main
from friction_hil.config import self_contained
from friction_hil.daemon.safety import LoopState
from friction_hil.recordings import columns
from friction_hil.recordings.mcap_writer import McapWriter
from friction_hil.reports.run.friction import friction_over_velocity
from friction_hil.reports.run.picture import comparison_text
from friction_hil.reports.run.view import make_view
from tests.browser import PROGRAM, browser
from tests.loop_run import BELIEVED, Run, axis, model
from tests.pages import Page

pytest.importorskip("matplotlib", reason="the extra 'report' is not installed")

BASELINE_S, DURATION_S, FADE_S, RAMP_S = 1.8, 4.2, 0.1, 0.25  # of motion; 1 Hz
COMPENSATION = {"fade_s": FADE_S, "baseline_s": BASELINE_S, "gain": 0.9}
LIMITS = {"torque": 0.6, "velocity": 30.0}
AXES = {
    mode: axis(mode, model=model(**BELIEVED), compensation=COMPENSATION, limits=LIMITS)
    for mode in ("csp", "csv", "cst")
}


def write(path: Path, run: Run, *, dropped: tuple[int, ...] = (), metadata: bool = True, **changes) -> Path:
    """The recording of a run; rows may be dropped, and columns changed, for all axes alike."""
    content = {"configuration": self_contained(run.config)} if metadata else {}
    writer = McapWriter(path, list(run.config.axes), columns.NAMES, metadata=content)
    table = {name: np.stack([run.column(column, name) for column in columns.NAMES], axis=1) for name in run.config.axes}
    for rows in table.values():
        for name, values in {"late_us": np.arange(len(rows)) % 50, **changes}.items():
            rows[:, columns.NAMES.index(name)] = values
    writer.write(np.delete(np.hstack(list(table.values())), dropped, axis=0))
    for event in run.sink.events:
        writer.write_event(*event)
    writer.close()
    return path


@pytest.fixture(scope="module")
def runs() -> dict[str, Run]:
    return {mode: Run(each, duration_s=DURATION_S) for mode, each in AXES.items()}


@pytest.fixture(scope="module")
def csp(runs, tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("csp") / "run.mcap", runs["csp"])


def plotted(capsys, *words: object) -> dict:
    assert main(["plot", *map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def is_picture(path: Path) -> bool:
    return path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" and path.stat().st_size > 50_000


def recomputed(path: Path, stop_s: float, is_enabled: float) -> tuple[float, float]:
    """RMS and peak of the whole period of 1 s before ``stop_s``, straight from the columns."""
    recording = recordings.read(path)
    rows = (recording["time_s"] > stop_s - 1.0 - 5e-4) & (recording["time_s"] < stop_s - 5e-4)
    assert np.all(recording["is_enabled"][rows] == is_enabled)
    assert np.count_nonzero(rows) == 1000
    error = (recording["position_demand"] - recording["position"])[rows]
    return float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error)))


@pytest.mark.deep
@pytest.mark.parametrize("mode", AXES)
def test_each_mode_has_its_picture_and_its_figures_are_those_of_the_columns(mode, runs, tmp_path, capsys):
    path = write(tmp_path / "run.mcap", runs[mode])
    found = plotted(capsys, path)
    assert found["files"] == [str(tmp_path / "run.png")]
    assert is_picture(tmp_path / "run.png")
    (facts,) = found["axes"].values()
    assert facts["panels"] == ["position", "velocity", "error", "torque", "timing", "friction"]
    assert facts["notes"] == []
    running = np.flatnonzero(runs[mode].column("state") == LoopState.RUNNING)
    start_s, end_s = running[0] * 1e-3, (running[-1] + 1) * 1e-3
    off_s = float(np.flatnonzero(runs[mode].column("is_enabled") == 1.0)[0]) * 1e-3
    assert off_s == pytest.approx(start_s + BASELINE_S, abs=2e-3)
    for name, stop_s, is_enabled in (("without", off_s, 0.0), ("with", end_s, 1.0)):
        figures = facts["following_error"][name]
        assert figures["from_s"] + 1.0 == pytest.approx(figures["to_s"])
        assert figures["to_s"] <= stop_s
        expected = recomputed(path, figures["to_s"], is_enabled)
        assert (figures["rms"], figures["peak"]) == pytest.approx(expected, rel=1e-9)
        assert figures["from_s"] >= (start_s + RAMP_S if is_enabled == 0.0 else off_s + FADE_S) + SETTLE_S - 1e-6
    assert facts["following_error"]["with"]["rms"] < facts["following_error"]["without"]["rms"]


def test_the_table_of_the_picture_holds_the_recomputed_numbers(csp, runs):
    view = make_view(recordings.read(csp), runs["csp"].config)
    before, after = (recomputed(csp, view.phases[k].intervals_s[-1][1], float(k)) for k in (0, 1))
    header, *lines = comparison_text(view).splitlines()
    assert header.split() == ["following", "error", "without", "with", "times", "lower"]
    factors = {"mrad": 1e3, "µrad": 1e6}
    for line, name, was, now in zip(lines, ("rms", "peak"), before, after, strict=True):
        found = re.fullmatch(rf"{name} +\[(\w+)\] +([\d.]+) +([\d.]+) +([\d.]+)", line)
        assert found, line
        unit, *numbers = found.groups()
        expected = [was * factors[unit], now * factors[unit], was / now]
        assert [float(each) for each in numbers] == pytest.approx(expected, rel=6e-3), line


@pytest.mark.deep
def test_the_same_recording_gives_the_same_bytes(csp, tmp_path, capsys):
    for suffix in ("svg", "html"):
        names = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
        for name in names:
            plotted(capsys, csp, "--from", 1.7, "--to", 2.1, "--output", name)
        assert names[0].read_bytes() == names[1].read_bytes(), suffix


def test_missed_periods_and_a_fault_are_marked(tmp_path, capsys):
    def pushed(cycle, feedback):
        if cycle == 2300:
            feedback[0].state, feedback[0].error = feedback[0].state.FAULT, "overcurrent"

    run = Run(AXES["csp"], duration_s=DURATION_S, disturb=pushed, faults=None)
    assert run.events("fault")
    path = write(tmp_path / "run.mcap", run, dropped=(700, 701, 702, 1200))
    facts = plotted(capsys, path)["axes"]["x"]
    assert facts["missed"] == 4
    (fault,) = (each for each in facts["events"] if each["name"] == "fault")
    assert fault["text"] == run.events("fault")[0]
    assert fault["time_s"] == pytest.approx(2.3, abs=5e-3)
    view = make_view(recordings.read(path), run.config)
    assert view.missed.tolist() == [3.0, 1.0]
    assert view.missed_s.tolist() == pytest.approx([0.703, 1.201])
    assert "4 periods missed" in view.facts
    assert "1 fault" in view.facts
    assert is_picture(tmp_path / "run.png")


def test_columns_of_nothing_but_nan_cost_their_panels_and_are_named(runs, tmp_path, capsys):
    unknown = dict.fromkeys(("torque", "late_us", "exchange_us", "path_lag_s"), np.nan)
    path = write(tmp_path / "run.mcap", runs["csp"], **unknown)
    facts = plotted(capsys, path)["axes"]["x"]
    assert facts["panels"] == ["position", "velocity", "error", "torque", "friction"]
    assert facts["notes"] == ["no timing of the loop: no column late_us"]
    path = write(tmp_path / "less.mcap", runs["csp"], position_demand=np.nan)
    facts = plotted(capsys, path)["axes"]["x"]
    assert facts["panels"] == ["position", "velocity", "torque", "timing", "friction"]
    assert facts["following_error"] == {"without": None, "with": None}
    assert any("no column position_demand" in note for note in facts["notes"])


@pytest.mark.deep
def test_the_weight_of_an_arm_is_not_drawn_as_friction(runs, csp, tmp_path):
    loaded = recordings.read(write(tmp_path / "run.mcap", runs["csp"], load_torque=2.0))
    config, notes = runs["csp"].config.axes["x"], []
    assert friction_over_velocity(recordings.read(csp), config, notes).measured is not None
    assert not notes
    assert friction_over_velocity(loaded, config, notes).measured is None
    assert "weight and inertia of the arm" in notes[0]


def test_a_recording_without_model_says_how_to_name_one(runs, csp, tmp_path, capsys):
    path = write(tmp_path / "bare.mcap", runs["csp"], metadata=False)
    facts = plotted(capsys, path)["axes"]["x"]
    assert [note for note in facts["notes"] if "--config" in note]
    assert facts["following_error"] == {"without": None, "with": None}
    assert is_picture(tmp_path / "bare.png")
    assert main(["convert", str(csp), str(tmp_path / "run.csv")]) == 0
    (tmp_path / "machine.yaml").write_text(json.dumps(self_contained(runs["csp"].config)))
    capsys.readouterr()
    again = plotted(capsys, tmp_path / "run.csv", "--config", tmp_path / "machine.yaml", "--output", tmp_path / "c.png")
    assert again["axes"]["run"]["following_error"] == plotted(capsys, csp)["axes"]["x"]["following_error"]


@pytest.mark.parametrize("content", [5, {"version": 1}, {"version": 1, "axes": {"x": {"driver": "no such driver"}}}])
def test_a_configuration_inside_that_cannot_be_used_is_reported(content, tmp_path, capsys):
    time = np.arange(50) * 1e-3
    writer = McapWriter(
        tmp_path / "r.mcap", ["x"], ("time_s", "cycle", "position"), metadata={"configuration": content}
    )
    writer.write(np.stack([time, np.arange(50.0), np.sin(time)], axis=1))
    writer.close()
    assert main(["plot", str(tmp_path / "r.mcap")]) == 0
    assert "x: the configuration inside cannot be used; name one with --config" in capsys.readouterr().err


def test_a_table_of_foreign_columns_has_what_they_allow(tmp_path, capsys):
    time = np.arange(500) * 1e-3
    lines = [f"{t:.3f},{np.sin(9 * t):.6f},{0.1 * np.cos(9 * t):.6f}" for t in time]
    (tmp_path / "bench.csv").write_text("\n".join(["t,angle,effort", *lines, ""]))
    words = ("--column", "time_s=t", "--column", "position=angle", "--column", "torque=effort")
    facts = plotted(capsys, tmp_path / "bench.csv", *words)["axes"]["bench"]
    assert facts["panels"] == ["position", "torque"]
    assert main(["plot", str(tmp_path / "bench.csv"), "--column", "time_s=t"]) == 1
    said = capsys.readouterr().err
    assert "nothing to draw" in said
    assert "angle, effort" in said


@pytest.mark.deep
def test_axes_get_a_picture_each_and_share_a_page(runs, tmp_path, capsys):
    run = Run(AXES["csp"], AXES["csp"] | {"node": 2}, duration_s=0.4)
    path = write(tmp_path / "run.mcap", run)
    assert plotted(capsys, path)["files"] == [str(tmp_path / "run_x.png"), str(tmp_path / "run_y.png")]
    assert plotted(capsys, path, "--axis", "y")["files"] == [str(tmp_path / "run.png")]
    plotted(capsys, path, "--output", tmp_path / "run.html")
    assert len(views(tmp_path / "run.html")) == 2


@pytest.mark.parametrize("suffix", ["png", "html"])
@pytest.mark.parametrize(
    "rows",
    [
        ["0,1,2"],
        ["0,1,2", "0,2,3", "0,3,4"],
        ["0,1,2", "0.001,2,3", "0.0005,3,4", "0.003,3,4"],
        ["0,0,0", "0.001,0,0", "0.002,0,0"],
        ["0,nan,inf", "0.001,-inf,2", "0.002,1,nan"],
    ],
    ids=["one row", "time stands still", "time goes back", "zeros", "not finite"],
)
def test_odd_tables_are_drawn(rows, suffix, tmp_path, capsys):
    path = tmp_path / "$odd_$name.csv"  # to matplotlib, what is between two of these is a formula
    path.write_text("\n".join(["time_s,position,torque", *rows, ""]))
    plotted(capsys, path, "--output", tmp_path / f"odd.{suffix}")


def test_a_value_that_no_picture_can_show_is_named(tmp_path, capsys):
    (tmp_path / "huge.csv").write_text("time_s,position,torque\n0,1,2\n0.001,-1e300,2\n0.002,1,2\n0.003,1,2\n")
    assert main(["plot", str(tmp_path / "huge.csv")]) == 1
    assert "position reaches 1e+300 at 0.001 s" in capsys.readouterr().err
    plotted(capsys, tmp_path / "huge.csv", "--from", "0.0015")
    assert main(["plot", str(tmp_path)]) == 2
    assert "no recording (.mcap) is in this folder" in capsys.readouterr().err


def views(path: Path) -> list:
    """The data that a page holds."""
    scripts = Page(path.read_text(encoding="utf-8")).scripts
    return [json.loads(text) for kind, text in scripts if kind == "application/json"]


def unpacked(text: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind)


def test_the_page_loads_nothing_and_holds_every_row(csp, tmp_path, capsys):
    plotted(capsys, csp, "--output", tmp_path / "run.html")
    page = Page((tmp_path / "run.html").read_text(encoding="utf-8"))
    assert page.sources == []
    metas = {given.get("http-equiv"): given.get("content") for tag, given in page.tags if tag == "meta"}
    assert "default-src 'none'" in metas["Content-Security-Policy"]
    assert [given.get("type", "") for tag, given in page.tags if tag == "script"] == ["application/json", "", "module"]
    (view,) = views(tmp_path / "run.html")
    recording = recordings.read(csp)
    np.testing.assert_array_equal(unpacked(view["time"], "<f8"), recording["time_s"])
    (position,) = (panel for panel in view["panels"] if panel["name"] == "position")
    assert position["unit"] == "mrad"
    (measured,) = (line for line in position["lines"] if line["name"] == "measured")
    np.testing.assert_allclose(unpacked(measured["data"], "<f4"), 1e3 * recording["position"], rtol=1e-6, atol=1e-6)


@pytest.mark.skipif(PROGRAM is None, reason="there is no Chromium here to open the page")
def test_a_browser_draws_the_page_zooms_shows_values_and_saves_a_picture(csp, tmp_path, capsys):
    plotted(capsys, csp, "--output", tmp_path / "run.html")
    last_s = float(recordings.read(csp)["time_s"][-1])
    with browser(tmp_path) as page:
        page.resize(1280)
        page.open((tmp_path / "run.html").as_uri())
        page.until("document.body?.dataset.drawn === 'yes'")
        assert page.get("document.querySelectorAll('.uplot').length") == 7  # five panels, comparison, friction
        page.picture(tmp_path / "whole.png")
        area = page.get("document.querySelector('#time-0 .u-over').getBoundingClientRect().toJSON()")

        def mouse(kind: str, share: float) -> None:
            x, y = area["left"] + share * area["width"], area["top"] + area["height"] / 2
            page.do("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, button="left", clickCount=1)

        def values_at(share: float) -> list[list[str]]:
            """The values at the cursor of each panel: the time, and each line's."""
            mouse("Moved", share)
            page.get("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
            legends = "[...document.querySelectorAll('#time-0 .u-legend')]"
            return page.get(
                f"{legends}.map((each) => [...each.querySelectorAll('.u-value')].map((value) => value.textContent))"
            )

        before = values_at(0.25)
        assert len(before) == 5
        assert all(float(panel[0]) == pytest.approx(0.25 * last_s, abs=0.05) for panel in before)
        assert all(value.endswith("mrad") for value in before[0][1:])
        mouse("Pressed", 0.25)
        mouse("Moved", 0.75)
        mouse("Released", 0.75)
        for share in (0.02, 0.5, 0.98):  # all panels show the half that was dragged over
            expected_s = (0.25 + 0.5 * share) * last_s
            assert [float(panel[0]) for panel in values_at(share)] == pytest.approx([expected_s] * 5, abs=0.05)
        page.do("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path / "saved"))
        page.get("document.querySelector('#picture-0').click()")
        saved, end_s = tmp_path / "saved" / "run.mcap, axis x.png", time.monotonic() + 30.0
        while not saved.exists():
            assert time.monotonic() < end_s, list(tmp_path.rglob("*.png"))
            time.sleep(0.05)
        assert is_picture(saved)
        assert page.said == []


def test_names_of_a_file_are_no_html(runs, tmp_path, capsys):
    time = np.arange(100) * 1e-3
    hostile = "</script><script>alert(1)</script>"
    writer = McapWriter(tmp_path / "run.mcap", ["x"], ("time_s", "cycle", "position"))
    writer.write(np.stack([time, np.arange(100.0), np.sin(time)], axis=1))
    writer.write_event(50.0, "fault", hostile)
    writer.close()
    plotted(capsys, tmp_path / "run.mcap", "--output", tmp_path / "run.html")
    assert hostile not in (tmp_path / "run.html").read_text(encoding="utf-8")
    (view,) = views(tmp_path / "run.html")
    assert "alert(1)" in view["marks"][0]["text"]


def test_a_part_is_drawn_and_the_figures_stay_those_of_the_run(csp, tmp_path, capsys):
    whole = plotted(capsys, csp, "--output", tmp_path / "a.html")
    part = plotted(capsys, csp, "--from", 1.0, "--to", 1.5, "--output", tmp_path / "b.html")
    assert part["axes"]["x"]["following_error"] == whole["axes"]["x"]["following_error"]
    (view,) = views(tmp_path / "b.html")
    time = unpacked(view["time"], "<f8")
    assert (time[0], time[-1], len(time)) == pytest.approx((1.0, 1.5, 501))


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (("--from", "9", "--to", "2"), 2, "the part must end after it begins"),
        (("--from", "900"), 1, "it reaches from 0 s to"),
        (("--from", "nan"), 2, "must end after it begins"),
        (("--output", "run.xyz"), 2, "no picture format has the suffix"),
        (("--output", "run.mcap"), 2, "is the recording itself"),
        (("--axis", "z"), 2, "no axis 'z'"),
        (("--output", "no/where.png"), 1, "cannot be written"),
        (("--output", "no/where.html"), 1, "cannot be written"),
    ],
)
def test_mistakes_are_answered(words, status, said, csp, monkeypatch, capsys):
    monkeypatch.chdir(csp.parent)
    assert main(["plot", "run.mcap", *words]) == status
    assert said in capsys.readouterr().err
