"""Configurations and model files: correct ones are accepted, and mistakes are reported."""

import json
import math
import re
import time

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from friction_hil.checked_yaml.text import dump
from friction_hil.config import from_dict, json_schema, load, missing_models, self_contained
from friction_hil.errors import ConfigurationError, UsageError
from tests.fake_drivers import GOOD, changed, good, install, outcome, problems_in, problems_of


@pytest.fixture(scope="module", autouse=True)
def _fake_drivers(tmp_path_factory):
    """Install a distribution with the drivers ``fake``, ``unsimulated`` and ``broken``."""
    directory = install(tmp_path_factory.mktemp("site"))
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(directory)
        yield


@pytest.fixture
def path(tmp_path):
    return tmp_path / "axis.yaml"


def test_a_good_file(path):
    path.write_text(GOOD)
    configuration = load(path)
    axis = configuration.axes["x"]
    assert configuration.source_path == path
    assert configuration.period_s == 1e-3
    assert configuration.bus.hop_limit == 0
    assert configuration.realtime.max_missed == 10
    assert (axis.options.node, axis.options.gear, axis.simulation.rate_hz) == (1, 1.0, 4000.0)
    assert axis.limits.position == (-10.0, 10.0)
    assert (axis.compensation.gain, axis.compensation.source) == (0.8, "auto")
    assert axis.model.friction_model.parameters["damping_velocity"] == math.inf
    assert [shadow.name for shadow in axis.shadows] == ["plain"]
    assert axis.trajectory.ramp_s == 1.0
    assert str(configuration.recording.path) == "out/run.mcap"


def test_neither_it_nor_what_it_is_made_of_is_changed():
    values = good()
    configuration = from_dict(values, "test")
    assert values == good()
    with pytest.raises(ValueError, match="frozen"):
        configuration.axes["x"].limits.torque = 3.0


