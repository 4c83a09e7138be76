"""What delays a loop, as the files of Linux tell: each obstacle has its remedy, and what is unknown never passes."""

import os

import pytest

from friction_hil.doctor import checks, disk, timing
from tests.system_files import lay

CPU = "sys__devices__system__cpu__"
IDLE = f"{CPU}cpu{{}}__cpuidle__state{{}}__"
IRQ = "proc__irq__{}__"


def result(finding):
    assert bool(finding.fix) == bool(finding.code) == (finding.result != "pass")
    return finding.result, finding.code, finding.detail


@pytest.mark.parametrize(
    ("text", "cpus"), [("", set()), ("3\n", {3}), ("2-3,7", {2, 3, 7}), ("0-1,4-6", {0, 1, 4, 5, 6})]
)
def test_lists_of_processors_are_read(text, cpus):
    assert timing.parse_cpus(text) == cpus


def test_isolated_processors_are_of_use_only_to_a_process_that_may_run_there(tmp_path):
    assert result(timing.isolation(tmp_path, {0}))[:2] == ("warn", "FH-317")
    lay(tmp_path, **{f"{CPU}isolated": "\n"})
    assert result(timing.isolation(tmp_path, {0}))[:2] == ("warn", "FH-316")
    assert "taskset -c 0" not in timing.isolation(tmp_path, {0}).fix  # there is no other processor
    assert "two processors or more" in timing.isolation(tmp_path, {0}).fix
    lay(tmp_path, **{f"{CPU}online": "0-1\n"})
    assert timing.isolation(tmp_path, {0}).fix.startswith("boot with isolcpus=1 ")
    lay(tmp_path, **{f"{CPU}isolated": "2-3\n"})
    assert result(timing.isolation(tmp_path, {0, 1}))[:2] == ("warn", "FH-318")
    assert "taskset -c 2" in timing.isolation(tmp_path, {0, 1}).fix
    assert result(timing.isolation(tmp_path, {3})) == (
        "pass",
        "",
        "isolated: processors 2, 3; this process may run there",
    )
    lay(tmp_path, **{f"{CPU}isolated": "what is this"})
    assert result(timing.isolation(tmp_path, {0}))[:2] == ("warn", "FH-317")


def test_interrupts_at_the_isolated_processors_are_counted(tmp_path):
    assert result(timing.interrupts(tmp_path))[:2] == ("warn", "FH-320")
    lay(
        tmp_path,
        **{
            f"{CPU}isolated": "3",
            IRQ.format(24) + "smp_affinity_list": "0-3",  # allowed everywhere, and delivered to 0
            IRQ.format(24) + "effective_affinity_list": "0",
            IRQ.format(25) + "smp_affinity_list": "0-2",
            "proc__irq__default_smp_affinity": "f",
        },
    )
    assert result(timing.interrupts(tmp_path))[:2] == ("pass", "")
    lay(tmp_path, **{IRQ.format(126) + "smp_affinity_list": "3"})
    assert result(timing.interrupts(tmp_path)) == ("warn", "FH-319", "1 of 3 arrive at the isolated processors: 126")
    lay(tmp_path, **{f"{CPU}isolated": ""})
    assert "3 interrupts share the processors" in result(timing.interrupts(tmp_path))[2]


@pytest.mark.parametrize(
    ("runtime", "spin_share", "expected"),
    [
        ("-1", 0.99, ("pass", "")),
        ("950000", 0.2, ("pass", "")),
        ("950000", 0.6, ("warn", "FH-321")),
        ("500000", 0.2, ("warn", "FH-321")),
        ("", 0.2, ("warn", "FH-322")),
    ],
)
def test_throttling_is_judged_by_the_time_that_the_loop_spins(tmp_path, runtime, spin_share, expected):
    files = {"proc__sys__kernel__sched_rt_runtime_us": runtime, "proc__sys__kernel__sched_rt_period_us": "1000000"}
    assert result(timing.throttling(lay(tmp_path, **files), spin_share))[:2] == expected


def test_throttling_is_unknown_without_its_files(tmp_path):
    assert result(timing.throttling(tmp_path, 0.2))[:2] == ("warn", "FH-322")


