"""Changes while the loop runs: applied between two cycles, without a step of torque, and reproduced by replay."""

import copy
import json
import os
from dataclasses import asdict, replace

import numpy as np
import pytest
import yaml

from friction_hil import recordings
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
from friction_hil.daemon.stop import StopRequest
from friction_hil.drive import DriveState, Request
from friction_hil.errors import DriveError, RecordingError, UsageError
from friction_hil.recordings import columns
from friction_hil.recordings.fingerprint import fingerprint
from friction_hil.recordings.mcap_writer import McapWriter
from friction_hil.replay.verify import verify
from tests.loop_run import Drives
from tests.networks import model_file, random_network
from tests.servo_drives import PERIOD_S, TRUE_FRICTION, axis_dict, configuration, make_loop

MOTION = {"kind": "sine", "amplitude": 0.3, "frequency": 2.0, "ramp_s": 0.1}
LIMITS = {"torque": 0.3, "velocity": 30.0, "following_error": 0.5}
WARM = {"temperature": {"reference": 40.0, "coefficient": -0.004}}
STRIBECK = {
    "axis": "rotary",
    "friction": {
        "model": "stribeck",
        "parameters": {"coulomb": 0.05, "static": 0.07, "stribeck_velocity": 0.2},
        "modifiers": WARM,
    },
    "mechanics": {"inertia": 2e-4, "torque_lag_s": 5e-4},
    "thermal": {"capacity": 100.0, "resistance": 1.0},
}
GMS = {
    "axis": "rotary",
    "friction": {
        "model": "gms",
        "parameters": {
            "stiffness": [1500.0, 500.0],
            "weight": [0.6, 0.4],
            "attraction": 2.0,
            "coulomb": 0.09,
            "static": 0.13,
            "stribeck_velocity": 0.2,
        },
    },
    "mechanics": {"inertia": 2e-4},
}


def quick(**changes):
    """An axis whose limits have no slew: only the transition itself can keep the torque from stepping."""
    return axis_dict(**{"trajectory": MOTION, "compensation": {"fade_s": 0.05}, "limits": LIMITS} | changes)


class Changed:
    """A run with changes: ``plan`` is, by cycle, what is set (a dict) or asked of the run (an Action)."""

    def __init__(self, config, plan, *, until, folder=None, disturb=None, **loop):
        self.config, self.plan = config, dict(plan)
        self.journal = JournalReader(make_journal(room(len(config.axes))))
        self.writer = JournalWriter(self.journal.descriptor)
        self.present = self_contained(config)
        self.models_of = dict.fromkeys(config.axes, 0)
        self.entries, self.asked, self.answers = [], [], []
        self.stop = StopRequest()
        self.until = until
        self.drives = Drives(config, self.before, disturb=disturb)
        self.facts = self.drives.connect()
        self.loop, self.sink, self.axes = make_loop(config, self.drives, stop=self.stop, journal=self.journal, **loop)
        self.result = self.loop.run()
        self.rows = np.array(self.sink.rows)

    def before(self, drives):
        if len(self.answers) < len(self.asked) and (answer := self.writer.wait(self.asked[-1], 0.0)) is not None:
            self.answers.append(answer)
        if drives.cycle == self.until:
            self.stop.is_requested = True
        wanted = self.plan.get(drives.cycle)
        if wanted is None:
            return
        number = len(self.asked) + 1
        self.asked.append(number)
        if isinstance(wanted, Action):
            self.writer.post(number, pack(Change(number, wanted, [], f"user 7: {wanted.name.lower()}")))
            return
        prepared = prepare(self.present, "test", wanted, self.facts, {}, has_network=False)
        entry = entry_of(number, prepared, self.models_of, "user 7")
        self.entries.append((drives.cycle, entry))
        self.writer.post(number, pack(Change(number, Action.NONE, prepared.axes, f"user 7 set {len(wanted)}")))
        self.present = prepared.configuration
        self.models_of = {name: axis["model_of"] for name, axis in entry["axes"].items()}

    def write(self, path, entries=None, rows=None):
        """A recording as the companion writes it, read again."""
        metadata = {
            "configuration": self_contained(self.config),
            "facts": [asdict(fact) for fact in self.facts],
            "fingerprint": fingerprint(),
        }
        writer = McapWriter(
            path,
            list(self.config.axes),
            list(columns.NAMES),
            state_width=max(axis.state_width for axis in self.axes),
            metadata=metadata,
            overwrite=True,
        )
        for cycle, entry in self.entries if entries is None else entries:
            writer.write_event(cycle, "change", json.dumps(entry))
        writer.write(self.rows if rows is None else rows)
        writer.close()
        return recordings.read_all(path)

    def column(self, name, axis="x"):
        return np.array(self.sink.column(axis, name))

    def texts(self, name):
        return [text for _, kind, text in self.sink.events if kind == name]


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

    def warm(cycle, feedback):
        feedback[0].temperature = 60.0 if 500 < cycle < 900 else np.nan

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
    axes = {"x": quick(), "y": quick(node=2)}
    return Changed(configuration(**axes), plan, until=1700, disturb=warm)


