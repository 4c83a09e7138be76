"""Model files from MJCF, URDF and BAM: what was exported comes back, gaps are named, bad files refused."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.errors import FrictionHilError, UsageError
from friction_hil.models import foreign
from friction_hil.models.files import load_model_file
from friction_hil.models.model_file import ModelFile

levels = st.floats(1e-3, 1e3)

MJCF = """<mujoco>
  <default>
    <joint damping="0.5"/>
    <default class="small"><joint frictionloss="0.02"/><default class="tiny"><joint damping="0.1 0.2 0.3"/></default>
    </default>
  </default>
  <worldbody>
    <body childclass="small">
      <joint name="a" armature="1e-4"/>
      <body><joint name="b" class="tiny" type="slide"/></body>
    </body>
    <body><joint name="c" type="ball"/></body>
    <body><joint name="d" frictionloss="0.7" damping="0"/></body>
  </worldbody>
</mujoco>"""


def imported(tmp_path, text, source, joint=None):
    path = tmp_path / "given"
    path.write_text(text)
    return foreign.read(path, source, joint)


@given(levels, st.floats(0.0, 10.0), st.sampled_from(["mjcf", "urdf", "bam"]))
def test_an_exported_level_and_coefficient_come_back(tmp_path_factory, coulomb, viscous, source):
    """The numbers that the export wrote, to their ten digits."""
    converted = fh.export.convert(f"coulomb:coulomb={coulomb!r},viscous={viscous!r}", source, name="x", speed=2.0)
    (text,) = converted.files.values()
    found = imported(tmp_path_factory.mktemp("import"), text, source)
    assert found.content["friction"]["model"] == "coulomb"
    names = {"mjcf": ("frictionloss", "damping"), "urdf": ("friction", "damping")}
    level, coefficient = names.get(source, ("friction_base", "friction_viscous"))
    assert found.content["friction"]["parameters"] == pytest.approx(
        {"coulomb": converted.parameters[level], "viscous": converted.parameters[coefficient]}, rel=1e-9
    )


@given(levels, st.floats(1.05, 3.0), st.floats(0.05, 0.5), st.floats(1e2, 1e6), st.floats(0.0, 2 * math.pi))
def test_lugre_and_cogging_come_back_from_mujoco(tmp_path_factory, coulomb, ratio, velocity, stiffness, phase):
    parameters = {"sigma0": stiffness, "sigma1": 0.5, "sigma2": 0.01 * coulomb, "coulomb": coulomb}
    parameters |= {"static": ratio * coulomb, "stribeck_velocity": velocity}
    ripple = [{"order": 7, "cosine": 0.01 * math.cos(phase), "sine": 0.01 * math.sin(phase)}]
    content = {"model": "lugre", "parameters": parameters, "modifiers": {"ripple": ripple}}
    file = ModelFile.model_validate({"axis": "rotary", "friction": content, "mechanics": {"inertia": 2e-4}})
    converted = fh.export.convert(file, "mjcf_lugre", name="x")
    found = imported(tmp_path_factory.mktemp("import"), converted.files["x.xml"], "mjcf")
    back = ModelFile.model_validate(found.content)
    assert back.mechanics.inertia == 2e-4
    v = np.linspace(-1.0, 1.0, 40)
    np.testing.assert_allclose(
        back.friction_model.steady_state(v), file.friction_model.steady_state(v), rtol=0, atol=1e-5 * coulomb
    )
    assert back.friction.parameters["sigma0"] == pytest.approx(stiffness, rel=1e-9)
    (harmonic,) = back.friction.modifiers["ripple"]
    assert (harmonic["order"], harmonic["cosine"], harmonic["sine"]) == pytest.approx(
        (7, ripple[0]["cosine"], ripple[0]["sine"]), abs=1e-9
    )


def test_default_classes_of_mujoco_are_those_that_mujoco_finds(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    text = MJCF.replace("</body>", '<geom size="1"/></body>')
    model = mujoco.MjModel.from_xml_string(text)
    for name in ("a", "b", "d"):
        dof = model.joint(name).dofadr[0]
        found = imported(tmp_path, MJCF, "mjcf", name).content
        parameters = found["friction"]["parameters"]
        assert parameters["coulomb"] == model.dof_frictionloss[dof]
        assert parameters["viscous"] == model.dof_damping[dof]
        assert found.get("mechanics", {}).get("inertia", 0.0) == model.dof_armature[dof]
        if name == "b":
            assert found["friction"]["modifiers"] == {"viscous": {"quadratic": 0.2, "cubic": 0.3}}
            assert found["axis"] == "linear"


def test_the_command_writes_a_model_file_and_names_what_is_missing(tmp_path, capsys):
    path = tmp_path / "m2.json"
    parameters = {"friction_base": 0.05, "friction_stribeck": 0.02, "dtheta_stribeck": 0.2, "alpha": 1.5}
    parameters |= {"friction_viscous": 0.01, "armature": 3e-3, "model": "m2", "load_friction_motor": 0.2, "kt": 1.2}
    path.write_text(json.dumps(parameters))
    output = tmp_path / "axis.yaml"
    words = ["import", str(path), "--from", "bam", "--output", str(output)]
    assert main(words) == 0
    printed = capsys.readouterr().out
    file = load_model_file(output)
    assert file.friction_model.steady_state([1.0]) == pytest.approx(0.06 + 0.02 * math.exp(-(5.0**1.5)))
    assert file.mechanics.inertia == 3e-3
    for each in ("standard errors", "range of velocity", "period", "delay of the torque", "load_friction_motor 0.2"):
        assert each in printed
        assert each in output.read_text()
        assert any(each in flag for flag in file.fit["flags"])
    assert main([*words, "--force", "--joint", "x"]) == 2
    assert "one actuator" in capsys.readouterr().err
    assert main(words) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*words, "--force", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["model"]["axis"] == "rotary"


URDF = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <joint name="a" type="revolute"><dynamics damping="0.5"/></joint>
  <joint name="b" type="revolute"/>
  <joint name="c" type="prismatic"><dynamics damping="0" friction="0"/></joint>
  <joint name="d" type="floating"/>
</robot>"""