def test_the_deepest_sleep_state_that_is_not_switched_off_counts(tmp_path):
    assert result(timing.sleep_states(tmp_path, is_prevented=True))[:2] == ("warn", "FH-324")
    states = (("POLL", "0", "0"), ("C1", "2", "0"), ("C6", "133", "0"), ("C10", "890", "1"))
    for cpu in range(2):
        for k, (name, latency, disable) in enumerate(states):
            at = IDLE.format(cpu, k)
            lay(tmp_path, **{f"{at}name": name, f"{at}latency": latency, f"{at}disable": disable})
    assert result(timing.sleep_states(tmp_path, is_prevented=True))[0] == "pass"
    found = result(timing.sleep_states(tmp_path, is_prevented=False))
    assert found == ("warn", "FH-323", "the deepest that is allowed, C6, takes 133 µs to leave")
    for cpu in range(2):
        lay(tmp_path, **{IDLE.format(cpu, 2) + "disable": "1\n"})
    assert result(timing.sleep_states(tmp_path, is_prevented=False))[0] == "pass"


GROUP = "sys__fs__cgroup__"


@pytest.mark.parametrize(
    ("own", "files", "expected"),
    [
        (None, {}, ("warn", "FH-326", "unknown")),
        ("0::/", {f"{GROUP}cgroup.controllers": "cpu memory"}, ("pass", "", "not limited")),
        (
            "0::/system.slice/axes.service",
            {
                f"{GROUP}cgroup.controllers": "cpu",
                f"{GROUP}system.slice__cpu.max": "150000 100000",
                f"{GROUP}system.slice__axes.service__cpu.max": "max 100000",
                f"{GROUP}system.slice__axes.service__memory.max": "max",
            },
            ("warn", "FH-325", "processor time is limited to 150 ms in each 100 ms"),  # by a group around it
        ),
        (
            "0::/",
            {f"{GROUP}cgroup.controllers": "memory", f"{GROUP}memory.max": "268435456"},  # of a container
            ("warn", "FH-325", "memory is limited to 268 MB"),
        ),
        (
            "4:cpu,cpuacct:/docker/1\n0::/",
            {
                f"{GROUP}cpu__docker__1__cpu.cfs_quota_us": "50000",
                f"{GROUP}cpu__docker__1__cpu.cfs_period_us": "100000",
            },
            ("warn", "FH-325", "processor time is limited to 50 ms in each 100 ms"),
        ),
        (
            "4:cpu:/\n3:memory:/a",
            {
                f"{GROUP}cpu__cpu.cfs_quota_us": "-1",
                f"{GROUP}cpu__cpu.rt_runtime_us": "0",
                f"{GROUP}memory__a__memory.limit_in_bytes": "9223372036854771712",
            },
            ("warn", "FH-325", "no real-time priority is granted"),
        ),
        ("0::/a", {f"{GROUP}a__cpu.max": "no numbers"}, ("warn", "FH-326", "unknown")),
        ("nonsense", {}, ("warn", "FH-326", "unknown")),
    ],
)
def test_limits_of_the_control_group_and_of_those_around_it(tmp_path, own, files, expected):
    if own is not None:
        lay(tmp_path, proc__self__cgroup=own)
    status, code, detail = result(timing.cgroup_limits(lay(tmp_path, **files)))
    assert (status, code) == expected[:2]
    assert expected[2] in detail


def test_a_slow_clock_is_named_with_a_faster_one(tmp_path):
    assert result(timing.clock_source(tmp_path))[:2] == ("warn", "FH-328")
    folder = "sys__devices__system__clocksource__clocksource0__"
    lay(tmp_path, **{f"{folder}current_clocksource": "tsc\n", f"{folder}available_clocksource": "tsc hpet acpi_pm \n"})
    assert result(timing.clock_source(tmp_path)) == ("pass", "", "tsc")
    lay(tmp_path, **{f"{folder}current_clocksource": "hpet\n"})
    assert result(timing.clock_source(tmp_path))[:2] == ("warn", "FH-327")
    assert "echo tsc >" in timing.clock_source(tmp_path).fix
    lay(tmp_path, **{f"{folder}available_clocksource": "hpet acpi_pm"})
    assert "dmesg" in timing.clock_source(tmp_path).fix


