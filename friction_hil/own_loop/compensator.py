"""The object that a loop of the user's own calls once a cycle."""

import math
import time
import weakref
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from friction_hil.config import Configuration, self_contained
from friction_hil.config import load as load_configuration
from friction_hil.daemon.control.message import AxisChange
from friction_hil.daemon.control.prepare import entry_of, prepare
from friction_hil.daemon.notices import AxisNotices
from friction_hil.drive.codes import FaultCode
from friction_hil.dynamics import Arm
from friction_hil.errors import UsageError, internal_error
from friction_hil.numerics.jit import Array, ready
from friction_hil.numerics.readable import POSITION_UNITS
from friction_hil.own_loop import kernel
from friction_hil.own_loop.faults import as_array, check_first, fault_of
from friction_hil.own_loop.joints import adopt, make_joints, remarks
from friction_hil.own_loop.kernel import DQ, GIVEN, LOAD, TAU, WRONG_SHAPE
from friction_hil.own_loop.memory import Memory
from friction_hil.own_loop.pace import Pace
from friction_hil.own_loop.recorder import Recorder

_LOOK_S = 0.25  # between two looks at what there is to be said
_PATIENCE_S = 1.0  # for the first positions
_MOST_NOTICES = 100
_RECORD_S = 60.0
_OF_THE_ARM = [GIVEN.index(name) for name in ("q", "q_des", "dq_des", "ddq_des", "load")]


