"""What is said of a finished identification: torques that are turned, wrong, of other joints, or of an axis at rest."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from friction_hil import recordings
from friction_hil.cli import main
from friction_hil.errors import ConfigurationError
from friction_hil.identification import IdentificationSettings, identify
from friction_hil.identification.coupling import siblings
from friction_hil.identification.mechanics import find_mechanics
from friction_hil.identification.moving_beside import moving_beside
from friction_hil.identification.plausibility import Finding, check_result
from friction_hil.models.files import load_model_file
from friction_hil.recordings import Recording
from friction_hil.replay.comparison import replay

SHARED = Path(__file__).parents[4] / "shared" / "data"
EMPS, BAM = SHARED / "emps" / "DATA_EMPS.mat", SHARED / "bam_xl330"
needs_emps = pytest.mark.skipif(not EMPS.exists(), reason="the shared data are not here")
needs_bam = pytest.mark.skipif(not BAM.exists(), reason="the shared data are not here")
PERIOD_S = 0.01
TURNED = "the sign of the torque is turned"


def sines(time: np.ndarray, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    parts = zip(rng.uniform(0.1, 0.9, 4), rng.uniform(0.0, 6.0, 4), strict=True)
    return sum(0.6 / (i + 1) * np.sin(2.0 * np.pi * f * time + p) for i, (f, p) in enumerate(parts))


def arm(coupling: float = 0.0, *, torque: str = "torque") -> Recording:
    """The first of three joints, Coulomb friction 0.5; gravity and acceleration of the second reach it."""
    rng = np.random.default_rng(1)
    time = np.arange(3000) * PERIOD_S
    q = np.stack([sines(time, seed) for seed in range(3)], axis=1)
    v = np.gradient(q, PERIOD_S, axis=0)
    a = np.gradient(v, PERIOD_S, axis=0)
    own = 0.05 * a[:, 0] + 0.5 * np.sign(v[:, 0]) + 0.1 * v[:, 0] + 2.0 * np.sin(q[:, 0])
    own += coupling * (0.04 * a[:, 1] + 1.5 * np.sin(q[:, 0] + q[:, 1])) + 0.02 * rng.normal(size=len(time))
    columns = {"time_s": time, "position": q[:, 0], "velocity": v[:, 0], "q2": q[:, 1], "q3": q[:, 2]}
    columns |= {"tau1": own, "tau2": np.sin(3.0 * time), "tau3": rng.normal(size=len(time))}
    source = torque if torque in columns else "tau1"
    columns["torque"] = columns[source]
    return Recording("arm.csv", "arm", columns, sources={"position": "q1", "torque": source})


def moves(rate: int = 20, static: float = 0.9) -> Recording:
    """Moves from point to point, Coulomb friction 0.6; at rest static friction holds any torque up to ``static``."""
    rng = np.random.default_rng(0)
    time = np.arange(120_000) * 1e-3
    velocity, hold = np.zeros(len(time)), np.zeros(len(time))
    begin, side = 0, 1.0
    while begin < len(time):
        move, rest = int(rng.uniform(600, 1500)), int(rng.uniform(300, 1000))
        shape = side * rng.uniform(0.3, 1.5) * np.sin(np.pi * np.arange(move) / move) ** 2
        velocity[begin : begin + move] = shape[: len(time) - begin]
        hold[begin + move : begin + move + rest] = rng.uniform(-static, static)
        begin, side = begin + move + rest, -side
    position = np.cumsum(velocity) * 1e-3
    torque = 0.2 * np.gradient(velocity, 1e-3) + 0.6 * np.sign(velocity) + 0.2 * velocity + np.sin(position) + hold
    torque += 0.03 * rng.normal(size=len(time))
    rows = slice(None, None, 1000 // rate)
    return Recording("moves.csv", "x", {"time_s": time[rows], "position": position[rows], "torque": torque[rows]})


def findings(recording: Recording, **settings: Any) -> list[Finding]:
    content: dict[str, Any] = {"families": ("coulomb",), "has_modifiers": False, **settings}
    result = identify([recording], IdentificationSettings(**content))
    return check_result(result, [recording])


def text_of(found: list[Finding]) -> str:
    return "\n".join(each.text for each in found)


def with_torque(torque: Any, recording: Recording | None = None) -> Recording:
    recording = arm() if recording is None else recording
    recording.columns["torque"] = torque(recording) if callable(torque) else torque
    return recording


def test_nothing_is_said_of_a_sound_model() -> None:
    assert findings(arm()) == []
    assert findings(moves(static=0.0), least_speed=0.1) == []


@pytest.mark.parametrize(
    ("sources", "option"),
    [
        ({"position": "q1"}, "--scale torque=-1"),
        ({"torque": "tau1"}, "--scale torque=-1"),
        ({"torque": "torque*-1"}, "leave out the factor -1"),
        ({"torque": "vir*35.15"}, "--column torque='vir*-35.15'"),
        ({"torque": "vir*-35.15"}, "--column torque='vir*35.15'"),
    ],
)
def test_a_turned_torque_is_named_with_the_option_that_turns_it(sources, option):
    recording = with_torque(lambda one: -one["torque"])
    recording.sources = sources
    found = findings(recording, gravity="pendulum")
    assert found[0].is_fatal
    assert option in text_of(found)
    assert TURNED in text_of(found)


def test_a_turned_torque_is_found_where_gravity_is_most_of_it():
    """Gravity has no sign that is known; the error of the model alone would not tell."""
    recording = with_torque(lambda one: -one["torque"] + 8.0 * np.cos(one["position"]))
    result = identify([recording], IdentificationSettings(families=("coulomb",), gravity="pendulum"))
    assert result.best.held_out.relative_error < 0.3
    (finding,) = check_result(result, [recording])
    assert finding.is_fatal
    assert TURNED in finding.text


@pytest.mark.parametrize("frequencies", [(0.7,), (0.3, 1.1)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_spring_is_not_taken_for_a_turned_torque(frequencies: tuple[float, ...], sign: float) -> None:
    """In a swing about one place its torque is that of a negative inertia; friction tells the sign."""
    time = np.arange(3000) * PERIOD_S
    position = sum(0.1 * np.sin(2.0 * np.pi * f * time) for f in frequencies)
    velocity = np.gradient(position, PERIOD_S)
    torque = 5.0 * position + 0.1 * np.sign(velocity) + 0.02 * np.gradient(velocity, PERIOD_S)
    torque += 0.01 * np.random.default_rng(0).normal(size=len(time))
    recording = Recording("spring.csv", "x", {"time_s": time, "position": position, "torque": sign * torque})
    assert (TURNED in text_of(findings(recording))) == (sign < 0.0)


def test_a_torque_that_has_nothing_to_do_with_the_motion_makes_no_model():
    """A constant one too, however small its error is."""
    constant = with_torque(lambda one: 7.0 + 0.1 * np.random.default_rng(2).normal(size=len(one)))
    for found in (findings(arm(torque="tau3")), findings(constant, gravity="none")):
        assert found[0].is_fatal
        assert "explains nothing" in found[0].text
    assert "tau1 fits the motion" in text_of(findings(arm(torque="tau3")))


def test_an_axis_without_friction_has_no_model():
    recording = with_torque(lambda one: 0.5 * np.gradient(one["velocity"], PERIOD_S))
    assert "has no friction" in text_of(findings(recording, gravity="none"))
    recording.columns["torque"] += 0.05 * recording["velocity"]
    assert findings(recording, gravity="none") == []


def test_an_unsigned_register_is_named():
    recording = with_torque(lambda one: np.round(100.0 * one["torque"]) % 65536.0)
    recording.sources["torque"] = "load"
    text = text_of(findings(recording))
    assert "register of 16 bits" in text
    assert "--column torque='load:int16'" in text


def test_a_coupled_arm_is_not_one_axis() -> None:
    (finding,) = findings(arm(coupling=1.0))
    assert not finding.is_fatal
    assert "not one of a single axis: the motion of q2 explains" in finding.text
    assert "q3" not in finding.text


@pytest.mark.parametrize(("coupling", "moves"), [(0.0, "elbow"), (1.0, "elbow"), (1.0, "wrist")])
def test_another_axis_of_the_machine_is_named_if_the_torque_follows_its_motion(coupling: float, moves: str) -> None:
    recording = arm(coupling)
    columns = {"time_s": recording["time_s"], "position": recording["q2" if moves == "elbow" else "q3"]}
    beside = {recording.path: {moves: Recording(recording.path, moves, columns)}}
    result = identify([recording], IdentificationSettings(families=("coulomb",), has_modifiers=False))
    found = moving_beside(result, beside)
    mechanics = find_mechanics([recording], result, disturbed=found)
    assert bool(found) == (coupling > 0.0 and moves == "elbow")
    assert not moving_beside(result, {})
    if found:
        assert found.startswith("the motion of elbow explains ")
        assert all(each.value is None and each.missing == found for each in mechanics.quantities)
        assert mechanics.load is None
    elif not coupling:
        assert {each.key: each.value for each in mechanics.quantities}["inertia"] is not None


def test_rest_in_a_slow_recording_is_left_out_by_a_speed_that_helps() -> None:
    text = text_of(findings(moves()))
    assert "try --min-speed" in text
    speed = float(text.rpartition("--min-speed ")[2])
    wanted = IdentificationSettings(families=("coulomb",), has_modifiers=False)
    before, after = (identify([moves()], replace(wanted, least_speed=each)).best for each in (0.0, speed))
    assert abs(before.values["coulomb"] - 0.6) > 0.15
    assert after.values["coulomb"] == pytest.approx(0.6, abs=0.1)
    assert after.held_out.relative_error < 0.5 * before.held_out.relative_error


def test_presliding_in_a_fast_recording_is_not_left_out() -> None:
    """It takes a dynamic model, which the rows at rest determine."""
    assert "--min-speed" in text_of(findings(moves(rate=250)))
    assert "--min-speed" not in text_of(findings(moves(rate=500)))


@pytest.mark.parametrize(
    ("name", "there", "expected"),
    [
        ("q1", ["q2", "q3", "dq1", "tau2", "time_s"], ["q2", "q3"]),
        ("q[:,3]", ["q[:,0]", "q[:,1]", "tau[:,0]"], ["q[:,0]", "q[:,1]"]),
        ("shoulder_position", ["elbow_position", "shoulder_velocity"], ["elbow_position"]),
        ("position_measured", ["position_demand", "position_raw"], []),
        ("qm", ["qg", "vir"], []),
    ],
)
def test_siblings_are_named_alike_but_for_the_joint(name: str, there: list[str], expected: list[str]) -> None:
    assert siblings(name, there) == expected


def test_command_fails_and_writes_no_model_that_explains_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    recording = with_torque(lambda one: -one["torque"])
    recordings.write(tmp_path / "arm.csv", recording)
    words = ["identify", "arm.csv", "--models", "coulomb", "--output", "axis.yaml"]
    assert main([*words, "--report", "axis.html"]) == 1
    printed = capsys.readouterr()
    assert "No usable model; the best candidate is coulomb" in printed.out
    assert "--scale torque=-1." in printed.out
    assert "Chosen" not in printed.out
    assert "axis.yaml is not written" in printed.err
    assert not Path("axis.yaml").exists()
    assert TURNED in Path("axis.html").read_text()
    assert main([*words, "--scale", "torque=-1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["is_usable"], document["findings"], document["output"]) == (True, [], "axis.yaml")
    model = load_model_file("axis.yaml")
    assert model.friction.parameters["coulomb"] == pytest.approx(0.5, abs=0.05)


def test_what_speaks_against_a_model_is_kept_in_its_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    recording = arm(coupling=1.0)
    recording.columns["q1"] = recording.columns.pop("position")
    recordings.write(tmp_path / "arm.csv", recording)
    words = ["identify", "arm.csv", "--models", "coulomb", "--column", "position=q1", "--output", "axis.yaml"]
    assert main(words) == 0
    assert "! This recording is not one of a single axis: the motion of q2" in capsys.readouterr().out
    model = load_model_file("axis.yaml")
    assert any("the motion of q2" in flag for flag in model.fit["flags"])


@needs_emps
def test_the_force_of_a_real_axis_with_its_sign_turned(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["identify", str(EMPS), "--linear", "--models", "coulomb", "--column", "time_s=t"]
    words += ["--column", "position=qm", "--column", "torque=vir*-35.150651", "--decimate", "40", "--json"]
    assert main(words) == 1
    document = json.loads(capsys.readouterr().out)
    assert (document["is_usable"], document["output"]) == (False, None)
    assert any("give --column torque='vir*35.150651'" in each for each in document["findings"])


@needs_bam
def test_the_register_of_a_real_servo_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["identify", str(BAM / "*.json"), "--models", "coulomb", "--column", "time_s=timestamp"]
    words += ["--column", "torque=load", "--lowpass", "10", "--decimate", "4"]
    assert main(words) == 1
    assert "--column torque='load:int16'" in capsys.readouterr().out


def test_gain_and_back_emf_of_a_model_apply_to_its_signal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The prediction is that of the same model in N m for the torque gain u - back_emf v."""
    monkeypatch.chdir(tmp_path)
    gain, back_emf = 0.2, 0.3
    content = "axis: rotary\nfriction: {model: coulomb, parameters: {coulomb: 0.4, viscous: 0.1}}\n"
    content += "mechanics: {inertia: 0.04, gravity: {sine: 2.0}}\n"
    Path("torque.yaml").write_text(content)
    Path("signal.yaml").write_text(content + f"torque_signal: {{gain: {gain}, back_emf: {back_emf}}}\n")
    Path("old.yaml").write_text(content + f"fit: {{drive: {{gain: {gain}, back_emf: {back_emf}}}}}\n")
    recording = arm()
    volts = Recording("v.csv", "x", dict(recording.columns))
    volts.columns["torque"] = (recording["torque"] + back_emf * recording["velocity"]) / gain
    files = {name: load_model_file(name) for name in ("torque.yaml", "signal.yaml", "old.yaml")}
    (expected,) = replay(recording, {"torque.yaml": files["torque.yaml"]}).predictions
    for name in ("signal.yaml", "old.yaml"):
        (found,) = replay(volts, {name: files[name]}).predictions
        assert found.rmse == pytest.approx(expected.rmse)
        np.testing.assert_allclose(found.measured - found.torque, expected.measured - expected.torque, atol=1e-9)
        relative = np.linalg.norm(found.measured - found.torque) / np.linalg.norm(gain * volts["torque"])
        assert found.relative_error == pytest.approx(relative)


