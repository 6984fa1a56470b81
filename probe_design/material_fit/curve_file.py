"""Read a curve of stress against stretch or strain from a text file of columns.

The names of the columns state what they hold: "stretch", "strain" or "shear", and "stress", with "nominal" or "engineering",
"true" or "Cauchy" in front where a file has both. Units stand in brackets or at the end: "nominal stress (kPa)", "strain [%]".
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.units import UNIT_FACTORS
from hw.common.errors import InvalidSource
from hw.files.csv_table import read_csv
from probe_design.material_fit.kinds import StressKind, Test

MAX_FILE_BYTES = 20_000_000  # bytes: a tensile test at 1 kHz for ten minutes
KINDS = {"nominal": "nominal", "engineering": "nominal", "pk1": "nominal", "true": "true", "cauchy": "true", "log": "true"}
STRAIN_UNITS = {"": 1.0, "-": 1.0, "1": 1.0, "mm/mm": 1.0, "m/m": 1.0, "%": 0.01}
QUANTITIES = ("stress", "stretch", "shear", "strain", "force", "load")
_UNIT_END = re.compile(r"(?P<name>.*\S)[\s,_/]+(?P<unit>Pa|kPa|MPa|GPa|psi|N|mN|kN|mm|%)")


@dataclass(frozen=True)
class _Column:
    """A column: its index, what it holds ("stretch", "strain", "shear", "stress", "force"), its kind and unit."""

    index: int
    quantity: str
    kind: str
    unit: str


def read_curve_file(path: Path, test: Test, kind: StressKind | None) -> tuple[Floats, Floats, StressKind]:
    """Return the deformation, the stress in Pa and the kind of the stress, as the columns of a file state them.

    Parameters
    ----------
    path
        Of a text file with one row of names above the numbers.
    test
        Determines the sign of strains: compression may be written as positive strain.
    kind
        Of the stress; None: as its column says.

    Raises
    ------
    InputError
        The file has no such columns, or more than one that fits.
    """
    try:
        if path.is_file() and path.stat().st_size > MAX_FILE_BYTES:
            raise InputError("curve", str(path), f"a text file of at most {MAX_FILE_BYTES // 1_000_000} MB")
        table = read_csv(path)
        columns = [_classify(k, *pair) for k, pair in enumerate(zip(table.names, table.units, strict=True))]
        measure = _choose(columns, ("shear",) if test == "shear" else ("stretch", "strain"), "nominal")
        stress = _choose(columns, ("stress",), kind)
        deformation, values = np.asarray(table.read([measure.index, stress.index]), dtype=float).T
    except InvalidSource as fault:
        name, _, remedy = str(fault).partition(": allowed: ")
        raise InputError("curve", Words(name), remedy or "a text file of columns") from None
    stated = stress.kind or kind
    if stated is None:
        raise InputError("stress", Words("neither nominal nor true"), "'nominal stress' or 'true stress' as name, or --stress")
    if kind is not None and stress.kind and stress.kind != kind:
        raise InputError("stress", kind, f"{stress.kind}, as the file's column says")
    return (
        _convert(measure, deformation, test),
        values * _find_stress_factor(stress.unit),
        "true" if stated == "true" else "nominal",
    )


def _classify(index: int, name: str, unit: str) -> _Column:
    """Return what a column holds by the words of its name; the quantity is "" for columns that do not matter."""
    if not unit and (match := _UNIT_END.fullmatch(name)):
        name, unit = match["name"], match["unit"]
    words = re.findall(r"[a-z0-9]+", name.lower())
    quantity = next((word for word in QUANTITIES if word in words), "")  # a shear stress is a stress, a shear strain a shear
    kind = next((KINDS[word] for word in words if word in KINDS), "")
    return _Column(index, {"load": "force"}.get(quantity, quantity), kind, unit)


def _choose(columns: list[_Column], quantities: tuple[str, ...], kind: str | None) -> _Column:
    """Return the column of one of these quantities, the first that the file has, of a kind where there are several."""
    wanted = " or ".join(f"'{quantity}'" for quantity in quantities)
    for quantity in quantities:
        fitting = [column for column in columns if column.quantity == quantity]
        if len(fitting) > 1:
            fitting = [column for column in fitting if column.kind == kind] or fitting
        if len(fitting) > 1:
            remedy = f"one column of {quantity}, or --stress nominal or true where the names say which is which"
            raise InputError(quantity, Words(f"{len(fitting)} columns"), remedy)
        if fitting:
            return fitting[0]
    if quantities == ("stress",) and any(column.quantity == "force" for column in columns):
        raise InputError("stress", Words("a column of force"), "a column of stress: force over the sample's area, with its unit")
    raise InputError("curve", Words("no such column"), f"a row of names above the numbers with {wanted} among them")


def _convert(column: _Column, values: Floats, test: Test) -> Floats:
    """Return stretches, or shears, of a column of stretch, strain or shear."""
    if column.quantity == "stretch":
        if column.unit not in ("", "-", "1", "mm/mm", "m/m"):
            raise InputError("stretch", Words(f"in {column.unit}"), "a number without unit: length over undeformed length")
        return values
    if column.unit not in STRAIN_UNITS:
        raise InputError(column.quantity, Words(f"in {column.unit}"), "a number without unit, or %")
    strain = values * STRAIN_UNITS[column.unit]
    if column.quantity == "shear":
        return strain if np.nansum(strain) >= 0 else -strain
    if test == "compression" and np.nansum(strain) > 0:  # written as a shortening
        strain = -strain
    if test == "compression" and column.kind != "true" and np.nanmin(strain) <= -1:
        raise InputError("strain", float(np.nanmax(-strain)), "below 1 in compression; strain in per cent needs the unit %")
    stretch: Callable[[Floats], Floats] = np.exp if column.kind == "true" else lambda strain: 1 + strain
    return np.asarray(stretch(np.clip(strain, -50.0, 50.0)))  # beyond it the stretch is refused anyway


def _find_stress_factor(unit: str) -> float:
    """Return the pascals in a unit of stress; refuse units of other quantities."""
    if not unit:
        raise InputError("stress", Words("without unit"), "its unit in the column's name, such as 'nominal stress (kPa)'")
    if unit not in UNIT_FACTORS["Pa"]:
        hint = "divide forces by the sample's undeformed area" if unit in ("N", "mN", "kN") else "convert the column"
        raise InputError("stress", Words(f"in {unit}"), f"{', '.join(UNIT_FACTORS['Pa'])}; {hint}")
    return UNIT_FACTORS["Pa"][unit]