class Compensator:
    """Friction compensation of n joints in a loop of your own: one call a cycle, arrays over joints in and out.

    It is the daemon's compensator: the same models, estimates, gains, limits and recording, without a bus. A joint is
    an axis of the configuration, in which ``driver`` and ``bus`` may be absent. All values are in SI units: rad, rad/s,
    N m; of a joint whose model is of a linear axis m, m/s, N.

    Nothing raises in the loop after the first call of `step`: what is wrong then fades the output to zero, and `fault`
    says what it was. `step` belongs to one thread; everything else may be called from another.

    Parameters
    ----------
    configuration : Configuration
        As `load` reads it.
    joints : sequence of str, optional
        Names of the axes in the order of the loop's arrays; by default all, in the order of the file.
    record_s : float, optional
        How much of the past the recording in memory keeps, s; 0 for none. A joint takes 136 bytes a cycle.
    record : str or Path, optional
        New MCAP file to be written while the loop runs, by a process beside it, in place of the recording in memory;
        `close` ends it. Linux alone.
    clock : callable, optional
        Monotonic time in nanoseconds, by which `step` measures the periods.

    Raises
    ------
    UsageError
        A joint has settings that a loop of your own cannot use, or a name in ``joints`` is wrong.

    Examples
    --------
    >>> import friction_hil as fh
    >>> comp = fh.Compensator.load("config/own_loop.yaml", period_s=0.004)
    >>> comp.joints
    ('shoulder', 'elbow')
    >>> moving = comp.step([0.0, 0.0], dq_des=[0.5, -0.5])  # from here on it fades in
    >>> for k in range(1, 200):
    ...     q = [0.002 * k, -0.002 * k]
    ...     ff = comp.step(q, q_des=q, dq_des=[0.5, -0.5], dt=0.004)
    >>> ff.round(2), comp.fault
    (array([ 0.42, -0.26]), None)
    """

    def __init__(
        self,
        configuration: Configuration,
        *,
        joints: Sequence[str] | None = None,
        record_s: float = _RECORD_S,
        record: str | Path | None = None,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        if not 0.0 <= record_s <= 86_400.0:
            raise UsageError(f"record_s = {record_s:g} must be a time, from 0 for none to a day")
        made = self._joints = make_joints(configuration, joints)
        n, self._period_s = len(made.names), configuration.period_s
        self._pace = Pace(self._period_s, clock)
        self._nothing, self._all, self._out = np.full(n, math.nan), np.ones(n, np.bool_), np.zeros(n)
        self._blind = [*[self._nothing] * (len(GIVEN) - 1), ~self._all]  # neither feedback nor demand
        self._recorder = None if record is None else Recorder(made, Path(record))
        self._memory: Memory | Recorder = self._recorder or Memory(made, record_s)
        self._end_recording = weakref.finalize(self, self._memory.close)
        self._is_first, self._is_plain, self._is_busy, self._is_period_told = True, False, False, False
        self._fault: str | None = None
        self._looks = self._countdown = max(round(_LOOK_S / self._period_s), 1)
        self._notices: deque[str] = deque(maxlen=_MOST_NOTICES)
        self._told: set[str] = set()
        units = [POSITION_UNITS[configuration.axes[name].model.axis] for name in made.names]
        named = zip(made.names, units, made.compensators, strict=True)
        self._tellers = [AxisNotices(name, unit, _LOOK_S, one) for name, unit, one in named]
        self._values = self_contained(made.configuration)
        self._number, self._models_of = 0, dict.fromkeys(made.names, 0)  # of the last change, of that of each model
        self._pending: deque[tuple[int, list[AxisChange | None]]] = deque()
        self._kernel: Any = ready(kernel.step)
        self._find_loads: Any = None if made.arm is None else ready(kernel.find_loads)
        arrays = (made.settings, made.state, made.limits, made.loop, self._out)
        self._arrays = (*arrays, self._memory.rows, made.flat_state, self._memory.states)
        self._compile()
        for text in remarks(made.configuration):
            self._tell(text)

    def __reduce__(self) -> NoReturn:
        """Refuse a copy, which would share its state with this one, or a part of it."""
        raise TypeError("a Compensator cannot be copied or pickled: load another one")

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        period_s: float | None = None,
        joints: Sequence[str] | None = None,
        record_s: float = _RECORD_S,
        record: str | Path | None = None,
    ) -> "Compensator":
        """Read a configuration, make its compensator, and compile it: the first call of `step` is as fast as any.

        Parameters
        ----------
        path : str or Path
            Configuration, YAML. Each axis needs ``model``, ``limits.torque``, ``limits.velocity`` and, without a
            driver, ``position_resolution``.
        period_s : float, optional
            Period of the loop, s, where the file has none.
        joints, record_s, record
            As for `Compensator`.

        Returns
        -------
        Compensator

        Raises
        ------
        ConfigurationError
            The file cannot be read or has mistakes, or gives another period; each mistake with its line.
        UsageError
            There is no period, or a name in ``joints`` is wrong.
        """
        configuration = load_configuration(path, period_s=period_s)
        if configuration.lacks_period:
            raise UsageError(f"{path} has no period_s: add it there, or give load(..., period_s=) that of your loop")
        return cls(configuration, joints=joints, record_s=record_s, record=record)

    def step(
        self,
        q: ArrayLike,
        dq: ArrayLike | None = None,
        tau: ArrayLike | None = None,
        *,
        q_des: ArrayLike | None = None,
        dq_des: ArrayLike | None = None,
        ddq_des: ArrayLike | None = None,
        load: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        fresh: ArrayLike | None = None,
        dt: float | None = None,
    ) -> Array:
        """Compute one cycle of all joints.

        All arrays have the shape (n,), in the order of `joints`; numbers of any type. NaN stands for what is not known
        of a single joint.

        Parameters
        ----------
        q : array_like
            Measured positions, rad or m.
        dq : array_like, optional
            Velocities that the robot reports, rad/s or m/s. Only ``compensation.velocity: drive`` needs them.
        tau : array_like, optional
            Torques that the robot reports, N m or N, positive if they drive in the positive direction. Adaptation and
            ``velocity: kalman`` need them.
        q_des, dq_des, ddq_des : array_like, optional
            Demanded motion of this cycle. With ``q_des`` alone the velocity is its change since the last cycle. Without
            ``q_des`` and ``dq_des`` the joint is guided by hand: friction follows from the measured velocity, and fades
            out at rest.
        load : array_like, optional
            Torque that the arm puts on each joint, N m or N, positive if it opposes positive motion: what holds the
            joint at rest. Friction that depends on load follows it; it is no part of the result. By default, and where
            it is NaN, that of ``arm`` in the configuration: weight, and in demanded motion what its inertia takes.
        temperature : array_like, optional
            Measured temperatures, deg C, for models that depend on them.
        fresh : array_like of bool, optional
            False for a joint whose values are not of this cycle; by default all are.
        dt : float, optional
            Time since the last call, s, in whole periods; by default measured. Not above zero, it counts as a period.

        Returns
        -------
        (n,) array
            Friction feed-forward, N m or N, within ``limits.torque`` and ``limits.torque_slew``; add it to your own.
            The buffer is used again by the next call.

        Raises
        ------
        UsageError
            In the first call only: an array is of another shape or no numbers, or one that a setting needs is missing.
        """
        if self._is_busy:  # by another thread: its cycle counts
            self._stop("step was called by two threads at once: it belongs to one")
            return self._out
        self._is_busy, fault = True, WRONG_SHAPE
        try:
            if self._fault is not None:  # whatever another thread's `fade_in` did in the same moment
                self._joints.loop["is_on"] = 0.0
            passed = self._pace.passed(dt)
            if self._pending:
                self._adopt()
            if self._is_plain:
                nothing = self._nothing
                try:
                    if self._find_loads is not None:
                        load = self._loads(passed, (q, q_des, dq_des, ddq_des, load))
                    fault = self._kernel(
                        *self._arrays,
                        passed,
                        0.0 if dq is None else 1.0,
                        0.0 if tau is None else 1.0,
                        q,
                        nothing if dq is None else dq,
                        nothing if tau is None else tau,
                        nothing if q_des is None else q_des,
                        nothing if dq_des is None else dq_des,
                        nothing if ddq_des is None else ddq_des,
                        nothing if load is None else load,
                        nothing if temperature is None else temperature,
                        self._all if fresh is None else fresh,
                    )
                except (TypeError, ValueError):  # arrays of another type; nothing was done yet
                    self._is_plain = False
            if fault < 0:
                given = (q, dq, tau, q_des, dq_des, ddq_des, load, temperature, fresh)
                converted = self._converted(given)
                if self._find_loads is not None:
                    q, q_des, dq_des, ddq_des, load = (converted[2 + k] for k in _OF_THE_ARM)
                    converted[2 + LOAD] = self._loads(passed, (q, q_des, dq_des, ddq_des, load))
                fault = self._kernel(*self._arrays, passed, *converted)
            if fault > 0 and self._fault is None:
                self._stop(fault_of(self._joints, fault))
            self._countdown -= 1
            if self._countdown <= 0:
                self._look()
        except Exception as error:  # whatever it is, the user's loop must go on
            if self._is_first:
                raise
            self._stop(f"the computation failed: {internal_error(error)}", FaultCode.COMPUTATION_FAILED)
            if fault < 0:  # a cycle without feedback and demand: the output fades, and makes no step
                self._out.fill(0.0)
                with suppress(Exception):
                    self._kernel(*self._arrays, 1.0, 0.0, 0.0, *self._blind)
        finally:
            if self._recorder is not None:
                self._recorder.push()
            self._is_busy = False
        return self._out

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of the arrays."""
        return self._joints.names

    @property
    def dynamics(self) -> Arm | None:
        """Dynamics of ``arm`` in the configuration, its joints in the order of `joints`; None without an arm.

        A joint outside of the arm is left out of it.
        """
        return self._joints.arm

    @property
    def period_s(self) -> float:
        """Period of the loop, s."""
        return self._period_s

    @property
    def fault(self) -> str | None:
        """Why the output fades to zero, or has faded; None if nothing is wrong. `fade_in` clears it."""
        return self._fault

    @property
    def notices(self) -> list[str]:
        """What there was to be said so far, oldest first; the last 100."""
        return list(self._notices)

    @property
    def missed(self) -> int:
        """Number of periods without a call of `step` so far."""
        return self._pace.missed

    @property
    def velocity_estimate(self) -> Array:
        """Estimated velocities of the last cycle, (n,), rad/s or m/s, a copy."""
        estimate: Array = self._joints.state["motion"]["velocity"][: len(self._out)].copy()
        return estimate

    @property
    def is_faded_out(self) -> bool:
        """True if no compensation of any joint is left."""
        return all(one.is_faded_out for one in self._joints.compensators)

    def fade_out(self, *joints: str) -> None:
        """Fade the compensation out over ``compensation.fade_s``: that of all joints, or of the ones that are named.

        Parameters
        ----------
        *joints : str
            Names from `joints`; each has a switch of its own beside that of all.

        Raises
        ------
        UsageError
            There is no joint of such a name.
        """
        for k in self._joints.places(joints):
            self._joints.limits[k]["is_wanted"] = 0.0
        if not joints:
            self._joints.loop["is_on"] = 0.0

    def fade_in(self, *joints: str) -> None:
        """Fade the compensation in again: that of all joints, which clears a fault, or of the ones that are named.

        A fault whose cause is still there comes again. A joint that was faded out by its name, or whose
        ``compensation.enabled`` is false, comes back by its name alone.

        Parameters
        ----------
        *joints : str
            Names from `joints`.

        Raises
        ------
        UsageError
            There is no joint of such a name.
        """
        for k in self._joints.places(joints):
            self._joints.limits[k]["is_wanted"] = 1.0
        if not joints:
            for name in ("stale_cycles", "fast_cycles", "reported_cycles"):
                self._joints.limits[name] = 0.0
            self._joints.limits["seen"]["contradictions"] = 0.0
            self._fault = None
            self._joints.loop["is_on"] = 1.0

    def set(self, joint: str, **values: Any) -> None:
        """Change settings of a joint from the next call of `step` on, without a step of torque.

        It takes some milliseconds: call it where the loop rests, or from another thread.

        Parameters
        ----------
        joint : str
            Name from `joints`.
        **values
            Keys of ``compensation`` with their new values, such as ``gain=0.8``, or ``model="elbow.yaml"``.

        Raises
        ------
        UsageError
            There is no such joint or key, or a value is wrong; nothing is changed then.
        """
        self._joints.places((joint,))
        given = {f"{joint}.{key}": value for key, value in values.items()}
        has_network = any(one.model.network is not None for one in self._joints.compensators)
        prepared = prepare(self._values, "set", given, self._joints.facts, {}, has_network=has_network)
        room = self._joints.settings.itemsize
        if any(change and change.record is not None and change.record.itemsize > room for change in prepared.axes):
            raise UsageError(f"{joint}.model has more parameters than there is room for: load it from the start")
        number = self._number = self._number + 1
        entry = entry_of(number, prepared, self._models_of, ", ".join(f"{key} = {each}" for key, each in given.items()))
        self._models_of = {name: axis["model_of"] for name, axis in entry["axes"].items()}
        self._values = prepared.configuration
        self._memory.note_change(entry)
        self._pending.append((number, prepared.axes))

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the recording of the last cycles as the daemon's own MCAP file, one axis a joint.

        ``friction-hil replay --verify`` repeats it bit for bit, and ``identify`` and ``plot`` read it. Call it where
        the loop rests, or from another thread. What is older than ``record_s`` has been dropped; `notices` says so.

        Parameters
        ----------
        path : str or Path
            File to write, ``.mcap``.
        overwrite : bool, optional
            Replace a file that exists.

        Returns
        -------
        Path

        Raises
        ------
        UsageError
            Nothing was recorded, or the name does not end in ``.mcap``.
        FileExistsError
            The file exists, unless ``overwrite``.
        OSError
            It cannot be written.
        """
        path = Path(path)
        if path.suffix != ".mcap":
            raise UsageError(f"{path}: a recording of the compensator is an MCAP file: take the suffix .mcap")
        written, dropped = self._memory.save(path, overwrite=overwrite)
        if dropped:
            seconds = f"{written * self._period_s:.4g} s"
            self._tell(f"{path} has the last {seconds}; the {dropped} cycles before were dropped")
        return path

    def close(self) -> None:
        """End the recording of ``record``, which the end of the program does too; `notices` says what it lacks.

        Call it where the loop rests. `step` goes on, without a recording.
        """
        for problem in self._end_recording() or ():
            self._tell(problem)

    def _tell(self, text: str) -> None:
        """Give a notice, once."""
        if text not in self._told:
            self._told.add(text)
            self._notices.append(text)
            self._memory.note("notice", text)

    def _loads(self, passed: float, given: Sequence[Any]) -> Any:
        """Return the loads, those of the arm where none are given; ``given``: see `_OF_THE_ARM`."""
        made, arrays = self._joints, [self._nothing if each is None else each for each in given]
        own = (made.settings, made.state, made.limits, *made.arm_arrays)
        return made.arm_arrays[-1] if self._find_loads(*own, passed * self._period_s, *arrays) else given[-1]

    def _compile(self) -> None:
        """Compile a cycle, and see to it that no array of another type is compiled for in the loop."""
        self._kernel.disable_compile(False)
        for _ in range(2):
            copies = (each[: 2 * len(self._out)].copy() for each in self._arrays)
            self._kernel(*copies, 1.0, 0.0, 0.0, *[self._nothing] * (len(GIVEN) - 1), self._all)
        self._kernel.disable_compile()
        if self._find_loads is not None:
            self._find_loads.disable_compile(False)
            self._loads(1.0, [self._nothing] * len(_OF_THE_ARM))
            self._find_loads.disable_compile()

    def _stop(self, text: str, code: FaultCode | None = None) -> None:
        """Let all joints fade out, and say why."""
        self._joints.loop["is_on"] = 0.0
        if self._fault is None:
            self._fault = text if code is None else code.append_to(text)
            self._memory.note("fault", self._fault)

    def _converted(self, given: Sequence[Any]) -> list[Any]:
        """Return the last arguments of the kernel from what is given, checked and converted.

        Raises `UsageError` in the first call; later what is wrong is a fault, and neither feedback nor demand is used.
        """
        try:
            nothing = [*[self._nothing] * (len(GIVEN) - 1), self._all]
            arrays = [
                usual if value is None else as_array(name, value, self.joints)
                for name, value, usual in zip(GIVEN, given, nothing, strict=True)
            ]
            if self._is_first:
                check_first(self._joints, given)
                self._memory.begin()
                self._is_first = False
                self._is_plain = True
        except Exception as error:
            if self._is_first:
                raise
            self._stop(str(error) if isinstance(error, UsageError) else internal_error(error))
            arrays = self._blind
        return [float(given[DQ] is not None), float(given[TAU] is not None), *arrays]

    def _adopt(self) -> None:
        """Take what `set` has prepared, one change a cycle: a recorded row has the number of one."""
        number, changes = self._pending.popleft()
        adopt(self._joints, number, changes)
        for k, change in enumerate(changes):
            if change is not None and change.friction is not None:
                self._tellers[k].renew(self._joints.compensators[k])

    def _look(self) -> None:
        """Give what notices there are; every quarter of a second."""
        self._countdown = self._looks
        for problem in () if self._recorder is None else self._recorder.tend():
            self._tell(problem)
        estimates, given = self._joints.state["motion"]["velocity"], self._joints.limits["temperature"]
        for k, (teller, one) in enumerate(zip(self._tellers, self._joints.compensators, strict=True)):
            if text := teller.next(one, estimates.item(k), given.item(k)):
                self._tell(text)
        for text in self._pace.remarks():
            self._tell(text)
        if not self._joints.loop["has_begun"]:
            if self._pace.calls * self._period_s > _PATIENCE_S:
                places = np.flatnonzero(np.isnan(self._joints.limits["position"]))
                text = f"no position of {', '.join(self.joints[k] for k in places)} so far: nothing is compensated yet"
                self._tell(FaultCode.FIRST_FEEDBACK_MISSING.append_to(text))
        elif self._pace.calls >= self._looks:
            text, is_fault = self._pace.judge()
            if is_fault:
                self._stop(text)
            elif text and not self._is_period_told:
                self._is_period_told = True
                self._tell(text)