CASES = [
    # the line of GOOD that is replaced, what replaces it, the field, the message
    ("period_s: 1e-3", "period_s: 1:30", "period_s", "must be a number [s], not the text '1:30'"),
    ("period_s: 1e-3", "period_s: 2", "period_s", "must be at least 0.0001 and at most 1 s, not 2"),
    ("period_s: 1e-3", "period_s: .nan", "period_s", "must be a finite number, not .nan"),
    ("period_s: 1e-3", "period_s: '1e-3'", "period_s", "without quotes"),
    ("period_s: 1e-3", "period_s: 0,001", "period_s", "write 0.001"),
    ("period_s: 1e-3", "period_s: true", "period_s", "must be a number [s], not true"),
    ("period_s: 1e-3", "period_s:", "period_s", "not empty"),
    ("period_s: 1e-3", "priod_s: 1e-3", "priod_s", "did you mean 'period_s'?"),
    ("version: 1", "version: 2", "version", "must be 1, not 2"),
    ("  port: 43113", "  port: 43_113", "bus.port", "write 43113"),
    ("  port: 43113", "  port: 1.0", "bus.port", "write 1"),
    ("  channel: 239.74.163.2", "  channel: can0", "bus.channel", "can0 is a channel of interface: socketcan"),
    ("  channel: 239.74.163.2", "  channel: 10.0.0.1", "bus.channel", "multicast address"),
    ("  channel: 239.74.163.2", "  channel: [1]", "bus.channel", "must be a whole number, not a list; or"),
    ("  x:", "  X:", "axes.X", "small letters"),
    ("    driver: fake", "    driver: fkae", "axes.x.driver", "did you mean 'fake'?"),
    ("    driver: fake", "    driver: broken", "axes.x.driver", "cannot be imported"),
    ("    node: 1", "    node: 10", "axes.x.node", "must be at least 1 and at most 9, not 10"),
    ("    node: 1", "    node: 010", "axes.x.node", "write 10"),
    ("    node: 1", "    node: 1\n    options: {node: 1}", "axes.x.options", "is not a key here"),
    ("    node: 1", "    node: 1\n    gear: 0", "axes.x.gear", "must be above 0 furlong, not 0"),
    ("    node: 1", "    node: 1\n    is_inverted: on", "axes.x.is_inverted", "write true"),
    ("    node: 1", "    node: 1\n    wiring: {pins: [1, a]}", "axes.x.wiring.pins[1]", "whole number"),
    ("    mode: csp", "    mode: CSP", "axes.x.mode", "'csp', 'csv' or 'cst'"),
    ("      torque: 0.3", "      torque: -0.3", "axes.x.limits.torque", "must be above 0 N m"),
    ("      torque: 0.3", "      torque: 0.3 Nm", "axes.x.limits.torque", "write the number alone, 0.3"),
    ("      torque: 0.3", "      torque: 1e300", "axes.x.limits.torque", "at most 1e+07 N m or N, not 1e+300"),
    ("      torque: 0.3", "      torque: 300 mNm", "axes.x.limits.torque", "in Nm: write 0.3"),
    ("period_s: 1e-3", "period_s: 1 ms", "period_s", "in s: write 0.001"),
    ("period_s: 1e-3", "period_s: 1000 Hz", "period_s", "write the number alone, converted to s"),
    ("      torque: 0.3", "      torque: 30%", "axes.x.limits.torque", "a percentage; give the value in N m or N"),
    ("      torque: 0.3", "      torque:", "axes.x.limits.torque", "not empty: fill in the limit of abs(compensation)"),
    ("      position: [-10.0, 10]", "      position: [1, 1]", "axes.x.limits.position", "[lowest, highest]"),
    ("      position: [-10.0, 10]", "      position: [1]", "axes.x.limits.position", "at least 2 values"),
    ("      position: [-10.0, 10]", "      position: [1, 2, 3]", "axes.x.limits.position", "at most 2"),
    ("      position: [-10.0, 10]", "      position: [1, .nan]", "axes.x.limits.position[1]", "finite"),
    ("      velocity: 30.0", "      velocity: 3.1", "axes.x.limits.velocity", "moves at up to 3.142"),
    ("        model: lugre", "        model: lugree", "axes.x.model.friction.model", "did you mean 'lugre'?"),
    ("          sigma0: 2000", "          sigma0: -1", "axes.x.model.friction.parameters.sigma0", "N m/rad, > 0"),
    ("          sigma0: 2000", "          sigma: 1", "axes.x.model.friction.parameters.sigma", "sigma0"),
    ("        inertia: 2e-4", "        inertia: [2e-4]", "axes.x.model.mechanics.inertia", "not a list"),
    ("      gain: 0.8", "      gain: 1.6", "axes.x.compensation.gain", "at least 0 and at most 1.5, not 1.6"),
    ("      gain: 0.8", "      gain: 12.5 %", "axes.x.compensation.gain", "write 0.125"),
    ("      gain: 0.8", "      enabled: yes", "axes.x.compensation.enabled", "write true"),
    ("      gain: 0.8", "      enabled: 1", "axes.x.compensation.enabled", "must be true or false, not 1"),
    ("      gain: 0.8", "      smoothing: 0.05", "axes.x.compensation.smoothing", "cycles"),
    ("      - name: plain", "      - name: Plain", "axes.x.shadows[0].name", "small letters"),
    ("      kind: circle", "      kind: circel", "axes.x.trajectory.kind", "one of 'circle', 'sine'"),
    ("      kind: circle", "", "axes.x.trajectory", "needs the key 'kind'"),
    ("  path: out/run.mcap", "  path: 3", "recording.path", "3"),
    ("  path: out/run.mcap", "  budget_mb: 20\n  rotate_mb: 15", "recording.rotate_mb", "half of budget_mb, 10"),
    ("  path: out/run.mcap", "  path: out/run.mcap\nlive: {}", "live.dashboard", "is needed, or foxglove"),
    ("realtime:", "live: {dashboard: 80, foxglove: 80}\nrealtime:", "live.foxglove", "another port"),
    ("realtime:", "live: {dashboard: 1, allow_hosts: ['a b']}\nrealtime:", "live.allow_hosts[0]", "machine"),
    ("  priority: 0", "  spin_us: 1000", "realtime.spin_us", "below the period, 1000 µs"),
]


@pytest.mark.parametrize(("old", "new", "field", "message"), CASES)
def test_a_mistake_is_reported_with_its_line(path, old, new, field, message):
    assert GOOD.count(f"{old}\n") == 1
    problems = problems_in(path, GOOD.replace(f"{old}\n", f"{new}\n"))
    [problem] = [problem for problem in problems if problem.field == field]
    assert message in problem.message
    assert problem.path == str(path)
    lines = GOOD.split("\n")
    expected = lines.index(old) + 1 + (0 if new.startswith("live") else new.count("\n"))
    if message.startswith("needs the key"):
        expected = lines.index("    trajectory:") + 1
    assert problem.line == expected


