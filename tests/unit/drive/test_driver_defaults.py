"""Drivers of others, which know no base classes, get defaults; codes of faults are unique, explained and used."""

import doctest
import re
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

import pytest
from friction_hil_drivers.canopen import codes as canopen_codes
from friction_hil_drivers.cia402 import codes as cia402_codes
from friction_hil_drivers.serial_line import codes as serial_codes
from pydantic import BaseModel

from friction_hil.config import drivers
from friction_hil.config.drivers import SIMULATED_DRIVES, load_driver
from friction_hil.drive import Driver, Drives, SimulatedDriver, codes
from friction_hil.drive.codes import FaultCode, coded
from friction_hil.errors import DriveError


class Keys(BaseModel):
    node: int = 1


class KeysWithCheck(Keys):
    @classmethod
    def check(cls, axes, bus):
        yield "x", "node", "is wrong"


class OldDriver:
    """As drivers were written before there were base classes."""

    Options = Keys
    is_passive = True

    def __init__(self, configuration, axes, clock, *, dry_run):
        self.axes = axes
        self.leftovers = ["something"]

    connect = start = receive = send = warm_caches = close = lambda self, *_: None

    @staticmethod
    def check_machine(root):
        yield root


class OldListing(OldDriver):
    Options = KeysWithCheck

    @staticmethod
    def open_inventory(config, *, may_disturb=False):
        return "inventory"


class OldSimulation:
    Options = Keys

    def __init__(self, configuration, axes, *, pace):
        self.pace = pace

    open = run = close = lambda self, *_: None


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """Drivers of this module are found, and no other ones; nothing of that stays."""

    def entry_points(*, group):
        kinds = ("OldSimulation",) if group == SIMULATED_DRIVES else ("OldDriver", "OldListing")
        return [EntryPoint(name, f"{__name__}:{name}", group) for name in kinds]

    monkeypatch.setattr(drivers, "entry_points", entry_points)
    load_driver.cache_clear()
    yield
    load_driver.cache_clear()


def test_what_a_driver_lacks_has_its_default():
    driver = load_driver("OldDriver")
    drives = driver.drives_for(None, {"x": None}, None, dry_run=True)
    assert isinstance(drives, OldDriver)
    assert isinstance(drives, Drives)
    assert (drives.is_passive, drives.is_follower, drives.phase_lock) == (True, False, None)
    assert (drives.leftovers, drives.remarks, drives.remedies) == (["something"], (), {})
    assert list(driver.check_machine("/")) == ["/"]
    assert list(driver.check_files(None, {})) == []
    assert driver.check_connection(None, {}) is None
    (stop,) = driver.stop_axes(None, {"x": None}).stops
    assert (stop.axis, stop.result, stop.is_proved) == ("x", "unknown", False)


def test_no_driver_has_an_inventory_because_another_one_has():
    assert load_driver("OldListing").has_inventory
    assert not Driver.has_inventory
    assert not load_driver("OldDriver").has_inventory


def test_keys_without_checks_get_them_and_those_with_keep_theirs():
    driver, listing = load_driver("OldDriver"), load_driver("OldListing")
    assert driver is load_driver("OldDriver")
    assert list(driver.Options.check({}, None)) == []
    assert driver.Options(node=3).node == 3
    assert list(listing.Options.check({}, None)) == [("x", "node", "is wrong")]
    assert list(listing.Options.check_timing({}, 1e-3, 10)) == []


def test_simulated_drives_get_theirs():
    simulated = load_driver("OldSimulation", SIMULATED_DRIVES)
    assert issubclass(simulated, SimulatedDriver)
    assert simulated(None, {}, pace="sync").pace == "sync"
    assert simulated.make_private(None, None) is None
    assert not simulated.have_common_time


CANOPEN = canopen_codes, {*range(200, 250), *range(264, 300)}
CIA402 = cia402_codes, set(range(200, 250))
SERIAL = serial_codes, set(range(250, 264))
EACH = [CANOPEN, CIA402, SERIAL]
EACH_DRIVER = pytest.mark.parametrize(("codes", "numbers"), EACH, ids=["canopen", "cia402", "serial"])


def names(codes: ModuleType) -> dict[str, str]:
    return {name: code for name, code in vars(codes).items() if name.isupper() and isinstance(code, str)}


@EACH_DRIVER
def test_every_code_is_in_its_drivers_range_has_one_name_and_is_used(codes: ModuleType, numbers: set[int]) -> None:
    of_objects = set() if codes is cia402_codes else set(cia402_codes.EXPLANATIONS)
    own = set(codes.EXPLANATIONS) - of_objects
    assert sorted(names(codes).values()) == sorted(set(names(codes).values())) == sorted(own)
    assert all(int(code.removeprefix("FH-")) in numbers for code in codes.EXPLANATIONS)
    assert codes.__file__ is not None
    text = "".join(path.read_text() for path in Path(codes.__file__).parent.rglob("*.py"))
    assert set(re.findall(r"\bcodes\.([A-Z_0-9]+)", text)) - {"EXPLANATIONS", "REMEDIES"} == set(names(codes))


def test_a_code_ends_a_message() -> None:
    assert coded("no heartbeat from node 5", canopen_codes.HEARTBEAT_LOST) == "no heartbeat from node 5 [FH-230]"
    assert str(DriveError("no reply", "check the wires", "FH-253")) == "no reply; check the wires [FH-253]"


ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("code", FaultCode, ids=str)
def test_codes_lie_in_their_ranges_have_messages_of_their_own_and_are_used(code, sources):
    assert 101 <= code.number <= 199
    assert re.fullmatch(r"FH-\d{3}", str(code))
    assert [other.explanation.message for other in FaultCode].count(code.explanation.message) == 1
    assert f"FaultCode.{code.name}" in sources


@pytest.fixture(scope="module")
def sources():
    rooms = (ROOT / "friction_hil/daemon", ROOT / "drivers/friction_hil_drivers")
    return "".join(path.read_text() for room in rooms for path in room.rglob("*.py"))


def test_a_message_gets_one_code():
    once = FaultCode.LOOP_LATE.append_to("the loop was late")
    assert once == "the loop was late [FH-113]"
    assert FaultCode.EXCHANGE_FAILED.append_to(once) == once
    with_advice = "the bus does not open; ip link set can0 up [FH-201]"
    assert FaultCode.EXCHANGE_FAILED.append_to(with_advice) == with_advice
    assert FaultCode.LOOP_LATE.append_to("limits [-1, 1]") == "limits [-1, 1] [FH-113]"


def test_the_examples_of_the_module_hold():
    assert doctest.testmod(codes) == (0, 3)
