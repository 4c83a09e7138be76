"""Logs of raw CAN frames: written by python-can, from frames of the driver's own encoder, and read back."""

import json
import struct
import zlib
from pathlib import Path

import can
import numpy as np
import pytest
from friction_hil_drivers.canopen.connect.configure import ConfiguredDrive
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.canopen.cycle.axis import CanopenAxis
from friction_hil_drivers.canopen.wire import cia301, frame_log
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.codec import COMMANDS, FEEDBACK, block_layout
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.units import DriveUnits

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.config import Configuration, from_dict, load, self_contained
from friction_hil.drive import AxisFacts, Command, DriveState, Feedback, Mode, Request
from friction_hil.errors import FrictionHilError, RecordingError, UsageError

ROOT = Path(__file__).parents[3]
CYCLES = 60
PERIOD = 1e-3
UNITS = DriveUnits(counts_per_unit=65536 / (2.0 * np.pi), velocity_per_unit=65536 / (2.0 * np.pi), rated_torque=0.5)
WRITERS = {".log": can.CanutilsLogWriter, ".asc": can.ASCWriter, ".blf": can.BLFWriter}
FACTS = AxisFacts("x", "", 1e-4, 1e-3, 0.0, 0.0)


@pytest.fixture(params=["csp", "csv", "cst"])
def mode(request: pytest.FixtureRequest) -> Mode:
    return Mode[request.param.upper()]


@pytest.fixture
def configuration(tmp_path: Path, mode: Mode) -> Configuration:
    return load(machine(tmp_path, mode))


def machine(folder: Path, mode: Mode, *keys: str) -> Path:
    """The example configuration of one axis in some mode, with further keys of the axis."""
    text = (ROOT / "config" / "single_axis_csp.yaml").read_text()
    text = text.replace("mode: csp", f"mode: {mode.name.lower()}")
    if mode is not Mode.CSP:
        gains = "position_gain: 50.0" + (", velocity_gain: 0.01" if mode is Mode.CST else "")
        text = text.replace("    trajectory:", f"    controller: {{{gains}}}\n    trajectory:")
    for key in keys:
        name = key.partition(":")[0]
        text = "\n".join(f"    {key}" if line.startswith(f"    {name}:") else line for line in text.splitlines())
    path = folder / "machine.yaml"
    path.write_text(text)
    (folder / "models").mkdir(exist_ok=True)
    (folder / "models" / "lugre_axis.yaml").write_text((ROOT / "config" / "models" / "lugre_axis.yaml").read_text())
    return path


def drive(mode: Mode) -> CanopenAxis:
    """The driver's encoder and decoder of node 1."""

    def pdo(cob_id: int, entries: tuple[Object, ...]) -> MappedPdo:
        return MappedPdo(cob_id, entries, block_layout(entries, [entry.type.bits for entry in entries]))

    tpdos = tuple(pdo(cia301.TPDO_BASES[i] + 1, entries) for i, entries in enumerate(FEEDBACK))
    rpdo = pdo(cia301.RPDO_BASES[0] + 1, COMMANDS[mode])
    return CanopenAxis(ConfiguredDrive(FACTS, UNITS, mode, tpdos, (rpdo,), "", 1e-3), 1, 0.1)


def message(identifier: int, data: bytes, time: float) -> can.Message:
    return can.Message(timestamp=1e9 + time, arbitration_id=identifier, data=data, is_extended_id=False)


def reported(index: int, subindex: int, value: int) -> can.Message:
    """What a drive answers when the daemon asks for an object."""
    return message(0x581, struct.pack("<BHBI", 0x43, index, subindex, value), 0.0)


