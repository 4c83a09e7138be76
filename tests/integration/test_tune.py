"""`friction-hil tune` against simulated drives of every kind: real processes, simulated time."""

import json
import os
import pty
import re
import signal
import subprocess

import can
import numpy as np
import pytest
import yaml
from friction_hil_drivers.canopen.wire import cia301

import friction_hil as fh
from friction_hil.config import load
from friction_hil.daemon.safety import LoopState
from friction_hil.models.files import load_model_file
from tests import arm_machine
from tests.launcher import COMMAND
from tests.peers.serial_processes import write_serial_configuration
from tests.processes import (
    listening,
    run,
    simulated_drives,
    start_daemon,
    wait_for_frames,
    write_configuration,
)
from tests.servo_drives import TRUE_FRICTION, axis_dict

pytestmark = pytest.mark.deep

SPEED, TRAVEL = 4.0, 1.0
REPORTED = 0.85  # of the commanded torque, by a drive with an error in its feedback
ONE = ("--axis", "x")
UNASKED = ("--pace", "sync", "--yes")
EXPERIMENT = {"velocity": SPEED, "travel": TRAVEL, "duration_s": 10.0, "ramp_s": 0.25}
AXIS = {
    "model": "learned.yaml",
    "experiment": EXPERIMENT,
    "limits": {"torque": 0.3, "torque_slew": 300.0, "velocity": 30.0, "following_error": 2.0},
    "trajectory": {"kind": "sine", "amplitude": 0.25, "frequency": 1.0, "ramp_s": 0.25},
}
OWN_LOOPS = {"mode": "cst", "controller": {"position_gain": 15.0, "velocity_gain": 0.03, "integral_hz": 1.0}}


SERVO = {
    **{"driver": "dynamixel", "description": "xl330", "id": 1, "torque_constant": 0.2},
    **dict.fromkeys(("unit", "counts_per_unit", "rated_torque")),
}


STILL = {"node": 2, "trajectory": {"kind": "sine", "amplitude": 0.3, "frequency": 1.0}}


def configured(kind, folder, period_s=4e-3, **changes):
    """``period_s`` is that of CANopen; a serial line has its own."""
    if kind == "canopen":
        return write_configuration(folder, period_s=period_s, x={**AXIS, **changes}, y=STILL)
    own = SERVO if kind == "dynamixel" else {}
    return write_serial_configuration(folder, "modbus rtu" if own else kind, **{**AXIS, **OWN_LOOPS, **own, **changes})


def tuned(configuration, *options, check=True):
    """Tune against drives of their own; return the JSON and the process."""
    folder = configuration.parent / "tuned"
    with simulated_drives(configuration):
        done = run("tune", configuration, *ONE, *UNASKED, "--output", folder, "--json", "-v", *options, check=check)
    return (json.loads(done.stdout) if done.stdout else None), done