def test_a_machine_on_which_no_processor_is_idle_is_busy(tmp_path):
    for text in (None, "", "nonsense 1 2"):
        if text is not None:
            lay(tmp_path, proc__loadavg=text)
        assert result(timing.processor_load(tmp_path, {0, 1}))[:2] == ("warn", "FH-332")
    lay(tmp_path, proc__loadavg="1.40 9.00 9.00 2/345 6789\n")
    assert result(timing.processor_load(tmp_path, {0, 1}))[0] == "pass"
    assert result(timing.processor_load(tmp_path, {1}))[:2] == ("warn", "FH-331")  # it may use one only
    lay(tmp_path, proc__loadavg="3.00 0.10 0.10 2/345 6789\n")
    assert result(timing.processor_load(tmp_path, {0, 1}))[:2] == ("warn", "FH-331")


def test_a_system_that_tells_nothing_passes_nothing(tmp_path):
    lay(tmp_path, proc__empty="")
    found = {each.check: each for each in checks.examine(None, tmp_path)}
    names = ("isolated processors", "interrupts", "real-time throttling", "sleep states", "clock source")
    for name in (*names, "limits of the control group", "processor load"):
        assert (found[name].result, "unknown" in found[name].detail) == ("warn", True)


def test_a_recording_goes_into_a_folder_that_is_not_there_yet_and_is_not_made(tmp_path):
    assert result(disk.recording_folder(tmp_path / "new" / "deep" / "run.mcap", 1.0, None))[0] == "pass"
    assert list(tmp_path.iterdir()) == []


def test_a_recording_below_a_file_cannot_be_written(tmp_path):
    (tmp_path / "out").write_text("")
    found = disk.recording_folder(tmp_path / "out" / "run.mcap", 1.0, None)
    assert (found.result, f"{tmp_path / 'out'} is no folder" in found.detail) == ("fail", True)


def test_space_is_judged_by_the_rate_of_the_recording_and_its_budget(tmp_path, monkeypatch):
    path = tmp_path / "later" / "run.mcap"
    usage = type("usage", (), {"free": 4 * 10**9})
    monkeypatch.setattr(disk.shutil, "disk_usage", lambda _: usage)
    assert result(disk.recording_folder(path, 1e5, None))[0] == "pass"
    assert "11.1 hours" in disk.recording_folder(path, 1e5, None).detail
    assert result(disk.recording_folder(path, 1e7, None))[:2] == ("warn", "FH-308")  # full in 7 minutes
    assert result(disk.recording_folder(path, 1e7, 10**9))[0] == "pass"  # the oldest are removed before
    assert result(disk.recording_folder(path, 1e5, 10**10))[:2] == ("warn", "FH-308")
    path.parent.mkdir()
    for name in ("run.mcap", "run-2.mcap"):
        with (path.parent / name).open("wb") as file:
            os.truncate(file.fileno(), 35 * 10**8)
    assert result(disk.recording_folder(path, 1e5, 10**10))[0] == "pass"  # 7 of 10 GB are there already


def test_the_speed_of_the_disk_is_measured_and_nothing_is_left(tmp_path):
    path = tmp_path / "later" / "run.mcap"
    assert result(disk.recording_speed(path, 1.0))[0] == "pass"
    assert result(disk.recording_speed(path, 1e12))[:2] == ("warn", "FH-329")
    times = iter((0.0, 0.0, 0.1, 0.1, 0.2, 0.2, 5.0, 5.0, 5.1, 5.1))
    stalled = disk.recording_speed(path, 1.0, lambda: next(times))
    assert (stalled.code, "4.8e+03 ms" in stalled.detail) == ("FH-329", True)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_cannot_be_written_has_no_speed(tmp_path, monkeypatch):
    def refuse(**_):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(disk.tempfile, "TemporaryFile", refuse)
    assert result(disk.recording_speed(tmp_path / "run.mcap", 1.0))[:2] == ("warn", "FH-330")
