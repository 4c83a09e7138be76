"""``config check`` reads what a driver's keys name, and opens nothing for that."""

import json
import re
from pathlib import Path

import pytest
import yaml
from friction_hil_drivers.ascii import DESCRIPTIONS
from friction_hil_drivers.modbus.description import DESCRIPTIONS as REGISTERS

from friction_hil.cli import main
from tests.serial_rig import CONTROLLER
from tests.servo_drives import axis_dict

ODRIVE = (DESCRIPTIONS / "odrive.yaml").read_text()
LINE = {"port": "/dev/none", "baud": 921600}


def write_configuration(folder, bus=None, period_s=4e-3, **axes):
    axes = {name: {**axis_dict(mode="cst", controller=CONTROLLER), **given} for name, given in axes.items()}
    for axis in axes.values():
        if axis["driver"] != "canopen":
            del axis["node"]
    path = folder / "config.yaml"
    given = {"version": 1, "period_s": period_s, "axes": axes, **({} if bus is None else {"bus": bus})}
    path.write_text(yaml.safe_dump(given))
    return path


@pytest.fixture
def check(tmp_path, capsys):
    def run(bus=None, period_s=4e-3, **axis):
        status = main(["config", "check", "--json", str(write_configuration(tmp_path, bus, period_s, x=axis))])
        (report,) = json.loads(capsys.readouterr().out)["files"]
        assert status == (2 if report["problems"] else 0)
        return report["problems"]

    return run


def odrive(**changes):
    return {"driver": "ascii", "line": LINE, "description": "odrive", "torque_constant": 0.1, **changes}


def test_what_is_right_is_said_to_be_right_although_nothing_is_connected(check):
    assert check(**odrive()) == []


def test_a_mistake_in_a_description_is_told_with_its_file_line_and_field(check, tmp_path):
    text = ODRIVE.replace("velocity: {unit: turn/s", "velocity: {unit: turns/s")
    (tmp_path / "mine.yaml").write_text(text)
    line = 1 + next(k for k, row in enumerate(text.splitlines()) if "unit: turns/s" in row)
    (problem,) = check(**odrive(description="mine.yaml"))
    assert (Path(problem["path"]).name, problem["line"]) == ("mine.yaml", line)
    assert problem["field"] == "signals.velocity.unit"
    assert "'turn/s'" in problem["message"]


@pytest.mark.parametrize(
    ("changes", "field", "message"),
    [
        ({"description": "odrvie"}, "description", "'odrive'"),
        ({"description": "missing.yaml"}, "", "cannot be read"),
        ({"description": "no_watchdog.yaml", "is_watchdog_required": True}, "is_watchdog_required", "torque stays"),
        ({"watchdog_s": 1e-3}, "watchdog_s", "0.001 s"),
        ({"watchdog_s": 0}, "watchdog_s", "above 0 and at most 10, not 0"),
        ({"watchdog_s": 11}, "watchdog_s", "above 0 and at most 10, not 11"),
        ({"line": {**LINE, "port": "tcp://x"}}, "line.port", "tcp://HOST:PORT"),
        ({"line": {**LINE, "port": "TCP://x:502"}}, "line.port", "tcp://HOST:PORT"),
        ({"line": {**LINE, "port": "/dev/\0"}}, "line.port", "printable"),
        ({"line": {**LINE, "reply_limit_s": 1e-6}}, "line.reply_limit_s", "1e-06 s"),
        ({"period_s": 1e-3, "line": {**LINE, "baud": 9600}}, "line", "too short for /dev/none"),
    ],
)
def test_what_connecting_would_refuse_is_told_at_its_key(check, tmp_path, changes, field, message):
    (tmp_path / "no_watchdog.yaml").write_text(re.sub("^watchdog: .*$", "", ODRIVE, flags=re.MULTILINE))
    (problem,) = check(**odrive(**changes))
    assert message in problem["message"]
    if field:
        assert problem["field"] == f"axes.x.{field}"
        assert row_of(problem, tmp_path).startswith(f"{field.rpartition('.')[2]}:")


def row_of(problem, tmp_path):
    rows = (tmp_path / "config.yaml").read_text().splitlines()
    return rows[problem["line"] - 1].strip()


def test_every_key_that_the_drives_units_need_is_told_at_the_axis_that_lacks_it(check, tmp_path):
    problems = check(driver="modbus", unit=3, description="generic_cia402", line=LINE)
    assert {problem["field"] for problem in problems} == {"axes.x.counts_per_unit", "axes.x.rated_torque"}
    for problem in problems:
        assert row_of(problem, tmp_path) == "x:"


def test_a_run_that_is_refused_for_a_key_tells_its_line_too(tmp_path, capsys):
    path = write_configuration(tmp_path, x=odrive(watchdog_s=1e-3))
    assert main(["run", str(path)]) == 2
    line = 1 + next(k for k, row in enumerate(path.read_text().splitlines()) if "watchdog_s" in row)
    assert f"{path}:{line}: axes.x.watchdog_s: 0.001 s" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("scale", "watchdog_s", "message"),
    [
        (1.0, 2.0, None),  # seconds, of which there are more than the shortest watchdog would have
        (1.0, 0.4, "0.4 s"),
        (1e-5, 0.5, None),
        (1e-5, 0.7, "at most 0.65535 s, not 0.7 s"),
    ],
)
def test_a_watchdog_is_given_only_times_that_its_register_can_hold(check, tmp_path, scale, watchdog_s, message):
    data = yaml.safe_load((REGISTERS / "generic_cia402.yaml").read_text())
    data["signals"][data["watchdog"]["signal"]] = {"address": 0x300, "type": "uint16", "unit": "s", "scale": scale}
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(data))
    given = {"unit": 3, "counts_per_unit": 1e5, "rated_torque": 1.0, "line": LINE}
    problems = check(driver="modbus", description="mine.yaml", watchdog_s=watchdog_s, **given)
    assert [problem["field"] for problem in problems] == ["axes.x.watchdog_s"] * (message is not None)
    assert all(message in problem["message"] for problem in problems)


def test_an_eds_that_cannot_be_read_is_told_at_its_key(check):
    (problem,) = check(driver="canopen", eds="none.eds", bus={"interface": "virtual", "channel": "no"})
    assert problem["field"] == "axes.x.eds"
    assert "none.eds" in problem["message"]


def test_axes_of_two_drivers_are_told_by_check_as_by_run(tmp_path, capsys):
    bus = {"interface": "virtual", "channel": "no"}
    path = write_configuration(tmp_path, bus, x={"node": 3}, y=odrive())
    told = []
    for command in (["config", "check"], ["run"]):
        assert main([*command, str(path)]) == 2
        told.append(capsys.readouterr().err)
    line = 1 + path.read_text().splitlines().index("    driver: ascii")
    assert f"{path}:{line}: axes.y.driver: is ascii" in told[0]
    assert told[0] in told[1]
