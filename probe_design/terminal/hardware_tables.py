"""Build tables of readings, calibrations, checks and the findings of `doctor`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from geometry.common.errors import to_one_line
from geometry.common.percent import format_percent
from geometry.scenes.units import MM_PER_M, format_modulus
from geometry.scenes.variables import PIEZO_KEYS
from probe_design.built_probe.calibration_record import CalibrationRecord
from probe_design.built_probe.reading import StressReading
from probe_design.doctor.finding import Finding
from probe_design.probe_check.check import Check
from probe_design.probe_check.deviation import CancellingPair
from probe_design.probe_check.explanations import Explanation
from probe_design.reporting.table import Table, format_number

MAX_EXPLANATIONS = 6  # explanations shown
MAX_PAIRS = 3


def build_reading_table(reading: StressReading) -> Table:
    """Return a reading as a table: measured, predicted, and their difference z in standard deviations."""
    title = f"{reading.cycles:.4g} cycles of {reading.frequency:.5g} Hz; predicted by {reading.evaluator}"
    title += "; ratio of charges" if reading.observable == "charge" else ""
    quantities = {
        "ratio": "ratio",
        "ratio_phase": "phase of the ratio, rad",
        "stress_inner": "stress inner, Pa",
        "stress_outer": "stress outer, Pa",
    }
    rows = [
        (label, *(getattr(reading, name) for name in (key, f"{key}_uncertainty", f"predicted_{key}", f"z_{key}")))
        for key, label in quantities.items()
    ]
    rows.append(("force on both films, N", reading.force, reading.force_uncertainty, reading.reference_force, None))
    cells = [(label, *_format_numbers(values, (5, 2, 5, 2))) for label, *values in rows]
    return Table(("quantity", "read", "sd", "predicted", "z"), cells, title)


def build_calibration_table(record: CalibrationRecord) -> Table:
    """Return the gain matrix and the offsets as a table, with their standard deviations."""
    scale = "absolute" if record.absolute else "relative: the outer gain is the unit"
    fit = f"chi-square {record.chi_square:.3g} for {record.degrees_of_freedom} degrees of freedom"
    title = f"{len(record.reading)} references at {record.frequency:.5g} Hz; gains {scale}; {fit}"
    rows = [(name, f"{value:.5g}", f"{sd:.2g}") for name, value, sd in record.list_gains()]
    rows += [
        (f"offset {name}, mV", f"{1e3 * value:.4g}", f"{1e3 * sd:.2g}")
        for name, value, sd in zip(("inner", "outer"), record.offsets, record.offsets_sd, strict=True)
    ]
    return Table(("quantity", "value", "sd"), rows, title)


def build_doctor_table(findings: Sequence[Finding], versions: dict[str, str | None]) -> Table:
    """Return findings as a table, one row each, with the versions below."""
    names = ", ".join(f"{name} {number}" for name, number in versions.items() if number is not None)
    rows = [(to_one_line(finding.name), finding.state, to_one_line(finding.text)) for finding in findings]
    return Table(("what", "state", "found"), rows, caption=names, left=(0, 1, 2))


def list_findings(findings: Sequence[Finding]) -> list[str]:
    """Return a line of the findings that are faults, one of those that are doubtful, and a line for each remedy."""
    lines = []
    for state, heading in (("fault", "at fault"), ("doubtful", "doubtful")):
        names = ", ".join(finding.name for finding in findings if finding.state == state)
        lines.append(f"{heading}: {names or 'nothing'}")
    remedies = [f"{finding.name}: {finding.remedy}" for finding in findings if finding.state != "good" and finding.remedy]
    return lines + remedies


def build_check_table(check: Check) -> Table:
    """Return the ratios of all blocks as a table: measured, predicted, and their difference z."""
    fit = f"chi-square {check.chi_square:.4g} for {check.degrees_of_freedom} degrees of freedom, p = {check.p_value:.2g}"
    rows = [
        (
            block.name,
            *_format_numbers(
                (block.ratio, block.ratio_uncertainty, block.predicted, block.predicted_uncertainty, block.z), (5, 2, 5, 2, 2)
            ),
        )
        for block in check.blocks
    ]
    title = f"{check.verdict}: {fit} (fails below {check.level:g})"
    return Table(("reference", "ratio read", "sd", "predicted", "sd", "z"), rows, title)


def build_explanations_table(check: Check) -> Table:
    """Return a table of the variables that would explain a deviation by themselves, the best first."""
    rows = [
        (_shorten(explanation.variable), *_format_explanation(explanation), f"{explanation.chi_square:.3g}")
        for explanation in check.explanations[:MAX_EXPLANATIONS]
    ]
    return Table(("variable", "drawn", "would be", "sd", "chi2 left"), rows, "which one variable would explain it")


def build_pairs_table(check: Check) -> Table:
    """Return a table of the pairs of variables that would explain a deviation together, the best first."""
    rows = [
        (_shorten(explanation.variable), *_format_explanation(explanation), chi_square_text)
        for pair in check.pairs[:MAX_PAIRS]
        for explanation, chi_square_text in ((pair.first, f"{pair.chi_square:.3g}"), (pair.second, ""))
    ]
    return Table(("variables", "drawn", "would be", "sd", "chi2 left"), rows, "which two would explain it together")


def build_coverage_table(check: Check) -> Table:
    """Return a table of the variables that the check has tested, and the deviation from which each would be detected."""
    title = "what was tested: a variable of which a deviation by five tolerances is detected in 1 of 2 cases or more"
    headings = ("variable", "tolerance, 1 sd", "five change a ratio by", "detected", "detected 1 in 2 from", "tested")
    rows = []
    for row in (*check.tested, *check.untested):
        detected_from = "nowhere" if row.found_from is None else _format_size(row.variable, row.found_from)
        effect, power = format_percent(row.effect), f"{100 * row.power:.0f} %"
        tolerance = _format_size(row.variable, row.tolerance)
        rows.append((_shorten(row.variable), tolerance, effect, power, detected_from, "yes" if row.tested else "no"))
    return Table(headings, rows, title)


def list_check_tables(check: Check) -> list[Table]:
    """Return the tables of a check: ratios, what would explain a deviation, and what was tested."""
    explanations = [build_explanations_table(check)] if check.alike else []
    pairs = [build_pairs_table(check)] if check.pairs else []
    return [build_check_table(check), *explanations, *pairs, build_coverage_table(check)]


def write_sentences(check: Check) -> list[str]:
    """Return the verdict of a check, the variables tested, and those not tested with the reasons, one line each."""
    lines = [f"{check.verdict}: {check.reason}"] if check.reason else []
    if check.tested:
        names = ", ".join(_shorten(row.variable) for row in check.tested)
        count = f"{len(check.tested)} of {len(check.tested) + len(check.untested)} variables"
        lines.append(f"the probe is {check.verdict}: {names} ({count})" if check.passed else f"tested: {names} ({count})")
    for reason in dict.fromkeys(row.reason for row in check.untested):
        names = ", ".join(_shorten(row.variable) for row in check.untested if row.reason == reason)
        lines.append(f"not tested: {names}: {reason}")
    if check.cancelling:
        pairs = (_describe_pair(row) for row in check.cancelling[:MAX_PAIRS])
        lines.append(f"not detected if off together, in tolerances, likewise with both signs changed: {'; '.join(pairs)}")
    return lines


def _describe_pair(pair: CancellingPair) -> str:
    """Describe a pair of variables whose deviations cancel, with the deviations in tolerances."""
    return " with ".join(f"{_shorten(name)} {size:+.2g}" for name, size in zip(pair.variables, pair.tolerances, strict=True))


def _shorten(variable: str) -> str:
    """Return the name of a variable without its prefix."""
    return variable.removeprefix("probe.")


def _format_size(variable: str, size: float, digits: int = 2) -> str:
    """Return a value or a deviation of a variable, given in SI units, as text in the unit of its kind."""
    size = float(f"{size:.{digits}g}")  # rounded here, so that digits behind the first ones are not written as 2.6e+02
    if variable in ("relative gain", "reference.youngs_modulus") or variable.endswith("poisson_ratio"):
        return f"{size:g}"
    if variable.endswith(PIEZO_KEYS):
        return f"{1e12 * size:g} pC/N"
    return format_modulus(size) if variable.endswith("modulus") else f"{MM_PER_M * size:g} mm"


def _format_explanation(explanation: Explanation) -> tuple[str, str, str]:
    """Return the drawn value of a variable, the value that would explain the readings, and its standard deviation."""
    name, value = explanation.variable, explanation.nominal + explanation.change
    return _format_size(name, explanation.nominal, 4), _format_size(name, value, 4), _format_size(name, explanation.uncertainty)


def _format_numbers(values: Iterable[float | None], digits: Iterable[int]) -> Iterator[str]:
    """Format numbers, each with its number of significant digits."""
    return map(format_number, values, digits)
