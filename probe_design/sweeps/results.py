"""Return or write the rows of a sweep as pandas, xarray, Parquet or CSV, also while the sweep runs."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry.common.errors import InputError, MissingLibrary
from geometry.common.files import written_whole
from geometry.common.text_files import read_text
from geometry.provenance.block import Provenance, provenance
from probe_design.sweeps.rows import COLUMNS, REAL
from probe_design.sweeps.store import reading

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

UNITS = {
    "stress_inner": "Pa", "stress_outer": "Pa", "ratio": "", "log_sensitivity": "", "stiffness": "N/m", "charge_inner": "C",
    "charge_outer": "C", "equivalent_modulus": "Pa", "error_estimate": "", "residual": "", "seconds": "s",
    "time_limit": "s", "memory_limit": "byte",
}  # fmt: skip
_FORMULA = tuple("=+-@\t\r\n＝＋－＠")  # a spreadsheet runs a text that begins with one of these as a formula


def extra(name: str) -> Any:
    """Import a library of the optional dependencies ``sweep``.

    Raises:
        MissingLibrary: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError:
        library = name.split(".")[0]
        raise MissingLibrary(f"{library} is not installed: pip install '.[sweep]' brings it") from None


def about(folder: Path | str) -> dict[str, Any]:
    """Return the request of the sweep in a folder. Raises ``InputError``, ``StoreError``."""
    with reading(Path(folder)) as store:
        request = store.about()
    if not request:
        raise InputError("folder", str(folder), "a folder of a sweep that has begun")
    return request


def rows(folder: Path | str) -> Iterator[dict[str, Any]]:
    """Yield the rows of all evaluated designs by number: number, key, variables, then ``rows.ROW_COLUMNS``; SI units.

    Raises:
        InputError: the folder holds no sweep.
        StoreError: it cannot be read.
    """
    with reading(Path(folder)) as store:
        names = store.about().get("names", [])
        for number, values, key, row in store.rows():
            yield {"number": number, "key": key.hex(), **dict(zip(names, values, strict=True)), **row}


def units(folder: Path | str) -> dict[str, str]:
    """Return the SI unit of each column of numbers; empty for dimensionless ones."""
    return {one["name"]: one["unit"] for one in about(folder)["variables"]} | UNITS


def dataframe(folder: Path | str) -> pd.DataFrame:
    """Return the rows of a sweep as a data frame with the design's number as index and units in ``attrs["units"]``.

    Raises:
        MissingLibrary: pandas is not installed.
        InputError: the folder holds no sweep.
        StoreError: it cannot be read.
    """
    pandas = extra("pandas")
    names = about(folder)["names"]
    frame = pandas.DataFrame.from_records(list(rows(folder)), columns=["number", "key", *names, *COLUMNS], index="number")
    frame[list(REAL)] = frame[list(REAL)].astype(float)
    frame.attrs["units"] = units(folder)
    return frame


def dataset(folder: Path | str) -> xr.Dataset:
    """Return the rows of a sweep as an xarray dataset with the unit of each array in its ``attrs``.

    The dimensions of a grid are the variables, and designs without a result are NaN. A sample has the one dimension ``design``
    (the number), along which the variables are coordinates.

    Raises:
        MissingLibrary: xarray or pandas is not installed.
        InputError: the folder holds no sweep.
        StoreError: it cannot be read.
    """
    xarray, request, frame = extra("xarray"), about(folder), dataframe(folder)
    labelled: xr.Dataset
    names, columns = request["names"], [*REAL, "status", "evaluator", "reason"]
    if request["sample"]["kind"] == "grid":
        axes = [one["values"] for one in request["variables"]]
        shape = tuple(len(axis) for axis in axes)
        count = 1
        for length in shape:
            count *= length
        whole = frame.reindex(range(count))  # adds the designs that constraints excluded, without values
        arrays = {name: (names, whole[name].to_numpy().reshape(shape)) for name in columns}
        labelled = xarray.Dataset(arrays, coords=dict(zip(names, axes, strict=True)))
    else:
        labels = {"design": frame.index.to_numpy()} | {name: ("design", frame[name].to_numpy()) for name in names}
        labelled = xarray.Dataset({name: ("design", frame[name].to_numpy()) for name in columns}, coords=labels)
    for name, unit in units(folder).items():
        labelled[name].attrs["units"] = unit or "1"
    labelled.attrs |= {name: request[name] for name in ("evaluator", "accuracy", "version")}
    labelled.attrs["provenance"] = json.dumps(origin(folder))
    return labelled


def origin(folder: Path | str) -> Provenance:
    """Return the provenance of a finished sweep; while it runs, that of this process."""
    with suppress(InputError, ValueError, KeyError, TypeError):
        told: Provenance = json.loads(read_text(Path(folder) / "provenance.json", "provenance"))["provenance"]
        return told
    return provenance()


def to_csv(folder: Path | str, path: Path) -> Path:
    """Write the rows as CSV with units in the headings; needs no optional library. The file is written whole or not at all.

    Texts that a spreadsheet would run as formulas are preceded by ``'``; see ``escape_formula``.
    """
    unit = units(folder)
    names = ["number", "key", *about(folder)["names"], *COLUMNS]
    with written_whole(path) as draft, draft.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(f"{name}, {unit[name]}" if unit.get(name) else name for name in names)
        table.writerows([no_formula(row[name]) for name in names] for row in rows(folder))
    return path


def no_formula(cell: Any) -> Any:
    """Put ``'`` before a text that a spreadsheet would run as a formula; return numbers unchanged.

    Source: https://owasp.org/www-community/attacks/CSV_Injection
    """
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(_FORMULA) else cell


def to_parquet(folder: Path | str, path: Path) -> Path:
    """Write the rows as Parquet. The file is written whole or not at all.

    Raises:
        MissingLibrary: pandas or pyarrow is not installed.
    """
    extra("pyarrow")
    frame = dataframe(folder)
    with written_whole(path) as draft:
        frame.to_parquet(draft)
    return path
