"""Friction of an arm's joints from one log, with MuJoCo as the arm: levels, load, intervals, and what a log lacks."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import signal

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.errors import RecordingError, UsageError
from friction_hil.identification.arm_fit import combinations, identify_arm
from friction_hil.recordings import Recording
from tests import simulated_arm as simulated

PENDULUMS = Path(__file__).parents[4] / "shared" / "data" / "ak80_6"
needs_pendulums = pytest.mark.skipif(not PENDULUMS.exists(), reason="the shared data are not here")
N = len(simulated.NAMES)
HEADER = ",".join(["time_s", *(f"{name}{k}" for name in ("q", "dq", "tau") for k in range(N))])


@pytest.fixture(scope="module")
def log():
    return simulated.record()


@pytest.fixture(scope="module")
def wrong(tmp_path_factory):
    """A URDF whose masses are wrong by up to 20 %."""
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(simulated.urdf(np.random.default_rng(7).uniform(0.8, 1.2, N)))
    return path


def recordings(log, order=range(N), sign=1.0):
    columns = [{"time_s": log.time_s, "position": log.position[:, k], "torque": sign * log.torque[:, k]} for k in order]
    return [Recording("log.csv", f"q{k}", each) for k, each in zip(order, columns, strict=True)]


def test_levels_load_and_intervals_of_a_simulated_arm(log, wrong):
    arm = fh.dynamics.load(wrong)
    true = {"coulomb": simulated.COULOMB, "viscous": simulated.VISCOUS, "load": simulated.LOAD}
    inside = []
    for each in (log, simulated.record(seed=2)):
        fit = identify_arm([recordings(each)], arm)
        for k, joint in enumerate(fit.joints):
            assert joint.values["coulomb"] == pytest.approx(simulated.COULOMB[k], rel=0.05)
            assert joint.values["load"] == pytest.approx(simulated.LOAD[k], rel=0.15)
            assert joint.held_out < 0.02 < joint.alone
            inside += [abs(joint.values[name] - value[k]) <= 1.645 * joint.errors[name] for name, value in true.items()]
        # the weight of the links, which the file states wrongly
        q = np.random.default_rng(1).uniform(-1.0, 1.0, (50, N))
        truth = wrong.with_name("true.urdf")
        truth.write_text(simulated.urdf())
        weight = fh.dynamics.load(truth).gravity(q)
        off, was = (np.abs(one.gravity(q) - weight).max() for one in (fit.arm, arm))
        assert off < 0.2 * was
        assert fit.contradiction < 1.0
        assert fit.is_physical
    assert np.mean(inside) >= 0.8  # of intervals of 90 %: 36 of them


def test_a_joint_that_is_held_is_named_and_costs_the_others_nothing(wrong):
    log = simulated.record(seed=3, duration_s=20.0, still=(2,))
    fit = identify_arm([recordings(log)], fh.dynamics.load(wrong))
    assert [joint.is_known for joint in fit.joints] == [True, True, False, True, True, True]
    assert any("hardly slides" in flag for flag in fit.joints[2].flags)
    assert fit.determined < fit.combinations
    for k in (0, 1, 3, 4, 5):
        assert fit.joints[k].values["coulomb"] == pytest.approx(simulated.COULOMB[k], rel=0.05)


def test_several_logs_are_one(log, wrong):
    half = len(log.time_s) // 2
    parts = [[each.at(rows) for each in recordings(log)] for rows in (slice(0, half), slice(half, None))]
    fit = identify_arm(parts, fh.dynamics.load(wrong))
    assert [joint.values["coulomb"] for joint in fit.joints] == pytest.approx(simulated.COULOMB, rel=0.05)


def test_joints_in_another_order_or_with_the_sign_turned_are_told(log, wrong):
    arm = fh.dynamics.load(wrong)
    turned = identify_arm([recordings(log, sign=-1.0)], arm)
    assert all(any("sign" in flag for flag in joint.flags) for joint in turned.joints)
    mixed = identify_arm([recordings(log, order=(1, 0, 2, 3, 4, 5))], arm)
    assert any("less well" in flag for joint in mixed.joints[:2] for flag in joint.flags)
    assert min(turned.contradiction, mixed.contradiction) > 1.5
    negative = recordings(log)
    negative[3] = Recording(
        "log.csv",
        "q3",
        {"time_s": log.time_s, "position": -log.position[:, 3], "torque": -log.torque[:, 3]},
    )
    signs = [1, 1, 1, -1, 1, 1]
    fit = identify_arm([negative], fh.dynamics.load(wrong, signs=signs))
    assert fit.joints[3].values["load"] == pytest.approx(simulated.LOAD[3], rel=0.15)


def test_logs_that_do_not_go_with_the_arm_are_refused(log, wrong):
    arm = fh.dynamics.load(wrong)
    with pytest.raises(UsageError, match="6 joints"):
        identify_arm([recordings(log)[:5]], arm)
    other = recordings(log)
    other[1] = other[1].at(slice(1, None))
    with pytest.raises(RecordingError, match="time stamps"):
        identify_arm([other], arm)
    silent = recordings(log)
    silent[4].columns["torque"] = 0.0 * log.time_s
    with pytest.raises(RecordingError, match="joint5 is zero"):
        identify_arm([silent], arm)
    silent[4].columns["torque"] = np.full(len(log.time_s), np.inf)
    with pytest.raises(RecordingError, match="joint q4 has none"):
        identify_arm([silent], arm)
    resting = [
        Recording("x", each.axis, each.columns | {"position": 0.0 * each["position"]}) for each in recordings(log)
    ]
    with pytest.raises(RecordingError, match="no joint slides"):
        identify_arm([resting], arm)


def test_combinations_that_any_motion_shows(tmp_path):
    """A planar chain of n revolute joints under gravity has 3 n, Khalil and Dombre (2002), section 9.4."""
    path = tmp_path / "planar.urdf"
    inertial = (
        '<inertial><origin xyz="0.1 0 0.1"/><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    links = (
        f'<link name="l{k + 1}">{inertial}</link><joint name="j{k}" type="continuous"><parent link="l{k}"/>'
        f'<child link="l{k + 1}"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/></joint>'
        for k in range(3)
    )
    path.write_text(f'<robot name="p"><link name="l0"/>{"".join(links)}</robot>')
    assert combinations(fh.dynamics.load(path)) == 9


@pytest.fixture
def folder(log, wrong, tmp_path, monkeypatch):
    table = np.column_stack([log.time_s, log.position, log.velocity, log.torque])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=HEADER, comments="", fmt="%.9g")
    (tmp_path / "arm.urdf").write_text(wrong.read_text())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_identify_writes_a_model_file_of_each_joint_of_an_arm(folder, capsys):
    words = ["identify", "log.csv", "--joints", "q{}", "--torque", "tau{}", "--urdf", "arm.urdf", "--models", "coulomb"]
    assert main([*words, "--output", "friction.yaml", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [each["name"] for each in told["arm"]["joints"]] == list(simulated.NAMES)
    for k in range(N):
        content = yaml.safe_load((folder / f"friction_q{k}.yaml").read_text())["friction"]
        assert content["parameters"]["coulomb"] == pytest.approx(simulated.COULOMB[k], rel=0.05)
        assert content["modifiers"]["load"]["motoring"] == pytest.approx(simulated.LOAD[k], rel=0.15)
        assert told["joints"][f"q{k}"]["output"] == f"friction_q{k}.yaml"
        fh.models.load(folder / f"friction_q{k}.yaml")


def test_a_log_gives_the_configuration_of_a_loop(folder, log, capsys):
    """From the log to `fh.Compensator` nothing is edited; the output is short and says what comes next."""
    words = ["identify", "log.csv", "--joints", "q{}", "--torque", "tau{}", "--urdf", "arm.urdf", "--models", "coulomb"]
    (folder / "loops").mkdir()
    assert main([*words, "--output", "friction.yaml", "--config", "loops/arm.yaml"]) == 0
    told = capsys.readouterr().out.splitlines()
    assert len(told) <= N + 8
    assert "loops/arm.yaml" in told[-1]
    assert main(["config", "check", "loops/arm.yaml"]) == 0
    axes = yaml.safe_load((folder / "loops/arm.yaml").read_text())["axes"]
    for k, axis in enumerate(axes.values()):
        assert axis["limits"]["velocity"] == pytest.approx(1.5 * np.abs(log.velocity[:, k]).max(), rel=0.15)
        assert simulated.COULOMB[k] < axis["limits"]["torque"] < 3.0 * np.abs(log.torque[:, k]).max()
    comp = fh.Compensator.load("loops/arm.yaml", period_s=0.004)
    assert comp.joints == simulated.NAMES
    assert main([*words, "--output", "friction.yaml", "--config", "loops/arm.yaml"]) == 2, "it may have been edited"
    assert "exists already" in capsys.readouterr().err


def test_names_and_signs_of_the_arm_s_joints_are_those_of_the_log(folder, capsys):
    """The first two joints of an arm, the others held, in a log that counts one of them the other way."""
    held = simulated.record(seed=4, duration_s=20.0, still=(2, 3, 4, 5))
    columns = [held.time_s, -held.position[:, 1], -held.torque[:, 1], held.position[:, 0], held.torque[:, 0]]
    header = "time_s,b_position,b_torque,a_position,a_torque"
    np.savetxt("two.csv", np.column_stack(columns), delimiter=",", header=header, comments="")
    words = ["--joints", "b_position,a_position", "--torque", "b_torque,a_torque", "--models", "coulomb"]
    words += ["--urdf", "arm.urdf", "--urdf-joints", "joint2,joint1", "--signs=-1,1", "--json"]
    assert main(["identify", "two.csv", *words]) == 0
    second, first = json.loads(capsys.readouterr().out)["arm"]["joints"]
    assert (second["name"], first["name"]) == ("joint2", "joint1")
    assert second["values"]["coulomb"] == pytest.approx(simulated.COULOMB[1], rel=0.05)
    assert second["values"]["load"] == pytest.approx(simulated.LOAD[1], rel=0.15)
    assert first["values"]["coulomb"] == pytest.approx(simulated.COULOMB[0], rel=0.05)


def test_joints_of_ros_are_read_by_name(tmp_path, log, wrong):
    """Joint states, in which the order of the joints changes; the arm's joints have the same names."""
    from mcap.writer import Writer

    from friction_hil.recordings.joint_state import SCHEMA, TEXT, TOPIC, JointStates

    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema(SCHEMA, "ros2msg", TEXT.encode())
        channel = writer.register_channel(TOPIC, "cdr", schema)
        orders = [list(range(N)), [5, 4, 3, 2, 1, 0]]
        states = [JointStates([simulated.NAMES[k] for k in order]) for order in orders]
        for row in range(5000):
            order, time_ns = orders[row % 2], round(1e9 * log.time_s[row]) + 1_700_000_000_000_000_000
            values = [log.position[row, order], log.velocity[row, order], log.torque[row, order]]
            data = states[row % 2].message(time_ns, values)
            writer.add_message(channel, log_time=time_ns, data=data, publish_time=time_ns)
        writer.finish()
    found = fh.identify_joints(path, ", ".join(reversed(simulated.NAMES)), arm=wrong, models="coulomb")
    assert list(found.joints) == list(reversed(simulated.NAMES))
    assert found.fit.arm.joints == tuple(reversed(simulated.NAMES))
    for name, coulomb in zip(simulated.NAMES, simulated.COULOMB, strict=True):
        assert found.joints[name].model.friction.parameters["coulomb"] == pytest.approx(coulomb, rel=0.05)


