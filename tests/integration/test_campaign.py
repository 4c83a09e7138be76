"""A few tries of tools/campaign: real processes, faults between them, and every frame on the wire within its limits.

How busy the computer is decides what a fault leads to and when; what is unsafe must not be seen in any case.
"""

import pytest

from tests.launcher import start
from tools.campaigns.faults import BY_NAME
from tools.campaigns.judge import judge
from tools.campaigns.trial import run_trial

pytestmark = pytest.mark.deep


@pytest.mark.parametrize(("name", "number"), [("kill-daemon", 0), ("lost-50", 2), ("garbage-journal", 1)])
def test_a_fault_ends_safely(name: str, number: int) -> None:
    seen = run_trial(BY_NAME[name], 11, number, start)
    verdict = judge(BY_NAME[name], seen)
    assert verdict.unsafe == [], seen.errors