def session(mode: Mode, *, start: int = 2**31 - 700) -> tuple[list[can.Message], list[tuple[Feedback, Command]]]:
    """Frames of some cycles, and what the driver itself makes of them."""
    axis = drive(mode)
    frames = [reported(0x608F, 1, 65536), reported(0x608F, 2, 1), reported(0x6076, 0, 500)]
    truth = []
    for cycle in range(CYCLES):
        at = 1.0 + cycle * PERIOD
        counts = (start + cycle * 37 + 2**31) % 2**32 - 2**31  # through the end of the counter
        feedback, command = Feedback(), Command(Request.ENABLE, 0.1 * cycle, -0.2 * cycle, 0.003 * cycle)
        first, second = (pdo.layout for pdo in axis.drive.tpdos)
        data = [first.pack(0x27, counts, 5 * cycle - 100), second.pack(-11 * cycle, mode)]
        axis.begin_cycle(0)
        for pdo, content in zip(axis.drive.tpdos, data, strict=True):
            axis.handlers[pdo.cob_id](content)
        axis.report(feedback, 0)
        [(identifier, content)] = axis.encode(command)
        frames.append(message(0x080, b"", at))
        frames += [message(pdo.cob_id, d, at + 1e-4) for pdo, d in zip(axis.drive.tpdos, data, strict=True)]
        frames.append(message(identifier, content, at + 3e-4))
        frames.append(message(0x701, b"\x05", at + 4e-4))
        truth.append((feedback, command))
    return frames, truth


def write(path: Path, frames: list[can.Message]) -> Path:
    writer = {**WRITERS, ".trc": can.TRCWriter}[path.suffix](str(path))
    for frame in frames:
        frame.channel = 1 if path.suffix == ".trc" else frame.channel
        writer.on_message_received(frame)
    writer.stop()
    return path


@pytest.mark.parametrize("suffix", [*WRITERS, ".trc"])
def test_a_log_says_what_the_driver_saw(suffix: str, tmp_path: Path, mode: Mode, configuration: Configuration) -> None:
    frames, truth = session(mode)
    read = fh.recordings.read(write(tmp_path / f"x{suffix}", frames), configuration=configuration)
    assert (read.axis, len(read), read.problems) == ("x", CYCLES, [])
    np.testing.assert_allclose(read["time_s"], np.arange(CYCLES) * PERIOD, atol=2e-6)
    np.testing.assert_array_equal(read["cycle"], np.arange(CYCLES))
    for name in ("position", "velocity", "torque"):
        np.testing.assert_allclose(read[name], [getattr(feedback, name) for feedback, _ in truth], rtol=1e-12)
    assert set(read["drive_state"]) == {DriveState.OPERATION_ENABLED}
    np.testing.assert_allclose(read["command"], [command.torque for _, command in truth], atol=0.26e-3)
    if mode is Mode.CSP:
        np.testing.assert_allclose(read["position_demand"], [c.position for _, c in truth], atol=1e-4)
    if mode is Mode.CSV:
        np.testing.assert_allclose(read["velocity_demand"], [c.velocity for _, c in truth], atol=1e-4)


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_log_cut_anywhere_is_reported(suffix: str, tmp_path: Path) -> None:
    configuration = load(machine(tmp_path, Mode.CSP))
    path = write(tmp_path / f"x{suffix}", session(Mode.CSP)[0])
    whole = fh.recordings.read(path, configuration=configuration)
    data = path.read_bytes()
    for cut in range(0, len(data) - 1, len(data) // 40):
        path.write_bytes(data[:cut])
        try:
            read = fh.recordings.read(path, configuration=configuration)
        except FrictionHilError as error:
            sentence = str(error)
        else:
            sentence = "; ".join(read.problems)
            for name in ("position", "torque"):
                np.testing.assert_array_equal(read[name], whole[name][: len(read)])
        # a line that ends where the cut is lacks nothing that could be seen
        assert "cut off" in sentence or "no frame of an axis" in sentence or data[cut - 1 : cut] == b"\n", cut


def test_lines_that_are_no_frames_cost_only_themselves(tmp_path: Path) -> None:
    """In a time proportional to their number: with its square, very many would take minutes."""
    configuration = load(machine(tmp_path, Mode.CSP))
    path = write(tmp_path / "x.log", session(Mode.CSP)[0])
    text = path.read_text()
    content = text.splitlines(keepends=True)
    content[20:20] = ["# a remark\n", "(1.0) can0 zzz#00\n"]
    path.write_text("".join(content))
    read = fh.recordings.read(path, configuration=configuration)
    assert (len(read), read.problems) == (CYCLES, ["2 lines are no frames (line 21, 22): left out"])
    path.write_text("(1.0) can0 zzz#00\n" * 20_000 + text)
    read = fh.recordings.read(path, configuration=configuration)
    assert read.problems == ["20000 lines are no frames (line 1, 2, 3, 4, 5, ...): left out"]


def test_a_blf_that_expands_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame_log, "_ANY_FILE", 10**5)
    configuration = load(machine(tmp_path, Mode.CSP))
    path = write(tmp_path / "x.blf", session(Mode.CSP)[0])
    packed = zlib.compress(bytes(10**6))
    container = struct.pack("<4sHHIIH6xI4x", b"LOBJ", 16, 1, 32 + len(packed), 10, 2, 10**6) + packed
    path.write_bytes(path.read_bytes() + container)
    with pytest.raises(RecordingError, match=r"hold more than .* split it"):
        fh.recordings.read(path, configuration=configuration)
    path.write_bytes(path.read_bytes().replace(container, container[:8] + bytes(4) + container[12:]))
    with pytest.raises(RecordingError, match=r"the object at byte \d+ claims 0 bytes"):
        fh.recordings.read(path, configuration=configuration)