def test_what_is_missing_is_reported_at_its_parent(path):
    [problem] = problems_in(path, GOOD.replace("position: [-10.0, 10]", "position: []"))
    assert (problem.field, problem.message) == ("axes.x.limits.position", "needs at least 2 values")
    [problem] = problems_in(path, GOOD.replace("      torque: 0.3\n", ""))
    assert (problem.line, problem.field) == (12, "axes.x.limits.torque")
    assert problem.message.startswith("is missing: ")
    [problem] = problems_in(path, GOOD.replace("          coulomb: 0.1\n          strib", "          strib"))
    assert (problem.line, problem.field) == (22, "axes.x.model.friction.parameters.coulomb")
    assert problem.message.startswith("lugre needs coulomb")
    [problem] = problems_in(path, GOOD.replace("    driver: fake\n", "    driver: unsimulated\n"))
    assert (problem.line, problem.field) == (43, "axes.x.simulation")
    assert "ascii, canopen, dynamixel, fake, modbus" in problem.message


@pytest.mark.parametrize("text", ["9" * 32_000 + "x", "0" * 32_000 + "x", "1" + ":00" * 10_000, "9" * 32_000 + ":00"])
def test_a_very_long_number_is_refused_without_a_long_search(path, text):
    started = time.process_time()
    [problem] = problems_in(path, GOOD.replace("period_s: 1e-3", f"period_s: {text}"))
    assert time.process_time() - started < 1.0  # a search in quadratic time takes several
    assert (problem.line, problem.field) == (2, "period_s")
    assert len(problem.message) < 200


def test_only_model_files_are_suggested_for_a_missing_one(tmp_path, path):
    text = re.sub(r"    model:\n(?:      .*\n)+", "    model: axes.yaml\n", GOOD, count=1)
    [problem] = problems_in(path, text)  # in axis.yaml itself, which is no model file
    assert "'friction-hil tune'" in problem.message
    assert "did you mean" not in problem.message
    (tmp_path / "axes1.yaml").write_text("axis: rotary\nfriction: {model: coulomb, parameters: {coulomb: 0.1}}\n")
    [problem] = problems_in(path, text)
    assert problem.message.endswith("did you mean 'axes1.yaml'?")


def test_a_model_file_that_is_not_there_yet_is_a_note(path):
    path.write_text(re.sub(r"    model:\n(?:      .*\n)+", "    model: later.yaml\n", GOOD, count=1))
    configuration = load(path, needs_models=False)
    [note] = missing_models(path, configuration)
    assert (note.line, note.field) == (18, "axes.x.model")
    assert str(path.parent / "later.yaml") in note.message
    (path.parent / "later.yaml").mkdir()  # a folder is no file that tune could write
    with pytest.raises(ConfigurationError, match="there is no model file"):
        load(path, needs_models=False)


def test_all_mistakes_are_reported_at_once(path):
    text = GOOD
    lines = set()
    for old, new in [
        ("period_s: 1e-3", "period_s: 0"),
        ("    node: 1", "    node: 0"),
        ("      torque: 0.3", "      torque: 0"),
        ("          sigma0: 2000", "          sigma0: 0"),
        ("          coulomb: 0.1", "          colomb: 0.1"),
        ("      - name: plain", "      - name: 3"),
        ("      rate_hz: 4000.0", "      rate_hz: x"),
        ("  priority: 0", "  priority: 0\n  priority: 1"),
    ]:
        text = text.replace(f"{old}\n", f"{new}\n", 1)
        lines.add(text.split("\n").index(new.split("\n")[-1]) + 1)
    problems = problems_in(path, text)
    assert {problem.line for problem in problems} == lines | {GOOD.split("\n").index("        parameters:") + 1}
    assert [problem.line for problem in problems] == sorted(problem.line for problem in problems)
    assert problems[-1].message.startswith("is given twice")


CONTROLLER = {"position_gain": 1.0, "velocity_gain": 1.0, "integral_hz": 0.0}
CST = {"axes__x__mode": "cst"}
SINE = {"kind": "sine", "amplitude": 1e-3, "frequency": 1.0}
TRIANGLE = {"kind": "triangle", "amplitude": 1.0, "frequency": 0.4}
EXPERIMENT = {"velocity": 3.0, "travel": 1.0}


