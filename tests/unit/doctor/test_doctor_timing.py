"""What delays a loop, as the files of Linux tell: each obstacle has its remedy, and what is unknown never passes."""

import os
import re
from pathlib import Path
from types import SimpleNamespace

import pytest

from friction_hil.doctor import checks, disk, machine, timing
from friction_hil.numerics import jit
from tests.system_files import lay

CPU = "sys__devices__system__cpu__"
IDLE = f"{CPU}cpu{{}}__cpuidle__state{{}}__"
IRQ = "proc__irq__{}__"


def told(finding):
    assert bool(finding.fix) == bool(finding.code) == (finding.result != "pass")
    return f"{finding.result} {finding.code}: {finding.detail} -> {finding.fix}"


def sleeping(*disabled):
    """Two processors with four sleep states, those of these numbers switched off."""
    states, files = (("POLL", "0"), ("C1", "2"), ("C6", "133"), ("C10", "890")), {}
    for cpu in range(2):
        for k, (name, latency) in enumerate(states):
            at = IDLE.format(cpu, k)
            files |= {f"{at}name": name, f"{at}latency": latency, f"{at}disable": f"{int(k in disabled)}\n"}
    return files


def scheduler(runtime):
    return {"proc__sys__kernel__sched_rt_runtime_us": runtime, "proc__sys__kernel__sched_rt_period_us": "1000000"}


ARRIVING = {
    IRQ.format(24) + "smp_affinity_list": "0-3",  # allowed everywhere, and delivered to 0
    IRQ.format(24) + "effective_affinity_list": "0",
    IRQ.format(25) + "smp_affinity_list": "0-2",
    "proc__irq__default_smp_affinity": "f",
}
MORE = {**ARRIVING, IRQ.format(126) + "smp_affinity_list": "3"}
ISOLATED = f"{CPU}isolated"
CLOCK = "sys__devices__system__clocksource__clocksource0__{}_clocksource"
CURRENT, AVAILABLE = CLOCK.format("current"), CLOCK.format("available")
isolation, sleep_states, load = timing.isolation, timing.sleep_states, timing.processor_load


@pytest.mark.parametrize(
    ("check", "given", "files", "words"),
    [
        (isolation, {0}, {}, "warn FH-317: "),
        (isolation, {0}, {ISOLATED: "\n"}, "warn FH-316: (?!.*taskset -c 0).*two processors or more"),
        (isolation, {0}, {ISOLATED: "\n", f"{CPU}online": "0-1\n"}, "warn FH-316: .*-> boot with isolcpus=1 "),
        (isolation, {0, 1}, {ISOLATED: "2-3\n"}, "warn FH-318: .*taskset -c 2"),
        (isolation, {3}, {ISOLATED: "2-3\n"}, "pass : .*processors 2, 3"),
        (isolation, {0}, {ISOLATED: "what is this"}, "warn FH-317: "),
        (timing.interrupts, None, {}, "warn FH-320: "),
        (timing.interrupts, None, {ISOLATED: "3", **ARRIVING}, "pass : "),
        (timing.interrupts, None, {ISOLATED: "3", **MORE}, "warn FH-319: 1 of 3 .*: 126"),
        (timing.interrupts, None, {ISOLATED: "", **MORE}, "warn FH-319: .* 3 interrupts"),
        (timing.throttling, 0.99, scheduler("-1"), "pass : "),
        (timing.throttling, 0.2, scheduler("950000"), "pass : "),
        (timing.throttling, 0.6, scheduler("950000"), "warn FH-321: "),
        (timing.throttling, 0.2, scheduler("500000"), "warn FH-321: "),
        (timing.throttling, 0.2, scheduler(""), "warn FH-322: "),
        (timing.throttling, 0.2, {}, "warn FH-322: "),
        (sleep_states, True, {}, "warn FH-324: "),
        (sleep_states, True, sleeping(3), "pass : "),
        (sleep_states, False, sleeping(3), "warn FH-323: .*C6, takes 133 µs"),
        (sleep_states, False, sleeping(2, 3), "pass : "),
        (timing.clock_source, None, {}, "warn FH-328: "),
        (timing.clock_source, None, {CURRENT: "tsc\n", AVAILABLE: "tsc hpet acpi_pm \n"}, "pass : tsc -> "),
        (timing.clock_source, None, {CURRENT: "hpet\n", AVAILABLE: "tsc hpet acpi_pm \n"}, "warn FH-327: .*echo tsc >"),
        (timing.clock_source, None, {CURRENT: "hpet\n", AVAILABLE: "hpet acpi_pm"}, "warn FH-327: .*dmesg"),
        (load, {0, 1}, {}, "warn FH-332: "),
        (load, {0, 1}, {"proc__loadavg": ""}, "warn FH-332: "),
        (load, {0, 1}, {"proc__loadavg": "nonsense 1 2"}, "warn FH-332: "),
        (load, {0, 1}, {"proc__loadavg": "1.40 9.00 9.00 2/345 6789\n"}, "pass : "),
        (load, {0, 1}, {"proc__loadavg": "1.80 9.00 9.00 2/345 6789\n"}, "warn FH-331: "),
        (load, {1}, {"proc__loadavg": "1.40 9.00 9.00 2/345 6789\n"}, "warn FH-331: "),  # it may use one only
        (load, {0, 1}, {"proc__loadavg": "3.00 0.10 0.10 2/345 6789\n"}, "warn FH-331: "),
    ],
)
def test_what_the_system_tells_of_itself_is_judged(tmp_path, check, given, files, words):
    arguments = {"is_prevented": given} if check is sleep_states else {}
    position = () if check is sleep_states or given is None else (given,)
    assert re.match(words, told(check(lay(tmp_path, **files), *position, **arguments)))