@needs_pendulums
@pytest.mark.parametrize(
    ("file", "cut_hz", "words"),
    [
        ("ak80-6_simple_pendulum_sysid.csv", 30.0, ["--joints", "position", "--torque", "torque"]),
        ("ak80-6_double_pendulum_sysid_500Hz.csv", 50.0, ["--joints", "pos{}", "--torque", "tau1*-1,tau2"]),
    ],
)
def test_real_pendulums_are_no_worse_than_coulomb_and_viscous_friction(file, cut_hz, words, capsys):
    words = ["identify", str(PENDULUMS / file), *words, "--column", "time_s=time", "--json"]
    main([*words, "--lowpass", str(cut_hz), "--models", "coulomb,stribeck,power_law"])
    found = json.loads(capsys.readouterr().out)["joints"]
    table = np.loadtxt(PENDULUMS / file, delimiter=",", skiprows=1)
    count = len(found)
    for k, each in enumerate(found.values()):
        own = coulomb_and_viscous(table[:, 0], table[:, 1 + k], table[:, 1 + 2 * count + k], cut_hz)
        assert each["fits"][0]["cross_validation"]["relative_error"] <= own
    coupled = [any("the motion of pos" in text for text in each["findings"]) for each in found.values()]
    assert coupled[0] == (count == 2)


