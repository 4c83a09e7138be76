"""A run of the daemon from its configuration: creates driver, axes, companion and loop, and closes them."""

import contextlib
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.compensator import Compensator, CompensatorSettings
from friction_hil.compensator.records import place
from friction_hil.config import RecordingConfig, self_contained
from friction_hil.config.drivers import load_driver
from friction_hil.config.load import only_driver
from friction_hil.daemon.arm import ArmTorques
from friction_hil.daemon.assembly import experiment_note, ramp_s
from friction_hil.daemon.axis import AxisLoop
from friction_hil.daemon.companion import Companion, CompanionReport, Job, free_path, prepare, state_folder
from friction_hil.daemon.companion.client import ring_of
from friction_hil.daemon.companion.paths import series_name
from friction_hil.daemon.control.job import ControlJob
from friction_hil.daemon.control.journal import JournalReader, make_journal, read_only
from friction_hil.daemon.control.lock import ControlSocket
from friction_hil.daemon.control.packed import room
from friction_hil.daemon.figures import AxisFigures, Condition, FollowingErrors
from friction_hil.daemon.follower import FollowerAxis
from friction_hil.daemon.learning_board import LearningBoard, first_report
from friction_hil.daemon.learning_service import LearningService
from friction_hil.daemon.log import LoopResult, Sink
from friction_hil.daemon.loop import Loop
from friction_hil.daemon.notices import adaptation_notice
from friction_hil.daemon.notify import NotifyingSink, ServiceManager
from friction_hil.daemon.processes import LEARNING, control_server, learning_process, live_server
from friction_hil.daemon.realtime import RealClock, SteppedClock, punctuality
from friction_hil.daemon.run import LoopSettings
from friction_hil.daemon.static_torque import largest_weights, static_torque_note
from friction_hil.daemon.stop import StopRequest
from friction_hil.daemon.supervisor import Beside
from friction_hil.daemon.uncertainty import uncertainty_table
from friction_hil.drive import AxisFacts, Clock, Drives, FaultCode, unit_table
from friction_hil.drive.finding import complaints
from friction_hil.models import create
from friction_hil.motion.trajectory import PathTime
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import POSITION_UNITS
from friction_hil.recordings import columns
from friction_hil.recordings.fingerprint import fingerprint

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration

_PASSIVE_STALE_S = 1.0
_LOOK_S = 0.05
_ROOM_S = 10.0
_CYCLE = columns.NAMES.index(columns.CYCLE)


@dataclass(frozen=True, slots=True)
class SessionSettings:
    """Settings that the command line adds to a configuration.

    ``allowed_speeds`` are those of the motions that the user was told of, by axis, rad/s or m/s; see
    `friction_hil.daemon.safety.Supervisor.allow`. ``is_waiting`` is that of `LoopSettings`. ``control`` is the socket
    at which the daemon is changed while it runs; None for none.
    """

    duration_s: float = math.inf
    record: Path | None = None
    is_overwrite_allowed: bool = False
    dry_run: bool = False
    is_fault_reset_wanted: bool = False
    is_paced_by_sync: bool = False
    is_status_shown: bool = False
    status_title: str = ""  # of a run of known duration that is part of something longer
    has_black_box: bool = True  # a file for each fault, with the minute before it
    allowed_speeds: Mapping[str, float] = field(default_factory=dict)
    is_waiting: bool = False
    control: ControlSocket | None = None


@dataclass(slots=True)
class SessionResult:
    """Result of a run."""

    loop: LoopResult
    axes: dict[str, AxisFigures] = field(default_factory=dict)
    report: CompanionReport | None = None
    learning: dict[str, Any] = field(default_factory=dict)


