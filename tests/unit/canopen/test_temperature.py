"""Temperature from the drive or a thermal observer to the friction model: no step of torque, nothing said twice."""

import math
import struct

import numpy as np
import pytest
from friction_hil_drivers.canopen.cycle.side_channel import CyclicSdo
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.temperature import TemperatureOptions, TemperatureRead
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

import friction_hil as fh
from friction_hil.compensator import Compensator, CompensatorSettings, ThermalObserver
from friction_hil.daemon.notices import TemperatureNotices
from friction_hil.drive import Request
from friction_hil.errors import ConfigurationError, DriveError
from tests.canopen_bench import NODE, Bench, BenchBus, Driven
from tests.compensators import columns
from tests.serial_rig import Rig as SerialBench
from tests.servo_drives import axis_dict, configuration

T = 1e-3
MODIFIER = {"temperature": {"reference": 40.0, "coefficient": -0.01}}
MODEL = fh.models.create("coulomb", coulomb=0.1, modifiers=MODIFIER)
BODY = ThermalObserver(capacity=20.0, resistance=0.5, ambient=20.0, initial=20.0, copper_loss=40.0)
SECOND = 1_000_000_000


def one(**changes):
    given = {"period_s": T, "position_resolution": 1e-6, "torque_limit": 1.0, "gain": 1.0, "fade_s": 0.01}
    return Compensator(MODEL, CompensatorSettings(**given | changes))


def slide(unit, temperature, speed=1.0, **given):
    """Replay of even motion with a temperature of each cycle."""
    temperature = np.asarray(temperature, dtype=float)
    demand = {"velocity_demand": speed, "velocity_demand_ahead": speed, "velocity": speed}
    demand |= {"position": speed * T * np.arange(temperature.size)}
    return unit.replay_all(columns(temperature.size, temperature=temperature, **demand, **given))


# --- what the model is given


def test_the_level_follows_the_measured_temperature():
    found = slide(one(), np.full(500, 60.0))
    assert np.all(found["temperature_estimate"] == 60.0)  # nothing was commanded before, so there is nothing to slew
    assert found["compensation"][-1] == pytest.approx(0.1 * (1.0 - 0.01 * 20.0))


@pytest.mark.parametrize("nothing", [math.nan, math.inf, -128.0, 3276.7, 1e9])
def test_what_is_no_temperature_leaves_the_reference(nothing):
    independent = Compensator(fh.models.create("coulomb", coulomb=0.1), one().settings)
    found, plain = (slide(unit, np.full(500, nothing)) for unit in (one(), independent))
    assert np.all(found["temperature_estimate"] == 40.0)
    assert np.isnan(plain["temperature_estimate"]).all()
    np.testing.assert_array_equal(found["compensation"], plain["compensation"])


@settings(max_examples=30, deadline=None)
@given(st.lists(st.one_of(st.just(math.nan), st.floats(-300.0, 4000.0)), min_size=2, max_size=200))
def test_no_sensor_makes_a_step(readings):
    found = slide(one(), readings)["temperature_estimate"]
    assert np.abs(np.diff(found)).max() <= 1.0 * T * (1.0 + 1e-9)
    assert np.all((found >= -60.0) & (found <= 250.0))


# --- the observer


def test_the_observer_heats_as_the_lumped_body_in_closed_form():
    """Held torque at rest: T = ambient + R k tau^2 (1 - exp(-t / R C)), within the slew of 1 K/s."""
    t = np.arange(60_000) * T
    found = slide(one(thermal=BODY), np.full(t.size, math.nan), speed=0.0, torque=0.5)["temperature_estimate"]
    expected = 20.0 + 0.5 * 40.0 * 0.25 * -np.expm1(-t / 10.0)
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_friction_heats_and_the_level_falls_by_it():
    found = slide(one(thermal=BODY), np.full(40_000, math.nan), speed=20.0)
    heat = found["compensation"] * 20.0
    body = 20.0
    for k in range(0, 40_000, 10):  # the witness: explicit Euler
        body += 10 * T / 20.0 * (heat[k] - (body - 20.0) / 0.5)
    assert found["temperature_estimate"][-1] == pytest.approx(body, abs=0.01)
    assert found["compensation"][-1] == pytest.approx(0.1 * (1.0 - 0.01 * (body - 40.0)), rel=1e-3)


