"""The timer that a cycle on a serial line waits with: it never ends a wait too late, and never hides a reply."""

import os
import select
import time

import pytest
from friction_hil_drivers.serial_line.protocol import Image
from friction_hil_drivers.serial_line.scheduler import BusScheduler
from friction_hil_drivers.serial_line.waiting import LineSelector, PeriodicTimer, run_schedulers
from hypothesis import given
from hypothesis import strategies as st

from tests.serial_rig import MS, Ask, BenchLine

PERIOD_NS = 2 * MS
MOST_LEAD_NS = 0.3 * MS
FAR_S = 20.0  # a hang, where anything else would be a matter of microseconds


@pytest.fixture
def ticker():
    made = PeriodicTimer(20 * MS)
    yield made
    made.close()


@given(
    phases=st.lists(st.integers(0, PERIOD_NS), min_size=1, max_size=3),
    jitters=st.lists(st.integers(-50_000, 50_000), min_size=4, max_size=20),
    since_ns=st.integers(0, PERIOD_NS),
)
def test_it_runs_from_the_second_period_on_wherever_the_moment_lies(phases, jitters, since_ns):
    ticker = PeriodicTimer(PERIOD_NS)
    now_ns = 1_000_000_000
    for phase in phases:
        for k, jitter in enumerate(jitters):
            moment_ns = now_ns + phase + k * PERIOD_NS + jitter
            before_ns = moment_ns - since_ns
            expiry_ns = ticker.expiry_ns
            told = ticker.expire_before(moment_ns, before_ns)
            if k > 0 and ticker.expiry_ns != expiry_ns:  # the jitter took the moment out of the timer's reach
                assert (moment_ns - expiry_ns) % PERIOD_NS > MOST_LEAD_NS
                assert not told
                continue
            if k == 0:
                assert ticker.expire_before(moment_ns, before_ns) == told, "if it was set now, it does not run yet"
                continue
            assert told == (since_ns > (moment_ns - ticker.expiry_ns) % PERIOD_NS)
            assert not (told and since_ns == 0)
            assert told or since_ns <= MOST_LEAD_NS
        now_ns += 1000 * PERIOD_NS + 12345
    ticker.close()


def test_a_moment_that_is_not_of_this_period_leaves_it_alone(ticker):
    now = time.monotonic_ns()
    assert not ticker.expire_before(now + 15 * MS, now)
    expiry = ticker.expiry_ns
    assert not ticker.expire_before(now + 100 * MS + 7, now)
    assert ticker.expiry_ns == expiry


def test_it_expires_in_each_period_and_not_before_its_time(ticker):
    moment = time.monotonic_ns() + 15 * MS
    ticker.expire_before(moment, moment - 10 * MS)
    for k in (1, 2, 3):
        assert select.select([ticker.descriptor], (), (), FAR_S)[0]
        assert time.monotonic_ns() >= moment + k * 20 * MS - MOST_LEAD_NS
        ticker.clear()
        ticker.clear()  # nothing is there to be forgotten


def test_closed_twice_gives_nothing_of_others_back(ticker):
    descriptor = ticker.descriptor
    ticker.close()
    with open(os.devnull, "rb") as other:
        assert other.fileno() == descriptor, "the number is given again"
        ticker.close()
        assert os.fstat(other.fileno())


class Talk:
    """A scheduler on a pipe, with a timer that has been set up."""

    def __init__(self):
        self.theirs = 0
        descriptor, self.theirs = os.pipe()
        self.line = BenchLine(lambda _: b"")
        self.line.descriptor = descriptor
        self.image = Image()
        self.scheduler = BusScheduler(self.line, [self.image], 0.0, 0.05)
        self.selector = LineSelector(20 * MS)
        self.limit_ns = time.monotonic_ns() + 30 * MS
        self.ticker.expire_before(self.limit_ns, self.limit_ns - 1)

    @property
    def ticker(self):
        return self.selector.timer

    def wait(self):
        """Ask, and wait until the first limit of a period to come."""
        self.scheduler.enqueue((Ask(self.image, "position"),))
        self.scheduler.poll()
        while time.monotonic_ns() > self.limit_ns - 10 * MS:
            self.limit_ns += 20 * MS
        is_done = run_schedulers([self.scheduler], self.limit_ns, self.selector)
        self.scheduler.end_cycle()
        return is_done

    def close(self):
        self.selector.close()
        os.close(self.line.descriptor)
        os.close(self.theirs)


@pytest.fixture
def talk():
    made = Talk()
    yield made
    made.close()


def test_a_silent_line_is_waited_for_until_the_limit(talk):
    for _ in range(3):
        assert not talk.wait()
        assert time.monotonic_ns() >= talk.limit_ns


def test_an_expiry_that_nobody_has_seen_ends_no_wait(talk):
    assert select.select([talk.ticker.descriptor], (), (), FAR_S)[0]
    assert not talk.wait()
    assert time.monotonic_ns() >= talk.limit_ns


def test_a_reply_is_taken_when_it_is_there(talk):
    talk.line.answer = lambda _: b"12;"
    os.write(talk.theirs, b"!")  # select sees the pipe, the line has the reply
    assert talk.wait()
    assert talk.image.values["position"] == 12.0
