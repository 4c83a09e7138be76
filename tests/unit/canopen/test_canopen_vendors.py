"""Drives of other vendors: their EDS against the modes, and the negotiation with drives that have such an EDS."""

import math
from pathlib import Path

import pytest
from friction_hil_drivers.canopen.connect.eds import load_eds
from friction_hil_drivers.canopen.connect.eds_check import compare_eds, necessary_keys
from friction_hil_drivers.canopen.options import CanopenOptions
from friction_hil_drivers.cia402 import objects

from friction_hil.drive import DriveState, Mode, Request
from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, Bench, BenchBus, Driven
from tests.vendor_drives import (
    CONTROL,
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
    TO_POSITION,
    VendorDrive,
)

UNITS = {"counts_per_unit": 2**20 / math.tau, "rated_torque": 0.64}


def reasons(
    folder: Path, drive: VendorDrive, mode: str, *, is_compensated=True, is_by_velocity=False, **options
) -> list[str]:
    dictionary = load_eds(drive.write(folder / "drive.eds"), NODE)
    options = CanopenOptions(node=NODE, **options)
    how = {"is_compensated": is_compensated, "is_by_velocity": is_by_velocity}
    return list(compare_eds(dictionary, Mode[mode.upper()], options, **how))


WITHOUT_60B2H = "has no object 60B2h torque offset, which mode csp needs"
WITHOUT_6071H = "has no object 6071h target torque, which mode cst needs"
UNMAPPABLE = {("60B2", "PDOMapping"): "0", ("6064", "PDOMapping"): "0"}


@pytest.mark.parametrize(
    ("drive", "mode", "options", "expected"),
    [
        (EYOU, "csp", {}, [WITHOUT_60B2H]),
        (EYOU, "csp", {"is_compensated": False}, []),
        (INGENIA, "cst", {}, ["lists csp, csv as the drive's modes (6502h supported drive modes), not cst"]),
        (INGENIA, "cst", {"is_mode_check_required": False}, []),
        (NOT_CYCLIC, "csv", {}, ["lists profile position, profile velocity, homing, interpolated position as"]),
        (SCHUNK, "cst", {}, [WITHOUT_6071H]),
        (EROB, "cst", {"axis_number": 1}, [WITHOUT_6071H]),  # of the second axis
        (FIXED, "cst", {}, ["fixed mappings only, and those do not contain 6040h controlword, 6071h target torque"]),
        (
            VendorDrive(values=UNMAPPABLE, tpdos=([], [], [], [])),
            "csp",
            {},
            ["60B2h torque offset be mapped into any RPDO", "6064h position actual value be mapped into any TPDO"],
        ),
        (
            VendorDrive(most_entries=1, rpdos=([], []), tpdos=ONE_ENTRY.tpdos),
            "csp",
            {},
            ["has 2 RPDOs of 1 entries that can be mapped; 3 are needed"],
        ),
        (VendorDrive(lacks=(0x60B2,), supported=CSP), "csp", {}, [WITHOUT_60B2H]),
        (VendorDrive(lacks=(0x60B2, 0x6071)), "csp", {}, [WITHOUT_60B2H]),
    ],
)
def test_the_reasons_against_an_eds_are_named(tmp_path, drive, mode, options, expected):
    found = reasons(tmp_path, drive, mode, **options)
    assert all(any(text in reason for reason in found) for text in expected), found
    assert len(found) == len(expected) or drive in (NOT_CYCLIC, SCHUNK, EROB)
    if expected == [WITHOUT_60B2H]:  # cst is recommended only to a drive that has it
        assert ("mode cst does without it" in found[0]) is (drive is EYOU)
        assert ("compensation: {enabled: false}" in found[0]) is (drive is not EYOU)


# --- drives with these EDS, on a bus that hands every frame over at once


