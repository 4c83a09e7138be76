"""Description of a family of friction models."""

from dataclasses import dataclass

from friction_hil.models.parameters import Parameter


@dataclass(frozen=True, slots=True)
class Family:
    """What is known of a model before its parameters have values. ``states`` names its states with units."""

    name: str
    summary: str
    formula: str
    source: str
    parameters: tuple[Parameter, ...]
    states: tuple[str, ...]
    note: str = ""

    @property
    def is_static(self) -> bool:
        """Whether the torque jumps at zero velocity and the model has no state."""
        return not self.states
