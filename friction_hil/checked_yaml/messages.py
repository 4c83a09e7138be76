"""Messages about wrong values: pydantic's errors in plain words, with units, choices and advice."""

import contextlib
import json
import re
from collections.abc import Collection, Iterable, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from friction_hil.checked_yaml.section import keys
from friction_hil.checked_yaml.text import FieldPath, resolve
from friction_hil.errors import choices

Mistake = tuple[FieldPath, str]  # field path, relative to the checked value, and message
Model = TypeVar("Model", bound=BaseModel)

_OWN = "friction_hil"  # type of errors that already have a complete message
_WANTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "text",
    "path_type": "a path",
    "list_type": "a list",
    "tuple_type": "a list",
    "set_type": "a list",
    "dict_type": "a group of keys",
    "model_type": "a group of keys",
    "model_attributes_type": "a group of keys",
}
_TRUTH = {"on": "true", "yes": "true", "y": "true", "off": "false", "no": "false", "n": "false"}
_BOUNDS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
_MOST_NAMED = 200  # mistakes in plain words; ten times those that are printed, which are the first ones of the file
_FAR = 1e6  # bounds from here on only keep numbers from overflowing
_PREFIXES = {"k": 1e3, "c": 1e-2, "m": 1e-3, "µ": 1e-6, "u": 1e-6}
_LONGEST_NUMBER = 60  # characters of a text that could be meant as a number


def validate(model: type[Model], value: Any, known: Collection[str] = ()) -> Model:
    """Create a ``model`` from plain values, without converting text to numbers or numbers to text.

    ``known``: further keys allowed beside those of the model, for the message about an unknown key. Raises
    `ValidationError`: there are mistakes; `mistakes_of` returns their messages.
    """
    try:
        # pydantic's strict mode for JSON converts lists to tuples and text to paths, and nothing else
        return model.model_validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        raise _refusal(model.__name__, mistakes_of(error, model, value, known)) from None


def refuse(section: BaseModel, mistakes: Iterable[Mistake]) -> None:
    """Raise a validation error for the ``mistakes``, if there are any; to be called by a validator of ``section``."""
    if found := list(mistakes):
        raise _refusal(type(section).__name__, found)


def mistakes_of(
    error: ValidationError, model: type[BaseModel], value: Any, known: Collection[str] = ()
) -> list[Mistake]:
    """Convert pydantic's ``error`` about ``value`` as ``model`` to mistakes, one per field path."""
    found: dict[FieldPath, list[str]] = {}
    items = error.errors(include_url=False)
    # of the values that a list lacks, the last one says how many it needs
    last = {item["loc"][:-1]: item["loc"] for item in items if _is_missing_value(item)}
    for item in items:
        if _is_missing_value(item) and item["loc"] != last[item["loc"][:-1]]:
            continue
        # of very many, the others are counted only, and their words take the most time
        is_named = len(found) < _MOST_NAMED
        steps, message = _translate(item, model, value, known) if is_named else (item["loc"], item["msg"])
        found.setdefault(steps, [])
        if message not in found[steps]:
            found[steps].append(message)
    return [(steps, "; or ".join(messages)) for steps, messages in found.items()]


def _is_missing_value(item: ErrorDetails) -> bool:
    """Return True if a list is too short for a value at this index."""
    return item["type"] == "missing" and isinstance(item["loc"][-1], int)


def _refusal(title: str, mistakes: Sequence[Mistake]) -> ValidationError:
    return ValidationError.from_exception_data(
        title,
        [
            InitErrorDetails(
                type=PydanticCustomError(_OWN, "{message}", {"message": message, "steps": len(steps)}),
                loc=steps,
                input=None,
            )
            for steps, message in mistakes
        ],
    )


def _translate(item: ErrorDetails, model: type[BaseModel], value: Any, known: Collection[str]) -> Mistake:
    location = item["loc"]
    context = item.get("ctx", {})
    if item["type"] == _OWN:
        split = len(location) - context["steps"]
        return (*_present(location[:split], value), *location[split:]), context["message"]
    if item["type"] == "missing":
        field, _ = _find(model, location)
        if isinstance(location[-1], int):
            return _present(location, value), f"needs at least {location[-1] + 1} values"
        meaning = f": {field.description}" if field is not None and field.description else ""
        return (*_present(location[:-1], value), location[-1]), f"is missing{meaning}"
    if item["type"] == "extra_forbidden":
        _, holders = _find(model, location[:-1])
        names = {name for holder in holders for name in keys(holder)}
        if len(location) == 1:
            names |= set(known)
        return _present(location, value), f"is not a key here; {choices(str(location[-1]), names)}"
    if item["type"] == "union_tag_invalid":
        name = context["discriminator"].strip("'")
        message = f"must be one of {context['expected_tags']}, not {show(item['input'][name])}"
        return (*_present(location, value), name), message
    field, holders = _find(model, location)
    return _present(location, value), _describe(item, context, field, holders)


