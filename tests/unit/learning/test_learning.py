"""Learning of an axis's parameters: estimate, judgement, and what is handed over and taken back."""

import copy
import math
from pathlib import Path

import numpy as np
import pytest

from friction_hil.learning import states
from friction_hil.learning.coordinates import value_of, with_values
from friction_hil.learning.estimate import Mechanics, first_belief
from friction_hil.learning.motions import Used
from friction_hil.learning.proposal import Step, Trial
from friction_hil.learning.proven import Proven, recall, store
from friction_hil.learning.record import Record
from friction_hil.learning.states import TRANSITIONS, Event, State
from friction_hil.learning.thresholds import TICK_S, WINDOW_TICKS
from tests.compensators import INERTIA, LUGRE, PERIOD_S, quantised
from tests.learning_records import COUNT, WRONG, Driven, levels, record


@pytest.fixture(scope="module")
def stages():
    """A learner at two moments, to be copied: as `first` and as `tried`."""
    driven = Driven().take(WINDOW_TICKS + 2, until=Step.PARAMETERS, error=1e-3)
    assert [proposal.step for _, proposal in driven.proposals] == [Step.PARAMETERS]
    first = copy.deepcopy(driven)
    driven.take(8, until=Step.PARAMETERS, error=8e-4)
    assert [proposal.step for _, proposal in driven.proposals] == 2 * [Step.PARAMETERS]
    return first, driven


@pytest.fixture
def first(stages):
    """A learner that has just handed over the first part of a change; the error was 1 mrad before."""
    return copy.deepcopy(stages[0])


@pytest.fixture
def tried(stages):
    """A learner that has just handed over its first parameters."""
    return copy.deepcopy(stages[1])


def test_a_wrong_model_is_replaced_after_a_window_of_motion_at_first_by_a_third(tried):
    (when, part), (_, whole) = tried.proposals
    assert when == WINDOW_TICKS
    assert value_of(whole.model, "coulomb") == pytest.approx(0.08, rel=0.02)
    logs = [math.log(value_of(each.model, "coulomb") / value_of(WRONG, "coulomb")) for each in (part, whole)]
    assert logs[0] == pytest.approx(logs[1] / 3.0)
    assert whole.gain - 0.9 == pytest.approx(3.0 * (part.gain - 0.9))
    assert 0.9 < whole.gain <= 1.0


def test_a_change_of_which_a_third_is_no_help_is_taken_back_before_the_whole(first):
    first.take(8, error=1.02e-3)
    assert [proposal.step for _, proposal in first.proposals] == [Step.PARAMETERS, Step.BACK]
    assert "a third" in first.proposals[-1][1].text
    at = first.ticks  # friction that has changed since then is no reason to wait
    first.take(4 * WINDOW_TICKS, until=Step.PARAMETERS, error=1e-3, true=levels(1.1))
    assert 1 <= (first.ticks - at) / WINDOW_TICKS < 2


@pytest.mark.parametrize(
    ("true", "shaking", "expected"), [(LUGRE, 0.01, 1.0), (levels(1.02), 0.0, 1.2), (levels(0.98), 0.0, 0.8)]
)
def test_only_what_is_in_proportion_to_the_friction_counts_as_drift(true, shaking, expected):
    """With a trial an axis may shake, which leaves more torque unexplained: the former error would be what it was."""
    belief, kept = first_belief(LUGRE, Mechanics(INERTIA), {}), Record(PERIOD_S, COUNT)
    former = Used(belief.x, 0.9, belief.coordinates)

    def taken(begin_s, **given):
        for k in range(WINDOW_TICKS + 4):
            rows = record(TICK_S, begin_s=begin_s + k * TICK_S, error=2e-5, **given)
            rows["torque"] += (begin_s > 0.0) * shaking * np.sin(math.tau * 40.0 * rows["cycle"] * PERIOD_S)
            kept.ticks.append(rows)

    taken(0.0)
    trial = Trial(Step.PARAMETERS, former, kept.work(WINDOW_TICKS), former, kept.left(belief, former)[0])
    taken(8.0, true=true)
    assert kept.expected(belief, trial).rms == pytest.approx(expected * trial.before.rms, rel=0.07)


def test_rows_from_before_a_change_say_nothing_about_it(first):
    """A busy computer hands over late: the change is judged from then on."""
    first.take(20, is_in_force=False, error=1.02e-3)
    for ticks, count in ((0, 1), (5, 1), (3, 2)):
        first.take(ticks, error=8e-4)
        assert [proposal.step for _, proposal in first.proposals] == count * [Step.PARAMETERS]


