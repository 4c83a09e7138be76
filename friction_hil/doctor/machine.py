"""What a machine offers a punctual loop, as its kernel tells it.

Each function takes the root of the file system, so that a test can lay out a machine of its own.
"""

import os
import re
import shutil
from collections import Counter
from pathlib import Path

from friction_hil.drive.finding import NOT_TOLD, Finding, system_text

_LEAST_FREE_BYTES = 1 << 30  # an hour of an axis at 1 kHz, not compressed, is half of that


def preemption(root: Path) -> Finding:
    """Tell whether the kernel lets a process with priority go before nearly everything else (PREEMPT_RT)."""
    check, fix = "kernel", "install a kernel with PREEMPT_RT, or see with cyclictest whether this one will do"
    version = system_text(root / "proc/sys/kernel/version")  # "#1 SMP PREEMPT_DYNAMIC Debian 6.1.76-1"
    if system_text(root / "sys/kernel/realtime") == "1" or re.search(r"\bPREEMPT[_ ]RT\b", version or ""):
        return Finding(check, "pass", "PREEMPT_RT")
    if version is None:
        return Finding(check, "warn", f"preemption model: {NOT_TOLD}", fix)
    found = re.search(r"\bPREEMPT(_\w+)?\b", version)
    model = found[0] if found else "not preemptible"
    chosen = re.search(r"\((\w+)\)", system_text(root / "sys/kernel/debug/sched/preempt") or "")
    if chosen:
        model += f", set to {chosen[1]}"
    detail = f"no PREEMPT_RT ({model}): drivers and other work in the kernel may delay a wake-up"
    return Finding(check, "warn", detail, fix)


def processor_clock(root: Path) -> Finding:
    """Tell whether the processors slow down when there is little to do, as they do in a loop that mostly sleeps."""
    check = "processor clock"
    files = root.glob("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")
    governors = Counter(text for file in files if (text := system_text(file)) is not None)
    if not governors:
        detail = f"frequency governor: {NOT_TOLD} (a virtual machine, or the firmware alone decides)"
        return Finding(check, "warn", detail, "choose the performance profile in the firmware or of the host")
    listed = ", ".join(f"{name} ({count} processors)" for name, count in sorted(governors.items()))
    if set(governors) == {"performance"}:
        return Finding(check, "pass", f"frequency governor: {listed}")
    return Finding(
        check,
        "warn",
        f"frequency governor: {listed}: a processor that slowed down while it slept computes late",
        "as root: echo performance | tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",
    )


def compiled_kernels(folder: str | None) -> Finding:
    """Tell whether there is compiled code in ``folder``, that of `friction_hil.numerics.jit.cache_folder`."""
    check = "compiled kernels"
    if folder is None:
        return Finding(
            check,
            "warn",
            "they cannot be kept: every start compiles anew, for a minute or two",
            "set XDG_CACHE_HOME to a folder that the user may write",
        )
    count = sum(1 for _ in Path(folder).rglob("*.nbc"))
    if count == 0:
        return Finding(
            check,
            "warn",
            "none yet: the first start takes a minute or two longer",
            "friction-hil demo compiles them, and they are kept",
        )
    return Finding(check, "pass", f"{count} are kept in {folder}")


def recording_folder(path: Path) -> Finding:
    """Tell whether a recording can be written to ``path``, whose folder need not exist yet."""
    check = "recording"
    folder = next(each for each in path.absolute().parents if each.exists())
    if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
        detail = f"{path} cannot be written: {folder} is no folder that the user may write"
        return Finding(check, "fail", detail, "change recording.path, or give the user the folder")
    free = shutil.disk_usage(folder).free
    detail = f"{path} can be written; {free / 1e9:.3g} GB are free"
    if free < _LEAST_FREE_BYTES:
        return Finding(check, "warn", detail, "make room: a recording that finds none ends early")
    return Finding(check, "pass", detail)
