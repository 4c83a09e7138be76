"""What the study's report and table say: sections, columns, and what to look at with each model."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from friction_hil.reports.numbers import digits

Facts = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Section:
    """One experiment in the report; ``facts`` are its numbers, by the name of the fact, with their headings."""

    key: str
    title: str
    text: str
    facts: dict[str, str]


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the table of main facts: one fact, or two with an arrow between them.

    ``brief`` is its heading where there is little room. ``{}`` in the name of a fact stands for the model.
    """

    title: str
    brief: str
    facts: tuple[str, ...]

    def write(self, facts: Facts, model: str) -> str:
        """Write the cell of a model."""
        return " → ".join(number(facts.get(fact.format(model))) for fact in self.facts)


def summary_columns() -> tuple[Column, ...]:
    """Columns of the table of main facts."""
    return (
        Column("presliding [µm]", "pre-\nsliding\n[µm]", ("presliding_um",)),
        Column("lag at 25 rad/s [mN]", "lag\n[mN]", ("lag_width_25_mN",)),
        Column("break-away, slow → fast [N]", "break-away\n[N]", ("breakaway_slow_N", "breakaway_fast_N")),
        Column("stuck [%]", "stuck\n[%]", ("stick_slip_stuck_percent", "stick_slip_stuck_percent_with_{}")),
        Column("hunting [mm]", "hunting\n[mm]", ("hunting_swing_mm", "hunting_swing_mm_with_{}")),
        Column("reversal [µrad]", "reversal\n[µrad]", ("reversal_peak_urad", "reversal_peak_urad_with_{}")),
    )


def number(value: float | None) -> str:
    """Write a fact with three digits; a dash where the model has none."""
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
    "armstrong": "rest strengthens it: break-away grows with the time at rest",
    "bouc_wen": "hysteresis of a shape of its own, but no Stribeck hump, hence no stick-slip",
    "coulomb": "a step: no presliding, no lag, no stick-slip; the plainest reversal spike",
    "dahl": "a spring that yields: presliding, but no Stribeck hump, hence no stick-slip",
    "elasto_plastic": "as lugre, but a small force that shakes it does not make it drift",
    "gms": "it remembers where it turned round: small loops close, and nothing drifts",
    "karnopp": "a Stribeck curve that sticks exactly: made for simulation",
    "lugre": "presliding, lag, rate-dependent break-away, stick-slip and hunting in one state",
    "power_law": "grows with a power of the velocity; no hump, no presliding",
    "stribeck": "a hump without presliding: it sticks and slips, but has no lag",
    "table": "a measured curve: as good as its points",
}


def look(model: str) -> str:
    """Say what to look at with a model."""
    return _LOOK.get(model, "")


