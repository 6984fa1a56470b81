"""Build the report of an optimisation for a population: comparison, maps, gains of improvements, fronts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from functools import partial

from geometry.common.json_types import JsonObject
from geometry.provenance.block import Provenance
from geometry.provenance.texts import format_toml_comment
from geometry.scenes.scene_file import scene_to_dict
from probe_design.design_report.depth_map import compute_depth_map
from probe_design.design_report.levers import compute_levers
from probe_design.design_report.pictures import draw_front, draw_levers, draw_maps
from probe_design.design_report.report import Report, Writer
from probe_design.design_report.table import build_table, describe_conditions
from probe_design.design_search.pareto import Front
from probe_design.design_search.population_optimum import PopulationOptimum
from probe_design.populations.design_file import Design
from probe_design.reporting.page import Chapter, Code, Part, Picture, Text
from probe_design.reporting.table import Table

MAPS_FILE, LEVERS_FILE, FRONT_FILE = "maps.png", "levers.png", "pareto.png"
TOLERANCE_NOTE = (
    "The objective by the closed form over 64 draws of what is built: radii and height to 0.05 mm, gap to 0.02 mm, each modulus "
    "to 10 % or to its material's own tolerance, one standard deviation each."
)
LIMITS_NOTE = (
    "linearity and gap_closure are forces, N: up to the first finite strain changes the ratio by at most 1 %, up to the second "
    "the gap stays open, for every tumour and tissue of the population, both with a margin of a tenth. They are lower than those "
    "of the one scene below."
)


class PopulationReport(Report[PopulationOptimum]):
    """The report of an optimisation for a design file's population.

    Parameters
    ----------
    optimum
        The result of the optimisation.
    fronts
        The Pareto fronts.
    """

    def __init__(self, optimum: PopulationOptimum, fronts: tuple[Front, ...] = ()) -> None:
        super().__init__(optimum)
        self.fronts = fronts
        self.maps = {
            name: compute_depth_map(optimum.design, verified.scene, verified.pressed.force)
            for name, verified in optimum.list_columns().items()
        }
        self.levers = compute_levers(optimum.scene, optimum.design)

    def build_table(self) -> Table:
        """See ``Report``."""
        return build_table(self.optimum, self.maps)

    @property
    def pictures(self) -> Mapping[str, tuple[str, Writer]]:
        """See ``Report``."""
        maximise = self.optimum.design.objective.maximise
        pictures: dict[str, tuple[str, Writer]] = {
            MAPS_FILE: (
                "probability and standard deviation of ln contrast over depth and diameter",
                partial(draw_maps, self.maps, self.optimum.list_columns()),
            ),
            LEVERS_FILE: ("the objective after each change of the readings", partial(draw_levers, self.levers, maximise)),
        }
        front = {FRONT_FILE: ("Pareto fronts", partial(draw_front, self.fronts, maximise))} if self.fronts else {}
        return pictures | front

    @property
    def texts(self) -> Mapping[str, Callable[[], str]]:
        """See ``Report``."""
        comment, design = format_toml_comment(self.provenance), self.optimum.design
        return {"question.toml": lambda: comment + write_design_file(design)}

    @property
    def provenance(self) -> Provenance:
        """See ``Report``."""
        return self.build_provenance(self.optimum.best.evaluator, self.optimum.design.population.seed)

    @property
    def additions(self) -> JsonObject:
        """See ``Report``."""
        return {"levers": [asdict(item) for item in self.levers], "pareto": [item.as_dict() for item in self.fronts]}

    @property
    def messages(self) -> tuple[str, ...]:
        """See ``Report``."""
        note = self.optimum.best.judgement.error_note
        return f"search: {self.optimum.search.how}", f"error of the detection: {note}"

    @property
    def limit_notes(self) -> tuple[Text, ...]:
        """See ``Report``."""
        return (Text(LIMITS_NOTE),)

    def build_chapters(self, pictures: Mapping[str, tuple[Picture, ...]]) -> Mapping[str, tuple[Part, ...]]:
        """See ``Report``."""
        tolerances = Table(("design", "as drawn", "expected", "5 % below", "95 % below"), self._list_tolerances())
        return {
            "Which tumours are detected and resolved": pictures[MAPS_FILE],
            "What would help most": pictures[LEVERS_FILE],
            "What more would cost": pictures.get(FRONT_FILE, ()),
            "After the workshop": (Text(TOLERANCE_NOTE), tolerances),
        }

    def build_last_chapters(self) -> tuple[Chapter, ...]:
        """See ``Report``."""
        return (Chapter("What was asked", (Code(write_design_file(self.optimum.design)),)),)

    def list_notes(self) -> Iterator[str]:
        """See ``Report``."""
        optimum = self.optimum
        yield (
            f"{describe_conditions(optimum)}. The sampling error is one standard error, of the tumours drawn and of the "
            "draws of noise; the "
            "model error is a bound on what the evaluator's own errors change. Of the recommended design "
            f"{optimum.best.judgement.error_note}. A gain counts only where it is beyond twice its own error, for which the same "
            f"tumours are read with both probes, under one force for all of them. The search went by formulas: "
            f"{optimum.search.how}."
        )
        if optimum.why_no_single:
            yield f"No design for one tumour: {optimum.why_no_single}."

    def _list_tolerances(self) -> list[tuple[str, ...]]:
        robust = self.optimum.robust
        names = ["start", *(f"design {k + 1}" for k in range(len(robust)))]
        designs = (self.optimum.start, *self.optimum.finalists)
        names[next(k for k, verified in enumerate(designs) if verified is self.optimum.best)] += ", recommended"
        return [
            (name, *(f"{value:.3g}" for value in (item.nominal, item.expected, item.low, item.high)))
            for name, item in zip(names, robust, strict=False)
        ]


def write_design_file(design: Design) -> str:
    """Return the design file with all defaults written out; reading it yields the same design."""
    import tomli_w

    tables = design.model_dump(mode="json", exclude_none=True, exclude={"scene"})
    return tomli_w.dumps(tables | {"scene": scene_to_dict(design.scene)})
