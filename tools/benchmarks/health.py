"""Simulated years of axes whose friction changes: delay until ``friction-hil health`` notices, and its false alarms.

Each simulated axis makes the same motion once a day, at any hour. Its friction is LuGre with parameters that scatter
from day to day, and fall as it gets warm: by day, and in summer. The recordings pass all of `friction_hil.health`.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import click
import numpy as np

import friction_hil as fh
from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import new_table, number, print_table, prose
from friction_hil.health import Layout, Observation
from friction_hil.health.observation import family
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from tools.benchmarks.report import machine, rounds

DAY_S, YEAR_DAYS = 86400.0, 365
BEGIN = 100  # day on which a change begins
DT, DURATION_S = 0.004, 20.0
SCATTER, MEMORY = 0.015, 0.3  # of the parameters from day to day, and correlation of successive days
COULOMB_PER_K, VISCOUS_PER_K = -0.003, -0.012
DAILY_K, YEARLY_K, SENSOR_K = 5.0, 6.0, 0.5
NOISE, INERTIA, OFFSET = 0.004, 0.004, 0.01  # N m, kg m^2, N m
LOAD_SHARE = 0.6  # of the friction, behind the transmission


@dataclass(frozen=True, slots=True)
class Change:
    """What happens to an axis from day `BEGIN` on; rates per day.

    Attributes
    ----------
    name : str
    coulomb, coulomb_rate : float
        Step and growth of the Coulomb level, parts of it.
    viscous_rate, static_rate : float
        Growth of viscous friction, and of the static level.
    ripple : float
        Amplitude of a torque of order 3, N m.
    play_rate : float
        Growth of the play of the transmission, rad.
    """

    name: str
    coulomb: float = 0.0
    coulomb_rate: float = 0.0
    viscous_rate: float = 0.0
    static_rate: float = 0.0
    ripple: float = 0.0
    play_rate: float = 0.0


NOTHING = Change("nothing but days, nights and seasons")
CHANGES = (
    Change("wear: Coulomb friction +0.2 % a day", coulomb_rate=0.002),
    Change("loss of grease: viscous friction +0.5 %, static level +0.3 % a day", viscous_rate=0.005, static_rate=0.003),
    Change("tightened bearing: Coulomb friction +10 % at once", coulomb=0.1),
    Change("damaged race: torque of order 3, 5 % of the Coulomb level", ripple=0.008),
    Change("play of the transmission +0.3 mrad a day", play_rate=3e-4),
)


def temperature(day: float) -> float:
    """Return the temperature at a time, °C."""
    hour, year = math.tau * day, math.tau * day / YEAR_DAYS
    return 30.0 - DAILY_K * math.cos(hour) - YEARLY_K * math.cos(year)


def recording(change: Change, day: float, factors: Array, rng: np.random.Generator) -> Recording:
    """Simulate the recording of a day; ``factors`` scale Coulomb, static and viscous friction."""
    age = day - BEGIN
    has_begun, days = age >= 0.0, max(age, 0.0)
    warm = temperature(day) - 30.0
    coulomb = 0.16 * factors[0] * (1.0 + COULOMB_PER_K * warm)
    coulomb *= 1.0 + has_begun * change.coulomb + change.coulomb_rate * days
    static = 1.25 * coulomb * factors[1] * (1.0 + change.static_rate * days)
    viscous = 0.03 * factors[2] * math.exp(VISCOUS_PER_K * warm) * (1.0 + change.viscous_rate * days)
    time = np.arange(0.0, DURATION_S, DT)
    position = sum(size * np.sin(math.tau * hertz * time) for size, hertz in ((2.4, 0.3), (0.9, 0.45), (0.5, 0.8)))
    position = np.asarray(position) + 1e-4 * rng.normal()
    velocity = np.gradient(position, DT)
    model = fh.models.create(
        "lugre",
        sigma0=60.0,
        sigma1=0.1,
        sigma2=viscous,
        coulomb=coulomb,
        static=static,
        stribeck_velocity=0.1,
    )
    load = np.gradient(_behind_play(position, 5e-3 + change.play_rate * days), DT)
    friction = (1.0 - LOAD_SHARE) * model.simulate(velocity, DT) + LOAD_SHARE * model.simulate(load, DT)
    torque = friction + INERTIA * np.gradient(velocity, DT) + OFFSET + NOISE * rng.normal(size=len(time))
    if has_begun:
        torque = torque + change.ripple * np.cos(3.0 * position)
    columns = {
        "time_s": time,
        "position": np.round(position / 1e-5) * 1e-5,
        "velocity": velocity,
        "torque": torque,
        "temperature": np.full(len(time), temperature(day) + SENSOR_K * rng.normal()),
    }
    return Recording(f"day {day:.1f}", "x", columns)


def _behind_play(position: Array, width: float) -> Array:
    """Return the position of a load that a gap of this width separates from the motor."""
    load, at = np.empty(len(position)), float(position[0])
    for i, motor in enumerate(position.tolist()):
        at = min(max(at, motor - 0.5 * width), motor + 0.5 * width)
        load[i] = at
    return load


def observations(change: Change, seed: int, days: int) -> Iterator[tuple[Observation, Layout]]:
    """Yield the observations of an axis, one a day."""
    rng = np.random.default_rng(seed)
    layout: Layout | None = None
    deviation = np.zeros(3)
    for day in range(days):
        deviation = MEMORY * deviation + SCATTER * math.sqrt(1.0 - MEMORY**2) * rng.normal(size=3)
        time = day + rng.uniform()
        one = recording(change, time, 1.0 + deviation, rng)
        found, layout, _ = fh.health.observe(one, started_s=time * DAY_S, layout=layout)
        yield from ((each, layout) for each in found)


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result for one axis: delay of the first alarm, days, infinite without one; number of alarms before; what rose."""

    delay: float
    early: int
    first: tuple[str, ...]