def test_lost_frames_are_holes(tmp_path: Path) -> None:
    configuration = load(machine(tmp_path, Mode.CSP))
    frames = session(Mode.CSP)[0]
    at = [i for i, frame in enumerate(frames) if frame.arbitration_id == 0x080]
    lost = {at[5] + 1, at[9] + 2, at[12] + 3, at[20] + 1}  # TPDO 1, TPDO 2, RPDO, TPDO 1
    short = frames[at[30] + 1]
    short.data, short.dlc = short.data[:6], 6
    path = write(tmp_path / "x.log", [frame for i, frame in enumerate(frames) if i not in lost])
    read = fh.recordings.read(path, configuration=configuration)
    assert np.setdiff1d(np.arange(CYCLES), read["cycle"]).tolist() == [5, 20, 30]
    assert np.flatnonzero(np.isnan(read.columns["velocity"])).tolist() == [8]
    assert "1 of 58 frames of TPDO 1 have fewer bytes than its objects, 8: left out" in read.problems[0]
    assert "3 cycles are missing in 3 gaps, the first after cycle 4" in read.problems
    assert "velocity is not finite in 1 of 57 rows (row 8)" in read.problems


def test_without_sync_a_cycle_begins_with_its_first_frame(tmp_path: Path) -> None:
    configuration = load(machine(tmp_path, Mode.CSP))
    frames = [frame for frame in session(Mode.CSP)[0] if frame.arbitration_id != 0x080]
    read = fh.recordings.read(write(tmp_path / "x.log", frames), configuration=configuration)
    assert len(read) == CYCLES
    assert "cycle" not in read.columns
    assert np.isfinite(read["velocity"]).all()


def test_scales_come_from_the_configuration_first(tmp_path: Path) -> None:
    frames = [frame for frame in session(Mode.CSP)[0] if frame.arbitration_id != 0x581]
    path = write(tmp_path / "x.log", frames)
    with pytest.raises(RecordingError, match=r"node 1 in .*x\.log .* counts_per_unit"):
        fh.recordings.read(path, configuration=load(machine(tmp_path, Mode.CSP)))
    with pytest.raises(RecordingError, match="rated_torque"):
        fh.recordings.read(path, configuration=load(machine(tmp_path, Mode.CSP, "counts_per_unit: 100.0")))
    keys = ("counts_per_unit: 100.0", "rated_torque: 2.0", "is_inverted: true")
    read = fh.recordings.read(path, configuration=load(machine(tmp_path, Mode.CSP, *keys)))
    assert read["torque"][0] == 100 * 2e-3
    assert read["velocity"][1] == 11 / 100.0


