"""Training data from recordings: the motion as derived from the counts of the encoder."""

import numpy as np
import pytest

from friction_hil.models.model_file import ModelFile
from friction_hil.recordings import Recording
from friction_hil.training import task_of_recordings
from friction_hil.training.excitation import excitation
from tests.unit.training.test_training import plant

DT, ROWS, COUNT, INERTIA = 1e-3, 12_000, 2.0 * np.pi / 2**20, 2e-4
KNOWN = {"model": "coulomb", "parameters": {"coulomb": 0.1}}


def recorded(seed=0, count=COUNT, **columns):
    """Motion and friction without noise, and a recording of them: counted position, torque with 1 % noise."""
    velocity, random = excitation(1.2, DT, ROWS, seed=seed), np.random.default_rng(seed)
    friction = plant().simulate(velocity, DT)
    torque = friction + INERTIA * np.append(np.diff(velocity), 0.0) / DT
    given = {
        "time_s": DT * np.arange(ROWS),
        "position": np.round(np.cumsum(velocity) * DT / count) * count,
        "torque": torque + 0.01 * np.std(friction) * random.standard_normal(ROWS),
    }
    return velocity, friction, Recording("made up", "axis", given | columns)


def samples(recording, **options):
    known = ModelFile.model_validate({"axis": "rotary", "friction": KNOWN, "mechanics": {"inertia": INERTIA}})
    return task_of_recordings([recording], [recording], known, **options)


def distance(torque, truth, weight):
    counts = weight > 0.0
    return float(np.std((torque - truth)[counts]) / np.std(truth[counts]))


@pytest.mark.parametrize("seed", [0, 1])
def test_reversals_are_not_low_passed_away(seed):
    """The plant itself, along the velocity of the samples, against its friction without noise."""
    velocity, friction, recording = recorded(seed)
    task = samples(recording)
    found, low = task.samples, samples(recording, lowpass_hz=100.0).samples
    away, away_low = (distance(plant().simulate(each.velocity, DT), friction, each.weight) for each in (found, low))
    assert away < 0.5 * away_low
    assert np.sum(found.weight) > 0.95 * ROWS
    assert 0.0095 < distance(found.torque, friction, found.weight) < 0.011  # its noise, and nothing of the inertia
    assert distance(low.torque, friction, low.weight) > 0.02
    assert any("counts" in note for note in task.notes)
    raw = np.diff(recording["position"], prepend=0.0) / DT
    assert np.std(found.velocity - velocity) < 0.5 * np.std(raw - velocity)


def test_a_velocity_that_is_differences_of_counts_is_replaced_and_a_finer_one_is_not():
    velocity, _, recording = recorded()
    for better, is_kept in ((velocity + 1e-4 * np.sin(np.arange(ROWS)), True), (None, False)):
        given = np.diff(recording["position"], prepend=0.0) / DT if better is None else better
        recording.columns["velocity"] = given
        used = samples(recording).samples.velocity
        assert np.array_equal(used, given) == is_kept


@pytest.mark.parametrize("options", [{"lowpass_hz": 80.0}, {"is_static": True}])
def test_a_low_pass_is_used_if_given_or_for_a_static_network(options):
    _, _, recording = recorded()
    task = samples(recording, **options)
    assert not any("counts" in note for note in task.notes)
    assert np.std(np.diff(task.samples.torque, 3)) < 0.3 * np.std(np.diff(recording["torque"], 3))


def test_gain_and_back_emf_of_a_model_apply_to_its_signal():
    velocity, _, recording = recorded()
    gain, back_emf = 0.2, 3e-3
    volts = Recording("volts", "axis", dict(recording.columns))
    volts.columns["torque"] = (recording["torque"] + back_emf * velocity) / gain
    content = {"axis": "rotary", "friction": KNOWN, "mechanics": {"inertia": INERTIA}}
    known = ModelFile.model_validate(content | {"torque_signal": {"gain": gain, "back_emf": back_emf}})
    found = task_of_recordings([volts], [volts], known).samples.torque
    expected = samples(recording).samples.torque
    assert np.std(found - expected) < 1e-3 * np.std(expected)
