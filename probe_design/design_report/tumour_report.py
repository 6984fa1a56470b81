"""Build the report of an optimisation for one tumour read once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from geometry.provenance.block import Provenance
from geometry.scenes.scene import Scene
from probe_design.design_report.report import Report, Writer
from probe_design.design_report.tumour_table import build_comparison_table, build_verified_table, describe_noise
from probe_design.design_search.tumour_optimum import TumourOptimum
from probe_design.reporting.page import Chapter
from probe_design.reporting.scene_sections import build_scene_section
from probe_design.reporting.table import Table


class TumourReport(Report[TumourOptimum]):
    """The report of an optimisation for the target of a scene."""

    def build_table(self) -> Table:
        """See ``Report``."""
        return build_comparison_table(self.optimum)

    @property
    def pictures(self) -> Mapping[str, tuple[str, Writer]]:
        """See ``Report``."""
        return {}

    @property
    def texts(self) -> Mapping[str, Callable[[], str]]:
        """See ``Report``."""
        return {"candidates.csv": lambda: build_verified_table(self.optimum).to_csv()}

    @property
    def provenance(self) -> Provenance:
        """See ``Report``."""
        return self.build_provenance(self.optimum.linear_evaluator)

    @property
    def linear_scene(self) -> tuple[Scene, float | None]:
        """See ``Report``."""
        best = self.optimum.best
        return (best.linear or best).loaded_scene, self.optimum.noise.ratio

    @property
    def cautions(self) -> tuple[str, ...]:
        """See ``Report``."""
        return (*self.optimum.warnings, *map(str, self.optimum.best.result.warnings))

    def build_last_chapters(self) -> tuple[Chapter, ...]:
        """See ``Report``."""
        return (
            Chapter("All verified designs", (build_verified_table(self.optimum),)),
            build_scene_section(self.optimum.design.scene, "What was asked"),
        )

    def list_notes(self) -> Iterator[str]:
        """See ``Report``."""
        optimum = self.optimum
        yield (
            f"Standard deviations hold for {describe_noise(optimum)}. A star marks a limit that the design lies on. The search "
            f"used the closed form; {optimum.linear_evaluator} verified. A gain counts only where it is beyond the errors of "
            f"both designs: those of the log-sensitivity and the ratio by {optimum.linear_evaluator}, and what finite strain "
            "changes of both at the force. That is the least of what the scene's load gives on each design, the force at which "
            "finite strain changes the ratio by 1 %, and 1/20 of the force that closes the gap in linear elasticity; design.toml "
            "has it as its load. Lengths are rounded to 0.01 mm and moduli to three digits before they are verified: this table "
            "is the probe as it is drawn."
        )
        if any(design.linear is not None for design in (optimum.best, optimum.start)):
            yield (
                "The scene's load is more than linear elasticity answers for: contact verified the designs under the best of all "
                "loads up to it, as far as half an outer radius deep, with nine tenths of the load that closes the gap at most; "
                "then a gain counts beyond twice its error. Maps, sensitivities and stresses below are those of the largest load "
                "that linear elasticity answers for."
            )
        yield (
            "A standard deviation of ln E_object of 1 means that the stiffness is known to a factor of 2.7; well above 1 it "
            "cannot be determined from one reading, however good the design (a tumour a hundred times stiffer than its tissue "
            "hardly feels different from a rigid one)."
        )
