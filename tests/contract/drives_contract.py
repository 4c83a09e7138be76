"""Behaviour that the loop expects of every driver, as tests that each driver inherits.

To test a driver, subclass `DrivesContract` in a test module, and override `make_rig`::

    class TestMyDrives(DrivesContract):
        def make_rig(self, tmp_path, *, dry_run=False):
            return MyRig(tmp_path, dry_run=dry_run)

A rig has one axis, in mode cst, with a drive (usually a simulated one) whose friction is below 0.2 N m.
"""

import copy
import math
from pathlib import Path
from typing import Protocol

import pytest

from friction_hil.drive import AxisFacts, Drives, DriveState, Feedback, Request

TORQUE = 0.3
ENABLE_CYCLES, DISABLE_CYCLES = 100, 400
_ON = DriveState.OPERATION_ENABLED


class Rig(Protocol):
    """One drive with its driver.

    Attributes
    ----------
    drives : Drives
        Neither connected nor started.
    """

    drives: Drives

    def cycle(self, request: Request, torque: float = 0.0) -> Feedback:
        """Perform one cycle: receive, then send the request and a torque, N m; return the feedback."""
        ...

    def is_powered(self) -> bool:
        """Return True if the drive itself has power, whatever the driver reports."""
        ...

    def close(self) -> None:
        """Close the driver, and whatever the rig has opened."""
        ...


class DrivesContract:
    """Tests of one driver; see the module."""

    def make_rig(self, tmp_path: Path, *, dry_run: bool = False) -> Rig:
        """Make a rig; its files may lie in ``tmp_path``."""
        raise NotImplementedError

    @pytest.fixture
    def rig(self, tmp_path):
        made = self.make_rig(tmp_path)
        yield made
        made.close()

    @pytest.fixture
    def facts(self, rig):
        """Connect and start; return the facts of the axis."""
        (facts,) = rig.drives.connect()
        rig.drives.start()
        return facts

    def enable(self, rig):
        for _ in range(ENABLE_CYCLES):
            if rig.cycle(Request.ENABLE).state is _ON:
                return
        raise AssertionError("the drive was not enabled")

    def test_the_facts_of_an_axis_are_finite_and_positive(self, facts):
        assert isinstance(facts, AxisFacts)
        assert facts.name
        assert facts.identity
        assert 0.0 < facts.position_resolution < 1.0
        assert 0.0 < facts.torque_resolution < 1.0
        assert facts.setpoint_delay_s >= 0.0
        assert facts.actuation_delay_s >= 0.0

    def test_connecting_and_listening_enable_nothing(self, rig, facts):
        for _ in range(10):
            feedback = rig.cycle(Request.LISTEN)
            assert not feedback.state.is_powered
            assert not rig.is_powered()

    def test_feedback_is_fresh_and_finite(self, rig, facts):
        for _ in range(10):
            feedback = rig.cycle(Request.LISTEN)
            assert feedback.is_fresh
            assert not feedback.missing
            assert all(map(math.isfinite, (feedback.position, feedback.velocity, feedback.torque)))

    def test_a_requested_state_is_reached(self, rig, facts):
        self.enable(rig)
        assert rig.is_powered()
        for _ in range(DISABLE_CYCLES):
            if not rig.cycle(Request.DISABLE).state.is_powered:
                break
        assert not rig.is_powered()

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_a_torque_moves_the_axis_in_its_direction(self, rig, facts, sign):
        self.enable(rig)
        start = rig.cycle(Request.ENABLE).position
        for _ in range(30):
            feedback = rig.cycle(Request.ENABLE, sign * TORQUE)
        assert sign * feedback.velocity > 0.0
        assert sign * (feedback.position - start) > 0.0

    def test_preparing_a_cycle_in_advance_changes_no_feedback(self, rig, facts):
        self.enable(rig)
        feedback = rig.cycle(Request.ENABLE)
        before = copy.copy(feedback)
        for _ in range(3):
            rig.drives.rehearse()
        assert feedback == before
        assert rig.cycle(Request.ENABLE).is_fresh

    def test_a_dry_run_enables_nothing(self, tmp_path):
        rig = self.make_rig(tmp_path, dry_run=True)
        try:
            rig.drives.connect()
            rig.drives.start()
            for _ in range(20):
                feedback = rig.cycle(Request.ENABLE, TORQUE)
                assert not feedback.state.is_powered
                assert not rig.is_powered()
            assert feedback.is_fresh
        finally:
            rig.close()

    def test_closing_takes_the_power_away_and_may_be_repeated(self, rig, facts):
        self.enable(rig)
        assert rig.is_powered()
        rig.drives.close()
        assert not rig.is_powered()
        rig.drives.close()

    def test_closing_before_connecting_is_safe(self, rig):
        rig.drives.close()
        assert not rig.is_powered()
