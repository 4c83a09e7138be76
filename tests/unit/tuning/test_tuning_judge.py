"""Trial of a model: how its runs are judged, motion by motion, which model is kept, what is shown and reported."""

import bisect
import copy
import math
import re
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from friction_hil.analysis.following import RECOVERY_S, SETTLE_S, Figures
from friction_hil.cli.work.tables import lines
from friction_hil.cli.work.tune import _motions_table, _table
from friction_hil.daemon.assembly import make_path
from friction_hil.daemon.notices import CompensationNotices
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import RecordingError
from friction_hil.identification.torque_lag import LagEstimate
from friction_hil.motion.trajectory import PathTime, Trajectory
from friction_hil.recordings import Recording
from friction_hil.recordings.recording import Event
from friction_hil.reports.tuning_report import write_reports
from friction_hil.tuning import AxisTuning, TriedModel, Tuning
from friction_hil.tuning.outcome import as_dict
from friction_hil.tuning.rehearsed import RehearsedFit
from friction_hil.tuning.sequential import ExperimentResult
from friction_hil.tuning.torque_lag import TorqueLag
from friction_hil.tuning.trial import MotionTrial, Trial, judge
from friction_hil.tuning.trial_motions import MOTIONS, windows
from tests.servo_drives import PERIOD_S
from tests.unit.tuning.test_tuning import COUNT, axis
from tests.unit.tuning.test_tuning_trial import tried

FADE_S, RAMP_S, DELAY_S, FREQUENCY = 0.1, 0.25, 3e-3, 1.0
OWN = {"kind": "sine", "amplitude": 0.5, "frequency": FREQUENCY, "ramp_s": RAMP_S}
BOUNDS = {"velocity": 5.0, "travel": 0.8, "duration_s": 20.0, "ramp_s": RAMP_S}


_, RUN, DURATION_S = tried(x=axis(trajectory=OWN, experiment=BOUNDS, compensation={"fade_s": FADE_S}))
SEQUENCE = RUN.axes["x"].trajectory
NAMES = tuple(part.name for part in SEQUENCE.motions)
STARTS = np.cumsum([0.0, *(part.duration_s for part in SEQUENCE.motions[:-1])]).tolist()
FIRST_CYCLE = 50.0


@cache
def course():
    """Cycles, and the demand and the time of the path in each."""
    cycle = np.arange(0.0, FIRST_CYCLE + round(DURATION_S / PERIOD_S))
    path_time = PathTime(RAMP_S)
    motion = Trajectory(make_path(RUN.axes["x"], COUNT, PERIOD_S), path_time)
    motion.begin_at(1.0)
    path_time.start(FIRST_CYCLE * PERIOD_S + DELAY_S)
    times = (cycle * PERIOD_S).tolist()
    return cycle, np.array([motion.at(t).position for t in times]), [path_time.at(t)[0] for t in times]


def recorded(errors, *, events=()):
    """A run with this error, by motion, at whatever time the path is sent ahead; wild before the own motion counts.

    ``errors`` maps names of motions to functions of the path's time; others have an error of 1e-3.
    """
    cycle, demand, path_s = course()
    begin, end = windows(SEQUENCE, FADE_S)["own"]

    def error_at(s):
        is_wild = s < begin - 1e-9 or end <= s < SEQUENCE.motions[0].moving_s
        name = NAMES[max(bisect.bisect_right(STARTS, s) - 1, 0)]  # a pause belongs to the motion before it
        return 9.0 if is_wild else errors.get(name, lambda _: 1e-3)(s)

    columns = {name: np.ones(len(cycle)) for name in ("is_fresh", "is_enabled")}
    columns |= {"time_s": cycle * PERIOD_S, "cycle": cycle.copy(), "path_lag_s": np.zeros(len(cycle))}
    columns |= {"position": demand - [error_at(s) for s in path_s], "position_demand": demand.copy()}
    columns["state"] = np.where(cycle < FIRST_CYCLE, float(LoopState.ENABLING), float(LoopState.RUNNING))
    facts = [{"name": "x", "position_resolution": COUNT, "setpoint_delay_s": DELAY_S}]
    found = [Event(float(np.searchsorted(path_s, s)), name, text) for s, name, text in events]
    return Recording("trial.mcap", "x", columns, {"facts": facts}, events=found)