def test_the_daemons_recordings_are_in_torque_whatever_the_model_came_from(tmp_path: Path) -> None:
    path = tmp_path / "signal.yaml"
    path.write_text(
        "axis: rotary\nfriction: {model: coulomb, parameters: {coulomb: 0.5}}\n"
        "torque_signal: {column: volts, gain: 0.2, back_emf: 0.1}\n"
    )
    model = {"m": load_model_file(path)}
    recording = arm()
    foreign = replay(recording, model)
    assert any("belongs to the signal volts; it is applied to tau1" in problem for problem in foreign.problems)
    recording.metadata["configuration"] = {}
    own = replay(recording, model)
    np.testing.assert_array_equal(own.predictions[0].measured, own.measured)
    assert not own.problems


@pytest.mark.parametrize(
    ("line", "field"),
    [("torque_signal: {gain: -0.2}", "torque_signal.gain"), ("fit: {drive: {gain: fast}}", "fit.drive.gain")],
)
def test_a_gain_that_is_no_number_above_zero_is_refused(tmp_path, line, field):
    path = tmp_path / "signal.yaml"
    path.write_text(f"axis: rotary\nfriction: {{model: coulomb, parameters: {{coulomb: 0.5}}}}\n{line}\n")
    with pytest.raises(ConfigurationError, match=rf"signal.yaml:3: {field}"):
        load_model_file(path)