@pytest.mark.parametrize(
    ("changes", "field", "message"),
    [
        ({"axes__x__trajectory": {"kind": "none"}}, "axes.x.trajectory.kind", "mode csp needs"),
        ({"axes__x__mode": "csv", "axes__x__trajectory": {"kind": "none"}}, "axes.x.trajectory.kind", "csv"),
        (CST, "axes.x.controller", "is missing"),
        ({"axes__x__controller": CONTROLLER}, "axes.x.controller", "modes cst"),
        ({**CST, "axes__x__trajectory": {"kind": "none"}}, "axes.x.limits.following_error", "set-point"),
        ({"axes__x__shadows": [good()["axes"]["x"]["shadows"][0]] * 2}, "axes.x.shadows[1]", "'plain' already"),
        ({"axes__x__model__friction__modifiers": {"a": {}}}, "axes.x.model.friction.modifiers.a", "no modifier 'a'"),
        ({"axes__y": good()["axes"]["x"]}, "axes.y.node", "has this node already"),
        ({"bus": None}, "axes.x.driver", "needs a bus"),
        ({"axes": {}}, "axes", "needs at least 1"),
        ({"axes__x__trajectory": {**TRIANGLE, "amplitude": 20.0}}, "axes.x.limits.velocity", "32"),
        ({"axes__x__trajectory__frequency": 5e-324}, "axes.x.trajectory.frequency", "at least 1e-05 .* 5000 Hz"),
        ({"bus__interface": "socketcan", "bus__channel": "can0"}, "bus.port", "no meaning"),
        ({"bus": {"interface": "pcan", "channel": "PCAN_USBBUS1", "timing": [1]}}, "bus.timing", "single value"),
        ({"bus": {"interface": "pcan", "channel": "PCAN_USBBUS1", "delay": math.nan}}, "bus.delay", "finite"),
        ({"bus": {"interface": "socketcan", "channel": "239.74.163.2"}}, "bus.channel", "for interface: udp_multicast"),
        ({"axes__x__limits__position": [-0.9, 0.9]}, "axes.x.trajectory.radius", "room for 0.9 at most"),
        ({"axes__x__trajectory": {**SINE, "frequency": 500.0}}, "axes.x.trajectory.frequency", "below half .*500 Hz"),
        ({"axes__x__experiment": {**EXPERIMENT, "travel": 100.0}}, "axes.x.experiment.travel", "100 .*room for 10 at"),
        ({"axes__x__experiment": {**EXPERIMENT, "duration_s": 36e3}}, "axes.x.experiment.duration_s", "at most 600 s"),
        (
            {"axes__x__trajectory": {"kind": "experiment", **EXPERIMENT, "duration_s": 36e3}},
            "axes.x.trajectory.duration_s",
            "at most 600 s",
        ),
        ({"axes__x__model": "x" * 300}, "axes.x.model", "there is no model file"),
        ({"axes__x__model": "no\0where/x"}, "axes.x.model", "there is no model file"),
    ],
)
def test_what_does_not_fit_together(changes, field, message):
    assert re.search(message, problems_of(changed(**changes))[field])


@pytest.mark.parametrize(
    "changes",
    [
        {"axes__x__mode": "cst", "axes__x__trajectory": {"kind": "none"}, "axes__x__limits__following_error": None},
        {"axes__x__mode": "cst", "axes__x__controller": CONTROLLER},
        {"axes__x__trajectory": {"kind": "hold"}},
        {"axes__x__mode": "csv", "axes__x__trajectory": {**SINE, "amplitude": 1.0}},
        {"axes__y": {**good()["axes"]["x"], "node": 2}},
        {"bus": {"interface": "socketcan", "channel": "can0", "bitrate": 1000000}},
        {"bus": {"interface": "kvaser", "channel": 0, "bitrate": 1000000, "single_handle": True}},
        {"recording": None, "realtime": None, "axes__x__simulation": None, "axes__x__shadows": None},
    ],
)
def test_what_fits_together(changes):
    given = changed(**changes)
    config = from_dict(given, "test")
    assert list(config.axes) == list(given["axes"])
    assert config.axes["x"].mode == given["axes"]["x"]["mode"]
    assert config.axes["x"].trajectory.kind == given["axes"]["x"]["trajectory"]["kind"]
    values = self_contained(config)
    assert self_contained(from_dict(values, "test")) == values


def test_further_keys_of_an_interface_are_kept_for_python_can():
    bus = {"interface": "kvaser", "channel": 0, "single_handle": True}
    assert from_dict(changed(bus=bus), "test").bus.further == {"single_handle": True}


def every_path(value, steps=()):
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield (*steps, key)
        yield from every_path(item, (*steps, key))


def place(values, steps):
    for step in steps:
        values = values[step]
    return values


