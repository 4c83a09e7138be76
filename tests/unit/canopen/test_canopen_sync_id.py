"""SYNC by another identifier than 080h: 1005h of the drive, and `bus.sync_cob_id`."""

import pytest
from friction_hil_drivers.canopen.drives import CanopenDrives

from friction_hil.config.bus import BusConfig
from friction_hil.drive import DriveState
from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, Bench, BenchBus, Driven
from tests.servo_drives import axis_dict, configuration

SYNC_COB_ID, OTHER = 0x1005, 0x190
READ_ONLY = {"sdo": [{"index": SYNC_COB_ID, "access": "write", "abort": 0x06010002}]}


class Synced(Driven):
    """A drive whose 1005h holds ``held``, and a daemon that sends SYNC as ``sync_id``."""

    def __init__(self, *, held, sync_id, manners=None, dry_run=False):
        self.sync_id = sync_id
        bench = Bench(manners=manners)
        bench.node.dictionary.change(SYNC_COB_ID, 0, held)
        bench.node._connect()
        super().__init__(bus=BenchBus(bench), dry_run=dry_run)

    def changed(self, config):
        return config.model_copy(update={"bus": config.bus.model_copy(update={"sync_cob_id": self.sync_id})})

    def enables(self):
        """True if the drive is enabled."""
        return self.start().cycle(count=20).state is DriveState.OPERATION_ENABLED

    @property
    def held(self):
        return self.bench.read(SYNC_COB_ID)


@pytest.mark.parametrize(("held", "sync_id"), [(0x80, 0x80), (OTHER, 0x80), (0x80, OTHER), (OTHER, OTHER)])
def test_a_drive_gets_the_identifier_of_sync_and_its_own_one_back(held, sync_id):
    driven = Synced(held=held, sync_id=sync_id)
    assert driven.enables()
    assert driven.held == sync_id
    driven.close()
    assert driven.held == held
    assert driven.drives.leftovers == []
    assert 0x80 + OTHER - sync_id not in {can_id for can_id, _ in driven.bus.sent}


def test_a_dry_run_sets_it_too_because_it_sends_sync():
    driven = Synced(held=OTHER, sync_id=0x80, dry_run=True)
    assert driven.start().cycle().is_fresh
    driven.close()
    assert driven.held == OTHER


def test_where_it_is_read_only_the_message_has_the_value_found():
    driven = Synced(held=OTHER, sync_id=0x80, manners=READ_ONLY)
    with pytest.raises(DriveError, match=r"190h.*=.*00000190h.*00000080h.*0x190.*FH-266"):
        driven.drives.connect()
    driven.close()
    driven = Synced(held=OTHER, sync_id=OTHER, manners=READ_ONLY)
    assert driven.enables()
    driven.close()


@pytest.mark.parametrize("sync_id", [0x01, 0x180, 0x581, 0x605, 0x6E5, 0x705])
def test_identifiers_of_other_services_are_no_sync(sync_id):
    with pytest.raises(ValueError, match=r"must not be 0x.*: CiA 301 reserves that"):
        BusConfig.model_validate({"interface": "virtual", "channel": "x", "sync_cob_id": sync_id})


def test_the_emergency_of_a_node_is_no_sync():
    config = configuration(x=axis_dict(node=NODE))
    config = config.model_copy(update={"bus": config.bus.model_copy(update={"sync_cob_id": 0x80 + NODE})})
    [(axis, key, error)] = CanopenDrives.check_files(config, config.axes)
    assert (axis, key) == ("x", "node")
    assert "0x85 is the emergency message" in error.detail