@pytest.mark.parametrize("kind", ["canopen", "dynamixel"])
def test_an_axis_learns_its_friction_on_its_drive(kind, tmp_path) -> None:
    if kind == "dynamixel":
        pytest.importorskip("dynamixel_sdk", reason="the extra 'dynamixel' is not installed")
    configuration = configured(kind, tmp_path)
    is_shaken = kind == "canopen"

    result, done = tuned(configuration, "--models", "coulomb", *(["--mechanics"] if is_shaken else []))

    learned = load_model_file(tmp_path / "learned.yaml")
    friction = learned.friction_model.parameters
    assert 0.8 * TRUE_FRICTION["coulomb"] < friction["coulomb"] < TRUE_FRICTION["static"]
    x = result["axes"]["x"]
    lag = x["torque_lag"]
    assert lag["value_s"] == pytest.approx(learned.mechanics.torque_lag_s, rel=1e-5)
    assert lag["is_replaced"] == (not lag["reason"])
    assert (x["in_place"], x["file"]) == (True, str(tmp_path / "learned.yaml"))
    took = x["experiment"]
    assert (took["duration_s"], took["parts_s"]) == (10.0, [10.0])
    assert took["reason"].startswith("the configured duration is over: ")
    [tried] = x["tried"]
    assert tried["reduction"]["rms"] > 2.0
    assert learned.fit["trial"] == {name: tried[name] for name in ("uncompensated", "compensated", "motions")}
    assert tried["motions"]["own"]["reduction"] == tried["reduction"]
    own = tried["motions"]["own"]
    assert (own["is_worse"], own["is_swinging"]) == (False, False)
    assert "x moves by up to 1 rad to either side of where it stands, at up to 4 rad/s (stopped above 6 " in done.stderr
    assert "x moves between -0.85 and 0.85 rad from where it stands, at up to 4 rad/s (stopped above 6 " in done.stderr
    assert "  own: sine between -0.25 and 0.25 rad, at up to 1.57 rad/s, for " in done.stderr
    if kind == "canopen":
        assert ", once: without compensation, while the models are computed" in done.stderr
        assert ", once: compensated by coulomb" in done.stderr
    else:  # in cst the loop needs a model for it
        assert "2 times: without compensation, compensated by coulomb" in done.stderr
    seconds = result["seconds"]
    assert seconds["motion_s"] > took["duration_s"]
    assert min(seconds["computing_between_s"], seconds["computing_after_s"]) > 0.0
    assert [path.name for path in sorted((tmp_path / "tuned").iterdir())] == [
        "report.html",
        "trial_1.mcap",
        *(f"trial_gain_{k}.mcap" for k in range(1, len(x["gains"]))),
        "trial_without.mcap",
        "x.yaml",
        "x_experiment.mcap",
        "x_identification.html",
        *(["x_shaken.mcap"] if is_shaken else []),
    ]
    if is_shaken:  # a rigid axis, of which nothing else is made
        assert "strokes of constant speed, shaken by up to " in done.stderr
        assert "anti-resonance, resonance" in done.stderr
        assert re.search(r"no resonance from \d+ to 100 Hz", done.stderr)
        assert "load" not in x["mechanics"]

    experiment = fh.recordings.read(tmp_path / "tuned" / "x_experiment.mcap", "x")
    way = experiment["position"] - experiment["position"][0]
    assert float(np.max(np.abs(way))) <= TRAVEL
    assert float(np.nanmax(np.abs(experiment["velocity_demand"]))) <= SPEED * (1.0 + 1e-9)
    assert not experiment["compensation"].any()

    if kind == "canopen":  # a second axis is on the bus
        assert "; y held" in done.stderr
        for name in ("x_experiment", "trial_without", "trial_1"):
            y = fh.recordings.read(tmp_path / "tuned" / f"{name}.mcap", "y")
            assert float(np.ptp(y["position"])) < 1e-4
            assert not y["command"].any()

    # what the JSON says is what the recordings show: over all of the trial the error is as many times lower
    errors = {}
    for name, is_compensated in (("trial_without", False), ("trial_1", True)):
        trial = fh.recordings.read(tmp_path / "tuned" / f"{name}.mcap", "x")
        is_running = trial["state"] == LoopState.RUNNING
        assert set(trial["is_enabled"][is_running]) == {float(is_compensated)}
        way = trial["position_demand"][is_running] - trial["position_demand"][is_running][0]
        assert float(np.max(np.abs(way))) <= TRAVEL
        errors[name] = (trial["position_demand"] - trial["position"])[is_running]
    before, after = (float(np.sqrt(np.mean(each**2))) for each in errors.values())
    reductions = [motion["reduction"]["rms"] for motion in tried["motions"].values()]
    assert min(reductions) < before / after < max(reductions)