class _CompanionSink:
    """Sink that hands rows to the companion, and looks after it; in simulated time it waits for room for a row."""

    def __init__(
        self,
        companion: Companion,
        period_s: float,
        learning: LearningService | None,
        journal: JournalReader | None,
        *,
        is_real: bool,
    ) -> None:
        self._learning, self._journal = learning, journal
        self._companion = companion
        self.event = companion.push_event
        self._is_real = is_real
        self._looks = max(1, round(_LOOK_S / period_s))  # rows between two looks at the companion
        self._left = self._looks
        self._is_patient = True

    def push(self, row: Array) -> None:
        if not (self._is_real or self._companion.free_slots()):
            self._wait_for_room(row)
        self._companion.push(row)
        self._left -= 1
        if not self._left:
            self._look(row)
        if not self._is_real and self._learning is not None and self._journal is not None:
            journal = self._journal
            said = self._learning.await_tick(int(row[_CYCLE]), lambda: journal.has_news, lambda: self._look(row))
            if said:
                self._companion.push_event(row[_CYCLE], "notice", said)

    def _look(self, row: Array) -> None:
        """Take what has happened beside the loop into the recording."""
        self._left = self._looks
        for name, text in self._companion.tend():
            self._companion.push_event(row[_CYCLE], name, text)
        if self._learning is not None and LEARNING in self._companion.over:
            self._learning.give_up()

    def _wait_for_room(self, row: Array) -> None:
        """Wait until a row would not be lost, but not forever: the axes have to come to rest all the same."""
        end_s = time.monotonic() + (_ROOM_S if self._is_patient else 0.0)
        while not (room := self._companion.free_slots()) and time.monotonic() < end_s:
            self._look(row)
            if self._companion.is_given_up:
                break
            time.sleep(0.001)
        self._is_patient = room > 0


def run_session(
    configuration: "Configuration",
    settings: SessionSettings,
    stop: StopRequest,
    report: Callable[[str], None],
) -> SessionResult:
    """Run the daemon until its duration is over, ``stop`` is requested, or a fault has been dealt with.

    ``stop`` may be set at any time, from a signal handler. ``report`` is called with lines for the user; not during the
    cyclic phase. Raises `FrictionHilError`, before anything has moved: the bus, a drive or the recording is not usable
    (later faults are in the result); `Interrupted`: a signal came before anything was enabled.
    """
    clock: Clock = SteppedClock() if settings.is_paced_by_sync else RealClock(configuration.realtime.spin_us)
    with contextlib.ExitStack() as stack:
        with stop.raised():
            prepared = _prepare(configuration, settings, clock, stack, report)
        axes, companion = prepared.axes, prepared.companion
        try:
            result = _run(prepared, configuration, settings, clock, stop, report)
        finally:
            recorded = companion.close()
            learned = {} if prepared.board is None else prepared.board.report()
    for axis in axes:
        unit = POSITION_UNITS[configuration.axes[axis.name].model.axis]
        if notice := adaptation_notice(axis.name, unit, axis.compensator):
            result.notices.append(notice)
    figures = {axis.name: _figures(axis, configuration.axes[axis.name], configuration.period_s) for axis in axes}
    return SessionResult(result, figures, recorded, learned)


@dataclass(frozen=True, slots=True)
class _Prepared:
    """What a run needs, before anything is enabled."""

    drives: Drives
    axes: list[AxisLoop]
    path_time: PathTime
    companion: Companion
    journal: JournalReader | None
    board: LearningBoard | None


def _prepare(
    configuration: "Configuration",
    settings: SessionSettings,
    clock: Clock,
    stack: contextlib.ExitStack,
    report: Callable[[str], None],
) -> _Prepared:
    """Connect the drives, compile the axes, start the companion; ``stack`` closes what was opened."""
    realtime = configuration.realtime
    started_ns = 0 if settings.is_paced_by_sync else time.time_ns()
    path = _recording_path(configuration, settings, started_ns)
    if path is not None:
        prepare(path, overwrite=settings.is_overwrite_allowed)  # report a wrong path before any drive is touched
    driver = load_driver(only_driver(configuration))
    drives = driver.drives_for(configuration, configuration.axes, clock, dry_run=settings.dry_run)
    stack.callback(_close, drives, report)
    facts, weights = drives.connect(), largest_weights(configuration)
    for fact in facts:
        report(f"{fact.name}: {fact.identity}")
        for line in unit_table(fact.name, fact.units):
            report(line)
        for note in (*fact.notes, *configuration.axes[fact.name].model.friction_model.notes):
            report(f"{fact.name}: {note}")
        if note := static_torque_note(configuration.axes[fact.name], weights.get(fact.name)):
            report(f"{fact.name}: {note}")
    path_time = PathTime(ramp_s(configuration.axes.values()))
    shadows = sorted({shadow.name for axis in configuration.axes.values() for shadow in axis.shadows})
    max_stale = realtime.max_missed
    if drives.is_passive:  # the feedback comes when another master asks for it
        max_stale = max(max_stale, math.ceil(_PASSIVE_STALE_S / configuration.period_s))
    make_axis = FollowerAxis if drives.is_follower else AxisLoop
    axes = [
        make_axis(
            fact.name,
            configuration.axes[fact.name],
            fact,
            configuration.period_s,
            path_time,
            shadows,
            max_stale,
            is_of_arm=fact.name in weights,
        )
        for fact in facts
    ]
    for axis in axes:
        if axis.name in settings.allowed_speeds:
            axis.supervisor.allow(settings.allowed_speeds[axis.name])
    for fact in facts:  # before anything moves
        note = experiment_note(configuration.axes[fact.name], fact.position_resolution, configuration.period_s)
        if note:
            report(f"{fact.name}: {note}")
    job = _job(configuration, settings, path, started_ns, facts, axes, shadows)
    ring = ring_of(job)
    others: list[Beside] = []
    journal = board = None
    recorded = -1  # the journal, for the companion
    if settings.control is not None:
        name, control_job = settings.control.path.stem, _control_job(configuration, settings, drives, facts, job)
        if control_job.has_network:
            _compile_plain(configuration.period_s)
        journal = JournalReader(make_journal(room(len(facts))))  # brings the changes to the loop
        stack.callback(os.close, journal.descriptor)
        recorded = read_only(journal.descriptor)
        stack.callback(os.close, recorded)
        learned = {}
        for axis_name, axis_config in configuration.axes.items():
            own, unit = axis_config.compensation, POSITION_UNITS[axis_config.model.axis]
            if own.learning != "off":
                learned[axis_name] = first_report(own.learning, unit, own.gain)
        if learned:
            board = LearningBoard()
            board.say(-1, {"axes": learned})
            stack.callback(board.close)
            others.append(learning_process(settings.control.path, board, is_simulated=settings.is_paced_by_sync))
        given = [settings.control.descriptor, ring.descriptor, journal.descriptor]
        others.insert(0, control_server(control_job, [*given, -1 if board is None else board.descriptor], stack))
        if configuration.live is not None:
            others.insert(1, live_server(name, configuration.live, stack))
    companion = Companion.start(job, recorded, others, ring)
    stack.callback(companion.close)
    return _Prepared(drives, axes, path_time, companion, journal, board)


