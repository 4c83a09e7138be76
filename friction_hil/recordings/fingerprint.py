"""Fingerprint of machine and software, on which the last bit of a result depends."""

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from friction_hil import __version__

_PACKAGES = ("numpy", "numba", "llvmlite")
_CPUINFO = Path("/proc/cpuinfo")
# Instruction sets by which numpy and numba choose their code; the other flags vary with the kernel.
_VECTOR_FLAGS = ("sse", "ssse", "avx", "fma", "asimd", "sve", "neon")
_MODEL_KEYS = ("model name", "CPU part", "uarch", "cpu model")  # x86, ARM, RISC-V, MIPS


def fingerprint() -> dict[str, str]:
    """Return the properties of this machine and software that can change the bits of a result."""
    cpuinfo = _cpuinfo()
    return {
        "machine": platform.machine(),
        "cpu": next((cpuinfo[key] for key in _MODEL_KEYS if key in cpuinfo), "unknown"),
        "vector": " ".join(_vector_flags(cpuinfo.get("flags", cpuinfo.get("Features", "")))),
        "libc": " ".join(platform.libc_ver()).strip() or "unknown",
        "python": platform.python_version(),
        **{name: _version(name) for name in _PACKAGES},
        "friction_hil": __version__,
    }


def differences(a: Mapping[str, str], b: Mapping[str, str]) -> list[str]:
    """Return the differences of two fingerprints, one line each: ``numpy: 2.1.0, here 2.2.0``.

    ``a`` is of the recording, ``b`` of this machine.
    """
    names = [*a, *(name for name in b if name not in a)]
    return [
        f"{name}: {a.get(name, 'not reported')}, here {b.get(name, 'not reported')}"
        for name in names
        if a.get(name) != b.get(name)
    ]


def _cpuinfo() -> dict[str, str]:
    """Return the properties of the first processor; empty if the system does not report them."""
    try:
        text = _CPUINFO.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return {}
    pairs = (line.partition(":") for line in text.partition("\n\n")[0].splitlines())
    return {name.strip(): value.strip() for name, _, value in pairs}


def _vector_flags(flags: str) -> list[str]:
    return sorted(flag for flag in flags.split() if flag.startswith(_VECTOR_FLAGS))


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"