@pytest.mark.deep
def test_a_computer_that_is_too_busy_for_an_estimate_judges_what_is_tried_all_the_same(tried):
    tried.take(WINDOW_TICKS + 6, may_estimate=False, error=3e-4)
    figures = tried.learner.figures
    assert (figures.re_identified, figures.taken_back) == (1, 0)
    estimated = figures.relative_errors
    tried.take(2 * WINDOW_TICKS, may_estimate=False, error=3e-4, true=levels(1.1))
    assert figures.relative_errors is estimated
    assert len(tried.proposals) == 2
    tried.take(1, error=3e-4, true=levels(1.1))
    assert tried.learner.figures.relative_errors is not estimated


def disturbed(rows):
    """A period was missed: until the axis has recovered, its error is large."""
    rows["is_disturbed"][100:140] = 1.0
    rows["position"][100:140] -= 5e-3 * np.hanning(40)


def test_errors_of_missed_periods_neither_stop_learning_nor_count_against_a_change():
    driven = Driven().take(WINDOW_TICKS + 2, until=Step.PARAMETERS, error=1e-3)
    driven.take(8, until=Step.PARAMETERS, change=disturbed, error=8e-4)
    driven.take(WINDOW_TICKS + 6, change=disturbed, error=3e-4)
    figures = driven.learner.figures
    assert (figures.re_identified, figures.taken_back, figures.stopped) == (1, 0, 0)
    assert figures.error_after == pytest.approx(3e-4 / math.sqrt(2.0), rel=0.05)


def test_what_does_not_help_is_taken_back(tried):
    tried.take(WINDOW_TICKS + 6, error=1e-3)
    _, back = tried.proposals[-1]
    assert (back.step, back.gain) == (Step.BACK, 0.9)
    np.testing.assert_array_equal(back.model.values, WRONG.values)
    assert (tried.learner.figures.re_identified, tried.learner.figures.taken_back) == (0, 1)


@pytest.mark.parametrize(
    ("given", "ticks", "after_s", "taken_back"),
    [
        pytest.param({"error": 3e-3}, 8, (0.0, 1.0), 1, id="a large error"),
        pytest.param({"error": 1.4e-3}, 12, (1.0, 1.5), 1, id="less than half a second may have"),
        pytest.param(
            {"error": 1e-4, "change": lambda rows: rows["gain_factor"][100:].fill(0.8)},
            1,
            (0.0, 0.25),
            1,
            id="a limit cycle",
        ),
        pytest.param({"error": 3e-4, "amplitude": 0.02}, WINDOW_TICKS, (0.0, 0.5), 0, id="another motion"),
    ],
)
def test_what_harms_is_taken_back_in_time(tried, given, ticks, after_s, taken_back):
    at = tried.ticks
    tried.take(ticks, until=Step.BACK, **given)
    assert tried.proposals[-1][1].step is Step.BACK
    assert after_s[0] < (tried.ticks - at) * TICK_S <= after_s[1]
    assert (tried.learner.figures.re_identified, tried.learner.figures.taken_back) == (0, taken_back)