def _describe(
    item: ErrorDetails, context: dict[str, Any], field: FieldInfo | None, holders: Sequence[type[BaseModel]]
) -> str:
    kind, given = item["type"], item["input"]
    unit = _unit(field)
    if kind in _WANTED:
        wanted = _WANTED[kind] + (f" [{unit}]" if unit and "number" in _WANTED[kind] else "")
        if given is None and field is not None and field.is_required() and field.description and not holders:
            meaning = field.description.removesuffix(f" [{unit}]")
            return f"must be {wanted}, not empty: fill in the {meaning}"
        if wanted == "a group of keys" and holders:
            wanted += f" ({', '.join(dict.fromkeys(name for holder in holders for name in keys(holder)))})"
        return f"must be {wanted}, not {show(given)}{_advice(kind, given, unit)}"
    if kind == "finite_number":
        return f"must be a finite number, not {show(given)}"
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        return f"must be {_bounds(field, context, given)}{f' {unit}' if unit else ''}, not {show(given)}"
    if kind in ("literal_error", "enum"):
        return f"must be {context['expected']}, not {show(given)}"
    if kind == "union_tag_not_found":
        return f"needs the key {context['discriminator']}, which selects its kind"
    if kind == "string_pattern_mismatch":
        return f"{given!r} is not a valid name: use small letters, digits and _, beginning with a letter"
    if kind in ("too_long", "too_short"):
        bound = context.get("max_length", context.get("min_length"))
        return f"needs {'at most' if kind == 'too_long' else 'at least'} {bound}, has {context['actual_length']}"
    if kind in ("value_error", "assertion_error"):
        return str(context["error"])
    return f"{item['msg'][:1].lower()}{item['msg'][1:]}"


def show(value: Any) -> str:
    """Describe a value of a YAML file for use in a sentence."""
    if value is None:
        return "empty"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text {value if len(value) <= 40 else value[:37] + '...'!r}"
    if isinstance(value, dict):
        return "a group of keys"
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, float) and not abs(value) < float("inf"):
        return {"inf": ".inf", "-inf": "-.inf", "nan": ".nan"}[str(value)]
    return f"{value!r}"


def _advice(kind: str, given: Any, unit: str) -> str:
    """Suggest what the author of a text most likely meant where a number, true or false is expected."""
    if not isinstance(given, str):
        if kind.startswith("int") and isinstance(given, float) and given.is_integer():
            return f"; write {int(given)}"
        return ""
    text = given.strip()
    if len(text) > _LONGEST_NUMBER:  # some of the patterns below take quadratic time
        return ""
    if kind == "bool_type":
        meant = _TRUTH.get(text.lower())
        return f" (it is text in YAML 1.2; write {meant})" if meant else ""
    if kind not in ("float_type", "int_type"):
        return ""
    if re.fullmatch(r"[0-9]+(:[0-5]?[0-9])+", text):
        seconds = 0
        for part in text.split(":"):
            seconds = 60 * seconds + int(part)
        return f" (it is text in YAML 1.2; write {seconds})"
    if match := re.fullmatch(r"([-+]?)0+([0-9]+)", text):
        return f" (leading zeros make it ambiguous; write {match[1]}{match[2]})"
    for pattern, template in (
        (r"[-+]?[0-9][0-9_]*", "without '_': write {}"),
        (r"[-+]?[0-9]*,[0-9]+(?:[eE][-+]?[0-9]+)?", "with a decimal point: write {}"),
    ):
        if re.fullmatch(pattern, text):
            return " (" + template.format(text.replace("_", "").replace(",", ".")) + ")"
    if re.fullmatch(r"[-+]?(?:inf|infinity)", text.lower()):
        return " (infinity is written .inf)"
    try:
        if isinstance(resolve(text), int | float):
            return " (without quotes it would be a number)"
    except OverflowError:
        return ""
    if match := re.fullmatch(r"([-+]?[0-9]+(?:\.[0-9]*)?)\s*%", text):
        fraction = float(match[1]) / 100.0
        return f" (a percentage; give the value in {unit})" if unit else f" (as a fraction: write {fraction:.12g})"
    if match := re.fullmatch(r"([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*([A-Za-zµ°%].*)", text):
        return _without_unit(match[1], match[2].strip(), unit)
    return ""


