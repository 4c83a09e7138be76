"""What the drive port promises, as tests. Subclass `DrivesContract` for a driver; README.md shows how."""

import math
from collections.abc import Callable

import pytest

from friction_hil.drive import DriveState, Request
from friction_hil.errors import BusError, DriveError
from tests.contract.rig import AXES, PERIOD_S, Connection, InstalledRig, NotApplicableError, Rig

_RISING = (  # towards power, which a drive gains in this order
    DriveState.UNKNOWN,
    DriveState.NOT_READY,
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY_TO_SWITCH_ON,
    DriveState.SWITCHED_ON,
    DriveState.OPERATION_ENABLED,
)
PUSH = 0.1  # N m
LONG = 400  # cycles, more than any drive takes to stop


def applicable(action: Callable[[], None]) -> None:
    """Do something with a rig, or skip the test where the rig says that it is not applicable."""
    try:
        action()
    except NotApplicableError as reason:
        pytest.skip(str(reason))


def stop(connection: Connection, request: Request, *torques: float) -> None:
    """Ask for a stop until no drive has power any more, or for longer than any takes."""
    for _ in connection.cycles(LONG, request, *torques):
        if not any(state.is_powered for state in connection.states):
            return


class DrivesContract:
    """Promises of `friction_hil.drive.Drives`. A subclass provides the fixture ``rig``, a `Rig`."""

    # --- connecting

    def test_connect_states_the_facts_of_each_axis_in_order(self, rig: Rig) -> None:
        with Connection(rig) as connection:
            assert [fact.name for fact in connection.facts] == list(AXES)
            for fact in connection.facts:
                delays = [fact.setpoint_delay_s, fact.actuation_delay_s]
                positive = [fact.position_resolution, fact.torque_resolution, *delays]
                assert all(math.isfinite(value) and value > 0.0 for value in positive), fact
                assert max(delays) < 1.0
                age_s = fact.torque_delay_s
                assert age_s is None or (math.isfinite(age_s) and age_s >= 0.0)
                assert fact.identity
                assert all(isinstance(note, str) and note for note in fact.notes)

    def test_connecting_gives_no_drive_power(self, rig: Rig) -> None:
        with Connection(rig) as connection:
            connection.run(5, Request.LISTEN)
            assert not any(state.is_powered for state in connection.states)

    def test_a_drive_with_power_is_refused_and_nothing_is_written(self, rig: Rig) -> None:
        """Somebody else moves it, or has left it so: touching it may be worse than leaving it."""
        rig.leave_enabled()
        before = rig.count_commands()
        drives = rig.make_drives()
        with pytest.raises(DriveError, match="already"):
            drives.connect()
        drives.close()
        assert rig.count_commands() == before
        assert rig.has_power(0)
        assert rig.has_power(1)

    # --- feedback

    def test_feedback_is_fresh_and_finite_in_every_cycle(self, rig: Rig) -> None:
        with Connection(rig) as connection:
            for feedback in connection.cycles(20, Request.LISTEN):
                for each in feedback:
                    assert each.is_fresh, each
                    assert all(map(math.isfinite, (each.position, each.velocity, each.torque)))
                    assert each.state is not DriveState.UNKNOWN
                    assert (each.error, each.message, each.missing) == ("", "", "")

    def test_feedback_follows_the_plant(self, rig: Rig) -> None:
        """Position is the integral of velocity, and each axis has its own."""
        with Connection(rig, is_enabled=True) as connection:
            connection.run(10, Request.ENABLE, PUSH, 0.0)
            start = [each.position for each in connection.feedback]
            travel = 0.0
            for feedback in connection.cycles(20, Request.ENABLE, PUSH, 0.0):
                travel += feedback[0].velocity * PERIOD_S
            moved = [each.position - before for each, before in zip(connection.feedback, start, strict=True)]
            assert moved[0] == pytest.approx(travel, rel=0.15)
            assert abs(moved[1]) < 0.01 * moved[0], "an axis without torque stands"

    def test_a_silent_drive_is_never_fresh_and_the_reason_is_reported(self, rig: Rig) -> None:
        """At once where the driver knows it, else when the drive's own heartbeat is overdue: within a second."""
        with Connection(rig, is_enabled=True) as connection:
            connection.run(LONG, Request.ENABLE)  # a drive that has a heartbeat has been heard by then
            positions = [each.position for each in connection.feedback]
            rig.silence()
            for _ in range(round(1.0 / PERIOD_S)):
                connection.cycle(Request.QUICK_STOP)
                for each, position in zip(connection.feedback, positions, strict=True):
                    assert not each.is_fresh
                    assert each.position == pytest.approx(position, abs=1e-9), "nothing is made up"
                if all(each.missing or each.message for each in connection.feedback):
                    break
            assert all(each.missing or each.message for each in connection.feedback)

    # --- commands

    def test_nothing_is_commanded_while_listening(self, rig: Rig) -> None:
        with Connection(rig) as connection:
            connection.run(3, Request.LISTEN)
            before = rig.count_commands()
            connection.run(30, Request.LISTEN, PUSH)
            assert rig.count_commands() == before
            assert [each.velocity for each in connection.feedback] == [0.0] * len(AXES)

    def test_a_command_that_was_not_written_is_reported_and_no_other(self, rig: Rig) -> None:
        with Connection(rig, is_enabled=True) as connection:
            for _ in connection.cycles(20, Request.ENABLE, PUSH):
                assert connection.written
                assert not any(each.is_setpoint_lost for each in connection.feedback)
            rig.silence()
            for _ in connection.cycles(20, Request.ENABLE, PUSH):
                is_lost = [each.is_setpoint_lost for each in connection.feedback]
                assert all(is_lost) == (connection.written == 0)

    def test_enabling_takes_one_step_after_the_other(self, rig: Rig) -> None:
        with Connection(rig) as connection:
            connection.run(3, Request.LISTEN)
            before, ranks = rig.count_commands(), []
            for feedback in connection.cycles(100, Request.ENABLE):
                ranks.append([_RISING.index(each.state) for each in feedback])
                if connection.states == [DriveState.OPERATION_ENABLED] * len(AXES):
                    break
            assert connection.states == [DriveState.OPERATION_ENABLED] * len(AXES)
            assert ranks == sorted(ranks), "no step back"
            assert rig.count_commands() > before
            connection.run(20, Request.ENABLE)
            assert connection.states == [DriveState.OPERATION_ENABLED] * len(AXES), "it stays there"

    @pytest.mark.parametrize("request_", [Request.DISABLE, Request.QUICK_STOP])
    def test_power_is_given_up_when_asked_for(self, rig: Rig, request_: Request) -> None:
        with Connection(rig, is_enabled=True) as connection:
            connection.run(10, Request.ENABLE, PUSH)
            stop(connection, request_, PUSH)
            connection.run(50, request_, PUSH)
            assert DriveState.OPERATION_ENABLED not in connection.states, "it stays without power"
            velocities = [each.velocity for each in connection.feedback]
            connection.run(20, request_, PUSH)
            for before, each in zip(velocities, connection.feedback, strict=True):
                assert abs(each.velocity) <= abs(before), "the torque that is still commanded must not act"

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_torque_has_the_scale_and_the_sign_of_si(self, rig: Rig, sign: float) -> None:
        """Its acceleration, measured over 20 cycles, is that of the plant; the axes are pushed apart."""
        with Connection(rig, is_enabled=True) as connection:
            torques = (sign * PUSH, -sign * PUSH)
            connection.run(10, Request.ENABLE, *torques)  # until commands act and filters have settled
            before = [each.velocity for each in connection.feedback]
            connection.run(20, Request.ENABLE, *torques)
            for each, start, torque in zip(connection.feedback, before, torques, strict=True):
                acceleration = (each.velocity - start) / (20 * PERIOD_S)
                expected = math.copysign(abs(torque) - rig.friction, torque) / rig.inertia
                tolerance = rig.torque_tolerance / rig.inertia + 0.1 * abs(expected)
                assert acceleration == pytest.approx(expected, abs=tolerance)
            for fact, each, torque in zip(connection.facts, connection.feedback, torques, strict=True):
                if fact.torque_delay_s is not None:
                    assert each.torque == pytest.approx(torque, abs=max(0.1 * PUSH, rig.torque_tolerance))

    def test_a_fault_is_reset_only_on_request(self, rig: Rig) -> None:
        with Connection(rig, is_enabled=True) as connection:
            rig.trip()
            for feedback in connection.cycles(30, Request.ENABLE):
                tripped = feedback[0].state
            assert tripped is DriveState.FAULT
            connection.run(30, Request.DISABLE)
            assert connection.states[0] is DriveState.FAULT
            connection.run(30, Request.RESET_FAULT)
            assert connection.states[0] is not DriveState.FAULT
            assert not connection.states[0].is_powered
            connection.enable()

    # --- blind stops and kills

    def test_a_drive_that_commands_do_not_reach_is_told_and_nothing_untrue_said_of_it(self, rig: Rig) -> None:
        with Connection(rig, is_enabled=True) as connection:
            connection.run(10, Request.ENABLE, PUSH, 0.0)
            applicable(rig.detach)
            for feedback in connection.cycles(LONG, Request.ENABLE, PUSH, 0.0):
                if not feedback[0].is_reachable:
                    break
            assert not connection.feedback[0].is_reachable
            assert connection.feedback[1].is_reachable
            connection.run(50, Request.QUICK_STOP)
            assert connection.feedback[0].message or connection.feedback[0].missing, "the reason is given"
            states = connection.drives.close()
        if states is not None:
            assert states[0] is DriveState.UNKNOWN or states[0].is_powered == rig.has_power(0)
        assert not rig.has_power(1)

    @pytest.mark.parametrize("is_disabled", [True, False])
    def test_closing_returns_the_states_that_were_read_back(self, rig: Rig, is_disabled: bool) -> None:
        with Connection(rig, is_enabled=True) as connection:
            connection.run(10, Request.ENABLE, PUSH)
            if is_disabled:
                stop(connection, Request.DISABLE)
            states = connection.drives.close()
        if is_disabled:
            assert not rig.has_power(0)
            assert not rig.has_power(1)
        if states is not None:  # None: the driver reads nothing back
            assert len(states) == len(AXES)
            for axis, state in enumerate(states):
                assert state is DriveState.UNKNOWN or state.is_powered == rig.has_power(axis)

    def test_a_killed_driver_leaves_no_power(self, rig: Rig) -> None:
        with Connection(rig, is_enabled=True) as connection:
            connection.run(20, Request.ENABLE, PUSH, -PUSH)
            assert rig.has_power(0)
            applicable(rig.kill)
            assert not rig.has_power(0)
            assert not rig.has_power(1)

    # --- dry runs and the end

    def test_a_dry_run_writes_nothing(self, rig: Rig) -> None:
        with Connection(rig, dry_run=True) as connection:
            connection.run(10, Request.LISTEN)
            connection.run(20, Request.ENABLE, PUSH)  # not even by mistake
            assert all(each.is_fresh for each in connection.feedback)
            assert not any(state.is_powered for state in connection.states)
        assert rig.count_commands() == 0

    def test_closing_is_safe_at_any_time_and_twice(self, rig: Rig) -> None:
        unused = rig.make_drives()
        unused.close()
        unused.close()
        connected = rig.make_drives()
        connected.connect()
        connected.close()
        connected.close()
        assert rig.count_commands() >= 0
        with Connection(rig) as connection:  # whoever comes next finds the drives as they were
            connection.run(5, Request.LISTEN)
            assert all(each.is_fresh for each in connection.feedback)
            assert not any(state.is_powered for state in connection.states)

    def test_after_closing_in_motion_no_drive_has_power_and_nothing_more_is_written(self, rig: Rig) -> None:
        with Connection(rig, is_enabled=True) as connection:
            connection.run(10, Request.ENABLE, PUSH)
        closed = rig.count_commands()
        with Connection(rig, dry_run=True) as listener:
            listener.run(10, Request.LISTEN)
            connection.drives.close()
            listener.run(10, Request.LISTEN)
            assert all(each.is_fresh for each in listener.feedback)
            assert not any(state.is_powered for state in listener.states)
        assert rig.count_commands() == closed


