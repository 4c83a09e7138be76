"""The dry friction of MuJoCo's joints, which is soft: pushed with less than its level, a joint creeps.

Source: MuJoCo's documentation, Computation, "Constraint model" and "Parameters". The constraint wants the acceleration
-b v with b = 2 / (dmax timeconst), and has the impedance d: without acceleration the friction of an inertia J is
J b d / (1 - d) v until it reaches the level. MuJoCo limits d to 0.9999, and timeconst to two time steps and more.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Softness:
    """What ``solreffriction`` and ``solimpfriction`` of a joint say."""

    timeconst: float
    impedance: float
    impedance_at_width: float

    def creep(self, level: float, inertia: float) -> float:
        """Return the speed at which the friction reaches its level, rad/s or m/s."""
        softness = (1.0 - self.impedance) / self.impedance
        return level / inertia * softness * 0.5 * self.impedance_at_width * self.timeconst

    def attributes(self) -> dict[str, str]:
        """Return the attributes of a joint."""
        impedance = f"{self.impedance:g} {self.impedance_at_width:g} 0.001"
        return {"solreffriction": f"{self.timeconst:g} 1", "solimpfriction": impedance}

    def sentence(self, level: float, inertia: float, axis: str, where: str = "In MuJoCo") -> str:
        """Return what a user should know about the creep of a joint that moves an inertia."""
        unit, quantity, speed = ("kg m^2", "inertia", "rad/s") if axis == "rotary" else ("kg", "mass", "m/s")
        return (
            f"{where}, a joint that is pushed with less than its friction creeps: up to "
            f"{self.creep(level, inertia):.2g} {speed} with {quantity} {inertia:.4g} {unit}, less with more, at time "
            f"steps of {500.0 * self.timeconst:g} ms and less."
        )


def words(attributes: dict[str, str]) -> str:
    """Return attributes of XML in a sentence."""
    return " and ".join(f"{name} {value}" for name, value in attributes.items())


DEFAULT = Softness(timeconst=0.02, impedance=0.9, impedance_at_width=0.95)
STIFF = Softness(timeconst=0.004, impedance=0.9999, impedance_at_width=0.9999)  # two of MuJoCo's default time steps