def _without_unit(number: str, given: str, unit: str) -> str:
    """Suggest the number without its unit; in the unit of the key where that is the one given with a prefix."""
    given = given.replace(" ", "")
    units = [each.replace(" ", "") for each in (unit, *unit.split(" or "))]
    if given in units:
        return f" (write the number alone, {number})"
    if given[1:] in units and given[0] in _PREFIXES:
        with contextlib.suppress(ValueError):
            return f" (in {given[1:]}: write {float(number) * _PREFIXES[given[0]]:.12g})"
    return f" (write the number alone{f', converted to {unit}' if unit else ''})"


def _bounds(field: FieldInfo | None, context: dict[str, Any], given: Any) -> str:
    """Describe the bounds of a number, those of the key and those of its type; not those far beyond ``given``."""
    found: dict[str, list[float]] = {name: [context[name]] if name in context else [] for name in _BOUNDS}
    for item in () if field is None else (*field.metadata, *_constraints(field.annotation)):
        for name, bounds in found.items():
            if (bound := getattr(item, name, None)) is not None:
                bounds.append(bound)
    narrowest = {name: max(bounds) if name in ("gt", "ge") else min(bounds) for name, bounds in found.items() if bounds}
    near = {name: bound for name, bound in narrowest.items() if abs(bound) < _FAR or abs(given) >= abs(bound)}
    return " and ".join(f"{_BOUNDS[name]} {bound:g}" for name, bound in (near or narrowest).items())


def _constraints(annotation: Any) -> list[Any]:
    """Return the constraints in a type, e.g. of ``Annotated[float, Field(gt=0.0)] | None``."""
    if get_origin(annotation) is Annotated:
        kind, *demands = get_args(annotation)
        own = [part for demand in demands for part in getattr(demand, "metadata", (demand,))]
        return [*own, *_constraints(kind)]
    if get_origin(annotation) in (Union, UnionType):
        return [part for item in get_args(annotation) for part in _constraints(item)]
    return []


def _unit(field: FieldInfo | None) -> str:
    extra = field.json_schema_extra if field is not None else None
    unit = extra.get("unit") if isinstance(extra, dict) else None
    return "" if unit in (None, "1") else str(unit)


def _present(location: Sequence[str | int], value: Any) -> FieldPath:
    """Return the part of pydantic's location that exists in the value, without the names of union branches."""
    steps: list[str | int] = []
    for step in location:
        try:
            value = value[step]
        except (KeyError, IndexError, TypeError):
            continue
        steps.append(step)
    return tuple(steps)


def _find(model: type[BaseModel], location: Sequence[str | int]) -> tuple[FieldInfo | None, list[type[BaseModel]]]:
    """Return the field at a location, and the models that are allowed there."""
    field: FieldInfo | None = None
    kinds: list[Any] = [model]
    for step in location:
        models = [kind for kind in kinds if _is_model(kind)]
        holder = next((kind for kind in models if step in kind.model_fields), None)
        if holder is not None:
            field = holder.model_fields[step]
            kinds = _members(field.annotation)
        elif narrowed := [kind for kind in models if step in _tags(kind)]:
            kinds = narrowed
        else:
            kinds = [part for kind in kinds for part in _members_of_items(kind)]
    return field, [kind for kind in kinds if _is_model(kind)]


def _members(annotation: Any) -> list[Any]:
    if get_origin(annotation) is Annotated:
        return _members(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [part for item in get_args(annotation) for part in _members(item)]
    return [] if annotation is NoneType else [annotation]


def _members_of_items(kind: Any) -> list[Any]:
    if get_origin(kind) is dict:
        return _members(get_args(kind)[1])
    if get_origin(kind) in (list, tuple):
        return [part for item in get_args(kind) if item is not Ellipsis for part in _members(item)]
    return []


def _tags(model: type[BaseModel]) -> set[Any]:
    """Return the strings that select a model in a union: its name, and the values of its literal fields."""
    tags: set[Any] = {model.__name__}
    for field in model.model_fields.values():
        if field.is_required():
            tags.update(item for item in get_args(field.annotation) if isinstance(item, str))
    return tags


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)