class OfVendor(Driven):
    """A simulated drive with a vendor's EDS."""

    def __init__(self, folder: Path, drive: VendorDrive, mode: str, *, supported=None, manners=None, **keys):
        bench = Bench(eds=drive.write(folder / "drive.eds"), modes=tuple(Mode), manners=manners)
        if supported is not None:  # what its EDS says, whatever it can
            bench.node.dictionary.of(objects.SUPPORTED_MODES).value = supported
        super().__init__(mode, bus=BenchBus(bench), **{"is_watchdog_required": False, **UNITS, **keys})

    @property
    def notes(self):
        return "\n".join(self.facts.notes)

    def enable(self, count=20):
        self.cycle(count=count)
        assert (self.feedback.state, self.feedback.message) == (DriveState.OPERATION_ENABLED, ""), self.notes
        assert self.bench.emergencies == []


WORKS = [(name, mode) for name, drive in DRIVES.items() for mode, works in drive.works.items() if works]
WORKS_NOT = [(name, mode) for name, drive in DRIVES.items() for mode, works in drive.works.items() if not works]


@pytest.mark.deep
@pytest.mark.parametrize(("name", "mode"), WORKS)
def test_a_drive_that_can_be_driven_is_driven(tmp_path, name, mode):
    """Enabled, followed, and the torque arrives where it adds to the loops, whatever its PDOs allow."""
    drive = DRIVES[name]
    assert reasons(tmp_path, drive, mode) == []
    with OfVendor(tmp_path, drive, mode) as driven:
        driven.enable()
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


@pytest.mark.parametrize(("name", "mode"), WORKS_NOT)
def test_a_drive_that_cannot_be_driven_is_refused_before_it_is_enabled(tmp_path, name, mode):
    drive = DRIVES[name]
    assert reasons(tmp_path, drive, mode) != []
    driven = OfVendor(tmp_path, drive, mode, supported=drive.supported)
    with pytest.raises(DriveError) as caught, driven:
        pass
    assert caught.value.code in ("FH-209", "FH-212", "FH-227", "FH-229")
    assert drive is not NOT_CYCLIC or "; it supports profile position" in str(caught.value)
    assert driven.bench.statusword & 0x6F == 0x40


def fixed(*records, value=None):
    """EDS values that make objects (or sub-indices) read-only, with a value if one is given."""
    found = {(record, "AccessType"): "ro" for record in records}
    return found if value is None else found | {(record, "DefaultValue"): value for record in records}


FOUR_MS = fixed("60C2sub1", value="4") | fixed("60C2sub2", value="-3")
UNREADABLE = VendorDrive(is_fixed=True, rpdos=FIXED.rpdos, tpdos=FIXED.tpdos, values={("6084", "AccessType"): "wo"})
OWN_TPDOS = VendorDrive(values=fixed(*(f"{0x1800 + n:X}sub2" for n in range(4))))


@pytest.mark.parametrize(
    ("drive", "mode", "told"),
    [
        (EYOU, "csp", "take mode cst, which compensates without it, or let the axis run without compensation"),
        (UNREADABLE, "csp", "RPDO 3 .* carries 6084h profile deceleration too; its value cannot be read"),
        (
            VendorDrive(values=FOUR_MS),
            "csp",
            r"60C2h.* stays at 0.004 s and not 0.001 s.*take period_s: 0.004, or mode",
        ),
        (OWN_TPDOS, "cst", "TPDO 1 .* does not come with every SYNC: its transmission type"),
    ],
    ids=["no offset", "unreadable", "period", "TPDOs"],
)
def test_the_refusal_says_what_stands_in_the_way(tmp_path, drive, mode, told):
    with pytest.raises(DriveError, match=told), OfVendor(tmp_path, drive, mode):
        pass


def test_a_mode_that_6502h_does_not_list_is_tried_if_the_configuration_insists(tmp_path):
    insisting = {"supported": INGENIA.supported, "is_mode_check_required": False}  # it has cst
    with OfVendor(tmp_path, VendorDrive(), "cst", **insisting) as driven:
        assert "is tried, as is_mode_check_required says" in driven.notes


def test_csp_without_a_torque_offset_needs_the_users_word(tmp_path):
    with OfVendor(tmp_path, EYOU, "csp", compensation={"enabled": False}) as driven:
        driven.enable()
        assert "60B2h" in driven.notes
        assert not driven.facts.takes_torque