def test_no_change_makes_the_loop_compile(changed):
    """The kernel runs for the record of any model: it was compiled before the loop began."""
    known = len(kernel.whole_step.signatures)
    axis = changed.axes[0]
    record = unpack(pack(Change(1, axes=[AxisChange(None, axis.compensator.record)])), [axis.compensator.record])
    axis.compensator.adopt(record.axes[0].record, None)
    axis.compensator.step(9999.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, True, False)
    assert len(kernel.whole_step.signatures) == known


def test_every_bit_is_reproduced_through_all_changes(changed, tmp_path):
    assert changed.result.faults == []
    assert [refusal for _, refusal in changed.answers] == [""] * 10
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
    with pytest.raises(RecordingError, match=r"change 3 of the settings, .* is not in the recording"):
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
    torque, velocity = changed.column("compensation"), changed.column("velocity_demand")
    before, after = (torque[(np.abs(velocity) > 1.0) & rows] for rows in _rows_of(changed))
    assert (np.sign(before[0]), np.sign(after[0])) == (1.0, -1.0)
    assert np.median(np.abs(after)) / np.median(np.abs(before)) == pytest.approx(0.7 / 0.9, rel=0.1)
    y = changed.column("compensation", "y")
    assert np.all(y[692:699] == 0.0)
    assert np.abs(y[640:690]).max() > 0.0
    # what adaptation had learned ends with it
    x = changed.axes[0].compensator
    assert np.all(x.record[0]["adaptation_s"] == 0.0)


def _rows_of(changed):
    """Rows before any change, and rows with the second one once its transition is over."""
    cycle = changed.column("cycle")
    return cycle < 260, (cycle > 355) & (cycle < 420)


def test_a_stop_takes_the_power_and_a_start_gives_it_back_from_where_the_axis_stands(changed):
    states = changed.texts("state")
    assert states == [
        *("enabling", "running", "stopping", "disabling", "waiting"),
        *("enabling", "running", "stopping", "disabling", "done"),
    ]
    state, drive = changed.column("state"), changed.column("drive_state")
    waiting = state == LoopState.WAITING
    assert waiting.sum() > 100
    assert set(drive[waiting][2:]) == {DriveState.SWITCH_ON_DISABLED}
    commands = changed.drives.commands[0]
    asked = [commands[int(k)].request for k in np.flatnonzero(waiting)]
    assert set(asked) == {Request.DISABLE}
    again = int(np.flatnonzero((state == LoopState.RUNNING) & (changed.column("cycle") > 1300))[0])
    position, demand = changed.column("position"), changed.column("position_demand")
    assert abs(demand[again] - position[again - 1]) < 1e-4
    assert changed.texts("notice") == [*changed.result.notices]
    assert "user 7: stop" in changed.result.notices


def test_all_values_of_a_message_are_applied_in_one_cycle(changed):
    (cycle,) = [cycle for cycle, entry in changed.entries if entry["number"] == 2]
    for name in ("x", "y"):
        assert changed.column("cycle", name)[changed.column("change", name) == 2.0].min() == cycle


