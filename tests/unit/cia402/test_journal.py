"""What a drive held before a run, written back in an order that the drive accepts."""

from friction_hil_drivers.cia402.access import RefusedError
from friction_hil_drivers.cia402.journal import Journal
from friction_hil_drivers.cia402.objects import INTERPOLATION_EXPONENT, INTERPOLATION_PERIOD


class Interpolator:
    """Access to a drive that refuses a value of 60C2h by which it would interpolate over less than 0.1 ms."""

    axis, where = "x", "node 5 on can0"

    def __init__(self) -> None:
        self.values = {INTERPOLATION_PERIOD.address: b"\x01", INTERPOLATION_EXPONENT.address: b"\xfd"}  # 1 ms

    def peek(self, entry):
        return self.values.get(entry.address, b"\x07\0\0\0")

    def download(self, entry, data):
        values = {**self.values, entry.address: data}
        period, exponent = (
            int.from_bytes(values[each.address], "little", signed=True)
            for each in (INTERPOLATION_PERIOD, INTERPOLATION_EXPONENT)
        )
        if entry == INTERPOLATION_PERIOD and period * 10.0**exponent < 0.99e-4:
            raise RefusedError("refused")
        self.values = values


def test_a_setting_that_needs_another_one_first_is_restored_after_it(tmp_path) -> None:
    drive = Interpolator()
    before = dict(drive.values)
    journal = Journal(drive, lambda identity: tmp_path / f"{identity}.json")
    for entry, data in ((INTERPOLATION_EXPONENT, b"\xfb"), (INTERPOLATION_PERIOD, b"\x19")):  # 0.25 ms
        journal.before(entry, data)
        drive.download(entry, data)

    assert journal.restore() == []
    assert drive.values == before
