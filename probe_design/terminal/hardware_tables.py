"""Build tables of readings, calibrations and checks."""

from __future__ import annotations

import numpy as np
from rich.table import Table

from geometry.scenes.catalogue import modulus_text
from probe_design.built_probe.calibration_record import CalibrationRecord
from probe_design.built_probe.gain_matrix import ENTRIES
from probe_design.built_probe.reading import Read
from probe_design.probe_check.check import Check
from probe_design.probe_check.deviation import CancellingPair
from probe_design.probe_check.explanations import Explanation

MOST = 6  # explanations shown
MOST_PAIRS = 3


def read_table(reading: Read) -> Table:
    """Return a reading as a table: measured, predicted, and their difference z in standard deviations."""
    table = Table(title=f"{reading.cycles:.4g} cycles of {reading.frequency:.5g} Hz; predicted by {reading.evaluator}")
    _columns(table, "quantity", "read", "sd", "predicted", "z")
    rows = (
        ("ratio", reading.ratio, reading.ratio_uncertainty, reading.predicted_ratio, reading.z_ratio),
        _phase(reading),
        _stress(reading, "inner"),
        _stress(reading, "outer"),
        ("force on both films, N", reading.force, reading.force_uncertainty, reading.reference_force, None),
    )
    for name, *values in rows:
        table.add_row(name, *(_text(value, digits) for value, digits in zip(values, (5, 2, 5, 2), strict=True)))
    return table


def _phase(reading: Read) -> tuple[str, float | None, float | None, float | None, float | None]:
    read, spread = reading.ratio_phase, reading.ratio_phase_uncertainty
    return "phase of the ratio, rad", read, spread, reading.predicted_ratio_phase, reading.z_ratio_phase


def calibration_table(record: CalibrationRecord) -> Table:
    """Return the gain matrix and the offsets as a table, with their standard deviations."""
    scale = "absolute" if record.absolute else "relative: the outer gain is the unit"
    fit = f"chi-square {record.chi_square:.3g} for {record.degrees_of_freedom} degrees of freedom"
    table = Table(title=f"{len(record.reading)} references at {record.frequency:.5g} Hz; gains {scale}; {fit}")
    _columns(table, "quantity", "value", "sd")
    spread = np.sqrt(np.diag(np.array(record.covariance)))
    for name, value, sd in zip(ENTRIES, np.array(record.matrix).ravel(), spread, strict=True):
        table.add_row(name, f"{value:.5g}", f"{sd:.2g}")
    for name, value, sd in zip(("inner", "outer"), record.offsets, record.offsets_sd, strict=True):
        table.add_row(f"offset {name}, mV", f"{1e3 * value:.4g}", f"{1e3 * sd:.2g}")
    return table


def check_table(check: Check) -> Table:
    """Return the ratios of all blocks as a table: measured, predicted, and their difference z."""
    fit = f"chi-square {check.chi_square:.4g} for {check.degrees_of_freedom} degrees of freedom, p = {check.p_value:.2g}"
    table = Table(title=f"{check.verdict}: {fit} (fails below {check.level:g})")
    _columns(table, "reference", "ratio read", "sd", "predicted", "sd", "z")
    for one in check.blocks:
        values = (one.ratio, one.ratio_uncertainty, one.predicted, one.predicted_uncertainty, one.z)
        table.add_row(one.name, *(_text(value, digits) for value, digits in zip(values, (5, 2, 5, 2, 2), strict=True)))
    return table


def explanations_table(check: Check) -> Table:
    """Return a table of the variables that would explain a deviation by themselves, the best first."""
    table = Table(title="which one variable would explain it")
    _columns(table, "variable", "drawn", "would be", "sd", "chi2 left")
    for one in check.explanations[:MOST]:
        table.add_row(_short(one.variable), *_in_units(one), f"{one.chi_square:.3g}")
    return table


