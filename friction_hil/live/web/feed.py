"""The thread that reads a daemon, waits for it, and attaches again when it comes back; it serves pages and Foxglove."""

import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.config.load import model_files
from friction_hil.daemon.control.ask import ask
from friction_hil.daemon.control.names import find
from friction_hil.errors import FrictionHilError, UsageError, choices
from friction_hil.live import Live, LiveFigures, Reading, Watch
from friction_hil.live.web.circle import circle_tracer
from friction_hil.live.web.content import COLUMNS, figures_message, hello, plain_text, rows_message, strip_values
from friction_hil.live.web.metrics import metrics_text
from friction_hil.live.web.strips import Points, Strips
from friction_hil.printable import printable

if TYPE_CHECKING:
    from friction_hil.live.web.foxglove_feed import FoxgloveFeed

_TICK_S = 0.1
_FIGURES_TICKS = 5
_MOST_EVENTS = 100
_SHOWN_EVENTS = ("fault", "reset", "warning", "notice", "abandoned")

Publish = Callable[[int, dict[str, Any]], None]


class Feed:
    """Reads one daemon after the other of a name; ``report`` is called with lines for the user."""

    def __init__(self, name: str, foxglove: "FoxgloveFeed | None", report: Callable[[str], None]) -> None:
        self._name, self._foxglove, self._report = name, foxglove, report
        self._lock = threading.Lock()  # the watched daemon, its number of messages, and what a page begins with
        self._watched: _Watched | None = None
        self._reason = f"no daemon called {name!r} runs here"
        self._number = 0
        self._publish: Publish = lambda number, message: None
        self._is_wanted: Callable[[], bool] = lambda: False

    def serve_pages(self, publish: Publish, is_wanted: Callable[[], bool]) -> None:
        """Hand messages to ``publish`` from now on; figures only while ``is_wanted``."""
        self._publish, self._is_wanted = publish, is_wanted

    def run(self, ending: threading.Event) -> None:
        """Read until ``ending`` is set."""
        tick = 0
        self._report(f"waiting for {self._name}")
        with Watch(self._name) as watch:
            while not ending.wait(_TICK_S):
                try:
                    live = watch.poll()
                except FrictionHilError as error:
                    if str(error) != self._reason:
                        self._report(str(error))
                    self._lose(str(error))
                    continue
                if live is not None and self._watched is None:
                    self._begin(live)
                elif self._watched is not None:
                    self._look(self._watched, with_figures=tick % _FIGURES_TICKS == 0)
                tick += 1
            if self._watched is not None:
                self._look(self._watched, with_figures=False)  # a daemon that ends this process has just ended

    def greeting(self) -> tuple[list[dict[str, Any]], int]:
        """Return the messages with which a page begins, and the number of the last one that they contain."""
        with self._lock:
            if self._watched is None:
                return [{"kind": "ended", "reason": self._reason}], self._number
            return self._watched.greeting(), self._number

    def metrics(self) -> str:
        """Return the metrics in Prometheus's text format."""
        with self._lock:
            watched = self._watched
            if watched is None:
                return metrics_text(self._name, None, {}, {})
            return metrics_text(self._name, watched.figures.snapshot(), watched.faults, watched.counts)

    def act(self, what: str, content: Mapping[str, Any]) -> dict[str, Any]:
        """Pass a request on to the daemon; return its answer, or why it is refused."""
        try:
            request: dict[str, Any] = {"do": what}
            if what == "set":
                request["values"] = self._with_paths(content.get("values"))
            return ask(find(self._name), request)
        except FrictionHilError as error:
            return {"ok": False, "problems": str(error).splitlines()}

    def _with_paths(self, values: Any) -> Any:
        """Return values to set, with the path of each model file in the place of its name.

        Raises `UsageError`: a model is not among the files beside the configuration (a page does not read any other
        file), or no daemon is attached, whose files they are.
        """
        with self._lock:
            watched, reason = self._watched, self._reason
        if watched is None:
            raise UsageError(reason)
        if not isinstance(values, dict):
            return values
        found = dict(values)
        for key, value in values.items():
            axis, _, rest = str(key).partition(".")
            if rest == "model" and axis in watched.live.facts.axes:
                files = watched.models(axis)
                if not isinstance(value, str) or value not in files:
                    raise UsageError(
                        f"{key}: {value!r} is no model file beside the configuration; {choices(str(value), files)}"
                    )
                found[key] = str(files[value])
        return found

    def _begin(self, live: Live) -> None:
        watched = _Watched(live)
        if live.is_over:
            return  # it is just ending
        if self._foxglove is not None:
            self._foxglove.begin(live.facts)
        with self._lock:
            self._watched, self._reason = watched, ""
            self._number += 1
            self._publish_all(watched.greeting())
        self._report(f"attached to {self._name}: {printable(live.facts.source)}")

    def _look(self, watched: "_Watched", *, with_figures: bool) -> None:
        reading = watched.live.read()
        with self._lock:
            self._number += 1
            self._publish_all(watched.take(reading))
            if (with_figures and self._is_wanted()) or reading.is_over:
                self._publish(self._number, watched.figures_message())
        if self._foxglove is not None:
            self._foxglove.send(reading)
        if reading.is_over:
            faults = watched.figures.snapshot().faults
            because = f" after a fault: {faults[0].text}" if faults else ""
            if self._foxglove is not None:
                self._foxglove.end()
            self._report(f"{self._name} has ended")
            self._lose(f"the daemon {self._name!r} has ended{because}")

    def _lose(self, reason: str) -> None:
        with self._lock:
            if reason == self._reason:
                return
            self._watched, self._reason = None, reason
            self._number += 1
            self._publish(self._number, {"kind": "ended", "reason": reason})

    def _publish_all(self, messages: list[dict[str, Any]]) -> None:
        for message in messages:
            self._publish(self._number, message)