def test_of_two_kinds_of_model_the_machine_decides_and_a_file_that_is_there_stays(tmp_path) -> None:
    present = "version: 1\naxis: rotary\nfriction: {model: coulomb, parameters: {coulomb: 0.02}}\n"
    (tmp_path / "learned.yaml").write_text(present + "mechanics: {torque_lag_s: 4e-4}\n")
    configuration = configured("canopen", tmp_path, period_s=2e-3)

    result, _ = tuned(configuration, "--models", "coulomb,lugre")

    x = result["axes"]["x"]
    assert len(x["tried"]) == 2
    used = [each for each in x["tried"] if each["model"] == x["model"]]
    assert [each["has_helped"] for each in used] == [True]
    motions = {each["model"]: list(each["motions"].values()) for each in x["tried"]}
    harm = {name: any(motion["is_swinging"] for motion in found) for name, found in motions.items()}
    assert not harm[x["model"]]
    assert [list(each["motions"]) for each in x["tried"]] == [["own", "slow", "small", "tiny", "rests", "fast"]] * 2
    for baseline in zip(*motions.values(), strict=True):
        assert baseline[0]["uncompensated"] == baseline[1]["uncompensated"], "recorded once"
    assert (x["in_place"], x["file"]) == (False, str(tmp_path / "tuned" / "x.yaml"))
    assert (tmp_path / "learned.yaml").read_text().startswith(present)
    assert load_model_file(x["file"]).mechanics.torque_lag_s == 4e-4
    assert x["mechanics"]["inertia"] == pytest.approx(2e-4, rel=0.15)

    # and the daemon runs with the new one as it is
    configuration.write_text(configuration.read_text().replace("learned.yaml", "tuned/x.yaml"))
    with simulated_drives(configuration):
        run("run", configuration, "--pace", "sync", "--duration", 0.5)


def test_a_static_model_is_learned_where_the_axis_slides(tmp_path) -> None:
    """Of a linear axis whose fast sweeps hardly leave presliding, which no map of the velocity explains.

    Its drive reports less than the torque that it is commanded, which the trial shows.
    """
    linear = {
        "experiment": {"velocity": 0.5, "travel": 0.2, "duration_s": 10.0, "ramp_s": 0.25, "axis": "linear"},
        "simulation": {
            "mechanics": {"axis": "linear"},
            "encoder": {"counts": 1_000_000},
            "torque_feedback": {"gain": REPORTED},
        },
        "trajectory": {"kind": "sine", "amplitude": 0.05, "frequency": 1.0, "ramp_s": 0.25},
    }
    configuration = configured("canopen", tmp_path, **linear, counts_per_unit=1e6, rated_torque=0.64)

    result, _ = tuned(configuration, "--models", "coulomb")

    assert 0.8 * TRUE_FRICTION["coulomb"] < result["axes"]["x"]["parameters"]["coulomb"] < TRUE_FRICTION["static"]
    x = result["axes"]["x"]
    assert [each["model"] for each in x["tried"]] == ["coulomb", "coulomb, scaled"]
    assert x["model"] == "coulomb, scaled"
    plain, scaled = (each["reduction"]["rms"] for each in x["tried"])
    assert scaled > max(1.1 * plain, 2.0)
    ratio = x["torque_ratio"]
    assert ratio["is_other"]
    assert ratio["estimate"] == pytest.approx(REPORTED, abs=3.0 * ratio["standard_error"])
    learned = load_model_file(x["file"])
    assert learned.mechanics.torque_ratio == pytest.approx(ratio["estimate"], rel=1e-5)
    assert learned.fit["standard_errors"]["torque_ratio"] == pytest.approx(ratio["standard_error"], rel=1e-5)


