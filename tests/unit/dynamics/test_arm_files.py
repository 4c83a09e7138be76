"""What an arm's file must not have, with its line; what is locked, mimicked or merged."""

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.errors import ConfigurationError, FrictionHilError, UsageError

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
URDF = f"""<robot name="a">
<link name="base"/>
<link name="one">
{INERTIAL}
</link>
<link name="two">{INERTIAL}</link>
<joint name="first" type="revolute"><parent link="base"/><child link="one"/>
<axis xyz="0 1 0"/></joint>
<joint name="second" type="prismatic"><parent link="one"/><child link="two"/><axis xyz="0 0 2"/></joint>
</robot>"""
MJCF = """<mujoco>
<compiler angle="radian"/>
<worldbody>
<body name="one">
<joint name="first"/>
<inertial mass="1" pos="0.1 0 0" diaginertia="1 1 1"/>
<body name="two" pos="1 0 0">
<joint name="second" type="slide" axis="0 0 2"/>
<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>
</body>
</body>
</worldbody>
</mujoco>"""


@pytest.fixture
def load(tmp_path):
    def of(text, *arguments, **options):
        path = tmp_path / "arm.xml"
        path.write_text(text, encoding="utf-8")
        return fh.dynamics.load(path, *arguments, **options)

    return of


@pytest.mark.parametrize(
    ("text", "old", "new", "line", "words"),
    [
        (URDF, 'ixx="1"', 'ixx="3"', 4, ["link 'one'", "principal moments"]),
        (URDF, 'ixy="0"', 'ixy="2"', 4, ["negative principal moment"]),
        (URDF, '<mass value="1"', '<mass value="-1"', 4, ["-1 kg"]),
        (URDF, '<mass value="1"', '<mass value="nan"', 4, ["link 'one'", "value", "'nan'"]),
        (URDF, '<mass value="1"/>', "", 4, ["lacks <mass>"]),
        (URDF, "0 1 0", "0 0 0", 8, ["joint 'first'", "axis"]),
        (URDF, "0 1 0", "0 1", 8, ["3 finite numbers"]),
        (URDF, '"revolute"', '"floating"', 7, ["joint 'first'", "floating"]),
        (URDF, '"revolute"', '"planar"', 7, ["joint 'first'", "planar"]),
        (URDF, '"revolute"', '"revolut"', 7, ["did you mean 'revolute'"]),
        (URDF, 'parent link="one"', 'parent link="on"', 9, ["joint 'second'", "did you mean 'one'"]),
        (URDF, 'child link="two"', 'child link="one"', 9, ["joint 'second'", "'first'"]),
        (URDF, 'parent link="base"', 'parent link="two"', 3, ["link 'one'", "ring"]),
        (URDF, 'parent link="one"', 'parent link="two"', 6, ["link 'two'", "ring"]),
        (URDF, "</robot>", '<link name="alone"/></robot>', 1, ["base, alone"]),
        (URDF, 'name="two"', 'name="one"', 6, ["link 'one'", "line 3"]),
        (URDF, 'name="second"', 'name="first"', 9, ["joint 'first'", "line 7"]),
        (URDF, '"prismatic">', '"prismatic"><mimic joint="first"/>', 9, ["joint 'second'", "'first'", "mimic"]),
        (URDF, 'name="a">', 'xmlns:xacro="http://www.ros.org/wiki/xacro">\n<xacro:arm/>', 2, ["<arm>", "xacro"]),
        (MJCF, "<worldbody>", '<worldbody><include file="x.xml"/>', 3, ["<include>"]),
        (MJCF, '<body name="two"', '<replicate count="3"/><body name="two"', 7, ["<replicate>"]),
        (MJCF, 'angle="radian"', 'settotalmass="3"', 2, ["<compiler>", "settotalmass"]),
        (MJCF, 'angle="radian"', 'eulerseq="xyw"', 2, ["eulerseq"]),
        (MJCF, 'name="first"', 'name="first" type="ball"', 5, ["joint 'first'", "'ball'"]),
        (MJCF, '<joint name="first"/>', '<freejoint name="f"/>', 5, ["joint 'f'", "'free'"]),
        (MJCF, 'name="first"', 'name="first" stiffness="2"', 5, ["joint 'first'", "stiffness"]),
        (MJCF, 'name="first"', 'name="first" axis="0 0 0"', 5, ["joint 'first'", "axis"]),
        (MJCF, 'name="first"', 'name="first" armature="-1"', 5, ["armature"]),
        (MJCF, 'name="second"', 'name="first"', 8, ["joint 'first'", "line 5"]),
        (MJCF, "1 1 1", "1 1 3", 6, ["<inertial>", "principal moments"]),
        (MJCF, 'mass="1"', 'mass="-1"', 6, ["-1 kg"]),
        (MJCF, 'mass="1"', "", 6, ["lacks mass"]),
        (MJCF, 'pos="1 0 0"', 'pos="1 0 inf"', 7, ["body 'two'", "inf"]),
        (MJCF, 'pos="1 0 0"', 'quat="0 0 0 0"', 7, ["quat"]),
        (MJCF, 'pos="1 0 0"', 'quat="1 0 0 0" euler="0 0 1"', 7, ["quat, euler"]),
        (MJCF, 'pos="1 0 0"', 'gravcomp="1"', 7, ["body 'two'", "gravcomp"]),
        (MJCF, '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>', '\n<geom size="1"/>', 7, ["'two'", "line 10"]),
        (MJCF, "</mujoco>", '<equality><weld body1="two"/></equality></mujoco>', 13, ["<weld>", "loop"]),
        (MJCF, "</mujoco>", '<equality><joint joint1="second"/></equality></mujoco>', 8, ["'second'", "line 13"]),
        (MJCF, "</mujoco>", '<tendon><fixed name="t" stiffness="1"/></tendon></mujoco>', 13, ["fixed 't'"]),
    ],
)
def test_what_cannot_be_computed_is_refused_with_its_line(load, text, old, new, line, words):
    assert old in text
    with pytest.raises(ConfigurationError) as error:
        load(text.replace(old, new, 1))
    (problem,) = error.value.problems
    assert problem.line == line, problem
    assert all(word in str(problem) for word in words), problem


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"joints": ["firs"]}, "did you mean 'first'"),
        ({"joints": ["first", "first"]}, "twice"),
        ({"joints": []}, "must name"),
        ({"signs": [1.0]}, "2 numbers"),
        ({"signs": [1.0, 0.5]}, "1 or -1"),
        ({"locked": {"first": 1.0}}, "'first'"),
        ({"joints": ["first"], "locked": {"second": float("nan")}}, "finite"),
        ({"joints": ["first"], "locked": {"third": 1.0}}, "'third'"),
        ({"gear": {"first": 10.0}}, "rotor_inertia"),
        ({"gear": {"first": 0.0}, "rotor_inertia": {"first": 1.0}}, "positive"),
        ({"rotor_inertia": {"first": -1.0}}, "negative"),
        ({"rotor_inertia": {"third": 1.0}}, "'third'"),
        ({"payload": fh.dynamics.Payload(-1.0)}, "-1 kg"),
        ({"payload": fh.dynamics.Payload(1.0, link="tool")}, "'tool'"),
        ({"payload": fh.dynamics.Payload(float("inf"))}, "finite"),
        ({"gravity": (0.0, 9.81)}, "gravity"),
    ],
)
def test_arguments_that_do_not_go_with_the_file_are_refused(load, options, word):
    with pytest.raises(UsageError) as error:
        load(URDF, **options)
    assert word in str(error.value)