def _compile_plain(period_s: float) -> None:
    """Compile the step for models without a network: one may take the place of a model that has one."""
    settings = CompensatorSettings(period_s, 1e-6, 1.0)
    Compensator(create("coulomb", coulomb=0.0), settings).compile()


def _control_job(
    configuration: "Configuration", settings: SessionSettings, drives: Drives, facts: Sequence[AxisFacts], job: Job
) -> ControlJob:
    """Return what the process of the control socket has to know."""
    assert settings.control is not None
    models = [axis.model for axis in configuration.axes.values()]
    models += [shadow.model for axis in configuration.axes.values() for shadow in axis.shadows]
    files = {name: axis.model.source_path for name, axis in configuration.axes.items()}
    return ControlJob(
        name=settings.control.path.stem,
        configuration=job.metadata["configuration"],
        source=str(configuration.source_path or "configuration"),
        facts=[asdict(fact) for fact in facts],
        columns=job.columns,
        state_width=job.state_width,
        has_network=any(model.friction_model.network is not None for model in models),
        is_follower=configuration.bus is not None and configuration.bus.role == "sidecar",
        files={name: str(file) for name, file in files.items() if file is not None},
        started_unix_ns=job.started_unix_ns,
        ramp_s=ramp_s(configuration.axes.values()),
        remedies={str(code): code.remedy for code in FaultCode} | dict(drives.remedies),
    )


def _run(
    prepared: _Prepared,
    configuration: "Configuration",
    settings: SessionSettings,
    clock: Clock,
    stop: StopRequest,
    report: Callable[[str], None],
) -> LoopResult:
    """Run the loop, from enabling the drives to disabling them."""
    realtime = configuration.realtime
    with punctuality(0 if settings.is_paced_by_sync else realtime.priority) as findings:
        for line in complaints(findings):
            report(line)
        loop_settings = LoopSettings(
            period_s=configuration.period_s,
            duration_s=settings.duration_s,
            max_missed=realtime.max_missed,
            enable_timeout_s=configuration.enable_timeout_s,
            dry_run=settings.dry_run,
            is_fault_reset_wanted=settings.is_fault_reset_wanted,
            is_follower=prepared.drives.is_follower,
            is_waiting=settings.is_waiting,
        )
        journal, board = prepared.journal, prepared.board
        period_s, is_simulated = configuration.period_s, settings.is_paced_by_sync
        learning = None if board is None else LearningService(board, period_s, is_simulated=is_simulated)
        sink: Sink = _CompanionSink(prepared.companion, period_s, learning, journal, is_real=clock.is_real)
        with contextlib.ExitStack() as stack:
            if manager := ServiceManager.from_environment(os.environ):
                stack.callback(manager.close)
                stack.callback(manager.stopping)
                sink = NotifyingSink(sink, manager, configuration.period_s)
            axes, path_time = prepared.axes, prepared.path_time
            arm = None if configuration.arm is None else ArmTorques(configuration.arm, axes)
            return Loop(prepared.drives, axes, path_time, clock, sink, loop_settings, stop, journal, arm).run()


