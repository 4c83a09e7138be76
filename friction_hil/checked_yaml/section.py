"""Base class of all sections of a checked YAML file, and the declaration of their keys."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

# Units of a rotary or a linear axis.
TORQUE = "N m or N"
POSITION = "rad or m"
VELOCITY = "rad/s or m/s"

# Bounds far beyond any servo axis. A number outside is a slip of the pen, and its products could overflow.
MOST_TORQUE = 1e7
MOST_TORQUE_SLEW = 1e12
MOST_POSITION = 1e9
MOST_VELOCITY = 1e6
MOST_ACCELERATION = 1e10
MOST_FREQUENCY_HZ = 5e3  # half of the highest rate of the loop
LEAST_FREQUENCY_HZ = 1e-5  # a period of a day
MOST_S = 86_400.0


class Section(BaseModel):
    """A group of keys: immutable, without unknown keys, with finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, ser_json_inf_nan="constants")


def key(meaning: str, unit: str | None = None, *, default: Any = ..., **bounds: Any) -> Any:
    """Declare a key with its meaning and unit; it is required if it has no default.

    ``meaning``: description of the key, for messages and the JSON Schema. ``unit``: of its value; "1" for a
    dimensionless number. ``default``: value when the key is absent. ``bounds``: as in pydantic's ``Field``.
    """
    text = meaning if unit in (None, "1") else f"{meaning} [{unit}]"
    extra = {"unit": unit} if unit is not None else None
    return Field(default, description=text, json_schema_extra=extra, **bounds)  # type: ignore[arg-type]


def keys(model: type[BaseModel]) -> list[str]:
    """Return the names of the keys that a file may have in this group."""
    return [
        name
        for name, field in model.model_fields.items()
        if not (isinstance(field.json_schema_extra, dict) and field.json_schema_extra.get("is_key") is False)
    ]