def test_a_sensor_takes_precedence_over_the_observer_and_leaves_to_it():
    readings = np.r_[np.full(3000, 23.0), np.full(5000, math.nan)]
    found = slide(one(thermal=BODY), readings)["temperature_estimate"]
    assert found[2999] == 23.0
    assert found[-1] < 20.5
    # friction at rest heats nothing, whatever is not a number
    still = slide(one(thermal=BODY), np.full(100, math.nan), speed=0.0, torque=math.nan)["temperature_estimate"]
    assert np.all(still == 20.0)


def model_file(**thermal):
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.08}, "modifiers": MODIFIER}
    return {"axis": "rotary", "friction": friction, "thermal": {"capacity": 20.0, "resistance": 0.5} | thermal}


def test_the_observer_begins_at_the_ambient_temperature_unless_another_is_given():
    axis = configuration(x=axis_dict(model=model_file(ambient=25.0))).axes["x"]
    assert axis.model.thermal.initial is None
    with pytest.raises(ConfigurationError, match="at least 1 s"):
        configuration(x=axis_dict(model=model_file(capacity=1.0)))
    with pytest.raises(ConfigurationError, match="has no effect"):
        configuration(x=axis_dict(model=axis_dict()["model"] | {"thermal": {"capacity": 20.0, "resistance": 0.5}}))


# --- what is said


def told(unit, temperatures):
    notices = TemperatureNotices("x", unit, T)
    return [text for text in map(notices.next, temperatures) if text]


def test_each_lack_is_said_once():
    assert told(one(), [math.nan] * 1500 + [30.0] * 10) == []
    (text,) = told(one(), [math.nan] * 5000)
    assert text.startswith("x: the drive reports no temperature")
    assert text.endswith("reference temperature, 40 °C")
    implausible, lost = told(one(thermal=BODY), [30.0, 3276.7, 3276.7, 30.0, math.nan, 30.0, math.nan, 3276.7])
    assert "3276.7 °C, which is not plausible" in implausible
    assert "any more" in lost
    assert lost.endswith("begins at 20 °C, towards it by at most 1 K/s")


# --- CANopen


@pytest.mark.parametrize(
    ("kind", "code", "number"),
    [
        ("int8", "b", -5),
        ("int16", "h", -300),
        ("int32", "i", 70000),
        ("uint8", "B", 200),
        ("uint16", "H", 40000),
        ("uint32", "I", 3_000_000_000),
        ("float32", "f", 36.5),
    ],
)
def test_every_type_of_object_is_decoded(kind, code, number):
    options = TemperatureOptions(index=0x2030, type=kind, scale=0.1, offset=-3.0)
    assert options.decode(struct.pack(f"<{code}", number)) == pytest.approx(0.1 * number - 3.0)
    assert math.isnan(options.decode(b"\0" * 3))


@pytest.mark.parametrize("wrong", [{"index": 0x1000}, {"scale": 0.0}, {"scale": math.inf}, {"interval_s": 0.0}])
def test_wrong_keys_are_refused(wrong):
    with pytest.raises(ValidationError):
        TemperatureOptions(**{"index": 0x2030} | wrong)


def asked(sdo, now_ns):
    frame = sdo.next(now_ns)
    return None if frame is None else struct.unpack_from("<BHB", frame[1])[1:]


def answer(index, value):
    return struct.pack("<BHBi", 0x4B, index, 0, value)


def reading(interval_s):
    read = TemperatureRead(TemperatureOptions(index=0x5FF0, scale=0.1, interval_s=interval_s), 20.0)
    sdo = CyclicSdo(5, 1.0, 0, read)
    read.start(0)
    return read, sdo


def test_the_temperature_is_asked_for_once_an_interval_and_after_everything_else():
    read, sdo = reading(2.0)
    assert [asked(sdo, now) for now in (SECOND, 2 * SECOND, 2 * SECOND + 1)] == [None, (0x5FF0, 0), None]
    sdo.take(answer(0x5FF0, 456), 2 * SECOND + 2)
    assert read.value == pytest.approx(45.6)
    sdo.error_code.begin()
    assert asked(sdo, 5 * SECOND) == (0x603F, 0)
    sdo.take(answer(0x603F, 1), 5 * SECOND)
    assert asked(sdo, 5 * SECOND + 1) == (0x5FF0, 0)
    sdo.begin_stop(5 * SECOND + 2)  # which waits for nothing
    assert asked(sdo, 5 * SECOND + 2) == (0x6040, 0)
    sdo.take(answer(0x5FF0, 999), 5 * SECOND + 3)  # the answer to a question given up
    assert read.value == pytest.approx(45.6)


