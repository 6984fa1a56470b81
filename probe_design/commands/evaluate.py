"""The commands `evaluate`, `plan`, `curve` and `tolerances`, which take one scene."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from geometry.common.errors import InputError
from geometry.scenes.quantities import Modulus
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import load_scene
from geometry.scenes.units import format_modulus
from probe_design.commands.fields import (
    NO_ACCURACY,
    Accuracy,
    Fraction,
    Frequency,
    LimitedRequest,
    Linear,
    Loads,
    Picture,
    SceneSource,
)
from probe_design.commands.output import present, split_assignments
from probe_design.commands.request import Option, use_request
from probe_design.terminal.console import show_spinner, show_steps

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from probe_design.tolerancing.budget import ToleranceBudget
    from solver import Curve

EVALUATOR_NAMES = ("auto", "published", "closed-form", "equivalent-inclusion", "axisymmetric", "contact", "solid")


class EvaluateRequest(LimitedRequest):
    """Compute the film stresses, their ratio and its sensitivity to the tumour's modulus.

    \b
    published             the paper's equations as printed: an equivalent modulus, no stresses
    closed-form           formulas, milliseconds, 1 to 30 %: spheres anywhere
    equivalent-inclusion  finite elements and scattering, 0.3 to 5 s, 1e-2 to 1e-3: tumours anywhere
    axisymmetric          finite elements, 0.1 to 10 s, 1e-2 to 1e-4: one sphere on the probe's axis
    contact               finite elements at finite strain, walls in contact, 2 to 20 s, 5e-3 to 2e-2:
                          loads of a hand, tumours anywhere
    solid                 3D finite elements, 10 to 100 s, 1e-2 to 3e-3: groove, edges, tilt, tumours
                          of any shape, from STL and STEP files too
    auto                  chosen by plan: the cheapest of the last four that can model the scene
                          and reaches --accuracy; refuses where none does

    All but contact are exact for small loads. Beyond linear_limit_load a named evaluator warns; auto uses contact if that can
    model the scene, and refuses if not. With --linear, error_estimate counts the possible effect of finite strain instead.
    """  # noqa: D301

    scene: SceneSource
    evaluator: Annotated[str, Option(f"Model to use: {', '.join(EVALUATOR_NAMES)}.", words=EVALUATOR_NAMES)] = "auto"
    accuracy: Accuracy = None
    linear: Linear = False
    loads: Loads = False
    frequency: Annotated[
        Frequency | None, Option('Frequency of the load, "5 Hz": compute the phase of the ratio by loss factors.')
    ] = None
    vtu: Annotated[Path | None, Option("With solid: write mesh, displacements and stresses for ParaView.")] = None
    picture: Annotated[Picture, Option("With solid: draw mesh and stresses to this .png file.", "--plot")] = None

    def run(self) -> None:
        """Evaluate the scene, and draw the solution where this is requested."""
        from probe_design.terminal.result_tables import build_result_table, list_reading_lines

        with show_steps(f"evaluating {self.scene}") as progress:
            scene = load_scene(self.scene)
            if self.vtu is not None or self.picture is not None:
                from probe_design.solid_output.evaluate_with_files import evaluate_with_files
                from solver.evaluation import add_phase
                from solver.evaluators import choose_accuracy

                accuracy = choose_accuracy(scene, self.accuracy)
                result = self.call(evaluate_with_files, scene=scene, accuracy=accuracy, progress=progress)
                result = result if self.frequency is None else add_phase(result, scene, accuracy, self.frequency)
            else:
                from solver import evaluate

                result = self.call(evaluate, scene=scene, progress=progress)
        present(result, build_result_table, self.as_json, lines=list_reading_lines)


class PlanRequest(LimitedRequest):
    """Report which model of SCENE reaches --accuracy at the lowest cost, which features it neglects, and the reasons.

    evaluate without --evaluator does the same: where it refuses, so does plan (exit code 2). Every feature that may be neglected
    is listed with its effect on the ratio, on the stresses and on the stiffness. Nonlinear effects are bounded at the scene's
    load, and the largest load for which auto uses a linear evaluator is printed. The evaluator has been run and reaches the
    accuracy; solid is not run where its accuracy is certain without.
    """

    scene: SceneSource
    accuracy: Accuracy = None
    loads: Loads = False

    def run(self) -> None:
        """Print the plan, then refuse where no evaluator reaches the accuracy."""
        from probe_design.terminal.result_tables import build_plan_table, list_plan_lines
        from solver import plan

        with show_spinner(f"planning {self.scene}"):
            result = self.call(plan)
        present(result, build_plan_table, self.as_json, lines=list_plan_lines)
        if result.refusal is not None:
            raise result.refusal


class CurveRequest(LimitedRequest):
    """Compute how ratio and log-sensitivity depend on the inclusion's Young's modulus.

    With one sphere on the probe's axis all moduli follow exactly from one factorisation, so that a thousand take as long as ten.
    With tumours elsewhere each modulus takes some 10 to 100 ms.
    """

    scene: SceneSource
    low: Annotated[Modulus, Option("Smallest Young's modulus of the inclusion.", "--from")] = 1e3
    high: Annotated[Modulus, Option("Largest Young's modulus of the inclusion.", "--to")] = 1e6
    points: Annotated[int, Field(ge=2, le=100_000), Option("Moduli, evenly on a logarithmic scale.")] = 50
    accuracy: Annotated[Accuracy, Option("Relative error that the ratio may have at every modulus.", left_out=NO_ACCURACY)] = None
    linear: Linear = False
    picture: Annotated[Picture, Option("Draw the curve to this .png, .svg or .pdf file.", "--plot")] = None

    def run(self) -> None:
        """Compute the curve at moduli that are evenly spaced on a logarithmic scale and contain both ends exactly."""
        import numpy as np

        from probe_design.terminal.result_tables import build_curve_table
        from solver import curve

        if not self.low < self.high:
            raise InputError("to", format_modulus(self.high), f"a modulus above from = {format_modulus(self.low)!r}")
        scene = load_scene(self.scene)
        moduli = np.geomspace(self.low, self.high, self.points)
        moduli[0], moduli[-1] = self.low, self.high  # free of rounding
        with show_steps(f"curve of {self.scene}") as progress:
            result = self.call(curve, scene=scene, moduli=moduli, progress=progress)
        present(result, build_curve_table, self.as_json, self.picture, draw=partial(_draw_curve, scene=scene))


def _draw_curve(curve: Curve, scene: Scene) -> Figure:
    """Draw a curve, with the moduli of the scene's target and of the tissue around it."""
    from probe_design.reporting.curve_figures import draw_curve

    body = scene.inclusion[scene.target or 0]
    return draw_curve(curve, body.youngs_modulus, scene.tissue.find_material(body.depth).youngs_modulus)


