"""Display of results in notebooks, and their arrays as an xarray dataset; xarray is imported when it is used."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import fields
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from geometry.common.errors import MissingLibrary

if TYPE_CHECKING:
    import xarray as xr

UNITS = {
    "stress_inner": "Pa", "stress_outer": "Pa", "ratio": "1", "log_sensitivity": "1", "stiffness": "N/m", "charge_inner": "C",
    "charge_outer": "C", "error_estimate": "1", "equivalent_modulus": "Pa", "residual": "1", "frequency": "Hz",
    "ratio_phase": "rad", "ratio_phase_error": "rad", "youngs_modulus": "Pa", "force": "N", "indentation": "m",
    "tangent_stiffness": "N/m", "closest_walls": "m", "contact_radius": "m", "largest_strain": "1", "position": "m", "at": "m",
    "ratio_without": "1", "depth": "m", "diameter": "m", "change": "1", "standard_deviation": "1", "error": "1", "seen": "1",
    "resolved": "1", "above_error": "1", "noise": "1", "seen_threshold": "1", "resolved_threshold": "1", "accuracy": "1",
    "seconds": "s", "strength": "m^3", "p_value": "1",
}  # fmt: skip
"""SI units of the fields of results, by name; 1 is a pure number."""
SHOWN = 12  # rows of a long table that a notebook shows


class Notebook:
    """Base of frozen dataclasses that hold numbers and arrays along ``DIMENSIONS``.

    Attributes:
        DIMENSIONS: the fields along which the arrays lie, in their order; none where there are no arrays.
        LABELS: further fields that say where along the dimensions an entry is.
    """

    DIMENSIONS: ClassVar[tuple[str, ...]] = ()
    LABELS: ClassVar[tuple[str, ...]] = ()

    def _arrays(self) -> dict[str, np.ndarray]:
        """Return the fields that are arrays along the dimensions; NaN where a value is missing, as a warning then explains."""
        shape = tuple(len(getattr(self, name)) for name in self.DIMENSIONS)
        found: dict[str, np.ndarray] = {}
        for one in fields(self):  # type: ignore[arg-type]
            value = getattr(self, one.name)
            if isinstance(value, tuple) and one.name in UNITS and one.name not in self.DIMENSIONS and shape:
                array = np.array(value, dtype=float)  # None becomes NaN
                found |= {one.name: array} if array.shape == shape else {}
        return found

    def _numbers(self) -> dict[str, Any]:
        """Return the fields that are one number or text."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}  # type: ignore[arg-type]
        return {name: value for name, value in values.items() if isinstance(value, str | bool | int | float)}

    def to_dataset(self) -> xr.Dataset:
        """Return the arrays with their labels, units in the ``attrs`` of each; NaN where there is no value.

        Verdicts are 1, 0 or NaN. The ``attrs`` of the whole hold the single numbers, the warnings and, as JSON, the provenance.

        Raises:
            MissingLibrary: xarray is not installed.
        """
        try:
            xarray = import_module("xarray")
        except ImportError:
            raise MissingLibrary("xarray is not installed: pip install 'probe-design[sweep]'") from None
        arrays: dict[str, Any] = {name: (self.DIMENSIONS, values) for name, values in self._arrays().items()}
        labels = {name: (name, np.array(getattr(self, name))) for name in self.DIMENSIONS}
        labels |= {name: arrays.pop(name) for name in self.LABELS}
        told: xr.Dataset = xarray.Dataset(arrays, coords=labels)
        for name in told.variables:
            told[name].attrs["units"] = UNITS[str(name)]
        told.attrs |= self._numbers() | {"warnings": [*map(str, getattr(self, "warnings", ()))]}
        told.attrs["provenance"] = json.dumps(getattr(self, "provenance", None))
        return told

    def _repr_html_(self) -> str:
        """Return what a notebook shows as HTML: the numbers, some rows of the arrays, the warnings."""
        single = [(name, _text(value), _unit(name)) for name, value in self._numbers().items()]
        parts = [html_table(("quantity", "value", "unit"), single)]
        if len(self.DIMENSIONS) == 1:
            along = self.DIMENSIONS[0]
            columns = {along: np.array(getattr(self, along))} | self._arrays()
            rows = list(zip(*columns.values(), strict=True))
            heads = [f"{name}, {_unit(name)}".rstrip(", ") for name in columns]
            parts.append(html_table(heads, [[_text(value) for value in row] for row in rows[:: -(-len(rows) // SHOWN)]]))
        notes = "".join(f"<li>{escape(str(text))}</li>" for text in getattr(self, "warnings", ()))
        return "".join(parts) + (f"<ul>{notes}</ul>" if notes else "")


def html_table(headings: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table as HTML; texts are escaped."""
    head = "".join(f"<th>{escape(text)}</th>" for text in headings)
    body = "".join("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _unit(name: str) -> str:
    return UNITS.get(name, "").replace("1", "")


def _text(value: Any) -> str:
    """Return a number with six digits, or a dash for None and NaN."""
    if isinstance(value, str | bool):
        return str(value)
    return "-" if value is None or value != value else f"{value:.6g}"
