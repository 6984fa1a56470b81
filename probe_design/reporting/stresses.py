"""Draw the vertical pressure in probe and tissue under the load, in the meridian plane, from evaluator axisymmetric."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from geometry.common.arrays import Floats
from geometry.meridian.mesh import compute_nodes
from geometry.scenes.scene import Scene
from geometry.scenes.units import MM_PER_M, PA_PER_KPA
from solver.axisymmetric.base_states import BaseStates
from solver.elements.quadrilateral import compute_gradients, project_dilations
from solver.results.film_forces import compute_indentation

ELEMENT_CORNERS = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])


def compute_pressures(states: BaseStates, scene: Scene) -> Floats:
    """Compute the mean of -sigma_zz over each of n elements under the scene's load, Pa, shape (n,).

    Its average over a block is the block's film stress, as every section of a block carries the force on its film.
    """
    model, total = states.model, float(states.forces.sum())
    # n elements with s shape functions each
    n, s = len(model.mesh.body), len(model.shapes.degrees)
    # both blocks lowered by 1 m: the first two states, film states follow
    displacements = states.values[..., :2].sum(axis=2).reshape(n, 2, s, 1)
    (rr, _, _, zz), hoop_strain = compute_gradients(model.geometry, model.shapes, displacements)
    dilation = project_dilations(model.geometry, model.shapes, rr + zz + hoop_strain)
    stress = model.law.two_mu[:, None] * zz[..., 0] + model.law.dilation_modulus[:, None] * dilation[..., 0]
    mean = (stress * model.geometry.weight).sum(axis=1) / model.geometry.weight.sum(axis=1)
    return np.asarray(-mean * compute_indentation(scene, total))


def draw_stress_figure(states: BaseStates, scene: Scene) -> Figure:
    """Draw the vertical pressures within three outer radii of the axis; return the figure.

    The colours reach the 98 % quantile of the pressures over the area shown, as those at the edges of the blocks are singular.
    """
    model, pressure = states.model, compute_pressures(states, scene)
    corners = MM_PER_M * np.asarray(compute_nodes(model.section, model.mesh, ELEMENT_CORNERS))  # (n, 4, 2)
    radius = 3 * MM_PER_M * scene.probe.tube_radius
    height = MM_PER_M * max(scene.probe.core_height, scene.probe.tube_height)
    depth = min(radius, MM_PER_M * float(np.max(model.section.tissue_depth)))
    is_shown = (corners[..., 0].min(axis=1) < radius) & (corners[..., 1].min(axis=1) > -1.5 * depth)
    shown, area = np.abs(pressure[is_shown]), _compute_areas(corners[is_shown])
    max_pressure = float(np.quantile(shown, 0.98, weights=area, method="inverted_cdf")) / PA_PER_KPA or 1.0
    figure = Figure(figsize=(8.0, 1.0 + 7.0 * (depth + height) / radius), facecolor="white", layout="constrained")
    axes = figure.subplots()
    cells = PolyCollection(
        corners[is_shown],
        array=pressure[is_shown] / PA_PER_KPA,
        cmap="RdBu_r",
        clim=(-max_pressure, max_pressure),
        edgecolors="face",
        linewidths=0.1,
    )
    axes.add_collection(cells)
    axes.set(xlim=(0, radius), ylim=(-depth, 1.05 * height), aspect="equal", xlabel="r, mm", ylabel="z, mm")
    for k, layer_depth in enumerate(scene.tissue.interfaces):
        axes.axhline(-MM_PER_M * layer_depth, color="0.4", linewidth=0.8, linestyle="--", label="layer" if k == 0 else None)
    for k, body in enumerate(scene.inclusion):
        if body.diameter is not None:
            centre, size = (0.0, -MM_PER_M * body.depth), MM_PER_M * body.diameter / 2
            axes.add_patch(Circle(centre, size, fill=False, edgecolor="black", linewidth=1.2, label="tumour" if k == 0 else None))
    if scene.inclusion or scene.tissue.interfaces:
        axes.legend(loc="lower right")
    figure.colorbar(cells, ax=axes, label="vertical pressure, kPa (compression positive)", shrink=0.8, extend="both")
    return figure


def _compute_areas(corners: Floats) -> Floats:
    """Return the areas of quadrilaterals from their corners, shape (n, 4, 2)."""
    first, second = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]  # diagonals
    return np.asarray(np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2)
