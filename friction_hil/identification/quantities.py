"""Quantities of the machine behind the motor, determined or not, with their units. Pure."""

from dataclasses import dataclass

from friction_hil.identification.identify import Identification


@dataclass(frozen=True, slots=True)
class Quantity:
    """A property of the axis with its standard error, or why it is not determined."""

    key: str  # name in ``--json``
    label: str  # for people
    unit: str  # SI, of the axis
    value: float | None = None  # this and the error: None if it is not determined
    error: float | None = None
    source: str = ""  # method
    missing: str = ""  # why it is not determined, and the motion that would show it; else empty


@dataclass(frozen=True, slots=True)
class Units:
    """Units of an axis, for people."""

    position: str
    torque: str
    inertia: str

    @classmethod
    def of(cls, result: Identification) -> "Units":
        """Return those of the axis of an identification."""
        return cls("m", "N", "kg") if result.settings.axis == "linear" else cls("rad", "N m", "kg m^2")

    @property
    def stiffness(self) -> str:
        """Unit of a stiffness."""
        return f"{self.torque}/{self.position}"

    @property
    def damping(self) -> str:
        """Unit of a damping."""
        return f"{self.torque} s/{self.position}"


def undetermined(units: Units) -> list[Quantity]:
    """Return all quantities, none of them determined, in the order in which they are shown."""
    return [
        Quantity("inertia", "inertia of motor and load", units.inertia),
        Quantity("motor_inertia", "inertia of the motor", units.inertia),
        Quantity("load_inertia", "inertia of the load", units.inertia),
        Quantity("antiresonance_hz", "anti-resonance", "Hz"),
        Quantity("resonance_hz", "resonance", "Hz"),
        Quantity("stiffness", "stiffness of the coupling", units.stiffness),
        Quantity("damping", "damping of the coupling", units.damping),
        Quantity("backlash", "backlash", units.position),
        Quantity("motor_friction", "friction of the motor", units.torque),
        Quantity("load_friction", "friction of the load", units.torque),
        Quantity("load_dependence", "friction per load", ""),
        Quantity("cogging", "cogging", units.torque),
        Quantity("encoder_error", "periodic encoder error", units.position),
    ]
