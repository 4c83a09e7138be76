"""Drivers of others that know nothing of the base classes: what they lack has a default, what they have stays."""

from importlib.metadata import EntryPoint

import pytest
from pydantic import BaseModel

from friction_hil.config import drivers
from friction_hil.config.drivers import SIMULATED_DRIVES, load_driver
from friction_hil.drive import Driver, Drives, SimulatedDriver


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
