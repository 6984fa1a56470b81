"""Write the summary page of a sweep: counts, scatter plots, main effects, and Sobol indices of a Saltelli sample."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.files import write_text
from geometry.scenes.units import shown
from probe_design.reports.page import Chapter, PageTable, Picture, Text, page
from probe_design.sweeps.results import UNITS, about, extra, origin, rows

SHOWN = ("ratio", "log_sensitivity", "stiffness", "error_estimate")
MOST_POINTS = 5000  # designs drawn in a scatter plot
MOST_BESIDE = 4  # scatter plots in a line
BINS = 10  # of a variable, for main effects of a sample
SEED = 1  # of the bootstrap for intervals of Sobol indices


def write_page(folder: Path | str, path: Path) -> Path:
    """Write the summary of the sweep in ``folder``, one HTML file with its pictures in it.

    Raises:
        MissingLibrary: SALib is not installed, for a Saltelli sample.
        InputError: the folder holds no sweep.
        StoreError: it cannot be read.
    """
    request, all_rows = about(folder), list(rows(folder))
    good = [row for row in all_rows if row["status"] == "ok"]
    names = [name for name in SHOWN if any(row[name] is not None for row in good)]
    sections = [Chapter("What was asked", (_counts(request, all_rows),))]
    for name in names:
        answered = [row for row in good if row[name] is not None]
        y = np.array([row[name] for row in answered], dtype=float)
        effects = _effects(request, answered, y, complete=len(answered) == request["designs"])
        sections.append(Chapter(_label(name, UNITS[name]), (_picture(name, request["variables"], answered, y), *effects)))
    sections += _reasons(all_rows)
    counts = Counter(row["status"] for row in all_rows)
    headline = f"{request['designs']} designs: {counts['ok']} ok, {counts['refused']} refused, {counts['failed']} failed."
    answer = {"designs": request["designs"], **counts, "provenance": origin(folder)}
    return write_text(path, page("Sweep", headline, sections, answer))


def _counts(request: dict[str, Any], all_rows: list[dict[str, Any]]) -> PageTable:
    """Build the table of the request and the counts of rows."""
    count = Counter(row["status"] for row in all_rows)
    lines = [
        ("designs", request["designs"]), ("ok", count["ok"]), ("refused", count["refused"]), ("failed", count["failed"]),
        ("sample", request["sample"]["kind"]), ("evaluator", request["evaluator"]), ("accuracy", request["accuracy"]),
        ("version", request["version"]), ("constraints", "; ".join(request["constraints"]) or "none"),
        ("seconds of work", f"{sum(row['seconds'] for row in all_rows):.4g}"),
    ]  # fmt: skip
    return _table(("", ""), lines)


def _reasons(all_rows: list[dict[str, Any]]) -> list[Chapter]:
    """Build the table of the commonest reasons why designs have no result."""
    reasons = Counter((row["status"], row["type"], row["reason"]) for row in all_rows if row["status"] != "ok")
    lines = [(count, *reason) for reason, count in reasons.most_common(20)]
    return [Chapter("Designs without a result", (_table(("rows", "status", "type", "reason"), lines),))] if lines else []


def _effects(request: dict[str, Any], answered: list[dict[str, Any]], y: Floats, complete: bool) -> tuple[PageTable | Text, ...]:
    """Build the table of main effects, or of Sobol indices if the sample is complete and of kind ``saltelli``."""
    if len(y) < 2 or np.ptp(y) == 0.0:
        return (Text("The same for all designs."),)
    if request["sample"]["kind"] == "saltelli" and complete:
        indices = sobol_indices(y, len(request["names"]))
        table = [(name, *(f"{low:.3g}" for low in one)) for name, one in zip(request["names"], indices, strict=True)]
        heads = ("variable", "first order", "±", "total", "±")
        return _table(heads, table), Text("Sobol indices, 95 % intervals.")
    effects = [(name, main_effect([row[name] for row in answered], y)) for name in request["names"]]
    lines = [(name, "-" if effect is None else f"{effect:.3g}") for name, effect in effects]
    note = "" if request["sample"]["kind"] != "saltelli" else " Sobol indices need a result for every design."
    return _table(("variable", "share of the variance"), lines), Text(f"Main effects: what each variable explains alone.{note}")


def main_effect(values: Sequence[object], y: Floats) -> float | None:
    """Compute the main effect of a variable: the variance of the conditional means of ``y`` over its variance, from 0 to 1.

    Means are taken at each value of a grid, and over bins of equally many designs of a sample, which adds noise of about
    bins / designs. None if there are fewer than two designs per bin, where every variable would seem to explain everything.

    Args:
        values: of the variable, one per design.
        y: the output, shape (designs,), not constant.
    """
    levels, bins = np.unique(np.array(values), return_inverse=True)
    if len(levels) > 2 * BINS:
        bins = np.empty(len(y), dtype=int)
        bins[np.argsort(np.array(values), kind="stable")] = np.arange(len(y)) * BINS // len(y)
    counts = np.bincount(bins)
    if np.mean(counts) < 2:
        return None
    means = np.bincount(bins, weights=y - np.mean(y)) / counts
    return float(np.sum(counts * means**2) / np.sum((y - np.mean(y)) ** 2))


def sobol_indices(y: Floats, d: int) -> list[tuple[float, float, float, float]]:
    """Return for each variable its first-order Sobol index and total index, each followed by its 95 % half-width.

    Args:
        y: the output of all designs of a Saltelli sample, in its order, shape (n (d + 2),).
        d: number of variables.

    Raises:
        MissingLibrary: SALib is not installed.

    Source: Saltelli et al., Computer Physics Communications 181 (2010) 259-270, table 2, eqs. (b) and (f), as in SALib.
    """
    problem = {"num_vars": d, "names": [str(one) for one in range(d)], "bounds": [[0.0, 1.0]] * d}
    indices = extra("SALib.analyze.sobol").analyze(problem, y, calc_second_order=False, conf_level=0.95, seed=SEED)
    columns = (map(float, indices[name]) for name in ("S1", "S1_conf", "ST", "ST_conf"))
    return list(zip(*columns, strict=True))


def _picture(name: str, variables: list[Any], answered: list[Any], y: Floats) -> Picture:
    """Draw an output against each variable, in its display unit."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    wide, high = min(len(variables), MOST_BESIDE), -(-len(variables) // MOST_BESIDE)
    figure = Figure(figsize=(3.2 * wide, 2.8 * high), layout="constrained")
    FigureCanvasAgg(figure)
    step = -(-len(y) // MOST_POINTS)
    places = figure.subplots(high, wide, sharey=True, squeeze=False).ravel()
    for axes in places[len(variables) :]:
        axes.set_visible(False)
    for axes, variable in zip(places, variables, strict=False):
        values = [row[variable["name"]] for row in answered[::step]]
        if variable["unit"]:
            values = [shown(value, variable["unit"], variable["shown"]) for value in values]
        axes.plot(values, y[::step], ".", markersize=3, alpha=0.5)
        axes.set_xlabel(_label(variable["name"], variable["shown"]))
        if variable["log"]:
            axes.set_xscale("log")
    for axes in places[::wide]:
        axes.set_ylabel(_label(name, UNITS[name]))
    return Picture.of(figure, name)


def _label(name: str, unit: str) -> str:
    return f"{name}, {unit}" if unit else name


def _table(heads: tuple[str, ...], lines: Sequence[Sequence[Any]]) -> PageTable:
    return PageTable(heads, tuple(tuple(map(str, line)) for line in lines))
