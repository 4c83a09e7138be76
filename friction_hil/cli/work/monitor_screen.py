"""The screen of ``friction-hil monitor``: lines of a given width and height from the figures of a daemon. Pure."""

import math
import textwrap
from collections.abc import Sequence

import numpy as np

from friction_hil.daemon import learning_words
from friction_hil.live import AxisSnapshot, Snapshot
from friction_hil.live.friction_map import FrictionMap
from friction_hil.live.values import values_of
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import digits, quantity, shortened
from friction_hil.printable import printable

_GAP = "  "
_HISTOGRAM_WIDTH = 26
_LEAST_GRAPH = 5  # lines
_MOST_MESSAGES = 6
_MOST_LEARNING = 2  # lines of a text
_BARS = " ▏▎▍▌▋▊▉█"
_BRAILLE = 0x2800
_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
_LEAST_CELL = 11  # characters, so that columns stay where they are
_LONG = ("Parameters", "Learning")  # what is no value for a table
_STYLES = {"bold": "1", "red": "31;1", "yellow": "33", "cyan": "36", "dim": "2"}
_COLOURS = ("red", "yellow", "cyan")
_MEASURED = "●"

Part = tuple[str, str]  # text and style
Line = list[Part]


def screen(shown: Snapshot, width: int, height: int, chosen: int, *, is_coloured: bool, is_live: bool) -> list[str]:
    """Return the lines of the screen, at most ``height`` of at most ``width - 1`` characters each.

    ``width``, ``height``: of the terminal; the last column stays empty, because some terminals wrap there. ``chosen``:
    axis whose friction is drawn, counted over all axes again and again. ``is_live``: False for a single picture: there
    are no keys to name.
    """
    width -= 1
    axes = list(shown.axes.items())
    name, axis = axes[chosen % len(axes)]
    values = [(each, dict(values_of(found))) for each, found in axes]
    lines = [_head(shown, width), _timing(shown)]
    footer: list[Line] = [[("q ends" + ("  Tab: next axis" if len(axes) > 1 else ""), "dim")]] if is_live else []
    messages = _messages(shown, width)
    learning = [[(text, "")] for each in _learning(values) for text in _wrapped(each, width)[:_MOST_LEARNING]]
    room = height - len(lines) - len(footer)
    for table in _tables(values, width):
        lines += table[: max(0, room - min(len(messages), 2))]
        room = height - len(lines) - len(footer)
    lines += learning[: max(0, room - _LEAST_GRAPH - min(len(messages), _MOST_MESSAGES))]
    room = height - len(lines) - len(footer)
    graph = _graph(shown, name, axis, width, room - min(len(messages), _MOST_MESSAGES))
    lines += graph
    room = height - len(lines) - len(footer)
    lines += messages[:room]
    lines += [[] for _ in range(height - len(lines) - len(footer) if is_live else 0)]
    return [_rendered(line, width, is_coloured=is_coloured) for line in [*lines, *footer][:height]]


def waiting_screen(name: str, last: Snapshot | None, width: int, height: int, *, is_coloured: bool) -> list[str]:
    """Return the lines while no daemon of this name runs: what the last one said at its end stays."""
    lines: list[Line] = [[(f"waiting for {printable(name)}", "bold")]]
    if last is not None:
        lines += [[(f"the last one ended at {last.time_s:.1f} s", "")], *_messages(last, width - 1)]
    room = max(0, height - 1 - len(lines))
    lines = [*lines[: height - 1], *([] for _ in range(room)), [("q ends", "dim")]]
    return [_rendered(line, width - 1, is_coloured=is_coloured) for line in lines]


def brief_line(shown: Snapshot) -> str:
    """Return one line of text, for an output that is no terminal."""
    parts = [f"{printable(shown.name)}: {shown.state}", f"{digits(shown.time_s, 4)} s", f"missed {shown.missed}"]
    parts.append(f"late p99 {_microseconds(shown.lateness.p99_us)}")
    for name, axis in shown.axes.items():
        figures = axis.compensated if axis.is_enabled else axis.without
        rms = "-" if figures is None else quantity(figures.rms, axis.unit)
        condition = "with" if axis.is_enabled else "without"
        parts.append(f"{printable(name)}: {axis.drive_state}, error {rms} rms {condition} compensation")
        if axis.learning is not None:
            parts.append(f"learning {printable(learning_words.summary(axis.learning))}")
    parts += [f"fault: {printable(each.text)}" for each in shown.faults]
    return "; ".join(parts)


