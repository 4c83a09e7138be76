"""``friction-hil train`` as users type it: networks that learn, files that load, Ctrl-C, mistakes."""

import json
import re
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest

import friction_hil as fh
from tests.launcher import start
from tests.processes import run

pytestmark = pytest.mark.deep

LUGRE = "lugre:sigma0=900,sigma1=0.6,sigma2=4e-3,coulomb=0.11,static=0.17,stribeck_velocity=0.12,damping_velocity=0.12"
EMPS = Path(__file__).resolve().parents[3] / "shared" / "data" / "emps" / "DATA_EMPS.mat"


def train(*arguments):
    return run("train", *arguments, check=False)


def test_a_network_learns_a_model_and_runs_where_a_model_runs(tmp_path):
    net, report = tmp_path / "net.yaml", tmp_path / "net.html"
    done = train("--from-model", LUGRE, "--samples", 6000, "--hidden", 6, "--output", net, "--report", report, "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["structure"] == "gated"
    assert said["validation"]["free_run"] < 0.05
    assert said["unseen"]["multi-sines, ramps and pulses"] < 0.05

    model = fh.models.load(net)
    t = np.arange(8000) * 1e-3
    velocity = 0.4 * np.sin(3.0 * t) * np.sin(0.7 * t)
    name, _, rest = LUGRE.partition(":")
    true = fh.models.create(name, **{k: float(v) for k, v in (part.split("=") for part in rest.split(","))})
    wanted = true.simulate(velocity, 1e-3)
    assert np.sqrt(np.mean((model.simulate(velocity, 1e-3) - wanted) ** 2)) < 0.1 * np.std(wanted)
    assert 0.1 < model.level < 0.25

    text = report.read_text(encoding="utf-8")
    assert text.count("<figure") == 5
    errors = {name: float(error) for name, error in re.findall(r">(\w+)</th><td[^>]*>([.\d]+)</td>", text)}
    assert errors["network"] < 0.5 * errors["coulomb"]
    assert errors["lugre"] < 0.02  # the plant is one
    assert "http" not in text.replace("http://www.w3.org", "")

    recording = tmp_path / "log.csv"
    rows = np.column_stack([t, np.cumsum(velocity) * 1e-3, velocity, wanted])
    np.savetxt(recording, rows, delimiter=",", header="time_s,position,velocity,torque", comments="")
    replayed = run("replay", recording, "--model", net, "--json")
    assert json.loads(replayed.stdout)["recordings"][0]["models"][0]["relative_error"] < 0.1


def log_of_friction(path, ripple):
    """Write strokes of several speeds under friction that varies with the position by ``ripple``."""
    random, parts, where = np.random.default_rng(0), [], 0.0
    for _ in range(24):
        stroke = random.uniform(0.6, 1.1) * (-1.0 if where > 0.0 else 1.0)
        s = np.linspace(0.0, 1.0, round(abs(stroke) * 750.0 / random.choice([0.6, 1.2, 2.4, 4.0])))[1:]
        parts.append(where + stroke * s**3 * (10.0 - 15.0 * s + 6.0 * s**2))
        where += stroke
    position = np.concatenate(parts)
    velocity = np.gradient(position, 2e-3)
    torque = (0.1 + ripple * np.sin(3.0 * position)) * np.tanh(velocity / 1e-3) + 0.01 * velocity
    torque += 1e-3 * np.gradient(velocity, 2e-3) + 2e-3 * random.standard_normal(len(position))
    counted = np.round(position / 3.8e-4) * 3.8e-4
    rows = np.column_stack([2e-3 * np.arange(len(position)), counted, torque])
    np.savetxt(path, rows, delimiter=",", header="time_s,position,torque", comments="")


@pytest.mark.parametrize("ripple", [0.0, 0.03])
def test_without_a_structure_the_network_is_kept_only_if_held_out_data_show_that_it_is_better(ripple, tmp_path):
    log, known, net, report = (tmp_path / name for name in ("log.csv", "known.yaml", "net.yaml", "net.html"))
    log_of_friction(log, ripple)
    known.write_text(
        "version: 1\naxis: rotary\nfriction: {model: coulomb, parameters: {coulomb: 0.1, viscous: 0.01}}\n"
        "mechanics: {inertia: 1.0e-3}\n",
        encoding="utf-8",
    )
    done = train(log, "--base", known, "--output", net, "--report", report)
    assert done.returncode == 0, done.stderr
    model = fh.models.load(net)
    assert (model.network is not None) == (ripple > 0.0)
    assert model.name == "coulomb"
    if ripple > 0.0:
        assert "because on strokes of other speeds" in done.stdout
        assert model.network.structure.has_position
    else:
        assert "because no network is better than the model of --base" in done.stdout
        assert "holds this model without a network" in done.stdout
    text = report.read_text(encoding="utf-8")
    assert text.count("<figure") == 1
    assert "blocks of time" in text


def test_ctrl_c_keeps_the_best_network_so_far(tmp_path):
    net = tmp_path / "net.yaml"
    words = ("train", "--from-model", LUGRE, "--output", net, "--json")
    with start(*words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        assert any(line.startswith("trying start") for line in process.stderr)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    said = json.loads(out)
    assert "stopped before the search was over" in said["flags"]
    assert said["iterations"] < 25
    assert fh.models.load(net).network is not None


@pytest.mark.skipif(not EMPS.exists(), reason="the shared recording of the EMPS axis is not here")
def test_a_residual_of_the_emps_axis_beats_the_physical_model_on_held_out_blocks(tmp_path):
    columns = [f"--column={each}" for each in ("time_s=t", "position=qm", "torque=vir*35.150651")]
    net = tmp_path / "net.yaml"
    done = train(
        EMPS, "--linear", *columns, "--structure", "residual", "--inputs", "position", "--json", "--output", net
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["weights"] <= 50
    own, physical = said["relative_errors"].values()
    assert own < 0.95 * physical < 0.03
    model = fh.models.load(net)
    assert model.name == "lugre"
    assert model.network.is_residual


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "one of them"),
        (["log.csv", "--from-model", LUGRE], "one of them"),
        (["--from-model", "luger:a=1"], "lugre"),
        (["--from-model", LUGRE, "--hidden", "ten"], "whole numbers"),
        (["--from-model", LUGRE, "--hidden", "0"], "1 to 64 units"),
        (["--from-model", LUGRE, "--inputs", "speed"], "no input 'speed'"),
        (["--from-model", LUGRE, "--structure", "lstm"], "gated"),
        (["--from-model", LUGRE, "--structure", "residual"], "recordings"),
        (["--from-model", LUGRE, "--output", "net.txt"], ".yaml"),
        (["--from-model", LUGRE, "--report", "net.pdf"], ".html"),
        (["--from-model", "coulomb:coulomb=0.1"], "--speed"),
        (["nowhere.csv"], "nowhere.csv"),
        (["log.csv", "--hidden", "4"], "--structure"),
        (["log.csv", "--inputs", "speed"], "no input 'speed'"),
    ],
)
def test_a_mistake_is_one_sentence(arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = train(*arguments)
    assert done.returncode in (1, 2)
    assert words in done.stderr
    assert "Traceback" not in done.stderr


def test_a_narx_is_trained_drawn_and_written_in_every_way(tmp_path):
    """The classical way: series-parallel first, then cut loose. It runs at the period of its training only."""
    net = tmp_path / "narx.yaml"
    done = train(
        *("--from-model", LUGRE, "--structure", "narx", "--samples", 1000, "--hidden", 2),
        *("--output", net, "--report", tmp_path / "narx.html"),
    )
    assert done.returncode == 0, done.stderr
    assert "best so far" in done.stderr
    assert (tmp_path / "narx.html").exists()

    model = fh.models.load(net)
    assert np.isfinite(model.steady_state([-0.5, 0.01, 0.5])).all()
    draw = ("--motion", "sine:amplitude=0.1", "--beside", LUGRE, "--draw", tmp_path / "narx.png", "--json")
    for words in (
        ("models", net, "--draw", tmp_path / "cycle.png"),
        ("models", net, *draw),
        *(("export", net, "--to", to, "--output", tmp_path / to) for to in ("csv", "c", "st", "urdf")),
    ):
        made = run(*words, check=False)
        assert made.returncode == 0, made.stderr

    recording = tmp_path / "log.csv"
    for dt, status in ((1e-3, 0), (4e-3, 2)):
        t = np.arange(2000) * dt
        rows = np.column_stack([t, 0.1 * np.sin(t), 0.1 * np.cos(t), 0.1 * np.sign(np.cos(t))])
        np.savetxt(recording, rows, delimiter=",", header="time_s,position,velocity,torque", comments="")
        replayed = run("replay", recording, "--model", net, "--json", check=False)
        assert bool(replayed.returncode) == bool(status)
        if status:
            assert "a narx runs only at the period of its training, 0.001 s, not at 0.004 s" in replayed.stderr
