"""Columns that are made of others: products, registers read again, and rows whose torque does not count."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings.product import Term, possible_columns, product_of
from friction_hil.recordings.recording import Recording

CSV = "t,load,volts,is_on,angle\n0,65535,7,1,0.1\n0.001,10,7.5,0,0.2\n0.002,65436,8,1,0.3\n0.003,885,nan,2,0.4\n"
TORQUE = "load:int16*volts/885"
PIECES = st.sampled_from(["a", "b", "π", " ", ".", "(", "2", "-", ":", "/", "*", "/2", "*2", ":int8"])
ODD = st.lists(PIECES, min_size=1, max_size=5).map(lambda pieces: "".join(pieces).strip()).filter(bool)
PLAIN = st.text("abπ_. ()[]#", min_size=1, max_size=6).map(str.strip).filter(bool)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "servo.csv"
    path.write_text(CSV, encoding="utf-8")
    return path


@given(ODD, st.sets(ODD))
def test_a_name_that_is_there_means_itself(name: str, others: set[str]) -> None:
    product = product_of(name, {name, *others})
    assert product.is_plain
    assert product.terms == (Term(name),)


@given(ODD, ODD, st.sets(ODD))
def test_whatever_a_source_means_was_asked_of_the_reader(first: str, second: str, others: set[str]) -> None:
    source = f"{first}*{second}"
    try:
        product = product_of(source, {first, second, *others})
    except UsageError:
        assume(False)  # a factor of zero, or nothing beside a *
    assert {term.column for term in product.terms} <= possible_columns(source)


@given(st.data())
def test_a_product_is_what_its_parts_are(data: st.DataObject) -> None:
    """Against the parts from which the text was put together."""
    names = data.draw(st.lists(PLAIN, min_size=1, max_size=4, unique=True))
    columns = {name: data.draw(arrays(np.int16, 5)) for name in names}
    there = {name: values.view(np.uint16).astype(np.float64) for name, values in columns.items()}
    parts, expected = [], np.ones(5)
    for name in data.draw(st.permutations(names)):
        is_signed, divisor = data.draw(st.booleans()), data.draw(st.sampled_from([1.0, -4.0, 0.5]))
        parts.append(f"{name}{' : int16' if is_signed else ''}{f' / {divisor}' if divisor != 1.0 else ''}")
        expected *= (columns[name] if is_signed else there[name]) / divisor
        if data.draw(st.booleans()):
            parts.append("-0.25")
            expected *= -0.25
    product = product_of(data.draw(st.sampled_from(["*", " * "])).join(parts), there)
    np.testing.assert_allclose(product.values(there), expected, rtol=1e-14)


@given(arrays(np.uint8, (4, 4)), st.sampled_from(["int8", "int16", "int32"]), st.booleans())
def test_a_register_read_again_has_the_bits_it_had(values: np.ndarray, name: str, is_signed: bool) -> None:
    right, wrong = (name, f"u{name}") if is_signed else (f"u{name}", name)
    for as_read in (right, wrong):
        there = {"x": values.view(as_read).ravel().astype(np.float64)}
        again = product_of(f"x:{right}", there).values(there)
        assert again.tolist() == values.view(right).ravel().tolist()


@pytest.mark.parametrize("value", [-32769.0, 65536.0])
def test_what_fits_into_no_register_is_refused(value: float) -> None:
    product = product_of("x:int16", {"x"})
    assert product.values({"x": np.array([-32768.0, 65535.0])}).tolist() == [-32768.0, -1.0]
    with pytest.raises(UsageError, match="x is no register of 16 bits"):
        product.values({"x": np.array([value])})


@pytest.mark.parametrize(
    ("source", "there", "terms", "factor"),
    [
        ("a*b", {"a", "b", "a*b"}, [("a*b", "")], 1.0),
        ("a*b*c/2", {"a*b", "c", "a", "b"}, [("a*b", ""), ("c", "")], 0.5),
        ("x/effort*y/effort", {"x/effort", "y/effort"}, [("x/effort", ""), ("y/effort", "")], 1.0),
        ("x/2*y", {"x/2", "y", "x"}, [("x/2", ""), ("y", "")], 1.0),
        ("x/2*y", {"x", "y"}, [("x", ""), ("y", "")], 0.5),
        ("m:int16", {"m:int16", "m"}, [("m:int16", "")], 1.0),
        ("m:int16:int16", {"m:int16", "m"}, [("m:int16", "int16")], 1.0),
        ("bus:pwm:uint8*2", {"bus:pwm"}, [("bus:pwm", "uint8")], 2.0),
        ("pi/180*angle (deg)", {"angle (deg)"}, [("angle (deg)", "")], math.pi / 180.0),
        ("a*b:int8*c", {"a*b:int8", "c", "a"}, [("a*b:int8", ""), ("c", "")], 1.0),
        ("5", set(), [("5", "")], 1.0),
    ],
)
def test_names_go_before_notation(source: str, there: set[str], terms: list[tuple[str, str]], factor: float) -> None:
    product = product_of(source, there)
    assert [(term.column, term.register) for term in product.terms] == terms
    assert product.factor == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize("suffix", fh.recordings.formats(to_write=True))
@pytest.mark.parametrize("only", [None, ["time_s", "torque", "speed"]])
def test_every_format_has_products(suffix: str, only: list[str] | None, tmp_path: Path) -> None:
    time, load = np.arange(4.0), np.array([65535.0, 10.0, 32768.0, 0.0])
    columns = {"stamp": time, "load": load, "volts": np.full(4, 7.5), "is_on": np.array([1.0, 0.0, np.nan, -2.0])}
    fh.recordings.write(tmp_path / f"x{suffix}", Recording("x", "x", {"time_s": time, **columns}, units={"load": "%"}))
    mapping = {"columns": {"torque": TORQUE, "speed": "stamp"}, "where": "is_on"}
    read = fh.recordings.read(tmp_path / f"x{suffix}", **mapping, only=only)
    np.testing.assert_allclose(read["torque"], [-7.5 / 885.0, np.nan, np.nan, 0.0])
    rest = {"load", "volts", "is_on"}
    assert set(read.columns) == {"time_s", "torque", "speed"} | (rest if only is None else set())
    assert "torque" not in read.units
    assert "is_on is zero in 2 of 4 rows (row 1, 2): the torque does not count there" in read.problems
    if only is not None:
        assert rest <= set(read.others)


def test_a_condition_may_be_called_by_either_name(log: Path) -> None:
    columns = {"time_s": "t", "torque": "volts", "enabled": "is_on"}
    first, second = (fh.recordings.read(log, columns=columns, where=name)["torque"] for name in ("is_on", "enabled"))
    np.testing.assert_array_equal(first, [7.0, np.nan, 8.0, np.nan])
    np.testing.assert_array_equal(second, first)


def test_a_mapping_beside_the_file_has_products(log: Path) -> None:
    beside = log.with_name("columns.yaml")
    beside.write_text(f"columns:\n  time_s: t*1\n  torque: {TORQUE}\n  temperature: load*heat\n", encoding="utf-8")
    read = fh.recordings.read(log, only=["time_s", "torque"])
    np.testing.assert_allclose(read["torque"], [-7 / 885, 75 / 885, -800 / 885, np.nan])
    assert "temperature" not in fh.recordings.read(log).columns  # one of its columns is not there
    beside.rename(log.with_name("servo.csv.columns.yaml"))  # of this file alone: a mistake
    with pytest.raises(UsageError, match="no column 'heat'; there are: angle, is_on, load, t, volts"):
        fh.recordings.read(log)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("load:int16*volt", "--column torque=load:int16*volt: no column 'volt'; did you mean 'volts'?"),
        ("lod:int16", "did you mean 'load'?"),
        ("load:int12", "'int12' is no type of register; there are int8, int16, int32, uint8, uint16, uint32"),
        ("load:int16*", "'load:int16*': a column or a number is missing"),
        ("load*0*volts", "'load*0*volts': a factor is finite and not zero"),
        ("angle:int16", "angle is no register of 16 bits: it holds 0.1"),
        ("load:int8", "load is no register of 8 bits: it holds 65535"),
        ("load*1e300*volts*1e8", "too large for a number"),
        ("2*3", "there are: angle"),
    ],
)
def test_mistakes_say_what_is_there(source: str, message: str, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["convert", str(log), "--info", "--column", "time_s=t", "--column", f"torque={source}"]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_info_shows_what_came_of_it(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--column", "time_s=t", "--column", f"torque={TORQUE}", "--where", "is_on"]
    assert main(["convert", str(log), "--info", "--json", *words]) == 0
    facts = json.loads(capsys.readouterr().out)["axes"]["servo"]
    torque = facts["columns"]["torque"]
    assert (torque["values"], torque["unit"]) == (2, "N m or N")
    assert (torque["min"], torque["max"]) == pytest.approx((-800 / 885, -7 / 885))
    assert "is_on is zero in 1 of 4 rows (row 1): the torque does not count there" in facts["problems"]
    assert facts["columns"]["load"]["max"] == 65535.0  # a product takes nothing away


@pytest.mark.parametrize(
    "command",
    [["identify"], ["train"], ["convert", "out.csv"], ["replay", "--model", "coulomb:coulomb=1"]],
    ids=lambda words: words[0],
)
def test_every_command_refuses_a_condition_that_is_none(command, log, monkeypatch, capsys):
    monkeypatch.chdir(log.parent)
    words = [command[0], "servo.csv", *command[1:], "--column", "time_s=t", "--column", "position=angle"]
    assert main([*words, "--column", "torque=volts", "--where", "is_onn"]) == 2
    assert "--where is_onn: did you mean 'is_on'? There are: " in " ".join(capsys.readouterr().err.split())
    assert main([*words, "--where", "is_on"]) == 2
    assert "no column torque to count" in " ".join(capsys.readouterr().err.split())
    log.write_text("time_s,torque,is_on\n0,1,0\n1,2,0\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="is_on is zero in all rows"):
        fh.recordings.read(log, where="is_on")


def test_replay_counts_only_where_the_servo_pulls(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    time: np.ndarray = np.arange(3000) * 1e-3
    velocity = np.sin(2.0 * np.pi * time) + 0.01
    is_on = (time < 1.0) | (time > 2.0)
    columns = {"velocity": velocity, "position": np.cumsum(velocity) * 1e-3, "is_on": is_on.astype(float)}
    columns["pwm"] = np.mod(np.where(is_on, 100.0 * np.sign(velocity), 3000.0), 65536.0)
    fh.recordings.write(Path("x.csv"), Recording("x", "x", {"time_s": time, **columns}))

    def error(*words: str) -> float:
        given = ["replay", "x.csv", "--model", "coulomb:coulomb=2,viscous=0", "--column", "torque=pwm:int16*0.02"]
        assert main([*given, "--json", *words]) == 0
        recordings: list[dict[str, Any]] = json.loads(capsys.readouterr().out)["recordings"]
        return float(recordings[0]["models"][0]["relative_error"])

    assert error() > 0.9
    assert error("--where", "is_on") < 0.1
    assert main(["replay", "x.csv", "--verify", "--where", "is_on"]) == 2
    assert "not with --where" in " ".join(capsys.readouterr().err.split())
