"""Drives of other vendors: their EDS against the modes, and the negotiation with drives that have such an EDS."""

import math
import re
from pathlib import Path

import pytest
from friction_hil_drivers.canopen.connect.eds import SIMULATED_SERVO, load_eds
from friction_hil_drivers.canopen.connect.eds_check import compare_eds, necessary_keys
from friction_hil_drivers.canopen.options import CanopenOptions
from friction_hil_drivers.cia402 import objects

from friction_hil.drive import DriveState, Mode, Request
from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, Bench, BenchBus, Driven
from tests.vendor_drives import (
    CSP,
    DRIVES,
    EPOS4,
    EROB,
    EVENT_TIMERS,
    EYOU,
    FIXED,
    INGENIA,
    NOT_CYCLIC,
    ONE_ENTRY,
    SCHUNK,
    VendorDrive,
)

UNITS = {"counts_per_unit": 2**20 / math.tau, "rated_torque": 0.64}


def reasons(drive: VendorDrive, mode: str, folder: Path, *, is_compensated=True, **options) -> list[str]:
    dictionary = load_eds(drive.write(folder / "drive.eds"), NODE)
    return list(
        compare_eds(dictionary, Mode[mode.upper()], CanopenOptions(node=NODE, **options), is_compensated=is_compensated)
    )


@pytest.mark.parametrize("mode", ["csp", "csv", "cst"])
@pytest.mark.parametrize("name", DRIVES)
def test_an_eds_is_compared_with_the_mode(tmp_path, name, mode):
    found = reasons(DRIVES[name], mode, tmp_path)
    assert (found == []) == DRIVES[name].works[mode], found


def test_an_eds_may_begin_with_a_byte_order_mark(tmp_path):
    path = tmp_path / "windows.eds"
    path.write_bytes(b"\xef\xbb\xbf" + SIMULATED_SERVO.read_bytes())
    assert 0x6040 in load_eds(path, 1)


def test_the_reasons_are_named(tmp_path):
    assert reasons(EYOU, "csp", tmp_path) == [
        "has no object 60B2h torque offset, which mode csp needs (mode cst does without it)"
    ]
    assert reasons(EYOU, "csp", tmp_path, is_compensated=False) == []
    [text] = reasons(INGENIA, "cst", tmp_path)
    assert text == (
        "lists csp, csv as the drive's modes (6502h supported drive modes), not cst "
        "(is_mode_check_required: false if that is wrong)"
    )
    assert reasons(INGENIA, "cst", tmp_path, is_mode_check_required=False) == []
    assert (
        "lists profile position, profile velocity, homing, interpolated position as"
        in reasons(NOT_CYCLIC, "csv", tmp_path)[0]
    )
    assert "has no object 6071h target torque, which mode cst needs" in reasons(SCHUNK, "cst", tmp_path)
    [text] = reasons(FIXED, "cst", tmp_path)
    assert text == "has RPDOs with fixed mappings only, and those do not contain 6040h controlword, 6071h target torque"


def test_objects_that_cannot_be_mapped_are_named(tmp_path):
    drive = VendorDrive(values={("60B2", "PDOMapping"): "0", ("6064", "PDOMapping"): "0"}, tpdos=([], [], [], []))
    assert reasons(drive, "csp", tmp_path) == [
        "does not let 60B2h torque offset be mapped into any RPDO",
        "does not let 6064h position actual value be mapped into any TPDO",
    ]


def test_too_few_pdos_are_counted(tmp_path):
    drive = VendorDrive(most_entries=1, rpdos=([], []), tpdos=ONE_ENTRY.tpdos)
    assert reasons(drive, "csp", tmp_path) == ["has 2 RPDOs of 1 entries that can be mapped; 3 are needed"]


def test_a_second_axis_is_looked_for_where_it_stands(tmp_path):
    found = reasons(EROB, "cst", tmp_path, axis_number=1)
    assert "has no object 6071h target torque, which mode cst needs" in found


# --- drives with these EDS, on a bus that hands every frame over at once


class OfVendor(Driven):
    """A simulated drive with a vendor's EDS."""

    def __init__(self, eds: Path, mode: str, *, supported=None, manners=None, **keys):
        bench = Bench(eds=eds, modes=tuple(Mode), manners=manners)
        if supported is not None:  # what its EDS says, whatever it can
            bench.node.dictionary.of(objects.SUPPORTED_MODES).value = supported
        super().__init__(mode, bus=BenchBus(bench), **{"is_watchdog_required": False, **UNITS, **keys})

    def refusal(self):
        """The error with which connecting ends."""
        with pytest.raises(DriveError) as caught, self:
            pass
        return caught.value


ALL = [(name, mode) for name, drive in DRIVES.items() for mode, works in drive.works.items() if works]


