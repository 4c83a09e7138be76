"""`doctor --try-watchdog`: what a drive does when one of its watchdogs lapses, as far as it is seen."""

import time

import pytest
from friction_hil_drivers.canopen.drives import CanopenDrives

from friction_hil.cli import main
from tests.canopen_bench import NODE, Bench, BusClock, TimedBus
from tests.servo_drives import axis_dict, configuration


class Tried(TimedBus):
    """A drive and a computer that is busy with something else now and then, in simulated time."""

    def __init__(self):
        self.bench = Bench(is_paced_by_sync=False, manners={"timer_at_sync_only": True})
        super().__init__([self.bench], 0.0)
        self.stalls_ms = []
        self.is_fed = False
        self.states = set()

    def send(self, msg, timeout=None):
        self.is_fed = self.is_fed or msg.arbitration_id == 0x77E
        super().send(msg, timeout)

    def recv(self, timeout=None):
        if self.is_fed and self.stalls_ms and timeout:
            self.pass_until(self.now_ms + self.stalls_ms.pop())
        return super().recv(timeout)

    def pass_until(self, now_ms):
        super().pass_until(now_ms)
        self.states.add(self.bench.node.drive.state.name)


@pytest.fixture
def tried(monkeypatch):
    """Try the watchdogs of a simulated drive; return the findings and the bus."""

    def attempt(*, prepare=None, stalls_ms=(), answer_ms=0.0):
        bus = Tried()
        monkeypatch.setattr(time, "monotonic", lambda: 1e-3 * bus.now_ms)
        monkeypatch.setattr(time, "sleep", lambda wait_s: bus.pass_until(bus.now_ms + 1e3 * wait_s))
        if prepare is not None:
            prepare(bus.bench.node)
        config = configuration(x=axis_dict(node=NODE))
        drives = CanopenDrives(config, config.axes, BusClock(bus), dry_run=False, bus=bus)
        drives.connect()
        bus.stalls_ms, bus.answer_ms = list(stalls_ms), answer_ms
        try:
            return list(drives.try_own_watchdogs("x")), bus
        finally:
            drives.close()
            bus.shutdown()

    return attempt


def results(findings):
    return [(finding.result, finding.code) for finding in findings]


@pytest.mark.parametrize("answer_ms", [0.0, 15.0, 60.0])
def test_each_means_is_tried_and_what_was_seen_is_told(tried, answer_ms):
    (rpdo, heartbeat), bus = tried(answer_ms=answer_ms)
    assert (rpdo.check, rpdo.result, rpdo.code) == ("x: RPDO 4", "warn", "FH-443")
    assert "8250h" in rpdo.detail
    assert "no reaction seen without torque" in rpdo.detail
    assert (heartbeat.check, heartbeat.result) == ("x: heartbeat (1016h:01)", "pass"), heartbeat.detail
    assert "NMT state pre-operational" in heartbeat.detail
    assert "OPERATION_ENABLED" not in bus.states  # no torque at any time
    assert "SWITCHED_ON" in bus.states
    assert bus.bench.node.drive.state.name == "SWITCH_ON_DISABLED"


SEEN, ALWAYS_LATE = [("warn", "FH-443"), ("pass", "")], [("warn", "FH-442")] * 2


@pytest.mark.parametrize(("stalls", "expected"), [(1, SEEN), (2, SEEN), (1000, ALWAYS_LATE)])
def test_a_drive_that_this_computer_fed_too_late_is_tried_again(tried, stalls, expected):
    """A computer that is always late proves nothing."""
    findings, bus = tried(stalls_ms=[300.0] * stalls)
    assert results(findings) == expected, findings
    assert bool(bus.stalls_ms) is (stalls == 1000)
    assert stalls < 1000 or all("this computer fed the drive" in finding.detail for finding in findings)


def test_a_watchdog_that_does_nothing_is_not_said_to_work(tried):
    def keep_quiet(node):
        node.dictionary.at(0x1029, 1).value = 1  # stays in Operational
        node.dictionary.at(0x1014, 0).value |= 0x80000000

    findings, bus = tried(prepare=keep_quiet)
    assert results(findings) == [("fail", "FH-442")] * 2
    assert all("not seen to act" in finding.detail for finding in findings)
    assert "OPERATION_ENABLED" not in bus.states


def test_without_a_configuration_there_is_nothing_to_try(capsys):
    assert main(["doctor", "--try-watchdog"]) == 2
    assert "--try-watchdog needs CONFIG" in capsys.readouterr().err