@pytest.mark.parametrize(
    ("text", "cpus"), [("", set()), ("3\n", {3}), ("2-3,7", {2, 3, 7}), ("0-1,4-6", {0, 1, 4, 5, 6})]
)
def test_lists_of_processors_are_read(text, cpus):
    assert timing.parse_cpus(text) == cpus


@pytest.mark.parametrize(
    ("own", "files", "words"),
    [
        (None, {}, "warn FH-326: unknown"),
        ("0::/", {"cgroup.controllers": "cpu memory"}, "pass : .*not limited"),
        (
            "0::/system.slice/axes.service",
            {
                "cgroup.controllers": "cpu",
                "system.slice__cpu.max": "150000 100000",
                "system.slice__axes.service__cpu.max": "max 100000",
                "system.slice__axes.service__memory.max": "max",
            },
            "warn FH-325: .*150 ms in each 100 ms",  # by a group around it
        ),
        ("0::/", {"cgroup.controllers": "memory", "memory.max": "268435456"}, "warn FH-325: .* 268 MB"),
        (
            "4:cpu,cpuacct:/docker/1\n0::/",
            {"cpu__docker__1__cpu.cfs_quota_us": "50000", "cpu__docker__1__cpu.cfs_period_us": "100000"},
            "warn FH-325: .*50 ms in each 100 ms",
        ),
        (
            "4:cpu:/\n3:memory:/a",
            {"cpu__cpu.cfs_quota_us": "-1", "cpu__cpu.rt_runtime_us": "0"}
            | {"memory__a__memory.limit_in_bytes": "9223372036854771712"},
            "warn FH-325: no real-time priority (?!.*memory is limited)",
        ),
        ("0::/a", {"a__cpu.max": "no numbers"}, "warn FH-326: unknown"),
        ("nonsense", {}, "warn FH-326: unknown"),
    ],
)
def test_limits_of_the_control_group_and_of_those_around_it(tmp_path, own, files, words):
    if own is not None:
        lay(tmp_path, proc__self__cgroup=own)
    lay(tmp_path, **{f"sys__fs__cgroup__{name}": text for name, text in files.items()})
    assert re.match(words, told(timing.cgroup_limits(tmp_path)))


def test_a_system_that_tells_nothing_passes_nothing(tmp_path):
    lay(tmp_path, proc__empty="")
    found = {each.check: each for each in checks.examine(None, tmp_path)}
    names = ("kernel", "processor clock", "isolated processors", "interrupts", "real-time throttling", "sleep states")
    for name in (*names, "clock source", "limits of the control group", "processor load"):
        assert re.match("warn .*(unknown|not reported)", told(found[name]))


def test_a_recording_goes_into_a_folder_that_is_not_there_yet_and_is_not_made_but_not_below_a_file(tmp_path):
    assert disk.recording_folder(tmp_path / "new" / "deep" / "run.mcap", 1.0, None).result == "pass"
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "out").write_text("")
    found = disk.recording_folder(tmp_path / "out" / "run.mcap", 1.0, None)
    assert (found.result, f"{tmp_path / 'out'} " in found.detail) == ("fail", True)


def test_space_is_judged_by_the_rate_of_the_recording_and_its_budget(tmp_path, monkeypatch):
    path = tmp_path / "later" / "run.mcap"
    monkeypatch.setattr(disk.shutil, "disk_usage", lambda _: SimpleNamespace(free=4 * 10**9))
    for rate, budget, words in (
        (1e5, None, "pass : .*11.1 hours"),
        (1e7, None, "warn FH-308"),  # full in 7 minutes
        (1e7, 10**9, "pass"),  # the oldest are removed before
        (1e5, 10**10, "warn FH-308"),
    ):
        assert re.match(words, told(disk.recording_folder(path, rate, budget)))
    path.parent.mkdir()
    for name in ("run.mcap", "run-2.mcap"):
        with (path.parent / name).open("wb") as file:
            os.truncate(file.fileno(), 35 * 10**8)
    assert disk.recording_folder(path, 1e5, 10**10).result == "pass"  # 7 of 10 GB are there already


def test_the_speed_of_the_disk_is_measured_and_nothing_is_left(tmp_path, monkeypatch):
    path = tmp_path / "later" / "run.mcap"
    assert told(disk.recording_speed(path, 1.0)).startswith("pass")
    assert told(disk.recording_speed(path, 1e12)).startswith("warn FH-329")
    times = iter((0.0, 0.0, 0.1, 0.1, 0.2, 0.2, 5.0, 5.0, 5.1, 5.1))
    assert re.match(r"warn FH-329: .*4.8e\+03 ms", told(disk.recording_speed(path, 1.0, lambda: next(times))))
    assert list(tmp_path.iterdir()) == []

    def refuse(**_):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(disk.tempfile, "TemporaryFile", refuse)
    assert told(disk.recording_speed(tmp_path / "run.mcap", 1.0)).startswith("warn FH-330")


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