@pytest.mark.parametrize(("true", "is_kept"), [(LUGRE, True), (WRONG, False)])
def test_a_gain_that_may_be_chance_is_kept_if_the_torque_since_then_is_explained_better(true, is_kept):
    driven = Driven()
    for second in range(40):
        error = 1e-3 * (1.0 + 0.6 * (-1.0) ** (second // 2)) * (1.0 if driven.proposals == [] else 0.93)
        is_tried = len(driven.proposals) == 2
        driven.take(4, error=error, true=true if is_tried else LUGRE)
        if driven.learner.figures.re_identified or driven.learner.figures.taken_back:
            break
    assert (driven.learner.figures.re_identified, driven.learner.figures.taken_back) == (is_kept, not is_kept)
    assert is_kept or "without the change" in driven.proposals[-1][1].text


def test_what_helps_is_kept_and_where_friction_falls_the_gain_leaves_room_until_the_next_change(tried):
    tried.take(WINDOW_TICKS + 6, error=3e-4)
    figures = tried.learner.figures
    assert (figures.re_identified, figures.taken_back) == (1, 0)
    errors = np.array([1e-3, 3e-4]) / math.sqrt(2.0)
    assert [figures.error_before, figures.error_after] == pytest.approx(errors, rel=0.05)
    gain = tried.proposals[-1][1].gain
    tried.take(2 * WINDOW_TICKS, until=Step.PARAMETERS, error=3e-4, true=levels(0.93))
    tried.take(8, until=Step.PARAMETERS, error=2e-4, true=levels(0.93))
    whole = tried.proposals[-1][1]
    assert value_of(whole.model, "coulomb") < 0.97 * 0.08
    assert 0.9 <= whole.gain < gain - 0.02


@pytest.mark.deep
@pytest.mark.parametrize(("error", "windows"), [(1e-3, 2), (1.3e-3, 1)])
def test_the_next_trial_waits_unless_the_error_grows_meanwhile(first, error, windows):
    first.take(8, until=Step.BACK, error=1.02e-3)
    at = first.ticks
    first.take(4 * WINDOW_TICKS, until=Step.PARAMETERS, error=error)
    assert windows <= (first.ticks - at) / WINDOW_TICKS < windows + 1


def test_another_motion_has_the_model_file_and_one_that_comes_back_what_was_kept_for_it(tried):
    tried.take(WINDOW_TICKS + 6, error=3e-4)
    kept = tried.proposals[-1][1].model
    for ticks, amplitude, values, most_s in ((4, 0.02, WRONG.values, 0.5), (6, 0.2, kept.values, 1.5)):
        at = tried.ticks
        tried.take(ticks, error=3e-4, amplitude=amplitude)
        when, proposal = tried.proposals[-1]
        assert (proposal.step is Step.BACK, (when - at) * TICK_S <= most_s) == (amplitude == 0.02, True)
        assert amplitude == 0.2 or proposal.gain == 0.9
        np.testing.assert_array_equal(proposal.model.values, values)


@pytest.mark.parametrize(
    ("model", "gain", "ticks", "given"),
    [
        (WRONG, 0.9, 3 * WINDOW_TICKS, {"amplitude": 0.0, "error": 1e-3}),
        (WRONG, 0.9, 3 * WINDOW_TICKS, {"error": 0.5 * COUNT}),
        (LUGRE, 1.0, 4 * WINDOW_TICKS, {"error": 2.0 * COUNT}),
    ],
    ids=["at rest", "an error below the counts of the encoder", "the true model"],
)
def test_nothing_is_tried_where_nothing_is_to_be_learned(model, gain, ticks, given):
    driven = Driven(model, gain=gain).take(ticks, **given)
    assert driven.proposals == []
    assert driven.learner.figures.relative_errors is None or given.get("amplitude") != 0.0, "rest teaches nothing"


def test_a_truer_model_that_leaves_more_of_the_friction_with_its_gain_is_not_tried():
    high = with_values(LUGRE, {name: LUGRE.given[name] / 0.9 for name in ("coulomb", "static", "sigma0", "sigma2")})
    driven = Driven(high, is_gain_fixed=True).take(3 * WINDOW_TICKS, error=1e-3)
    assert driven.learner.belief.parameters["coulomb"] == pytest.approx(LUGRE.given["coulomb"], rel=0.02)
    assert driven.proposals == []


@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_white_noise_of_the_torque_hides_neither_a_wrong_level_nor_how_well_the_torque_is_known(factor):
    random = np.random.default_rng(1)

    def noisy(rows):  # more than a third of the level, and an offset
        rows["torque"] += 0.02 + 0.03 * random.standard_normal(rows["torque"].size)

    learner = Driven(levels(factor)).take(WINDOW_TICKS, change=noisy, error=2e-4).learner
    assert learner.doing[0] == "trying"
    parameters, gain = learner.wanted
    assert parameters["coulomb"] == pytest.approx(LUGRE.given["coulomb"], rel=0.02)
    assert gain > 0.92


def test_a_record_that_contradicts_what_is_known_outweighs_it():
    driven = Driven(has_layer=False).take(4 * WINDOW_TICKS, inertia=0.7 * INERTIA, error=1e-3)
    driven.take(WINDOW_TICKS + 1, amplitude=3.0, frequency=1.0, error=1e-3)
    found = driven.learner.belief.parameters
    for name in ("sigma2", "coulomb"):
        assert found[name] == pytest.approx(LUGRE.given[name], rel=0.03)


@pytest.mark.parametrize(
    ("column", "rows", "change", "words"),
    [
        ("torque", slice(None), lambda _: 0.05, "torque"),
        ("position", slice(100, None), lambda values: values + 0.01, "jumps"),
        ("torque", slice(5, 6), lambda _: math.nan, "gaps"),
    ],
    ids=["frozen", "slipped", "holed"],
)
def test_a_record_that_is_not_that_of_the_axis_ends_learning_within_a_second(tried, column, rows, change, words):
    def spoil(record):
        record[column][rows] = change(record[column][rows])

    at = tried.ticks
    tried.take(4, until=Step.BACK, change=spoil, error=1e-3)
    assert any(note.startswith("learning stops") and words in note for note in tried.notes)
    assert (tried.ticks - at) * TICK_S <= 1.0
    assert tried.proposals[-1][1].step is Step.BACK
    assert tried.learner.figures.stopped == 1


@pytest.mark.parametrize("error", [6e-3, 2e-4])
def test_an_error_that_changes_without_a_reason_ends_learning_within_a_second(error):
    driven = Driven(LUGRE, gain=1.0).take(40, error=1e-3).take(4, error=error)
    assert driven.proposals == []
    assert any("following error" in note for note in driven.notes)


def test_an_error_that_another_demand_explains_ends_nothing():
    driven = Driven(LUGRE, gain=1.0)
    for tick in range(60):  # a long stroke at constant speed, a short and hard one from time to time
        t = (tick * 250 + np.arange(250)) * PERIOD_S
        is_stroke = tick % 20 > 16
        velocity = 0.05 + (0.5 * np.sin(math.tau * 4.0 * t) if is_stroke else 0.0 * t)
        rows = record(TICK_S, begin_s=tick * TICK_S)
        demand = np.cumsum(velocity) * PERIOD_S
        error = (1e-3 if is_stroke else 5e-5) * np.sin(math.tau * 4.0 * t)
        rows |= {"velocity_demand": velocity, "position_demand": demand, "position": quantised(demand - error, COUNT)}
        driven.learner.take(rows)
    assert not any("following error" in note for note in driven.learner.notes)


def test_a_torque_that_is_no_longer_updated_is_named():
    """Where it would fit the model: a constant one of sliding, over a reversal of the demand."""
    driven = Driven().take(5, error=1e-3)
    driven.take(4, change=lambda rows: rows["torque"].fill(0.05), error=1e-3)
    assert any("frozen" in note for note in driven.notes)


def test_a_load_that_is_gone_ends_learning(tried):
    tried.take(WINDOW_TICKS + 8, error=3e-4)
    other = with_values(LUGRE, {"coulomb": 0.03, "static": 0.04})
    tried.take(4, error=3e-4, true=other)
    assert any("not that of the model" in note for note in tried.notes)


KEPT = Proven("digest", {"coulomb": 0.07}, 0.97, 1000.0, 25.0)


@pytest.mark.parametrize(
    ("model", "celsius", "later_s", "words"),
    [
        ("digest", 30.0, 3600.0, ""),
        ("digest", None, 3600.0, ""),
        ("other", 25.0, 3600.0, "model file has changed"),
        ("digest", 40.0, 3600.0, "temperature differs by 15 K"),
        ("digest", 25.0, 8.0 * 86400.0, "8 days old"),
        ("digest", 25.0, -86400.0, "-1 days old"),
    ],
)
def test_what_was_kept_is_used_unless_it_is_stale(tmp_path, model, celsius, later_s, words):
    path = tmp_path / "mill" / "x.json"
    assert recall(path, model, celsius) == (None, "")
    store(path, KEPT)
    found, why = recall(path, model, celsius, KEPT.unix_s + later_s)
    assert found == (None if words else KEPT)
    assert words in why
    assert bool(why) == bool(words)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"version": 1}', '{"version": 2}', "\x00"])
def test_a_damaged_file_is_named_and_not_used(tmp_path, text):
    path = tmp_path / "x.json"
    path.write_text(text)
    found, why = recall(path, "digest", None)
    assert found is None
    assert str(path) in why


def test_parameters_that_are_not_finite_are_not_used(tmp_path):
    store(tmp_path / "x.json", Proven("digest", {"coulomb": math.nan}, 0.97, 1000.0, None))
    assert recall(tmp_path / "x.json", "digest", None, 2000.0)[0] is None


def test_a_run_begins_with_what_an_earlier_one_has_kept():
    driven = Driven()
    driven.learner.resume({"coulomb": 0.08, "unknown": 1.0}, 1.4)
    driven.take(2, error=3e-4, amplitude=0.0)
    assert driven.proposals == []
    driven.take(1, error=3e-4)
    _, first = driven.proposals[0]
    assert value_of(first.model, "coulomb") == pytest.approx(0.08)
    assert value_of(first.model, "static") == value_of(WRONG, "static")
    assert first.gain == 1.0
    assert driven.learner.proven[0]["coulomb"] == pytest.approx(0.08)


# states


def test_the_page_has_the_transitions_of_the_code():
    page = Path(states.__file__).with_name("layer.md").read_text(encoding="utf-8")
    _, _, table = page.partition("| state | event | next |\n|---|---|---|\n")
    rows = [tuple(line.strip("| ").split(" | ")) for line in table.partition("\n\n")[0].splitlines()]
    assert rows == [(state.value, event.value, to.value) for (state, event), to in TRANSITIONS.items()]


def test_every_state_is_reached_and_left_and_every_event_leads_somewhere():
    assert {state for state, _ in TRANSITIONS} == set(TRANSITIONS.values()) == set(State)
    assert {event for _, event in TRANSITIONS} == set(Event)
