"""The plain C servo that ``tools/bench servo`` measures against: an independent form of the rigid one."""

import shutil

import pytest

from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo
from tools.benchmarks import models
from tools.benchmarks import servo as bench


@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc here to compile the C loop")
def test_the_rigid_servo_moves_as_the_c_loop():
    plain, ours = bench.CServo(), Servo(ServoConfig.model_validate({"friction": bench.LUGRE}))
    for torque in (0.1, 0.2, -0.15, 0.02, -0.3):
        plain.advance(torque, 8000)
        ours.command(bench.CST, torque)
        ours.advance(8000)
        assert ours.true_position == pytest.approx(plain.state[0], rel=1e-6, abs=1e-9)
        assert ours.true_velocity == pytest.approx(plain.state[1], rel=1e-6, abs=1e-9)
        assert ours.velocity == pytest.approx(plain.state[5], rel=1e-6, abs=1e-2)


def test_the_configurations_that_are_timed_have_their_parts():
    assert not ServoConfig.model_validate(bench.TWO_MASSES).is_rigid
    full = ServoConfig.model_validate({"friction": bench.LUGRE, **bench.ALL_PARTS})
    assert not any(part.is_plain for part in (full.encoder, full.torque_feedback, full.motor, full.loops))


@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc here to compile the C loop")
def test_the_benchmark_of_the_servo_compares_parts_rigid_and_c(monkeypatch, capsys):
    monkeypatch.setattr(models, "ROUNDS", 1)
    monkeypatch.setattr(bench, "STEPS", 800)
    rows = bench.run()
    assert "gcc" in capsys.readouterr().err
    assert [row.unit for row in rows] == ["ns", "ns", "ns", "ns", "1"]
    assert all(row.value > 0.0 and row.ratio > 0.0 for row in rows)
    assert rows[1].reference == rows[2].reference
    assert rows[3].reference == 2.0 * rows[2].reference
    axes = bench.AXES * 80_000 * rows[2].value * 1e-9
    assert rows[4].value == pytest.approx(axes)