@pytest.mark.parametrize(
    ("refusal", "why"),
    [(None, "does not answer"), (struct.pack("<BHBI", 0x80, 0x5FF0, 0, 0x08000022), "refuses it")],
)
def test_readings_that_fail_are_told_once_and_end_the_temperature(refusal, why):
    read, sdo = reading(1.0)
    for k in range(1, 12):
        assert read.value == 20.0 if k < 6 else math.isnan(read.value)
        assert asked(sdo, k * SECOND) == (0x5FF0, 0)
        if refusal is not None:
            sdo.take(refusal, k * SECOND)
        else:
            assert asked(sdo, k * SECOND + SECOND // 2) is None
    assert why in read.notice


def canopen(temperature, is_mappable=True, **changes):
    """A drive of the bench that shows 25.0 °C in 5FF0h, as INTEGER16 of 0.1 °C, and 61.2 °C after 150 ms."""
    event = {"at_s": 0.15, "do": "write", "index": 0x5FF0, "value": 612}
    bench = Bench(manners={"events": [event]})
    bench.node.dictionary.of(objects.SIMULATED_MOTOR_TEMPERATURE).is_mappable = is_mappable
    return Driven(bus=BenchBus(bench), temperature=temperature, **changes)


@pytest.mark.parametrize(
    ("is_mappable", "changes", "requests", "late"),
    [
        (True, {}, 0, 0),  # in the three bytes that the second TPDO has left
        (True, {"load_encoder": {}}, 0, 0),
        (False, {}, 3, 100),
    ],
)
def test_the_temperature_comes_with_the_feedback_or_beside_it(is_mappable, changes, requests, late):
    driven = canopen({"index": 0x5FF0, "scale": 0.1, "interval_s": 0.1}, is_mappable, **changes)
    found, heard = mappings(driven.bench), []
    with driven:
        notes, begin = driven.facts.notes, len(driven.bus.sent)
        assert any("no TPDO of the drive takes 5FF0h temperature" in note for note in notes) is not is_mappable
        for _ in range(350):
            assert driven.cycle().is_fresh
            heard.append(driven.feedback.temperature)
        asked_for = [data for can_id, data in driven.bus.sent[begin:] if can_id == cia301.SDO_REQUEST_BASE + NODE]
    assert mappings(driven.bench) == found
    assert heard[0] == pytest.approx(25.0)
    assert heard[-1] == pytest.approx(61.2)
    changed = np.flatnonzero(np.diff(heard))
    assert 100 < changed[0] <= 150 + late  # the drive writes it 150 ms after it was switched on
    assert sum(data[:4] == bytes.fromhex("40f05f00") for data in asked_for) == requests


def mappings(bench):
    """Entries of all TPDOs of the drive."""
    counts = {index: bench.read(index, 0, "B") for index in range(0x1A00, 0x1A00 + cia301.PDO_COUNT)}
    return {index: [bench.read(index, k) for k in range(1, count + 1)] for index, count in counts.items()}


def test_no_further_frame_is_sent_in_each_cycle_for_a_temperature():
    """An INTEGER32 has no room in the two TPDOs of the feedback."""
    with canopen({"index": 0x6062, "type": "int32", "interval_s": 0.1}) as driven:
        assert all(0x60620020 not in words for words in mappings(driven.bench).values())


@pytest.mark.parametrize(
    ("wrong", "text"),
    [({"index": 0x2030}, "object 2030h temperature"), ({"index": 0x5FF0, "type": "float32"}, "has 2 bytes")],
)
def test_an_object_that_is_not_there_is_refused_before_anything_is_enabled(wrong, text):
    with pytest.raises(DriveError, match=text), canopen(wrong):
        pass


# --- serial lines


def test_a_servo_on_a_serial_line_reports_it_where_the_model_depends_on_it(tmp_path):
    for k, (modifiers, expected) in enumerate(((MODIFIER, 30.0), ({}, math.nan))):
        folder = tmp_path / str(k)
        folder.mkdir()
        friction = {"model": "coulomb", "parameters": {"coulomb": 0.08}, "modifiers": modifiers}
        model = {"axis": "rotary", "friction": friction, "mechanics": {"inertia": 2e-4}}
        with SerialBench("dynamixel", folder, model=model).begin() as bench:
            bench.cycle(Request.LISTEN, count=3)
            np.testing.assert_equal(bench.feedback.temperature, expected)