def test_a_model_that_does_not_help_is_not_put_to_use(tmp_path) -> None:
    """By Modbus: what is learned is right there too, and with a gain of zero it takes nothing away.

    Then little has to be known, and the experiment ends early.
    """
    experiment = {**EXPERIMENT, "duration_s": 60.0}
    compensation = {"gain": 0.0, "fade_s": 0.1}
    configuration = configured("modbus rtu", tmp_path, compensation=compensation, experiment=experiment)

    with simulated_drives(configuration):
        tuning = ("tune", configuration, *UNASKED, "--output", tmp_path / "tuned", "--models", "coulomb", "-v")
        done = run(*tuning, check=False)

    assert done.returncode == 1
    assert "x: compensation did not help" in done.stderr
    assert ("(kept)" in done.stdout, "recommended:" in done.stdout, "it did not help" in done.stdout) == (
        False,
        False,
        True,
    )
    assert "for at most 6" in done.stderr
    assert "it moves in parts of 15, 15, 30 s, as many as needed" in done.stderr
    ended = "x: the experiment took 30 s of 60 s in 2 parts: stopped early: "
    assert ended in done.stderr
    assert ended in " ".join(done.stdout.split())
    files = {path.name for path in (tmp_path / "tuned").glob("x_experiment*.mcap")}
    assert files == {"x_experiment_1.mcap", "x_experiment_2.mcap"}
    assert not (tmp_path / "learned.yaml").exists()
    friction = load_model_file(tmp_path / "tuned" / "x.yaml").friction_model.parameters
    assert 0.8 * TRUE_FRICTION["coulomb"] < friction["coulomb"] < TRUE_FRICTION["static"]


def test_mistakes_are_reported_before_anything_moves(tmp_path) -> None:
    configuration = configured("canopen", tmp_path, experiment=None)
    data = yaml.safe_load(configuration.read_text())
    del data["axes"]["x"]["experiment"]
    configuration.write_text(yaml.safe_dump(data))

    missing = run("tune", configuration, *ONE, *UNASKED, check=False)
    nobody = run("tune", configuration, *UNASKED, "--axis", "z", check=False)
    data["axes"]["x"]["experiment"] = EXPERIMENT
    configuration.write_text(yaml.safe_dump(data))
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "notes.txt").touch()
    used = run("tune", configuration, *ONE, *UNASKED, "--output", tmp_path / "used", check=False)
    unasked = run("tune", configuration, "--pace", "sync", check=False, stdin=subprocess.DEVNULL)
    unfitted = run("tune", configuration, *UNASKED, "--models", "coulom", check=False)
    data["axes"]["x"]["model"] = "models/learned.yaml"
    configuration.write_text(yaml.safe_dump(data))
    nowhere = run("tune", configuration, *UNASKED, check=False)

    assert re.search(
        r"axes\.yaml:\d+: axes\.x\.experiment: is missing: it says how far",
        missing.stderr,
    )
    assert "no axis is called 'z'" in nobody.stderr
    assert "is not empty" in used.stderr
    assert "--yes" in unasked.stderr
    assert "no friction model is called 'coulom'" in unfitted.stderr
    assert re.search(r"axes\.yaml:\d+: axes\.x\.model: there is no folder .*models to make it in", nowhere.stderr)
    for each in (missing, nobody, used, unasked, unfitted, nowhere):
        assert (each.returncode, "moves by" in each.stderr) == (2, False)


def test_a_drive_in_fault_is_tuned_only_if_its_fault_may_be_reset(tmp_path) -> None:
    configuration = configured("canopen", tmp_path, model=axis_dict()["model"])
    tuning = ("tune", configuration, *ONE, *UNASKED, "--models", "coulomb", "--json", "--output")
    with simulated_drives(configuration), listening(configuration) as bus:
        daemon = start_daemon(configuration)
        wait_for_frames(bus, cia301.SYNC_ID, 400)
        daemon.kill()
        daemon.communicate(timeout=60)
        while bus.recv(0.1) is not None:  # unread frames would fill the socket and push answers out
            pass
        for _ in range(400):  # the drive's time passes by them, until it misses the daemon
            bus.send(can.Message(arbitration_id=cia301.SYNC_ID, is_extended_id=False))
            while bus.recv(0.001) is not None:
                pass
        refused = run(*tuning, tmp_path / "refused", check=False)
        done = run(*tuning, tmp_path / "tuned", "--reset-fault")

    assert refused.returncode == 1
    assert re.search(
        r"x: the drive is in fault: .*; --reset-fault leaves it \[FH-105\]; nothing has moved", refused.stderr
    )
    assert not (tmp_path / "refused").exists(), "there is no run to look at"
    assert json.loads(done.stdout)["axes"]["x"]["tried"][0]["reduction"]["rms"] > 2.0


