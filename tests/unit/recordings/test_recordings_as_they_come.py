"""Tables as other programs write them: encodings, lines above the rows, units, dates, text, a time for each channel."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings import Recording
from friction_hil.recordings.contradictions import contradictions, turned_torque, unsigned_register
from friction_hil.recordings.dates import seconds
from friction_hil.recordings.quality import resolution
from friction_hil.recordings.suggestion import joint_options
from friction_hil.recordings.units import conversion, unit_in

TIME = np.arange(400) * 0.005
POSITION = np.sin(3.0 * TIME) + 0.2 * np.sin(11.0 * TIME)
VELOCITY = 3.0 * np.cos(3.0 * TIME) + 2.2 * np.cos(11.0 * TIME)
TORQUE = 0.3 * np.sign(VELOCITY) + 0.12 * VELOCITY
DEGREES = np.degrees(POSITION)
COLUMNS = (TIME, POSITION, TORQUE)


def comma(value: float) -> str:
    return f"{value:.6f}".replace(".", ",")


def rows(*columns: np.ndarray, between: str = ",", end: str = "\n", write: object = "{:.6f}".format) -> str:
    return "".join(between.join(map(write, row)) + end for row in zip(*columns, strict=True))  # type: ignore[call-overload]


def scope() -> str:
    """As TwinCAT Scope: a header of keys, decimal commas, a slower channel that ends early."""
    keys = [("Name", ("Axis.ActPos", "Axis.Torque")), ("SampleTime[ms]", ("5", "10"))]
    keys += [("Offset", ("0", "0")), ("Unit", ("° (Angle)", "(None)"))]
    head = "Name\tproject\nFile\tx.csv\n\n" + "".join("\t".join(f"{k}\t{v}" for v in vs) + "\n" for k, vs in keys)
    slow = [(comma(1e3 * t), comma(q)) for t, q in zip(TIME[::2], TORQUE[::2], strict=True)] + [("", "")] * 200
    lines = [[comma(1e3 * t), comma(q), *own] for t, q, own in zip(TIME, DEGREES, slow, strict=True)]
    return head + "\n" + "".join("\t".join(line) + "\n" for line in lines) + "EOF\n"


MIDNIGHT = np.datetime64("2024-06-11T00:00:00.000")
STAMPS = [str(MIDNIGHT + np.timedelta64(round(1e3 * t) - 1000, "ms")).replace("T", " ") for t in TIME]
DATED = "".join(f"{d},RUN,{q:.6f},{m:.6f}\n" for d, q, m in zip(STAMPS, DEGREES, TORQUE, strict=True))
CLOCK = DATED.replace("2024-06-10 ", "").replace("2024-06-11 ", "")
MILLISECONDS = (1e3 * TIME, DEGREES, 1e3 * TORQUE)
PREAMBLE = "Axis1\nNumber of sampling data,400\nSampling time interval(ms),5.0\n"
KEYS = "Samples\t400\t400\t\nY_Unit_Label\tdeg\tNm\t\nDelta_X\t0.005\t0.005\t\n"
LABVIEW = (
    f"LabVIEW Measurement\t\n***End_of_Header***\t\n\n{KEYS}***End_of_Header***\t\t\t\nX_Value\tpos\ttau\tComment\n"
)
ROSTOPIC = "".join(f"{1718 * 10**15 + int(1e9 * t)},base,{q:.6f},{m:.6f}\n" for t, q, m in zip(*COLUMNS, strict=True))
DURATIONS = "".join(f"T#{1e3 * t:.0f}ms;{q:.6f};{m:.6f}\n" for t, q, m in zip(*COLUMNS, strict=True))
QUOTED = "".join(f'"{t:.6f}","RUN, fast","{q:.6f}","{m:.6f}"\n' for t, q, m in zip(*COLUMNS, strict=True))
PAIRS = rows(1e3 * TIME, POSITION, 1e3 * TIME, TORQUE, between=";", write=comma)
# the text, then the names of time, position and torque where they are not ours
TABLES = {
    "units row below a preamble": (f"{PREAMBLE}Time,A 1,A 2\nms,deg,mNm\n{rows(*MILLISECONDS)}", "Time|A 1|A 2"),
    "units in names, decimal commas": (
        "Zeit [ms];Position [°];Drehmoment (mNm)\n" + rows(*MILLISECONDS, between=";", write=comma),
        "Zeit [ms]|Position [°]|Drehmoment (mNm)",
    ),
    "units as suffixes": (
        "t_ms,pos_deg,torque_nm\n" + rows(1e3 * TIME, DEGREES, TORQUE),
        "t_ms|pos_deg|torque_nm",
    ),
    "separators at the ends of lines": ("time_s,position,torque,\n" + rows(*COLUMNS, end=",\n"), ""),
    "more separators in the rows": ("time_s;position;torque\n" + rows(*COLUMNS, between=";", end=";\n"), ""),
    "a name missing": (",position,torque\n" + rows(*COLUMNS), "column1"),
    "a name twice": ("time_s,q,q\n" + rows(*COLUMNS), "|q|q_2"),
    "dates and text": ("timestamp,mode,pos [deg],torque (Nm)\n" + DATED, "timestamp|pos [deg]|torque (Nm)"),
    "times of day": ("clock,mode,pos [deg],tau\n" + CLOCK, "clock|pos [deg]|tau"),
    "rostopic": (
        "%time,field.header.frame_id,field.position0,field.effort0\n" + ROSTOPIC,
        "%time|field.position0|field.effort0",
    ),
    "scope": (scope(), "time|Axis.ActPos|Axis.Torque"),
    "one time before each channel": ("Time [ms];q;Time [ms];tau\n" + PAIRS, "Time [ms]|q|tau"),
    "LabVIEW": (LABVIEW + rows(TIME, DEGREES, TORQUE, between="\t"), "X_Value|pos|tau"),
    "trace of a controller": (
        "CODESYS Trace\nC:\\x.pro\nCycle P.POS P.TAU\n\n" + rows(*COLUMNS, between=" "),
        "Cycle|P.POS|P.TAU",
    ),
    "durations of a controller": ("T;x;y\n" + DURATIONS, "T|x|y"),
    "quotes with separators inside": ('"time_s","state","pos, left","torque"\n' + QUOTED, "|pos, left"),
}


def table(name: str) -> tuple[str, dict[str, str]]:
    """Text of a table, and the mapping of its columns."""
    text, names = TABLES[name]
    given = zip(("time_s", "position", "torque"), names.split("|"), strict=False)
    return text, {column: name for column, name in given if name}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_is_read_as_it_comes(tmp_path: Path, name: str) -> None:
    text, columns = table(name)
    (tmp_path / "x.csv").write_text(text, newline="")
    read = fh.recordings.read(tmp_path / "x.csv", columns=columns)
    np.testing.assert_allclose(read["time_s"] - read["time_s"][0], TIME, atol=1e-6)
    np.testing.assert_allclose(read["position"], POSITION, atol=2e-6)
    known = np.isfinite(read["torque"])
    is_sharp = np.abs(np.gradient(np.sign(VELOCITY))) > 0.0  # where a slower channel is interpolated over a step
    assert known.mean() > 0.99
    np.testing.assert_allclose(read["torque"][known & ~is_sharp], TORQUE[known & ~is_sharp], atol=2e-3)


@pytest.mark.parametrize("name", ["dates and text", "units in names, decimal commas", "more separators in the rows"])
def test_the_same_without_pyarrow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    test_a_table_is_read_as_it_comes(tmp_path, name)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    text, columns = table("units in names, decimal commas")
    (tmp_path / "x.txt").write_bytes(text.encode(encoding))
    read = fh.recordings.read(tmp_path / "x.txt", columns=columns)
    np.testing.assert_allclose(read["position"], POSITION, atol=1e-6)
    assert any("cp1252" in problem for problem in read.problems) == (encoding == "cp1252")


def test_what_is_done_is_said_and_text_is_an_error_where_it_is_wanted(tmp_path: Path) -> None:
    text, columns = table("dates and text")
    path = tmp_path / "x.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=r"--column time_s=timestamp --column 'position=pos \[deg\]' --column"):
        fh.recordings.read(path)
    problems = "\n".join(fh.recordings.read(path, columns=columns).problems)
    for part in ("left out: mode ('RUN')", "timestamp holds dates", "position is in deg"):
        assert part in problems
    with pytest.raises(UsageError, match=r"'mode' .* \('RUN'\)"):
        fh.recordings.read(path, columns=columns | {"torque": "mode"})
    path.write_text(text.replace(",RUN,0.", ",RUN,fast", 1))
    with pytest.raises(RecordingError, match=r"x\.csv:\d+: pos \[deg\]: 'fast\d+'"):
        fh.recordings.read(path, columns=columns)


@pytest.mark.parametrize("name", TABLES)
def test_the_preview_names_a_command_that_reads_the_file(tmp_path, name, capsys):
    (tmp_path / "x.csv").write_text(TABLES[name][0], newline="")
    assert main(["convert", str(tmp_path / "x.csv"), "--info", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)["axes"]["x"]
    assert facts["rows"] == 400
    if name not in ("a name missing", "a name twice", "durations of a controller", "trace of a controller"):
        assert facts["rate_hz"] == pytest.approx(200.0, rel=1e-3)
        fh.recordings.read(tmp_path / "x.csv", columns=facts["suggestion"]["columns"]).require("position", "torque")


@pytest.mark.parametrize(
    ("name", "column", "factor"),
    [
        ("pos [deg]", "position", np.pi / 180.0),
        ("pos (°)", "position", np.pi / 180.0),
        ("M in mNm", "torque", 1e-3),
        ("n / min^-1", "velocity", np.pi / 30.0),
        ("rpm", "velocity", np.pi / 30.0),
        ("speed_rpm", "velocity", np.pi / 30.0),
        ("v [mm/s]", "velocity", 1e-3),
        ("t [µs]", "time_s", 1e-6),
        ("torque_nm", "torque", 1.0),
        ("position", "position", None),
        ("current [A]", "torque", None),
        ("pos_min", "position", None),
    ],
)
def test_units_in_names(name: str, column: str, factor: float | None) -> None:
    found = conversion(column, unit_in(name))
    assert (found.value if found else None) == (factor if factor is None else pytest.approx(factor))


@given(st.integers(0, 86_400_000), st.lists(st.integers(0, 5_000_000), min_size=1, max_size=5))
def test_dates_keep_their_microseconds(start_ms: int, steps_us: list[int]) -> None:
    at = np.datetime64("2024-02-28T00:00:00", "us") + np.timedelta64(1000 * start_ms, "us")
    stamps = at + np.cumsum([0, *steps_us]).astype("timedelta64[us]")
    found = seconds([str(stamp) for stamp in stamps])
    np.testing.assert_allclose(found, np.cumsum([0, *steps_us]) * 1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("factors", "said"),
    [
        ({}, ""),
        ({"position": 180.0 / np.pi}, "position is in degrees"),
        ({"velocity": 30.0 / np.pi}, "revolutions per minute"),
        ({"time_s": 1000.0}, "time is in milliseconds"),
        ({"velocity": 1000.0}, "velocity is in thousandths"),
        ({"velocity": -1.0}, "the other sign"),
        ({"position": 3.0}, "times velocity"),
        ({"torque": -1.0}, "--column torque=torque*-1"),
    ],
)
def test_columns_that_contradict_each_other_are_reported_by_replay_too(tmp_path, capsys, factors, said) -> None:
    velocity = VELOCITY + 0.05 * np.random.default_rng(1).normal(size=400)
    columns = {"time_s": TIME, "position": POSITION, "velocity": velocity, "torque": TORQUE}
    recording = Recording("x", "x", {name: factors.get(name, 1.0) * values for name, values in columns.items()})
    if "torque" not in factors:
        found = contradictions(recording)
        assert len(found) == bool(said)
        assert said in "".join(found)
    fh.recordings.write(tmp_path / "x.csv", recording)
    main(["replay", str(tmp_path / "x.csv"), "--model", "coulomb:coulomb=0.3", "--json"])
    problems = json.loads(capsys.readouterr().out)["recordings"][0]["problems"]
    assert any(said in each for each in problems if said) == bool(said)


@pytest.mark.parametrize("step", [1.0, 2.69, 0.1])
def test_a_register_that_was_scaled_without_its_sign_is_found_and_read_back(tmp_path: Path, step: float) -> None:
    counts = np.round(110.0 * np.sin(3.0 * TIME) + 3.0 * np.cos(40.0 * TIME))
    logged = np.round(np.mod(counts, 65536.0) * step, 1)
    columns = {"time_s": TIME, "position": POSITION, "i": logged}
    fh.recordings.write(tmp_path / "x.csv", Recording("x", "x", columns))
    read = fh.recordings.read(tmp_path / "x.csv", columns={"torque": "i"}, scale={"torque": 0.5})
    said = unsigned_register([read])
    assert "signed register of 16 bits" in said
    assert turned_torque(read) == "", "a sign that was lost is not turned"
    source = said.partition("--column torque='")[2].partition(":int16")[0] + ":int16"
    again = fh.recordings.read(tmp_path / "x.csv", columns={"torque": source})
    np.testing.assert_array_equal(again["torque"], counts)


@given(
    friction=st.floats(0.05, 1.0),
    inertia=st.floats(0.0, 0.3),
    pull=st.floats(-2.0, 2.0),
    noise=st.floats(0.0, 0.5),
    has_velocity=st.booleans(),
    seed=st.integers(0, 99),
)
def test_a_torque_with_the_sign_turned_is_found_and_no_other(friction, inertia, pull, noise, has_velocity, seed):
    """Whatever pulls to one side, accelerates the axis, or disturbs the torque."""
    time_s = 0.01 * np.arange(1000)
    velocity = np.sin(2.0 * time_s) + 0.3 * np.sin(5.0 * time_s)
    acceleration = 2.0 * np.cos(2.0 * time_s) + 1.5 * np.cos(5.0 * time_s)
    position = -0.5 * np.cos(2.0 * time_s) - 0.06 * np.cos(5.0 * time_s)
    random = np.random.default_rng(seed).normal(size=1000)
    torque = friction * (np.sign(velocity) + noise * random) + friction * inertia * acceleration + pull
    columns = {"time_s": time_s, "position": position, "torque": torque}
    columns |= {"velocity": velocity} if has_velocity else {}
    assert turned_torque(Recording("x", "x", columns)) == ""
    assert "its sign is turned" in turned_torque(Recording("x", "x", {**columns, "torque": -torque}))
    one_way = velocity > 0.0
    columns = {name: values[one_way] for name, values in {**columns, "torque": -torque}.items()}
    assert turned_torque(Recording("x", "x", columns)) == ""


def test_another_quantity_is_refused_in_place_of_the_position(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("time_s,velocity,torque\n" + rows(TIME, VELOCITY, TORQUE))
    with pytest.raises(UsageError, match=r"velocity is in rad/s, position in rad; .* integrated from the velocity"):
        fh.recordings.read(tmp_path / "x.csv", columns={"position": "velocity"})


@given(st.integers(10, 24), st.integers(4, 10), st.floats(-1.0, 1.0), st.booleans())
def test_the_steps_of_an_encoder_are_found_behind_rounding(bits, digits, start, in_degrees):
    """As long as a step is clearly more than the last digit; a finer encoder is as coarse as that digit."""
    step = (360.0 if in_degrees else 2.0 * np.pi) / 2.0**bits
    assume(step >= 5.0 * 10.0**-digits or step <= 0.2 * 10.0**-digits)
    time = np.arange(4000) * 1e-3
    position = (start + 0.2 * np.sin(2.0 * time) + 0.01 * np.sin(50.0 * time)) * (57.3 if in_degrees else 1.0)
    found = resolution(np.round(np.round(position / step) * step, digits))
    assume(np.ptp(position) > 100.0 * max(step, 10.0**-digits))
    assert found == pytest.approx(max(step, 10.0**-digits), rel=1e-3)


@given(st.integers(0, 1000))
def test_numbers_of_no_encoder_have_no_steps(seed: int) -> None:
    random = np.random.default_rng(seed)
    assert resolution(random.normal(size=2000)) is None
    assert resolution(np.cumsum(random.normal(size=2000))) is None


@pytest.mark.parametrize("size", [1.0, 1e-6])
def test_an_axis_that_stands_still_contradicts_nothing(size: float) -> None:
    position, velocity = size * np.random.default_rng(2).normal(size=(2, 400))
    columns = {"time_s": TIME, "position": position, "velocity": velocity}
    assert contradictions(Recording("x", "x", columns)) == []


def test_the_joints_of_a_wide_log_are_read_at_once():
    names = ["time", "q1", "q2", "q10", "dq1", "dq2", "dq10", "tau1", "tau2", "tau10", "temperature"]
    found = {"time_s": "time*0.001", "position": "q1*pi/180", "velocity": "dq1", "torque": "tau1"}
    words = joint_options(found, names)
    assert words == ["--column", "time_s=time*0.001", "--joints", "q{}*pi/180", "--torque", "tau{}"]
    for other in (names[:-2], ["time", "q1", "dq1", "tau1"]):  # a joint without torque, a single joint
        assert joint_options(found, other) == []
    assert joint_options({**found, "position": "angle"}, names) == []
