"""Checks of the machine, on system files that a test provides."""

import os
import re
from pathlib import Path

import pytest

from friction_hil.doctor import machine
from friction_hil.numerics import jit
from tests.system_files import lay

VERSION, REALTIME = "proc__sys__kernel__version", "sys__kernel__realtime"


def governors(*names):
    cpus = "sys__devices__system__cpu__"
    files = {f"{cpus}cpu{k}__cpufreq__scaling_governor": f"{name}\n" for k, name in enumerate(names)}
    return files | {f"{cpus}cpufreq__boost": "1\n"}  # beside them, and no processor


PREEMPT = "sys__kernel__debug__sched__preempt"


@pytest.mark.parametrize(
    ("check", "files", "words"),
    [
        (machine.preemption, {VERSION: "#1 SMP PREEMPT_RT Debian 6.1.76-1 (2024-02-01)\n"}, "pass: .*PREEMPT_RT"),
        (machine.preemption, {VERSION: "#1 SMP PREEMPT RT Debian 4.19.1\n"}, "pass: .*PREEMPT_RT"),
        (machine.preemption, {VERSION: "#1 SMP Debian\n", REALTIME: "1\n"}, "pass: .*PREEMPT_RT"),
        (machine.preemption, {VERSION: "#1 SMP PREEMPT_DYNAMIC\n", REALTIME: "0\n"}, r"warn: .*\(PREEMPT_DYNAMIC\)"),
        (
            machine.preemption,
            {VERSION: "#1 SMP PREEMPT_DYNAMIC Debian\n", PREEMPT: "none (voluntary) full\n"},
            r"warn: .*\(PREEMPT_DYNAMIC, set to voluntary\)",
        ),
        (machine.preemption, {VERSION: "#1 SMP PREEMPT Debian\n"}, r"warn: .*\(PREEMPT\)"),
        (machine.preemption, {VERSION: "#1 SMP Debian 5.10 (2021-01-01)\n"}, r"warn: .*\(not preemptible\)"),
        (machine.preemption, {}, "warn: .*not reported"),
        (machine.processor_clock, governors("performance", "performance"), r"pass: .*: performance \(2 processors\) "),
        (
            machine.processor_clock,
            governors("performance", "powersave", "performance"),
            r"warn: .*performance \(2 processors\), powersave \(1 processors\).* -> .*echo performance",
        ),
        (machine.processor_clock, governors(), "warn: .*not reported"),
    ],
)
def test_what_the_kernel_tells_of_preemption_and_clock_is_judged(tmp_path, check, files, words):
    found = check(lay(tmp_path, **files))
    assert re.match(words, f"{found.result}: {found.detail} -> {found.fix}")
    assert bool(found.fix) == (found.result != "pass")


def test_compiled_kernels(tmp_path):
    assert machine.compiled_kernels(None).result == "warn"
    assert "XDG_CACHE_HOME" in machine.compiled_kernels(None).fix
    assert "none yet" in machine.compiled_kernels(str(tmp_path)).detail
    lay(tmp_path, a__kernel__nbi="", **{"a__step.1.nbc": "", "b__run.1.nbc": ""})
    found = machine.compiled_kernels(str(tmp_path))
    assert (found.result, found.detail) == ("pass", f"2 are kept in {tmp_path}")


def test_a_user_without_a_home_keeps_no_kernels_and_starts_all_the_same(monkeypatch):
    def no_home():
        raise RuntimeError

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    assert jit.cache_folder.__wrapped__() is None


def test_processes_that_start_at_the_same_time_all_keep_their_kernels(monkeypatch, tmp_path):
    make = Path.mkdir

    def make_second(path, *arguments, **options):
        os.makedirs(path, exist_ok=True)  # by another process, just before
        make(path, *arguments, **options)

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(Path, "mkdir", make_second)
    folder = jit.cache_folder.__wrapped__()
    assert folder is not None
    assert Path(folder).is_dir()


def test_kernels_of_every_room_decide_which_compiled_code_is_current():
    names = {path.parent.name for path in jit.kernel_sources()}
    assert {"friction", "compensator", "servo", "motion", "training"} <= names