@given(st.data())
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
def test_a_wrong_value_is_reported_in_its_own_line(tmp_path, data):
    values = good()
    paths = [steps for steps in every_path(values) if not isinstance(place(values, steps), dict | list)]
    steps = data.draw(st.sampled_from([each for each in paths if each != ("axes", "x", "shadows", 0, "name")]))
    place(values, steps[:-1])[steps[-1]] = {"what": "is this"}
    text = yaml.safe_dump(values, default_flow_style=False, sort_keys=False)
    problems = problems_in(tmp_path / "axis.yaml", text)
    node = yaml.compose(text)
    for step in steps:
        if isinstance(step, int):
            node = node.value[step]
            line = node.start_mark.line + 1
        else:
            [(name, node)] = [(name, value) for name, value in node.value if name.value == step]
            line = name.start_mark.line + 1
    reported = {problem.line for problem in problems}
    assert reported & {line, line + 1}, f"line {line}: {problems}"


WORDS = ["csp", "cst", "none", "fake", "broken", "coulomb", "1:30", "on", 1e-3, 1, 10**30, "axis.yaml"]
KEYS = st.sampled_from(["kind", "model", "axis", "friction", "parameters", "node", "name"]) | st.text(max_size=4)
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6) | st.sampled_from(WORDS),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=6,
)


@pytest.mark.deep
@given(st.data())
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=150)
def test_a_mutated_configuration_loads_or_has_mistakes_with_lines(tmp_path, data):
    values = good()
    for _ in range(data.draw(st.integers(1, 3))):
        steps = data.draw(st.sampled_from(list(every_path(values)) or [("axes",)]))
        kind = data.draw(st.sampled_from(["replace", "remove", "add"]))
        container = place(values, steps[:-1])
        if kind == "replace":
            container[steps[-1]] = data.draw(ANYTHING)
        elif kind == "remove":
            del container[steps[-1]]
        elif isinstance(container, dict):
            container[data.draw(st.text(max_size=5))] = data.draw(ANYTHING)
        else:
            container.append(data.draw(ANYTHING))
    text = dump(values)
    path = tmp_path / "mutated.yaml"
    path.write_text(text)
    configuration, problems = outcome(path)
    if configuration is not None:
        assert self_contained(from_dict(self_contained(configuration), "test")) == self_contained(configuration)
        return
    assert problems
    for problem in problems:
        assert problem.message
        if problem.path == str(path):
            assert 1 <= problem.line <= text.count("\n") + 1


@given(st.data())
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=100)
def test_a_mutated_text_loads_or_has_mistakes(tmp_path, data):
    raw = bytearray(GOOD.encode())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(raw) - 1))
        raw[at : at + data.draw(st.integers(0, 3))] = data.draw(
            st.binary(max_size=3) | st.sampled_from([b":", b"\n", b"  ", b"*", b"&a ", b"\t"])
        )
    path = tmp_path / "mutated.yaml"
    path.write_bytes(bytes(raw))
    configuration, problems = outcome(path)
    assert configuration is not None or problems


def test_what_is_self_contained_comes_back_without_files(tmp_path):
    (tmp_path / "models").mkdir()
    values = good()
    model = values["axes"]["x"]["model"]
    (tmp_path / "models" / "lugre_axis.yaml").write_text(dump({"version": 1, **model}))
    values["axes"]["x"]["model"] = "models/lugre_axis.yaml"
    named = {"name": "other", "model": "models/lugre_axis.yaml"}
    values["axes"]["x"]["shadows"] = ["models/lugre_axis.yaml", named, {"name": "inline", "model": model}]
    path = tmp_path / "axis.yaml"
    path.write_text(dump(values))
    configuration = load(path)
    axis = configuration.axes["x"]
    assert [shadow.name for shadow in axis.shadows] == ["lugre_axis", "other", "inline"]
    assert axis.model.source_path == tmp_path / "models" / "lugre_axis.yaml"
    assert [shadow.model.source_path is not None for shadow in axis.shadows] == [True, True, False]

    carried = json.loads(json.dumps(self_contained(configuration)))
    for file in (path, tmp_path / "models" / "lugre_axis.yaml"):
        file.unlink()
    again = from_dict(carried, "run.mcap")
    assert self_contained(again) == carried
    assert again.axes["x"].model.friction.parameters == {**model["friction"]["parameters"]}
    assert again.axes["x"].options == axis.options


def test_relative_paths_of_a_driver_start_from_the_configuration(path):
    path.write_text(GOOD.replace("    node: 1\n", "    node: 1\n    table: a.csv\n    wiring: {table: /b.csv}\n"))
    options = load(path).axes["x"].options
    assert options.table == path.parent / "a.csv"
    assert str(options.wiring.table) == "/b.csv"


def test_the_schema_names_a_broken_driver():
    with pytest.raises(UsageError, match="'broken'"):
        json_schema()
