"""Servo drives of other vendors, as their EDS and DCF files describe them: what the driver must cope with.

Each is described in a few lines of our own, in terms of the simulated drive's EDS: the objects that it lacks, and those
that differ. Nothing is copied from the files. From the description comes an EDS for tests and for the simulated drive.
"""

import configparser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from friction_hil_drivers.canopen.connect.eds import SIMULATED_SERVO

INTEGER32 = "0x0004"
CSP, CSV, CST = 0x80, 0x100, 0x200
EVENT_TIMERS = tuple(f"{0x1400 + n:X}sub5" for n in range(4))


@dataclass(frozen=True)
class VendorDrive:
    """What an EDS says of a drive, where it differs from the EDS of the simulated drive."""

    supported: int | None = CSP | CSV | CST  # 6502h; None: the file gives no value
    lacks: Sequence[int | str] = ()  # indices and sections (1400sub5) that the file has not
    values: Mapping[tuple[str, str], str] = field(default_factory=dict)  # (section, key) -> value
    # mapping of each PDO as delivered, as many as the drive has; empty: as in the simulated drive
    rpdos: Sequence[Sequence[int]] = ()
    tpdos: Sequence[Sequence[int]] = ()
    most_entries: int = 8  # of each PDO
    is_fixed: bool = False  # the mappings are read-only
    # by mode: whether the EDS passes the comparison with the mode, with compensation
    works: Mapping[str, bool] = field(default_factory=lambda: {"csp": True, "csv": True, "cst": True})

    def write(self, path: Path) -> Path:
        """Write an EDS of this drive."""
        eds = configparser.RawConfigParser()
        eds.optionxform = str  # type: ignore[assignment,method-assign]
        eds.read(SIMULATED_SERVO)
        self._map(eds, 0x1400, 0x1600, self.rpdos)
        self._map(eds, 0x1800, 0x1A00, self.tpdos)
        for lacking in self.lacks:
            _remove(eds, lacking)
        for (section, key), value in self.values.items():
            eds[section][key] = value
        if eds.has_section("6502"):
            eds["6502"]["DefaultValue"] = "" if self.supported is None else hex(self.supported)
        with path.open("w") as file:
            eds.write(file, space_around_delimiters=False)
        return path

    def _map(
        self, eds: configparser.RawConfigParser, parameters: int, mappings: int, pdos: Sequence[Sequence[int]]
    ) -> None:
        for number in range(4):
            mapping = f"{mappings + number:X}"
            if pdos and number < len(pdos):
                words = pdos[number]
                eds[f"{mapping}sub0"]["DefaultValue"] = str(len(words))
                for position in range(1, 9):
                    word = words[position - 1] if position <= len(words) else 0
                    eds[f"{mapping}sub{position}"]["DefaultValue"] = hex(word)
            for position in range(9):
                if position > self.most_entries:
                    _remove(eds, f"{mapping}sub{position}")
                elif self.is_fixed:
                    eds[f"{mapping}sub{position}"]["AccessType"] = "ro"
            if pdos and number >= len(pdos):
                _remove(eds, parameters + number)
                _remove(eds, mappings + number)


def _remove(eds: configparser.RawConfigParser, what: int | str) -> None:
    """Remove an object with its sub-indices, or one section."""
    name = what if isinstance(what, str) else f"{what:04X}"
    for section in eds.sections():
        if section == name or section.startswith(f"{name}sub"):
            eds.remove_section(section)
    if isinstance(what, int):
        for section in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
            if not eds.has_section(section):
                continue
            listed = [v for k, v in eds[section].items() if k.isdigit() and int(v, 16) != what]
            eds[section] = {"SupportedObjects": str(len(listed)), **{str(n): v for n, v in enumerate(listed, 1)}}


