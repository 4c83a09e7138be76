"""The spawner: starts processes as it is asked to, and reports how they end; ends with the control process.

A request is JSON with the descriptors that the process gets (SCM_RIGHTS): its standard input, its standard output, and
those of ``descriptors`` under the numbers that they have in the control process. Answers are JSON with ``number`` of
the request and ``pid``, and later ``status`` as `subprocess.Popen.returncode` has it. A process that cannot be started
has status 127 and no pid.
"""

import fcntl
import json
import os
import select
import signal
import socket
import sys
from typing import Any

from friction_hil.daemon.spawner import ENVIRONMENT

_REQUEST_BYTES = 1 << 16
_MOST_DESCRIPTORS = 32
_CANNOT_START = 127
_ABOVE_ALL = 512  # descriptors from here on are not among those that a process gets
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main(descriptor: int) -> None:
    """Serve the control process at this end of a socket until it is gone."""
    for ignored in _SIGNALS:
        signal.signal(ignored, signal.SIG_IGN)
    connection = socket.socket(fileno=descriptor)
    connection.set_inheritable(False)
    poll = select.poll()
    poll.register(connection, select.POLLIN)
    children: dict[int, tuple[int, int]] = {}  # number of the request and pid, by descriptor of the process
    while True:
        for ready, _ in poll.poll():
            if ready == connection.fileno():
                try:
                    data, descriptors, *_ = socket.recv_fds(connection, _REQUEST_BYTES, _MOST_DESCRIPTORS)
                except ConnectionResetError:
                    return
                if not data:
                    return
                for each in descriptors:
                    os.set_inheritable(each, False)  # to those that are started later
                request = json.loads(data)
                try:
                    pid = _start(request, descriptors)
                    process = os.pidfd_open(pid)
                except OSError as error:
                    sys.stderr.write(f"friction-hil: a process cannot be started: {error.strerror}\n")
                    _answer(connection, number=request["number"], status=_CANNOT_START)
                    continue
                finally:
                    for each in descriptors:
                        os.close(each)
                children[process] = (request["number"], pid)
                poll.register(process, select.POLLIN)
                _answer(connection, number=request["number"], pid=pid)
            else:
                number, pid = children.pop(ready)
                poll.unregister(ready)
                os.close(ready)
                _, status = os.waitpid(pid, 0)
                _answer(connection, number=number, status=os.waitstatus_to_exitcode(status))


def _answer(connection: socket.socket, **message: Any) -> None:
    try:
        connection.send(json.dumps(message).encode())
    except OSError:  # the control process is gone: its processes see that for themselves
        sys.exit()


def _start(request: dict[str, Any], descriptors: list[int]) -> int:
    """Start a process; return its number."""
    if pid := os.fork():
        return pid
    try:
        os.setpgid(0, 0)  # Ctrl-C is not meant for it
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_DFL)
        wanted = [0, 1, *request["descriptors"]]
        above = [fcntl.fcntl(each, fcntl.F_DUPFD_CLOEXEC, _ABOVE_ALL) for each in descriptors]
        for source, target in zip(above, wanted, strict=True):
            os.dup2(source, target)
        words = request["words"]
        os.execve(words[0], words, os.environ | ENVIRONMENT)
    finally:
        os._exit(_CANNOT_START)


if __name__ == "__main__":
    main(int(sys.argv[1]))