def test_the_state_of_another_model_is_that_of_the_latest_motion(changed, models):
    from friction_hil.compensator import INPUTS

    part = changed.rows[200:255, : len(columns.NAMES) + changed.axes[0].state_width]
    inputs = {name: part[:, columns.NAMES.index(name)] for name in INPUTS}
    latest = {"x": (inputs, part[0, len(columns.NAMES) :])}
    present = self_contained(changed.config)
    cold, warm = (
        prepare(present, "test", {"x.model": models["gms"]}, changed.facts, rows, has_network=False).axes[0].friction
        for rows in ({}, latest)
    )
    assert not cold.any()
    assert np.abs(warm).max() > 1e-6


def test_a_model_of_the_same_family_begins_with_the_present_state(changed):
    """The latest cycles may be those of a rest, which say nothing of the state."""
    from friction_hil.compensator import INPUTS, STATE

    part = changed.rows[250:251, : len(columns.NAMES) + changed.axes[0].state_width]
    inputs = {name: part[:, columns.NAMES.index(name)] for name in INPUTS}
    state = part[0, len(columns.NAMES) :]
    present = self_contained(changed.config)
    model = copy.deepcopy(present["axes"]["x"]["model"])
    model["friction"]["parameters"]["coulomb"] *= 1.1
    latest = {"x": (inputs, state)}
    (change, _) = prepare(present, "test", {"x.model": model}, changed.facts, latest, has_network=False).axes
    first = STATE.fields["friction"][1] // 8
    assert abs(state[first]) > 1e-6
    np.testing.assert_allclose(change.friction[0], state[first], rtol=0.2)


def test_a_fault_of_a_daemon_that_waits_is_reset_by_somebody_before_a_start():
    def disturb(cycle, feedback):
        if cycle == 400:
            run_drives[0].states[0] = feedback[0].state = DriveState.FAULT

    run_drives = []

    class Kept(Changed):
        def before(self, drives):
            run_drives[:] = [drives]
            super().before(drives)

    plan = {200: Action.START, 600: Action.START, 650: Action.RESET, 700: Action.START}
    run = Kept(configuration(x=quick()), plan, until=1000, disturb=disturb, is_waiting=True)
    refusals = [refusal for _, refusal in run.answers]
    assert refusals == ["", "it has a fault: remove the cause and reset it first", "", ""]
    assert len(run.result.faults) == 1
    assert "the drive is in fault" in run.result.faults[0]
    assert run.texts("state") == [
        *("waiting", "enabling", "running", "fault_stopping", "disabling", "waiting"),
        *("enabling", "running", "stopping", "disabling", "done"),
    ]
    requests = [command.request for command in run.drives.commands[0]]
    # nothing is written to a drive before somebody starts it, and after the fault none is enabled before that
    assert set(requests[:200]) == {Request.LISTEN}
    assert Request.ENABLE not in requests[402:699]
    assert Request.RESET_FAULT in requests[650:652]
    assert Request.RESET_FAULT not in requests[:650]


def test_an_axis_whose_computation_failed_is_not_started_again():
    def disturb(cycle, feedback):
        if cycle == 400:
            feedback[0].velocity = "fast"

    plan = {200: Action.START, 600: Action.RESET, 700: Action.START}
    run = Changed(configuration(x=quick()), plan, until=900, disturb=disturb, is_waiting=True)
    assert [refusal for _, refusal in run.answers] == [
        *("", "", "x: its computation has failed: start the daemon again")
    ]
    assert Request.ENABLE not in [command.request for command in run.drives.commands[0]][402:]


def test_what_is_not_possible_now_is_refused_with_the_reason():
    plan = {100: Action.START, 300: Action.RESET, 400: Action.STOP, 405: Action.START}
    run = Changed(configuration(x=quick()), plan, until=700)
    assert [refusal for _, refusal in run.answers] == [
        "it is started already",
        "it has not stopped: faults are reset once it waits without power",
        "",
        "it is still stopping: start it when it has stopped",
    ]
    dry = Changed(configuration(x=quick()), {50: Action.START, 60: Action.STOP}, until=100, dry_run=True)
    assert [refusal for _, refusal in dry.answers] == ["a dry run enables nothing", "a dry run has enabled nothing"]


