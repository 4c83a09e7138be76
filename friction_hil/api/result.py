"""What an identification or a training of one axis results in."""

import html
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.checked_yaml.output import check_model_path
from friction_hil.checked_yaml.text import dump
from friction_hil.errors import FrictionHilError
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.json_values import to_json
from friction_hil.numerics.readable import brief

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Result:
    """A model of one axis with its provenance.

    Attributes
    ----------
    label : str
        Name of the model with its modifiers.
    reason : str
        Why it was chosen.
    flags : tuple of str
        What limits its use, and what is wrong with the recordings; one sentence each.
    standard_errors : dict of str to float
        Standard errors of its parameters, in their units; None of one that is at a bound or not determined.
    content : dict or None
        The model file as plain values; None if no model is usable.
    facts : dict
        What the command prints with ``--json``; values are not yet those of JSON (`to_dict`).
    """

    label: str
    reason: str
    flags: tuple[str, ...]
    standard_errors: Mapping[str, float | None]
    content: Mapping[str, Any] | None
    facts: Mapping[str, Any]

    @property
    def is_usable(self) -> bool:
        """True if there is a model: one that explains nothing is none."""
        return self.content is not None

    @property
    def model(self) -> ModelFile:
        """The model file: ``model.friction_model`` is the friction model, ``model.mechanics`` the rest of the axis.

        Raises
        ------
        FrictionHilError
            No model is usable; the message says why.
        """
        if self.content is None:
            raise FrictionHilError(f"there is no usable model: {'; '.join(self.flags)}")
        return ModelFile.model_validate(self.content)

    def save(self, path: str | Path) -> None:
        """Write the model file, as ``--output`` does.

        Parameters
        ----------
        path : path
            File to write, with the suffix .yaml; an existing one is replaced.

        Raises
        ------
        FrictionHilError
            No model is usable.
        UsageError
            The suffix is wrong, or the file cannot be written.
        """
        check_model_path(Path(path))
        self.model  # noqa: B018  raises before a file that could not be read again is written
        assert self.content is not None
        Path(path).write_text(dump(dict(self.content)), encoding="utf-8")

    def to_dict(self) -> dict[str, Any]:
        """Return what the command prints with ``--json``.

        Returns
        -------
        dict
            Values that JSON can hold: NaN and infinity are None.
        """
        found: dict[str, Any] = to_json(self.facts)
        return found

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw friction over velocity, measured and of the model.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw into; new ones by default.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        UsageError
            matplotlib is not installed.
        """
        raise NotImplementedError

    def __repr__(self) -> str:
        """Return the model and why it was chosen."""
        return f"{type(self).__name__}({self.label!r}: {self.reason or 'no usable model'}; {len(self.flags)} flags)"

    def _repr_html_(self) -> str:
        """Return parameters with standard errors, and flags, for a notebook."""
        from friction_hil.reports.page import table, unordered_list  # imported here: few need it

        friction = (self.content or {}).get("friction", {})
        values = {**friction.get("parameters", {}), **(self.content or {}).get("mechanics", {})}
        rows = [
            (
                html.escape(name),
                brief(value, 4),
                "" if (error := self.standard_errors.get(name)) is None else brief(error, 2),
            )
            for name, value in values.items()
            if isinstance(value, int | float)
        ]
        text = f"<strong>{html.escape(self.label)}</strong>: {html.escape(self.reason or 'no usable model')}"
        return f"<p>{text}</p>{table(('parameter', 'value', 'standard error'), rows)}{unordered_list(self.flags)}"
