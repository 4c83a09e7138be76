"""The choice among candidates: failing ones, paired comparison, levels the motion does not show, work in parallel."""

import dataclasses
import threading
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.errors import RecordingError
from friction_hil.identification import (
    Fit,
    Identification,
    IdentificationSettings,
    candidates,
    identify,
    plausible_fits,
)
from friction_hil.identification.choice import choose, log_likelihood_gain
from friction_hil.identification.export import as_json, model_file
from friction_hil.identification.least_squares import FitError, column_norms, least_norm_solution
from friction_hil.identification.prediction_errors import PredictionError
from friction_hil.parallel import in_parallel, threads
from tests.unit.identification.test_identification import PERIOD_S, found, made, plain, recorded


@pytest.fixture(scope="module")
def result() -> Identification:
    return found(recorded("stribeck", noise=0.01), families=("coulomb", "stribeck", "dahl", "lugre"))


def failing(monkeypatch: pytest.MonkeyPatch, *families: str) -> None:
    """Make the fits of some families fail as a decomposition does that does not converge."""
    fit = candidates.fit

    def sometimes(regression: Any, *args: Any, **kwargs: Any) -> Fit:
        if regression.structure.family in families:
            raise np.linalg.LinAlgError("SVD did not converge")
        return fit(regression, *args, **kwargs)

    monkeypatch.setattr(candidates, "fit", sometimes)


def test_a_candidate_whose_numbers_fail_is_left_out_and_named(monkeypatch):
    failing(monkeypatch, "dahl", "lugre")
    result = found(recorded("stribeck", noise=0.01), families=("coulomb", "dahl", "stribeck"))
    assert result.best.label == "stribeck"
    assert {fit.structure.family for fit in result.fits} == {"coulomb", "stribeck"}
    [said, *_] = (note for note in as_json(result)["notes"] if "dahl" in note)
    assert "SVD did not converge" in said
    with pytest.raises(RecordingError, match=r"no candidate.*dahl.*SVD did not converge"):
        found(recorded("dahl", noise=0.01), families=("dahl", "lugre"))


@given(st.lists(st.floats(-280.0, 280.0), min_size=1, max_size=4))
def test_norms_of_columns_neither_overflow_nor_vanish(exponents: list[float]) -> None:
    scales = 10.0 ** np.array(exponents)
    matrix = np.outer([3.0, 0.0, -4.0], scales)
    np.testing.assert_allclose(column_norms(matrix), 5.0 * scales, rtol=1e-12)


