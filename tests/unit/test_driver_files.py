"""``config check`` reads what a driver's keys name, and opens nothing for that."""

import json
from pathlib import Path

import pytest
import yaml
from friction_hil_drivers.ascii import DESCRIPTIONS

from friction_hil.cli import main
from tests.servo_drives import axis_dict

ODRIVE = (DESCRIPTIONS / "odrive.yaml").read_text()
CONTROLLER = {"position_gain": 1.0, "velocity_gain": 0.1}


@pytest.fixture
def check(tmp_path, capsys):
    def run(bus=None, period_s=4e-3, **changes):
        axis = {**axis_dict(mode="cst", controller=CONTROLLER), **changes}
        if axis["driver"] != "canopen":
            del axis["node"]
        given = {"version": 1, "period_s": period_s, "axes": {"x": axis}, **({} if bus is None else {"bus": bus})}
        path = tmp_path / "config.yaml"
        path.write_text(yaml.safe_dump(given))
        status = main(["config", "check", "--json", str(path)])
        (report,) = json.loads(capsys.readouterr().out)["files"]
        assert status == (2 if report["problems"] else 0)
        return report["problems"]

    return run


def odrive(**changes):
    line = {"port": "/dev/there/is/none", "baud": 921600}
    return {"driver": "ascii", "line": line, "description": "odrive", "torque_constant": 0.1, **changes}


def test_what_is_right_is_said_to_be_right_although_nothing_is_connected(check):
    assert check(**odrive()) == []


def test_a_mistake_in_a_description_is_told_with_its_file_line_and_field(check, tmp_path):
    text = ODRIVE.replace("velocity: {unit: turn/s", "velocity: {unit: turns/s")
    (tmp_path / "mine.yaml").write_text(text)
    line = 1 + next(k for k, row in enumerate(text.splitlines()) if "unit: turns/s" in row)
    (problem,) = check(**odrive(description="mine.yaml"))
    assert (Path(problem["path"]).name, problem["line"]) == ("mine.yaml", line)
    assert problem["field"] == "signals.velocity.unit"
    assert "did you mean 'turn/s'" in problem["message"]


@pytest.mark.parametrize(
    ("changes", "field", "message"),
    [
        ({"description": "odrvie"}, "description", "did you mean 'odrive'"),
        ({"description": "missing.yaml"}, "", "cannot be read"),
        ({"torque_constant": None}, "line", "give torque_constant of the axis"),
        ({"period_s": 1e-3, "line": {"port": "/dev/none", "baud": 9600}}, "line", "is too short for /dev/none"),
    ],
)
def test_what_connecting_would_refuse_is_told_at_its_key(check, tmp_path, changes, field, message):
    (problem,) = check(**{key: value for key, value in odrive(**changes).items() if value is not None})
    assert message in problem["message"]
    if field:
        assert problem["field"] == f"axes.x.{field}"
        rows = (tmp_path / "config.yaml").read_text().splitlines()
        assert rows[problem["line"] - 1].strip().startswith(f"{field}:")


def test_an_eds_that_cannot_be_read_is_told_at_its_key(check):
    (problem,) = check(driver="canopen", eds="none.eds", bus={"interface": "virtual", "channel": "no"})
    assert problem["field"] == "axes.x.eds"
    assert "none.eds cannot be read" in problem["message"]


@pytest.mark.parametrize("value", [0, -1, 11])
def test_all_bounds_of_a_number_are_told_whichever_was_broken(check, value):
    (problem,) = check(**odrive(watchdog_s=value))
    assert problem["message"] == f"must be above 0 and at most 10, not {value}"