def _head(shown: Snapshot, width: int) -> Line:
    style = "red" if shown.faults or shown.state in ("unknown", "fault stopping") else "bold"
    line: Line = [(printable(shown.name), "bold"), (_GAP, ""), (shown.state, style)]
    line += [(f"{_GAP}{digits(shown.time_s, 4)} s{_GAP}period {quantity(shown.period_s, 's')}", "")]
    if shown.stands:
        line.append((f"{_GAP}the loop stands: nothing is known of the drives", "red"))
    elif shown.change:
        line.append((f"{_GAP}change {shown.change}", ""))
    return line


def _timing(shown: Snapshot) -> Line:
    late = shown.lateness
    missed: Part = (f"missed {shown.missed}", "yellow" if shown.missed else "")
    values = "/".join(map(_microseconds, (late.p50_us, late.p99_us, late.max_us)))
    lost = f"{_GAP}rows not seen {shown.lost}" if shown.lost else ""
    return [missed, (f"{_GAP}late p50/p99/max {values}{lost}", "")]


def _microseconds(value: float) -> str:
    return quantity(value * 1e-6, "s")


def _tables(axes: Sequence[tuple[str, dict[str, str]]], width: int) -> list[list[Line]]:
    """Return tables with a heading and a line for each axis: as many as the values take side by side."""
    names = ["axis", *(shortened(printable(name), max(4, width // 4)) for name, _ in axes)]
    first = max(map(len, names))
    tables: list[list[Line]] = []
    room = 0
    for label in dict.fromkeys(label for _, values in axes for label in values if not label.startswith(_LONG)):
        cells = [label, *(printable(values.get(label, "")) for _, values in axes)]
        size = max(_LEAST_CELL, *map(len, cells))
        if size + len(_GAP) > room:
            room = width - first
            tables.append([[(name.ljust(first), "dim" if k == 0 else "")] for k, name in enumerate(names)])
        room -= size + len(_GAP)
        for line, cell in zip(tables[-1], cells, strict=True):
            line.append((_GAP + cell.rjust(size), line[0][1]))
    return tables


def _learning(axes: Sequence[tuple[str, dict[str, str]]]) -> list[str]:
    """Return what learning does for each axis, and below the parameters in use with their standard errors."""
    texts = []
    for name, values in axes:
        if "Learning" in values:
            texts.append(f"{name} learning {values['Learning']}")
            texts += [f"  {text}" for label, text in values.items() if label == "Parameters with standard errors"]
    return texts


def _messages(shown: Snapshot, width: int) -> list[Line]:
    """Return faults with their remedy, then the last warning, wrapped."""
    lines: list[Line] = []
    marked = [(each, "fault", "red") for each in shown.faults]
    marked += [(each, "warning", "yellow") for each in shown.warnings[:-3:-1]]
    for each, kind, style in marked:
        lines += [[(text, style)] for text in _wrapped(f"{kind}: {each.text}", width)]
        if each.remedy:
            lines += [[(text, "")] for text in _wrapped(f"  remedy: {each.remedy}", width)]
    return lines


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(printable(text), max(width, 10), subsequent_indent="    ") or [""]


def _graph(shown: Snapshot, name: str, axis: AxisSnapshot, width: int, height: int) -> list[Line]:
    """Return friction over velocity, and beside it the lateness where there is room."""
    if height < _LEAST_GRAPH or width < _HISTOGRAM_WIDTH:
        return []
    is_wide = width >= 2 * _HISTOGRAM_WIDTH + 8
    left_width = width - _HISTOGRAM_WIDTH - len(_GAP) if is_wide else width
    left = _friction(axis, printable(name), left_width, height)
    if not is_wide:
        return left
    right = _histogram(shown, _HISTOGRAM_WIDTH, height)
    lines = []
    for k in range(max(len(left), len(right))):
        part = left[k] if k < len(left) else []
        space = left_width - sum(len(text) for text, _ in part)
        lines.append([*part, (" " * max(space, 0) + _GAP, ""), *(right[k] if k < len(right) else [])])
    return lines


def _friction(axis: AxisSnapshot, name: str, width: int, height: int) -> list[Line]:
    """Return measured friction and the steady state of the model over velocity, drawn in characters."""
    found = axis.friction
    title: Line = [(f"friction of {name} over velocity", "bold")]
    if found.note:
        return [title, [(shortened(found.note, width), "")]]
    title += [(f"{_GAP}{_MEASURED} measured", "cyan"), (f"{_GAP}⠒ {printable(axis.model)}", "yellow")]
    fastest, highest = _reach(found)
    rows, columns = height - 2, width
    canvas = _canvas(found.curve_velocity / fastest, found.curve_torque / highest, columns, rows)
    grid = [[(chr(_BRAILLE + code) if code else " ", "yellow") for code in line] for line in canvas]
    for velocity, torque in zip(found.velocity / fastest, found.torque / highest, strict=True):
        column, row = round((velocity + 1.0) / 2.0 * (columns - 1)), round((1.0 - torque) / 2.0 * (rows - 1))
        grid[min(max(row, 0), rows - 1)][column] = _MEASURED, "cyan"
    middle = columns // 2
    for line in grid:
        if line[middle][0] == " ":
            line[middle] = "│", "dim"
    low, high = quantity(-fastest, f"{axis.unit}/s"), quantity(fastest, f"{axis.unit}/s")
    scale = f"±{quantity(highest, axis.torque_unit)}"
    return [title, *map(_joined, grid), [(low + scale.center(max(columns - len(low) - len(high), 1)) + high, "dim")]]


def _reach(found: FrictionMap) -> tuple[float, float]:
    """Return the largest velocity and torque that are drawn."""
    fastest = float(np.max(np.abs(found.velocity), initial=0.0)) * 1.02 or 1.0
    inside = np.abs(found.curve_velocity) <= fastest
    curve = found.curve_torque[inside]
    highest = float(np.max(np.abs(found.torque), initial=0.0))
    return fastest, max(highest, float(np.nanmax(np.abs(curve), initial=0.0))) * 1.05 or 1.0


def _canvas(x: Array, y: Array, columns: int, rows: int) -> "list[list[int]]":
    """Return the codes of braille cells for points in -1 to 1; the points are joined where they are far apart."""
    codes = np.zeros((rows, columns), np.int64)
    known = np.isfinite(x) & np.isfinite(y) & (np.abs(x) <= 1.0)
    if known.sum() > 1:
        fine = np.linspace(-1.0, 1.0, 2 * columns)
        for side in (fine < 0.0, fine > 0.0):
            part = known & ((x < 0.0) if side[0] else (x > 0.0))
            if part.sum() < 2:
                continue
            torque = np.interp(fine[side], x[part], y[part])
            across = np.flatnonzero(side)
            down = np.clip(np.rint((1.0 - torque) / 2.0 * (4 * rows - 1)).astype(int), 0, 4 * rows - 1)
            np.bitwise_or.at(codes, (down // 4, across // 2), _DOTS[down % 4, across % 2])
    listed: list[list[int]] = codes.tolist()
    return listed


def _joined(cells: Sequence[Part]) -> Line:
    """Return characters of one style that follow each other as one part."""
    line: Line = []
    for text, style in cells:
        if line and line[-1][1] == style:
            line[-1] = line[-1][0] + text, style
        else:
            line.append((text, style))
    return line


def _histogram(shown: Snapshot, width: int, height: int) -> list[Line]:
    """Return bars of the lateness on a logarithmic scale, from the first bin in use to the last."""
    late = shown.lateness
    lines: list[Line] = [[("lateness, log. counts", "bold")]]
    used = np.flatnonzero(late.counts)
    if not used.size:
        return lines
    labels = [f"≤ {_microseconds(each)}" for each in late.bounds_us]
    labels.append(f"> {_microseconds(late.bounds_us[-1])}")
    first, last = int(used[0]), int(used[-1])
    first = max(first, last - (height - 2))  # the latest ones matter
    size = max(map(len, labels))
    room = width - size - 1
    longest = math.log1p(float(late.counts.max()))
    for k in range(first, last + 1):
        eighths = round(8 * room * math.log1p(float(late.counts[k])) / longest)
        bar = "█" * (eighths // 8) + _BARS[eighths % 8].strip()
        lines.append([(f"{labels[k]:>{size}} ", ""), (bar, "cyan")])
    return lines[:height]


def _rendered(line: Line, width: int, *, is_coloured: bool) -> str:
    """Return a line with the control sequences of its styles, cut to ``width`` characters."""
    text, room = "", width
    for part, style in line:
        part = part[:room]
        room -= len(part)
        is_shown = style and (is_coloured or style not in _COLOURS) and part.strip()
        text += f"\x1b[{_STYLES[style]}m{part}\x1b[0m" if is_shown else part
        if not room:
            break
    return text