def wave(amplitude):
    return lambda s: amplitude * math.sin(2.0 * math.pi * FREQUENCY * s)


def judged(without, compensated):
    return judge(without, compensated, RUN.axes["x"], PERIOD_S, FADE_S)


@pytest.fixture(scope="module")
def without():
    return recorded({"own": wave(4e-3), "slow": lambda _: 3e-3})


def start_of(name):
    return sum(part.duration_s for part in SEQUENCE.motions[: NAMES.index(name)])


def test_each_motion_is_judged_by_its_own_error(without) -> None:
    """Of the own motion whole periods of settled motion; of the others all, from start to rest."""
    trial = judged(without, recorded({"own": wave(1e-3), "slow": lambda _: 2e-3, "tiny": lambda _: 5e-4}))
    found = {each.name: each for each in trial.motions}
    assert tuple(found) == NAMES == MOTIONS
    assert trial.own is found["own"]
    assert found["own"].uncompensated.rms == pytest.approx(4e-3 / math.sqrt(2.0), rel=1e-6)
    assert found["own"].uncompensated.peak == pytest.approx(4e-3, rel=1e-4)
    assert (trial.reduction.rms, trial.reduction.peak) == pytest.approx((4.0, 4.0), rel=1e-6)
    expected = {"slow": 1.5, "small": 1.0, "tiny": 2.0, "rests": 1.0, "fast": 1.0}
    for name, ratio in expected.items():
        assert (found[name].reduction.rms, found[name].reduction.peak) == pytest.approx((ratio, ratio), rel=1e-6)
    assert trial.has_helped
    assert (trial.worse, trial.swinging, trial.problems) == ((), (), ())
    for error, amplitude in zip(trial.own.errors, (4e-3, 1e-3), strict=True):
        assert np.nanmax(np.abs(error)) == pytest.approx(amplitude, rel=1e-4)
        assert np.isfinite(error).all()
    assert trial.own.errors[0] == pytest.approx(4.0 * trial.own.errors[1], abs=1e-9), "both over the same demand"


def test_the_own_motion_counts_once_it_is_steady_and_compensated() -> None:
    begin, end = windows(SEQUENCE, FADE_S)["own"]
    assert begin >= max(RAMP_S, FADE_S) + SETTLE_S - 1e-9
    assert end - begin == pytest.approx(round((end - begin) * FREQUENCY) / FREQUENCY)
    assert end - begin >= 4.0 - 1e-9
    assert end <= SEQUENCE.motions[0].moving_s - RAMP_S + 1e-9


@pytest.mark.parametrize(
    ("error", "is_help"),
    [
        (wave(4.4e-3), False),
        (wave(3.9e-3), False),
        (wave(3.6e-3), True),
        (lambda s: 2e-3 - 6.4e-3 * (s % 1.0 < 0.01), False),
    ],
    ids=["worse", "hardly better", "better", "a higher peak"],
)
def test_worse_or_hardly_better_is_no_help(error, is_help, without):
    assert judged(without, recorded({"own": error})).has_helped == is_help


@pytest.mark.parametrize("name", [name for name in MOTIONS if name != "own"])
def test_a_motion_that_gets_worse_is_named(name, without) -> None:
    trial = judged(without, recorded({"own": wave(1e-3), name: lambda _: 3.3e-3 if name == "slow" else 1.1e-3}))
    assert trial.worse == (name,)
    assert trial.has_helped, "the own motion is what the axis is for"
    [problem] = trial.problems
    assert f"the motion {name!r} is larger" in problem
    assert trial.figures["motions"][name]["is_worse"]


@pytest.mark.parametrize(("rms", "peak", "is_worse"), [(1.2, 3.0, False), (1.5, 3.0, True), (1.0, 4.0, True)])
def test_one_count_of_the_encoder_is_no_harm(rms, peak, is_worse):
    after = Figures(rms * COUNT, peak * COUNT)
    assert motion_trial("tiny", Figures(1.0 * COUNT, 2.0 * COUNT), after).is_worse == is_worse


def lowered(name="x"):
    """The daemon's own warning."""
    guarded = partial(SimpleNamespace, trained_speed=math.inf, has_residual=False)
    return CompensationNotices(name, "rad", guarded(gain_factor=1.0)).next(guarded(gain_factor=0.8), 0.0)