LOOP = {"velocity_gain": 0.1, "integral_hz": 10.0, "limit": 5.0, "slew": 1e4}
BY_VELOCITY = {"compensation": {"velocity_offset": LOOP}}


@pytest.mark.parametrize("mode", ["csp", "csv"])
@pytest.mark.parametrize("is_inverted", [False, True])
def test_a_drive_without_a_torque_input_gets_the_velocity_offset(tmp_path, mode, is_inverted):
    drive = VendorDrive(lacks=[0x60B2])
    assert reasons(tmp_path, drive, mode, is_by_velocity=True) == []
    with OfVendor(tmp_path, drive, mode, is_inverted=is_inverted, **BY_VELOCITY) as driven:
        driven.enable()
        driven.cycle(count=3, velocity_offset=0.25)
        sign = -1 if is_inverted else 1
        assert driven.bench.read(0x60B1, 0, "i") == sign * round(0.25 * 2**20 / math.tau)
        assert sign * driven.bench.servo.velocity_offset == pytest.approx(0.25, rel=1e-4)
        assert driven.facts.takes_torque
        assert driven.facts.takes_velocity_offset
        with pytest.raises(ValueError, match="nan"):
            driven.cycle(velocity_offset=math.nan)


@pytest.mark.parametrize("lacks", [[], [0x60B1, 0x60B2]])
def test_a_drive_that_takes_nothing_but_positions_gets_no_offset(tmp_path, lacks):
    keys = {"compensation": {"velocity_offset": LOOP | {"position_gain": 100.0}}}
    with OfVendor(tmp_path, VendorDrive(lacks=lacks), "csp", **keys) as driven:
        driven.enable()
        driven.cycle(count=3, position=0.01)
        assert driven.bench.read(0x607A, 0, "i") == round(0.01 * 2**20 / math.tau)
        assert (driven.facts.takes_torque, driven.facts.takes_velocity_offset) == (True, False)
        assert "without compensation" not in driven.notes


def test_a_velocity_offset_goes_beside_a_torque_offset_that_is_kept_at_zero(tmp_path):
    """A drive with a fixed mapping of both gets the one that is configured."""
    both = ([CONTROL, TO_POSITION, 0x60B20010], [CONTROL, 0x60B10020], [], [])
    drive = VendorDrive(is_fixed=True, rpdos=both, tpdos=FIXED.tpdos)
    with OfVendor(tmp_path, drive, "csp", **BY_VELOCITY) as driven:
        driven.enable()
        driven.cycle(count=3, torque=0.05, velocity_offset=0.25)
        assert driven.bench.read(0x60B1, 0, "i") == round(0.25 * 2**20 / math.tau)
        assert driven.bench.read(0x60B2, 0, "h") == 0


@pytest.mark.parametrize(
    ("lacks", "keys", "told"),
    [
        ([0x60B2], {}, "lacks object 60B2h .*give compensation.velocity_offset, as it has 60B1h velocity offset"),
        ([0x60B1, 0x60B2], {}, "lacks object 60B2h .*compensated: give .* position_gain"),
        ([0x60B1], BY_VELOCITY, r"lacks object 60B1h .*\(compensation.velocity_offset\): give .* position_gain"),
    ],
)
def test_what_there_is_beside_the_offset_that_a_drive_lacks_is_told(tmp_path, lacks, keys, told):
    with pytest.raises(DriveError, match=told) as caught, OfVendor(tmp_path, VendorDrive(lacks=lacks), "csp", **keys):
        pass
    assert caught.value.code == "FH-229"


def test_a_fixed_mapping_is_kept_and_what_it_carries_is_told(tmp_path):
    with OfVendor(tmp_path, FIXED, "csp") as driven:
        present = driven.bench.read(0x6084)
        driven.enable()
        told = f"RPDO 3 keeps the mapping that the drive has, which carries 6084h profile deceleration = {present} too"
        assert told in driven.notes
        assert driven.bench.read(0x6084) == present
        assert driven.bench.read(0x60FF, 0, "i") == 0


POOR = [0x6061, 0x6077, 0x606C, 0x6502, 0x605A, 0x60C2, 0x1017]