@pytest.mark.deep
@pytest.mark.parametrize(("name", "mode"), ALL)
def test_a_drive_that_can_be_driven_is_driven(tmp_path, name, mode):
    """Enabled, followed, and the torque arrives where it adds to the loops, whatever its PDOs allow."""
    drive = DRIVES[name]
    with OfVendor(drive.write(tmp_path / "drive.eds"), mode) as driven:
        driven.cycle(count=20)
        assert driven.feedback.state is DriveState.OPERATION_ENABLED, driven.facts.notes
        assert driven.feedback.message == ""
        driven.cycle(count=3, torque=0.064)
        index = 0x6071 if mode == "cst" else 0x60B2
        code = "i" if mode != "cst" and ("60B2", "DataType") in drive.values else "h"
        assert driven.bench.read(index, 0, code) == 100
        assert driven.feedback.is_fresh
        assert driven.feedback.position == pytest.approx(driven.bench.servo.position, abs=1e-3)
        if mode == "cst":
            assert driven.feedback.torque == pytest.approx(0.064, abs=5e-3)
        driven.cycle(Request.DISABLE, count=300)
        assert not driven.feedback.state.is_powered
        assert driven.bench.emergencies == []


@pytest.mark.parametrize(
    ("name", "mode"), [(n, m) for n, d in DRIVES.items() for m, works in d.works.items() if not works]
)
def test_a_drive_that_cannot_be_driven_is_refused_before_it_is_enabled(tmp_path, name, mode):
    driven = OfVendor(DRIVES[name].write(tmp_path / "drive.eds"), mode, supported=DRIVES[name].supported)
    assert driven.refusal().code in ("FH-209", "FH-212", "FH-227", "FH-229")
    assert driven.bench.statusword & 0x6F == 0x40


def test_a_drive_without_cyclic_modes_says_what_it_can(tmp_path):
    error = OfVendor(NOT_CYCLIC.write(tmp_path / "drive.eds"), "csp", supported=NOT_CYCLIC.supported).refusal()
    text = "supports none of csp, csv, cst, one of which is needed for cyclic commands; it supports profile position"
    assert text in str(error)


def test_a_mode_that_6502h_does_not_list_is_tried_if_the_configuration_insists(tmp_path):
    eds = VendorDrive().write(tmp_path / "drive.eds")  # it has cst
    with OfVendor(eds, "cst", supported=INGENIA.supported, is_mode_check_required=False) as driven:
        assert any("is tried, as is_mode_check_required says" in note for note in driven.facts.notes)


def test_csp_without_a_torque_offset_needs_the_users_word(tmp_path):
    eds = EYOU.write(tmp_path / "drive.eds")
    error = OfVendor(eds, "csp").refusal()
    assert re.search(
        "take mode cst, which compensates without it, or let the axis run without compensation", str(error)
    )
    with OfVendor(eds, "csp", compensation={"enabled": False}) as driven:
        driven.cycle(count=20)
        assert driven.feedback.state is DriveState.OPERATION_ENABLED
        assert "the drive has no 60B2h torque offset: it runs without compensation" in driven.facts.notes
        assert not driven.facts.takes_torque


def test_a_fixed_mapping_is_kept_and_what_it_carries_is_told(tmp_path):
    with OfVendor(FIXED.write(tmp_path / "drive.eds"), "csp") as driven:
        present = driven.bench.read(0x6084)
        driven.cycle(count=20)
        notes = "\n".join(driven.facts.notes)
        assert (
            f"RPDO 3 keeps the mapping that the drive has, which carries 6084h profile deceleration = {present} too"
            in notes
        )
        assert driven.bench.read(0x6084) == present
        assert driven.bench.read(0x60FF, 0, "i") == 0
        assert driven.feedback.state is DriveState.OPERATION_ENABLED


def test_what_a_fixed_mapping_carries_must_be_readable(tmp_path):
    unreadable = VendorDrive(
        is_fixed=True, rpdos=FIXED.rpdos, tpdos=FIXED.tpdos, values={**FIXED.values, ("6084", "AccessType"): "wo"}
    )
    error = OfVendor(unreadable.write(tmp_path / "drive.eds"), "csp").refusal()
    assert re.search(r"RPDO 3 .* carries 6084h profile deceleration too; its value cannot be read", str(error))


POOR = [0x6061, 0x6077, 0x606C, 0x6502, 0x605A, 0x60C2, 0x1017]


def test_a_drive_that_reports_little_is_driven_and_what_that_costs_is_told(tmp_path):
    drive = VendorDrive(lacks=POOR)
    with OfVendor(drive.write(tmp_path / "drive.eds"), "cst") as driven:
        assert driven.facts.torque_delay_s is None
        notes = "\n".join(driven.facts.notes)
        assert "no 6061h modes of operation display: that it takes the mode is not confirmed" in notes
        assert "no 6077h torque actual value: no torque is recorded" in notes
        assert "no 606Ch velocity actual value: the velocity is derived from the position" in notes
        driven.cycle(count=30, torque=0.2)
        assert driven.feedback.state is DriveState.OPERATION_ENABLED
        true = driven.bench.servo.velocity
        assert true > 1.0
        assert driven.feedback.velocity == pytest.approx(true, abs=0.1 * true)


