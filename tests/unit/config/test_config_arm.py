"""The section `arm` of a configuration: what it says of axes and joints, and each mistake with its line."""

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.checked_yaml.text import dump
from friction_hil.cli.work.config import check_files, show_file
from friction_hil.cli.work.study_machine import run_machine_study
from friction_hil.config import from_dict, load, self_contained
from friction_hil.daemon.static_torque import largest_weights
from friction_hil.errors import ConfigurationError, UsageError
from tests.arm_machine import ARM, URDF, gravity, machine, values, write

POSE = np.array([0.4, 0.9])


def problems(folder, **given):
    """The mistakes of a file, by (file, field), each with its message; all have a line."""
    with pytest.raises(ConfigurationError) as caught:
        load(write(folder, **given))
    assert all(problem.line is not None for problem in caught.value.problems)
    return {(problem.path.rpartition("/")[2], problem.field): problem.message for problem in caught.value.problems}


def test_an_arm_beside_its_configuration_has_the_weight_of_its_links(tmp_path):
    arm = machine(tmp_path).arm
    assert arm.dynamics.joints == ("joint1", "joint2")
    assert arm.dynamics.gravity(POSE) == pytest.approx(gravity(*POSE))
    assert arm.dynamics.armatures.tolist() == [0.45, 0.12]
    assert arm.ordered(("elbow", "shoulder")).gravity(POSE[::-1]) == pytest.approx(gravity(*POSE)[::-1])


def test_a_recorded_configuration_needs_no_file_and_has_no_dynamics(tmp_path):
    first = machine(tmp_path)
    (tmp_path / "arm.urdf").unlink()
    again = from_dict(self_contained(first), "a recording", reads_files=False)
    assert self_contained(again) == self_contained(first)
    with pytest.raises(UsageError, match=r"arm\.urdf was not read"):
        _ = again.arm.dynamics


def test_signs_gears_payload_and_gravity_are_those_of_the_library(tmp_path):
    arm = ARM | {
        "signs": {"elbow": -1},
        "rotor_inertia": {"elbow": 1e-5},
        "gear": {"elbow": 100.0},
        "payload": {"mass": 2.0, "center": [0.0, 0.1, -0.3], "inertia": [0.1, 0, 0, 0.1, 0, 0.1], "link": "tool"},
        "gravity": [0.0, 1.0, -9.0],
    }
    found = machine(tmp_path, arm).arm.dynamics
    payload = fh.dynamics.Payload(2.0, (0.0, 0.1, -0.3), (0.1, 0, 0, 0.1, 0, 0.1), "tool")
    expected = fh.dynamics.load(
        tmp_path / "arm.urdf",
        signs=[1, -1],
        rotor_inertia={"joint2": 1e-5},
        gear={"joint2": 100.0},
        payload=payload,
        gravity=[0, 1, -9],
    )
    motion = np.random.default_rng(0).normal(size=(3, 2))
    assert found.inverse_dynamics(*motion) == pytest.approx(expected.inverse_dynamics(*motion), rel=1e-12)


def test_a_joint_that_is_left_out_is_locked(tmp_path):
    arm = {"file": "arm.urdf", "joints": {"shoulder": "joint1"}, "locked": {"joint2": 0.9}}
    found = machine(tmp_path, arm).arm.dynamics
    assert found.gravity(POSE[:1]) == pytest.approx(gravity(*POSE)[:1])


HEAVY = {"sine": 1.0}


@pytest.mark.parametrize(
    ("changes", "field", "words"),
    [
        ({"joints": {"shulder": "joint1", "elbow": "joint2"}}, "arm.joints.shulder", ["'shoulder'"]),
        ({"joints": {"shoulder": "joint1", "elbow": "joint3"}}, "arm.joints.elbow", ["'joint3'", "joint1"]),
        ({"joints": {"shoulder": "joint1", "elbow": "joint1"}}, "arm.file", ["twice"]),
        ({"joints": {}}, "arm.joints", ["at least 1"]),
        ({"file": "arn.urdf"}, "arm.file", ["there is no file"]),
        ({"file": "."}, "arm.file", ["there is no file"]),
        ({"signs": {"wrist": -1}}, "arm.signs.wrist", ["no axis of arm.joints", "elbow"]),
        ({"signs": {"elbow": 2}}, "arm.signs.elbow", ["1", "-1"]),
        ({"gear": {"elbow": 100.0}, "rotor_inertia": {}}, "arm.gear", ["rotor_inertia"]),
        ({"gear": {"elbow": 0.0}}, "arm.gear.elbow", ["above 0"]),
        ({"rotor_inertia": {"elbow": -1.0}}, "arm.rotor_inertia.elbow", ["at least 0"]),
        ({"drive_inertia": {"joint1": 1.0}}, "arm.drive_inertia.joint1", ["shoulder"]),
        ({"locked": {"joint2": 0.0}}, "arm.locked", ["'joint2'", "joints that move"]),
        ({"locked": {"joint4": 0.0}}, "arm.locked", ["'joint4'"]),
        ({"payload": {"mass": -1.0}}, "arm.payload.mass", ["at least 0"]),
        ({"payload": {"mass": 1.0, "link": "tol"}}, "arm.payload", ["'tool'"]),
        ({"payload": {"mass": 1.0, "inertia": [1, 0, 0, 1, 0, 9]}}, "arm.payload", ["principal moments"]),
        ({"gravity": [0, 0]}, "arm.gravity", ["3 values"]),
        ({"gravity": [0, 0, float("inf")]}, "arm.gravity[2]", ["finite"]),
        ({"jionts": {}}, "arm.jionts", ["'joints'"]),
    ],
)
def test_mistakes_name_their_line_and_the_choices(tmp_path, changes, field, words):
    found = problems(tmp_path, arm=ARM | changes)
    for word in words:
        assert word in found["machine.yaml", field]


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"axes__elbow__model__mechanics__gravity": HEAVY}, "axes.elbow.model.mechanics.gravity"),
        ({"axes__elbow__compensation__velocity": "kalman"}, "axes.elbow.compensation.velocity"),
        ({"axes__elbow__compensation__adaptation": {}}, "axes.elbow.compensation.adaptation"),
        ({"axes__elbow__compensation__learning": "propose"}, "axes.elbow.compensation.learning"),
    ],
)
def test_what_would_take_the_weight_from_the_model_is_refused_on_axes_of_the_arm_alone(tmp_path, changes, field):
    assert ("machine.yaml", field) in problems(tmp_path, **changes)
    load(write(tmp_path, ARM | {"joints": {"shoulder": "joint1"}, "rotor_inertia": {}}, **changes))


