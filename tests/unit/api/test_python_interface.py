"""The public Python interface: its names, its examples, the same results as the commands, and every kind of input."""

import doctest
import importlib
import inspect
import json
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.models.files import load_model_file
from friction_hil.models.model_file import ModelFile
from friction_hil.recordings import Recording

PROJECT = Path(__file__).parents[3]
GOLDEN = PROJECT / "tests/unit/replay/golden/0.3.0.dev0.mcap"
MODELS = ["coulomb", "stribeck"]
WRONG = "coulomb:coulomb=0.2"


def made(columns=("time_s", "position", "velocity", "torque"), seed=0):
    """An axis with Coulomb friction 0.3 N m, viscous friction 0.05 N m s/rad and inertia 0.02 kg m^2."""
    time = np.arange(2500) * 4e-3
    velocity = np.cos(2.0 * np.pi * 0.9 * time) + 0.4 * np.cos(2.0 * np.pi * 2.3 * time + 1.0)
    torque = 0.3 * np.sign(velocity) + 0.05 * velocity + 0.02 * np.gradient(velocity, 4e-3)
    torque += 0.01 * np.random.default_rng(seed).normal(size=len(time))
    values = {"time_s": time, "position": np.cumsum(velocity) * 4e-3, "velocity": velocity, "torque": torque}
    return {name: values[name] for name in columns}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    for seed, name in enumerate(("swing", "other")):
        fh.recordings.write(folder / f"{name}.csv", Recording("", "x", made(seed=seed)))
    return folder


@pytest.fixture(scope="module")
def swing(folder):
    return fh.identify(folder / "swing.csv", models=MODELS)


def said(capsys, *words):
    main([*map(str, words), "--json"])
    return json.loads(capsys.readouterr().out)


def test_every_public_name_is_there_and_no_other():
    for name in fh.__all__:
        each = getattr(fh, name)
        assert inspect.ismodule(each) or each.__name__ == name
        assert each.__doc__
    with pytest.raises(AttributeError, match=r"no attribute 'replays'.*identify"):
        fh.replays  # noqa: B018


def test_the_interface_costs_nothing_until_it_is_used():
    code = "import sys, friction_hil; assert not {'numpy', 'numba', 'click'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=PROJECT)


def test_the_examples_run():
    public = [getattr(fh, name) for name in fh.__all__]
    names = {each.__name__ if inspect.ismodule(each) else each.__module__ for each in public}
    names |= {each.__module__ for each in map(fh.recordings.__dict__.get, fh.recordings.__all__)}
    options = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    tried = {name: doctest.testmod(importlib.import_module(name), optionflags=options) for name in names}
    assert {name for name, result in tried.items() if result.failed} == set()
    missing = [f.__name__ for f in public if inspect.isfunction(f) and "Examples" not in f.__doc__]
    assert missing == [], "a public function has an example"


def test_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = PROJECT / "friction_hil/api/README.md"
    options = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    assert doctest.testfile(str(page), module_relative=False, optionflags=options).failed == 0


def test_the_parameters_are_the_options_of_the_commands():
    renamed = {
        "sources",
        "config",
        "as_json",
        "verbose",
        "columns",
        "rate_hz",
        "model_arguments",
        "names",
        "kept_apart",
    }
    only_commands = {"output", "report", "scheduler", "is_verifying", "yes"}
    for command, *functions in (
        ("identify", fh.identify, fh.identify_joints),
        ("replay", fh.compare),
        ("train", fh.train),
        ("tune", fh.tune),
    ):
        options = {each.name for each in importlib.import_module(f"friction_hil.cli.{command}").command.params}
        parameters = {name for function in functions for name in inspect.signature(function).parameters}
        assert options - renamed - only_commands <= parameters, command


def test_identify_says_what_the_command_says(folder, swing, capsys):
    words = ("identify", folder / "swing.csv", "--models", ",".join(MODELS), "--output", folder / "cli.yaml")
    told = said(capsys, *words)
    assert swing.to_dict() == told | {"output": None}
    assert swing.model.friction.parameters["coulomb"] == pytest.approx(0.3, rel=0.02)
    assert swing.standard_errors == told["fits"][0]["standard_errors"]
    assert (swing.reason, swing.label, swing.is_usable) == (told["reason"], told["best"], True)
    swing.save(folder / "python.yaml")
    assert (folder / "python.yaml").read_text() == (folder / "cli.yaml").read_text()
    assert isinstance(swing.model, ModelFile)