def test_an_axis_that_swings_by_itself_is_not_identified(tmp_path) -> None:
    hot = {"mode": "cst", "controller": {"position_gain": 30.0, "velocity_gain": 0.03, "integral_hz": 1.0}}
    configuration = write_serial_configuration(tmp_path, "modbus rtu", **{**AXIS, **hot}, period_s=8e-3)

    _, done = tuned(configuration, "--models", "coulomb", check=False)

    assert done.returncode == 1
    assert re.search(
        r"x: (the drive reports a )?velocity .* is beyond its limit of 6 rad/s, 1.5 times the 4 ", done.stderr
    )
    assert "a loop that swings needs a lower velocity_gain" in done.stderr
    assert not (tmp_path / "learned.yaml").exists()


def test_an_axis_that_falls_before_its_drive_is_enabled_needs_a_brake(tmp_path) -> None:
    weight = {"simulation": {**AXIS.get("simulation", {}), "mechanics": {"load_torque": 0.2}}}

    _, done = tuned(configured("canopen", tmp_path, **weight), "--models", "coulomb", check=False)

    assert done.returncode == 1
    assert "x moved before the drive was enabled, so that a load turns the axis" in done.stderr
    assert "has_brake: true" in done.stderr
    assert "a loop that swings" not in done.stderr


