"""Changes while the loop runs: applied between two cycles, without a step of torque, and reproduced by replay."""

import copy
import json
import os
import re
from dataclasses import asdict, replace

import numpy as np
import pytest
import yaml

from friction_hil import compensator, recordings
from friction_hil.compensator import kernel
from friction_hil.config import self_contained
from friction_hil.daemon.control.journal import JournalReader, JournalWriter, loop_pages, make_journal
from friction_hil.daemon.control.message import Action, AxisChange, Change, pack
from friction_hil.daemon.control.packed import room, unpack
from friction_hil.daemon.control.prepare import entry_of, prepare
from friction_hil.daemon.control.state import ERROR_WITHOUT, Messages
from friction_hil.daemon.figures import SETTLE_S, Condition
from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.static_torque import StaticTorque
from friction_hil.drive import DriveState, Request
from friction_hil.errors import DriveError, RecordingError, UsageError
from friction_hil.recordings import columns
from friction_hil.recordings.fingerprint import fingerprint
from friction_hil.recordings.mcap_writer import McapWriter
from friction_hil.replay.verify import verify
from tests.loop_run import Run, heard, in_state
from tests.networks import model_file, random_network
from tests.servo_drives import PERIOD_S, TRUE_FRICTION, axis_dict, configuration

MOTION = {"kind": "sine", "amplitude": 0.3, "frequency": 2.0, "ramp_s": 0.1}
LIMITS = {"torque": 0.3, "velocity": 30.0, "following_error": 0.5}
STRIBECK = {
    "axis": "rotary",
    "friction": {
        "model": "stribeck",
        "parameters": {"coulomb": 0.05, "static": 0.07, "stribeck_velocity": 0.2},
        "modifiers": {"temperature": {"reference": 40.0, "coefficient": -0.004}},
    },
    "mechanics": {"inertia": 2e-4, "torque_lag_s": 5e-4},
    "thermal": {"capacity": 100.0, "resistance": 1.0},
}
ELEMENTS = {"stiffness": [1500.0, 500.0], "weight": [0.6, 0.4], "attraction": 2.0}
GMS = {
    "axis": "rotary",
    "friction": {"model": "gms", "parameters": {**ELEMENTS, "coulomb": 0.09, "static": 0.13, "stribeck_velocity": 0.2}},
    "mechanics": {"inertia": 2e-4},
}


def quick(**changes):
    """An axis whose limits have no slew: only the transition itself can keep the torque from stepping."""
    return axis_dict(**{"trajectory": MOTION, "compensation": {"fade_s": 0.05}, "limits": LIMITS} | changes)


