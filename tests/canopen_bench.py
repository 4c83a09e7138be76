"""A simulated CANopen drive on the bench: raw frames in, raw frames out, no bus and no clock."""

import queue
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import can
from friction_hil_drivers.canopen.connect.eds import SIMULATED_SERVO
from friction_hil_drivers.canopen.drives import CanopenDrives
from friction_hil_drivers.canopen.sdo.client import SdoNetwork
from friction_hil_drivers.canopen.simulated.eds_dictionary import eds_dictionary
from friction_hil_drivers.canopen.simulated.manners import Manners
from friction_hil_drivers.canopen.simulated.node import SimulatedNode
from friction_hil_drivers.canopen.wire.frames import FrameBus
from friction_hil_drivers.cia402.simulated.drive import SimulatedCia402Drive

from friction_hil.daemon.realtime import SteppedClock
from friction_hil.drive import AxisFacts, Command, Feedback, Mode, Request
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo
from tests.servo_drives import axis_dict, configuration

NODE = 5
SDO_REQUEST, SDO_ANSWER = 0x600 + NODE, 0x580 + NODE
STEPS_PER_MS = 80
PLAIN: dict[str, Any] = {"friction": {"model": "coulomb", "parameters": {"coulomb": 0.01}}}

Frame = tuple[int, bytes]


class Bench:
    """One node; with ``is_paced_by_sync`` a SYNC is one millisecond, otherwise time is what `at` says.

    With ``is_locked`` its clock locks to SYNCs of one millisecond, as it does in real time.
    """

    def __init__(
        self,
        servo: dict[str, Any] | None = None,
        *,
        position: float = 0.0,
        is_paced_by_sync: bool = True,
        is_locked: bool = False,
        modes: Sequence[Mode] | None = None,
        missing: Sequence[int] = (),
        eds: Path = SIMULATED_SERVO,
        manners: dict[str, Any] | None = None,
        number: int = NODE,
    ) -> None:
        self.sent: list[Frame] = []
        self.real_ms = 0.0  # the clock on the wall, which runs with `at` and `wait`
        self.servo = Servo(ServoConfig.model_validate(servo or {}), position)
        wanted = Manners.model_validate(manners or {})
        self.node = SimulatedNode(
            number,
            eds_dictionary(eds, number, missing),
            lambda dictionary, emergencies: SimulatedCia402Drive(self.servo, dictionary, emergencies, modes, wanted),
            lambda can_id, data: self.sent.append((can_id, bytes(data))),
            sync_steps=STEPS_PER_MS if is_paced_by_sync else None,
            lock_steps=STEPS_PER_MS if is_locked else None,
            manners=wanted,
            clock=lambda: round(self.real_ms * 1e6),
        )
        self.node.boot()

    def send(self, can_id: int, data: bytes | str = b"") -> list[Frame]:
        """Give the node a frame; return what it sends in answer."""
        before = len(self.sent)
        self.node.receive(can_id, bytes.fromhex(data) if isinstance(data, str) else data)
        if self.node.needs_poll(self.node.now_ns):
            self.node.poll()
        return self.sent[before:]

    def send_remote(self, can_id: int) -> list[Frame]:
        """Give the node a remote frame; return its answers."""
        before = len(self.sent)
        self.node.receive_remote(can_id)
        return self.sent[before:]

    def guard(self) -> list[Frame]:
        """Send the remote frame of node guarding; return what the node sends in answer."""
        return self.send_remote(0x700 + NODE)

    def at(self, time_ms: float) -> list[Frame]:
        """Let real time come to ``time_ms``; return what the node sends meanwhile."""
        before = len(self.sent)
        self.real_ms = max(self.real_ms, time_ms)
        self.node.advance_to(round(time_ms * 1e6))
        self.node.poll()
        self.node.answer()
        return self.sent[before:]

    def wait(self, time_ms: float) -> list[Frame]:
        """Let real time pass without a SYNC; return the late SDO answers that come."""
        before = len(self.sent)
        self.real_ms += time_ms
        self.node.answer()
        return self.sent[before:]

    def sync(self, count: int = 1) -> list[Frame]:
        """Send SYNCs; return what the node sends in answer to the last one."""
        frames: list[Frame] = []
        for _ in range(count):
            frames = self.send(0x080)
        return frames

    def nmt(self, command: int, node: int = NODE) -> list[Frame]:
        return self.send(0x000, bytes([command, node]))

    def read(self, index: int, subindex: int = 0, code: str = "I") -> int:
        """Expedited upload."""
        [(can_id, answer)] = self.sdo(struct.pack("<BHB4x", 0x40, index, subindex))
        assert can_id == 0x580 + NODE
        size = struct.calcsize(f"<{code}")
        assert answer[:4] == struct.pack("<BHB", 0x43 | (4 - size) << 2, index, subindex), answer.hex()
        return int(struct.unpack_from(f"<{code}", answer, 4)[0])

    def write(self, index: int, subindex: int, code: str, value: int) -> None:
        """Expedited download that must succeed."""
        assert self.try_write(index, subindex, code, value) == 0

    def try_write(self, index: int, subindex: int, code: str, value: int) -> int:
        """Expedited download; return the abort code, 0 for none."""
        data = struct.pack(f"<{code}", value)
        head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex)
        [(can_id, answer)] = self.sdo(head + data.ljust(4, b"\0"))
        assert can_id == 0x580 + NODE
        if answer[0] == 0x80:
            assert answer[1:4] == head[1:4]
            return int(struct.unpack_from("<I", answer, 4)[0])
        assert answer == bytes([0x60]) + head[1:4] + bytes(4)
        return 0

    def sdo(self, request: bytes) -> list[Frame]:
        """Give the server a request; return its answers without the emergencies beside them."""
        return [frame for frame in self.send(0x600 + NODE, request) if frame[0] == 0x580 + NODE]

    def map(self, parameter: int, mapping: int, cob_id: int, kind: int, words: Sequence[int]) -> None:
        """Set up a PDO through SDO, as CiA 301 prescribes."""
        self.write(parameter, 1, "I", 0x80000000 | cob_id)
        self.write(mapping, 0, "B", 0)
        for position, word in enumerate(words, 1):
            self.write(mapping, position, "I", word)
        self.write(mapping, 0, "B", len(words))
        self.write(parameter, 2, "B", kind)
        self.write(parameter, 1, "I", cob_id)

    @property
    def statusword(self) -> int:
        return self.read(0x6041, 0, "H")

    @property
    def emergencies(self) -> list[str]:
        """Codes of the emergency messages so far."""
        own = 0x080 + self.node.number
        return [f"{struct.unpack_from('<H', data)[0]:04X}" for can_id, data in self.sent if can_id == own]

    def enable(self, mode: int) -> None:
        """To Operation Enabled, by SDO."""
        self.write(0x6060, 0, "b", mode)
        for word in (0x06, 0x07, 0x0F):
            self.write(0x6040, 0, "H", word)
        assert self.statusword & 0x6F == 0x27, hex(self.statusword)

    def stream(self, mode: int, offset: int | None = 0x60B20010) -> None:
        """Map controlword, target and torque offset synchronously, go to Operational and enable."""
        target = {8: 0x607A0020, 9: 0x60FF0020, 10: 0x60710010}[mode]
        self.command = struct.Struct(f"<H{'h' if mode == 10 else 'i'}{'h' if offset else ''}")
        self.map(0x1400, 0x1600, 0x205, 1, [0x60400010, target, *([offset] if offset else [])])
        self.map(0x1800, 0x1A00, 0x185, 1, [0x60410010, 0x60640020, *([0x60770010] if offset else [])])
        self.nmt(0x01)
        self.enable(mode)

    def move(self, target: int, cycles: int = 1, *, offset: int = 0, word: int = 0x0F) -> list[Frame]:
        """Send commands as `stream` has mapped them, each before a SYNC; return the answer to the last one."""
        frames: list[Frame] = []
        values = (word, target, offset)[: len(self.command.format) - 1]
        for _ in range(cycles):
            self.send(0x205, self.command.pack(*values))
            frames = self.sync()
        return frames


