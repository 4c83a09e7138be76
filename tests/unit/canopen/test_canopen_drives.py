"""The driver on a bus that hands every frame to a simulated drive and back."""

import can
import numpy as np
import pytest

from friction_hil.drive import Command, Request
from friction_hil.errors import BusError
from tests.canopen_bench import Bench, BenchBus, Driven

CONTROLLER = {"position_gain": 1.0, "velocity_gain": 0.1}
RPDO1, SDO_REQUEST = 0x205, 0x605
NO_REACTION = 0  # 6007h: the drive does nothing when the connection is lost


@pytest.fixture
def driven():
    with Driven("cst") as one:
        yield one


def test_the_position_is_that_of_the_sync(driven):
    driven.cycle(count=10, torque=0.3)
    assert driven.feedback.velocity > 1.0
    assert driven.feedback.position == pytest.approx(driven.bench.servo.position, abs=1e-9)  # it stands since then


@pytest.mark.parametrize("mode", ["cst", "csp"])
def test_a_torque_acts_when_the_facts_say_that_it_does(mode):
    """One cycle's torque, on an axis too heavy to be moved by it: nothing else changes the drive's demand."""
    driven = Driven(mode, bus=BenchBus(Bench({"mechanics": {"inertia": 1e3}}))).start()
    servo, demands = driven.bench.servo, []
    advance = servo.advance

    def advance_step_by_step(steps):
        for _ in range(steps):
            advance(1)
            demands.append(servo.torque_demand)

    servo.advance = advance_step_by_step
    driven.cycle(count=20)
    driven.cycle(torque=0.3)
    sampled = len(demands)  # at the last SYNC
    driven.cycle(count=5)
    driven.close()
    pushed = np.array(demands[sampled:])
    assert np.abs(demands[:sampled]).max() < 1e-3
    assert pushed.max() == pytest.approx(0.3, abs=1e-3)
    middle = (np.arange(pushed.size) + 0.5) / servo.steps_per_second
    acted = float(np.sum(middle * pushed) / np.sum(pushed))
    assert acted == pytest.approx(driven.facts.actuation_delay_s, abs=1.0 / servo.config.loops.rate_hz)


def test_after_a_crash_in_motion_no_drive_keeps_its_power(driven):
    """The last command by PDO needs a SYNC, which does not come; and this drive does not react to the lost master."""
    driven.bench.write(0x6007, 0, "h", NO_REACTION)
    driven.cycle(count=10, torque=0.3)
    driven.drives.send([Command(Request.DISABLE)])
    driven.drives.close()
    assert driven.bench.statusword & 0x6F == 0x40
    assert driven.bench.servo.torque_demand == 0.0
    assert driven.bench.read(0x1016, 1) == 0


def test_a_drive_is_configured_for_a_model_that_depends_on_the_load():
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.08}, "modifiers": {"load": {"motoring": 0.1}}}
    model = {"axis": "rotary", "friction": friction, "mechanics": {"inertia": 2e-4}}
    with Driven(model=model) as driven:
        assert driven.facts.torque_resolution > 0.0


def test_a_bus_that_is_not_open_or_fails_is_an_error(driven):
    with pytest.raises(BusError, match="not open"):
        Driven(node=9).drives.start()

    def fail(msg, timeout=None):
        raise can.CanOperationError("bus-off")

    driven.bus.send, working = fail, driven.bus.send
    with pytest.raises(BusError, match=r"bus-off \[FH-202\]"):
        driven.drives.receive([driven.feedback], 0)
    driven.bus.send = working
