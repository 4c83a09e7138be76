"""Run commands of friction-hil as on a system that is not Linux: without what Windows and macOS lack.

python -P other_system.py PLATFORM FILE: FILE holds a JSON list of command lines; standard output is one line of JSON,
[exit status, output, errors] of each. The libraries are imported before anything is removed: on those systems they have
code of their own. The modules of friction_hil meet a system without it from their import on.
"""

import contextlib
import importlib
import io
import json
import mmap
import os
import platform
import select
import shlex
import signal
import socket
import sys
import time

LIBRARIES = (
    *("multiprocessing.pool", "concurrent.futures.process", "asyncio", "subprocess", "tempfile", "importlib.metadata"),
    *("numpy", "numba", "scipy.optimize", "scipy.signal", "scipy.io", "scipy.linalg", "scipy.interpolate"),
    *("matplotlib.figure", "matplotlib.backends.backend_agg", "matplotlib.backends.backend_svg"),
    *("can", "canopen", "serial", "pymodbus.framer", "yaml", "pydantic", "click", "rich.progress", "rich.console"),
    *("mcap.reader", "mcap.writer", "isal.isal_zlib", "zstandard", "pyarrow.parquet", "h5py", "asammdf", "onnx"),
)
MODULES = ("fcntl", "grp", "pwd", "resource", "termios", "tty", "pty", "syslog")
# What a module of the standard library has on Linux, and not on Windows; a * stands for any ending.
NAMES = {
    os: "fork* sched_* SCHED_* memfd_create MFD_* pidfd_open eventfd* openpty ttyname getuid geteuid getgid getegid "
    "getgroups setuid setgid getpgid setsid setpgid killpg mkfifo pread* pwrite* chown lchown fchown fdatasync "
    "nice getpriority setpriority sysconf statvfs fstatvfs sendfile uname getloadavg wait wait3 wait4 waitid "
    "WNOHANG WIF* posix_* sync O_CLOEXEC O_NOFOLLOW O_NONBLOCK O_DIRECTORY O_SYNC O_DSYNC register_at_fork "
    "set_blocking get_blocking getresuid getxattr setxattr",
    signal: "SIGHUP SIGKILL SIGUSR1 SIGUSR2 SIGALRM SIGSTOP SIGCONT SIGCHLD SIGPIPE SIGQUIT SIGTSTP SIGWINCH alarm "
    "setitimer pthread_* pidfd_send_signal pause sigwait* set_wakeup_fd",
    mmap: "MAP_* PROT_* MADV_*",
    select: "poll epoll POLL* EPOLL*",
    socket: "AF_UNIX AF_CAN PF_CAN CAN_* SO_TIMESTAMPNS TCP_QUICKACK send_fds recv_fds",
    time: "CLOCK_* clock_gettime* timerfd_*",
}


def _remove(name: str) -> None:
    for module in MODULES:
        sys.modules[module] = None
    for module, patterns in NAMES.items():
        for pattern in patterns.split():
            stem = pattern.removesuffix("*")
            for each in [
                each for each in vars(module) if each == pattern or (stem != pattern and each.startswith(stem))
            ]:
                delattr(module, each)
    sys.platform = name
    platform.system = lambda: {"win32": "Windows", "darwin": "Darwin"}[name]


def main() -> None:
    """Run the commands of the file."""
    name, path = sys.argv[1:]
    for library in LIBRARIES:
        with contextlib.suppress(ImportError):  # an extra that is not installed
            importlib.import_module(library)
    _remove(name)
    from friction_hil.cli import main as command_line

    with open(path, encoding="utf-8") as file:
        commands = json.load(file)
    done = []
    for command in commands:
        with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as errors:
            status = command_line(shlex.split(command)[1:])
        done.append((status, out.getvalue(), errors.getvalue()))
    print(json.dumps(done))


if __name__ == "__main__":
    main()