@pytest.mark.deep
@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("into_s", [0.02, 1.0])
def test_an_oscillation_is_attributed_to_its_motion(name, into_s, without) -> None:
    at_s = start_of(name) + into_s
    others = [(at_s + 0.1, "warning", lowered("y")), (0.5, "warning", "x: faster than the network was trained for")]
    trial = judged(without, recorded({"own": wave(1e-3)}, events=[(at_s, "warning", lowered()), *others]))
    assert trial.swinging == (name,)
    assert trial.has_helped == (name != "own"), "it would oscillate in the motion that the axis is for"
    assert trial.problems[0].startswith(f"the axis oscillates by its compensation in the motion {name!r}")
    assert [each["is_swinging"] for each in trial.figures["motions"].values()] == [each == name for each in NAMES]


def test_an_oscillation_in_a_pause_belongs_to_the_motion_before(without):
    at_s = start_of("tiny") + SEQUENCE.motions[NAMES.index("tiny")].duration_s - 0.1
    assert judged(without, recorded({}, events=[(at_s, "warning", lowered())])).swinging == ("tiny",)


def test_all_motions_with_harm_are_named_in_one_sentence(without) -> None:
    events = [(start_of(name) + 1.0, "warning", lowered()) for name in ("slow", "tiny", "tiny")]
    errors = {"own": wave(1e-3), "rests": lambda _: 2e-3, "fast": lambda _: 2e-3}
    trial = judged(without, recorded(errors, events=events))
    swinging, worse = trial.problems
    assert "oscillates by its compensation in the motions 'slow', 'tiny'" in swinging
    assert "the motions 'rests', 'fast' is larger" in worse


def test_where_the_computer_was_late_nothing_counts(without) -> None:
    whole = recorded({"own": wave(1e-3)})
    late = copy.deepcopy(whole)
    row = 50 + round((windows(SEQUENCE, FADE_S)["own"][0] + 1.5 + 0.5 * RAMP_S) / PERIOD_S)
    late.columns["position"][row : row + 4] += 7.0
    late.columns["is_fresh"][row : row + 4] = 0.0
    missing = np.delete(np.arange(len(whole)), slice(row, row + 40))
    after = slice(row, row + round(RECOVERY_S / PERIOD_S))
    gap = replace(whole, columns={name: values[missing] for name, values in whole.columns.items()})
    gap.columns["position"][after] += 7.0
    for damaged in (late, gap):
        assert judged(without, damaged).own.compensated.peak == pytest.approx(1e-3, rel=1e-3)


def test_after_missed_periods_the_motions_are_found_by_the_time_of_the_path(without) -> None:
    """The path was held up by 0.2 s before the slow motion, so that all of it comes later."""
    whole = recorded({"own": wave(1e-3), "slow": lambda _: 3e-3})
    row = 50 + round((start_of("slow") + 0.5 * RAMP_S + DELAY_S - 0.1) / PERIOD_S)
    held = round(0.2 / PERIOD_S)
    columns = {name: np.insert(values, row, np.full(held, values[row])) for name, values in whole.columns.items()}
    columns["cycle"] = np.arange(float(len(columns["cycle"])))
    columns["time_s"] = columns["cycle"] * PERIOD_S
    columns["path_lag_s"][row + held :] = held * PERIOD_S
    columns["path_lag_s"][row : row + held] = PERIOD_S * np.arange(1, held + 1)
    trial = judged(without, replace(whole, columns=columns))
    ratios = {each.name: each.reduction.rms for each in trial.motions}
    assert ratios == pytest.approx({**dict.fromkeys(NAMES, 1.0), "own": 4.0}, rel=1e-6)


def test_a_run_that_is_too_short_or_was_mostly_missed_is_refused(without) -> None:
    whole = recorded({})
    short = replace(whole, columns={name: values[:-2500] for name, values in whole.columns.items()})
    with pytest.raises(RecordingError, match="x: the run ended"):
        judged(without, short)
    late = copy.deepcopy(whole)
    late.columns["is_fresh"][-5000::7] = 0.0
    with pytest.raises(RecordingError, match="periods of the laps"):
        judged(without, late)


def test_an_error_below_the_resolution_is_no_division_by_zero() -> None:
    none = Figures(0.0, 0.0)
    perfect = motion_trial("own", Figures(1e-3, 2e-3), none)
    assert Trial((perfect,)).reduction == Figures(math.inf, math.inf)
    assert Trial((perfect, motion_trial("slow", none, none))).has_helped
    assert not Trial((motion_trial("own", none, none),)).has_helped


