"""Draw the vertical pressure in probe and tissue under the load, in the meridian plane, from evaluator axisymmetric."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.mesh import nodes
from geometry.scenes.scene import Scene
from solver.axisymmetric.base_states import BaseStates
from solver.elements.quadrilateral import gradients, projected
from solver.results.film_forces import indented

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CORNERS = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
MM = 1e3


def pressures(states: BaseStates, scene: Scene) -> Floats:
    """Compute the mean of -sigma_zz over each of n elements under the scene's load, Pa, shape (n,).

    Its average over a block is the block's film stress, as every section of a block carries the force on its film.
    """
    model, total = states.model, float(states.forces.sum())
    n, s = len(model.mesh.body), len(model.shapes.degrees)
    both = states.own.sum(axis=2).reshape(n, 2, s, 1)  # both blocks lowered by 1 m
    (rr, _, _, zz), around = gradients(model.at, model.shapes, both)
    dilation = projected(model.at, model.shapes, rr + zz + around)
    stress = model.two_mu[:, None] * zz[..., 0] + model.lam[:, None] * dilation[..., 0]
    mean = (stress * model.at.weight).sum(axis=1) / model.at.weight.sum(axis=1)
    return np.asarray(-mean * indented(scene, total))


def stress_figure(states: BaseStates, scene: Scene) -> Figure:
    """Draw the pressures within three outer radii of the axis."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    model, pressure = states.model, pressures(states, scene)
    corners = MM * np.asarray(nodes(model.section, model.mesh, CORNERS))  # (n, 4, 2)
    reach = 3 * MM * scene.probe.tube_radius
    above = MM * max(scene.probe.core_height, scene.probe.tube_height)
    deep = min(reach, MM * float(np.max(model.section.tissue_depth)))
    inside = (corners[..., 0].min(axis=1) < reach) & (corners[..., 1].min(axis=1) > -1.5 * deep)
    most = float(np.quantile(np.abs(pressure[inside]), 0.98)) or 1.0
    figure = Figure(figsize=(8.0, 1.0 + 7.0 * (deep + above) / reach), facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    cells = PolyCollection(
        corners[inside], array=pressure[inside], cmap="RdBu_r", clim=(-most, most), edgecolors="face", linewidths=0.1
    )
    axes.add_collection(cells)
    axes.set(xlim=(0, reach), ylim=(-deep, 1.05 * above), aspect="equal", xlabel="r, mm", ylabel="z, mm")
    figure.colorbar(cells, ax=axes, label="vertical pressure, Pa (compression positive)", shrink=0.8)
    return figure