def test_identify_takes_the_options_of_the_command(folder, capsys):
    options = {"models": "coulomb", "validate": [folder / "other.csv"], "fix": {"inertia": 0.02}, "lowpass": 40.0}
    options |= {"decimate": 5, "loss": "huber", "gravity": "none", "column": {"torque": "torque*0.5"}, "seed": 3}
    words = ("--models", "coulomb", "--validate", folder / "other.csv", "--fix", "inertia=0.02", "--lowpass", "40")
    words += ("--decimate", "5", "--loss", "huber", "--gravity", "none", "--column", "torque=torque*0.5", "--seed", "3")
    found = fh.identify([folder / "swing.csv"], **options)
    assert found.to_dict() == said(capsys, "identify", folder / "swing.csv", *words)
    assert found.model.friction.parameters["coulomb"] == pytest.approx(0.15, rel=0.05)


def test_a_map_is_identified_as_by_the_command(tmp_path, capsys):
    speeds = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
    table = {"velocity": speeds, "torque": 0.2 * np.sign(speeds) + 0.03 * speeds}
    lines = [f"{v},{t}" for v, t in zip(speeds.tolist(), table["torque"].tolist(), strict=True)]
    (tmp_path / "map.csv").write_text("\n".join(["velocity,torque", *lines]))
    found = fh.identify(tmp_path / "map.csv", static=True, fix={"inertia": 0.01})
    assert found.to_dict() == said(capsys, "identify", tmp_path / "map.csv", "--static", "--fix", "inertia=0.01")
    assert found.model.friction.parameters["coulomb"] == pytest.approx(0.2)
    assert fh.identify(table, static=True).model.friction == found.model.friction
    with pytest.raises(fh.errors.UsageError, match="takes --fix inertia"):
        fh.identify(table, static=True, fix={"coulomb": 0.1})


class Interchange:
    """A data frame of a library without Arrow's protocol."""

    def __init__(self, table):
        self._table = table

    def __dataframe__(self, **options):
        return self._table.__dataframe__(**options)


@pytest.mark.parametrize("kind", ["arrays", "recording", "by axis", "pandas", "arrow", "interchange", "mapped"])
def test_every_kind_of_input_gives_the_same_model(kind, swing):
    columns, options = made(), {}
    if kind == "pandas":
        given = pytest.importorskip("pandas").DataFrame(columns)
    elif kind in ("arrow", "interchange"):
        table = pytest.importorskip("pyarrow").table({**columns, "note": ["a"] * 2500})
        given = table if kind == "arrow" else Interchange(table)
    elif kind == "mapped":
        mine = {"state": np.column_stack([columns["position"], columns["velocity"]]), "ampere": columns["torque"] / 0.5}
        options["column"] = {"position": "state[:,0]", "velocity": "state[:, 1]", "torque": "ampere*0.5"}
        given, options["rate"] = mine, 250.0
    else:
        recording = Recording("memory", "x", columns)
        given = {"arrays": columns, "recording": recording, "by axis": {"x": recording}}[kind]
    found = fh.identify(given, models=MODELS, **options)
    assert found.label == swing.label
    assert found.model.friction.parameters == pytest.approx(swing.model.friction.parameters, rel=1e-6)
    assert found.facts["recordings"][0]["rows"] == 2500


def test_a_recording_is_left_as_it_was():
    recording = Recording("memory", "x", made())
    before = {name: values.copy() for name, values in recording.columns.items()}
    fh.compare(recording, WRONG, scale={"torque": 2.0})
    assert list(recording.columns) == list(before)
    assert recording.problems == []
    for name, values in before.items():
        np.testing.assert_array_equal(recording.columns[name], values)


@pytest.mark.parametrize(
    ("given", "options", "text"),
    [
        (3, {}, "int is no recording: give a path"),
        ([], {}, "there is no recording"),
        ({"time_s": [0.0, 1.0], "torque": [1.0]}, {}, "have one length, not time_s 2, torque 1"),
        (made(("time_s", "position")), {}, "no column torque"),
        (made(), {"gravity": "up"}, "gravity='up' is not known"),
        (made(), {"torque_is": "late"}, "torque_is='late' is not known"),
        (made(), {"loss": "cubes"}, "loss='cubes' is not known"),
        (made(), {"fix": {"inertia": float("nan")}}, "fix: inertia=nan: a finite number"),
        (made(), {"min_speed": -1.0}, "min_speed=-1.0: a number from 0"),
        (made(), {"decimate": 0}, "decimate=0: a number from 1"),
        (made(), {"controller": {"position_gain": 1.0}}, "--controller also needs velocity_gain"),
        (made(), {"models": ["coulmob"]}, "did you mean 'coulomb'"),
        (made(), {"axis": "x", "scale": {"torque": float("inf")}}, "a factor is finite and not zero"),
        (Recording("memory", "x", made()), {"axis": "y"}, "is of axis 'x', not of 'y'"),
    ],
)
def test_mistakes_are_errors_of_the_package(given, options, text):
    with pytest.raises(fh.errors.FrictionHilError, match=re.escape(text)):
        fh.identify(given, **options)


