"""Checks of what delays a loop's wake-up: shared and busy processors, interrupts, sleep states, limits, slow clocks.

Each function takes the root of the file system, so that a test can provide files of its own. What the system does not
report is unknown, and no pass.
"""

import os
from collections.abc import Iterator
from pathlib import Path

from friction_hil.drive.finding import NOT_REPORTED, Finding, system_text

_CPU = "sys/devices/system/cpu"
_UNKNOWN = f"unknown: {NOT_REPORTED}"
_COMPUTING = 0.4  # of each period, beside spinning, that a loop may take
_LONG_EXIT_US = 20  # from a sleep state
_LITTLE_MEMORY = 1 << 30
_NAMED = 8
_FREE = 0.5  # processors that must be idle on average
_SLOW_CLOCKS = ("hpet", "acpi_pm", "jiffies", "refined-jiffies", "pit", "xen")


def parse_cpus(text: str) -> set[int]:
    """Return the processors of a list of the kernel: ``2-3,7``; a `ValueError`: it is no such list."""
    found: set[int] = set()
    for part in filter(None, text.strip().split(",")):
        first, _, last = part.partition("-")
        found.update(range(int(first), int(last or first) + 1))
    return found


def isolation(root: Path, own: set[int]) -> Finding:
    """Check for processors that the scheduler leaves alone, and whether this process may run on one.

    ``own``: processors on which this process may run.
    """
    check = "isolated processors"
    isolated = _cpus(root / _CPU / "isolated")
    last = max(_cpus(root / _CPU / "online") or own)  # one that exists
    fix = f"boot with isolcpus={last} nohz_full={last} rcu_nocbs={last}, and start the daemon with: taskset -c {last}"
    if last == 0:
        fix = "take a computer with two processors or more: there is one only, which nothing can leave to the daemon"
    if isolated is None:
        return Finding(check, "warn", _UNKNOWN, f"look on the host for isolcpus= in /proc/cmdline; {fix}", "FH-317")
    if not isolated:
        detail = "none: work of the kernel and other processes may delay the loop on every processor"
        return Finding(check, "warn", detail, fix, "FH-316")
    listed = _listed(isolated)
    if not isolated & own:
        detail = f"isolated: {listed}, but a process that is started here runs on {_listed(own)}"
        fix = f"start the daemon with taskset -c {min(isolated)}, or CPUAffinity={min(isolated)} in its service"
        return Finding(check, "warn", detail, fix, "FH-318")
    return Finding(check, "pass", f"isolated: {listed}; this process may run there")


def interrupts(root: Path) -> Finding:
    """Check whether interrupts of devices arrive at the isolated processors."""
    check = "interrupts"
    isolated = _cpus(root / _CPU / "isolated") or set()
    numbers: dict[int, set[int]] = {}
    for folder in root.glob("proc/irq/[0-9]*"):
        for name in ("effective_affinity_list", "smp_affinity_list"):
            if cpus := _cpus(folder / name):
                numbers[int(folder.name)] = cpus
                break
    fix = "as root: stop irqbalance, and echo 0 > /proc/irq/NUMBER/smp_affinity_list for each"
    if not numbers:
        return Finding(check, "warn", f"affinity: {_UNKNOWN}", f"check on the host; {fix}", "FH-320")
    if not isolated:
        detail = f"no processor is free of them: {len(numbers)} interrupts share the processors with the loop"
        return Finding(check, "warn", detail, f"isolate a processor; then {fix}", "FH-319")
    there = sorted(number for number, cpus in numbers.items() if cpus & isolated)
    if there:
        named = ", ".join(map(str, there[:_NAMED])) + (", ..." if len(there) > _NAMED else "")
        detail = f"{len(there)} of {len(numbers)} arrive at the isolated processors: {named}"
        return Finding(check, "warn", detail, fix, "FH-319")
    return Finding(check, "pass", f"none of {len(numbers)} arrives at the isolated processors")


def throttling(root: Path, spin_share: float) -> Finding:
    """Check whether the kernel stops real-time processes that take too much of each second.

    ``spin_share``: share of each period that the loop waits busily.
    """
    check, fix = "real-time throttling", "as root: sysctl -w kernel.sched_rt_runtime_us=-1"
    runtime = _number(root / "proc/sys/kernel/sched_rt_runtime_us")
    period = _number(root / "proc/sys/kernel/sched_rt_period_us")
    if runtime is None or not period:
        return Finding(check, "warn", _UNKNOWN, f"check on the host; {fix}", "FH-322")
    if runtime < 0:
        return Finding(check, "pass", "real-time processes are not throttled")
    share, needed = runtime / period, min(spin_share + _COMPUTING, 1.0)
    detail = f"real-time processes may take {100.0 * share:.3g} % of the time"
    if share < needed:
        detail += f", and a loop that spins for {100.0 * spin_share:.3g} % of its period may need more"
        return Finding(check, "warn", detail, f"{fix}; or a smaller realtime.spin_us", "FH-321")
    return Finding(check, "pass", f"{detail}, which suffices for the loop")


