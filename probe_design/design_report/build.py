"""Build the report of either kind of optimisation."""

from __future__ import annotations

from probe_design.design_report.population_report import build_population_report
from probe_design.design_report.report import Report
from probe_design.design_report.tumour_report import build_tumour_report
from probe_design.design_search.optimum import PopulationOptimum, TumourOptimum
from probe_design.design_search.pareto import Front


def build_report(optimum: PopulationOptimum | TumourOptimum, fronts: tuple[Front, ...] = ()) -> Report:
    """Return the report of an optimum; fronts are those of a design file."""
    if isinstance(optimum, PopulationOptimum):
        return build_population_report(optimum, fronts)
    return build_tumour_report(optimum)