def test_friction_that_is_not_stated_is_missing_and_no_friction_is_none(tmp_path):
    only = imported(tmp_path, URDF, "urdf")  # the joint a: the others state zero or nothing
    assert only.content["friction"]["parameters"] == {"coulomb": 0.0, "viscous": 0.5}
    coulomb, viscous = ("the Coulomb friction (friction): zero stands for it", "the viscous friction (damping): zero")
    assert coulomb in only.missing
    assert not any(each.startswith(viscous) for each in only.missing)
    neither = imported(tmp_path, URDF, "urdf", "b").missing
    assert coulomb in neither
    assert any(each.startswith(viscous) for each in neither)
    assert not any("zero stands" in each for each in imported(tmp_path, URDF, "urdf", "c").missing)
    with_joint = MJCF.replace('name="d" frictionloss="0.7"', 'name="d"')
    assert any("frictionloss" in each for each in imported(tmp_path, with_joint, "mjcf", "d").missing)
    assert not any("frictionloss" in each for each in imported(tmp_path, MJCF, "mjcf", "a").missing)


def one_joint(joint, actuator=""):
    body = f'<body>{joint}<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
    return f"<mujoco><worldbody>{body}</worldbody><actuator>{actuator}</actuator></mujoco>"


def test_the_inertia_of_a_motor_counts_and_other_actuators_are_named(tmp_path):
    joint = '<joint name="j" axis="0 0 1" armature="0.1" damping="0.5"/>'
    motor = '<dcmotor joint="j" motorconst="0.1" resistance="1" input="none" armature="0.2" damping="0.3"/>'
    found = imported(tmp_path, one_joint(joint, motor), "mjcf", "j").content
    assert found["mechanics"]["inertia"] == pytest.approx(0.3)
    assert found["friction"]["parameters"]["viscous"] == pytest.approx(0.8)
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(one_joint(joint, motor))
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = 1.0
    mujoco.mj_forward(model, data)
    assert 1.0 / data.qacc[0] == pytest.approx(1.0 + found["mechanics"]["inertia"])  # that of the body added
    notes = imported(tmp_path, one_joint(joint, '<position joint="j" damping="0.3" armature="0.2"/>'), "mjcf").notes
    assert "left out: damping 0.3 and armature 0.2 of the actuator <position> on this joint" in notes


def test_copies_of_a_body_have_the_friction_of_the_one(tmp_path):
    copies = '<replicate count="2"><body><joint name="j" frictionloss="0.3"/></body></replicate>'
    found = imported(tmp_path, f"<mujoco><worldbody>{copies}</worldbody></mujoco>", "mjcf")
    assert found.content["friction"]["parameters"]["coulomb"] == 0.3


