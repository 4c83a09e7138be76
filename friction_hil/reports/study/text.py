"""Texts of the study: its sections, the columns of its main table, and a remark on each model."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from friction_hil.reports.numbers import digits

Facts = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class ExperimentText:
    """Section of the report on one experiment; ``facts`` maps the names of its numbers to their headings."""

    key: str
    title: str
    text: str
    facts: dict[str, str]


@dataclass(frozen=True, slots=True)
class SummaryColumn:
    """Column of the main table: one number, or two with an arrow between them.

    ``brief`` is a short heading for a terminal. ``{}`` in the name of a fact stands for the model.
    """

    title: str
    brief: str
    facts: tuple[str, ...]

    def write(self, facts: Facts, model: str) -> str:
        """Format the cell of a model."""
        return " → ".join(number(facts.get(fact.format(model))) for fact in self.facts)


def summary_columns() -> tuple[SummaryColumn, ...]:
    """Return the columns of the main table."""
    return (
        SummaryColumn("presliding [µm]", "pre-\nsliding\n[µm]", ("presliding_um",)),
        SummaryColumn("lag at 25 rad/s [mN]", "lag\n[mN]", ("lag_width_25_mN",)),
        SummaryColumn("break-away, slow → fast [N]", "break-away\n[N]", ("breakaway_slow_N", "breakaway_fast_N")),
        SummaryColumn("stuck [%]", "stuck\n[%]", ("stick_slip_stuck_percent", "stick_slip_stuck_percent_with_{}")),
        SummaryColumn("hunting [mm]", "hunting\n[mm]", ("hunting_swing_mm", "hunting_swing_mm_with_{}")),
        SummaryColumn("reversal [µrad]", "reversal\n[µrad]", ("reversal_peak_urad", "reversal_peak_urad_with_{}")),
    )


def number(value: float | None) -> str:
    """Format a number with three digits; a dash if the model has none."""
    if value is None:
        return "–"
    if not math.isfinite(value):
        return "not finite"
    if abs(value) < 5e-4:
        return "0"
    rounded = float(f"{value:.3g}")
    text = f"{value:.0f}" if abs(rounded) >= 100.0 else digits(rounded)
    return text.replace("-", "−")


_LOOK = {
    "armstrong": "break-away grows with the time at rest",
    "bouc_wen": "hysteresis of adjustable shape, but no Stribeck hump, hence no stick-slip",
    "coulomb": "a step: no presliding, no lag, no stick-slip; the plainest reversal spike",
    "dahl": "a spring that yields: presliding, but no Stribeck hump, hence no stick-slip",
    "elasto_plastic": "as lugre, but a small oscillating force does not make it drift",
    "gms": "it remembers each reversal: small loops close, and nothing drifts",
    "karnopp": "a Stribeck curve that sticks exactly: made for simulation",
    "lugre": "presliding, lag, rate-dependent break-away, stick-slip and hunting in one state",
    "power_law": "grows with a power of the velocity; no hump, no presliding",
    "stribeck": "a Stribeck hump without presliding: stick-slip, but no lag",
    "table": "a measured curve: as good as its points",
}


def look(model: str) -> str:
    """Return a remark on what to look at with a model."""
    return _LOOK.get(model, "")


SECTIONS = (
    ExperimentText(
        "static_curve",
        "1. Static curves",
        """At constant velocity each model settles on its own curve. Those with a <em>Stribeck</em> hump start at
        the break-away level (1.5 N) and fall to the Coulomb level (1 N) within a few mm/s, because a lubricant film
        builds up; then viscous friction grows with the velocity. Where the curve falls, friction pushes instead of
        damping: that is the root of stick-slip and hunting. Models that share a line here differ only in motion, as
        the next experiments show.""",
        {"curve_at_slow_N": "at 0.01 mm/s [N]", "curve_minimum_N": "lowest [N]"},
    ),
    ExperimentText(
        "velocity_pulse",
        "2. Response to a velocity pulse",
        """The contact is moved forward, stopped, and moved back. A static map jumps with the sign of the velocity
        and, at rest with nothing applied, has no friction at all. A model with a state rises like a spring and
        keeps its force at rest (compare dahl with lugre). Models with a Stribeck hump overshoot as they break away,
        and rise again as they come to rest.""",
        {"pulse_overshoot_N": "overshoot over the sliding level [N]", "pulse_at_rest_N": "left at rest [N]"},
    ),
    ExperimentText(
        "presliding",
        "3. Presliding and drift",
        """A force that is slowly cycled to 95 % of break-away does not make the mass slide, and yet it moves by
        tens of micrometres: the contact yields like a spring with losses, and the area of the loop is the energy
        lost in a cycle. A static map does not move at all. Second picture: a small oscillating force should leave
        the contact where it is. dahl, bouc_wen and lugre drift with each oscillation, an artefact that
        elasto_plastic and gms avoid. A damper of 100 N s/m in parallel keeps the mass from ringing.""",
        {
            "presliding_um": "displacement [µm]",
            "presliding_loss_uJ": "loss in a cycle [µJ]",
            "drift_um": "drift in 10 swings [µm]",
        },
    ),
    ExperimentText(
        "stress_strain",
        "4. Stress and strain",
        """The contact is moved slowly (0.1 mm/s) along a given path and friction is read. From rest the curve
        begins with the stiffness of the contact. The test is the small loop at zero: a real contact returns exactly
        to the path that it left (gap 0), because each asperity remembers its own deflection. gms does so; a model
        with a single state does not, and returns at a lower force. A static map is infinitely stiff.""",
        {"stiffness_N_per_um": "initial stiffness [N/µm]", "small_loop_gap_mN": "gap of the small loop [mN]"},
    ),
    ExperimentText(
        "frictional_lag",
        "5. Frictional lag",
        """The velocity oscillates between 0 and 2 mm/s without changing its sign. Friction follows its static curve
        with a delay: it is lower while the velocity falls than while it rises, and the loop opens as the
        oscillation becomes faster. The width is read at 1.5 mm/s. A static map, or a model without a Stribeck hump,
        has no loop.""",
        {f"lag_width_{rate}_mN": f"width at {rate} rad/s [mN]" for rate in (1, 10, 25)},
    ),
    ExperimentText(
        "break_away",
        "6. Break-away force",
        """A force that rises steadily pushes 1 kg until it slides. If it rises quickly, the contact already moves
        fast while it still yields, so that its level has fallen before it is reached. A break-away force in a data
        sheet therefore says little without the rate at which it was measured. (The contact of gms has no damping: 1
        kg on it oscillates and breaks away early.) The viscous part is subtracted.""",
        {"breakaway_slow_N": "at 0.2 N/s [N]", "breakaway_fast_N": "at 50 N/s [N]"},
    ),
    ExperimentText(
        "stick_slip",
        "7. Stick-slip",
        """1 kg is pulled through a soft spring (2 N/m) at 0.1 m/s. While it sticks the spring loads; when it breaks
        away friction falls, the mass jumps ahead and sticks again. Without a falling curve it slides steadily.
        (armstrong slides, too, after its first stop: when it sticks again, its undamped contact spring rings and
        breaks it loose.) The compensation acts on the mass: it is the compensator of the daemon at 1 kHz with gain
        0.9, acts one period late, sees the position through an encoder of 0.1 µm, and knows the demanded velocity
        of 0.1 m/s. A compensation without a Stribeck hump is constant as long as the demand is, and cannot end
        stick-slip: the fall from break-away to Coulomb level remains.""",
        {
            "stick_slip_stuck_percent": "stuck, of the last 20 s [%]",
            "stick_slip_swing_mm_s": "swing of the velocity [mm/s]",
        },
    ),
    ExperimentText(
        "hunting",
        "8. Hunting",
        """A PID controller (3 N/m, 4 N/(m s), 6 N s/m) brings 1 kg to 1 m. Where the mass sticks short of the
        target, the integral grows until it breaks away and jumps past the target, again and again: it hunts.
        Without a hump each jump is smaller than the last, and hunting decays. The compensator (gain 0.9) uses only
        the measured velocity here, since a step has no demanded velocity. A contact with presliding moves before it
        breaks away, so that the compensation acts in time, and hunting shrinks to that of a tenth of the friction.
        A static map does not move before it breaks away: the compensation comes too late, adds to a jump that has
        begun, and makes hunting <em>worse</em>. So does a compensator whose model has more friction than the axis,
        or a contact much softer than the real one (gms here), which still pushes in the old direction after the
        mass has reversed. On a real axis: feed the compensation from a demanded motion, and keep its gain below 1
        where only the measured velocity is known.""",
        {"hunting_swing_mm": "swing in the last 40 s [mm]"},
    ),
    ExperimentText(
        "reversal",
        "9. Reversal spikes on a circle",
        """Two equal servo axes draw a circle of 1 rad at 0.5 Hz. The drive's loops are tuned and fed forward as in
        <code>friction-hil demo</code>. Where an axis reverses, friction changes its sign faster than the loops can
        react: the axis lags behind, which causes a spike. The daemon's compensator (1 kHz, torque offset one period
        late; gain 1, since the levels are known exactly here) knows the demanded velocity ahead of time, and
        removes most of the spike: nearly all of it if its model has the shape of the true friction. The diagonal of
        the table shows what a perfect identification can reach, the rest of a row the effect of a wrong model.""",
        {"reversal_peak_urad": "largest radius error [µrad]", "reversal_rms_urad": "rms [µrad]"},
    ),
)

HOW_MATCHED = """
<p>All models of an axis have the same levels: Coulomb level, break-away level, Stribeck velocity, viscous
coefficient, stiffness and damping, as far as the model has them. Experiments 1 to 8 use the reference set of Canudas
de Wit, Olsson, Åström and Lischinsky (IEEE Transactions on Automatic Control 40(3), 1995) for 1 kg on a plane;
experiment 9 a small servo, with the levels of the example of <code>lugre</code>. The remaining parameters, the shape,
come from the example of the model's family: forces scale with the Coulomb level, lengths with the Coulomb level over
the stiffness, velocities with the Stribeck velocity; times are not scaled.</p>
<p>The models of the compensator are made from the same levels in the same manner: the levels are known exactly,
nothing is fitted to the experiment, and only the shape is wrong. In experiments 7 and 8 the viscous part is not
compensated, and damps the mass. <code>coulomb</code> has no break-away level above its Coulomb level here.
<code>power_law</code> equals the viscous friction at the fastest motion. <code>table</code> holds some points of the
axis's curve.</p>
"""