class Changed(Run):
    """A run with changes: ``plan`` is, by cycle, what is set (a dict) or asked of the run (an Action)."""

    def __init__(self, *axes, plan, until, before=None, **loop):
        self.plan, self.first, self.present = plan, before, None
        self.journal = JournalReader(make_journal(room(len(axes))))
        self.writer = JournalWriter(self.journal.descriptor)
        self.models_of = dict.fromkeys("xyz"[: len(axes)], 0)
        self.entries, self.asked, self.refusals = [], 0, []
        super().__init__(*axes, before=self.before, stop_at=until, journal=self.journal, **loop)
        self.rows = np.array(self.sink.rows)

    @property
    def facts(self):
        return self.drives.connect()

    def before(self, drives):
        if self.first is not None:
            self.first(drives)
        if len(self.refusals) < self.asked and (answer := self.writer.wait(self.asked, 0.0)) is not None:
            self.refusals.append(answer[1])
        wanted = self.plan.get(drives.cycle)
        if wanted is None:
            return
        self.asked += 1
        if isinstance(wanted, Action):
            change = Change(self.asked, wanted, [], f"user 7: {wanted.name.lower()}")
        else:
            present = self.present or self_contained(self.config)
            prepared = prepare(present, "test", wanted, self.facts, {}, has_network=False)
            entry = entry_of(self.asked, prepared, self.models_of, "user 7")
            self.entries.append((drives.cycle, entry))
            self.present = prepared.configuration
            self.models_of = {name: axis["model_of"] for name, axis in entry["axes"].items()}
            change = Change(self.asked, Action.NONE, prepared.axes, f"user 7 set {len(wanted)}")
        self.writer.post(self.asked, pack(change))

    def write(self, path, entries=None, rows=None):
        """A recording as the companion writes it, read again."""
        metadata = {"configuration": self_contained(self.config), "fingerprint": fingerprint()}
        metadata["facts"] = [asdict(fact) for fact in self.facts]
        width = max(axis.state_width for axis in self.axes)
        names = list(self.config.axes), list(columns.NAMES)
        writer = McapWriter(path, *names, state_width=width, metadata=metadata, overwrite=True)
        for cycle, entry in self.entries if entries is None else entries:
            writer.write_event(cycle, "change", json.dumps(entry))
        writer.write(self.rows if rows is None else rows)
        writer.close()
        return recordings.read_all(path)


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Model files by name."""
    folder = tmp_path_factory.mktemp("models")
    found = {}
    for name, content in {"stribeck": STRIBECK, "gms": GMS}.items():
        found[name] = str(folder / f"{name}.yaml")
        (folder / f"{name}.yaml").write_text(json.dumps({"version": 1, **content}))
    return found


@pytest.fixture(scope="module")
def changed(models):
    """A run of two axes through changes of every kind."""
    plan = {
        260: {"x.gain": 0.6},
        261: {"x.gain": 1.1, "x.gain_negative": 0.7, "y.dead_band": 0.1},
        420: {"x.model": models["stribeck"]},
        430: {"x.adaptation": {"time_s": 0.5}, "x.source": "measured"},
        640: {"x.adaptation": None, "y.enabled": False},
        700: {"x.model": models["gms"], "x.gain": 0.8, "y.gain": 0.5, "y.enabled": True},
        800: Action.STOP,
        1100: {"x.compensation.fade_s": 0.02},
        1300: Action.START,
        1500: {"x.model": models["stribeck"]},
    }

    def warm(cycle, feedback):
        feedback[0].temperature = 60.0 if 500 < cycle < 900 else np.nan

    return Changed(quick(), quick(node=2), plan=plan, until=1700, disturb=warm)


def prepared(config, values, facts, rows=(), *, has_network=False):
    return prepare(self_contained(config), "test", values, facts, dict(rows), has_network=has_network).axes


@pytest.fixture(scope="module")
def alone():
    """The configuration of one axis."""
    return configuration(x=quick())


def test_no_change_makes_the_loop_compile(changed):
    """The kernel runs for the record of any model: it was compiled before the loop began."""
    known, one = len(kernel.whole_step.signatures), changed.axes[0].compensator
    record = unpack(pack(Change(1, axes=[AxisChange(None, one.record)])), [one.record])
    one.adopt(record.axes[0].record, None)
    one.step(9999.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, True, False)
    assert len(kernel.whole_step.signatures) == known


def test_every_bit_is_reproduced_through_all_changes(changed, tmp_path):
    assert changed.result.faults == []
    assert changed.refusals == [""] * 10
    for name, recording in changed.write(tmp_path / "run.mcap").items():
        result = verify(recording)
        assert (result.axis, result.is_verified, result.reason) == (name, True, "")
        assert (result.rows, result.tolerance) == (len(changed.rows), 0.0)
        assert set(recording["change"].astype(int)) == {0, 1, 2, 3, 4, 5, 6, 8, 10}


@pytest.mark.parametrize("number", [2, 3, 6])
def test_a_change_that_is_not_what_was_applied_is_found(changed, tmp_path, number):
    entries = json.loads(json.dumps(changed.entries))
    place = [entry["number"] for _, entry in entries].index(number)
    altered = entries[place][1]["axes"]["x"]["compensation"]
    altered["gain"] = altered["gain_negative"] = 0.75 + 1e-12
    result = verify(changed.write(tmp_path / "run.mcap", entries)["x"])
    cycle = next(cycle for cycle, entry in changed.entries if entry["number"] == number)
    assert not result.is_verified
    # the first torque after a change is that of the former settings, whatever the gain: the second shows it
    assert cycle <= int(result.reason.split(":")[0].removeprefix("cycle ")) <= cycle + 2


def test_rows_are_lost_and_files_begin_between_changes(changed, tmp_path):
    """The settings of a row follow from its number, not from the changes that were seen before."""
    lost = np.delete(changed.rows, np.r_[250:320, 425:435, 690:720], axis=0)
    assert verify(changed.write(tmp_path / "lost.mcap", rows=lost)["x"]).is_verified
    late = changed.write(tmp_path / "late.mcap", rows=changed.rows[1000:])["x"]
    assert verify(late).is_verified
    without = changed.write(tmp_path / "without.mcap", entries=changed.entries[:2])["x"]
    with pytest.raises(RecordingError, match="change 3 "):
        verify(without)


def test_no_change_makes_the_torque_step(changed):
    """Not even where limits.torque_slew is not given."""
    for name in ("x", "y"):
        torque = changed.column("compensation", name)
        steps = np.abs(np.diff(torque))
        ordinary = steps[60:255].max()
        for cycle, entry in changed.entries:
            if entry["axes"][name]["is_adopted"]:
                row = int(np.flatnonzero(changed.column("cycle", name) == cycle)[0])
                assert steps[row - 1 : row + 2].max() <= 1.1 * ordinary


def test_a_change_takes_effect_within_the_time_of_its_fade(changed):
    """Sliding, the torque is that of the new settings: of negative motion 0.7 instead of 0.9 of the friction."""
    torque, velocity, cycle = changed.columns("compensation", "velocity_demand", "cycle")
    at_once = {int(cycle[changed.column("change", name) == 2.0].min()) for name in ("x", "y")}
    assert at_once == {at for at, entry in changed.entries if entry["number"] == 2}
    parts = cycle < 260, (cycle > 355) & (cycle < 420)
    before, after = (torque[(np.abs(velocity) > 1.0) & rows] for rows in parts)
    assert (np.sign(before[0]), np.sign(after[0])) == (1.0, -1.0)
    assert np.median(np.abs(after)) / np.median(np.abs(before)) == pytest.approx(0.7 / 0.9, rel=0.1)
    y = changed.column("compensation", "y")
    assert np.all(y[692:699] == 0.0)
    assert np.abs(y[640:690]).max() > 0.0
    # what adaptation had learned ends with it
    assert np.all(changed.axes[0].compensator.record[0]["adaptation_s"] == 0.0)


def test_a_stop_takes_the_power_and_a_start_gives_it_back_from_where_the_axis_stands(changed):
    assert changed.events() == [
        *("enabling", "running", "stopping", "disabling", "waiting"),
        *("enabling", "running", "stopping", "disabling", "done"),
    ]
    state, drive, position, demand = changed.columns("state", "drive_state", "position", "position_demand")
    waiting = state == LoopState.WAITING
    assert waiting.sum() > 100
    assert set(drive[waiting][2:]) == {DriveState.SWITCH_ON_DISABLED}
    assert {changed.commands[0][k].request for k in np.flatnonzero(waiting)} == {Request.DISABLE}
    again = int(np.flatnonzero((state == LoopState.RUNNING) & (changed.column("cycle") > 1300))[0])
    assert abs(demand[again] - position[again - 1]) < 1e-4
    assert changed.events("notice") == [*changed.result.notices]
    assert "user 7: stop" in changed.result.notices


def latest(changed, rows):
    """Inputs and first state of rows of axis x."""
    part = changed.rows[rows, : len(columns.NAMES) + changed.axes[0].state_width]
    inputs = {name: part[:, columns.NAMES.index(name)] for name in compensator.INPUTS}
    return {"x": (inputs, part[0, len(columns.NAMES) :])}


def test_the_state_of_another_model_is_that_of_the_latest_motion(changed, models):
    cold, warm = (
        prepared(changed.config, {"x.model": models["gms"]}, changed.facts, rows)[0].friction
        for rows in ({}, latest(changed, slice(200, 255)))
    )
    assert not cold.any()
    assert np.abs(warm).max() > 1e-6


def test_a_model_of_the_same_family_begins_with_the_present_state(changed):
    """The latest cycles may be those of a rest, which say nothing of the state."""
    model = copy.deepcopy(self_contained(changed.config)["axes"]["x"]["model"])
    model["friction"]["parameters"]["coulomb"] *= 1.1
    rows = latest(changed, slice(250, 251))
    state = rows["x"][1][compensator.STATE.fields["friction"][1] // 8]
    change, _ = prepared(changed.config, {"x.model": model}, changed.facts, rows)
    assert abs(state) > 1e-6
    np.testing.assert_allclose(change.friction[0], state, rtol=0.2)


def test_a_fault_of_a_daemon_that_waits_is_reset_by_somebody_before_a_start():
    plan = {200: Action.START, 600: Action.START, 650: Action.RESET, 700: Action.START}
    run = Changed(
        quick(), plan=plan, until=1000, before=in_state(DriveState.FAULT, 400), is_waiting=True, faults=["x FH-105"]
    )
    assert [bool(each) for each in run.refusals] == [False, True, False, False]
    assert "it has a fault" in run.refusals[1]
    assert run.events() == [
        *("waiting", "enabling", "running", "fault_stopping", "disabling", "waiting"),
        *("enabling", "running", "stopping", "disabling", "done"),
    ]
    requests = [command.request for command in run.commands[0]]
    # nothing is written to a drive before somebody starts it, and after the fault none is enabled before that
    assert set(requests[:200]) == {Request.LISTEN}
    assert Request.ENABLE not in requests[402:699]
    assert Request.RESET_FAULT in requests[650:652]
    assert Request.RESET_FAULT not in requests[:650]


def test_an_axis_whose_computation_failed_is_not_started_again():
    plan = {200: Action.START, 600: Action.RESET, 700: Action.START}
    run = Changed(quick(), plan=plan, until=900, disturb=heard(400, 401, velocity="fast"), is_waiting=True, faults=None)
    assert run.refusals[:2] == ["", ""]
    assert run.refusals[2].startswith("x: its computation has failed")
    assert Request.ENABLE not in [command.request for command in run.commands[0]][402:]


@pytest.mark.parametrize(
    ("plan", "reasons", "loop"),
    [
        (
            {100: Action.START, 300: Action.RESET, 400: Action.STOP, 405: Action.START},
            ["started already", "not stopped", "^$", "still stopping"],
            {},
        ),
        ({50: Action.START, 60: Action.STOP}, ["a dry run enables", "a dry run has enabled"], {"dry_run": True}),
    ],
)
def test_what_is_not_possible_now_is_refused_with_the_reason(plan, reasons, loop):
    run = Changed(quick(), plan=plan, until=600, **loop)
    for reason, refusal in zip(reasons, run.refusals, strict=True):
        assert re.search(reason, refusal)


def test_a_stop_takes_the_power_of_a_drive_that_a_waiting_daemon_found_with_power():
    found = in_state(DriveState.OPERATION_ENABLED, 0)  # an earlier daemon was killed
    run = Changed(quick(), plan={200: Action.STOP}, until=300, before=found, is_waiting=True)
    assert {command.request for command in run.commands[0][:200]} == {Request.LISTEN}
    drive = run.column("drive_state")
    assert (drive[150], drive[250]) == (DriveState.OPERATION_ENABLED, DriveState.SWITCH_ON_DISABLED)
    assert run.result.drive_states == [DriveState.SWITCH_ON_DISABLED]


@pytest.mark.parametrize("is_wanted", [True, False])
def test_a_waiting_daemon_resets_the_fault_that_it_found_only_on_the_users_word(is_wanted):
    """`run --wait --reset-fault`: however late somebody starts the axes, and only once."""
    plan, faults = {1500: Action.START, 2200: Action.START}, in_state(DriveState.FAULT, 0, 1900)
    run = Changed(
        quick(), plan=plan, until=2300, before=faults, is_waiting=True, is_fault_reset_wanted=is_wanted, faults=None
    )
    requests = {cycle for cycle, command in enumerate(run.commands[0]) if command.request is Request.RESET_FAULT}
    assert run.refusals[-1] != ""
    if not is_wanted:
        assert "it has a fault" in run.refusals[0]
        assert not requests
        return
    assert run.refusals[0] == ""
    assert requests <= set(range(1500, 1510))
    drive = run.column("drive_state")
    assert np.all(drive[1550:1890] == DriveState.OPERATION_ENABLED)
    assert not np.any(drive[1910:] == DriveState.OPERATION_ENABLED)


def test_a_stop_before_the_last_start_proves_nothing_about_the_power_now():
    def breaks(cycle, feedback):
        if cycle == 400:
            raise DriveError("the line is gone")

    run = Changed(quick(), plan={200: Action.START}, until=900, disturb=breaks, is_waiting=True, faults=None)
    assert run.column("drive_state")[-1] == DriveState.OPERATION_ENABLED
    assert run.result.drive_states == [DriveState.UNKNOWN]


def test_figures_are_those_of_the_last_motion_also_when_the_run_ends_while_it_waits():
    run = Changed(quick(), plan={3000: Action.STOP}, until=3600)
    assert run.axes[0].following.errors.figures(Condition.WITH).counted >= 500


def test_garbage_in_the_journal_is_reported_once_and_changes_nothing():
    class Scribbled(Changed):
        def before(self, drives):
            if 100 <= drives.cycle < 900 and drives.cycle % 3 == 0:
                first, _ = loop_pages(self.journal.descriptor)
                os.pwrite(self.journal.descriptor, np.random.default_rng(drives.cycle).bytes(600), first)
            super().before(drives)

    quiet, run = (each(quick(), plan={}, until=1000) for each in (Changed, Scribbled))
    assert len(run.result.warnings) == 1
    assert "journal of the control socket" in run.result.warnings[0]
    np.testing.assert_array_equal(run.column("compensation"), quiet.column("compensation"))
    assert run.result.faults == []


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"x.gian": 0.8}, "x.gian: .*'gain'"),
        ({"z.gain": 0.8}, "z.gain: .*'z'.*: x"),
        ({"x.gain": 3.0}, "x.gain: .* 0 .* 1.5, not 3.0"),
        ({"x.gain": "high"}, "x.gain: .*'high'"),
        ({"x.enabled": "off"}, "x.enabled: .*'off' .* write false"),
        ({"x.source": "measurd"}, "x.source: .*'auto', 'measured' or 'demand'"),
        ({"x.adaptation.time_s": 0.01}, "x.adaptation.time_s: .* 0.1"),
        ({"x.adaptation.time": 1.0}, "x.adaptation.time: .*'time_s'"),
        ({"x.gain.more": 1.0}, "x.gain.more|gain has no keys"),
        ({"x.velocity": "kalman"}, "x.velocity: .* it would begin"),
        ({"x.transmission": None}, "x.transmission: .* because it would move the set-point"),
        ({"x.limits.torque": 1.0}, "x.limits.torque: cannot be changed"),
        ({"x.model": "gone.yaml"}, "x.model: there is no"),
        ({"x.gian": 1.0, "x.limits": 1.0}, "(?s)x.gian: .*\n.*x.limits: "),
        ({"": 1.0}, "no axis ''"),
    ],
)
def test_values_are_refused_with_the_words_of_the_configuration(changed, alone, values, message):
    with pytest.raises(UsageError, match=message):
        prepared(alone, values, changed.facts[:1])


def test_a_network_is_refused_by_a_daemon_that_has_not_loaded_its_code(changed, alone, tmp_path):
    path = tmp_path / "net.yaml"
    path.write_text(yaml.safe_dump(model_file(random_network())))
    with pytest.raises(UsageError, match=r"x\.model: has a network"):
        prepared(alone, {"x.model": str(path)}, changed.facts[:1])
    (change,) = prepared(alone, {"x.model": str(path)}, changed.facts[:1], has_network=True)
    message = pack(Change(1, axes=[change]))
    with pytest.raises(ValueError, match="wrong size"):
        unpack(message, [changed.axes[0].compensator.record])


def test_models_that_cannot_take_the_place_of_the_present_one_are_refused(changed, alone, tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text(json.dumps({"version": 1, **GMS, "axis": "linear"}))
    with pytest.raises(UsageError, match=r"x.model: .* linear .* rotary"):
        prepared(alone, {"x.model": str(path)}, changed.facts[:1])
    mechanics = {"inertia": 2e-4, "backlash": 1e-3, "load": {"inertia": 1e-4, "friction": 0.03}}
    friction = {"model": "lugre", "parameters": dict(TRUE_FRICTION)}
    with_gap = {"axis": "rotary", "friction": friction, "mechanics": mechanics}
    path.write_text(json.dumps({"version": 1, **with_gap}))
    offset = quick(model=with_gap, compensation={"fade_s": 0.05, "transmission": {"acceleration": 300.0}})
    with pytest.raises(UsageError, match=r"compensation\.transmission"):
        prepared(configuration(x=offset), {"x.model": str(path)}, changed.facts[:1])


def test_compensation_is_not_enabled_where_no_torque_gets_to_the_drive(changed):
    config = configuration(x=quick(compensation={"enabled": False}))
    facts = [replace(changed.facts[0], takes_torque=False)]
    with pytest.raises(UsageError, match=r"x\.enabled: must be false"):
        prepared(config, {"x.enabled": True}, facts)
    (change,) = prepared(config, {"x.enabled": False}, facts)
    assert change.is_enabled is False


def test_gravity_follows_each_change_within_the_fade(models, tmp_path):
    """Switched off, on, with another model, and with the compensation: as a new start would feed it, without a step."""
    heavier = tmp_path / "heavier.yaml"
    mechanics = {"inertia": 2e-4, "offset": 0.06, "gravity": {"constant": 0.01}}
    heavier.write_text(json.dumps({"version": 1, **STRIBECK, "mechanics": mechanics}))
    x = quick()
    x["model"] = x["model"] | {"mechanics": {"inertia": 2e-4, "gravity": {"constant": 0.04}}}
    plan = {
        300: {"x.gravity": False},
        400: {"x.gravity": True},
        500: {"x.model": str(heavier)},
        600: {"x.enabled": False},
        700: {"x.gain": 3.0 / 4.0},
        800: {"x.enabled": True},
        900: {"x.model": models["stribeck"]},
    }
    changed = Changed(x, plan=plan, until=1000)
    assert changed.refusals == [""] * len(plan)
    fed = changed.column("command") - changed.column("compensation")
    ends = [fed[cycle - 1] for cycle in (*plan, 1000)]
    assert ends == pytest.approx([0.04, 0.0, 0.04, 0.07, 0.0, 0.0, 0.07, 0.0], abs=1e-9)
    steps = np.abs(np.diff(fed))[200:1000]
    assert steps.max() <= 0.07 / 49  # of the 50 cycles of the fade


@pytest.mark.parametrize("damage", [{"bound": 0.4}, {"bound": -0.1}, {"sine": np.nan}, {"offset": np.inf}])
def test_a_damaged_gravity_is_refused(changed, damage):
    whole = StaticTorque(0.2, 0.1, 0.0, 0.1, 0.0)
    records = [axis.compensator.record for axis in changed.axes]
    taken = unpack(pack(Change(1, axes=[AxisChange(static=whole), None])), records)
    assert taken.axes == [AxisChange(static=whole), None]
    with pytest.raises(ValueError, match="gravity"):
        unpack(pack(Change(1, axes=[AxisChange(static=whole._replace(**damage)), None])), records)


def test_the_error_without_compensation_is_told_when_compensation_begins_after_each_start():
    plan = {1500: Action.STOP, 1900: Action.START}
    with_baseline = {"fade_s": 0.05, "baseline_s": 1.3}
    off = {**with_baseline, "enabled": False}
    axes = quick(compensation=with_baseline), quick(node=2, compensation=off), quick(node=3)  # that from the start on
    run = Changed(*axes, plan=plan, until=3500)
    told = [(cycle, text) for cycle, name, text in run.sink.events if name == ERROR_WITHOUT]
    running = np.flatnonzero(np.diff((run.column("state") == LoopState.RUNNING).astype(int)) == 1) + 1
    on = np.flatnonzero(np.diff(run.column("is_enabled")) == 1.0) + 1
    assert [cycle for cycle, _ in told] == list(on)  # in the cycle in which compensation begins
    error = run.column("position_demand") - run.column("position")
    period, settled = round(0.5 / PERIOD_S), round((0.25 + SETTLE_S) / PERIOD_S)  # after the ramp of `make_loop`
    for (cycle, text), began in zip(told, running, strict=True):
        messages = Messages()
        messages.take(ERROR_WITHOUT, text)
        counted = error[began + settled :][:period]  # a whole period
        assert began + settled + period <= cycle
        figures = {"rms": np.sqrt(np.mean(counted**2)), "peak": np.abs(counted).max(), "seconds": 0.5}
        assert messages.error_without == {"x": pytest.approx(figures, rel=1e-3)}