def sleep_states(root: Path, *, is_prevented: bool) -> Finding:
    """Check how long processors need to leave their deepest sleep state (C-state).

    ``is_prevented``: the daemon keeps processors out of such states (``/dev/cpu_dma_latency``).
    """
    check = "sleep states"
    deepest: tuple[float, str] | None = None
    for folder in root.glob(f"{_CPU}/cpu[0-9]*/cpuidle/state[0-9]*"):
        exit_us, name = _number(folder / "latency"), system_text(folder / "name")
        if exit_us is None or name is None:
            continue
        is_disabled = system_text(folder / "disable") == "1"
        if not is_disabled and (deepest is None or exit_us > deepest[0]):
            deepest = exit_us, name
    if deepest is None:
        detail = f"{_UNKNOWN} (a virtual machine, or the firmware decides)"
        fix = "switch C-states off in the firmware or on the host"
        return Finding(check, "warn", detail, fix, "FH-324")
    detail = f"the deepest that is allowed, {deepest[1]}, takes {deepest[0]:g} µs to leave"
    if deepest[0] <= _LONG_EXIT_US:
        return Finding(check, "pass", detail)
    if is_prevented:
        return Finding(check, "pass", f"{detail}; the daemon keeps the processors out of it")
    fix = f"let the user open /dev/cpu_dma_latency; or as root: cpupower idle-set -D {_LONG_EXIT_US}"
    return Finding(check, "warn", detail, fix, "FH-323")


def cgroup_limits(root: Path) -> Finding:
    """Check for limits of processor time and memory of the control group in which this process runs."""
    check = "limits of the control group"
    text = system_text(root / "proc/self/cgroup")
    groups = [] if text is None else list(_groups(root / "sys/fs/cgroup", text))
    is_known = False
    limits: list[str] = []
    for group in groups:
        is_known = is_known or any((group / name).exists() for name in ("cgroup.controllers", "cpu.cfs_quota_us"))
        limits += _limits(group)
    if limits:
        fix = "CPUQuota=infinity and MemoryMax=infinity in the service; a container without --cpus and --memory"
        return Finding(check, "warn", "; ".join(dict.fromkeys(limits)), fix, "FH-325")
    if not is_known:
        fix = "check on the host: cpu.max and memory.max of the control group"
        return Finding(check, "warn", _UNKNOWN, fix, "FH-326")
    return Finding(check, "pass", "processor time and memory are not limited")


def processor_load(root: Path, own: set[int]) -> Finding:
    """Check whether other work leaves the loop a processor of those on which this process may run."""
    check = "processor load"
    try:
        load = float((system_text(root / "proc/loadavg") or "").split(maxsplit=1)[0])
    except (IndexError, ValueError):
        return Finding(check, "warn", _UNKNOWN, "check on the host: uptime", "FH-332")
    count = len(own)
    detail = f"{load:.2g} processes on average wanted to run in the last minute, on {count} processors"
    if load > count - _FREE:
        fix = "end what computes beside the daemon (top shows it), or leave a processor to the daemon alone"
        return Finding(check, "warn", detail, fix, "FH-331")
    return Finding(check, "pass", detail)


def clock_source(root: Path) -> Finding:
    """Check whether the clock is read from the processor, or with a slow access to a device."""
    check, folder = "clock source", root / "sys/devices/system/clocksource/clocksource0"
    current = system_text(folder / "current_clocksource")
    if not current:
        return Finding(check, "warn", _UNKNOWN, "check on the host: it should be tsc or arch_sys_counter", "FH-328")
    if current not in _SLOW_CLOCKS:
        return Finding(check, "pass", current)
    available = system_text(folder / "available_clocksource") or ""
    fix = "choose a processor clock in the firmware; the kernel log says why it was rejected (dmesg | grep -i tsc)"
    if better := [name for name in available.split() if name not in _SLOW_CLOCKS]:
        fix = f"as root: echo {better[0]} > /sys/devices/system/clocksource/clocksource0/current_clocksource"
    return Finding(check, "warn", f"{current}: each look at the clock takes a microsecond or more", fix, "FH-327")


def own_cpus() -> set[int]:
    """Return the processors on which this process may run."""
    return set(os.sched_getaffinity(0))


def _groups(mount: Path, text: str) -> Iterator[Path]:
    """Yield the control groups of a process and those around them, from the text of ``/proc/self/cgroup``."""
    lines = (line.split(":", 2) for line in text.splitlines() if line.count(":") > 1)
    for number, controllers, path in lines:
        for controller in [""] if number == "0" else controllers.split(","):
            top = mount / controller
            group = top / path.lstrip("/")
            yield from (each for each in (group, *group.parents) if each.is_relative_to(top))


def _limits(group: Path) -> Iterator[str]:
    """Yield the limits of one control group, of version 2 or 1."""
    quota_us, period_us = _number(group / "cpu.cfs_quota_us"), _number(group / "cpu.cfs_period_us")
    words = (system_text(group / "cpu.max") or "").split()
    if len(words) == 2 and all(word.isdecimal() for word in words):  # "max 100000" is no limit
        quota_us, period_us = map(int, words)
    if quota_us is not None and quota_us > 0 and period_us:
        yield f"processor time is limited to {quota_us / 1e3:g} ms in each {period_us / 1e3:g} ms"
    if _number(group / "cpu.rt_runtime_us") == 0:
        yield "no real-time priority is granted (cpu.rt_runtime_us is 0)"
    for name in ("memory.max", "memory.limit_in_bytes"):
        memory = _number(group / name)
        if memory is not None and memory < _LITTLE_MEMORY:
            yield f"memory is limited to {memory / 1e6:.0f} MB"


def _listed(cpus: set[int]) -> str:
    return f"{'processor' if len(cpus) == 1 else 'processors'} {', '.join(map(str, sorted(cpus)))}"


def _cpus(path: Path) -> set[int] | None:
    text = system_text(path)
    if text is None:
        return None
    try:
        return parse_cpus(text)
    except ValueError:
        return None


def _number(path: Path) -> int | None:
    text = system_text(path)
    try:
        return None if text is None else int(text)
    except ValueError:  # "max"
        return None
