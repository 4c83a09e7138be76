"""What every friction model promises, whatever its family; a subclass names the family.

The numbered facts are those of the literature by which an implementation is judged: steady state (1), dissipation (8),
oddness (10), consistency over the step (11).
"""

import itertools
import math
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import friction_hil as fh
from tests.examples import most_for_families
from tests.friction_models import again, decades, level_bound, level_of, mirrored, models, motions

checked = settings(  # one function serves all subclasses; the first example may compile
    max_examples=most_for_families(), deadline=None, suppress_health_check=[HealthCheck.differing_executors]
)


class FrictionFamilyContract:
    """Promises of a family of friction models.

    Attributes
    ----------
    family : str
        Its name in `friction_hil.models.names`.
    has_jump : bool
        True if the torque jumps at zero velocity: then a feedforward is regularised there.
    settles_within : float
        Relative error that is left of a transient after a long time at one velocity.
    cannot_move : frozenset of str
        Parameters over which the torque has no derivative: it changes with them by jumps.
    least_compared : int
        Number of parameters whose gradient is compared at least.
    """

    family: ClassVar[str]
    has_jump: ClassVar[bool] = False
    settles_within: ClassVar[float] = 1e-9
    cannot_move: ClassVar[frozenset[str]] = frozenset()
    least_compared: ClassVar[int] = 2

    @property
    def names(self) -> tuple[str, ...]:
        return (self.family,)

    def example(self, **changes: Any) -> Any:
        return fh.models.create(self.family, **dict(fh.models.describe(self.family).example) | changes)

    # --- symmetry (fact 10)

    @checked
    @given(st.data())
    def test_the_mirror_image_has_exactly_the_opposite_torque(self, data: st.DataObject) -> None:
        """Where directions differ or a ripple is even, the mirror image swaps or turns them."""
        model = data.draw(models(self.names))
        motion = data.draw(motions(model))
        np.testing.assert_array_equal(motion.opposite().simulate(mirrored(model)), -motion.simulate(model))
        load = float(motion.inputs["load_torque"][0]) if "load_torque" in motion.inputs else 0.0
        there = mirrored(model).steady_state(-motion.velocity, load_torque=-load)
        np.testing.assert_array_equal(there, -model.steady_state(motion.velocity, load_torque=load))

    @checked
    @given(st.data())
    def test_a_feedforward_is_odd_too(self, data: st.DataObject) -> None:
        model = data.draw(models(self.names))
        motion = data.draw(motions(model))
        forth, back = model.start("feedforward"), mirrored(model).start("feedforward")
        for (v, dt, inputs), (w, _, turned) in zip(motion.steps(), motion.opposite().steps(), strict=True):
            assert back.step(w, dt, **turned) == -forth.step(v, dt, **inputs)

    def test_a_symmetric_model_is_odd_on_a_long_rough_history(self) -> None:
        random = np.random.default_rng(1)
        v = np.cumsum(random.normal(size=4000)) * 1e-3
        v[random.integers(0, v.size, 400)] = 0.0
        force = random.normal(size=v.size)
        back, forth = (self.example().simulate(sign * v, 1e-3, applied_torque=sign * force) for sign in (-1.0, 1.0))
        np.testing.assert_array_equal(back, -forth)
        assert np.abs(forth).max() > 0.0

    # --- bounds

    @checked
    @given(st.data())
    def test_no_step_and_no_velocity_lead_out_of_the_bound(self, data: st.DataObject) -> None:
        """Without viscous parts, at any period from picoseconds to years."""
        model = data.draw(models(self.names, is_bounded=True))
        motion = data.draw(motions(model, fastest=1e9, periods=decades(1e-12, 1e12)))
        torque = motion.simulate(model)
        assert np.all(np.isfinite(torque))
        assert np.abs(torque).max() <= level_bound(model, motion.inputs) * (1.0 + 1e-9)

    # --- steady state (fact 1)

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    @pytest.mark.parametrize("speed", [0.03, 0.5, 20.0])
    def test_after_long_it_is_on_its_steady_curve(self, speed: float, sign: float) -> None:
        model = self.settling()
        n = 4000
        torque = model.simulate(np.full(n, sign * speed), 4.0 / speed / n)
        expected = model.steady_state([sign * speed])[0]
        assert torque[-1] == pytest.approx(expected, rel=self.settles_within)
        assert math.copysign(1.0, expected) == sign

    def settling(self) -> Any:
        """Return the model whose transients end; a family may have to give up what depends on rest before."""
        return self.example()

    def test_there_is_no_steady_torque_at_rest(self) -> None:
        assert self.example().steady_state([0.0])[0] == 0.0

    # --- one step at a time

    @checked
    @given(st.data())
    def test_step_by_step_is_simulate_bit_for_bit(self, data: st.DataObject) -> None:
        model = data.draw(models(self.names))
        motion = data.draw(motions(model))
        runner = model.start("simulation")
        torque = [runner.step(v, dt, **inputs) for v, dt, inputs in motion.steps()]
        np.testing.assert_array_equal(torque, motion.simulate(model))

    @checked
    @given(st.data())
    def test_a_feedforward_differs_from_a_simulation_only_by_the_jump(self, data: st.DataObject) -> None:
        """Bit for bit the same without a jump; with one, bounded as the simulation is and zero at rest."""
        model = data.draw(models(self.names, is_bounded=self.has_jump))
        motion = data.draw(motions(model))
        feedforward = model.start("feedforward")
        torque = np.array([feedforward.step(v, dt, **inputs) for v, dt, inputs in motion.steps()])
        if not self.has_jump:
            np.testing.assert_array_equal(torque, motion.simulate(model))
            return
        assert np.all(np.isfinite(torque))
        assert np.abs(torque).max() <= level_bound(model, motion.inputs) * (1.0 + 1e-9)

    def test_a_fast_feedforward_is_the_simulation(self) -> None:
        """Far from zero velocity nothing is regularised."""
        model = self.settling()
        v = 50.0 + 10.0 * np.sin(0.05 * np.arange(400))
        feedforward = model.start("feedforward")
        torque = [feedforward.step(float(each), 1e-3) for each in v]
        np.testing.assert_allclose(torque[200:], model.simulate(v, 1e-3)[200:], rtol=1e-6)

    # --- dissipation (fact 8)

    @checked
    @given(arrays(float, st.integers(4, 12), elements=st.floats(-2.0, 2.0)))
    def test_closed_cycles_dissipate(self, v: np.ndarray) -> None:
        corners = np.append(v, v[0]) - v.mean()
        fine = np.interp(np.linspace(0.0, v.size, 600, endpoint=False), np.arange(v.size + 1), corners)
        torque = self.example().simulate(np.tile(fine, 4), 1e-4).reshape(4, -1)
        scale = float(np.abs(torque).max())
        if np.abs(torque[3] - torque[2]).max() < 1e-9 * scale:  # the cycle closes: nothing is left in a spring
            assert np.sum(torque[3] * fine) >= 0.0

    # --- consistency over the step (fact 11)

    def test_a_shorter_step_changes_little_and_converges(self) -> None:
        """Of a smooth motion in one direction, with steps from 50 us on, shorter than any relaxation."""
        coarse, differences = 200, []
        model = self.settling()
        torques = []
        for factor in (1, 2, 4, 8):
            n = coarse * factor
            middle = (np.arange(n) + 0.5) / n  # velocity held over a step: its mean over it
            v = 0.5 + 0.4 * np.sin(2.0 * np.pi * middle)
            torques.append(model.simulate(v, 0.01 / n).reshape(coarse, factor).mean(axis=1))
        for rough, fine in itertools.pairwise(torques):
            differences.append(float(np.abs(rough - fine)[20:].max()))
        scale = float(np.abs(torques[-1]).max())
        assert differences[0] < 0.05 * scale
        assert differences[-1] <= max(0.75 * differences[0], 1e-9 * scale)

    # --- gradient

    def test_the_gradient_is_that_of_differences(self) -> None:
        """Central differences, at all but the few samples where the torque has a kink."""
        model = self.differentiable()
        v = np.concatenate([a * np.sin(0.06 * np.arange(200) + 0.3) for a in (2.0, 0.05, 0.0, 0.5)])
        force = np.where(np.arange(v.size) % 40 < 20, 0.5, -0.5)
        torque, gradient = model.simulate_with_gradient(v, 1.3e-3, applied_torque=force)
        level = level_of(self.family, model.parameters)
        np.testing.assert_allclose(
            torque, model.simulate(v, 1.3e-3, applied_torque=force), rtol=0.0, atol=1e-12 * level
        )
        assert gradient.shape == (v.size, len(model.free))
        assert np.all(np.isfinite(gradient))
        compared = 0
        for i, name in enumerate(model.free):
            value = model.parameters.get(name)
            if not isinstance(value, float) or not math.isfinite(value) or value == 0.0 or name in self.cannot_move:
                continue
            step = 1e-5 * abs(value)
            up, down = (
                again(model, {name: value + sign * step}).simulate(v, 1.3e-3, applied_torque=force)
                for sign in (1.0, -1.0)
            )
            difference = (up - down) / (2.0 * step)
            scale = np.abs(gradient[:, i]).max()
            assert scale > 0.0, name
            close = np.abs(gradient[:, i] - difference) <= 1e-4 * scale
            assert close.mean() > 0.9, name
            compared += 1
        assert compared >= self.least_compared

    def differentiable(self) -> Any:
        """Return the model whose parameters can be moved to both sides."""
        return self.example()