@given(st.integers(0, 10_000), st.booleans())
def test_least_squares_without_singular_values_agree(seed: int, is_singular: bool) -> None:
    """What is used where the SVD fails gives the same solution of least norm."""
    random = np.random.default_rng(seed)
    matrix, right = random.normal(size=(7, 4)), random.normal(size=7)
    if is_singular:
        matrix[:, 3] = matrix[:, 0] - matrix[:, 1]
    with pytest.MonkeyPatch.context() as patch:
        expected = np.linalg.pinv(matrix) @ right
        patch.setattr(np.linalg, "lstsq", Mock(side_effect=np.linalg.LinAlgError("SVD did not converge")))
        np.testing.assert_allclose(least_norm_solution(matrix, right, 1e-10), expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_no_least_squares_problem(bad: float) -> None:
    with pytest.raises(FitError, match="not finite"):
        least_norm_solution(np.full((2, 2), bad), np.ones(2))


def test_the_search_keeps_out_of_loops_that_release_energy():
    structure = found(recorded("bouc_wen"), families=("bouc_wen",)).fits[0].structure
    values = {"beta": 80.0, "stiffness": 40.0, "exponent": 1.2}
    admitted = [structure.is_admissible({**values, "gamma": gamma}) for gamma in (-81.0, -79.0, 79.0, 81.0)]
    assert admitted == [False, True, True, False]


def with_errors(fit: Fit, stretches: np.ndarray, measured: float = 1.0) -> Fit:
    """A fit whose held-out mean square errors are these."""
    rmse = float(np.sqrt(np.mean(stretches)))
    error = PredictionError(rmse, rmse / measured, tuple(stretches[:4]), tuple(stretches))
    return dataclasses.replace(fit, across_speeds=error, validation=None)


def test_a_stretch_that_no_fit_resolves_does_not_hide_the_difference(result: Identification) -> None:
    """One hard stretch dominates both mean square errors; everywhere else one fit is far better."""
    simple, larger = plain(result, "coulomb"), plain(result, "stribeck")
    random = np.random.default_rng(0)
    noise = np.exp(0.3 * random.normal(size=(2, 40)))
    good, bad = 1e-4 * noise[0], 25e-4 * noise[1]
    good[0] = bad[0] = 1.0
    chosen, _ = choose([with_errors(simple, bad), with_errors(larger, good)])
    assert chosen.label == "stribeck"
    gain, error = log_likelihood_gain(with_errors(larger, good).held_out, with_errors(simple, bad).held_out)
    assert gain == pytest.approx(np.log(5.0), rel=0.15)
    assert gain > 5.0 * error


def test_the_gain_is_antisymmetric_and_zero_for_the_same(result):
    one, other = result.fits[0].held_out, result.fits[-1].held_out
    assert log_likelihood_gain(one, one) == (0.0, 0.0)
    gain, error = log_likelihood_gain(other, one)
    assert log_likelihood_gain(one, other) == pytest.approx((-gain, error), rel=1e-3)


def test_a_choice_does_not_call_parameters_determined_that_it_flags(result):
    simple, larger = plain(result, "coulomb"), plain(result, "stribeck")
    error = simple.held_out
    simple = dataclasses.replace(simple, across_speeds=error, validation=None, flags=())
    better = dataclasses.replace(error, rmse=0.999 * error.rmse)
    larger = dataclasses.replace(larger, across_speeds=better, validation=None)
    assert simple.count < larger.count
    chosen, reason = choose([simple, larger])
    assert chosen is simple
    assert "parameters the data determine" in reason
    flagged = dataclasses.replace(simple, flags=("not excited: offset = 1e-5, its standard error 300 % of it: move",))
    chosen, reason = choose([flagged, larger])
    assert chosen is flagged
    assert "the data determine" not in reason
    assert "all exceed their standard errors" in reason


def test_fits_that_do_not_compare_are_in_groups_of_their_own(result):
    assert [heading for heading, _ in result.groups] == [""]
    one = plain(result, "dahl")
    others = [each for each in result.fits if each is not one]
    mixed = dataclasses.replace(result, fits=(dataclasses.replace(one, is_refined=True), *others))
    (first, refined), (second, rest) = mixed.groups
    assert ([each.label for each in refined], rest) == (["dahl"], tuple(others))
    assert "Fitted once more" in first
    assert "do not compare" in second


def test_a_parameter_at_a_bound_counts_against_a_fit(result: Identification) -> None:
    """Equal errors and parameters: the one with the bound loses, though it has fewer free parameters."""
    bounded, sound = plain(result, "stribeck"), plain(result, "dahl")
    estimate = dataclasses.replace(bounded.estimate, at_bound=("stribeck_velocity", "static"))
    bounded = dataclasses.replace(bounded, estimate=estimate)
    errors = np.exp(np.random.default_rng(1).normal(size=40))
    worse = errors * np.exp(0.1 * np.random.default_rng(2).normal(size=40))
    chosen, _ = choose([with_errors(bounded, errors), with_errors(sound, worse)])
    assert chosen.label == "dahl"


def test_plausible_fits_begin_with_the_chosen_one_and_have_each_family(result: Identification) -> None:
    fits = plausible_fits(result)
    assert fits[0] is result.best
    assert len({id(each) for each in fits}) == len(fits)
    assert {each.structure.family for each in fits} == {each.structure.family for each in result.fits}


def test_a_hump_that_the_motion_does_not_show_is_held_flat() -> None:
    """Coulomb friction with presliding: the level at standstill is free to absorb whatever the model lacks."""
    result = found(recorded("dahl", noise=0.02), families=("lugre",))
    assert any(fit.structure.is_flat for fit in result.fits)
    for fit in result.fits:
        for name, value in fit.values.items():
            if not name.endswith("static"):
                continue
            if fit.structure.is_flat:
                assert value == fit.values[name.replace("static", "coulomb")]
            else:  # shown: a level that the data determine
                assert fit.inference.standard_errors[name] < value
        assert any(flag.startswith("not excited: a static level") for flag in fit.flags) == fit.structure.is_flat
    assert model_file(result).friction.parameters["coulomb"] == pytest.approx(0.3, rel=0.05)


def test_no_level_exceeds_what_was_ever_measured() -> None:
    """A fast sine of which hardly any row is slow: the level at standstill would be anything."""
    time = np.arange(13000) * PERIOD_S
    velocity = 2.0 * np.pi * np.cos(2.0 * np.pi * time)
    model = fh.models.create("stribeck", coulomb=0.08, static=0.12, stribeck_velocity=0.02, viscous=0.002)
    torque = model.simulate(velocity, PERIOD_S) + 2e-4 * np.gradient(velocity, PERIOD_S)
    torque += 0.002 * np.random.default_rng(0).normal(size=len(time))
    for fit in found(made(time, velocity, torque), families=("lugre",)).fits:
        levels = [value for name, value in fit.values.items() if name.endswith("static")]
        assert max(levels) < 1.6 * np.abs(torque).max()


def test_results_are_in_order_and_begin_is_called_in_this_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "processors", lambda: 3)
    barrier, begun = threading.Barrier(3, timeout=20.0), []

    def job(number: int) -> int:
        barrier.wait()  # passes only if three run at the same time
        return number * number

    def begin(number: int) -> None:
        begun.append((number, threading.current_thread() is threading.main_thread()))

    jobs = [lambda number=number: job(number) for number in range(6)]
    assert in_parallel(jobs, begin) == [0, 1, 4, 9, 16, 25]
    assert begun == [(number, True) for number in range(6)]


