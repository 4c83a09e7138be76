"""Checks of the machine, on system files that a test provides."""

import os
from pathlib import Path

import pytest

from friction_hil.doctor import machine
from friction_hil.numerics import jit
from tests.system_files import lay

VERSION = "proc__sys__kernel__version"


@pytest.mark.parametrize(
    ("files", "result", "text"),
    [
        ({VERSION: "#1 SMP PREEMPT_RT Debian 6.1.76-1 (2024-02-01)\n"}, "pass", "PREEMPT_RT"),
        ({VERSION: "#1 SMP PREEMPT RT Debian 4.19.1\n"}, "pass", "PREEMPT_RT"),
        ({VERSION: "#1 SMP Debian\n", "sys__kernel__realtime": "1\n"}, "pass", "PREEMPT_RT"),
        ({VERSION: "#1 SMP PREEMPT_DYNAMIC Debian\n", "sys__kernel__realtime": "0\n"}, "warn", "(PREEMPT_DYNAMIC)"),
        (
            {
                VERSION: "#1 SMP PREEMPT_DYNAMIC Debian\n",
                "sys__kernel__debug__sched__preempt": "none (voluntary) full\n",
            },
            "warn",
            "(PREEMPT_DYNAMIC, set to voluntary)",
        ),
        ({VERSION: "#1 SMP PREEMPT Debian\n"}, "warn", "(PREEMPT)"),
        ({VERSION: "#1 SMP Debian 5.10 (2021-01-01)\n"}, "warn", "(not preemptible)"),
        ({}, "warn", "preemption model: not reported by this system"),
    ],
)
def test_the_preemption_model(tmp_path, files, result, text):
    found = machine.preemption(lay(tmp_path, **files))
    assert found.result == result
    assert text in found.detail
    assert bool(found.fix) == (result != "pass")


def governors(root, *names):
    for number, name in enumerate(names):
        lay(root, **{f"sys__devices__system__cpu__cpu{number}__cpufreq__scaling_governor": f"{name}\n"})
    lay(root, sys__devices__system__cpu__cpufreq__boost="1\n")  # beside them, and no processor
    return root


def test_processors_that_never_slow_down_pass(tmp_path):
    found = machine.processor_clock(governors(tmp_path, "performance", "performance"))
    assert (found.result, found.detail) == ("pass", "frequency governor: performance (2 processors)")


def test_one_processor_that_slows_down_is_enough_for_a_warning(tmp_path):
    found = machine.processor_clock(governors(tmp_path, "performance", "powersave", "performance"))
    assert found.result == "warn"
    assert "performance (2 processors), powersave (1 processors)" in found.detail
    assert "echo performance" in found.fix


def test_an_unknown_governor_is_a_warning(tmp_path):
    found = machine.processor_clock(governors(tmp_path))
    assert found.result == "warn"
    assert "not reported by this system" in found.detail


def test_compiled_kernels(tmp_path):
    assert machine.compiled_kernels(None).result == "warn"
    assert "XDG_CACHE_HOME" in machine.compiled_kernels(None).fix
    assert "none yet" in machine.compiled_kernels(str(tmp_path)).detail
    lay(tmp_path, a__kernel__nbi="", **{"a__step.1.nbc": "", "b__run.1.nbc": ""})
    found = machine.compiled_kernels(str(tmp_path))
    assert (found.result, found.detail) == ("pass", f"2 are kept in {tmp_path}")


def test_a_user_without_a_home_keeps_no_kernels_and_starts_all_the_same(monkeypatch):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

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