def kill(drives: CanopenDrives) -> None:
    """Let go of the locks of a daemon's drives, as the kernel does with a daemon that was killed."""
    for lock in drives._locks:
        lock.release()


class BenchBus(can.BusABC):
    """A bus to a drive on the bench: its answers are there before anybody asks for them.

    ``refused`` has the SDO requests that the drive aborts: (index, client's command specifier) -> code.
    """

    def __init__(self, bench: Bench | None = None, refused: dict[tuple[int, int], int] | None = None) -> None:
        super().__init__(channel="bench")
        self.bench = Bench() if bench is None else bench
        self.refused = refused or {}
        # Not SimpleQueue, whose get() never returns when the timeout ends before it begins to wait (CPython 3.11).
        self.answers: queue.Queue[can.Message] = queue.Queue()
        self.sent: list[Frame] = []

    def loses(self, can_id: int, data: bytes) -> bool:
        """Return True for a frame of the master that never reaches the drive."""
        return False

    def hear(self, can_id: int, data: bytes = b"") -> None:
        """Let a frame come, of the drive or of somebody else."""
        self.answers.put(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        can_id, data = frame = msg.arbitration_id, bytes(msg.data)
        self.sent.append(frame)
        if self.loses(*frame):
            return
        if can_id == SDO_REQUEST and (code := self.refused.get((int.from_bytes(data[1:3], "little"), data[0] >> 5))):
            self.hear(SDO_ANSWER, b"\x80" + data[1:4] + struct.pack("<I", code))
            return
        for answer in self.answers_of(*frame):
            self.hear(*answer)

    def answers_of(self, can_id: int, data: bytes) -> list[Frame]:
        """Give the drive a frame; return its answers."""
        return self.bench.send(can_id, data)

    @property
    def downloads(self) -> list[int]:
        """Indices of what was written by SDO."""
        writes = [data for can_id, data in self.sent if can_id == SDO_REQUEST and data[0] >> 5 == 1]
        return [int.from_bytes(data[1:3], "little") for data in writes]

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            return self.answers.get(timeout=timeout), True
        except queue.Empty:
            return None, True


class SlowBus(FrameBus):
    """A server whose answers come in order, each after a time; the time passes while somebody waits for a frame.

    ``answers_to`` takes a request and returns frames; ``delay`` says how long their answers take, None: they are lost.
    """

    def __init__(self, answers_to: Callable[[bytes], list[Frame]], delay: Callable[[bytes], float | None]) -> None:
        self.answers_to, self.delay = answers_to, delay
        self.now_s = 0.0
        self.waiting: list[tuple[float, Frame]] = []
        self.client = SdoNetwork(self, now=lambda: self.now_s).client(NODE, "x", "node 5 on a slow bus")

    def send(self, can_id: int, data: bytes) -> None:
        delay_s = self.delay(bytes(data))
        if delay_s is not None:
            after = max([self.now_s + delay_s, *(due_s for due_s, _ in self.waiting)])
            self.waiting += [(after, frame) for frame in self.answers_to(bytes(data))]

    def receive(self, timeout: float) -> Frame | None:
        if self.waiting and self.waiting[0][0] <= self.now_s + timeout:
            due_s, frame = self.waiting.pop(0)
            self.now_s = max(self.now_s, due_s)
            return frame
        self.now_s += timeout
        return None


class Driven:
    """Axis x of a daemon on a bus of the bench, in stepped time."""

    facts: AxisFacts

    def __init__(
        self, mode: str = "csp", *, bus: Any = None, clock: Any = None, dry_run: bool = False, **keys: Any
    ) -> None:
        self.bus = bus or BenchBus()
        self.bench: Bench = self.bus.bench
        if mode == "cst":
            keys = {"controller": {"position_gain": 1.0, "velocity_gain": 0.1}} | keys
        self.config = self.changed(configuration(x=axis_dict(**{"node": NODE, "mode": mode, **keys})))
        self.clock = clock or SteppedClock()
        self.drives = CanopenDrives(self.config, self.config.axes, self.clock, dry_run=dry_run, bus=self.bus)
        self.feedback = Feedback()

    def changed(self, config: Any) -> Any:
        """Return the configuration to use."""
        return config

    def start(self) -> "Driven":
        """Connect, and begin the cyclic phase."""
        (self.facts,) = self.drives.connect()
        self.drives.start()
        return self

    def cycle(self, request: Request = Request.ENABLE, count: int = 1, **command: float) -> Feedback:
        for _ in range(count):
            self.clock.sleep_until(self.clock.now_ns() + 1_000_000)
            self.drives.receive([self.feedback], 0)
            self.drives.send([Command(request, **command)])
        return self.feedback

    def close(self) -> None:
        self.drives.close()
        self.bus.shutdown()

    def __enter__(self) -> "Driven":
        try:
            return self.start()
        except Exception:
            self.close()
            raise

    def __exit__(self, *_: object) -> None:
        self.close()


class TimedBus(can.BusABC):
    """Drives whose SDO server takes some time for an answer. Time passes while somebody waits for a frame."""

    def __init__(self, benches, answer_ms):
        super().__init__(channel="timed")
        self.benches, self.answer_ms, self.now_ms = benches, answer_ms, 0.0
        self.waiting, self.sent, self.gone, self.refused = [], [], set(), []
        self.lost, self.slow = (), {}  # identifiers that nobody hears; ms for the answers about objects, by index

    def put(self, frames):
        for can_id, data in frames:
            if can_id in self.lost:
                continue
            is_sdo = 0x580 <= can_id < 0x600
            message = can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
            late_ms = self.slow.get(int.from_bytes(data[1:3], "little"), self.answer_ms) if is_sdo else 0.0
            self.waiting.append((self.now_ms + late_ms, message))
        self.waiting.sort(key=lambda one: one[0])

    def send(self, msg, timeout=None):
        can_id, data = msg.arbitration_id, bytes(msg.data)
        if (can_id, data) in self.refused:
            raise can.CanOperationError("the interface is down")
        self.sent.append((self.now_ms, can_id, data))
        for bench in self.benches:
            if bench.node.number not in self.gone:
                self.put(bench.send_remote(can_id) if msg.is_remote_frame else bench.send(can_id, data))

    def recv(self, timeout=None):
        end = self.now_ms + 1e3 * (timeout or 0.0)
        while not self.waiting or self.waiting[0][0] > self.now_ms:
            if self.now_ms >= end:
                return None
            self.pass_until(min(end, self.now_ms + 1.0))
        return self.waiting.pop(0)[1]

    def pass_until(self, now_ms):
        self.now_ms = now_ms
        for bench in self.benches:
            frames = bench.at(now_ms)
            if bench.node.number not in self.gone:
                self.put(frames)


class BusClock:
    """The clock of a `TimedBus`."""

    is_real = True

    def __init__(self, bus):
        self.now_ns = lambda: round(bus.now_ms * 1e6)

    def doze_until(self, deadline_ns):
        return False

    def sleep_until(self, deadline_ns):
        pass