def pairs_table(check: Check) -> Table:
    """Return a table of the pairs of variables that would explain a deviation together, the best first."""
    table = Table(title="which two would explain it together")
    _columns(table, "variables", "drawn", "would be", "sd", "chi2 left")
    for pair in check.pairs[:MOST_PAIRS]:
        for one, left in ((pair.first, f"{pair.chi_square:.3g}"), (pair.second, "")):
            table.add_row(_short(one.variable), *_in_units(one), left)
    return table


def coverage_table(check: Check) -> Table:
    """Return a table of the variables that the check has tested, and the deviation from which each would be detected."""
    table = Table(title="what was tested: a variable that would be found off by five tolerances in 1 of 2 cases or more")
    _columns(table, "variable", "tolerance, 1 sd", "five change a ratio by", "then found", "found 1 in 2 from", "tested")
    for one in (*check.tested, *check.untested):
        found = "nowhere" if one.found_from is None else _sized(one.variable, one.found_from)
        effect, often = f"{100 * one.effect:.2g} %", f"{100 * one.power:.0f} %"
        table.add_row(
            _short(one.variable), _sized(one.variable, one.tolerance), effect, often, found, "yes" if one.tested else "no"
        )
    return table


def sentences(check: Check) -> list[str]:
    """Return the verdict of a check, the variables tested, and those not tested with the reasons, one line each."""
    lines = [f"{check.verdict}: {check.reason}"] if check.reason else []
    if check.tested:
        names = ", ".join(_short(one.variable) for one in check.tested)
        count = f"{len(check.tested)} of {len(check.tested) + len(check.untested)} variables"
        lines.append(f"the probe is {check.verdict}: {names} ({count})" if check.passed else f"tested: {names} ({count})")
    for reason in dict.fromkeys(one.reason for one in check.untested):
        names = ", ".join(_short(one.variable) for one in check.untested if one.reason == reason)
        lines.append(f"not tested: {names}: {reason}")
    if check.cancelling:
        pairs = (_together(one) for one in check.cancelling[:MOST_PAIRS])
        lines.append(f"not detected if off together, in tolerances, likewise with both signs changed: {'; '.join(pairs)}")
    return lines


def _together(one: CancellingPair) -> str:
    return " with ".join(f"{_short(name)} {size:+.2g}" for name, size in zip(one.variables, one.tolerances, strict=True))


def _short(variable: str) -> str:
    return variable.removeprefix("probe.")


def _sized(variable: str, size: float) -> str:
    """Return a deviation of a variable, SI, as text in its unit."""
    if variable.endswith("poisson_ratio"):
        return f"{size:.2g}"
    return modulus_text(float(f"{size:.2g}")) if variable.endswith("modulus") else f"{1e3 * size:.2g} mm"


def _in_units(one: Explanation) -> tuple[str, str, str]:
    value = one.nominal + one.change
    if one.variable in ("relative gain", "reference.youngs_modulus"):
        return "1", f"{value:.5g}", f"{one.uncertainty:.2g}"
    if one.variable.endswith("poisson_ratio"):
        return f"{one.nominal:.4g}", f"{value:.4g}", f"{one.uncertainty:.2g}"
    scale, unit = (1e-3, "kPa") if one.variable.endswith("modulus") else (1e3, "mm")
    return f"{scale * one.nominal:.5g} {unit}", f"{scale * value:.5g}", f"{scale * one.uncertainty:.2g}"


def _stress(reading: Read, film: str) -> tuple[str, float | None, float | None, float | None, float | None]:
    key = f"stress_{film}"
    read, spread, predicted, z = (getattr(reading, name) for name in (key, f"{key}_uncertainty", f"predicted_{key}", f"z_{key}"))
    return f"stress {film}, Pa", read, spread, predicted, z


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}g}"


def _columns(table: Table, first: str, *others: str) -> None:
    table.add_column(first, no_wrap=True)
    for heading in others:
        table.add_column(heading, justify="right", no_wrap=True)