@pytest.mark.parametrize("count", [1, 2])
def test_the_first_failure_is_raised(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "processors", lambda: count)

    def fails(text: str) -> None:
        raise FitError(text)

    with pytest.raises(FitError, match="one"):
        in_parallel([lambda: None, lambda: fails("one"), lambda: fails("two")])


def test_the_number_of_processors_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = recorded("lugre", noise=0.02)
    values = []
    for count in (1, 4):
        monkeypatch.setattr(threads, "processors", lambda count=count: count)
        values.append([(fit.label, fit.values) for fit in found(recording, families=("dahl", "lugre", "gms")).fits])
    assert values[0] == values[1]


@pytest.mark.parametrize(("amplitudes", "is_said"), [((0.4, 0.4), True), ((0.4, 1.2), False)])
def test_a_choice_that_rests_on_one_kind_of_motion_says_so(amplitudes: tuple[float, float], is_said: bool) -> None:
    time = np.arange(8000) * PERIOD_S
    velocity = np.where(time < 8.0, *amplitudes) * np.sin(2.0 * np.pi * time)
    torque = 0.02 * np.gradient(velocity, PERIOD_S) + 0.3 * np.sign(velocity) + 0.05 * velocity
    one = made(time, velocity, torque)
    assert any("one kind of motion" in note for note in found(one, families=("coulomb",)).notes) == is_said
    judged = identify([one], IdentificationSettings(families=("coulomb",), gravity="none"), validation=[one])
    assert not any("one kind of motion" in note for note in judged.notes), "held out is what the user gave"