def test_a_log_needs_a_configuration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "x.log", session(Mode.CSP)[0])
    with pytest.raises(UsageError, match=r"--config machine\.yaml"):
        fh.recordings.read(path)
    config = machine(tmp_path, Mode.CSP, "node: 7")
    with pytest.raises(RecordingError, match=r"187h \(x\); .* 080h, 181h, 201h, 281h, 581h, 701h"):
        fh.recordings.read(path, configuration=load(config))
    config = machine(tmp_path, Mode.CSP)
    assert main(["convert", str(path), str(tmp_path / "x.csv"), "--config", str(config)]) == 0
    assert f"{CYCLES} rows of" in capsys.readouterr().out
    assert main(["replay", str(path), "--config", str(config)]) == 0
    assert "lugre (as recorded)" in capsys.readouterr().out


def printed(frames: list[can.Message], time: str) -> str:
    """What ``candump -t`` prints of frames; ``time`` is its letter, empty without the option."""
    lines, before = [], frames[0].timestamp
    for frame in frames:
        at = frame.timestamp - (0.0 if time == "a" else before)
        date = str(np.datetime64(round(frame.timestamp * 1e6), "us")).replace("T", " ")
        stamp = {"": "", "A": f" ({date})"}.get(time, f" ({at:010.6f})")
        before = frame.timestamp if time == "d" else before
        data = " ".join(f"{byte:02X}" for byte in frame.data)
        lines.append(f"{stamp}  can0  {frame.arbitration_id:03X}   [{frame.dlc}]  {data}\n")
    return "".join(lines)


@pytest.mark.parametrize("suffix", [".log", ".txt"])
@pytest.mark.parametrize("time", ["a", "A", "z", "d", ""])
def test_what_candump_prints_is_read_where_it_has_times(tmp_path: Path, time: str, suffix: str) -> None:
    configuration = load(machine(tmp_path, Mode.CSP))
    frames, truth = session(Mode.CSP)
    path = tmp_path / f"x{suffix}"
    path.write_text(printed(frames, time))
    if not time:
        with pytest.raises(RecordingError, match=r"without their times.* candump -l, or candump -t a"):
            fh.recordings.read(path, configuration=configuration)
        return
    read = fh.recordings.read(path, configuration=configuration)
    np.testing.assert_allclose(read["time_s"], np.arange(CYCLES) * PERIOD, atol=CYCLES * 3e-6)
    np.testing.assert_allclose(read["position"], [feedback.position for feedback, _ in truth], rtol=1e-12)


def moving(*pdos: tuple[int, tuple[Object, ...]], told: bool = False) -> list[can.Message]:
    """Frames of a drive that moves, in a mapping of another master; ``told``: it reads the mapping first."""
    time = np.arange(400) * 5e-3
    counts = (40_000.0 * np.sin(3.0 * time)).round().astype(int)
    values: dict[Object, np.ndarray] = {
        objects.STATUSWORD: np.full(400, 0x1237),
        objects.POSITION_ACTUAL: counts,
        objects.VELOCITY_ACTUAL: (120_000.0 * np.cos(3.0 * time)).astype(int),
        objects.TORQUE_ACTUAL: (300.0 * np.cos(3.0 * time)).astype(int),
        objects.MODE_DISPLAY: np.full(400, 8),
    }
    frames = [reported(0x608F, 1, 65536), reported(0x608F, 2, 1), reported(0x6076, 0, 500)]
    for cob_id, entries in pdos if told else ():
        place = cob_id // 0x100 - 1
        frames += [reported(0x1800 + place, 1, cob_id), reported(0x1A00 + place, 0, len(entries))]
        frames += [reported(0x1A00 + place, k, entry.mapping) for k, entry in enumerate(entries, 1)]
    for row, at in enumerate(time):
        frames.append(message(0x080, b"", 1.0 + at))
        for cob_id, entries in pdos:
            layout = block_layout(entries, [entry.type.bits for entry in entries])
            data = layout.pack(*(int(values[entry][row]) for entry in entries))
            frames.append(message(cob_id, data, 1.0 + at + 1e-4))
    return frames


