"""Build the sections of a report about a scene, for any command: shape, plan, loads, curve, maps, sensitivities and stresses.

Where a result is not available the section contains the text of the refusal.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from geometry.common.errors import ProbeError
from geometry.common.limits import format_maximum
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_toml
from geometry.scenes.variables import list_values
from probe_design.maps.detectability import detectability
from probe_design.maps.sphere_effects import Thresholds
from probe_design.maps.target_grid import choose_sizes
from probe_design.reporting.bodies import build_bodies
from probe_design.reporting.curve_figures import draw_curve
from probe_design.reporting.detectability_figure import draw_detectability
from probe_design.reporting.page import Chapter, Code, Part, Picture, Text, TurningView
from probe_design.reporting.stresses import draw_stress_figure
from probe_design.reporting.table import Table
from solver import plan
from solver.automatic import state_accuracy
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.gradients import Gradients, compute_gradients
from solver.axisymmetric.sections import build_sections
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.gradients import compute_tumour_gradients, solve_first_order
from solver.results.evaluator import ProgressCallback, ignore_progress

MAP_POINTS, CURVE_POINTS = 12, 13  # points on each side of a map, and on a curve
MAX_SHOWN_EFFECT = 1e3  # relative; a plan states 1e9 for effects that it does not know
NUMBER_ACCURACY, DRAWING_ACCURACY = 0.01, 0.02  # relative accuracy of printed numbers, and of pictures


def iterate_scene_sections(scene: Scene, noise: float | None, progress: ProgressCallback = ignore_progress) -> Iterator[Chapter]:
    """Yield the sections of a report about a scene at its load; each takes up to some seconds.

    Parameters
    ----------
    scene
        Subject of the report.
    noise
        Relative standard deviation of one reading of the ratio; None leaves out the maps that depend on it.
    progress
        Called with a line before each long piece of work.
    """
    for title, build in (
        ("The probe", _build_shape),
        ("The plan: what is modelled, and what is left out", _build_plan),
        ("Allowed loads", _build_loads),
        ("Ratio over the tumour's stiffness", _build_curve),
        *(
            (("Tumours detected, and tumours whose stiffness is resolved", partial(_build_map, noise=noise)),)
            if noise is not None
            else ()
        ),
        ("Sensitivity to each dimension", _build_sensitivities),
        ("Stresses", _build_stresses),
    ):
        progress(f"for the report: {title[0].lower()}{title[1:]}")
        try:
            parts = tuple(build(scene))
        except ProbeError as refusal:
            parts = (Text(f"Not available: {refusal}"),)
        yield Chapter(title, parts)


def build_scene_section(scene: Scene, title: str = "The scene") -> Chapter:
    """Build the section that contains a scene file."""
    return Chapter(title, (Code(scene_to_toml(scene)),))


def _build_shape(scene: Scene) -> Iterator[Part]:
    """Build the rotating view of the probe and its tumours."""
    yield TurningView(
        build_bodies(scene), "The probe with a quarter left out, above its tumours, all to scale; the tissue is not shown."
    )


def _build_plan(scene: Scene) -> Iterator[Part]:
    """Build the table of modelled and neglected features."""
    scene_plan = plan(state_accuracy(scene))
    rows = tuple(
        (decision.feature, "yes" if decision.modelled else "no", _format_effect(decision.effect), decision.reason)
        for decision in scene_plan.decisions
    )
    evaluator = (
        f"Evaluated by {scene_plan.evaluator}: {scene_plan.dimension}" if scene_plan.evaluator else "No evaluator takes it"
    )
    yield Text(f"{evaluator}. Effects are relative changes of the ratio.")
    yield Table(("feature", "modelled", "effect", "reason"), rows)


def _format_effect(effect: float) -> str:
    """Return a relative effect as text; those that stand for "unknown" are beyond all others."""
    return format_percent(effect) if effect < MAX_SHOWN_EFFECT else "unknown"


def _build_loads(scene: Scene) -> Iterator[Part]:
    """Build the table of the scene's load and of the loads that limits allow."""
    rows = [
        (item.question, format_maximum(item.force, 3), format_maximum(1e3 * item.indentation, 3), item.by, item.basis_text)
        for item in plan(scene, NUMBER_ACCURACY).load_limits.available_limits
    ]
    load = scene.load
    force, indentation = (
        "-" if item is None else f"{size * item:.3g}" for item, size in ((load.force, 1.0), (load.indentation, 1e3))
    )
    yield Table(("load", "force, N", "indentation, mm", "limited by", "known"), (("here", force, indentation, "-", "-"), *rows))
    yield Text(
        "These limits hold for the tumours of this scene. Higher loads need the evaluator contact: "
        "probe-design load draws ratio and walls against force. Curve, maps, sensitivities and stresses below are those of "
        "linear elasticity, which holds for small loads."
    )