def test_a_stop_takes_the_power_of_a_drive_that_a_waiting_daemon_found_with_power():
    class Found(Changed):
        def before(self, drives):
            if drives.cycle == 0:
                drives.states[0] = DriveState.OPERATION_ENABLED  # an earlier daemon was killed
            super().before(drives)

    run = Found(configuration(x=quick()), {200: Action.STOP}, until=300, is_waiting=True)
    assert {command.request for command in run.drives.commands[0][:200]} == {Request.LISTEN}
    drive = run.column("drive_state")
    assert (drive[150], drive[250]) == (DriveState.OPERATION_ENABLED, DriveState.SWITCH_ON_DISABLED)
    assert run.result.drive_states == [DriveState.SWITCH_ON_DISABLED]


@pytest.mark.parametrize("is_wanted", [True, False])
def test_a_waiting_daemon_resets_the_fault_that_it_found_only_on_the_users_word(is_wanted):
    """`run --wait --reset-fault`: however late somebody starts the axes, and only once."""

    class Found(Changed):
        def before(self, drives):
            if drives.cycle in (0, 1900):
                drives.states[0] = DriveState.FAULT
            super().before(drives)

    plan = {1500: Action.START, 2200: Action.START}
    run = Found(configuration(x=quick()), plan, until=2300, is_waiting=True, is_fault_reset_wanted=is_wanted)
    requests = {cycle for cycle, command in enumerate(run.drives.commands[0]) if command.request is Request.RESET_FAULT}
    drive = run.column("drive_state")
    assert run.answers[-1][1] != ""
    if not is_wanted:
        assert "it has a fault" in run.answers[0][1]
        assert not requests
        return
    assert run.answers[0][1] == ""
    assert requests <= set(range(1500, 1510))
    assert np.all(drive[1550:1890] == DriveState.OPERATION_ENABLED)
    assert not np.any(drive[1910:] == DriveState.OPERATION_ENABLED)


def test_a_stop_before_the_last_start_proves_nothing_about_the_power_now():
    def breaks(cycle, feedback):
        if cycle == 400:
            raise DriveError("the line is gone")

    run = Changed(configuration(x=quick()), {200: Action.START}, until=900, disturb=breaks, is_waiting=True)
    assert run.column("drive_state")[-1] == DriveState.OPERATION_ENABLED
    assert run.result.drive_states == [DriveState.UNKNOWN]


def test_figures_are_those_of_the_last_motion_also_when_the_run_ends_while_it_waits():
    run = Changed(configuration(x=quick()), {3000: Action.STOP}, until=3600)
    figures = run.axes[0].following.errors.figures(Condition.WITH)
    assert figures is not None
    assert figures.counted >= 500


def test_garbage_in_the_journal_is_reported_once_and_changes_nothing():
    class Scribbled(Changed):
        def before(self, drives):
            if 100 <= drives.cycle < 900 and drives.cycle % 3 == 0:
                first, _ = loop_pages(self.journal.descriptor)
                os.pwrite(self.journal.descriptor, np.random.default_rng(drives.cycle).bytes(600), first)
            super().before(drives)

    quiet = Changed(configuration(x=quick()), {}, until=1000)
    run = Scribbled(configuration(x=quick()), {}, until=1000)
    assert len(run.result.warnings) == 1
    assert "the journal of the control socket held garbage, which was ignored" in run.result.warnings[0]
    np.testing.assert_array_equal(run.column("compensation"), quiet.column("compensation"))
    assert run.result.faults == []


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"x.gian": 0.8}, "x.gian: is not a key here; did you mean 'gain'?"),
        ({"z.gain": 0.8}, "z.gain: there is no axis 'z'; there are: x"),
        ({"x.gain": 3.0}, "x.gain: must be at least 0 and at most 1.5, not 3.0"),
        ({"x.gain": "high"}, "x.gain: must be a number, not the text 'high'"),
        ({"x.enabled": "off"}, "x.enabled: must be true or false, not the text 'off' .* write false"),
        ({"x.source": "measurd"}, "x.source: must be 'auto', 'measured' or 'demand', not the text 'measurd'"),
        ({"x.adaptation.time_s": 0.01}, "x.adaptation.time_s: must be at least 0.1"),
        ({"x.adaptation.time": 1.0}, "x.adaptation.time: is not a key here; did you mean 'time_s'?"),
        ({"x.gain.more": 1.0}, "x.gain.more|gain has no keys"),
        ({"x.velocity": "kalman"}, "x.velocity: cannot be changed while the daemon runs, because it would begin"),
        ({"x.transmission": None}, "x.transmission: .* because it would move the set-point"),
        ({"x.limits.torque": 1.0}, "x.limits.torque: cannot be changed while the daemon runs: change it in the config"),
        ({"x.model": "gone.yaml"}, "x.model: there is no model file"),
        ({"x.gian": 1.0, "x.limits": 1.0}, "(?s)x.gian: .*\n.*x.limits: "),
        ({"": 1.0}, "there is no axis ''"),
    ],
)
def test_values_are_refused_with_the_words_of_the_configuration(changed, values, message):
    config = configuration(x=quick())
    with pytest.raises(UsageError, match=message):
        prepare(self_contained(config), "test", values, changed.facts[:1], {}, has_network=False)