def test_what_explains_nothing_is_no_model(tmp_path):
    noise = made(("time_s", "position", "velocity")) | {"torque": np.random.default_rng(0).normal(size=2500)}
    found = fh.identify(noise, models="coulomb")
    assert not found.is_usable
    assert found.to_dict()["is_usable"] is False
    with pytest.raises(fh.errors.FrictionHilError, match="no usable model: "):
        found.save(tmp_path / "noise.yaml")
    assert list(tmp_path.iterdir()) == []


def test_save_replaces_a_file_and_refuses_what_the_command_refuses(swing, tmp_path):
    path = tmp_path / "axis.yaml"
    path.write_text("old")
    swing.save(str(path))
    assert load_model_file(path).friction == swing.model.friction
    for wrong, text in ((tmp_path / "axis.txt", "ends in .yaml"), (tmp_path / "gone" / "a.yaml", "there is no folder")):
        with pytest.raises(fh.errors.UsageError, match=text):
            swing.save(wrong)


def test_compare_says_what_replay_says(folder, swing, capsys):
    swing.save(folder / "model.yaml")
    models = [str(folder / "model.yaml"), WRONG]
    found = fh.compare([folder / "swing.csv", folder / "other.csv"], models, decimate=5)
    words = ("replay", folder / "swing.csv", folder / "other.csv", "--model", models[0], "--model", WRONG)
    told = said(capsys, *words, "--decimate", "5")
    assert found.to_dict() == told
    errors = {each["model"]: each["relative_error"] for each in told["recordings"][0]["models"]}
    one = fh.compare(folder / "swing.csv", models, decimate=5)
    assert one.relative_errors == pytest.approx(errors)
    assert (one.best, one.model.friction) == (models[0], swing.model.friction)
    assert one.standard_errors == {name: pytest.approx(e) for name, e in swing.standard_errors.items() if e is not None}
    assert "lowest relative error" in one.reason
    by_result = fh.compare(folder / "swing.csv", [swing, swing.model], decimate=5)
    assert list(by_result.relative_errors.values()) == [one.relative_errors[models[0]]] * 2


def test_verify_says_what_the_command_says(capsys):
    found = fh.verify(GOLDEN)
    assert found
    assert found.to_dict() == said(capsys, "replay", GOLDEN, "--verify")
    recording = fh.recordings.read(GOLDEN)
    assert fh.verify([recording]).is_verified
    recording.columns["compensation"] = recording.columns["compensation"].copy()
    recording.columns["compensation"][-2] += 1e-3
    altered = fh.verify(recording)
    assert not altered
    assert "cycle" in altered.reason
    with pytest.raises(fh.errors.RecordingError, match="only the daemon's own"):
        fh.verify(Recording("memory", "x", made()))


def test_train_says_what_the_command_says(folder, capsys):
    options = {"structure": "static", "samples": 1000, "speed": 2.0, "seed": 5, "hidden": [3]}
    told = said(capsys, "train", "--from-model", WRONG, *(f"--{k}={v}" for k, v in (options | {"hidden": 3}).items()))
    found = fh.train(from_model=WRONG, **options)
    assert found.to_dict() | {"seconds": 0.0} == told | {"seconds": 0.0}
    assert found.model.friction.network is not None
    with pytest.raises(fh.errors.UsageError, match="recordings or --from-model"):
        fh.train(folder / "swing.csv", from_model=WRONG)
    with pytest.raises(fh.errors.UsageError, match="samples=10: a number from 1000"):
        fh.train(from_model=WRONG, samples=10)


@pytest.mark.deep
def test_the_choice_of_a_network_says_what_the_command_says(folder, capsys):
    found = fh.train(folder / "swing.csv", base=f"{WRONG},viscous=0.01", lowpass=40.0)
    told = said(capsys, "train", folder / "swing.csv", "--base", f"{WRONG},viscous=0.01", "--lowpass", "40")
    assert found.to_dict() | {"seconds": 0.0} == told | {"seconds": 0.0}
    assert found.reason == told["reason"]


def test_nothing_is_printed_and_a_callback_is_told(folder, capfd):
    told = []
    fh.identify(folder / "swing.csv", models="coulomb", progress=lambda *now: told.append(now))
    fh.compare(folder / "swing.csv", WRONG, progress=lambda *now: told.append(now))
    fh.train(from_model=WRONG, structure="static", samples=1000, speed=2.0, progress=lambda *now: told.append(now))
    assert capfd.readouterr() == ("", "")
    shares = [share for _, share in told if share is not None]
    assert len({stage for stage, _ in told}) > 5
    assert len(shares) > 5
    assert all(0.0 <= share < 1.0 for share in shares)


