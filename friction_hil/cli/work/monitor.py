"""The work of ``friction-hil monitor``: reads a daemon, and shows it on a terminal, as lines or as JSON."""

import contextlib
import json
import os
import select
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from types import FrameType

from friction_hil.cli.work.monitor_screen import brief_line, screen, waiting_screen
from friction_hil.daemon.control.names import running, socket_path
from friction_hil.errors import FrictionHilError, UsageError
from friction_hil.interrupts import Interrupted, interrupt
from friction_hil.live import Live, LiveFigures, Snapshot, Watch, attach
from friction_hil.numerics.json_values import to_json

_FRAME_S, _LINE_S = 0.25, 1.0
_ANSWER_S = 3.0  # of a daemon that runs; before, nothing is said of waiting
_FIRST_S = 1.0  # for the first row of a daemon that has just begun
_OUTPUT = 1
_BEGIN, _END = "\x1b[?1049h\x1b[?25l", "\x1b[?25h\x1b[?1049l"  # other screen, without cursor
_SIZE = os.terminal_size((80, 24))  # where none is known


def monitor(*, name: str | None, window_s: float, once: bool, as_json: bool) -> int:
    """Show a daemon until the user ends it; return the exit status."""
    name = _only_daemon() if name is None else name
    socket_path(name)  # a name that none can have is refused
    if once:
        with attach(name) as live:
            return _show_once(live, window_s, as_json=as_json)
    with Watch(name) as watch:
        view = _View(watch, window_s)
        try:
            if as_json or not os.isatty(_OUTPUT):
                _follow(name, view, as_json=as_json)
            else:
                _show(name, view)
        except Interrupted as error:
            if error.number != signal.SIGINT:
                raise
    return 0


class _View:
    """The daemon that is there now, and its figures."""

    def __init__(self, watch: Watch, window_s: float) -> None:
        self._watch, self._window_s = watch, window_s
        self._live: Live | None = None
        self._figures: LiveFigures | None = None

    def look(self) -> Snapshot | None:
        """Return the figures; None while no daemon of the name runs. At its end they say so."""
        live = self._watch.poll()
        if live is None:
            return None
        if live is not self._live:
            self._live, self._figures = live, LiveFigures(live.facts, live.faults, self._window_s)
        assert self._figures is not None
        self._figures.take(live.read())
        return self._figures.snapshot()


def _only_daemon() -> str:
    """Return the name of the only daemon that runs here.

    Raises `FrictionHilError`: none runs, or several: the message lists them.
    """
    names = [each for each, _ in running()]
    if not names:
        raise FrictionHilError(
            "no daemon runs here", "'friction-hil run CONFIG' starts one; with NAME this waits for it"
        )
    if len(names) > 1:
        raise UsageError(f"several daemons run here, name one of them: {', '.join(names)}")
    return names[0]


def _show_once(live: Live, window_s: float, *, as_json: bool) -> int:
    figures, end_s = LiveFigures(live.facts, live.faults, window_s), time.monotonic() + _FIRST_S
    figures.take(live.read())
    while not (shown := figures.snapshot()).cycle and not shown.is_over and time.monotonic() < end_s:
        time.sleep(0.02)
        figures.take(live.read())
    if as_json:
        print(_json(shown))
    elif os.isatty(_OUTPUT):
        size = _size()
        _write(
            "\n".join(screen(shown, size.columns, size.lines - 1, 0, is_coloured=_is_coloured(), is_live=False)) + "\n"
        )
    else:
        print(brief_line(shown))
    return 1 if shown.faults else 0


def _follow(name: str, view: _View, *, as_json: bool) -> None:
    """Print a line a second."""
    was_waiting = False
    end_s = time.monotonic() + _ANSWER_S
    while (shown := view.look()) is None and time.monotonic() < end_s:
        time.sleep(_FRAME_S)
    while True:
        if as_json:
            print(_json(shown) if shown else json.dumps({"name": name, "state": "waiting"}), flush=True)
        elif shown is not None:
            print(brief_line(shown), flush=True)
        elif not was_waiting:
            print(f"waiting for {name}", flush=True)
        was_waiting = shown is None
        time.sleep(_LINE_S)
        shown = view.look()


def _show(name: str, view: _View) -> None:
    """Show the screen until the user presses q."""
    chosen, last = 0, None
    with _terminal() as has_keys:
        size = _size()  # the first look may take a while: code is compiled
        _draw(waiting_screen(name, last, size.columns, size.lines, is_coloured=_is_coloured()))
        while True:
            shown = view.look()
            last = shown or last
            size = _size()
            if shown is None:
                lines = waiting_screen(name, last, size.columns, size.lines, is_coloured=_is_coloured())
            else:
                lines = screen(shown, size.columns, size.lines, chosen, is_coloured=_is_coloured(), is_live=True)
            _draw(lines)
            keys = _keys(has_keys)
            if "q" in keys:
                return
            chosen += keys.count("\t")


@contextlib.contextmanager
def _terminal() -> Iterator[bool]:
    """Take the other screen and single keys, and give both back; the value says if there are keys."""
    if sys.platform == "win32":
        raise UsageError("the monitor needs Linux")
    else:  # mypy leaves this out for Windows
        import termios  # imported here: Windows has none
        import tty

        has_keys = os.isatty(0)
        before = termios.tcgetattr(0) if has_keys else None

        def begin() -> None:
            if has_keys:
                tty.setcbreak(0)
            _write(_BEGIN)

        def end() -> None:
            with contextlib.suppress(OSError):
                _write(_END)
            if before is not None:
                termios.tcsetattr(0, termios.TCSADRAIN, before)

        def pause(number: int, frame: FrameType | None) -> None:
            """Give the terminal back while the shell has it, after Ctrl-Z."""
            end()
            os.kill(os.getpid(), signal.SIGSTOP)
            begin()  # goes on here, in the foreground again

        former = {each: signal.getsignal(each) for each in (signal.SIGTSTP, signal.SIGTERM)}
        try:
            signal.signal(signal.SIGTSTP, pause)
            signal.signal(signal.SIGTERM, interrupt)
            begin()
            yield has_keys
        finally:
            end()
            for each, handler in former.items():
                signal.signal(each, handler)


def _keys(has_keys: bool) -> str:
    """Wait for the next frame; return the keys that were pressed. A terminal that is gone ends the monitor."""
    if not has_keys:
        time.sleep(_FRAME_S)
        return ""
    if not select.select([0], [], [], _FRAME_S)[0]:
        return ""
    try:
        return os.read(0, 64).decode("ascii", "replace") or "q"
    except OSError:
        return "q"


def _draw(lines: Sequence[str]) -> None:
    _write("\x1b[H" + "\r\n".join(f"{line}\x1b[K" for line in lines) + "\x1b[J")


def _json(shown: Snapshot) -> str:
    return json.dumps(to_json(asdict(shown)), ensure_ascii=False, allow_nan=False)


def _size() -> os.terminal_size:
    with contextlib.suppress(OSError):
        size = os.get_terminal_size(_OUTPUT)
        # a pseudo-terminal without a size reports 0
        return os.terminal_size((size.columns or _SIZE.columns, size.lines or _SIZE.lines))
    return _SIZE


def _is_coloured() -> bool:
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM", "") not in ("", "dumb")


def _write(text: str) -> None:
    """Write control sequences and printable text past the stream that takes control sequences away."""
    sys.stdout.flush()
    data = text.encode()
    while data:
        data = data[os.write(_OUTPUT, data) :]
