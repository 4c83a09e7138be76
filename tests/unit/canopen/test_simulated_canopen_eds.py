"""The shipped EDS: complete, and the same as the table of objects and as what the simulated drive does."""

import configparser
from pathlib import Path
from typing import Any

import canopen
import pytest
from friction_hil_drivers.canopen.connect.eds import SIMULATED_SERVO, load_eds
from friction_hil_drivers.canopen.simulated.eds_dictionary import eds_dictionary
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402.objects import DataType

from friction_hil.errors import UsageError
from tests.canopen_bench import NODE, Bench


@pytest.fixture(scope="module")
def eds() -> Any:
    return canopen.import_od(str(SIMULATED_SERVO), NODE)


def variables(eds: Any) -> list[Any]:
    items = [item for item in eds.values() if item.index >= 0x1000]
    single = canopen.objectdictionary.ODVariable
    return [entry for item in items for entry in ([item] if isinstance(item, single) else item.values())]


def test_every_entry_has_type_access_and_default_and_is_that_of_the_table(eds: Any) -> None:
    known = {index for index, _ in cia301.TABLE}
    known |= {base + n for base in (0x1400, 0x1600, 0x1800, 0x1A00) for n in range(cia301.PDO_COUNT)}
    for variable in variables(eds):
        assert variable.data_type in set(DataType), variable
        assert variable.access_type in ("ro", "rw", "const"), variable
        assert variable.default is not None, variable
        if variable.min is not None and variable.max is not None:
            assert variable.min <= variable.default <= variable.max, variable
        assert variable.index in known, variable
        entry = cia301.TABLE.get((variable.index, variable.subindex))
        if entry is not None:  # the driver also knows objects of other drives
            assert (variable.data_type, variable.name) == (entry.type, entry.name)
    information = eds.device_information
    assert (information.nr_of_RXPDO, information.nr_of_TXPDO) == (cia301.PDO_COUNT, cia301.PDO_COUNT)
    assert eds[0x1018][2].default == information.product_number
    assert eds[0x1018][1].default == information.vendor_number
    assert load_eds(SIMULATED_SERVO, 7)[0x1014].default == 0x87


def test_lists_of_objects_match_the_sections() -> None:
    parser = configparser.RawConfigParser()
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read(SIMULATED_SERVO)
    listed: list[int] = []
    for section in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        count = parser.getint(section, "SupportedObjects")
        listed += [int(parser.get(section, str(number)), 0) for number in range(1, count + 1)]
        assert len(parser.options(section)) == count + 1
    described = [int(name, 16) for name in parser.sections() if len(name) == 4]
    assert sorted(listed) == sorted(described)
    assert len(set(listed)) == len(listed)
    for name in parser.sections():
        if len(name) == 4 and parser.has_option(name, "SubNumber"):
            subindices = [s for s in parser.sections() if s.startswith(f"{name}sub")]
            assert len(subindices) == int(parser.get(name, "SubNumber"), 0), name
            highest = max(int(s[7:], 16) for s in subindices)
            counts_what_is_there = name == "1003" or int(name, 16) >> 8 in (0x16, 0x1A)
            if not counts_what_is_there:
                assert int(parser.get(f"{name}sub0", "DefaultValue"), 0) == highest, name


def test_simulated_drive_serves_exactly_the_eds(eds: Any) -> None:
    bench = Bench()
    present = {(variable.index, variable.subindex) for variable in variables(eds)}
    for index in sorted({index for index, _ in present}):
        for subindex in range(12):
            [(_, answer)] = bench.sdo(bytes([0x40, index & 0xFF, index >> 8, subindex, 0, 0, 0, 0]))
            abort = int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0
            assert (abort in (0x06020000, 0x06090011)) == ((index, subindex) not in present), f"{index:X}:{subindex}"


# Foreign EDS files


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("missing.eds", None, "cannot be read"),
        ("drive.xml", "<xml/>", "should end in"),
        ("empty.eds", "", "no object"),
        ("garbage.eds", "this is no EDS", "no valid EDS"),
        ("twice.eds", "[1000]\n[1000]\n", "no valid EDS"),
        ("nameless.eds", "[1000]\nDataType=7\n", "no valid EDS"),
    ],
)
def test_unreadable_eds_is_a_clear_error(tmp_path: Path, name: str, text: str | None, message: str) -> None:
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(UsageError, match=message) as info:
        eds_dictionary(path, NODE)
    assert name in str(info.value)