class ServiceContract:
    """Promises of ``stop_axes`` and ``reset_axes`` of a driver. The fixture ``rig`` is an `InstalledRig`."""

    def test_stop_takes_the_power_of_drives_that_were_left_enabled_and_reset_does_not(self, rig: InstalledRig) -> None:
        rig.leave_enabled()
        before = rig.count_commands()
        assert [each.result for each in rig.reset_axes()] == ["powered"] * len(AXES)
        assert rig.count_commands() == before
        assert rig.has_power(0)
        stops = rig.stop_axes()
        assert [(each.axis, each.result, each.before) for each in stops] == [
            (name, "stopped", DriveState.OPERATION_ENABLED) for name in AXES
        ]
        assert not any(each.after.is_powered or each.after is DriveState.UNKNOWN for each in stops)
        assert not any(rig.has_power(k) for k in range(len(AXES)))
        before = rig.count_commands()
        assert [each.result for each in rig.stop_axes()] == ["unpowered"] * len(AXES)
        assert rig.count_commands() == before, "there was nothing to do"
        with Connection(rig) as connection:
            connection.enable()

    def test_reset_says_what_the_fault_was_and_leaves_no_power(self, rig: InstalledRig) -> None:
        rig.trip()
        left, _ = rig.stop_axes()
        assert (left.result, left.after) == ("unpowered", DriveState.FAULT)
        first, second = rig.reset_axes()
        assert (first.result, first.before, second.result) == ("reset", DriveState.FAULT, "unpowered")
        assert first.fault
        assert not first.after.is_powered
        assert first.after not in (DriveState.UNKNOWN, DriveState.FAULT)
        assert [each.result for each in rig.reset_axes()] == ["unpowered"] * len(AXES)
        assert not any(rig.has_power(k) for k in range(len(AXES)))