def test_a_drive_that_reports_little_is_driven_and_what_that_costs_is_told(tmp_path):
    with OfVendor(tmp_path, VendorDrive(lacks=POOR), "cst") as driven:
        assert driven.facts.torque_delay_s is None
        for told in (
            "no 6061h",
            "no 6077h",
            "no 606Ch velocity actual value: the velocity is derived from the position",
        ):
            assert told in driven.notes
        driven.cycle(count=30, torque=0.2)
        assert driven.feedback.state is DriveState.OPERATION_ENABLED
        true = driven.bench.servo.velocity
        assert true > 1.0
        assert driven.feedback.velocity == pytest.approx(true, abs=0.1 * true)


@pytest.mark.parametrize("mode", ["csp", "csv"])
def test_objects_that_are_read_only_and_right_are_no_obstacle(tmp_path, mode):
    values = fixed("60C2sub1", "1400sub2", value="1") | fixed("60C2sub2", value="-3")
    with OfVendor(tmp_path, VendorDrive(values=values), mode) as driven:
        driven.enable()


def test_another_interpolation_period_is_told_in_csv(tmp_path):
    with OfVendor(tmp_path, VendorDrive(values=FOUR_MS), "csv") as driven:
        assert "stays at 0.004 s" in driven.notes


def test_an_rpdo_that_acts_on_arrival_shortens_the_delay(tmp_path):
    drive = VendorDrive(values=fixed(*(f"{0x1400 + n:X}sub2" for n in range(4))))  # type 255
    with OfVendor(tmp_path, drive, "cst") as driven:
        assert driven.facts.actuation_delay_s == pytest.approx(1e-3)
        assert "take effect when they arrive" in driven.notes


@pytest.mark.deep
@pytest.mark.parametrize(
    "manners",
    [{"controlword": "edge"}, {"controlword": "twice"}, {"switch_on_s": 2.0}, {"switch_on_s": 1.0, "enable_s": 1.5}],
)
@pytest.mark.parametrize("mode", ["csp", "cst"])
def test_drives_that_switch_on_in_their_own_way_are_enabled(tmp_path, mode, manners):
    """Brakes and charging take seconds; some drives look at changes of the controlword, some need it twice."""
    with OfVendor(tmp_path, EPOS4, mode, manners=manners) as driven:
        driven.enable(count=3000)
        assert driven.feedback.error == ""


WITHOUT_UNITS = (0x608F, 0x60A8, 0x6092, 0x6076)


NO_ROOM = {("1016sub1", "HighLimit"): "65535"}  # for the number of a node


@pytest.mark.parametrize(
    ("drive", "needed"),
    [
        (VendorDrive(), []),
        (VendorDrive(lacks=WITHOUT_UNITS), ["counts_per_unit", "rated_torque"]),
        (VendorDrive(lacks=(0x6007, 0x1029)), ["is_watchdog_required"]),
        (VendorDrive(lacks=(0x1016, 0x100C, *EVENT_TIMERS)), ["is_watchdog_required"]),
        (VendorDrive(lacks=(0x1016, 0x100C)), []),
        (VendorDrive(lacks=(0x6007, 0x1016, 0x100C)), ["is_watchdog_required"]),  # the timer of an RPDO has no effect
        (VendorDrive(lacks=(0x100C, *EVENT_TIMERS)), []),
        (VendorDrive(lacks=(0x100C, *EVENT_TIMERS), values=NO_ROOM), ["is_watchdog_required"]),
        (
            VendorDrive(lacks=(*WITHOUT_UNITS, 0x6007, 0x1029)),
            ["counts_per_unit", "rated_torque", "is_watchdog_required"],
        ),
    ],
)
def test_every_key_that_an_eds_makes_necessary_is_named(tmp_path, drive, needed):
    dictionary = load_eds(drive.write(tmp_path / "drive.eds"), NODE)
    for given, expected in (({}, needed), ({**UNITS, "is_watchdog_required": False}, [])):
        found = necessary_keys(dictionary, CanopenOptions(node=NODE, **given), "rotary")
        assert [key for key, _ in found] == expected