@pytest.mark.parametrize(
    "content", [b"", b"<sdf/>", b"\x00\x01", b"<!DOCTYPE robot><robot/>", b"<robot/>", b"<mujoco/>"]
)
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "arm.urdf"
    path.write_bytes(content)
    with pytest.raises(FrictionHilError) as error:
        fh.dynamics.load(path)
    assert str(path) in str(error.value)
    with pytest.raises(UsageError):
        fh.dynamics.load(tmp_path / "absent.urdf")


def test_numbers_whose_products_are_too_large_are_refused(load):
    text = URDF.replace('<parent link="one"/>', '<parent link="one"/><origin xyz="1e200 0 0"/>')
    text = text.replace('type="prismatic"', 'type="fixed"')
    with pytest.raises(UsageError, match="too large"):
        load(text)


def test_a_mimic_joint_is_locked_with_the_joint_that_it_follows(load):
    follower = URDF.replace('"prismatic">', '"prismatic"><mimic joint="first" multiplier="0.5" offset="0.1"/>')
    grown = follower.replace("</robot>", f'<link name="three">{INERTIAL}</link><joint name="third" type="continuous">'
                             '<parent link="base"/><child link="three"/></joint></robot>')  # fmt: skip
    assert load(grown, ["third"]).joints == ("third",)
    with pytest.raises(ConfigurationError):
        load(grown, ["second"])
    moved = URDF.replace("</robot>", '<joint name="third" type="continuous"><parent link="two"/><child link="three"/>'
                         f'<origin xyz="0.3 0 0"/></joint><link name="three">{INERTIAL}</link></robot>')  # fmt: skip
    tied = moved.replace('"prismatic">', '"prismatic"><mimic joint="first" multiplier="0.5" offset="0.1"/>')
    free = load(moved, ["third"], locked={"first": 0.4, "second": 0.3})
    assert load(tied, ["third"], locked={"first": 0.4}).gravity([0.7]) == pytest.approx(free.gravity([0.7]), abs=1e-12)


def test_other_joints_of_a_file_are_locked_where_it_draws_them(load):
    text = MJCF.replace('name="second"', 'name="second" ref="0.7"').replace('name="first"', 'name="first" axis="0 1 0"')
    assert load(text, ["first"]).inertia_matrix([0.0]) == pytest.approx(1.0 + 0.01 + 1.0 + 1.0)
    with_ball = text.replace("<worldbody>", '<worldbody><body><freejoint/><inertial mass="1" pos="0 0 0"/></body>')
    arm = load(with_ball, ["second", "first"])
    assert arm.joints == ("second", "first")
    assert np.diag(arm.inertia_matrix([0.7, 0.0])) == pytest.approx([1.0, 3.01])
