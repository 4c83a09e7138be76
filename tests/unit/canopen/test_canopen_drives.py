"""The driver on a bus that hands every frame to a simulated drive and back."""

import re
import subprocess
import sys

import can
import numpy as np
import pytest
from friction_hil_drivers.canopen.drives import CanopenDrives

from friction_hil.config.bus import BusConfig
from friction_hil.drive import Command, DriveState, Request
from friction_hil.errors import BusError, DriveError
from tests.canopen_bench import NODE, Bench, BenchBus, Driven
from tests.servo_drives import axis_dict, configuration

SYNC_COB_ID, OTHER = 0x1005, 0x190
READ_ONLY = {"sdo": [{"index": SYNC_COB_ID, "access": "write", "abort": 0x06010002}]}
NOT_NOW, GENERAL, NO_OBJECT = 0x08000022, 0x08000000, 0x06020000


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
    """The last command by PDO needs a SYNC, which does not come; and 6007h says: no reaction to a lost master."""
    driven.bench.write(0x6007, 0, "h", 0)
    driven.cycle(count=10, torque=0.3)
    driven.drives.send([Command(Request.DISABLE)])
    driven.drives.close()
    assert (driven.bench.statusword & 0x6F, driven.bench.servo.torque_demand) == (0x40, 0.0)
    assert driven.bench.read(0x1016, 1) == 0


def test_a_drive_is_configured_for_a_model_that_depends_on_the_load():
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.08}, "modifiers": {"load": {"motoring": 0.1}}}
    with Driven(model={"axis": "rotary", "friction": friction, "mechanics": {"inertia": 2e-4}}) as driven:
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


# --- SYNC by another identifier than 080h: 1005h of the drive, and `bus.sync_cob_id`


def with_sync(config, sync_id):
    return config.model_copy(update={"bus": config.bus.model_copy(update={"sync_cob_id": sync_id})})


class Synced(Driven):
    """A drive whose 1005h holds ``held``, and a daemon that sends SYNC as ``sync_id``."""

    def __init__(self, *, held, sync_id, manners=None, dry_run=False):
        self.sync_id = sync_id
        bench = Bench(manners=manners)
        bench.node.dictionary.change(SYNC_COB_ID, 0, held)
        bench.node._connect()
        super().__init__(bus=BenchBus(bench), dry_run=dry_run)

    def changed(self, config):
        return with_sync(config, self.sync_id)


@pytest.mark.parametrize(
    ("held", "sync_id", "how"),
    [
        (0x80, 0x80, {}),
        (OTHER, 0x80, {}),
        (0x80, OTHER, {}),
        (OTHER, OTHER, {}),
        (OTHER, OTHER, {"manners": READ_ONLY}),
        (OTHER, 0x80, {"dry_run": True}),  # which sends SYNC
    ],
)
def test_a_drive_gets_the_identifier_of_sync_and_its_own_one_back(held, sync_id, how):
    with Synced(held=held, sync_id=sync_id, **how) as driven:
        driven.cycle(count=20)
        assert driven.feedback.is_fresh
        assert (driven.feedback.state is DriveState.OPERATION_ENABLED) is ("dry_run" not in how)
        assert driven.bench.read(SYNC_COB_ID) == sync_id
    assert driven.bench.read(SYNC_COB_ID) == held
    assert driven.drives.leftovers == []
    assert 0x80 + OTHER - sync_id not in {can_id for can_id, _ in driven.bus.sent}


def test_where_it_is_read_only_the_message_has_the_value_found():
    driven = Synced(held=OTHER, sync_id=0x80, manners=READ_ONLY)
    with pytest.raises(DriveError, match=r"190h.*=.*00000190h.*00000080h.*0x190.*FH-266"):
        driven.drives.connect()
    driven.close()


@pytest.mark.parametrize("sync_id", [0x01, 0x180, 0x581, 0x605, 0x6E5, 0x705])
def test_identifiers_of_other_services_are_no_sync(sync_id):
    with pytest.raises(ValueError, match=r"sync_cob_id"):
        BusConfig.model_validate({"interface": "virtual", "channel": "x", "sync_cob_id": sync_id})


def test_the_emergency_of_a_node_is_no_sync():
    config = with_sync(configuration(x=axis_dict(node=NODE)), 0x80 + NODE)
    [(axis, key, error)] = CanopenDrives.check_files(config, config.axes)
    assert (axis, key) == ("x", "node")
    assert "0x85" in error.detail


# --- a unit of velocity that the drive has and does not show: nobody guesses which one it is


def hiding(code, **keys):
    """Connect to a drive that aborts a read of 60A9h; return the facts."""
    with Driven(bus=BenchBus(refused={(0x60A9, 2): code}), **keys) as driven:
        return driven.facts


def test_for_velocity_targets_the_unit_must_be_known():
    with pytest.raises(DriveError, match=r"60A9h.*08000022.*velocity_unit.*FH-214"):
        hiding(NOT_NOW, mode="csv")


@pytest.mark.parametrize(
    ("code", "keys", "source"),
    [
        (NOT_NOW, {"mode": "csp"}, r"the assumption counts/s, as 60A9h was not read \(.*0x08000022"),
        (NOT_NOW, {"mode": "cst"}, r"the assumption counts/s, as 60A9h was not read \(.*0x08000022"),
        (NOT_NOW, {"mode": "csv", "velocity_unit": "counts/s"}, "velocity_unit$"),
        (GENERAL, {"mode": "csv"}, "the assumption counts/s, as there is no 60A9h$"),
        (NO_OBJECT, {"mode": "csv"}, "the assumption counts/s, as there is no 60A9h$"),
    ],
)
def test_otherwise_it_is_told_where_the_unit_comes_from(code, keys, source):
    facts = hiding(code, **keys)
    [row] = [row for row in facts.units if row.quantity == "velocity"]
    assert re.match(source, row.source)
    is_noted = any("60A9h" in note and "taken as absent" in note for note in facts.notes)
    assert is_noted is (code != NO_OBJECT)


# --- reading a configuration does not wait for libraries that only an open bus needs


CODE = """
import sys
sys.path[:0] = {path!r}
from friction_hil_drivers.canopen import CanopenDrives
from friction_hil_drivers.canopen.simulated import SimulatedCanopenDrives
print(CanopenDrives.Options.__name__, SimulatedCanopenDrives.Options.__name__)
print(*sorted(name for name in ("can", "canopen", "msgpack") if name in sys.modules))
"""


def test_the_drivers_options_need_no_bus_library() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CODE.format(path=sys.path)], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["CanopenOptions SimulationOptions", ""]
