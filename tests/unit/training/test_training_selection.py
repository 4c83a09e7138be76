"""Choice between a physical model and a network beside it: by held-out data, never worse where nothing was learned."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.errors import RecordingError, UsageError
from friction_hil.friction import NetworkStructure, network
from friction_hil.identification import IdentificationSettings
from friction_hil.identification.data import Data, prepare
from friction_hil.models.model_file import ModelFile
from friction_hil.recordings import Recording
from friction_hil.training import (
    NetworkSpec,
    averaged,
    held_out,
    residual_model_file,
    select,
    task_of_recordings,
    train_task,
)
from friction_hil.training.checks import simulate
from friction_hil.training.layout import Samples
from friction_hil.training.visited import least_speed
from tests.networks import alone, beside, random_network

DT, INERTIA = 2e-3, 1e-3
BITS_14, BITS_20 = 2.0 * np.pi / 2**14, 2.0 * np.pi / 2**20
SMALL = IdentificationSettings(families=("coulomb", "stribeck"), has_modifiers=False)
EMPS = Path(__file__).resolve().parents[4] / "shared" / "data" / "emps" / "DATA_EMPS.mat"


def motion(seed, seconds=9.0, top=4.0):
    """Strokes of several speeds over about one radian, the slowest a fortieth of the fastest."""
    random, t, parts, where = np.random.default_rng(seed), 0.0, [], 0.0
    while t < seconds:
        stroke = random.uniform(0.6, 1.1) * (-1.0 if where > 0.0 else 1.0)
        speed = top * random.choice([0.15, 0.3, 0.6, 1.0])
        rows = round(abs(stroke) * 1.5 / speed / DT)
        s = np.arange(1, rows + 1) / rows
        shape = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        parts.append(where + stroke * shape)
        where, t = where + stroke, t + rows * DT
    return np.concatenate(parts)


def friction(position, velocity, ripple):
    return (0.1 + ripple * np.sin(3.0 * position)) * np.tanh(velocity / 1e-3) + 0.01 * velocity


def recorded(seed=0, ripple=0.0, count=BITS_14, noise=2e-3, **changes):
    position = motion(seed, **changes)
    velocity = np.gradient(position, DT)
    torque = friction(position, velocity, ripple) + INERTIA * np.gradient(velocity, DT)
    torque = torque + noise * np.random.default_rng(seed + 100).standard_normal(len(torque))
    columns = {"time_s": DT * np.arange(len(position)), "position": np.round(position / count) * count}
    return Recording("made up", "axis", columns | {"torque": torque}), position, velocity


def physical(**parameters):
    levels = {"coulomb": 0.1, "viscous": 0.01} | parameters
    content = {"model": "coulomb", "parameters": levels}
    return ModelFile.model_validate({"axis": "rotary", "friction": content, "mechanics": {"inertia": INERTIA}})


@pytest.fixture(scope="module")
def learned():
    """Selection from friction that depends on the position, which no model of the library describes."""
    return select([recorded(ripple=0.03)[0]], settings=SMALL)


@pytest.mark.deep
def test_a_network_learns_what_depends_on_the_position(learned):
    assert learned.chosen.inputs == ("position",)
    assert all(gain.is_clear for gain in learned.chosen.gains(learned.physical).values())
    _, position, velocity = recorded(7)
    wanted = friction(position, velocity, 0.03)
    given = {"position": position}
    base = learned.base.friction_model.simulate(velocity, DT, **given)
    with_network = learned.model.simulate(velocity, DT, **given)
    offset = learned.base.mechanics.offset
    moving = np.abs(velocity) > learned.network.least_speed
    before, after = (np.sqrt(np.mean((each + offset - wanted)[moving] ** 2)) for each in (base, with_network))
    assert after < 0.5 * before
    assert np.sqrt(np.mean((with_network + offset - wanted) ** 2)) < np.sqrt(np.mean((base + offset - wanted) ** 2))


@pytest.mark.deep
def test_where_nothing_was_learned_the_physical_model_remains(learned):
    """Slower than the encoder resolves, faster and farther than the recording went."""
    base, model, slowest = learned.base.friction_model, learned.model, learned.network.least_speed
    top, (low, high) = learned.network.speed_limit, learned.network.ranges["position"]
    position = np.linspace(low, high, 50)
    for speed in (0.0, 0.1 * slowest, -0.49 * slowest, 1.51 * top, -10.0 * top):
        velocity = np.full(50, speed)
        found, expected = (each.simulate(velocity, DT, position=position) for each in (model, base))
        np.testing.assert_array_equal(found, expected)
    far = high + 0.2 * (high - low)
    assert model.simulate([0.5 * top], DT, position=far)[0] == base.simulate([0.5 * top], DT, position=far)[0]
    assert np.ptp(model.simulate(np.full(50, slowest), DT, position=position)) > 0.01


@pytest.mark.deep
def test_friction_that_the_physical_model_describes_needs_no_network():
    found = select([recorded()[0]], settings=SMALL)
    assert found.network is None
    assert found.structure == "physical"
    assert found.reason.startswith("no network is better than coulomb")
    content = ModelFile.model_validate(found.model_file())
    assert content.friction.model == "coulomb"
    assert content.friction.parameters["coulomb"] == pytest.approx(0.1, rel=0.03)
    assert "coulomb + direction" in {each.label for each in found.judged}


@pytest.mark.deep
@pytest.mark.parametrize("ripple", [0.0, 0.03])
def test_a_known_model_gets_a_network_only_where_it_helps(ripple):
    content = residual_model_file([recorded(ripple=ripple)[0]], physical())
    assert (content is not None) == (ripple > 0.0)
    if content is not None:
        with pytest.raises(UsageError, match="network already"):
            select([recorded()[0]], known=ModelFile.model_validate(content))
        file = ModelFile.model_validate(content)
        assert file.friction.network.base.parameters["coulomb"] == 0.1
        assert file.mechanics.inertia == INERTIA


def test_the_same_seed_gives_the_same_bits_and_another_one_does_not():
    _, position, velocity = recorded(seconds=3.0)
    left = 0.03 * np.sin(3.0 * position) * np.sign(velocity)
    samples, thirds = Samples(DT, velocity, left, position=position), np.arange(len(left)) * 3 // len(left)
    parts, structure = [thirds == i for i in range(3)], NetworkStructure("static", (3,), 0, 0, True)
    first, again, other = (averaged.fit(structure, samples, parts, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_other_recordings_decide_if_there_are_any():
    found = select([recorded(0, 0.03)[0]], [recorded(1, 0.03)[0]], physical())
    assert list(found.chosen.errors) == [held_out.OTHERS]
    assert found.network is not None
    opposite = select([recorded(0, 0.03)[0]], [recorded(1, -0.03)[0]], physical())
    assert opposite.network is None


@pytest.mark.deep
def test_an_input_that_was_not_recorded_is_refused_and_a_given_one_is_used():
    recording = recorded(ripple=0.03)[0]
    with pytest.raises(RecordingError, match="no temperature that varies"):
        select([recording], known=physical(), inputs=["temperature"])
    assert select([recording], known=physical(), inputs=["position"]).chosen.inputs == ("position",)


def test_a_model_on_which_nothing_is_held_out_leaves_what_it_does_not_explain():
    recording, _, _ = recorded(noise=0.0, count=BITS_20)
    known = physical()
    data = Data(prepare(recording))
    left = held_out.Given(known).left(data)
    assert np.median(np.abs(left)) < 0.01 * np.std(data.torque)  # more at reversals, where the sign is blurred
    more = physical(coulomb=0.12)
    signs = data.stack([np.sign(record.velocity) for record in data.records])
    np.testing.assert_allclose(held_out.Given(more).left(data), left - 0.02 * signs, atol=1e-9)


@pytest.mark.parametrize("count", [BITS_14, BITS_20])
def test_the_least_speed_is_above_the_noise_of_the_encoder(count):
    """At rest, behind the same low-pass, an encoder that toggles at random shows less than the least speed."""
    position = motion(0)
    noise = np.random.default_rng(0).uniform(-0.5, 0.5, len(position)) * count
    shown = prepare(recorded(count=count)[0])
    slowest = least_speed(shown)
    time_s = DT * np.arange(len(position))
    columns = {"time_s": time_s, "position": noise, "torque": np.ones(len(position))}
    rest = prepare(Recording("a", "axis", columns), lowpass_hz=shown[0].lowpass_hz)[0]
    assert 2.0 * np.std(rest.velocity[rest.begin : rest.end]) < slowest
    assert slowest < 0.6


def test_gains_are_paired():
    """Parts of very different size: the difference is clear although the parts vary more."""
    before = np.array([1.0, 10.0, 100.0, 2.0])
    found = held_out.gain(0.9 * before, before)
    assert found.mean == pytest.approx(0.1)
    assert not held_out.gain(before + np.array([1.0, -1.0, 1.0, -1.0]), before).is_clear
    assert not held_out.gain(before, before).is_clear
    assert not held_out.gain(0.995 * before, before).is_clear  # certain, but it does not matter
    difference = np.array([0.3, 0.1, 0.2, 0.4])
    found = held_out.gain(1.0 - difference, np.ones(4))
    assert found.error == pytest.approx(np.std(difference, ddof=1) / 2.0)


@pytest.mark.parametrize("has_position", [False, True])
def test_the_mean_of_networks_has_the_mean_of_their_torques(has_position):
    structure = NetworkStructure("static", (5,), 0, 0, has_position)
    weights = [0.3 * np.random.default_rng(seed).standard_normal(structure.weights) for seed in range(3)]
    networks = [random_network("static", structure=structure, bound=50.0, weights=each) for each in weights]
    velocity, position = np.linspace(-2.5, 2.5, 101), np.linspace(1.1, -1.1, 101)
    wanted = np.mean([alone(each).simulate(velocity, DT, position=position) for each in networks], axis=0)
    p = averaged.mean(structure, [each.values for each in networks])
    wide = NetworkStructure("static", (15,), 0, 0, has_position)
    np.testing.assert_allclose(simulate(wide, p, velocity, DT, position=position), wanted, atol=1e-13)


def test_an_average_of_what_is_mostly_noise_stays_small():
    random = np.random.default_rng(0)
    velocity = random.uniform(-1.0, 1.0, 600)
    samples = Samples(DT, velocity, random.standard_normal(600))
    parts = [np.arange(600) // 200 == i for i in range(3)]
    structure = NetworkStructure("static", (4,), 0)
    p = averaged.fit(structure, samples, parts)
    learned = simulate(NetworkStructure("static", (12,), 0), p, velocity, DT)
    assert np.std(learned) < 0.3
    assert np.max(np.abs(learned)) <= np.max(np.abs(samples.torque))
    p = averaged.fit(structure, samples.weighted(np.zeros(600)), parts)
    assert not np.any(simulate(structure, p, velocity, DT)), "what does not count teaches nothing"


@settings(max_examples=50, deadline=None)
@given(st.floats(0.0, 10.0), st.floats(-3.0, 3.0), st.floats(-1.0, 1.0), st.floats(0.0, 90.0) | st.just(np.nan))
def test_the_support_of_a_residual_is_a_fraction_and_zero_outside(speed, position, load, temperature):
    p = random_network("every_input", is_residual=True, least_speed=0.1).values
    found = network.support(p, speed, position, load, temperature)
    inside = 0.1 <= speed <= 2.0 and abs(position) <= 1.0 and abs(load) <= 0.2
    inside = inside and (np.isnan(temperature) or 20.0 <= temperature <= 60.0)
    outside = speed <= 0.05 or speed >= 3.0 or abs(position) >= 1.25 or abs(load) >= 0.25
    outside = outside or temperature <= 15.0 or temperature >= 65.0
    assert 0.0 <= found <= 1.0
    assert not inside or found == 1.0
    assert not outside or found < 1e-12


def test_a_least_speed_is_checked_and_survives_the_model_file():
    for least_speed_given, is_residual in ((-0.1, True), (2.0, True), (np.nan, True), (0.1, False)):
        with pytest.raises(fh.models.InvalidParameterError, match="least_speed"):
            random_network(least_speed=least_speed_given, is_residual=is_residual)
    whole = random_network("static", least_speed=0.1, is_residual=True)
    assert whole.as_dict()["least_speed"] == 0.1
    assert type(whole).of_values(whole.values, 0.12, is_residual=True).least_speed == 0.1
    velocity = np.array([0.04, 0.075, 0.1])
    lugre = fh.models.create("lugre", **fh.models.describe("lugre").example)
    added = beside(whole).simulate(velocity, DT) - lugre.simulate(velocity, DT)
    full = alone(random_network("static")).simulate(velocity, DT)
    np.testing.assert_allclose(added, full * [0.0, 0.5, 1.0], atol=1e-12)


@pytest.mark.deep
@pytest.mark.parametrize("ripple", [0.0, 0.03])
def test_a_network_of_a_given_structure_is_flagged_if_a_physical_model_is_as_good(ripple):
    task = task_of_recordings([recorded(ripple=ripple)[0]], [], physical(), is_static=True, is_residual=True)
    found = train_task(task, NetworkSpec(structure="residual", inputs=("position",)))
    is_better = found.gains["the model of --base"].is_clear
    assert is_better == (ripple > 0.0)
    assert any(flag.startswith("it is not better") for flag in found.trained.flags) != is_better
    assert 0.0 < found.network.least_speed < 0.1


@pytest.mark.deep
@pytest.mark.skipif(not EMPS.exists(), reason="the shared recording of the EMPS axis is not here")
def test_the_friction_of_the_emps_axis_depends_on_its_position():
    named = {"time_s": "t", "position": "qm", "torque": "vir*35.150651"}
    recording = fh.recordings.read(EMPS, columns=named)
    chosen = IdentificationSettings(families=("coulomb", "stribeck"), axis="linear", has_modifiers=False)
    found = select([recording], settings=chosen)
    assert found.chosen.inputs == ("position",)
    coulomb = next(each for each in found.judged if each.label == "coulomb + direction")
    assert found.chosen.first.relative_error < 0.95 * coulomb.first.relative_error