STATUS, ACTUAL = objects.STATUSWORD, objects.POSITION_ACTUAL
SPEED, TORQUE = objects.VELOCITY_ACTUAL, objects.TORQUE_ACTUAL
OF_OTHERS = {
    "profile": ((0x181, (STATUS,)), (0x381, (STATUS, ACTUAL)), (0x481, (STATUS, SPEED))),
    "position first": ((0x181, (ACTUAL, STATUS, TORQUE)), (0x281, (SPEED, objects.MODE_DISPLAY))),
    "position last": ((0x181, (STATUS, TORQUE, ACTUAL)), (0x281, (SPEED, objects.MODE_DISPLAY))),
    "torque first": ((0x181, (TORQUE, STATUS, ACTUAL)),),
    "position last, no velocity": ((0x181, (STATUS, TORQUE, ACTUAL)),),
    "no status": ((0x181, (ACTUAL, SPEED)), (0x281, (TORQUE,))),
}


@pytest.mark.parametrize("name", OF_OTHERS)
def test_the_mapping_of_another_master_is_used_where_stated_and_never_guessed(tmp_path: Path, name: str) -> None:
    pdos = OF_OTHERS[name]
    plain = load(machine(tmp_path, Mode.CSP))
    with pytest.raises(RecordingError, match=r"x: .*(carries|statuswords|jumps|velocity|moves by).*sidecar\.tpdos"):
        fh.recordings.read(write(tmp_path / "x.log", moving(*pdos)), configuration=plain)
    truth = 40_000.0 * np.sin(3.0 * np.arange(400) * 5e-3) / UNITS.counts_per_unit
    told = fh.recordings.read(write(tmp_path / "told.log", moving(*pdos, told=True)), configuration=plain)
    np.testing.assert_allclose(told["position"], truth, atol=1.0 / UNITS.counts_per_unit)
    assert any("SDO transfers of the log" in problem for problem in told.problems)
    if name == "no status":
        return  # which a sidecar needs
    path = tmp_path / "sidecar.yaml"
    tpdos = [{"cob_id": cob_id, "entries": [entry.index for entry in entries]} for cob_id, entries in pdos]
    path.write_text(SIDECAR.format(tpdos=json.dumps(tpdos)))
    read = fh.recordings.read(tmp_path / "x.log", configuration=load(path))
    np.testing.assert_allclose(read["position"], truth, atol=1.0 / UNITS.counts_per_unit)
    tpdos[0]["entries"] = [0x6041, 0x6064, 0x6061]  # seven bytes, which no frame has
    path.write_text(SIDECAR.format(tpdos=json.dumps(tpdos[:1])))
    with pytest.raises(RecordingError, match=r"181h carries \d bytes, .* 7 of 6041h .*sidecar"):
        fh.recordings.read(tmp_path / "x.log", configuration=load(path))


SIDECAR = """
version: 1
period_s: 0.005
bus: {{interface: virtual, channel: x, role: sidecar}}
axes:
  x:
    driver: canopen
    node: 1
    mode: csp
    counts_per_unit: 10430.378350470453
    rated_torque: 0.5
    limits: {{torque: 0.1, velocity: 50.0}}
    model: {{axis: rotary, friction: {{model: coulomb, parameters: {{coulomb: 0.05}}}}}}
    trajectory: {{kind: master}}
    sidecar:
      tpdos: {tpdos}
      offset: {{cob_id: 0x501, entries: [0x60B2]}}
"""


def _second_axis(folder: Path, mode: Mode, *names: str) -> Configuration:
    """Axes of node 1: ``x``, and ``y`` as its axis number 1."""
    values = self_contained(load(machine(folder, mode)))
    axis = values["axes"]["x"]
    axes = {"x": axis, "y": {**axis, "axis_number": 1}}
    return from_dict({**values, "axes": {name: axes[name] for name in names}}, "machine.yaml")


