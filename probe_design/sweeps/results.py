"""Return or write the rows of a sweep as pandas, xarray, Parquet or CSV, also while the sweep runs."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry.common.errors import InputError, import_extra
from geometry.common.files import write_whole
from geometry.common.json_types import JsonObject
from geometry.common.text_files import read_text
from geometry.provenance.block import Provenance, build_provenance
from probe_design.sweeps.rows import COLUMN_UNITS, ROW_COLUMNS
from probe_design.sweeps.store import open_for_reading

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

PROVENANCE_FILE = "provenance.json"  # in the folder of a sweep that has ended
_FORMULA_PREFIXES = tuple("=+-@\t\r\n＝＋－＠")  # a spreadsheet runs a text that begins with one of these as a formula


def read_request(folder: Path | str) -> JsonObject:
    """Return the request of the sweep in a folder: its settings and variables. Raises ``InputError``, ``StoreError``."""
    with open_for_reading(Path(folder)) as store:
        request = store.read_request()
    if not request:
        raise InputError("folder", str(folder), "a folder of a sweep that has begun")
    return request


def iterate_rows(folder: Path | str) -> Iterator[JsonObject]:
    """Yield the rows of all evaluated designs by number: number, key, variables, then ``rows.ROW_COLUMNS``; SI units.

    Raises
    ------
    InputError
        The folder holds no sweep.
    StoreError
        It cannot be read.
    """
    with open_for_reading(Path(folder)) as store:
        names = store.read_request().get("names", [])
        for number, values, key, row in store.iterate_rows():
            yield {"number": number, "key": key.hex(), **dict(zip(names, values, strict=True)), **row}


def read_units(folder: Path | str) -> dict[str, str]:
    """Return the SI unit of each column of numbers; empty for dimensionless ones."""
    return {variable["name"]: variable["unit"] for variable in read_request(folder)["variables"]} | COLUMN_UNITS


def dataframe(folder: Path | str) -> pd.DataFrame:
    """Return the rows of a sweep as a data frame with the design's number as index and units in ``attrs["units"]``.

    Raises
    ------
    MissingLibrary
        Pandas is not installed.
    InputError
        The folder holds no sweep.
    StoreError
        It cannot be read.
    """
    pandas = import_extra("pandas")
    names = read_request(folder)["names"]
    frame = pandas.DataFrame.from_records(
        list(iterate_rows(folder)), columns=["number", "key", *names, *ROW_COLUMNS], index="number"
    )
    frame[list(COLUMN_UNITS)] = frame[list(COLUMN_UNITS)].astype(float)
    frame.attrs["units"] = read_units(folder)
    return frame


def dataset(folder: Path | str) -> xr.Dataset:
    """Return the rows of a sweep as an xarray dataset with the unit of each array in its ``attrs``.

    The dimensions of a grid are the variables, and designs without a result are NaN. A sample has the one dimension ``design``
    (the number), along which the variables are coordinates.

    Raises
    ------
    MissingLibrary
        Xarray or pandas is not installed.
    InputError
        The folder holds no sweep.
    StoreError
        It cannot be read.
    """
    xarray, request, frame = import_extra("xarray"), read_request(folder), dataframe(folder)
    labelled: xr.Dataset  # xarray is imported at run time, so its types are not known here
    names, columns = request["names"], [*COLUMN_UNITS, "status", "evaluator", "observable", "reason"]
    if request["sample"]["kind"] == "grid":
        axes = [variable["values"] for variable in request["variables"]]
        shape = tuple(len(axis) for axis in axes)
        full_frame = frame.reindex(range(math.prod(shape)))  # adds the designs that constraints excluded, without values
        arrays = {name: (names, full_frame[name].to_numpy().reshape(shape)) for name in columns}
        labelled = xarray.Dataset(arrays, coords=dict(zip(names, axes, strict=True)))
    else:
        labels = {"design": frame.index.to_numpy()} | {name: ("design", frame[name].to_numpy()) for name in names}
        labelled = xarray.Dataset({name: ("design", frame[name].to_numpy()) for name in columns}, coords=labels)
    for name, unit in read_units(folder).items():
        labelled[name].attrs["units"] = unit or "1"
    labelled.attrs |= {name: request[name] for name in ("evaluator", "accuracy", "version")}
    labelled.attrs["provenance"] = json.dumps(read_provenance(folder))
    return labelled


def read_provenance(folder: Path | str) -> Provenance:
    """Return the provenance of a finished sweep; while it runs, that of this process."""
    with suppress(InputError, ValueError, KeyError, TypeError):
        block: Provenance = json.loads(read_text(Path(folder) / PROVENANCE_FILE, "provenance"))["provenance"]
        return block
    return build_provenance()


def write_csv(folder: Path | str, path: Path) -> Path:
    """Write the rows as CSV with units in the headings; needs no optional library. The file is written whole or not at all.

    Texts that a spreadsheet would run as formulas are preceded by ``'``; see ``escape_formula``.
    """
    unit = read_units(folder)
    names = ["number", "key", *read_request(folder)["names"], *ROW_COLUMNS]
    with write_whole(path) as draft, draft.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(f"{name}, {unit[name]}" if unit.get(name) else name for name in names)
        table.writerows([escape_formula(row[name]) for name in names] for row in iterate_rows(folder))
    return path


def escape_formula(cell: Any) -> Any:
    """Put ``'`` before a text that a spreadsheet would run as a formula; return numbers unchanged.

    Source: https://owasp.org/www-community/attacks/CSV_Injection
    """
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(_FORMULA_PREFIXES) else cell


def write_parquet(folder: Path | str, path: Path) -> Path:
    """Write the rows as Parquet. The file is written whole or not at all.

    Raises
    ------
    MissingLibrary
        Pandas or pyarrow is not installed.
    """
    import_extra("pyarrow")
    frame = dataframe(folder)
    with write_whole(path) as draft:
        frame.to_parquet(draft)
    return path
