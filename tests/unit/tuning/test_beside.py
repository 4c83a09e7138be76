"""Computing beside the motion gives what computing at standstill gives, and leaves the loop its processor."""

import os
import pickle
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from friction_hil.errors import RecordingError
from friction_hil.identification.least_squares import FitError
from friction_hil.recordings import Recording
from friction_hil.tuning.analysis import analysed, compile_ahead
from friction_hil.tuning.beside import Worker
from tests.unit.tuning.test_tuning_sequential import machine, part

FAMILIES = ("coulomb", "stribeck")


def silent(*_):
    """A step that nobody looks at."""


def submitted(worker, parts):
    return worker.submit(analysed, machine(), FAMILIES, parts, [], {}, None)


def children():
    """Return the numbers of the child processes; others than the worker may be there."""
    own = os.getpid()
    return set(map(int, Path(f"/proc/{own}/task/{own}/children").read_text().split()))


def niceness_of_session(process):
    """Return what counts between sessions; None where the kernel does not weigh them."""
    file = Path(f"/proc/{process}/autogroup")
    return int(file.read_text().split()[-1]) if file.exists() else None


def test_a_worker_finds_the_same_bits_and_tells_its_steps() -> None:
    parts, steps = [part(seed=1), part(seed=2)], []
    with Worker() as worker:
        worker.submit(compile_ahead, machine(), FAMILIES[:1], parts[0])
        found = worker.result(submitted(worker, parts), lambda *step: steps.append(step))
    here = analysed(machine(), FAMILIES, parts, [], {}, None, silent)
    assert [(each.reason, each.notes) for each in found.found] == [(each.reason, each.notes) for each in here.found]
    for one, other in zip(found.found[0].fits, here.found[0].fits, strict=True):
        assert (one.label, one.values, one.inference.standard_errors) == (
            other.label,
            other.values,
            other.inference.standard_errors,
        )
        assert one.estimate.residual.tobytes() == other.estimate.residual.tobytes()
    assert (found.mechanics.lines, found.unrehearsed) == (here.mechanics.lines, here.unrehearsed)
    assert [(each.label, each.reductions) for each in found.rehearsed] == [
        (each.label, each.reductions) for each in here.rehearsed
    ]
    assert all(each.fit in each.identification.fits for each in found.rehearsed)
    assert steps


def test_while_axes_move_a_worker_has_the_lowest_priority_and_leaves_a_processor() -> None:
    every, others = os.sched_getaffinity(0), children()
    with Worker() as worker:
        number = submitted(worker, [part()])
        [process] = children() - others
        with worker.aside():
            left = [os.sched_getaffinity(int(each)) for each in os.listdir(f"/proc/{process}/task")]
            assert all(len(each) == max(len(every) - 1, 1) for each in left)
            assert niceness_of_session(process) in (None, 19)
        worker.result(number, silent)
        assert os.sched_getaffinity(process) == every
        assert niceness_of_session(process) in (None, 0)
        assert os.sched_getscheduler(process) == os.SCHED_IDLE
        assert os.getpriority(os.PRIO_PROCESS, process) == 19
    assert not Path(f"/proc/{process}").exists()


@pytest.mark.parametrize("is_killed", [False, True])
def test_what_cannot_be_identified_is_said_and_a_lost_worker_costs_time_only(is_killed) -> None:
    good = part()
    still = Recording("still.mcap", "x", dict(good.recording.columns), good.recording.metadata)
    still.columns["position"] = np.zeros(len(still))
    others = children()
    with Worker() as worker:
        number = submitted(worker, [replace(good, recording=still)])
        [process] = children() - others
        if is_killed:
            os.kill(process, signal.SIGKILL)
        with pytest.raises(RecordingError) as error:
            worker.result(number, silent)
    with pytest.raises(RecordingError) as here:
        analysed(machine(), FAMILIES, [replace(good, recording=still)], [], {}, None, silent)
    assert str(error.value) == str(here.value)
    assert pickle.loads(pickle.dumps(error.value)).args == error.value.args


def test_a_job_that_is_replaced_is_computed_with_its_new_arguments_and_others_are_not_lost() -> None:
    others = children()
    with Worker() as worker:
        jobs = [worker.submit("{0}".format, k) for k in (1, 2)]
        assert worker.result(jobs[0], silent) == "1"
        [former] = children() - others
        worker.replace(jobs[0], 3)
        [process] = children() - others
        assert process != former
        assert [worker.result(job, silent) for job in jobs] == ["3", "2"]


@pytest.mark.parametrize(
    "error", [np.linalg.LinAlgError("singular"), FitError("not finite"), RecordingError("no loop")]
)
def test_what_fails_in_closed_loop_costs_these_models_and_no_others(error, monkeypatch) -> None:
    def failing(*_):
        raise error

    monkeypatch.setattr("friction_hil.tuning.analysis.closed_loop_starts", failing)
    found = analysed(machine(), ("coulomb",), [part(seed=1)], [], {}, None, silent)
    [problem] = [each for each in found.problems if "closed loop" in each]
    assert str(error) in problem
    assert [each.best.structure.family for each in found.found] == ["coulomb"]