def _build_curve(scene: Scene) -> Iterator[Part]:
    """Draw ratio and log-sensitivity over the modulus of the tumour."""
    moduli = np.geomspace(1e3, 1e6, CURVE_POINTS)
    curve = _choose_evaluator(scene).curve(scene, moduli, NUMBER_ACCURACY)
    body = scene.inclusion[scene.target or 0]
    figure = draw_curve(curve, body.youngs_modulus, scene.tissue.find_material(body.depth).youngs_modulus)
    yield Picture.from_figure(figure, "ratio and log-sensitivity against the Young's modulus of the inclusion")


def _build_map(scene: Scene, noise: float) -> Iterator[Part]:
    """Draw maps of tumours detected and of tumours whose stiffness is resolved over diameter and depth, with their warnings."""
    depths, diameters = choose_sizes(scene, MAP_POINTS)
    tumour_map = detectability(scene, depths, diameters, Thresholds(noise), accuracy=DRAWING_ACCURACY, linear=True)
    caption = "maps over diameter and depth: change of the ratio, standard deviation of ln E_object"
    yield Picture.from_figure(draw_detectability(tumour_map, scene), caption)
    for text in tumour_map.warnings:
        yield Text(f"{text}.")


def _build_sensitivities(scene: Scene) -> Iterator[Part]:
    """Build the table of the changes of ratio, stiffness and log-sensitivity by 1 % more of each number of the scene."""
    derivatives = _compute_gradients(scene)
    rows = tuple(_build_sensitivity_row(scene, derivatives, k) for k in range(len(derivatives.variables)))
    yield Text("Change of ratio and stiffness in per cent, and of the log-sensitivity, for an increase of each number by 1 %.")
    yield Table(("1 % more of", "ratio, %", "stiffness, %", "log-sensitivity"), rows)


def _compute_gradients(scene: Scene) -> Gradients:
    """Compute the derivatives with respect to every number: exact on the axis, to first order in the tumours' fields off it."""
    evaluator = _choose_evaluator(scene)
    if isinstance(evaluator, Axisymmetric):
        return compute_gradients(scene, evaluator.compute_converged(scene, NUMBER_ACCURACY).sample)

    evaluator.check(scene)
    return compute_tumour_gradients(scene, solve_first_order(scene, build_sections(scene)), tuple(list_values(scene)))


def _choose_evaluator(scene: Scene) -> Axisymmetric | EquivalentInclusion:
    """Return the evaluator for the pictures of a report; it is linear, whatever the load."""
    return Axisymmetric() if Axisymmetric().refusal(scene) is None else EquivalentInclusion()


def _build_sensitivity_row(scene: Scene, derivatives: Gradients, k: int) -> tuple[str, ...]:
    """Build the row of number ``k`` in the table of sensitivities."""
    name = derivatives.variables[k]
    size = list_values(scene)[name]
    # for 1 % more: ratio and stiffness change by derivative * size / value in per cent, the log-sensitivity by itself
    changes = (
        derivatives.derivatives[output][0, k] * size / (100 if output == "log_sensitivity" else derivatives.values[output][0])
        for output in ("ratio", "stiffness", "log_sensitivity")
    )
    return name, *(f"{change:.3g}" if change else "0" for change in changes)  # no -0


def _build_stresses(scene: Scene) -> Iterator[Part]:
    """Draw the vertical pressure in the meridian plane, without the tumours if these are not on the probe's axis."""
    axisymmetric_scene = scene.model_copy(update={"inclusion": ()}) if Axisymmetric().refusal(scene) is not None else scene
    states = Axisymmetric().compute_converged(axisymmetric_scene, NUMBER_ACCURACY).sample.states
    yield Picture.from_figure(
        draw_stress_figure(states, axisymmetric_scene), "vertical pressure in the meridian plane under the load"
    )
    if axisymmetric_scene is not scene:
        yield Text("Without the tumours, which are off the probe's axis.")