CONTROL, STATUS, POSITION, VELOCITY = 0x60400010, 0x60410010, 0x60640020, 0x606C0020
TO_POSITION, TO_VELOCITY, MODE = 0x607A0020, 0x60FF0020, 0x60600008
STANDARD_RPDOS = ([CONTROL], [CONTROL, MODE], [CONTROL, TO_POSITION], [CONTROL, TO_VELOCITY])
STANDARD_TPDOS = ([STATUS], [STATUS, 0x60610008], [STATUS, POSITION], [STATUS, VELOCITY])

EPOS4 = VendorDrive(supported=None, values={("60A9", "DefaultValue"): "0x00B44700"})
EROB = VendorDrive(
    supported=0x38D,
    lacks=[0x6007, 0x605A, 0x608F, 0x60A9],
    values={("6076", "AccessType"): "ro", ("6040", "AccessType"): "rww", ("60B2", "AccessType"): "rww"},
    rpdos=([CONTROL], [CONTROL, TO_POSITION], [CONTROL, TO_VELOCITY], []),
    tpdos=([STATUS], [STATUS, POSITION], [STATUS, VELOCITY], []),
)
E35 = VendorDrive(
    supported=0x303EF,
    lacks=[0x1016, 0x6007, 0x605A, *EVENT_TIMERS],
    values={
        ("60B2", "DataType"): INTEGER32,
        ("1800sub3", "DefaultValue"): "1000",
        ("1801sub3", "DefaultValue"): "1000",
    },
    rpdos=([TO_VELOCITY, CONTROL], [], [], []),
    tpdos=([VELOCITY, STATUS], [0x60770010], [POSITION], []),
)
EYOU = VendorDrive(
    supported=0x3CD,
    lacks=[0x60B2, 0x6076, 0x608F, 0x60A9, 0x6007, *EVENT_TIMERS],
    values={("60C2sub2", "AccessType"): "ro", ("60C2sub2", "DefaultValue"): "-3"},
    rpdos=([CONTROL, TO_VELOCITY, MODE], [TO_POSITION], [], []),
    works={"csp": False, "csv": False, "cst": True},
)
INGENIA = VendorDrive(
    supported=CSP | CSV,
    lacks=[0x1016, 0x608F, 0x60A9],
    rpdos=STANDARD_RPDOS,
    tpdos=STANDARD_TPDOS,
    values={("1800sub3", "DefaultValue"): "1000"},
    works={"csp": True, "csv": True, "cst": False},
)
SCHUNK = VendorDrive(
    supported=0x2 | 0x40 | 0x1,
    lacks=[0x6007, 0x605A, 0x6071, 0x6074, 0x6076, 0x60FF, *(f"{0x1400 + n:X}sub5" for n in range(2))],
    rpdos=([CONTROL], []),
    works={"csp": False, "csv": False, "cst": False},
)
NOT_CYCLIC = VendorDrive(supported=0x65, lacks=[0x1016], works={"csp": False, "csv": False, "cst": False})
FIXED = VendorDrive(
    is_fixed=True,
    rpdos=([CONTROL], [MODE, CONTROL], [0x60840020, TO_POSITION], [CONTROL, TO_VELOCITY, 0x60B20010]),
    tpdos=([STATUS], [0x60610008, STATUS, POSITION], [0x60740010, VELOCITY, STATUS], []),
    works={"csp": True, "csv": True, "cst": False},
)
TWO_ENTRIES = VendorDrive(most_entries=2, rpdos=STANDARD_RPDOS, tpdos=STANDARD_TPDOS)
ONE_ENTRY = VendorDrive(most_entries=1, rpdos=([CONTROL], [], [], []), tpdos=([STATUS], [], [], []))

DRIVES = {
    "maxon EPOS4": EPOS4,
    "ZeroErr eRob": EROB,
    "e35": E35,
    "EYOU": EYOU,
    "Ingenia EVE-XCR-C": INGENIA,
    "Schunk": SCHUNK,
    "no cyclic mode": NOT_CYCLIC,
    "fixed mapping": FIXED,
    "two entries": TWO_ENTRIES,
    "one entry": ONE_ENTRY,
}