def _close(drives: Drives, report: Callable[[str], None]) -> None:
    """Leave the bus, and tell what the driver could not leave as it was found, or does not know of that."""
    drives.close()
    for line in (*drives.leftovers, *drives.remarks):
        report(line)


def _figures(axis: AxisLoop, config: "AxisConfig", period_s: float) -> AxisFigures:
    """Return the figures of the axis, with those of its load where that has an encoder."""
    return replace(
        _figures_of(axis.following.errors, axis, config, period_s),
        bridged=axis.gaps.bridged,
        bridged_reasons=axis.gaps.reasons,
        load=None if axis.load is None else _figures_of(axis.load.errors, axis, config, period_s),
    )


def _figures_of(errors: FollowingErrors, axis: AxisLoop, config: "AxisConfig", period_s: float) -> AxisFigures:
    age_s = axis.facts.setpoint_age_s
    configured = (axis.facts.setpoint_delay_s + (age_s or 0.0)) / period_s
    # in cst no set-point is sent
    later = 0.0 if config.mode == "cst" or age_s is None else errors.delay(configured)
    return AxisFigures(
        unit=POSITION_UNITS[config.model.axis],
        without=errors.figures(Condition.WITHOUT, later),
        compensated=errors.figures(Condition.WITH, later),
        is_comparable=config.trajectory.kind not in ("experiment", "multisine", "sequence"),
        stale=axis.gaps.stale,
        taken_back=axis.following.taken_back,
        configured_delay=configured,
        delay=configured + later if later else math.nan,
        lacks_demand=axis.lacks_demand,
    )


def _recording_path(configuration: "Configuration", settings: SessionSettings, started_ns: int) -> Path | None:
    if settings.record is None and configuration.recording is not None and configuration.recording.path is not None:
        return free_path(configuration.recording.path, started_ns)
    return settings.record


def _series(configuration: "Configuration", settings: SessionSettings) -> str:
    wanted = settings.record or (configuration.recording and configuration.recording.path)
    name = None if settings.control is None else settings.control.path.stem
    return series_name(configuration.source_path, wanted or Path("run.mcap"), name)


def _black_box_path(configuration: "Configuration", path: Path | None) -> Path:
    """Return the path from which those of the files of faults are made."""
    folder = None if configuration.recording is None else configuration.recording.black_box
    source = configuration.source_path
    name = f"{'run' if source is None else source.stem}.mcap" if path is None else path.name
    if folder is None:
        folder = state_folder() if path is None else path.parent
    return folder / name


def _job(
    configuration: "Configuration",
    settings: SessionSettings,
    path: Path | None,
    started_ns: int,
    facts: Sequence[AxisFacts],
    axes: Sequence[AxisLoop],
    shadows: Sequence[str],
) -> Job:
    """Return the job of the companion: what to record and to show."""
    recording = configuration.recording or RecordingConfig()
    return Job(
        axes=[axis.name for axis in axes],
        columns=[*columns.NAMES, *(columns.shadow(name) for name in shadows)],
        state_width=max(axis.state_width for axis in axes),
        period_s=configuration.period_s,
        started_unix_ns=started_ns,
        path=None if path is None else str(path),
        overwrite=settings.is_overwrite_allowed,
        metadata={
            "configuration": self_contained(configuration),
            "facts": [{**asdict(fact), "lead_s": axis.lead_s} for fact, axis in zip(facts, axes, strict=True)],
            "fingerprint": fingerprint(),
        },
        status_line=settings.is_status_shown,
        status_title=f"{settings.status_title}, of {settings.duration_s:.0f} s" if settings.status_title else "",
        kinds=[configuration.axes[axis.name].model.axis for axis in axes],
        rotate_s=recording.rotate_s,
        rotate_bytes=recording.rotate_bytes,
        budget_bytes=recording.budget_bytes,
        series=_series(configuration, settings),
        black_box=str(_black_box_path(configuration, path)) if settings.has_black_box else None,
        has_joint_states=recording.ros,
        uncertainty={name: table for name, axis in configuration.axes.items() if (table := uncertainty_table(axis))},
        factors=[place(name) for name in ("fade", "standstill_fade", "limit_cycle.gain_factor")],
    )
