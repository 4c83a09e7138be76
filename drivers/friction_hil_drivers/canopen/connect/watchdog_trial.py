"""Trial of a drive's watchdogs: at standstill and without torque, each is let lapse while the others are fed.

The drive is in Switched On, never in Operation Enabled. No SYNC is sent, as after the death of a daemon. Many drives
react to a lost connection only while they have torque: what is not seen here is called so, and nothing is said to work.
"""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from friction_hil.drive import DriveState
from friction_hil.drive.finding import Finding
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen.connect.watchdogs import Means
from friction_hil_drivers.canopen.sdo.dialogue import Upload
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.cia301 import Frame, decode_heartbeat
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.profile import emergency_code

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.cycle.axis import CanopenAxis
    from friction_hil_drivers.canopen.sdo.client import SdoClient, SdoNetwork
    from friction_hil_drivers.canopen.wire.frames import FrameBus

_FED_S = 0.3  # before one lapses, at least
_FEED_S = 0.002
_POLL = "statusword"
_POLL_S = 0.02  # between two readings of the statusword
_STATE_TIMEOUT_S = 2.0
_TRIES = 3  # of a means, until this computer was not late
_OPERATIONAL = bytes([cia301.NmtState.OPERATIONAL])


@dataclass(slots=True)
class Seen:
    """What a drive did, and how many seconds after the last frame that it should miss."""

    errors: list[tuple[float, str]] = field(default_factory=list)  # emergencies
    states: list[tuple[float, str]] = field(default_factory=list)  # of the drive and of the node, other than before
    late_s: float = 0.0  # how late this computer fed the drive at worst: then it is not known why the drive acted

    def __bool__(self) -> bool:
        return bool(self.errors or self.states)

    def __str__(self) -> str:
        return ", ".join(f"{text} after {1e3 * after_s:.0f} ms" for after_s, text in sorted(self.errors + self.states))


