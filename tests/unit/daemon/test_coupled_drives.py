"""Simulated drives that share a mechanism: the key in the configuration, and nodes on one bus."""

import contextlib
import copy
import functools
import itertools
import operator
import re
import struct
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
import yaml
from friction_hil_drivers.canopen.simulated import SimulatedCanopenDrives

from friction_hil.checked_yaml.text import dump
from friction_hil.config import Configuration, from_dict, load, self_contained
from friction_hil.config.simulation import simulated_servos
from friction_hil.daemon.assembly import periodic_path
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import ConfigurationError, OptionError, UsageError
from friction_hil.rehearsal import AxisRun, Motion, Rehearsal, rehearse, simulated_machines
from friction_hil.tuning import TuneSettings, tune
from tests.servo_drives import ServoDrives, make_loop

FOLDER = Path(__file__).parents[3] / "config/machines"
TEXT = (FOLDER / "gantry.yaml").read_text()
_channels = itertools.count()


def edited(machine: str = "gantry", **changes: Any) -> dict[str, Any]:
    """A machine's file as plain values; keys with double underscores reach into it, None removes."""
    data = yaml.safe_load(dump(self_contained(load(FOLDER / f"{machine}.yaml"))))
    for path, value in changes.items():
        *steps, last = path.split("__")
        place = functools.reduce(operator.getitem, steps, data)
        place[last] = copy.deepcopy(value)
        if value is None:
            del place[last]
    return data


def test_a_configuration_keeps_its_mechanism_without_its_file() -> None:
    configuration = load(FOLDER / "two_link_arm.yaml")
    assert from_dict(self_contained(configuration), "test").simulation == configuration.simulation
    shared = configuration.simulation
    assert shared is not None
    assert shared.mechanism.axes == ("shoulder", "elbow")
    servos = simulated_servos(configuration, configuration.axes)
    assert list(servos) == ["shoulder", "elbow"]
    assert servos["shoulder"].total_inertia > configuration.axes["shoulder"].simulation.mechanics.inertia  # type: ignore[union-attr]


def test_other_axes_of_the_file_stay_alone() -> None:
    data = edited()
    data["axes"] = {"x": {**copy.deepcopy(data["axes"]["y1"]), "node": 3}, **data["axes"]}
    configuration = from_dict(data, "test")
    servos = simulated_servos(configuration, configuration.axes)
    for name in ("x", "y1"):
        servos[name].command(10, 200.0)
    for name in ("x", "y1", "y2"):
        servos[name].advance(8000)
    assert servos["x"].total_inertia == 14.8
    assert servos["x"].true_position > servos["y1"].true_position > servos["y2"].true_position > 1e-5


INERTIA = "        inertia: 14.8\n"
LOAD = "        load: {inertia: 9.0, stiffness: 1e6}\n"
GAIN = "velocity_gain: 9000.0, integral_hz: 5.0}\n"


@pytest.mark.parametrize(
    ("old", "new", "field", "words"),
    [
        ("axes: [y1, y2]", "axes: [y1, z2]", "mechanism.axes[1]", "'z2'.*: y1, y2"),
        ("axes: [y1, y2]", "axes: [y1, y1]", "mechanism.axes", "not y1 twice"),
        ("kind: gantry", "kind: gantri", "mechanism.kind", "'gantry', 'two_link_arm'"),
        ("span: 1.2 ", "span: 0.0 ", "mechanism.span", "above 0, not 0.0"),
        ("span: 1.2 ", "span: .inf ", "mechanism.span", "finite"),
        ("span: 1.2 ", "spam: 1.2 ", "mechanism.spam", "'span'"),
        ("  mechanism: ", "  machanism: ", "machanism", "'mechanism'"),
        (f"        axis: linear\n{INERTIA}", INERTIA, "axes.y2.simulation.mechanics.axis", "linear"),
        (INERTIA, INERTIA + LOAD, "axes.y2.simulation.mechanics.load", "y2 .* rigid"),
        (
            GAIN,
            "velocity_gain: 9000.0}\n      integration_hz: 160000\n",
            "axes.y2.simulation.integration_hz",
            "160000.* y1 is 80000",
        ),
    ],
)
def test_mistakes_are_reported_with_their_line(tmp_path: Path, old: str, new: str, field: str, words: str) -> None:
    path = tmp_path / "gantry.yaml"
    assert old in TEXT
    path.write_text(TEXT.replace(old, new))
    with pytest.raises(ConfigurationError) as caught:
        load(path)
    field = field if field.startswith("axes.") else f"simulation.{field}"
    [problem] = [each for each in caught.value.problems if each.field == field]
    assert re.search(words, problem.message)
    assert problem.line is not None