def test_a_network_is_refused_by_a_daemon_that_has_not_loaded_its_code(changed, tmp_path):
    path = tmp_path / "net.yaml"
    path.write_text(yaml.safe_dump(model_file(random_network())))
    config, values = self_contained(configuration(x=quick())), {"x.model": str(path)}
    with pytest.raises(UsageError, match=r"x\.model: has a network, whose code this daemon has not loaded"):
        prepare(config, "test", values, changed.facts[:1], {}, has_network=False)
    (change,) = prepare(config, "test", values, changed.facts[:1], {}, has_network=True).axes
    message = pack(Change(1, axes=[change]))
    present = [changed.axes[0].compensator.record]
    with pytest.raises(ValueError, match="have the wrong size"):
        unpack(message, present)


def test_models_that_cannot_take_the_place_of_the_present_one_are_refused(changed, tmp_path):
    linear = tmp_path / "linear.yaml"
    linear.write_text(json.dumps({"version": 1, **GMS, "axis": "linear"}))
    config = self_contained(configuration(x=quick()))
    with pytest.raises(UsageError, match=r"x.model: is for a linear axis, but x is rotary"):
        prepare(config, "test", {"x.model": str(linear)}, changed.facts[:1], {}, has_network=False)
    mechanics = {"inertia": 2e-4, "backlash": 1e-3, "load": {"inertia": 1e-4, "friction": 0.03}}
    with_gap = {
        "axis": "rotary",
        "friction": {"model": "lugre", "parameters": dict(TRUE_FRICTION)},
        "mechanics": mechanics,
    }
    offset = quick(model=with_gap, compensation={"fade_s": 0.05, "transmission": {"acceleration": 300.0}})
    other = tmp_path / "other.yaml"
    other.write_text(json.dumps({"version": 1, **with_gap}))
    config = self_contained(configuration(x=offset))
    with pytest.raises(UsageError, match=r"because compensation\.transmission is on"):
        prepare(config, "test", {"x.model": str(other)}, changed.facts[:1], {}, has_network=False)


def test_compensation_is_not_enabled_where_no_torque_gets_to_the_drive(changed):
    config = self_contained(configuration(x=quick(compensation={"enabled": False})))
    facts = [replace(changed.facts[0], takes_torque=False)]
    with pytest.raises(UsageError, match=r"x\.enabled: must be false, because this drive takes no torque .*mode cst "):
        prepare(config, "test", {"x.enabled": True}, facts, {}, has_network=False)
    (change,) = prepare(config, "test", {"x.enabled": False}, facts, {}, has_network=False).axes
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
    changed = Changed(configuration(x=x), plan, until=1000)
    assert changed.result.faults == []
    assert [refusal for _, refusal in changed.answers] == [""] * len(plan)
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
    with pytest.raises(ValueError, match="the feed-forward of gravity is"):
        unpack(pack(Change(1, axes=[AxisChange(static=whole._replace(**damage)), None])), records)


def test_the_error_without_compensation_is_told_when_compensation_begins_after_each_start():
    plan = {1500: Action.STOP, 1900: Action.START}
    with_baseline = {"fade_s": 0.05, "baseline_s": 1.3}
    axes = {
        "x": quick(compensation=with_baseline),
        "y": quick(node=2, compensation={**with_baseline, "enabled": False}),
        "z": quick(node=3),  # compensated from the start on
    }
    run = Changed(configuration(**axes), plan, until=3500)
    assert run.result.faults == []
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