class WatchdogTrial:
    """Trial of all watchdogs of one axis, which is connected and has not been started.

    ``client``: of the drive, for states and faults. ``master_node``: node number of the daemon's heartbeat.
    ``beat_s``: period of heartbeats and remote frames, s.
    """

    def __init__(
        self,
        bus: "FrameBus",
        network: "SdoNetwork",
        client: "SdoClient",
        axis: "CanopenAxis",
        *,
        master_node: int,
        beat_s: float,
    ) -> None:
        self._bus, self._network, self._client, self._axis = bus, network, client, axis
        self._frames: dict[str, Sequence[Frame]] = {
            "rpdo": [(axis.watch.rpdo_id, profile.SWITCH_ON.to_bytes(2, "little"))] if axis.watch.rpdo_id else (),
            "heartbeat": [(cia301.HEARTBEAT_BASE + master_node, _OPERATIONAL)],
        }
        self._sent_s: dict[str, float] = {}  # when each was fed last, or could first be
        self._periods_s = {"rpdo": _FEED_S, "heartbeat": beat_s, "guarding": beat_s, _POLL: _POLL_S}

    def run(self) -> Iterator[Finding]:
        """Try one means after the other; the drive is without power, and its faults are reset, before and after."""
        self._network.meanwhile = self._feed
        try:
            results = []
            for means in self._axis.watch.means:
                for _ in range(_TRIES):
                    seen, too_early = self._try(means)
                    if not (too_early or seen.late_s):
                        break
                results.append((means, seen, too_early))
        finally:
            self._switch_off()
            self._network.meanwhile = None
        is_any_seen = any(seen and not too_early and not seen.late_s for _, seen, too_early in results)
        for means, seen, too_early in results:
            is_first, check = means is self._axis.watch.acting, f"{self._axis.facts.name}: {means.name}"
            yield _finding(check, means, seen, too_early=too_early, is_any_seen=is_any_seen, is_first=is_first)

    def _try(self, means: Means) -> tuple[Seen, bool]:
        """Feed all means, then all but one; return what the drive did, and whether it acted while all were fed."""
        self._switch_on()
        seen = self._observe(self._axis.watch.means, max(_FED_S, 4e-3 * means.within_ms))
        if seen or seen.late_s:
            return seen, True
        others = [one for one in self._axis.watch.means if one is not means]
        return self._observe(others, 3e-3 * means.within_ms + 0.2), False

    def _switch_on(self) -> None:
        """Bring the node to Operational and the drive to Switched On, without torque; else raise a `DriveError`."""
        self._nmt(cia301.NmtCommand.ENTER_PRE_OPERATIONAL)
        self._leave_fault()
        if not self._axis.watch.rpdo_id:
            # the event-driven RPDO 1 carries the present position, no velocity and no torque
            position = self._client.read(objects.POSITION_ACTUAL)
            self._frames["rpdo"] = self._axis.idle_frames(profile.SWITCH_ON, position)
        self._nmt(cia301.NmtCommand.START)
        for word, state in (
            (profile.SHUTDOWN, DriveState.READY_TO_SWITCH_ON),
            (profile.SWITCH_ON, DriveState.SWITCHED_ON),
        ):
            self._client.write(objects.CONTROLWORD, word)
            self._await(state)
        self._sent_s |= dict.fromkeys(("rpdo", _POLL), time.monotonic())

    def _feed(self) -> float:
        """Feed what watches the daemon in every NMT state; return for how long that is enough, s."""
        now, left_s = time.monotonic(), math.inf
        for means in self._axis.watch.means:
            if means.kind != "rpdo":
                if now >= self._sent_s.get(means.kind, -math.inf) + self._periods_s[means.kind]:
                    self._send(means.kind)
                    self._sent_s[means.kind] = now
                left_s = min(left_s, self._sent_s[means.kind] + self._periods_s[means.kind] - now)
        return max(left_s, _FEED_S)

    def _leave_fault(self) -> None:
        """Reset the fault that the trial before has caused."""
        self._client.write(objects.CONTROLWORD, profile.DISABLE_VOLTAGE)
        if self._state() is DriveState.FAULT:
            self._client.write(objects.CONTROLWORD, profile.FAULT_RESET)
            self._await(DriveState.SWITCH_ON_DISABLED)
            self._client.write(objects.CONTROLWORD, profile.DISABLE_VOLTAGE)

    def _switch_off(self) -> None:
        self._nmt(cia301.NmtCommand.ENTER_PRE_OPERATIONAL)
        self._leave_fault()

    def _state(self) -> DriveState:
        return profile.drive_state(self._client.read(objects.STATUSWORD))

    def _await(self, state: DriveState) -> None:
        end = time.monotonic() + _STATE_TIMEOUT_S
        while (found := self._state()) is not state:
            if time.monotonic() > end:
                text = f"{self._axis.facts.name}: the drive stays {found.words} and does not become {state.words}"
                raise DriveError(text, "see what it reports: friction-hil run with --dry-run")
            time.sleep(_FEED_S)

    def _nmt(self, command: cia301.NmtCommand) -> None:
        self._bus.send(cia301.NMT_ID, bytes((command, self._axis.node)))

    # One trial

    def _observe(self, fed: Sequence[Means], duration_s: float) -> Seen:
        """Feed some watchdogs and listen for ``duration_s``; return what the drive did."""
        seen = Seen()
        while self._bus.receive(0.0) is not None:
            pass  # of before
        begin = now = time.monotonic()
        allowed_s = {means.kind: 1e-3 * means.within_ms for means in fed} | {_POLL: math.inf}
        next_s = dict.fromkeys(allowed_s, begin)
        while now < begin + duration_s:
            for kind, at in next_s.items():
                if now >= at:
                    seen.late_s = max(seen.late_s, now - self._sent_s[kind] - allowed_s[kind])
                    self._send(kind)
                    self._sent_s[kind], next_s[kind] = now, now + self._periods_s[kind]
            frame = self._bus.receive(max(0.0, min(next_s.values()) - time.monotonic()))
            now = time.monotonic()
            if frame is not None:
                self._take(frame, now - begin, seen)
        return seen

    def _send(self, kind: str) -> None:
        if kind == "guarding":
            self._bus.send_remote(cia301.HEARTBEAT_BASE + self._axis.node, 1)
        elif kind == _POLL:
            self._bus.send(cia301.SDO_REQUEST_BASE + self._axis.node, Upload(objects.STATUSWORD).first())
        else:
            for frame in self._frames[kind]:
                self._bus.send(*frame)

    def _take(self, frame: Frame, after_s: float, seen: Seen) -> None:
        """Note an emergency, another NMT state and another state of the drive, each when it is new."""
        can_id, data = frame
        node = self._axis.node
        if can_id == cia301.EMERGENCY_BASE + node:
            if code := emergency_code(data):
                seen.errors.append((after_s, f"emergency {profile.error_text(code)}"))
            return
        text = ""
        if can_id == cia301.HEARTBEAT_BASE + node:
            state = decode_heartbeat(data)
            if state is not None and state != cia301.NmtState.OPERATIONAL:
                text = f"NMT state {cia301.NMT_WORDS.get(state, f'{state:02X}h')}"
        elif can_id == cia301.SDO_RESPONSE_BASE + node:
            upload = Upload(objects.STATUSWORD)
            upload.take(data)
            if upload.value is not None and (found := profile.drive_state(upload.value)) is not DriveState.SWITCHED_ON:
                text = f"state {found.words}"
        if text and text not in (known for _, known in seen.states):
            seen.states.append((after_s, text))


def _finding(check: str, means: Means, seen: Seen, *, too_early: bool, is_any_seen: bool, is_first: bool) -> Finding:
    """Return the finding for one watchdog."""
    if seen.late_s:
        detail = f"not known: this computer fed the drive {1e3 * seen.late_s:.0f} ms too late; what came then: {seen}"
        return Finding(check, "warn", detail, "try it on a quiet computer: friction-hil latency shows", "FH-442")
    if too_early:
        detail = f"it trips although it is fed: {seen}"
        fix = "a longer watchdog_s or heartbeat_s; another tool may have armed a watchdog of its own"
        return Finding(check, "fail", detail, fix, "FH-445")
    if seen.states:
        first = f"; it acts first, within {means.worst_ms} ms of the daemon's last frame" if is_first else ""
        return Finding(check, "pass", f"seen to act without torque (set to {means.within_ms} ms): {seen}{first}")
    if seen:
        detail = f"it reports the loss ({seen}), but the drive stays switched on: no reaction seen without torque"
        fix = "see its manual: many drives react only while they are enabled (6007h, 1029h)"
        return Finding(check, "warn", detail, fix, "FH-443")
    waited_ms = 3 * means.within_ms + 200
    detail = f"not seen to act: nothing within {waited_ms} ms after the last frame (set to {means.within_ms} ms)"
    fix = "do not rely on it; see the drive's manual whether it watches only while it is enabled"
    return Finding(check, "warn" if is_any_seen else "fail", detail, fix, "FH-442")
