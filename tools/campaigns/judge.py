"""What a try must have shown, whatever the fault was, and what its fault adds to that."""

import re
import signal
from dataclasses import dataclass, field

from friction_hil.drive import DriveState
from tools.campaigns.faults import Fault
from tools.campaigns.machine import SIDECAR
from tools.campaigns.trial import Seen
from tools.campaigns.witness import is_powered

_CODE = re.compile(r"\[(FH-\d{3})\]")
_LATE = "FH-113"  # this computer was busy, which is nobody's fault
# What may follow from periods that the daemon missed: late feedback, a drive whose watchdog struck, an axis that
# catches up, a heartbeat or SYNC that was not seen in time. The message has to name these periods.
_FROM_LATE = ("FH-103", "FH-105", "FH-106", "FH-107", "FH-230", "FH-235", "FH-248")
_NAMES_MISSED = re.compile(r"; \d+ periods? (was|were) missed ")
# What may follow from feedback and commands that do not arrive, where the message says so: too fast, too far, behind
_FROM_GAPS = ("FH-107", "FH-108", "FH-109")
_NAMES_GAPS = re.compile(r"; feedback was missing in \d+ of the \d+ cycles before")
_BUSY = (_LATE, "FH-101", "FH-103", "FH-114", "FH-230", "FH-235", "FH-248")  # daemon or drives were
_SAYS_TORQUE = re.compile(r"torque offset|FH-222|FH-128")  # what was not set to zero
_NOT_RESTORED = "[FH-222]"  # a drive that did not answer after the stop
_TOO_SLOW = "set-points no longer wait for a missed one"
_ALL_LOST = re.compile(r"\b(\d+) of \1 rows were lost")  # before the file had a channel
_ROWS_LOST = re.compile(r"rows?\b.*\blost\b|\blost\b.*\brows?\b")
_POWERED = {state.words for state in DriveState if state.is_powered}


@dataclass
class Verdict:
    """Judgement of one try.

    Attributes
    ----------
    unsafe : list of str
        What must not be on however busy a computer: a limit broken, power or torque left, a wrong statement about
        it, processes left behind, a traceback.
    wrong : list of str
        What must not be besides.
    is_void : bool
        True if the run ended before the fault struck, because this computer was too busy.
    named : str
        ``yes``, ``no: CODE``, ``late`` where this computer was, ``unsaid`` where the run went on without a word
    zero_s, unpowered_s : float or None
        From the fault to the end of the torque and of the power, of a run that the fault ended.
    lost : int or None
        Rows that are not in the recording.
    """

    unsafe: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    is_void: bool = False
    has_ended: bool = False
    named: str = ""
    zero_s: float | None = None
    unpowered_s: float | None = None
    lost: int | None = None

    @property
    def problems(self) -> list[str]:
        """All that must not be."""
        return self.unsafe + self.wrong


def judge(fault: Fault, seen: Seen) -> Verdict:
    """Hold what was seen against what must be."""
    faults = [str(text) for text in seen.result.get("faults", ())]
    verdict = Verdict(has_ended=bool(faults) or fault.killed == "daemon")
    verdict.unsafe += seen.witness.broken + seen.left
    if not any(_TOO_SLOW in str(text) for text in seen.result.get("warnings", ())):
        verdict.unsafe += seen.witness.bends
    if seen.has_hung:
        verdict.unsafe.append("the daemon did not end")
    if "Traceback" in seen.errors:
        verdict.unsafe.append(f"traceback: {seen.errors.rstrip().splitlines()[-1]}")
    if seen.struck_s is None:
        verdict.is_void = True
        if seen.status is not None and seen.status < 0:
            verdict.unsafe.append(f"the daemon died of signal {-seen.status} before the fault")
    if unread := seen.witness.unread:
        verdict.unsafe.append(f"{unread} commands could not be read, and were not judged")
    if fault.killed != "drives" or seen.drives_status != -signal.SIGKILL:
        _judge_end(fault, seen, verdict)
    _judge_exit(fault, seen, faults, verdict)
    _judge_cause(fault, seen, faults, verdict)
    _judge_rows(fault, seen, verdict)
    if verdict.has_ended and not verdict.is_void:
        _take_times(seen, verdict)
    return verdict