class _Watched:
    """A daemon that is being read, and what was made of its rows."""

    def __init__(self, live: Live) -> None:
        self.live = live
        facts = live.facts
        self.figures = LiveFigures(facts, live.faults)
        self.faults: Counter[str] = Counter()  # by code, since this was attached
        self.counts: Counter[str] = Counter(dict.fromkeys(_SHOWN_EVENTS, 0))  # of events, by name
        self._strips = {axis: Strips(len(COLUMNS), facts.period_s) for axis in facts.axes}
        self._circle = circle_tracer(facts)
        self._events: deque[dict[str, Any]] = deque(maxlen=_MOST_EVENTS)
        self.take(live.read())

    def take(self, reading: Reading) -> list[dict[str, Any]]:
        """Take what was read; return the messages about it."""
        self.figures.take(reading)
        rows = reading.rows
        points: dict[str, Points] = {}
        for axis, strips in self._strips.items():
            points[axis] = strips.take(rows.of(axis, "time_s"), strip_values(rows, axis))
        if self._circle is not None:
            self._circle.take(rows, reading.lost)
        messages = [rows_message(points)] if any(times for times, _ in points.values()) else []
        events = []
        for event in reading.events:
            if event.name == "fault":
                self.faults[event.code] += 1
            if event.name in _SHOWN_EVENTS:
                self.counts[event.name] += 1
                one = {"kind": event.name, "text": event.text, "remedy": plain_text(event.remedy)}
                events.append({"time": f"{event.time_s:.3f} s", **one})
        if events:
            self._events.extend(events)
            messages.append({"kind": "events", "events": events})
        return messages

    def figures_message(self) -> dict[str, Any]:
        """Return the figures at this moment."""
        points = {axis: strips.window() for axis, strips in self._strips.items()}
        circle = None if self._circle is None else self._circle.figures()
        return figures_message(self.live.facts, self.figures.snapshot(), points, circle)

    def greeting(self) -> list[dict[str, Any]]:
        """Return the messages with which a page begins."""
        facts = self.live.facts
        models = {axis: sorted(self.models(axis)) for axis in facts.axes}
        points = {axis: strips.window() for axis, strips in self._strips.items()}
        messages = [*hello(facts, models, points), self.figures_message()]
        return [*messages, {"kind": "events", "events": list(self._events)}] if self._events else messages

    def models(self, axis: str) -> dict[str, Path]:
        """Return the model files beside the configuration, and beside the one in force, by name."""
        present = self.live.settings.axes[axis].model_file
        folders = [Path(self.live.facts.source).parent, *(() if present is None else (Path(present).parent,))]
        return {file.name: file.absolute() for folder in reversed(folders) for file in model_files(folder)}