def follow(change: Change, seed: int, days: int) -> Outcome:
    """Judge an axis day by day, as somebody would who runs the command every day."""
    found: list[Observation] = []
    early, before = 0, False
    begin = days if change is NOTHING else BEGIN
    for observation, layout in observations(change, seed, days):
        found.append(observation)
        health = fh.health.judge("x", found, layout)
        day = observation.time_s / DAY_S
        if health.changed and day >= begin and not before:
            return Outcome(day - begin, early, tuple(dict.fromkeys(family(each.name) for each in health.changed)))
        early += bool(health.changed) and not before
        before = bool(health.changed)
    return Outcome(math.inf, early, ())


@click.command("health", help=__doc__)
@click.option("--axes", type=click.IntRange(min=1), default=4, show_default=True, help="Axes for each kind of change.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout and nothing else.")
def command(axes: int, as_json: bool) -> None:
    """Simulate axes and print delays and false alarms."""
    changes = (NOTHING, *CHANGES)
    results: dict[str, list[Outcome]] = {each.name: [] for each in changes}
    for k in rounds(axes * len(changes), "axes"):
        change = changes[k % len(changes)]
        results[change.name].append(follow(change, k, YEAR_DAYS))
    rows = [_row(each, results[each.name], YEAR_DAYS) for each in changes]
    if as_json:
        print_json({"machine": machine(), "axes": axes, "days": YEAR_DAYS, "rows": rows})
        return
    columns = ("noticed", "median delay", "longest", "false alarms\nper axis-year")
    table = new_table(prose("change"), *map(number, columns), prose("first noticed in"))
    for row in rows:
        delays = ["-" if row[key] is None else f"{row[key]:.0f} days" for key in ("median_days", "longest_days")]
        noticed = "-" if row["noticed"] is None else f"{row['noticed']} of {axes}"
        table.add_row(row["change"], noticed, *delays, f"{row['false_alarms_per_year']:.2f}", ", ".join(row["first"]))
    print_table(table)
    click.echo(machine())


def _row(change: Change, outcomes: Sequence[Outcome], days: int) -> dict[str, Any]:
    watched = (days if change is NOTHING else BEGIN) - fh.health.BASELINE
    years = len(outcomes) * watched / YEAR_DAYS
    delays = sorted(each.delay for each in outcomes if math.isfinite(each.delay))
    first = Counter(name for each in outcomes for name in each.first)
    is_nothing = change is NOTHING
    return {
        "change": change.name,
        "noticed": None if is_nothing else len(delays),
        "median_days": median(delays) if delays else None,
        "longest_days": delays[-1] if delays else None,
        "false_alarms_per_year": sum(each.early for each in outcomes) / years,
        "first": [name for name, _ in first.most_common()],
    }