def coulomb_and_viscous(time, position, torque, cut_hz):
    """Error of 5-fold cross-validation: inertia, Coulomb and viscous friction, offset, in blocks of time."""
    period = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1], period)
    sections = signal.butter(4, cut_hz, fs=1.0 / period, output="sos")
    q, tau = (signal.sosfiltfilt(sections, np.interp(even, time, each)) for each in (position, torque))
    v = np.gradient(q, period)
    matrix = np.column_stack([np.gradient(v, period), np.sign(v), v, np.ones_like(v)])
    fold, square = 5 * np.arange(len(tau)) // len(tau), 0.0
    for number in range(5):
        kept = fold != number
        factors = np.linalg.lstsq(matrix[kept], tau[kept])[0]
        square += float(np.sum((tau[~kept] - matrix[~kept] @ factors) ** 2))
    return math.sqrt(square / float(tau @ tau))


def test_identify_reads_all_joints_of_a_wide_log_and_says_that_they_are_coupled(folder, capsys):
    words = ["--joints", "q1,q2", "--torque", "tau1,tau2", "--velocity", "dq1,dq2", "--models", "coulomb"]
    assert main(["identify", "log.csv", *words, "--json"]) in (0, 1)
    told = json.loads(capsys.readouterr().out)["joints"]
    assert list(told) == ["q1", "q2"]
    assert any("q1" in text for text in told["q2"]["findings"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--joints", "q{}"], "needs --torque"),
        (["--torque", "tau{}"], "needs --joints"),
        (["--config", "arm.yaml"], "needs --joints"),
        (["--joints", "p{}", "--torque", "tau{}"], "no column fits"),
        (["--joints", "q{}", "--torque", "torque{}"], "no column fits --torque"),
        (["--joints", "pi/180*q{}", "--torque", "tau{}"], "'q{}*pi/180'"),
        (["--joints", "q{}", "--torque", "tau{}", "--config", "arm.yaml"], "needs --output"),
        (["--joints", "q{}", "--torque", "tau{}", "--output", "f.yaml", "--config", "no/arm.yaml"], "no folder"),
        (["--joints", "q{}", "--torque", "tau1,tau2"], "6 columns, --torque 2"),
        (["--joints", "q{}", "--torque", "tau{}", "--axis", "q"], "--axis"),
        (["--joints", "q{}", "--torque", "tau{}", "--column", "position=q1"], "--column position"),
        (["--joints", "q{}", "--torque", "tau{}", "--signs", "1"], "--urdf"),
        (["--joints", "q{}", "--torque", "tau{}", "--urdf", "arm.urdf", "--signs", "1,x"], "--signs"),
        (["--joints", "q{}", "--torque", "tau{}", "--urdf", "arm.urdf", "--urdf-joints", "joint1"], "has 1 joints"),
        (["--joints", "q{}", "--torque", "tau{}", "--urdf", "arm.urdf", "--gravity", "none"], "--gravity"),
        (["--joints", "shoulder"], "no axis 'shoulder'"),
    ],
)
def test_options_that_do_not_go_together_are_refused(folder, capsys, words, message):
    assert main(["identify", "log.csv", *words]) == 2
    assert message in capsys.readouterr().err