def test_a_name_with_a_line_break_stays_in_the_comment(tmp_path, capsys):
    path, output = tmp_path / "m1.json", tmp_path / "axis.yaml"
    given = {"model": "m1", "friction_base": 0.05, "friction_viscous": 0.01, "actuator": "a\nversion: 4"}
    path.write_text(json.dumps(given | {"load_friction_a\nversion: 3\nx": 0.1}))
    assert main(["import", str(path), "--from", "bam", "--output", str(output)]) == 0
    assert load_model_file(output).friction.parameters["coulomb"] == 0.05
    for place in ("none/axis.yaml", "."):
        assert main(["import", str(path), "--from", "bam", "--output", str(tmp_path / place)]) == 2
        assert "folder" in capsys.readouterr().err


BOMB = """<!DOCTYPE lolz [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]><robot name="&b;"/>"""


@pytest.mark.parametrize(
    ("text", "source", "joint", "message"),
    [
        (BOMB, "urdf", None, "document type"),
        ("<robot>" * 300, "urdf", None, "300|200 deep"),
        ("<robot", "urdf", None, "is not XML"),
        (MJCF, "urdf", None, "<mujoco>, not <robot>"),
        (MJCF, "mjcf", None, "several joints.*--joint"),
        (MJCF, "mjcf", "e", "no joint 'e'"),
        (MJCF, "mjcf", "c", "'ball'"),
        (MJCF.replace("0.7", "nan"), "mjcf", "d", "finite"),
        (MJCF.replace("0.7", "-1"), "mjcf", "d", "not below zero"),
        (MJCF.replace('class="tiny" ', 'class="other" '), "mjcf", "d", "no default class 'other'"),
        ("<robot/>", "urdf", None, "no friction"),
        (URDF.replace('name="b"', 'name="a"'), "urdf", None, "several joints have the name 'a'"),
        (URDF.replace('"0.5"', '"${d}"'), "urdf", "a", r"joint 'a': damping: '\$\{d\}' must be numbers"),
        (URDF.replace('"0.5"', '"1 2"'), "urdf", "a", "must be one finite number"),
        ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>', "urdf", None, "with xacro"),
        ('<robot xmlns="http://www.ros.org"/>', "urdf", None, "not <robot> without a namespace"),
        ('<mujoco><worldbody><include file="b.xml"/></worldbody></mujoco>', "mjcf", None, "includes are not read"),
        (MJCF.replace('name="d"', 'name="a"'), "mjcf", None, "several joints have the name 'a'"),
        (one_joint('<joint name="j" damping="2" springdamper="0.1 1"/>'), "mjcf", None, "springdamper"),
        (one_joint('<joint name="j"/>', '<dcmotor joint="j" damping="1" gear="x"/>'), "mjcf", None, "gear"),
        ("[1]", "bam", None, "no file of BAM"),
        ("{", "bam", None, "is not JSON"),
        ('{"model": "m1", "friction_base": NaN}', "bam", None, "friction_base must be a finite number"),
        ('{"model": "m1", "friction_base": -1, "friction_viscous": 0}', "bam", None, "below zero"),
        ('{"model": "m1"}', "bam", "x", "one actuator"),
        (
            '{"model": "m2", "friction_base": 1, "friction_viscous": 0, "friction_stribeck": 1, "dtheta_stribeck": 0, '
            '"alpha": 1}',
            "bam",
            None,
            "makes no model",
        ),
        ('{"model": "m1", "friction_base": 1' + 400 * "0" + "}", "bam", None, "friction_base must be a finite number"),
        ('{"model": "m2", "friction_base": 1, "friction_viscous": 0}', "bam", None, "friction_stribeck is missing"),
        ("{}", "sdf", None, "no source 'sdf'"),
    ],
)
def test_files_that_are_wrong_are_refused(tmp_path, text, source, joint, message):
    with pytest.raises(UsageError, match=message):
        imported(tmp_path, text, source, joint)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(FrictionHilError, match=r"none\.xml"):
        foreign.read(tmp_path / "none.xml", "mjcf")


def test_a_soft_dry_friction_is_said_not_to_be_in_the_model(tmp_path):
    """MuJoCo's default lets a joint creep under its frictionloss; what the export wrote hardly does."""
    (stiff,) = fh.export.convert("coulomb:coulomb=0.1,viscous=0.01", "mjcf", name="x", speed=2.0).files.values()
    soft = "solimpfriction 0.9"
    assert not any(soft in each for each in imported(tmp_path, stiff, "mjcf").notes)
    assert any(soft in each for each in imported(tmp_path, MJCF, "mjcf", "d").notes)