class SilentServiceContract(ServiceContract):
    """Also what is promised of drives that do not answer."""

    def test_a_drive_that_does_not_answer_is_unknown_and_is_told_to_stop(self, rig: InstalledRig) -> None:
        rig.leave_enabled()
        rig.stop()
        before = rig.count_commands()
        stops = rig.stop_axes()
        assert [(each.result, each.is_proved) for each in stops] == [("unknown", False)] * len(AXES)
        assert all(each.detail for each in stops)
        assert rig.count_commands() > before


class SimulatedDrivesContract:
    """Promises of a counterpart at ``pace="sync"``. A subclass provides the fixture ``rig``, an `InstalledRig`."""

    def test_it_names_its_drives(self, rig: InstalledRig) -> None:
        assert all(f"{name}=" in rig.ready for name in AXES)

    def test_a_cycle_is_one_period_of_the_plant(self, rig: InstalledRig) -> None:
        """Velocity grows by the torque's impulse over one period in each cycle, however long the cycle really takes."""
        with Connection(rig, is_enabled=True) as connection:
            connection.run(10, Request.ENABLE, PUSH)
            velocity = [f[0].velocity for f in connection.cycles(40, Request.ENABLE, PUSH)]
            grown = (velocity[-1] - velocity[0]) / (len(velocity) - 1)
            expected = (PUSH - rig.friction) / rig.inertia * PERIOD_S
            assert grown == pytest.approx(expected, rel=0.1)

    def test_two_runs_are_the_same_bit_for_bit(self, rig: InstalledRig, another_rig: InstalledRig) -> None:
        told = []
        for one in (rig, another_rig):
            with Connection(one, is_enabled=True) as connection:
                rows = [
                    [(each.position, each.velocity, each.torque, each.state) for each in feedback]
                    for feedback in connection.cycles(60, Request.ENABLE, PUSH, -PUSH)
                ]
            told.append(rows)
        assert told[0] == told[1]
        assert told[0][0] != told[0][-1]

    def test_running_ends_on_request(self, rig: InstalledRig) -> None:
        with Connection(rig) as connection:
            connection.run(3, Request.LISTEN)
        assert rig.stop()

    def test_closing_twice_is_safe_and_running_needs_to_be_opened(self, rig: InstalledRig) -> None:
        rig.close()
        rig.counterpart.close()
        with pytest.raises(BusError, match="open"):
            rig.counterpart.run(lambda: True)
