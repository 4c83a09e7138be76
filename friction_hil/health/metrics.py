"""The judgement in the text format of Prometheus, for the textfile collector of its node exporter. Pure."""

from collections.abc import Iterable, Iterator

from friction_hil.health.judge import Health, Verdict

_P = "friction_hil_health_"
_QUANTITY = (
    ("value", "last value, at the temperature of the baseline, SI units", lambda v: float(v.values[-1])),
    ("baseline", "mean of the baseline, SI units", lambda v: v.baseline),
    ("change", "change since it was first seen, SI units; 0 if unchanged", lambda v: v.change),
    ("sum_ratio", "CUSUM over its threshold; an alarm is given at 1", lambda v: v.level),
    ("alarm", "1 if the quantity has changed", lambda v: float(v.state == "changed")),
)


def metrics_text(found: Iterable[Health]) -> str:
    """Return the metrics of axes as text; quantities that are not judged have none."""
    return "".join(f"{line}\n" for line in _lines(list(found)))


def _lines(found: list[Health]) -> Iterator[str]:
    yield from _head("judged", "1 if any quantity of the axis is compared with a baseline")
    yield from (f"{_P}judged{{{_label('axis', each.axis)}}} {int(each.is_judged)}" for each in found)
    for name, text, value_of in _QUANTITY:
        yield from _head(name, text)
        for health in found:
            for verdict in health.verdicts:
                if verdict.state in ("changed", "unchanged") and (value := value_of(verdict)) is not None:
                    yield f"{_P}{name}{{{_labels(health, verdict)}}} {value:.10g}"
    yield from _head("last_observation_timestamp_seconds", "time of the last observation")
    for health in found:
        times = [float(each.times_s[-1]) for each in health.verdicts if each.times_s.size]
        if times:
            yield f"{_P}last_observation_timestamp_seconds{{{_label('axis', health.axis)}}} {max(times):.3f}"


def _head(name: str, text: str) -> Iterator[str]:
    yield f"# HELP {_P}{name} {text}"
    yield f"# TYPE {_P}{name} gauge"


def _labels(health: Health, verdict: Verdict) -> str:
    return ",".join([_label("axis", health.axis), _label("quantity", verdict.name), _label("unit", verdict.unit)])


def _label(name: str, value: str) -> str:
    escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'{name}="{escaped}"'