SECTIONS = (
    Section(
        "static_curve",
        "1. Static curves",
        """At constant velocity each model settles on its own curve. Those with a <em>Stribeck</em> hump start at the
        break-away level (1.5 N) and fall to the Coulomb level (1 N) within a few mm/s, because a lubricant film
        builds up; then viscous friction grows with the velocity. Where the curve falls, friction pushes instead of
        damping: that is the root of stick-slip and hunting. Models that share a line here differ only in motion, as
        the next experiments show.""",
        {"curve_at_slow_N": "at 0.01 mm/s [N]", "curve_minimum_N": "lowest [N]"},
    ),
    Section(
        "velocity_pulse",
        "2. Answer to a velocity pulse",
        """The contact is moved forth, stopped, and moved back. A static map jumps with the sign of the velocity and,
        at rest with nothing applied, has no friction at all. A model with a state comes up like a spring and keeps
        its force at rest (compare dahl with lugre). Models with a Stribeck hump overshoot as they break away, and
        rise again as they come to rest.""",
        {"pulse_overshoot_N": "overshoot over the sliding level [N]", "pulse_at_rest_N": "left at rest [N]"},
    ),
    Section(
        "presliding",
        "3. Presliding and drift",
        """A force that is slowly cycled to 95 % of break-away does not make the mass slide, and yet it moves by tens
        of micrometres: the contact yields like a spring with losses, and the area of the loop is the energy lost in
        a cycle. A static map does not move at all. Second picture: a force that only shakes should leave the
        contact where it is. dahl, bouc_wen and lugre creep on with each swing, an artefact of theirs that
        elasto_plastic and gms avoid. A damper of 100 N s/m beside the friction keeps the mass from ringing.""",
        {
            "presliding_um": "displacement [µm]",
            "presliding_loss_uJ": "loss in a cycle [µJ]",
            "drift_um": "drift in 10 swings [µm]",
        },
    ),
    Section(
        "stress_strain",
        "4. Stress and strain",
        """The contact is moved slowly (0.1 mm/s) along a given path and friction is read. From rest the curve begins
        with the stiffness of the contact. The test is the small loop at zero: a real contact returns exactly to the
        path that it had left (gap 0), because each asperity remembers its own deflection. gms does; a model with a
        single state forgets, and comes out lower. A static map is infinitely stiff.""",
        {"stiffness_N_per_um": "initial stiffness [N/µm]", "small_loop_gap_mN": "gap of the small loop [mN]"},
    ),
    Section(
        "frictional_lag",
        "5. Frictional lag",
        """The velocity swings between 0 and 2 mm/s without changing its sign. Friction follows its static curve with a
        delay: it is lower while the velocity falls than while it rises, and the loop opens as the swing becomes
        faster. The width is read at 1.5 mm/s. A static map, or a model without a Stribeck hump, has no loop.""",
        {f"lag_width_{rate}_mN": f"width at {rate} rad/s [mN]" for rate in (1, 10, 25)},
    ),
    Section(
        "break_away",
        "6. Break-away force",
        """A force that rises steadily pushes 1 kg until it slides. If it rises quickly, the contact already moves fast
        while it still yields, so that its level has fallen before it is reached. A break-away force in a data sheet
        therefore says little without the rate at which it was measured. (gms has no damping in its contact: 1 kg on
        it shakes itself loose early.) The viscous part is taken off.""",
        {"breakaway_slow_N": "at 0.2 N/s [N]", "breakaway_fast_N": "at 50 N/s [N]"},
    ),
    Section(
        "stick_slip",
        "7. Stick-slip",
        """1 kg is pulled through a soft spring (2 N/m) at 0.1 m/s. While it sticks the spring loads; when it breaks
        away friction falls, it shoots ahead, and sticks again. Without a falling curve it slides steadily.
        (armstrong slides, too, after its first stop: when it sticks anew, its undamped contact spring rings, and
        that breaks it loose.) The compensation pushes at the mass: it is the daemon's own compensator at 1 kHz with
        gain 0.9, acts one period late, sees the position through an encoder of 0.1 µm, and knows that the mass is
        meant to move at 0.1 m/s. A compensation without a Stribeck hump is constant as long as the demand is, and
        cannot end stick-slip: the fall from break-away to Coulomb level remains.""",
        {
            "stick_slip_stuck_percent": "stuck, of the last 20 s [%]",
            "stick_slip_swing_mm_s": "swing of the velocity [mm/s]",
        },
    ),
    Section(
        "hunting",
        "8. Hunting",
        """A PID controller (3 N/m, 4 N/(m s), 6 N s/m) brings 1 kg to 1 m. Where the mass sticks short of the target,
        the integral grows until it breaks away, jumps past the target, and all begins again: it hunts. Without a
        hump each jump is smaller than the last one, and it dies down by itself. The compensator (gain 0.9) only
        measures here, since a step has no demanded velocity. A contact with presliding moves before it breaks away,
        so that the compensation is there in time, and hunting shrinks to what a tenth of the friction leaves. A
        static map does not move before it breaks away: the compensation comes too late, adds to a jump that has
        begun, and makes hunting <em>worse</em>. So does a compensator that believes in more friction than there is,
        or in a contact much softer than the real one (gms here), which still pushes the old way after the mass has
        turned round. On a real axis: feed the compensation from a demanded motion, and keep its gain below 1 where
        it only measures.""",
        {"hunting_swing_mm": "swing in the last 40 s [mm]"},
    ),
    Section(
        "reversal",
        "9. Reversal spikes on a circle",
        """Two equal servo axes draw a circle of 1 rad at 0.5 Hz. The drive's loops are tuned and fed forward as in
        <code>friction-hil demo</code>. Where an axis reverses, friction changes its sign faster than the loops can
        answer: the axis stays behind and leaves a spike. The daemon's compensator (1 kHz, torque offset one period
        late; gain 1, since the levels are known exactly here) knows the demanded velocity ahead of time, and takes
        most of the spike away: nearly all of it where the model that compensates has the shape of the friction that
        acts. Along the diagonal of the table is what a perfect identification can reach; the rest of a row is the
        price of a wrong model.""",
        {"reversal_peak_urad": "largest radius error [µrad]", "reversal_rms_urad": "rms [µrad]"},
    ),
)

HOW_MATCHED = """
<p>All models of an axis are brought to the same levels: Coulomb level, break-away level, Stribeck velocity, viscous
coefficient, stiffness and damping, as far as a model has them. Experiments 1 to 8 use the reference set of Canudas de
Wit, Olsson, Åström and Lischinsky (IEEE Transactions on Automatic Control 40(3), 1995) for 1 kg on a plane;
experiment 9 a small servo, with the levels of the example of <code>lugre</code>. What is left, the shape, comes from
the example of the model's family: forces in Coulomb levels, lengths in Coulomb level over stiffness, velocities in
Stribeck velocities, times as they are.</p>
<p>The compensating models are made by the same recipe from the same levels. That is the simplest honest
identification: the levels are known exactly, nothing is fitted to the experiment, and what is wrong is the shape
alone. In experiments 7 and 8 they leave the viscous part to the mass, as its damping. <code>coulomb</code> has no
break-away level above its Coulomb level here. <code>power_law</code> meets the viscous friction at the fastest
motion. <code>table</code> holds some points of the axis's curve.</p>
"""
