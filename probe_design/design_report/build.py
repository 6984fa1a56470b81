"""Build the report of either kind of optimisation."""

from __future__ import annotations

from probe_design.design_report.population_report import PopulationReport
from probe_design.design_report.tumour_report import TumourReport
from probe_design.design_search.pareto import Front
from probe_design.design_search.population_optimum import PopulationOptimum
from probe_design.design_search.tumour_optimum import TumourOptimum


def build_report(optimum: PopulationOptimum | TumourOptimum, fronts: tuple[Front, ...] = ()) -> PopulationReport | TumourReport:
    """Return the report of an optimum; fronts are those of a design file."""
    return PopulationReport(optimum, fronts) if isinstance(optimum, PopulationOptimum) else TumourReport(optimum)
