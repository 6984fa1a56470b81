"""The command `optimize`: search a better probe for the tumours of a design file or for the tumour of a scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from geometry.common.errors import InputError, Words
from geometry.common.files import check_writable
from geometry.common.json_types import JsonMapping
from geometry.provenance.block import DISTRIBUTION, compute_digest
from geometry.scenes.quantities import Length
from geometry.scenes.scene import Scene
from probe_design.commands.fields import Force, LimitedRequest, Noise
from probe_design.commands.output import print_json, report_assumed_sizes
from probe_design.commands.request import Option, use_request
from probe_design.data.noise import DEFAULT_NOISE
from probe_design.terminal.console import show_stages, show_table, warn, write_message

if TYPE_CHECKING:
    from probe_design.design_search.optimum import PopulationOptimum, TumourOptimum
    from probe_design.populations.design_file import Design, DesignSource

SCENE_OPTIONS = ("outer_radius", "starts", "evaluator", "noise")  # a design file states these by its own keys
IGNORED_FIELDS = {
    "scene", "output", "force", "template", "pareto", "as_json", "quiet", "time", "memory",
}  # fmt: skip  # results do not depend on these
Stages = Callable[[str, int, int], None]


class OptimizeRequest(LimitedRequest):
    """Find a better probe for a DESIGN file's tumours or for a SCENE's tumour, verify it by finite elements, and export it.

    A DESIGN file (--template prints one) describes the tumours and their tissue, the readings and their noise, the limits, and
    the design variables: dimensions, moduli, materials that can be bought. The probe that detects most of
    them, or resolves most, is searched by formulas, refined and verified by finite elements on tumours that were not used in
    the search. Without a file, a built-in design file is used, which starts at the paper's probe. Every result states the
    probability of detection by the ratio alone, by the stiffness alone and by both. A gain counts if it is above twice its error.
    If there is none, the initial design is exported, and the exit code is 1.

    For a SCENE the standard deviation of ln E_object of its one tumour is improved. The search varies inner radius, A2/A1,
    gap, height and both moduli by formulas; the ten best designs are verified by finite elements, the best three of them
    refined with exact derivatives. A gain counts if it is above what the errors of both designs can cause.

    \b
    Limits for a SCENE, each extended to the initial design if that lies outside:
      outer radius   --outer-radius, and 0.95 of the tissue's radius or half-width
      inner radius   0.5 mm or more, and 0.55 groove widths
      wall           0.5 mm or more, of the outer block
      A2/A1          0.05 to 20
      gap            0.1 mm to 0.5 mm
      height         1 mm to 20 mm, and 1.25 groove depths
      moduli         10 kPa to 1 MPa, of each block

    SCENE's load is an upper limit. In the search each design has the largest load that is within this limit, changes the ratio by
    at most 1 % through finite strain, and is at most 1/20 of the force that closes the gap. Where SCENE's load is above that,
    contact evaluates the initial design and the candidates under the best load up to it, with an open gap and up to half an
    outer radius deep. The table lists the active limits, the limit of the force, and the effect of more
    load.
    """  # noqa: D301

    scene: Annotated[Path | None, Option("File of a design or scene.", is_argument=True, metavar="[SCENE | DESIGN]")] = None
    output: Annotated[Path | str | None, Option("Folder for the design, STEP files and report.", "-o/--output")] = None
    template: Annotated[bool, Option("Print a design file with every key, its default and its meaning, and exit.")] = False
    pareto: Annotated[
        tuple[Literal["outer_radius", "force", "positions"], ...],
        Option("With a DESIGN file: compute how the objective improves as this limit grows; may be repeated."),
    ] = ()
    outer_radius: Annotated[
        Length | None,
        Option("Limit of the probe's outer radius, such as '8 mm'.", left_out="1.4 times the start's"),
    ] = None
    starts: Annotated[int, Field(ge=1, le=100), Option("Local searches for a SCENE.")] = 8
    evaluator: Annotated[
        str | None,
        Option(
            "Verifies and refines: axisymmetric or equivalent-inclusion.",
            left_out="chosen by the scene",
            words=("axisymmetric", "equivalent-inclusion"),
        ),
    ] = None
    noise: Noise = DEFAULT_NOISE
    force: Force = False

    def run(self) -> None:
        """Print the template, or check the options and optimise for a design file or a scene."""
        from probe_design.populations.design_file import Design, read_design_source

        if self.template:
            from probe_design.populations.template import build_design_template

            print(build_design_template(), end="")
            return
        if self.output is None:
            raise InputError("output", Words("missing"), "-o DIR, the folder for the design, its parts and the report")
        question, folder = read_design_source(self.scene), Path(self.output)
        settings = {key: getattr(self, key) for key in SCENE_OPTIONS}
        if isinstance(question, Design):
            settings = {}
            given = (key for key in SCENE_OPTIONS if key in self.model_fields_set)
            refuse_options({key.replace("_", "-"): getattr(self, key) for key in given})
        elif self.pareto:
            raise InputError("pareto", ", ".join(self.pareto), "none for a scene: fronts are a design file's")
        self._optimize(question, folder, settings)

    def _optimize(self, question: Scene | Design, folder: Path, settings: JsonMapping) -> None:
        """Search, verify, write the files and report; exit with 1 where no gain counts.

        Parameters
        ----------
        question
            The initial scene, or the design with its tumours.
        folder
            For the files.
        settings
            Values of ``SCENE_OPTIONS`` for a scene; empty for a design.
        """
        from probe_design.design_report.build import build_report
        from probe_design.design_search.pareto import compute_front
        from probe_design.populations.design_file import Design
        from probe_design.reporting.workshop_command import build_evaluate_command, build_export_command
        from probe_design.workshop.package import list_missing_films

        question_digest, fronts = self._check_output(question, folder), []
        with show_stages() as progress:
            optimum = _run_search(question, progress, settings)
            if isinstance(question, Design):
                fronts = [compute_front(question, cost, partial(progress, f"front: {cost}")) for cost in self.pareto]
            report = build_report(optimum, tuple(fronts))
            files = report.write(folder, progress, force=self.force, question_digest=question_digest)
        if self.as_json:
            print_json(report.build_summary(files))
        else:
            show_table(report.table)
            report_assumed_sizes(optimum.scene.probe)
            warn(list_missing_films(optimum.scene.probe))
            for message in report.messages:
                write_message(message)
            write_message(f"wrote {len(files)} files to {folder}; begin with {folder / 'report.html'}")
            write_message(f"for the workshop: {build_export_command(folder)}")
            write_message(f"its reading: {build_evaluate_command(folder)}")
        warn(optimum.warnings)
        write_message(optimum.verdict)
        for sentence in report.advice:
            (write_message if self.as_json else print)(sentence)
        if optimum.status == "no-gain":
            raise SystemExit(1)

    def _check_output(self, start: Scene | Design, folder: Path) -> str:
        """Check the output folder and CAD before the search rather than after it; return the digest of the question.

        It is computed from the scene or design and every option on which the result depends. A folder that holds the result of
        another question is refused.
        """
        from importlib.metadata import version

        from geometry.cad.parts_record import check_same_question
        from geometry.cad.solids import load_cadquery

        tables, options = (model.model_dump(mode="json", exclude_none=True) for model in (start, self))
        settings = {key: value for key, value in options.items() if key not in IGNORED_FIELDS}
        question_digest = compute_digest({"asked": tables, "version": version(DISTRIBUTION), **settings})
        check_writable(folder)
        if not self.force:
            check_same_question(folder, question_digest)
        load_cadquery()
        return question_digest


@use_request(OptimizeRequest)
def optimize(
    design: DesignSource = None, *, output: Path | str | None = None, outer_radius: float | None = None,
    starts: int = 8, evaluator: str | None = None, noise: float = DEFAULT_NOISE, force: bool = False,
    progress: Stages | None = None,
) -> PopulationOptimum | TumourOptimum:  # fmt: skip
    """Find a better probe for the tumours of a design file or for the tumour of a scene, and verify it by finite elements.

    The load of a scene is an upper limit. Where it is beyond linear elasticity, ``contact`` evaluates each design under the best
    load up to that limit. A design file states by its own keys what ``outer_radius`` to ``noise`` state for a scene.

    Parameters
    ----------
    design : Design, mapping, Scene, or the name of a file; default: the built-in design file
        Design, the tables of a design file, or the initial scene.
    progress : callable, optional
        Called with the name of a stage, the number of steps done and their total.

    Returns
    -------
    PopulationOptimum or TumourOptimum
        The initial design, all verified designs and the best; ``status`` states whether there is a gain.

    Raises
    ------
    InputError
        No target, a load of 0, no allowed design, no such evaluator; or ``output`` holds another design.
    Refusal
        The closed form or the verifying evaluator cannot model the scene.
    """
    from probe_design.populations.design_file import read_design_source

    progress, question = progress or ignore_stage, read_design_source(design)
    folder = None if output is None else Path(output)
    if folder is not None:
        check_writable(folder)
    settings = {"outer_radius": outer_radius, "starts": starts, "evaluator": evaluator, "noise": noise}
    if not isinstance(question, Scene):
        settings = {key: value for key, value in settings.items() if value != OptimizeRequest.model_fields[key].default}
        refuse_options(settings)
    optimum = _run_search(question, progress, settings)
    if folder is not None:
        from probe_design.design_report.build import build_report

        build_report(optimum).write(folder, progress, force=force)
    return optimum


def _run_search(question: Scene | Design, progress: Stages, settings: JsonMapping) -> PopulationOptimum | TumourOptimum:
    """Run the search for the tumour of a scene, with ``settings``, or for the tumours of a design, which has its own settings.

    ``progress`` is called with the name of a stage, the number of steps done and their total.
    """
    from probe_design.design_search.population_study import optimize_for_population
    from probe_design.design_search.tumour_study import optimize_for_tumour

    if isinstance(question, Scene):
        return optimize_for_tumour(question, progress, **settings)
    return optimize_for_population(question, progress)


def refuse_options(options: Mapping[str, object]) -> None:
    """Refuse ``options``, by name, if there are any: none of them applies to a design file."""
    for key, value in options.items():  # the first one is reported
        raise InputError(key, value, "none for a design file, whose tables state it")


def ignore_stage(stage: str, done: int, total: int) -> None:
    """Accept a progress report and discard it."""
