"""Build the sections of a report about a scene, for any command: shape, plan, loads, curve, maps, sensitivities and stresses.

Where a result is not available the section contains the text of the refusal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from geometry.common.errors import ProbeError
from geometry.common.limits import most
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_toml
from geometry.scenes.variables import values
from probe_design.reports.bodies import bodies
from probe_design.reports.page import Chapter, Code, PageTable, Part, Picture, Text, TurningView
from solver.axisymmetric.gradients import Gradients
from solver.axisymmetric.level import Axisymmetric
from solver.equivalent_inclusion.level import EquivalentInclusion

MAP_POINTS, CURVE_POINTS = 12, 13  # points on each side of a map, and on a curve
ACCURACY, DRAWN = 0.01, 0.02  # relative accuracy of printed numbers, and of pictures
Tell = Callable[[str], None]


def scene_sections(scene: Scene, noise: float | None, tell: Tell = lambda text: None) -> Iterator[Chapter]:
    """Yield the sections of a report about a scene at its load; each takes up to some seconds.

    Args:
        scene: subject of the report.
        noise: relative standard deviation of one reading of the ratio; None leaves out the maps that depend on it.
        tell: called with a line before each long piece of work.
    """
    for title, made in (
        ("The probe", _shape),
        ("The plan: what is modelled, and what is left out", _plan),
        ("Allowed loads", _loads),
        ("Ratio over the tumour's stiffness", _curve),
        *(
            (("Tumours detected, and tumours whose stiffness is resolved", partial(_map, noise=noise)),)
            if noise is not None
            else ()
        ),
        ("Sensitivity to each dimension", _sensitivities),
        ("Stresses", _stresses),
    ):
        tell(f"for the report: {title[0].lower()}{title[1:]}")
        try:
            parts = tuple(made(scene))
        except ProbeError as why:
            parts = (Text(f"Not available: {why}"),)
        yield Chapter(title, parts)


def asked(scene: Scene, title: str = "The scene") -> Chapter:
    """Build the section that contains a scene file."""
    return Chapter(title, (Code(scene_to_toml(scene)),))


def _shape(scene: Scene) -> Iterator[Part]:
    """Build the rotating view of the probe and its tumours."""
    yield TurningView(
        bodies(scene), "The probe with a quarter left out, above its tumours, all to scale; the tissue is not shown."
    )


def _plan(scene: Scene) -> Iterator[Part]:
    """Build the table of modelled and neglected features."""
    from solver import plan

    decided = plan(scene)
    rows = tuple((one.feature, "yes" if one.modelled else "no", f"{one.effect:.2g}", one.reason) for one in decided.decisions)
    yield Text(
        f"Evaluated by {decided.evaluator or 'no evaluator'}: {decided.dimension}. Effects are relative changes of the ratio."
    )
    yield PageTable(("feature", "modelled", "effect", "why"), rows)


def _loads(scene: Scene) -> Iterator[Part]:
    """Build the table of load limits."""
    from solver import plan

    rows = [
        (one.question, most(one.force, 3), most(1e3 * one.indentation, 3), one.by, one.how)
        for one in plan(scene, ACCURACY).load_limits.known
    ]
    load = scene.load
    force, deep = ("-" if one is None else f"{size * one:.3g}" for one, size in ((load.force, 1.0), (load.indentation, 1e3)))
    yield PageTable(("load", "force, N", "indentation, mm", "limited by", "known"), (("here", force, deep, "-", "-"), *rows))
    yield Text(
        "These limits hold for the tumours of this scene. Higher loads need the evaluator contact: "
        "probe-design load draws ratio and walls against force."
    )


def _curve(scene: Scene) -> Iterator[Part]:
    """Draw ratio and log-sensitivity over the modulus of the tumour."""
    from solver.results.figures import curve_figure

    moduli = np.geomspace(1e3, 1e6, CURVE_POINTS)
    found = _level(scene).curve(scene, moduli, ACCURACY)
    body = scene.inclusion[scene.target or 0]
    figure = curve_figure(found, body.youngs_modulus, scene.tissue.material_at(body.depth).youngs_modulus)
    yield Picture.of(figure, "ratio and log-sensitivity against the Young's modulus of the inclusion")


def _map(scene: Scene, noise: float) -> Iterator[Part]:
    """Draw maps of detection and stiffness over diameter and depth."""
    from probe_design.maps.detectability import detectability
    from probe_design.maps.sphere_effects import Thresholds
    from probe_design.maps.target_grid import chosen_sizes

    depths, diameters = chosen_sizes(scene, MAP_POINTS)
    found = detectability(scene, depths, diameters, Thresholds(noise), accuracy=DRAWN, linear=True)
    yield Picture.of(found.plot(), "maps over diameter and depth: change of the ratio, standard deviation of ln E_object")
    for text in found.warnings:
        yield Text(f"{text}.")


def _sensitivities(scene: Scene) -> Iterator[Part]:
    """Build the table of sensitivities."""
    found = _gradients(scene)
    rows = tuple(_row(scene, found, k) for k in range(len(found.variables)))
    yield Text("Change of ratio and stiffness in per cent, and of the log-sensitivity, for an increase of each number by 1 %.")
    yield PageTable(("1 % more of", "ratio, %", "stiffness, %", "log-sensitivity"), rows)


def _gradients(scene: Scene) -> Gradients:
    """Compute the derivatives with respect to every number: exact on the axis, to first order in the tumours' fields off it."""
    level = _level(scene)
    if isinstance(level, Axisymmetric):
        from solver.axisymmetric.gradients import gradients

        return gradients(scene, level.converged(scene, ACCURACY).sample)
    from solver.axisymmetric.sections import sections
    from solver.equivalent_inclusion.gradients import first_order, tumour_gradients

    level.check(scene)
    return tumour_gradients(scene, first_order(scene, sections(scene)), tuple(values(scene)))


def _level(scene: Scene) -> Axisymmetric | EquivalentInclusion:
    """Return the evaluator for the pictures of a report; it is linear, whatever the load."""
    return Axisymmetric() if Axisymmetric().refusal(scene) is None else EquivalentInclusion()


def _row(scene: Scene, found: Gradients, k: int) -> tuple[str, ...]:
    """Build the row of number ``k`` in the table of sensitivities."""
    name = found.variables[k]
    size = values(scene)[name]
    changes = (
        found.derivatives[output][0, k] * size / (100 if output == "log_sensitivity" else found.values[output][0])
        for output in ("ratio", "stiffness", "log_sensitivity")
    )
    return name, *(f"{change:.3g}" for change in changes)


def _stresses(scene: Scene) -> Iterator[Part]:
    """Draw the vertical pressure in the meridian plane."""
    from probe_design.reports.stresses import stress_figure

    upright = scene.model_copy(update={"inclusion": ()}) if Axisymmetric().refusal(scene) is not None else scene
    states = Axisymmetric().converged(upright, ACCURACY).sample.states
    yield Picture.of(stress_figure(states, upright), "vertical pressure in the meridian plane under the load")
    if upright is not scene:
        yield Text("Without the tumours, which are off the probe's axis.")
