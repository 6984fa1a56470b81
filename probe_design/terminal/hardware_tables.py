"""Readings, calibrations and checks as tables."""

from __future__ import annotations

import numpy as np
from rich.table import Table

from probe_design.built_probe.calibration_record import CalibrationRecord
from probe_design.built_probe.check import Check
from probe_design.built_probe.explanations import Explanation
from probe_design.built_probe.gain_matrix import ENTRIES
from probe_design.built_probe.reading import Read

MOST = 6  # explanations shown


def read_table(found: Read) -> Table:
    """Return a reading: read, predicted, z."""
    table = Table(title=f"{found.cycles:.4g} cycles of {found.frequency:.5g} Hz; predicted by {found.evaluator}")
    _columns(table, "quantity", "read", "sd", "predicted", "z")
    rows = (
        ("ratio", found.ratio, found.ratio_uncertainty, found.predicted_ratio, found.z_ratio),
        _stress("inner", found.stress_inner, found.stress_inner_uncertainty, found.predicted_stress_inner, found.z_stress_inner),
        _stress("outer", found.stress_outer, found.stress_outer_uncertainty, found.predicted_stress_outer, found.z_stress_outer),
        ("force on both films, N", found.force, found.force_uncertainty, found.reference_force, None),
    )
    for name, *values in rows:
        table.add_row(name, *(_text(value, digits) for value, digits in zip(values, (5, 2, 5, 2), strict=True)))
    return table


def calibration_table(told: CalibrationRecord) -> Table:
    """Return the gain matrix and what it was told by."""
    scale = "absolute" if told.absolute else "relative: the outer gain is the unit"
    fit = f"chi-square {told.chi_square:.3g} for {told.degrees_of_freedom} degrees of freedom"
    table = Table(title=f"{len(told.reading)} references at {told.frequency:.5g} Hz; gains {scale}; {fit}")
    _columns(table, "quantity", "value", "sd")
    spread = np.sqrt(np.diag(np.array(told.covariance)))
    for name, value, sd in zip(ENTRIES, np.array(told.matrix).ravel(), spread, strict=True):
        table.add_row(name, f"{value:.5g}", f"{sd:.2g}")
    for name, value, sd in zip(("inner", "outer"), told.offsets, told.offsets_sd, strict=True):
        table.add_row(f"offset {name}, mV", f"{1e3 * value:.4g}", f"{1e3 * sd:.2g}")
    return table


def check_table(found: Check) -> Table:
    """Return the ratios of all blocks."""
    verdict = "passed" if found.passed else "failed"
    fit = f"chi-square {found.chi_square:.4g} for {found.degrees_of_freedom} degrees of freedom, p = {found.p_value:.2g}"
    table = Table(title=f"{verdict}: {fit} (fails below {found.level:g})")
    _columns(table, "reference", "ratio read", "sd", "predicted", "sd", "z")
    for one in found.blocks:
        values = (one.ratio, one.ratio_uncertainty, one.predicted, one.predicted_uncertainty, one.z)
        table.add_row(one.name, *(_text(value, digits) for value, digits in zip(values, (5, 2, 5, 2, 2), strict=True)))
    return table


def explanations_table(found: Check) -> Table:
    """Return what would explain a deviation, best first."""
    table = Table(title="which one variable would explain it")
    _columns(table, "variable", "drawn", "would be", "sd", "chi2 left")
    for one in found.explanations[:MOST]:
        table.add_row(one.variable.removeprefix("probe."), *_in_units(one), f"{one.chi_square:.3g}")
    return table


def sentence(found: Check) -> str:
    """Say what a check comes to."""
    if found.passed:
        return "the probe does what was predicted, within the uncertainties"
    if not found.explanations or not found.explanations[0].explains:
        return "the probe does not do what was predicted, and no single variable explains it"
    best, *others = found.alike
    if not others:
        return f"the probe does not do what was predicted; {best} would explain it"
    return f"the probe does not do what was predicted; {best} would explain it; not told apart from it: {', '.join(others)}"


def _in_units(one: Explanation) -> tuple[str, str, str]:
    value = one.nominal + one.change
    if one.variable in ("relative gain", "reference.youngs_modulus"):
        return "1", f"{value:.5g}", f"{one.uncertainty:.2g}"
    if one.variable.endswith("poisson_ratio"):
        return f"{one.nominal:.4g}", f"{value:.4g}", f"{one.uncertainty:.2g}"
    scale, unit = (1e-3, "kPa") if one.variable.endswith("modulus") else (1e3, "mm")
    return f"{scale * one.nominal:.5g} {unit}", f"{scale * value:.5g}", f"{scale * one.uncertainty:.2g}"


def _stress(film: str, *values: float | None) -> tuple[str, float | None, float | None, float | None, float | None]:
    read, spread, predicted, z = values
    return f"stress {film}, Pa", read, spread, predicted, z


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}g}"


def _columns(table: Table, first: str, *others: str) -> None:
    table.add_column(first, no_wrap=True)
    for heading in others:
        table.add_column(heading, justify="right", no_wrap=True)
