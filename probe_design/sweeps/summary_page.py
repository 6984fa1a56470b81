"""Write the summary page of a sweep: counts, scatter plots, main effects, and Sobol indices of a Saltelli sample."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import import_extra
from geometry.common.files import write_text
from geometry.common.json_types import JsonObject
from geometry.scenes.units import convert_to_unit
from probe_design.reporting.page import Chapter, Picture, Text, build_page
from probe_design.reporting.table import Table
from probe_design.sweeps.results import iterate_rows, read_provenance, read_request
from solver.results.record import find_shown_unit

STRESS_COLUMNS = ("ratio", "log_sensitivity", "stiffness", "error_estimate")
CHARGE_COLUMNS = (
    "charge_ratio", "charge_log_sensitivity", "charge_per_force_inner", "charge_per_force_outer", "stiffness",
    "charge_ratio_error",
)  # fmt: skip
MAX_POINTS = 5000  # designs drawn in a scatter plot
PICTURES_PER_LINE = 4  # scatter plots in a line
EFFECT_BINS = 10  # of a variable, for main effects of a sample
BOOTSTRAP_SEED = 1  # of the bootstrap for intervals of Sobol indices


def write_page(folder: Path | str, path: Path) -> Path:
    """Write the summary of the sweep in ``folder``, one HTML file with its pictures in it.

    Raises
    ------
    MissingLibrary
        SALib is not installed, for a Saltelli sample.
    InputError
        The folder holds no sweep.
    StoreError
        It cannot be read.
    """
    request, all_rows = read_request(folder), list(iterate_rows(folder))
    ok_rows = [row for row in all_rows if row["status"] == "ok"]
    # charges first where some designs read them; stresses too where some designs read these, or have no charges
    by_charge = any(row["observable"] == "charge" for row in ok_rows)
    only_charges = by_charge and all(row["charge_ratio"] is not None for row in ok_rows if row["observable"] == "charge")
    by_stress = not only_charges or any(row["observable"] == "stress" for row in ok_rows)
    summary_columns = dict.fromkeys((CHARGE_COLUMNS if by_charge else ()) + (STRESS_COLUMNS if by_stress else ()))
    names = [name for name in summary_columns if any(row[name] is not None for row in ok_rows)]
    sections = [Chapter("The request", (_build_counts_table(request, all_rows),))]
    for name in names:
        result_rows = [row for row in ok_rows if row[name] is not None]
        y = np.array([row[name] for row in result_rows], dtype=float)
        effects = _build_effects(request, result_rows, y, complete=len(result_rows) == request["designs"])
        sections.append(
            Chapter(
                _format_label(name.replace("_", " "), find_shown_unit(name)[0]),
                (_draw_scatter(name, request["variables"], result_rows, y), *effects),
            )
        )
    sections += _build_reasons(all_rows)
    counts = Counter(row["status"] for row in all_rows)
    headline = f"{request['designs']} designs: {counts['ok']} ok, {counts['refused']} refused, {counts['failed']} failed."
    record = {"designs": request["designs"], **counts, "provenance": read_provenance(folder)}
    return write_text(path, build_page("Sweep", headline, sections, record, is_positive=not counts["failed"]))


def _build_counts_table(request: JsonObject, all_rows: list[JsonObject]) -> Table:
    """Build the table of the request and the counts of rows."""
    count = Counter(row["status"] for row in all_rows)
    lines = [
        ("designs", request["designs"]), ("ok", count["ok"]), ("refused", count["refused"]), ("failed", count["failed"]),
        ("sample", request["sample"]["kind"]), ("evaluator", request["evaluator"]), ("accuracy", request["accuracy"]),
        ("version", request["version"]), ("constraints", "; ".join(request["constraints"]) or "none"),
        ("seconds of work", f"{sum(row['seconds'] for row in all_rows):.4g}"),
    ]  # fmt: skip
    return Table(("", ""), [(name, str(value)) for name, value in lines])


def _build_reasons(all_rows: list[JsonObject]) -> list[Chapter]:
    """Build the chapter with the commonest reasons why designs have no result; none if all have one."""
    reasons = Counter((row["status"], row["type"], row["reason"]) for row in all_rows if row["status"] != "ok")
    lines = [(str(count), *reason) for reason, count in reasons.most_common(20)]
    return [Chapter("Designs without a result", (Table(("rows", "status", "type", "reason"), lines),))] if lines else []


def _build_effects(request: JsonObject, result_rows: list[JsonObject], y: Floats, complete: bool) -> tuple[Table | Text, ...]:
    """Build the table of main effects, or of Sobol indices if the sample is complete and of kind ``saltelli``.

    Parameters
    ----------
    request
        Settings and variables of the sweep.
    result_rows
        Rows that have this output.
    y
        The output in these rows, shape (rows,).
    complete
        Whether every design has it.
    """
    if len(y) < 2 or np.ptp(y) == 0.0:
        return (Text("The same for all designs."),)
    if request["sample"]["kind"] == "saltelli" and complete:
        indices = compute_sobol_indices(y, len(request["names"]))
        table = [(name, *(f"{low:.3g}" for low in values)) for name, values in zip(request["names"], indices, strict=True)]
        heads = ("variable", "first order", "±", "total", "±")
        return Table(heads, table), Text("Sobol indices, 95 % intervals.")
    effects = [(name, compute_main_effect([row[name] for row in result_rows], y)) for name in request["names"]]
    lines = [(name, "-" if effect is None else f"{effect:.3g}") for name, effect in effects]
    note = "" if request["sample"]["kind"] != "saltelli" else " Sobol indices need a result for every design."
    return Table(("variable", "share of the variance"), lines), Text(f"Main effects: what each variable explains alone.{note}")


def compute_main_effect(values: Sequence[object], y: Floats) -> float | None:
    """Return the main effect of a variable: the variance of the conditional means of ``y`` over its variance, from 0 to 1.

    Means are taken at each value of a grid, and over bins of equally many designs of a sample, which adds noise of about
    bins / designs. None if there are fewer than two designs per bin, where every variable would seem to explain everything.

    Parameters
    ----------
    values
        Values of the variable, one per design.
    y
        The output, shape (designs,), not constant.
    """
    unique_values, bins = np.unique(np.array(values), return_inverse=True)
    if len(unique_values) > 2 * EFFECT_BINS:
        bins = np.empty(len(y), dtype=int)
        # ranks of the values, divided into bins of equally many designs
        bins[np.argsort(np.array(values), kind="stable")] = np.arange(len(y)) * EFFECT_BINS // len(y)
    counts = np.bincount(bins)
    if np.mean(counts) < 2:
        return None
    means = np.bincount(bins, weights=y - np.mean(y)) / counts
    return float(np.sum(counts * means**2) / np.sum((y - np.mean(y)) ** 2))


def compute_sobol_indices(y: Floats, d: int) -> list[tuple[float, float, float, float]]:
    """Return for each variable its first-order Sobol index and total index, each followed by its 95 % half-width.

    Parameters
    ----------
    y
        The output of all designs of a Saltelli sample, in its order, shape (n (d + 2),).
    d
        Number of variables.

    Raises
    ------
    MissingLibrary
        SALib is not installed.

    Source: Saltelli et al., Computer Physics Communications 181 (2010) 259-270, table 2, eqs. (b) and (f), as in SALib.
    """
    problem = {"num_vars": d, "names": [str(k) for k in range(d)], "bounds": [[0.0, 1.0]] * d}
    indices = import_extra("SALib.analyze.sobol").analyze(
        problem, y, calc_second_order=False, conf_level=0.95, seed=BOOTSTRAP_SEED
    )
    columns = (map(float, indices[name]) for name in ("S1", "S1_conf", "ST", "ST_conf"))
    return list(zip(*columns, strict=True))


def _draw_scatter(name: str, variables: list[Any], result_rows: list[Any], y: Floats) -> Picture:
    """Draw the output ``name``, with SI values y, against each variable, both in their display units."""
    from matplotlib.figure import Figure

    column_count, row_count = min(len(variables), PICTURES_PER_LINE), -(-len(variables) // PICTURES_PER_LINE)
    figure = Figure(figsize=(3.2 * column_count, 2.8 * row_count), layout="constrained")
    step = -(-len(y) // MAX_POINTS)  # rounded up: every step-th design is drawn
    unit, scale = find_shown_unit(name)
    places = figure.subplots(row_count, column_count, sharey=True, squeeze=False).ravel()
    for axes in places[len(variables) :]:
        axes.set_visible(False)
    for axes, variable in zip(places, variables, strict=False):
        values = [row[variable["name"]] for row in result_rows[::step]]
        if variable["unit"]:
            values = [convert_to_unit(value, variable["unit"], variable["shown"]) for value in values]
        axes.plot(values, scale * y[::step], ".", markersize=3, alpha=0.5)
        axes.set_xlabel(_format_label(variable["name"], variable["shown"]))
        if variable["log"]:
            axes.set_xscale("log")
    for axes in places[::column_count]:
        axes.set_ylabel(_format_label(name.replace("_", " "), unit))
    return Picture.from_figure(figure, name)


def _format_label(name: str, unit: str) -> str:
    """Return a name with its unit, if it has one."""
    return f"{name}, {unit}" if unit else name
