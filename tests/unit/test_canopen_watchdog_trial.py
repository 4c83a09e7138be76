"""`doctor --try-watchdog`: what a drive does when one of its watchdogs lapses, as far as it is seen."""

import threading
import time

import pytest
from friction_hil_drivers.canopen.drives import CanopenDrives
from friction_hil_drivers.canopen.simulated import SimulatedCanopenDrives

from friction_hil.cli import main
from friction_hil.config import from_dict
from friction_hil.daemon.realtime import RealClock
from tests.processes import free_port
from tests.servo_drives import axis_dict

GROUP = "239.74.163.42"


@pytest.fixture
def tried():
    """Try the watchdogs of a simulated drive that runs in a thread; return the findings and the states it was in."""

    def attempt(prepare=None):
        data = {
            "version": 1,
            "period_s": 1e-3,
            "bus": {"interface": "udp_multicast", "channel": GROUP, "port": free_port(), "hop_limit": 0},
            "axes": {"x": axis_dict(simulation={"canopen": {"timer_at_sync_only": True}})},
        }
        config = from_dict(data, "test")
        simulated, is_over, states = SimulatedCanopenDrives(config, config.axes, pace="real"), threading.Event(), set()
        simulated.open()
        if prepare is not None:
            prepare(simulated._nodes[0])

        def is_stopping():
            states.add(simulated._nodes[0].drive.state.name)
            return is_over.is_set()

        thread = threading.Thread(target=simulated.run, args=(is_stopping,))
        thread.start()
        try:
            time.sleep(0.1)
            findings = list(CanopenDrives.try_watchdogs(config, config.axes, RealClock(0)))
        finally:
            is_over.set()
            thread.join(20.0)
            simulated.close()
        return findings, states, simulated._nodes[0]

    return attempt


def test_each_means_is_tried_and_what_was_seen_is_told(tried):
    (rpdo, heartbeat), states, node = tried()
    assert (rpdo.check, rpdo.result, rpdo.code) == ("x: RPDO 4", "warn", "FH-443")
    assert "8250h" in rpdo.detail
    assert "no reaction seen without torque" in rpdo.detail
    assert (heartbeat.check, heartbeat.result) == ("x: heartbeat (1016h:01)", "pass")
    assert "NMT state pre-operational" in heartbeat.detail
    assert "OPERATION_ENABLED" not in states  # no torque at any time
    assert "SWITCHED_ON" in states
    assert node.drive.state.name == "SWITCH_ON_DISABLED"


def test_a_watchdog_that_does_nothing_is_not_said_to_work(tried):
    def keep_quiet(node):
        node._behaviour.value = 1  # 1029h: stays in Operational
        node._emergency_id.value |= 0x80000000

    findings, states, _ = tried(prepare=keep_quiet)
    assert [(finding.result, finding.code) for finding in findings] == [("fail", "FH-442")] * 2
    assert all("not seen to act" in finding.detail for finding in findings)
    assert "OPERATION_ENABLED" not in states


def test_without_a_configuration_there_is_nothing_to_try(capsys):
    assert main(["doctor", "--try-watchdog"]) == 2
    assert "--try-watchdog needs CONFIG" in capsys.readouterr().err
