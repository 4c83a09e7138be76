"""Metrics for Prometheus, in base units. Pure."""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric

from friction_hil.daemon.learning_words import DOINGS
from friction_hil.daemon.safety import LoopState
from friction_hil.live import AxisSnapshot, Snapshot

_P = "friction_hil_"
_UNITS = {"rad": "radians", "m": "meters", "N m": "newton_meters", "N": "newtons"}


class _Collected:
    """Metrics as the library wants them."""

    def __init__(self, metrics: Iterable[Metric]) -> None:
        self._metrics = list(metrics)

    def collect(self) -> Iterable[Metric]:
        return self._metrics


def metrics_text(
    name: str, snapshot: Snapshot | None, faults: Mapping[str, int], events: Mapping[str, int] | None = None
) -> str:
    """Return the metrics of a daemon as text.

    ``snapshot``: None while no daemon of this name runs. ``faults``: their number by code, since the daemon is watched.
    ``events``: their number by name, since then: what a drive says of itself is a notice.
    """
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Collected(_metrics(name, snapshot, faults, events or {})))
    return generate_latest(registry).decode()


def _metrics(
    name: str, snapshot: Snapshot | None, faults: Mapping[str, int], events: Mapping[str, int]
) -> Iterator[Metric]:
    is_up = snapshot is not None and not snapshot.stands
    yield _gauge("up", "1 while the daemon runs and its loop writes rows", name, float(is_up))
    if snapshot is None:
        return
    about = GaugeMetricFamily(f"{_P}daemon_info", "Version of the daemon.", labels=["daemon", "version"])
    about.add_metric([name, snapshot.version], 1.0)
    yield about
    yield _counter("missed_periods", "Periods that the loop has missed", name, snapshot.missed)
    yield _counter("rows_lost", "Rows that did not reach this server in time", name, snapshot.lost)
    yield _gauge("active_faults", "Faults that nobody has reset", name, float(len(snapshot.faults)))
    counted = CounterMetricFamily(f"{_P}faults", "Faults since the daemon is watched.", labels=["daemon", "code"])
    for code, count in sorted(faults.items()):
        counted.add_metric([name, code], count)
    yield counted
    told = CounterMetricFamily(f"{_P}events", "Events since the daemon is watched.", labels=["daemon", "event"])
    for event, count in events.items():
        told.add_metric([name, event], count)
    yield told
    yield _histogram(name, snapshot)
    state = GaugeMetricFamily(f"{_P}state", "1 for the state of the run.", labels=["daemon", "state"])
    for each in LoopState:
        words = each.name.lower().replace("_", " ")
        state.add_metric([name, words], float(snapshot.state == words))
    yield state
    yield _gauge("period_seconds", "Period of the loop", name, snapshot.period_s)
    if is_up:
        yield _gauge("run_seconds", "Time since the first cycle", name, snapshot.time_s)
        yield from _axes(name, snapshot.axes)


def _histogram(name: str, snapshot: Snapshot) -> Metric:
    lateness = snapshot.lateness
    counts = lateness.total_counts.cumsum().tolist()
    bounds = [f"{bound * 1e-6:g}" for bound in lateness.bounds_us] + ["+Inf"]
    family = HistogramMetricFamily(f"{_P}lateness_seconds", "How late the cycles began.", labels=["daemon"])
    family.add_metric([name], list(zip(bounds, map(float, counts), strict=True)), lateness.total_us * 1e-6)
    return family


class _AxisMetrics:
    """Metrics of a daemon with a sample for each axis."""

    def __init__(self, name: str) -> None:
        self._name = name
        self.families: dict[str, GaugeMetricFamily | CounterMetricFamily] = {}

    def add(self, metric: str, text: str, axis: str, value: float, **labels: str) -> None:
        """Add a gauge; without a sample where the value is not known."""
        family = self._family(GaugeMetricFamily, metric, f"{text}.", labels)
        if math.isfinite(value):
            family.add_metric([self._name, axis, *labels.values()], value)

    def count(self, metric: str, text: str, axis: str, value: int) -> None:
        """Add a counter that begins with the run."""
        self._family(CounterMetricFamily, metric, f"{text}, since the run began.", {}).add_metric(
            [self._name, axis], value
        )

    def _family(
        self,
        kind: type[GaugeMetricFamily] | type[CounterMetricFamily],
        metric: str,
        text: str,
        labels: Mapping[str, str],
    ) -> GaugeMetricFamily | CounterMetricFamily:
        if metric not in self.families:
            self.families[metric] = kind(f"{_P}{metric}", text, labels=["daemon", "axis", *labels])
        return self.families[metric]