class TolerancesRequest(LimitedRequest):
    """Compute how manufacturing tolerances of SCENE's probe change its ratio, and which tolerances --ratio requires.

    Radii and heights have the tolerances of casting or machining, moduli those of the catalogue for a named material, gains 5 %;
    or those of --bench, --tolerance and --material. To first order by derivatives at SCENE's load, and by samples.
    """

    scene: SceneSource
    ratio: Annotated[Fraction, Option("Allowed relative standard deviation of the ratio.")] = 0.01
    tolerance: Annotated[tuple[str, ...], Option('A standard deviation: "probe.gap = 10 um", 5 % of a modulus or gain.')] = ()
    material: Annotated[tuple[str, ...], Option("Material of a block, inner=dragon-skin-30: sets the sd of its modulus.")] = ()
    bench: Annotated[Path | None, Option("TOML file whose [workshop] and [channels] replace the built-in ones.")] = None
    samples: Annotated[int, Field(ge=64, le=65_536), Option("Samples for the Sobol indices: a power of 2.")] = 1024
    picture: Annotated[Picture, Option("Draw the budget to this .png, .svg or .pdf file.", "--plot")] = None

    def run(self) -> None:
        """Compute the budget of uncertainties, and print it."""
        from probe_design.terminal.workshop_tables import build_tolerance_table, write_tolerance_lines

        scene = load_scene(self.scene)
        stated_sds = split_assignments("tolerance", self.tolerance, "'probe.gap = 10 um'")
        materials = split_assignments("material", self.material, "'inner=dragon-skin-30'")
        with show_spinner(f"tolerances of {self.scene}"):
            budget = self.call(tolerances, scene=scene, materials=materials, sds=stated_sds)
        present(budget, build_tolerance_table, self.as_json, self.picture, lines=write_tolerance_lines, draw=_draw_budget)


@use_request(TolerancesRequest)
def tolerances(
    scene: Scene | Path | str, *, ratio: float = 0.01, sds: Mapping[str, object] = MappingProxyType({}),
    materials: Mapping[str, str] = MappingProxyType({}), bench: Path | str | None = None, samples: int = 1024,
) -> ToleranceBudget:  # fmt: skip
    """Compute how manufacturing tolerances of a scene's probe change its ratio, and which tolerances a given scatter requires.

    Beyond linear elasticity results and derivatives are those of ``contact``.

    Parameters
    ----------
    sds : mapping of str to str or float
        Standard deviations that differ from the workshop's: ``{"probe.gap": "10 um"}``, or numbers in SI units.
    materials : mapping of str to str
        Materials of the blocks, ``{"inner": "dragon-skin-30"}``: set the scatter of their moduli.

    Returns
    -------
    ToleranceBudget
        Scatter of each output, and what each uncertain number contributes; ``to_frame()`` lists the numbers.

    Raises
    ------
    InputError
        A name is unknown or a number not allowed.
    Refusal
        Neither ``axisymmetric`` nor ``equivalent-inclusion`` models the scene, ``contact`` does not reach its load, or a film is
        not pressed.

    Examples
    --------
    >>> from probe_design import tolerances
    >>> tolerances("examples/scene.toml").to_frame()  # doctest: +SKIP
    """
    from probe_design.built_probe.bench import read_bench
    from probe_design.tolerancing.budget import compute_budget

    read = None if bench is None else read_bench(bench)
    return compute_budget(load_scene(scene), ratio, bench=read, materials=materials, given=sds, samples=samples)


def _draw_budget(budget: ToleranceBudget) -> Figure:
    """Draw a budget of uncertainties."""
    from probe_design.tolerancing.plot import draw_budget

    return draw_budget(budget)