def motion_trial(name, before, after, *, swings=False):
    return MotionTrial(name, before, after, swings, COUNT, np.zeros(0), (np.zeros(0), np.zeros(0)))


def model_with(own, slow=(1.0, 2.0), *, swings=False):
    """Tried model with these figures with compensation; without they are 10 and 20, slow 2 and 4."""
    own = motion_trial("own", Figures(10.0, 20.0), Figures(*own))
    slow = motion_trial("slow", Figures(2.0, 4.0), Figures(*slow), swings=swings)
    return TriedModel(None, None, {}, Trial((own, slow)))


GOOD, USELESS, SPIKY = model_with((5.0, 10.0)), model_with((10.0, 20.0)), model_with((1.0, 21.0))
SWINGING, HARMFUL = model_with((0.1, 0.2), swings=True), model_with((0.1, 0.2), slow=(2.5, 4.0))
EVEN = model_with((1.0, 2.0), slow=(1.0, 2.0))


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        pytest.param(GOOD, SPIKY, id="a higher peak than without any is no help, however small RMS times peak"),
        pytest.param(GOOD, SWINGING, id="swings, however small its error in the own motion"),
        pytest.param(GOOD, HARMFUL, id="harms another motion"),
        pytest.param(HARMFUL, SWINGING, id="harm is less than swinging"),
        pytest.param(SWINGING, USELESS, id="it does help in the own motion"),
        pytest.param(model_with((1.0, 2.0), slow=(0.5, 1.0)), EVEN, id="better in another motion"),
        pytest.param(model_with((1.2, 2.4), slow=(0.7, 1.4)), EVEN, id="more in the others than worse in the own"),
        pytest.param(EVEN, model_with((1.2, 2.4), slow=(0.9, 1.8)), id="less in the others than worse in the own"),
    ],
)
def test_of_two_models_the_better_one_is_kept(better, worse):
    for models in ((better, worse), (worse, better)):
        assert AxisTuning(models, Path(), False).best is better
    assert AxisTuning((worse,), Path(), False).best is worse


def tuning_of(*models):
    """A tuning of an axis by these models: each has its slow motion in the place of all but its own."""
    found = SimpleNamespace(settings=SimpleNamespace(axis="rotary"), reason="simplest")
    content = {"friction": {"parameters": {"coulomb": 0.1}}, "mechanics": {"inertia": 2e-4}}
    candidates = []
    for label, model in models:
        own, slow = model.trial.motions
        fit = SimpleNamespace(label=label, flags=[], friction=[{"coulomb": 0.08}])
        trial = Trial((own, *(replace(slow, name=name) for name in MOTIONS[1:])))
        candidates.append(replace(model, identification=found, fit=fit, model=content, trial=trial))
    return Tuning(axes={"spindle": AxisTuning(tuple(candidates), Path("out/spindle.yaml"), False)})


def test_the_tables_show_each_motion_within_80_columns() -> None:
    tuning = tuning_of(
        ("elasto_plastic + direction + ripple + load", model_with((0.4, 2.0), slow=(0.02, 0.2))),
        ("stribeck", model_with((10.0, 20.0), slow=(20.0, 40.0), swings=True)),
    )
    terminal = Console(width=80)
    shown = list(lines(_motions_table(tuning), terminal))
    assert max(map(len, shown)) <= 80
    assert shown[1].split() == ["axis", "model", "lower", *MOTIONS], "side by side"
    numbers = [re.findall(r"(?<=rms).*|(?<=peak).*", line) for line in shown]
    assert [each[0].split() for each in numbers if each] == [
        ["25", *["100"] * 5],
        ["10", *["20"] * 5],
        ["1.0", *["0.10"] * 5],
        ["1.0", *["0.10"] * 5],
    ]
    assert "(kept)" in " ".join(shown)


