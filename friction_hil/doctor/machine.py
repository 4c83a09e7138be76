"""Checks of the machine: kernel, processor clock, compiled kernels.

Each function takes the root of the file system, so that a test can provide files of its own.
"""

import platform
import re
import sys
from collections import Counter
from pathlib import Path

from friction_hil.drive.finding import NOT_REPORTED, Finding, system_text


def operating_system() -> Finding:
    """Report that the daemon does not run on this system, which is not Linux."""
    detail = f"the daemon and simulated drives need Linux, and this is {platform.system() or sys.platform}"
    fix = "run them on a Linux machine; the commands that need no drive work here"
    return Finding("operating system", "fail", detail, fix, "FH-315")


def preemption(root: Path) -> Finding:
    """Check for a PREEMPT_RT kernel, which lets a real-time process interrupt nearly all work of the kernel."""
    check, fix = (
        "kernel",
        "install a kernel with PREEMPT_RT, or measure whether this one is sufficient: friction-hil latency",
    )
    version = system_text(root / "proc/sys/kernel/version")  # "#1 SMP PREEMPT_DYNAMIC Debian 6.1.76-1"
    if system_text(root / "sys/kernel/realtime") == "1" or re.search(r"\bPREEMPT[_ ]RT\b", version or ""):
        return Finding(check, "pass", "PREEMPT_RT")
    if version is None:
        return Finding(check, "warn", f"preemption model: {NOT_REPORTED}", fix, "FH-302")
    found = re.search(r"\bPREEMPT(_\w+)?\b", version)
    model = found[0] if found else "not preemptible"
    chosen = re.search(r"\((\w+)\)", system_text(root / "sys/kernel/debug/sched/preempt") or "")
    if chosen:
        model += f", set to {chosen[1]}"
    detail = f"no PREEMPT_RT ({model}): drivers and other work in the kernel may delay a wake-up"
    return Finding(check, "warn", detail, fix, "FH-301")


def processor_clock(root: Path) -> Finding:
    """Check whether the processors reduce their clock at low load, as they do under a loop that mostly sleeps."""
    check = "processor clock"
    files = root.glob("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")
    governors = Counter(text for file in files if (text := system_text(file)) is not None)
    if not governors:
        detail = f"frequency governor: {NOT_REPORTED} (a virtual machine, or the firmware controls the clock)"
        fix = "choose the performance profile in the firmware or on the host"
        return Finding(check, "warn", detail, fix, "FH-303")
    listed = ", ".join(f"{name} ({count} processors)" for name, count in sorted(governors.items()))
    if set(governors) == {"performance"}:
        return Finding(check, "pass", f"frequency governor: {listed}")
    return Finding(
        check,
        "warn",
        f"frequency governor: {listed}: a processor that reduced its clock while idle computes late",
        "as root: echo performance | tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",
        "FH-304",
    )


def compiled_kernels(folder: str | None) -> Finding:
    """Check for compiled code in ``folder``, the result of `friction_hil.numerics.jit.cache_folder`."""
    check = "compiled kernels"
    if folder is None:
        return Finding(
            check,
            "warn",
            "they cannot be kept: every start compiles them again, which takes a minute or two",
            "set XDG_CACHE_HOME to a folder that the user may write to",
            "FH-305",
        )
    count = sum(1 for _ in Path(folder).rglob("*.nbc"))
    if count == 0:
        return Finding(
            check,
            "warn",
            "none yet: the first start takes a minute or two longer",
            "run friction-hil demo, which compiles and keeps them",
            "FH-306",
        )
    return Finding(check, "pass", f"{count} are kept in {folder}")