def _axes(name: str, axes: Mapping[str, AxisSnapshot]) -> Iterator[Metric]:
    metrics = _AxisMetrics(name)
    add = metrics.add
    for axis, each in axes.items():
        length, torque = _UNITS[each.unit], _UNITS[each.torque_unit]
        add(f"position_{length}", "Measured position", axis, each.position)
        add(f"velocity_{length}_per_second", "Measured velocity", axis, each.velocity)
        add(f"torque_{torque}", "Actual torque", axis, each.torque)
        add(f"compensation_{torque}", "Compensation", axis, each.compensation)
        add(f"compensation_rms_{torque}", "Root mean square of the compensation", axis, each.compensation_rms)
        add(f"following_error_{length}", "Demanded less measured position", axis, each.error)
        for words, figures in (("off", each.without), ("on", each.compensated)):
            rms, peak = (math.nan, math.nan) if figures is None else (figures.rms, figures.peak)
            text = "following error of the last steady motion, without and with compensation"
            add(f"following_error_rms_{length}", f"Root mean square of the {text}", axis, rms, compensation=words)
            add(f"following_error_peak_{length}", f"Largest absolute {text}", axis, peak, compensation=words)
        add("temperature_celsius", "Temperature of the axis", axis, each.temperature)
        add("compensation_enabled", "1 where the compensation is switched on", axis, float(each.is_enabled))
        add("compensation_gain_ratio", "Factor of the model's torque", axis, each.gain)
        powered = math.nan if each.is_powered is None else float(each.is_powered)
        add("drive_powered", "1 where the drive may produce torque; missing where that is unknown", axis, powered)
        for parameter, value in each.parameters.items():
            if isinstance(value, int | float):
                text = "Parameter of the friction model, in SI units"
                add("model_parameter", text, axis, float(value), model=each.model, parameter=parameter)
        if each.learning is not None:
            _add_learning(metrics, axis, each.learning["family"]["in_use"] or each.model, each.learning, length)
    yield from metrics.families.values()


def _add_learning(metrics: _AxisMetrics, axis: str, model: str, report: Mapping[str, Any], length: str) -> None:
    """Add what learning knows of an axis, and what it has done."""
    is_valid = report["doing"] != "ended" and report["parameters"]
    for parameter, value in report["parameters"].items() if is_valid else ():
        labels = {"model": model, "parameter": parameter}
        text = "Estimate of a parameter of the friction model by learning, in SI units"
        metrics.add("learned_parameter", text, axis, value, **labels)
        text = "Standard error of the estimate, relative to the parameter; of a ripple to its amplitude"
        metrics.add("learned_parameter_error_ratio", text, axis, report["relative_errors"][parameter], **labels)
    for doing in DOINGS:
        metrics.add("learning_state", "1 for what learning does", axis, float(report["doing"] == doing), state=doing)
    metrics.count("learning_kept", "Hand-overs of parameters that were kept", axis, report["re_identified"])
    metrics.count("learning_taken_back", "Changes that were taken back", axis, report["taken_back"])
    metrics.count("learning_stopped", "Stops because the record was not that of the axis", axis, report["stopped"])
    text = "Following error (root mean square) of the same motion, with the parameters of the model file and those kept"
    for key, words in (("error_before", "file"), ("error_after", "kept")):
        value = math.nan if report[key] is None else report[key]
        metrics.add(f"learning_error_rms_{length}", text, axis, value, parameters=words)


def _gauge(metric: str, text: str, name: str, value: float) -> Metric:
    family = GaugeMetricFamily(f"{_P}{metric}", f"{text}.", labels=["daemon"])
    if math.isfinite(value):
        family.add_metric([name], value)
    return family


def _counter(metric: str, text: str, name: str, value: int) -> Metric:
    family = CounterMetricFamily(f"{_P}{metric}", f"{text}, since the daemon is watched.", labels=["daemon"])
    family.add_metric([name], value)
    return family