SIX = "six_joint_arm"


@pytest.mark.parametrize(
    ("old", "new", "field", "words"),
    [
        (f"file: {SIX}", "file: nowhere", "simulation.mechanism", "nowhere.urdf cannot be read"),
        ("elbow: joint3", "elbow: joint9", "simulation.mechanism", "no joint 'joint9'"),
        ("elbow: joint3", "elbows: joint3", "simulation.mechanism.axes.elbows", "no axis 'elbows'.*'elbow'"),
        (
            "    payload:",
            "    signs: {arm: -1}\n    payload:",
            "simulation.mechanism.signs.arm",
            "no axis of the mechanism",
        ),
        (
            "{inertia: 0.04, ",
            "{axis: linear, inertia: 0.04, ",
            "axes.flange.simulation.mechanics.axis",
            "rotary.*joint6",
        ),
        ("{inertia: 0.04, ", f"{{{LOAD.strip()}, inertia: 0.04, ", "axes.flange.simulation.mechanics.load", "rigid"),
    ],
)
def test_mistakes_of_an_arm_are_reported_with_their_line(
    tmp_path: Path, old: str, new: str, field: str, words: str
) -> None:
    path, text = tmp_path / "arm.yaml", (FOLDER / f"{SIX}.yaml").read_text()
    (tmp_path / f"{SIX}.urdf").write_bytes((FOLDER / f"{SIX}.urdf").read_bytes())
    assert old in text
    path.write_text(text.replace(old, new, 1))  # the mechanism stands before `arm`, which has the same keys
    with pytest.raises(ConfigurationError) as caught:
        load(path)
    [problem] = [each for each in caught.value.problems if each.field == field]
    assert re.search(words, problem.message)
    assert problem.line is not None


def test_the_file_of_an_arm_stands_beside_its_configuration_and_a_recording_does_not_read_it(tmp_path: Path) -> None:
    configuration = load(FOLDER / f"{SIX}.yaml")
    data = self_contained(configuration)
    assert data["simulation"]["mechanism"]["file"] == str(FOLDER / f"{SIX}.urdf")
    assert len(simulated_servos(configuration, configuration.axes)) == 6
    data["simulation"]["mechanism"]["file"] = str(tmp_path / "gone.urdf")
    alone = from_dict(data, "test", reads_files=False)
    with pytest.raises(UsageError, match=r"gone\.urdf cannot be read"):
        simulated_servos(alone, alone.axes)


MODBUS = {"driver": "modbus", "line": {"port": "/dev/ttyUSB0"}, "description": "kinco_fd5p.yaml", "mode": "csv"}


def test_axes_on_serial_lines_and_without_simulated_drive_are_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"axes\[1\]: y2 .*'simulation'"):
        from_dict(edited(axes__y2__simulation=None), "test")
    axes = {}
    for unit, name in enumerate(("y1", "y2"), start=1):
        axis = edited()["axes"][name]
        shared = {key: axis[key] for key in ("limits", "model", "trajectory", "simulation")}
        axes[name] = {**shared, **MODBUS, "unit": unit}
        del axes[name]["simulation"]["canopen"], axes[name]["simulation"]["trajectory"]
    with pytest.raises(ConfigurationError) as caught:
        from_dict(edited(axes=axes, bus=None), "test")
    messages = [each.message for each in caught.value.problems if each.field.startswith("simulation.")]
    assert len(messages) == 2
    assert "y1 has the driver modbus" in messages[0]


def test_tune_refuses_to_twist_a_gantry(tmp_path: Path) -> None:
    settings = TuneSettings(folder=tmp_path / "results", names=("y2",), is_simulated=True)
    with pytest.raises(OptionError, match=r"y2: simulation: .* y1.*friction-hil identify"):
        tune(load(FOLDER / "gantry.yaml"), settings, None)  # type: ignore[arg-type]
    assert not settings.folder.exists()