def test_json_has_the_own_motion_as_before_and_each_motion() -> None:
    tuning = tuning_of(("lugre", model_with((1.0, 2.0))), ("stribeck", model_with((9.0, 9.0), swings=True)))
    axis_result = as_dict(tuning)["axes"]["spindle"]
    assert axis_result["model"] == "lugre"
    first, second = axis_result["tried"]
    assert first["uncompensated"] == {"rms": 10.0, "peak": 20.0}
    assert first["compensated"] == {"rms": 1.0, "peak": 2.0}
    assert first["reduction"] == {"rms": 10.0, "peak": 10.0}
    assert (first["has_helped"], second["has_helped"]) == (True, True)
    assert tuple(first["motions"]) == tuple(second["motions"]) == MOTIONS
    assert first["motions"]["own"]["reduction"] == first["reduction"]
    assert first["motions"]["tiny"]["compensated"] == {"rms": 1.0, "peak": 2.0}
    assert [second["motions"][name]["is_swinging"] for name in MOTIONS] == [False, *[True] * 5]


def test_a_fit_in_closed_loop_has_a_name_of_its_own() -> None:
    names = ["lugre", "lugre in closed loop"]
    tuning = tuning_of((names[0], model_with((2.0, 2.0))), (names[1], model_with((1.0, 2.0))))
    shown = " ".join(" ".join(lines(_table(tuning), Console(width=120))).split())
    assert "lugre rms" in shown
    assert f"{names[1]} (kept)" in shown
    assert [each["model"] for each in as_dict(tuning)["axes"]["spindle"]["tried"]] == names


ESTIMATE = LagEstimate(3e-4, 1e-5, 3.2e-4, 3e-3, 1.0)
LAG = TorqueLag(3e-4, 0.0, ESTIMATE, is_determined=True, reason="")


def written(folder, change, **options):
    """The page on a tuning that was changed before; without the report of the trial itself."""
    pytest.importorskip("matplotlib", reason="the extra 'report' is not installed")
    tuning = tuning_of(("lugre", model_with((1.0, 2.0))))
    change(tuning)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("friction_hil.reports.tuning_report.write_report", lambda *_: None)
        return write_reports(folder, tuning, **options).read_text()


def cells(page):
    """Rows of the table on the rehearsal, as text."""
    [table] = [each for each in re.findall(r"<table>.*?</table>", page, re.S) if "in simulation" in each]
    return [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>(.*?)</tr>", table)]


def test_the_report_has_the_kept_model_its_rehearsal_its_lag_and_its_experiment(tmp_path):
    """The page on a tuning in which everything was done."""

    def change(tuning):
        [tried] = tuning.axes["spindle"].candidates
        other = SimpleNamespace(label="stribeck <1>")
        tuning.rehearsed["spindle"] = (
            RehearsedFit(tried.identification, tried.fit, {"own": (8.0, 8.0), "slow": (2.0, 2.0)}, ()),
            RehearsedFit(tried.identification, other, {"own": (4.0, 4.0), "slow": (0.5, 0.5)}, ("slow",)),
        )
        tuning.torque_lags["spindle"] = LAG
        tuning.experiments["spindle"] = ExperimentResult((15.0, 15.0), 30.0, None, "the axis <stood>")

    page = written(tmp_path, change)
    overview, _, details = page.partition("<h2>")
    assert "<h1>Friction identified on the machine</h1>" in overview
    assert [word for word in ("spindle", "lugre", "times lower") if word not in overview] == []
    assert '<th scope="row">coulomb</th><td class="">0.1</td>' in details
    header, first, second = cells(page)
    assert header == ["in simulation", "times lower", "own", "slow", ""]
    assert first[:4] == ["lugre", "4.0", "8.0", "<strong>2.0</strong>"]
    assert second[:4] == ["stribeck &lt;1&gt;", "1.4", "4.0", "<strong>0.50</strong>"]
    assert (first[4], second[4][-6:]) == ("tried on the machine", ": slow")
    assert "<p>Torque lag 0.3 ms (standard error 0.01 ms), identified" in page
    assert "<p>The experiment took 30 s in 2 parts" in page
    assert ": the axis &lt;stood&gt;.</p>" in page


def test_the_report_of_a_simulation_says_that_it_was_one_and_what_was_not_done(tmp_path):
    def change(tuning):
        tuning.torque_lags["spindle"] = replace(LAG, value_s=0.0, is_determined=False, reason="the axis <stood>")

    page = written(tmp_path, change, is_simulated=True)
    assert "<h1>Friction identified in a simulation</h1>" in page
    assert "machine</h1>" not in page
    assert "not rehearsed" in page
    assert "in simulation</th>" not in page
    assert "<p>Torque lag not determined: the axis &lt;stood&gt;; 0 ms" in page
