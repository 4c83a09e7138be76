"""What the product writes, its own check accepts: every key, also those that nobody has given."""

from pathlib import Path

import pytest
import yaml
from friction_hil_drivers.canopen.simulated.private import private_configuration
from friction_hil_drivers.canopen.simulated.scenario import _FIELDS, Event
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from friction_hil.checked_yaml.text import dump
from friction_hil.cli import main
from friction_hil.config import AxisConfig, Configuration, file_problems, load, self_contained
from friction_hil.config.drivers import SIMULATED_DRIVES, load_driver
from tests.servo_drives import axis_dict

ROOT = Path(__file__).parents[3]
EXAMPLES = [*sorted((ROOT / "config").glob("*.yaml")), *sorted((ROOT / "config" / "machines").glob("*.yaml"))]
VALUES = {"data": "0a0b", "share": 0.5, "by_s": 0.001, "can_id": 0x123, "length": 3, "tpdo": 1, "per_ms": 2}
EVENTS = [
    {"at_s": 2.0, "do": do} | {name: VALUES.get(name, 1) for name in needed} for do, (needed, _) in _FIELDS.items()
]
EVENTS += [{**event, **{name: VALUES.get(name, 1) for name in _FIELDS[event["do"]][1]}} for event in EVENTS]
BUS = {"interface": "udp_multicast", "channel": "239.74.163.2"}


def configuration_of(folder, **simulation):
    values = {"version": 1, "period_s": 1e-3, "bus": BUS, "axes": {"x": axis_dict(simulation=simulation)}}
    path = folder / "machine.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


def written(configuration, folder):
    """A configuration written to a file as `config show` and `run --simulate` do, and read again."""
    path = folder / "shown.yaml"
    path.write_text(dump(self_contained(configuration)), encoding="utf-8")
    return load(path)


def test_every_event_of_a_scenario_is_accepted_again(tmp_path):
    configuration = load(configuration_of(tmp_path, canopen={"events": EVENTS}))
    again = written(configuration, tmp_path)
    assert self_contained(again) == self_contained(configuration)
    private, _ = private_configuration(again)
    assert self_contained(written(private, tmp_path)) == self_contained(private)


@given(st.sampled_from(EVENTS), st.sets(st.sampled_from(sorted(Event.model_fields.keys() - {"at_s", "do"}))))
def test_what_is_null_is_as_good_as_absent(event, absent):
    assert Event(**{name: None for name in absent if name not in event}, **event) == Event(**event)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_accepted_again_as_it_is_shown_and_as_it_is_simulated(path, tmp_path):
    try:
        configuration = load(path, needs_models=False)
    except Exception:  # noqa: BLE001 - a machine of `study`, no configuration
        pytest.skip("no configuration of a daemon")
    again = written(configuration, tmp_path)
    assert self_contained(again) == self_contained(configuration)
    assert file_problems(tmp_path / "shown.yaml", again) == []
    if configuration.is_own_loop:
        return  # there are no drives
    (driver,) = {axis.driver for axis in configuration.axes.values()}
    make_private = load_driver(driver, SIMULATED_DRIVES).make_private
    given, _ = make_private(configuration, tmp_path)
    shown, _ = make_private(again, tmp_path)
    assert self_contained(written(given, tmp_path))["axes"].keys() == given.axes.keys()
    for name in given.axes:  # what simulates the drive is the same, whether a default is written or not
        assert simulated(shown, name) == simulated(given, name)


def simulated(configuration, name):
    found = configuration.axes[name].simulation.model_dump(mode="json")
    return {key: value for key, value in found.items() if key != "line"}


def sections(value):
    """All sections of a configuration."""
    if isinstance(value, BaseModel):
        yield value
        for name in type(value).model_fields:
            yield from sections(getattr(value, name))
    elif isinstance(value, dict):
        for each in value.values():
            yield from sections(each)
    elif isinstance(value, list | tuple):
        for each in value:
            yield from sections(each)


def test_a_new_file_with_all_its_keys_is_accepted_again(tmp_path, monkeypatch):
    """`config new`, then every section of it with its defaults written out."""
    monkeypatch.chdir(tmp_path)
    assert main(["config", "new", "trial.yaml", "--simulated"]) == 0
    count = 0
    for section in sections(load("trial.yaml", needs_models=False)):
        if not isinstance(section, Configuration | AxisConfig):  # the driver's keys are among those of an axis
            again = type(section).model_validate_json(section.model_dump_json(), strict=True)
            assert again.model_dump_json() == section.model_dump_json()
            count += 1
    assert count > 20
