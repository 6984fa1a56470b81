"""Convert results to JSON objects, and their arrays to an xarray dataset; xarray is imported when it is used."""

from __future__ import annotations

import json
from dataclasses import asdict, fields, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import import_extra
from geometry.common.json_types import JsonObject
from geometry.common.percent import format_percent

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

SI_UNITS = {
    "stress_inner": "Pa", "stress_outer": "Pa", "ratio": "1", "log_sensitivity": "1", "stiffness": "N/m", "charge_inner": "C",
    "charge_outer": "C", "charge_per_force_inner": "C/N", "charge_per_force_outer": "C/N", "charge_ratio": "1",
    "charge_log_sensitivity": "1", "charge_log_sensitivity_error": "1", "charge_inner_error": "1", "charge_outer_error": "1",
    "charge_per_force_inner_error": "1", "charge_per_force_outer_error": "1", "charge_ratio_error": "1",
    "error_estimate": "1", "stress_inner_error": "1", "stress_outer_error": "1", "stiffness_error": "1",
    "equivalent_modulus": "Pa", "residual": "1", "frequency": "Hz",
    "ratio_phase": "rad", "ratio_phase_error": "rad", "youngs_modulus": "Pa", "force": "N", "indentation": "m",
    "tangent_stiffness": "N/m", "closest_walls": "m", "contact_radius": "m", "largest_strain": "1", "position": "m", "at": "m",
    "ratio_without": "1", "depth": "m", "diameter": "m", "change": "1", "standard_deviation": "1", "error": "1", "seen": "1",
    "resolved": "1", "above_error": "1", "noise": "1", "seen_threshold": "1", "resolved_threshold": "1", "accuracy": "1",
    "charge_ratio_without": "1", "seconds": "s", "strength": "m^3", "p_value": "1",
}  # fmt: skip
"""SI units of the fields of results, by name; 1 is a pure number."""
ERROR_FIELDS = (
    "error_estimate", "stress_inner_error", "stress_outer_error", "stiffness_error", "charge_inner_error", "charge_outer_error",
    "charge_per_force_inner_error", "charge_per_force_outer_error", "charge_ratio_error",
)  # fmt: skip
"""Fields of a result that are relative errors, of the kind ``error_kind``."""
SHOWN_IN_PERCENT = frozenset((*ERROR_FIELDS, "error", "change", "noise", "accuracy", "seen_threshold"))
"""Fields, also of scans and maps, that are relative: people read them in percent."""
SHOWN_UNITS = {"C": ("pC", 1e12), "C/N": ("pC/N", 1e12)}
"""By SI unit: the unit that is shown, and its number in an SI unit."""
SHOWN_MODULI = frozenset(("youngs_modulus", "equivalent_modulus"))
"""Fields that people read in kPa; stresses, small at a touch, are read in Pa."""

MAX_SHOWN_ROWS = 10  # rows of arrays that a printed result shows


def format_unit(name: str) -> str:
    """Return the SI unit of a field of results; an empty text for a pure number, whose unit is "1", and for unknown names."""
    return SI_UNITS.get(name, "").replace("1", "")


def find_shown_unit(name: str) -> tuple[str, float]:
    """Return the unit in which a field of results is shown, and its number in the SI unit."""
    if name in SHOWN_IN_PERCENT:
        return "%", 100.0
    if name in SHOWN_MODULI:
        return "kPa", 1e-3
    si = format_unit(name)
    return SHOWN_UNITS.get(si, (si, 1.0))