def _judge_end(fault: Fault, seen: Seen, verdict: Verdict) -> None:
    """Judge the end that the drive shows, and that the daemon claims."""
    witness = seen.witness
    if seen.arena == SIDECAR:
        if witness.zero_since_s is None:
            verdict.unsafe.append(f"an offset of {witness.torque:g} per mille is left in the drive")
        return
    if witness.zero_since_s is None and fault.killed != "daemon" and not _SAYS_TORQUE.search(seen.errors):
        verdict.unsafe.append(f"a torque of {witness.torque:g} per mille is left in the drive, and nobody says so")
    claimed = str(seen.result.get("drive_states", {}).get("x", ""))
    first, is_claimed_off = seen.end_statusword, claimed and claimed not in (*_POWERED, DriveState.UNKNOWN.words)
    if is_claimed_off and first is not None and is_powered(first):  # also if its watchdog has taken it since
        verdict.unsafe.append(f"the daemon says {claimed}, and left the drive with statusword {first:04X}h")
    if witness.statusword is None:
        verdict.unsafe.append("the drive does not tell its state after the end")
    elif is_powered(witness.statusword):
        verdict.unsafe.append(f"the drive still has power, statusword {witness.statusword:04X}h")


def _judge_exit(fault: Fault, seen: Seen, faults: list[str], verdict: Verdict) -> None:
    if fault.killed == "daemon" and not verdict.is_void:
        if seen.status not in (-signal.SIGKILL, 0, 1):
            verdict.wrong.append(f"exit status {seen.status}")
        return
    if verdict.is_void and "Error:" in seen.errors:
        return  # refused before anything was enabled: the computer was too busy to connect
    is_incomplete = any(text in seen.errors for text in ("rows were lost", "still to be written", _NOT_RESTORED))
    expected = 1 if faults or is_incomplete else 0
    if seen.status != expected:
        verdict.wrong.append(f"exit status {seen.status}, not {expected}: {seen.errors[-300:].strip()}")


def _judge_cause(fault: Fault, seen: Seen, faults: list[str], verdict: Verdict) -> None:
    if verdict.is_void and faults and _code(faults[0]) not in _BUSY and not _is_from_lateness(seen, faults[0]):
        verdict.wrong.append(f"the run ended before the fault struck: {faults[0]}")
    if verdict.is_void or fault.killed == "daemon":
        return
    said = "\n".join([*faults, *seen.result.get("warnings", ()), *seen.result.get("notices", ()), seen.errors])
    if faults:
        code = _code(faults[0])
        if code in fault.codes or (fault.loses_frames and code in _FROM_GAPS and _NAMES_GAPS.search(faults[0])):
            verdict.named = "yes"
        elif _is_from_lateness(seen, faults[0]):
            verdict.named = "late"
        else:
            verdict.named = f"no: {code}"
            verdict.wrong.append(f"the cause is not named: {faults[0]}")
    elif fault.must_end and seen.phase == "running":
        verdict.wrong.append("the run went on as if nothing had happened")
    elif fault.words:
        verdict.named = "yes" if re.search(fault.words, said) else "unsaid"


def _code(text: str) -> str:
    found = _CODE.search(text)
    return found[1] if found else "none"


def _is_from_lateness(seen: Seen, text: str) -> bool:
    """Return True if this computer's lateness explains a fault: its code, and missed periods shortly before it."""
    code = _code(text)
    has_missed = int(seen.result.get("missed", 0)) > 1 and _NAMES_MISSED.search(text) is not None
    return code == _LATE or (code in _FROM_LATE and has_missed)


def _judge_rows(fault: Fault, seen: Seen, verdict: Verdict) -> None:
    cycles = int(seen.result.get("cycles", seen.cycles))
    if seen.rows is None and not _ALL_LOST.search(seen.errors):
        if not verdict.is_void and cycles:
            verdict.wrong.append(f"recording: {seen.row_problem}")
        return
    verdict.lost = max(0, cycles - (seen.rows or 0))
    if verdict.lost and not fault.killed and not _ROWS_LOST.search(seen.errors):
        verdict.wrong.append(f"{verdict.lost} of {cycles} rows are missing, and nobody says so")


def _take_times(seen: Seen, verdict: Verdict) -> None:
    """Take the times from the fault; what was over before counts as zero."""
    assert seen.struck_s is not None
    witness = seen.witness
    ends = [each for each in (witness.zero_since_s, witness.unpowered_since_s) if each is not None]
    if ends:
        verdict.zero_s = max(0.0, min(ends) - seen.struck_s)
    if witness.unpowered_since_s is not None and seen.arena != SIDECAR:
        verdict.unpowered_s = max(0.0, witness.unpowered_since_s - seen.struck_s)