def _with_second_axis(mode: Mode) -> list[can.Message]:
    """The frames of both axes: the second one moves twice as far, on identifiers that the daemon wrote and restored."""
    frames, _ = session(mode, start=0)
    pdos = {0x181: (0x1840, 0x381), 0x281: (0x1841, 0x481), 0x201: (0x1440, 0x301)}

    def written(index: int, subindex: int, value: int) -> can.Message:
        return message(0x601, struct.pack("<BHBI", 0x23, index, subindex, value), 0.0)

    begin = []
    carried = (*FEEDBACK, COMMANDS[mode])
    for (index, identifier), entries in zip(pdos.values(), carried, strict=True):
        begin += [written(index, 1, 1 << 31 | 0x281), written(index + 0x200, 0, 0)]
        begin += [written(index + 0x200, k, entry.of_axis(1).mapping) for k, entry in enumerate(entries, 1)]
        begin += [written(index + 0x200, 0, len(entries)), written(index, 1, identifier)]
    begin += [reported(0x688F, 1, 65536), reported(0x688F, 2, 1), reported(0x6876, 0, 500)]
    end = [message(0x601, struct.pack("<BHBI", 0x23, 0x1840, 1, 0x181), 2.0)]
    both = []
    for frame in frames:
        both.append(frame)
        if frame.arbitration_id in pdos:
            data = bytearray(frame.data)
            if frame.arbitration_id == 0x181:
                data[2:6] = struct.pack("<i", 2 * struct.unpack("<i", data[2:6])[0])
            both.append(message(pdos[frame.arbitration_id][1], bytes(data), frame.timestamp - 1e9))
    return [*begin, *both, *end]


def test_the_axes_of_one_node_are_told_apart(tmp_path: Path, mode: Mode) -> None:
    log = write(tmp_path / "both.log", _with_second_axis(mode))
    x, y = fh.recordings.read_all(log, configuration=_second_axis(tmp_path, mode, "x", "y")).values()
    told = ["the PDOs are decoded by the mapping in the SDO transfers of the log"]
    assert (x.axis, y.axis, x.problems, y.problems) == ("x", "y", [], told)
    np.testing.assert_allclose(y["position"], 2.0 * x["position"])
    assert np.ptp(x["position"]) > 0.0
    np.testing.assert_array_equal(x["command"], y["command"])


def test_frames_of_another_axis_are_not_taken_for_those_of_a_second_one(tmp_path: Path, mode: Mode) -> None:
    """Without the daemon's connecting, nobody knows the identifiers of a second axis."""
    log = write(tmp_path / "one.log", session(mode)[0])
    (x,) = fh.recordings.read_all(log, configuration=_second_axis(tmp_path, mode, "x", "y")).values()
    assert x.axis == "x"
    assert any("no frames of axis y: identifiers and mapping that the daemon writes" in each for each in x.problems)
    with pytest.raises(RecordingError, match=r"no frame of an axis is in it\. Wanted: identifiers and mapping"):
        fh.recordings.read_all(log, configuration=_second_axis(tmp_path, mode, "y"))


def test_the_mapping_of_an_eds_is_used_and_commands_of_another_length_are_left_out(tmp_path: Path) -> None:
    """The simulated drive's EDS maps the PDOs of the profile; the master sends more than its RPDO 1."""
    frames = moving(*OF_OTHERS["profile"])
    frames += [message(0x201, bytes(8), frame.timestamp - 1e9) for frame in frames if frame.arbitration_id == 0x080]
    path = write(tmp_path / "x.log", sorted(frames, key=lambda frame: frame.timestamp))
    eds = ROOT / "drivers" / "friction_hil_drivers" / "eds" / "friction_hil_servo.eds"
    read = fh.recordings.read(path, configuration=load(machine(tmp_path, Mode.CSP, f"eds: {eds}")))
    truth = 40_000.0 * np.sin(3.0 * np.arange(400) * 5e-3) / UNITS.counts_per_unit
    np.testing.assert_allclose(read["position"], truth, atol=1.0 / UNITS.counts_per_unit)
    assert "command" not in read.columns
    for part in ("by the mapping of the EDS", "201h carries 8 bytes, and not the 2 of 6040h"):
        assert any(part in problem for problem in read.problems), read.problems