def test_gravity_in_a_model_file_is_reported_there(tmp_path):
    data = values()
    model = data["axes"]["elbow"]["model"]
    model["mechanics"]["gravity"] = HEAVY
    (tmp_path / "elbow.yaml").write_text(dump(model))
    found = problems(tmp_path, axes__elbow__model="elbow.yaml")
    assert "arm" in found["elbow.yaml", "mechanics.gravity"]


def test_the_drives_inertia_has_no_place_in_cst(tmp_path):
    controller = {"position_gain": 20.0, "velocity_gain": 40.0}
    changes = {"axes__elbow__mode": "cst", "axes__elbow__controller": controller}
    machine(tmp_path, **changes)
    found = problems(tmp_path, arm=ARM | {"drive_inertia": {"elbow": 0.3}}, **changes)
    assert "cst" in found["machine.yaml", "arm.drive_inertia.elbow"]


@pytest.mark.parametrize(
    ("old", "new", "field", "word"),
    [
        ('name="joint2" type="continuous"', 'name="joint2" type="prismatic"', None, "prismatic"),
        ('name="joint2" type="continuous"', 'name="joint2" type="floating"', "joint 'joint2'", "floating"),
        ("</joint>\n</robot>", '<mimic joint="joint2"/></joint>\n</robot>', "joint 'flange'", "mimic"),
        ('value="2.2"', 'value="nan"', "link 'fore'", "nan"),
    ],
)
def test_what_an_arm_cannot_be_is_refused_with_its_own_line(tmp_path, old, new, field, word):
    assert old in URDF
    text = URDF.replace(old, new)
    if word == "mimic":
        text = text.replace('name="flange" type="fixed"', 'name="flange" type="continuous"')
    found = problems(tmp_path, urdf=text)
    place = ("machine.yaml", "arm.joints.elbow") if field is None else ("arm.urdf", field)
    assert word in found[place]


def test_the_check_says_where_limits_torque_is_too_small_for_the_weight(tmp_path, capsys):
    path = write(tmp_path, axes__shoulder__limits__torque=20.0)
    assert check_files([str(path)], as_json=False) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "axes.shoulder.limits.torque: leaves" in printed
    assert "28.5 N m" in printed
    assert "elbow" not in printed


def test_the_largest_weight_is_that_within_the_position_limits(tmp_path):
    near = {"axes__shoulder__limits__position": [-0.6, 0.6], "axes__shoulder__experiment__travel": 0.5}
    found = largest_weights(machine(tmp_path, **near))
    assert found["shoulder"] == pytest.approx(gravity(0.6, 0.5 * np.pi - 0.6)[0], abs=0.3)
    assert largest_weights(machine(tmp_path))["shoulder"] == pytest.approx(28.5, abs=0.1)


def test_a_prismatic_joint_is_a_linear_axis(tmp_path):
    """Of the forearm's weight it carries what lies along it; without position limits it is looked at where it is 0."""
    slide = URDF.replace('name="joint2" type="continuous"', 'name="joint2" type="prismatic"')
    slide = slide.replace('-0.4"/><axis xyz="0 -1 0"', '-0.4"/><axis xyz="0 0 -1"')
    changes = {"simulation": None, "axes__elbow__simulation": None, "axes__elbow__model__axis": "linear"}
    changes |= {"axes__elbow__counts_per_unit": 1e6, "axes__elbow__rated_torque": 40.0}
    config = load(write(tmp_path, urdf=slide, **changes, axes__elbow__limits__position=None))
    assert config.arm.dynamics.is_linear == (False, True)
    assert config.arm.dynamics.gravity([0.0, 0.1]) == pytest.approx([0.0, -3.2 * 9.81])
    assert largest_weights(config)["elbow"] == pytest.approx(3.2 * 9.81, rel=1e-3)


def test_study_says_that_it_feeds_no_arm_forward(tmp_path, capsys):
    taken = tmp_path / "report"
    taken.mkdir()
    (taken / "report.html").write_text("of somebody else")
    with pytest.raises(UsageError):
        run_machine_study(machine=write(tmp_path), output=taken, as_json=True)
    assert "nothing of arm" in capsys.readouterr().err


def test_a_configuration_is_shown_with_the_place_of_its_arm(tmp_path, capsys):
    show_file(str(write(tmp_path)))
    shown = tmp_path / "shown.yaml"
    shown.write_text(capsys.readouterr().out)
    assert load(shown).arm.model_dump() == machine(tmp_path).arm.model_dump()