class Record:
    """Base of frozen dataclasses that hold numbers and arrays along ``DIMENSIONS``.

    Attributes
    ----------
    DIMENSIONS
        The fields along which the arrays lie, in their order; none where there are no arrays.
    LABELS
        Further fields that locate an entry along the dimensions.
    INTERNAL
        Fields that the JSON object does not have.
    """

    DIMENSIONS: ClassVar[tuple[str, ...]] = ()
    LABELS: ClassVar[tuple[str, ...]] = ()
    INTERNAL: ClassVar[tuple[str, ...]] = ()

    def as_dict(self) -> JsonObject:
        """Return the JSON object of the command that computes the result: all fields but ``INTERNAL`` ones."""
        # internal fields are set to None first, as asdict would convert them in vain
        public = replace(self, **dict.fromkeys(self.INTERNAL)) if self.INTERNAL else self  # type: ignore[type-var]
        return {name: value for name, value in asdict(public).items() if name not in self.INTERNAL}  # type: ignore[call-overload]

    def collect_numbers(self) -> JsonObject:
        """Return the fields that are one number or text."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        return {name: value for name, value in values.items() if isinstance(value, str | bool | int | float)}

    def collect_arrays(self) -> dict[str, Floats]:
        """Return the fields that are arrays along the dimensions; NaN where a value is missing, as a warning then explains."""
        shape = tuple(len(getattr(self, name)) for name in self.DIMENSIONS)
        arrays: dict[str, Floats] = {}
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            # arrays are stored as tuples; those of another shape than the dimensions' are left out below
            if isinstance(value, tuple) and field.name in SI_UNITS and field.name not in self.DIMENSIONS and shape:
                array = np.array(value, dtype=float)  # None becomes NaN
                arrays |= {field.name: array} if array.shape == shape else {}
        return arrays

    def __str__(self) -> str:
        """Return a short table: the single numbers with their units, the first rows of the arrays, the warnings."""
        numbers = self.collect_numbers()
        width = max(map(len, numbers), default=0)
        rows = [f"{name:<{width}}  {_format_value(name, value)}" for name, value in numbers.items()]
        arrays = self.collect_arrays() if len(self.DIMENSIONS) == 1 else {}
        if arrays:
            columns = {name: np.array(getattr(self, name)) for name in self.DIMENSIONS} | arrays
            columns = {name: values for name, values in columns.items() if np.isfinite(values).any()}
            shown = [
                [_format_heading(name), *(_format_entry(name, x) for x in column[:MAX_SHOWN_ROWS])]
                for name, column in columns.items()
            ]
            widths = [max(map(len, cells)) for cells in shown]
            rows += [
                "  ".join(cell.rjust(size) for cell, size in zip(row, widths, strict=True)) for row in zip(*shown, strict=True)
            ]
            left = len(next(iter(columns.values()))) - MAX_SHOWN_ROWS
            rows += [f"... {left} more rows"] if left > 0 else []
        rows += [f"warning: {text}" for text in getattr(self, "warnings", ())]
        return "\n".join([type(self).__name__, *rows])

    __repr__ = __str__  # in place of all fields with their provenance; dataclasses are declared with repr=False

    def to_frame(self) -> pd.DataFrame:
        """Return a pandas frame: the arrays by their dimensions, or the single numbers with their units by their names.

        Raises
        ------
        MissingLibrary
            Pandas is not installed; for arrays, xarray is needed, too.
        """
        pandas = import_extra("pandas")
        if self.DIMENSIONS:
            frame: pd.DataFrame = self.to_dataset().to_dataframe()
            return frame
        numbers = self.collect_numbers()
        columns = {"value": list(numbers.values()), "unit": [SI_UNITS.get(name, "").replace("1", "") for name in numbers]}
        return pandas.DataFrame(columns, index=pandas.Index(numbers, name="quantity"))

    def to_dataset(self) -> xr.Dataset:
        """Return the arrays with their labels, units in the ``attrs`` of each; NaN where there is no value.

        Verdicts are 1, 0 or NaN. The ``attrs`` of the whole hold the single numbers, the warnings and, as JSON, the provenance.

        Raises
        ------
        MissingLibrary
            Xarray is not installed.
        """
        xarray = import_extra("xarray")
        arrays: JsonObject = {name: (self.DIMENSIONS, values) for name, values in self.collect_arrays().items()}
        labels = {name: (name, np.array(getattr(self, name))) for name in self.DIMENSIONS}
        labels |= {name: arrays.pop(name) for name in self.LABELS}
        dataset: xr.Dataset = xarray.Dataset(arrays, coords=labels)
        for name in dataset.variables:
            dataset[name].attrs["units"] = SI_UNITS[str(name)]
        dataset.attrs |= self.collect_numbers() | {"warnings": [*map(str, getattr(self, "warnings", ()))]}
        dataset.attrs["provenance"] = json.dumps(getattr(self, "provenance", None))
        return dataset


def _format_entry(name: str, value: float) -> str:
    """Return an entry of an array, whose unit its heading does not have."""
    if name in SHOWN_IN_PERCENT and np.isfinite(value):
        return format_percent(value, 3)
    return f"{find_shown_unit(name)[1] * value:.5g}"


def _format_heading(name: str) -> str:
    """Return the heading of an array: its name, and its unit unless its entries have it."""
    unit = find_shown_unit(name)[0]
    return name if name in SHOWN_IN_PERCENT or not unit else f"{name}, {unit}"


def _format_value(name: str, value: object) -> str:
    """Return a number with the unit in which it is shown, or a text as it is."""
    if isinstance(value, str | bool):
        return str(value)
    if name in SHOWN_IN_PERCENT and isinstance(value, float):
        return format_percent(value, 3)
    if not isinstance(value, int | float):
        return str(value)
    unit, scale = find_shown_unit(name)
    return f"{scale * value:.6g} {unit}".rstrip()