@pytest.mark.parametrize("answer", [b"n\n", b"\n"])
def test_nobody_moves_before_the_user_says_so(answer, tmp_path) -> None:
    """On a terminal: the motion is shown, and whatever is not "yes" ends it."""
    configuration = configured("canopen", tmp_path)
    terminal, of_process = pty.openpty()
    with simulated_drives(configuration):
        asked = subprocess.Popen(
            [*COMMAND, "tune", str(configuration), *ONE, "--output", str(tmp_path / "tuned")],
            stdin=of_process,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        os.close(of_process)
        os.write(terminal, answer)
        _, said = asked.communicate(timeout=60)
        os.close(terminal)

    assert re.match(r"x moves by up to .*\nIs the way clear\? \[y/N\]", said)
    assert asked.returncode == 130
    assert not (tmp_path / "tuned" / "x_experiment.mcap").exists()


def test_ctrl_c_while_it_moves_brings_the_axis_to_rest(tmp_path) -> None:
    configuration = configured("canopen", tmp_path, experiment={**EXPERIMENT, "duration_s": 600.0})
    recording = tmp_path / "tuned" / "x_experiment_1.mcap"
    with simulated_drives(configuration):
        moving = subprocess.Popen(
            [*COMMAND, "tune", str(configuration), *ONE, *UNASKED, "-v", "--output", str(tmp_path / "tuned")],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for line in moving.stderr:
            if "watches the daemon" in line:
                break
        while not (recording.exists() and recording.stat().st_size > 20_000):
            assert moving.poll() is None
        moving.send_signal(signal.SIGINT)
        _, errors = moving.communicate(timeout=60)

    assert moving.returncode == 130
    assert "Traceback" not in errors
    assert "stopped, the axes are at rest; the results so far are in" in errors
    stopped = fh.recordings.read(recording, "x")
    assert stopped["state"][-1] == LoopState.DISABLING
    assert abs(stopped["velocity_estimate"][-1]) < 0.05
    assert not (tmp_path / "learned.yaml").exists()


def test_check_and_doctor_do_without_the_model_that_tuning_makes(tmp_path) -> None:
    configuration = configured("canopen", tmp_path, experiment={**EXPERIMENT, "axis": "rotary"})
    findings = json.loads(run("doctor", configuration, "--json", check=False).stdout)
    checked = run("config", "check", configuration, check=False)

    assert {"check": "x: model", "result": "warn"}.items() <= next(
        each for each in findings if each["check"] == "x: model"
    ).items()
    assert (checked.returncode, checked.stderr) == (0, "")
    assert "learned.yaml; 'friction-hil tune' identifies" in checked.stdout
    assert load(configuration, needs_models=False).axes["x"].model.source_path == tmp_path / "learned.yaml"


def test_joints_of_an_arm_learn_their_friction_beside_its_weight(tmp_path):
    """The shoulder hangs down and its experiment shows little weight; the trial bends the arm."""
    changes = {}
    for name, speed, radius in (("shoulder", 1.5, 0.4), ("elbow", 2.5, 0.6)):
        changes[f"axes__{name}__model"] = f"{name}.yaml"
        changes[f"axes__{name}__experiment"] = {"velocity": speed, "travel": 1.2, "duration_s": 10.0, "ramp_s": 0.25}
        motion = {"kind": "circle", "radius": radius, "frequency": 1.0, "ramp_s": 0.25}
        changes[f"axes__{name}__trajectory"] = motion
        changes[f"axes__{name}__compensation"] = {"gain": 1.0, "fade_s": 0.1}
    box, folder = [[-0.6, -0.1, -0.8], [0.6, 0.1, 0.1]], tmp_path / "tuned"
    path = arm_machine.write(tmp_path, arm_machine.ARM | {"box": [[-0.1, *box[0][1:]], box[1]]}, **changes)
    refused = run("tune", path, "--simulate", *UNASKED, "--models", "coulomb", "--output", folder, check=False)
    assert refused.returncode == 2
    assert "the trial: the origin of joint2 would be at" in refused.stderr
    assert not folder.exists(), "nothing has moved"
    path = arm_machine.write(tmp_path, arm_machine.ARM | {"box": box}, **changes)
    done = run("tune", path, "--simulate", *UNASKED, "--models", "coulomb", "--output", folder, "--json")
    result = json.loads(done.stdout)
    truth = load(arm_machine.MACHINE).axes
    for name, joint in zip(arm_machine.NAMES, result["arm"]["arm"]["joints"], strict=True):
        friction, gear = truth[name].simulation.friction.parameters, truth[name].simulation.gear
        assert joint["values"]["coulomb"] == pytest.approx(friction["coulomb"], rel=0.05)
        losses = 0.5 * (1.0 / gear.forward_efficiency - gear.backward_efficiency)
        assert joint["values"]["load"] == pytest.approx(losses, rel=0.15)
        assert (folder / f"arm_{name}.yaml").exists()
        found = result["axes"][name]
        assert found["tried"][0]["reduction"]["rms"] > 2.0
        assert found["mechanics"]["gravity"] == {"constant": 0.0, "sine": 0.0, "cosine": 0.0}
        fitted = load_model_file(folder / f"{name}.yaml").fit["recordings"]
        assert [each["path"] for each in fitted] == [str(folder / f"{name}_experiment.mcap")], "alone, not the trial"
        assert found["arm"]["inertia"] == pytest.approx(found["arm"]["inertia_of_file"], rel=0.2)
        assert not found["arm"]["contradictions"]
        experiment = fh.recordings.read(folder / f"{name}_experiment.mcap", name)
        assert not experiment["command"].any()
        trial = fh.recordings.read(folder / "trial_1.mcap", name)
        assert np.abs(trial["feedforward"] - trial["compensation"]).max() > 0.5, "the arm's torque"
        without = fh.recordings.read(folder / "trial_without.mcap", name)
        assert not without["command"].any()
