"""Base of all parts of a configuration, and how their keys are declared."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

# Units of an axis that turns or of one that slides.
TORQUE = "N m or N"
POSITION = "rad or m"
VELOCITY = "rad/s or m/s"


class Section(BaseModel):
    """A group of keys: frozen, no others allowed, all numbers finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, ser_json_inf_nan="constants")


def key(meaning: str, unit: str | None = None, *, default: Any = ..., **bounds: Any) -> Any:
    """Declare a key by its meaning and unit; ``bounds`` as in pydantic's ``Field``. Required without default."""
    text = meaning if unit in (None, "1") else f"{meaning} [{unit}]"
    extra = {"unit": unit} if unit is not None else None
    return Field(default, description=text, json_schema_extra=extra, **bounds)  # type: ignore[arg-type]


def keys(model: type[BaseModel]) -> list[str]:
    """Names of the keys that a file may have in this group."""
    return [
        name
        for name, field in model.model_fields.items()
        if not (isinstance(field.json_schema_extra, dict) and field.json_schema_extra.get("is_key") is False)
    ]