@pytest.mark.parametrize("mode", ["csp", "csv"])
def test_objects_that_are_read_only_and_right_are_no_obstacle(tmp_path, mode):
    values = {("60C2sub1", "AccessType"): "ro", ("60C2sub1", "DefaultValue"): "1", ("60C2sub2", "AccessType"): "ro"}
    values[("60C2sub2", "DefaultValue")] = "-3"
    drive = VendorDrive(values={**values, ("1400sub2", "AccessType"): "ro", ("1400sub2", "DefaultValue"): "1"})
    with OfVendor(drive.write(tmp_path / "drive.eds"), mode) as driven:
        driven.cycle(count=20)
        assert driven.feedback.state is DriveState.OPERATION_ENABLED


def test_another_interpolation_period_is_refused_in_csp_and_told_in_csv(tmp_path):
    values = {("60C2sub1", "AccessType"): "ro", ("60C2sub1", "DefaultValue"): "4"}
    values |= {("60C2sub2", "AccessType"): "ro", ("60C2sub2", "DefaultValue"): "-3"}
    eds = VendorDrive(values=values).write(tmp_path / "drive.eds")
    error = OfVendor(eds, "csp").refusal()
    assert re.search(r"60C2h.* stays at 0.004 s and not 0.001 s.*take period_s: 0.004, or mode", str(error))
    with OfVendor(eds, "csv") as driven:
        assert any("stays at 0.004 s" in note for note in driven.facts.notes)


def test_an_rpdo_that_acts_on_arrival_shortens_the_delay(tmp_path):
    drive = VendorDrive(values={(f"{0x1400 + n:X}sub2", "AccessType"): "ro" for n in range(4)})  # type 255
    with OfVendor(drive.write(tmp_path / "drive.eds"), "cst") as driven:
        assert driven.facts.actuation_delay_s == pytest.approx(1e-3)
        assert "RPDOs of the drive take effect when they arrive and not at SYNC" in driven.facts.notes


def test_tpdos_that_do_not_come_with_sync_are_refused(tmp_path):
    drive = VendorDrive(values={(f"{0x1800 + n:X}sub2", "AccessType"): "ro" for n in range(4)})
    error = OfVendor(drive.write(tmp_path / "drive.eds"), "cst").refusal()
    assert re.search(r"TPDO 1 .* does not come with every SYNC: its transmission type", str(error))


@pytest.mark.deep
@pytest.mark.parametrize(
    "manners",
    [{"controlword": "edge"}, {"controlword": "twice"}, {"switch_on_s": 2.0}, {"switch_on_s": 1.0, "enable_s": 1.5}],
)
@pytest.mark.parametrize("mode", ["csp", "cst"])
def test_drives_that_switch_on_in_their_own_way_are_enabled(tmp_path, mode, manners):
    """Brakes and charging take seconds; some drives look at changes of the controlword, some need it twice."""
    with OfVendor(EPOS4.write(tmp_path / "drive.eds"), mode, manners=manners) as driven:
        driven.cycle(count=3000)
        assert driven.feedback.state is DriveState.OPERATION_ENABLED
        assert (driven.feedback.message, driven.feedback.error) == ("", "")
        assert driven.bench.emergencies == []


WITHOUT_UNITS = (0x608F, 0x60A8, 0x6092, 0x6076)


def keys(drive: VendorDrive, folder: Path, kind="rotary", **options) -> list[str]:
    dictionary = load_eds(drive.write(folder / "drive.eds"), NODE)
    return [key for key, _ in necessary_keys(dictionary, CanopenOptions(node=NODE, **options), kind)]


@pytest.mark.parametrize(
    ("lacks", "needed"),
    [
        ((), []),
        (WITHOUT_UNITS, ["counts_per_unit", "rated_torque"]),
        ((0x6007, 0x1029), ["is_watchdog_required"]),
        ((0x1016, 0x100C, *EVENT_TIMERS), ["is_watchdog_required"]),
        ((0x1016, 0x100C), []),
        ((0x6007, 0x1016, 0x100C), ["is_watchdog_required"]),  # the timer of an RPDO has no effect
        ((*WITHOUT_UNITS, 0x6007, 0x1029), ["counts_per_unit", "rated_torque", "is_watchdog_required"]),
    ],
)
def test_every_key_that_an_eds_makes_necessary_is_named(tmp_path, lacks, needed):
    assert keys(VendorDrive(lacks=lacks), tmp_path) == needed
    accepted = {**UNITS, "is_watchdog_required": False}
    assert keys(VendorDrive(lacks=lacks), tmp_path, **accepted) == []


def test_a_limit_that_leaves_no_room_for_a_node_makes_the_consumer_useless(tmp_path):
    limited = VendorDrive(lacks=(0x100C, *EVENT_TIMERS), values={("1016sub1", "HighLimit"): "65535"})
    assert keys(limited, tmp_path) == ["is_watchdog_required"]
    assert keys(VendorDrive(lacks=(0x100C, *EVENT_TIMERS)), tmp_path) == []


def test_cst_is_recommended_only_to_a_drive_that_has_it(tmp_path):
    for drive in (VendorDrive(lacks=(0x60B2,), supported=CSP), VendorDrive(lacks=(0x60B2, 0x6071))):
        [text] = reasons(drive, "csp", tmp_path)
        assert "mode cst does without it" not in text
        assert "compensation: {enabled: false}" in text