def test_a_machine_moves_only_if_that_is_confirmed(tmp_path):
    with pytest.raises(fh.errors.UsageError, match="confirm=True"):
        fh.tune(tmp_path / "machine.yaml")  # refused before the file is looked for
    with pytest.raises(fh.errors.ConfigurationError, match=r"machine\.yaml"):
        fh.tune(tmp_path / "machine.yaml", simulate=True, output=tmp_path / "tuned")
    with ThreadPoolExecutor(1) as pool, pytest.raises(fh.errors.UsageError, match="main thread"):
        pool.submit(fh.tune, tmp_path / "machine.yaml", simulate=True).result()
    assert list(tmp_path.iterdir()) == []


def test_results_are_drawn_into_given_axes_and_shown_in_notebooks(folder, swing):
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    network = fh.train(from_model=WRONG, structure="static", samples=1000, speed=2.0)
    compared = fh.compare(folder / "swing.csv", [swing, WRONG])
    speeds = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
    static = fh.identify({"velocity": speeds, "torque": np.sign(speeds)}, static=True)
    for result in (swing, network, compared, static):
        axes = Figure().subplots()
        assert result.plot(axes) is axes
        assert axes.lines
        assert axes.get_xlabel()
    assert len(compared.plot().lines) == 3  # measured, and one a model


def test_what_a_notebook_shows_is_escaped(folder, swing):
    error = fh.compare(Recording("<b>log</b>", "x", made()), WRONG)._repr_html_()
    assert "&lt;b&gt;log&lt;/b&gt;" in error
    assert "<b>" not in error
    shown = swing._repr_html_()
    assert "<table>" in shown
    assert "coulomb" in shown
    assert "0.3" in shown
    assert "<table>" in fh.verify(GOLDEN)._repr_html_()
    assert repr(swing).startswith(f"Identified({swing.label!r}")


CONSUMER = """
import numpy as np
import friction_hil as fh

found: fh.Identified = fh.identify({"time_s": np.zeros(3)}, models=["coulomb"], gravity="none")
inertia: float = found.model.mechanics.inertia
errors: list[float] = [each for each in found.standard_errors.values() if each is not None]
compared: fh.Comparison = fh.compare("log.csv", [found, "coulomb:coulomb=1"])
compared.plot().set_title(compared.best)
verified: bool = fh.verify("run.mcap").is_verified
fh.train("log.csv", structure="gated").save("net.yaml")
tuned: fh.Tuned = fh.tune("machine.yaml", confirm=True, pace="real")
worst: fh.errors.FrictionHilError = fh.errors.UsageError("")
recording: fh.recordings.Recording = fh.recordings.from_table({"time_s": np.zeros(3)})
"""


@pytest.mark.deep
def test_a_consumer_is_checked_by_mypy(tmp_path):
    (tmp_path / "consumer.py").write_text(CONSUMER)
    (tmp_path / "wrong.py").write_text('import friction_hil as fh\nfh.identify("log.csv", gravity="up")\nfh.replays\n')
    words = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "--config-file=/dev/null"]
    done = {
        name: subprocess.run([*words, str(tmp_path / name)], cwd=PROJECT, capture_output=True, text=True).stdout
        for name in ("consumer.py", "wrong.py")
    }
    assert "Success" in done["consumer.py"], done["consumer.py"]
    assert "Found 2 errors" in done["wrong.py"], done["wrong.py"]


@pytest.mark.deep
def test_a_tuning_prints_nothing_and_writes_into_its_folder(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    main(["config", "new", "trial.yaml", "--simulated"])
    Path("trial.yaml").write_text(
        re.sub(r"( +)travel: 1.0 .*", r"\1travel: 1.0\n\1duration_s: 10.0", Path("trial.yaml").read_text())
    )
    capfd.readouterr()
    found = fh.tune("trial.yaml", models="coulomb", simulate=True, pace="sync", output="python")
    assert capfd.readouterr() == ("", "")
    own = found.to_dict()["axes"]["x"]  # the command prints this very object
    assert own["file"] == "python/x.yaml"
    assert own["parameters"] == found.models["x"].friction.parameters
    assert sorted(found.to_dict()["recordings"]) == sorted(map(str, Path("python").glob("*.mcap")))
    assert found.has_helped
    assert found.models["x"].friction == load_model_file("python/x.yaml").friction
    found.save("copy.yaml")
    assert Path("copy.yaml").read_text() == Path("python/x.yaml").read_text()