@pytest.mark.deep
@pytest.mark.parametrize("machine", ["gantry", "two_link_arm", "six_joint_arm"])
def test_the_compensator_helps_each_axis_of_a_mechanism(machine: str) -> None:
    """One period before and one after the compensation begins, all axes in motion; and the rehearsal agrees."""
    data = edited(machine, bus={"interface": "virtual", "channel": f"coupled-{next(_channels)}"})
    for axis in data["axes"].values():
        axis["compensation"]["baseline_s"] = 4.0
    configuration = from_dict(data, "test")
    drives = ServoDrives(configuration)
    drives.servos = list(simulated_servos(configuration, configuration.axes).values())
    for servo in drives.servos:
        servo.set_period(configuration.period_s)
    loop, sink, _ = make_loop(configuration, drives, duration_s=7.6)
    assert loop.run().faults == []
    loops = {}
    for name, axis in configuration.axes.items():
        demand, position = (np.array(sink.column(name, column)) for column in ("position_demand", "position"))
        error = (demand - position)[np.array(sink.column(name, "state")) == LoopState.RUNNING]
        period = round(1e3 / axis.trajectory.frequency)  # type: ignore[union-attr]
        without, compensated = error[4000 - period : 4000], error[7500 - period : 7500]
        assert np.std(compensated) < 0.7 * np.std(without)
        assert np.abs(compensated).max() < 0.7 * np.abs(without).max()
        loops[name] = np.std([without, compensated], axis=1)
    assert rehearsed_errors(configuration) == {name: pytest.approx(found, rel=0.05) for name, found in loops.items()}


def rehearsed_errors(configuration: Configuration) -> dict[str, list[float]]:
    """RMS over a period by axis, without and with compensation, of the motions from where simulated drives start."""
    [machine] = simulated_machines(configuration)
    runs = []
    for axis in machine.axes:
        trajectory: Any = axis.config.trajectory
        path = periodic_path(trajectory)
        motion = Motion(
            lambda s, path=path: (path(s)[0] - path(0.0)[0], *path(s)[1:]),
            1.0 / trajectory.frequency,
            ramp_s=0.25,
            start_s=2.5,
        )
        runs.append(AxisRun(Rehearsal(axis.config, axis.facts, 1e-3), axis.servo, axis.config.model, motion))
    found: dict[str, list[float]] = {axis.name: [] for axis in machine.axes}
    for is_compensated in (False, True):
        traces = rehearse(machine.mechanism, runs, is_compensated=is_compensated)
        for axis, run, trace in zip(machine.axes, runs, traces, strict=True):
            found[axis.name].append(float(np.std(trace["error"][-round(1e3 * run.motion.duration_s) :])))
    return found


class Bench:
    """The gantry's nodes on a bus in this process, y1 under power in cst and y2 without, in simulated time."""

    def __init__(self, names: tuple[str, ...]) -> None:
        channel = f"coupled-{next(_channels)}"
        data = edited(bus={"interface": "virtual", "channel": channel})
        data["axes"] = {name: data["axes"][name] for name in names}
        configuration = from_dict(data, "test")
        self.bus = can.Bus(interface="virtual", channel=channel)
        self.drives = SimulatedCanopenDrives(configuration, configuration.axes, pace="sync")
        self.drives.open()
        words = [(0x6040, "h", word) for word in (6, 7, 15)]
        for index, code, value in ((0x6060, "b", 10), *words, (0x6071, "h", 400)):
            command = {"b": 0x2F, "h": 0x2B}[code]
            self.send(0x601, struct.pack(f"<BHB{code}", command, index, 0, value).ljust(8, b"\0"))
        self.run(5)

    def send(self, can_id: int, data: bytes) -> None:
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def run(self, count: int) -> None:
        passed = itertools.count()
        self.drives.run(lambda: next(passed) >= count)

    def positions(self, syncs: int) -> list[tuple[int, int]]:
        """Node and 6064h, read after each SYNC, in the order of the answers."""
        for _ in range(syncs):
            self.send(0x080, b"")
            for node in (1, 2):
                self.send(0x600 + node, struct.pack("<BHB4x", 0x40, 0x6064, 0))
        self.run(3 * syncs)
        found = []
        while (message := self.bus.recv(0.0)) is not None:
            if message.data[:4] == struct.pack("<BHB", 0x43, 0x6064, 0):
                found.append((message.arbitration_id - 0x580, struct.unpack_from("<i", message.data, 4)[0]))
        return found

    def close(self) -> None:
        self.drives.close()
        self.bus.shutdown()


def test_a_motor_takes_the_other_end_of_the_beam_along_whatever_the_order_of_the_nodes() -> None:
    """The same bits with the axes in either order; and both nodes show the same instant at a SYNC."""
    courses = []
    for names in (("y1", "y2"), ("y2", "y1"), ("y1", "y2")):
        with contextlib.closing(Bench(names)) as bench:
            courses.append(bench.positions(60))
    assert courses[0] == courses[1] == courses[2]
    first, second = ([position for node, position in courses[0] if node == wanted] for wanted in (1, 2))
    assert len(first) == len(second) == 60
    assert first[-1] > second[-1] > 1000  # 0.1 mm
    # of the same state: the yaw of the beam is the only difference, and it is stiff
    assert max(abs(a - b) for a, b in zip(first, second, strict=True)) < 0.2 * first[-1]
