"""Measure how exact tumour effects are that are added to a loaded state without a tumour, for off-axis tumours.

    python -m benchmarks.contact.small_tumours

About the loaded state of tissue alone a tumour whose modulus is hardly another changes ln ratio by S1 (k - 1), k the moduli's
ratio: the tangent's exact derivative, by reciprocity an integral of two axisymmetric fields over the tumour, wherever it lies.
Two ways from there to a real tumour, both of which could be had off the axis:

- dipole: Eshelby's sphere in the loaded tissue, (k - 1) / (1 + beta (k - 1)) for k - 1;
- carried: the linear evaluator's result, reflections and all, times what the load makes of S1.

On the axis ``contact`` knows the truth. Each row is a tumour under examples/scene.toml's probe and one force: the truth's change
of ln ratio and log-sensitivity, and the relative errors of both. One mesh for all, so that its error cancels.

Off the axis a sphere counts by its share of each circle about the axis. The second table shows S1 there, at rest beside
``equivalent-inclusion``, and what loads make of it.

Duration: minutes.
"""

from __future__ import annotations

from math import log

import numpy as np
from rich.console import Console

from benchmarks.contact.peers import scene
from benchmarks.tables import MeasuredTable
from geometry import Scene
from geometry.common.arrays import Floats
from geometry.meridian.mesh import compute_nodes
from geometry.meridian.mesh_lines import MeridianFineness
from solver import evaluate
from solver.axisymmetric.sections import build_sections
from solver.contact.model import ContactModel
from solver.contact.path import Path
from solver.contact.states import PathPoint

COVERS = (0.25, 0.5, 1.0, 1.5)  # diameters
DIAMETERS, CONTRASTS = (4e-3, 8e-3), (5.0, 0.2)
NEARLY_ONE = 1.001  # a contrast whose effect is linear, and that keeps the tumour in the mesh
OFFSETS = (0.0, 0.5, 1.0, 2.0)  # outer radii
DEPTHS = (0.1, 0.2, 0.3)  # outer radii, of the indentation without a tumour
SMALL_DEPTH_OUTER_RADII = 2e-3  # likewise: nearly at rest
FINENESS = MeridianFineness(1, 0, 3)


def build_tumour_scene(diameter: float, cover: float, contrast: float) -> Scene:
    """Return the example with a tumour of its own."""
    base = scene()
    tissue = base.tissue
    body = base.inclusion[0].model_copy(
        update={
            "diameter": diameter,
            "depth": (0.5 + cover) * diameter,
            "youngs_modulus": contrast * tissue.youngs_modulus,
            "poisson_ratio": tissue.poisson_ratio,
        }
    )
    return base.model_copy(update={"inclusion": (body,)})


def build_path(pressed_scene: Scene) -> Path:
    """Return its path at rest, on a mesh of order 3."""
    cut = build_sections(pressed_scene)
    return Path(ContactModel.from_section(cut.section, cut.materials, "bonded", FINENESS), sensitive=True)


def dipole(contrast: float, poisson: float) -> tuple[float, float]:
    """Return Eshelby's strength of a sphere that changes no volume, and its derivative by ln contrast."""
    beta = 2 * (4 - 5 * poisson) / (15 * (1 - poisson))
    denominator = 1 + beta * (contrast - 1)
    return (contrast - 1) / denominator, contrast / denominator**2


def ln_ratio(point: PathPoint) -> float:
    """Return ln of the films' forces' ratio, at rest of their derivatives': areas cancel in differences."""
    inner, outer = point.films if point.indentation > 0 else point.tangent
    return log(inner / outer)


def compare_points(bare: PathPoint, true: PathPoint) -> tuple[float, float, float]:
    """Return S1, the true change of ln ratio and the true log-sensitivity at one force."""
    return bare.log_sensitivity / NEARLY_ONE, ln_ratio(true) - ln_ratio(bare), true.log_sensitivity


def rows(diameter: float, cover: float, contrast: float) -> list[tuple[float | str, ...]]:
    """Return the table's rows of one tumour."""
    alone, real = (
        build_path(build_tumour_scene(diameter, cover, NEARLY_ONE)),
        build_path(build_tumour_scene(diameter, cover, contrast)),
    )
    strength, derivative = dipole(contrast, scene().tissue.poisson_ratio)
    at_rest, change_at_rest, sensitivity_at_rest = compare_points(alone.points[0], real.points[0])
    table_rows: list[tuple[float | str, ...]] = []
    for depth in DEPTHS:
        bare = alone.press_to_indentation(depth * alone.radius)
        first, change, sensitivity = compare_points(bare, real.press_to_force(bare.force))
        carried = first / at_rest
        by_dipole = strength * first / change, derivative * first / sensitivity
        by_load = carried * change_at_rest / change, carried * sensitivity_at_rest / sensitivity
        deviations = (f"{100 * (guess - 1):+.1f} %" for guess in (*by_dipole, *by_load))
        table_rows.append((1e3 * diameter, cover, contrast, depth, f"{first / at_rest:.3f}", change, sensitivity, *deviations))
    return table_rows


def shares(model: ContactModel, x: float, depth: float, diameter: float) -> Floats:
    """Return a sphere's share of the circles through all Gauss points, shape (n, q)."""
    functions = model.elements.shapes
    nodes = compute_nodes(model.section, model.mesh, functions.places)
    r, z = (nodes[..., k] @ functions.geometry.T for k in (0, 1))
    reach = (diameter / 2) ** 2 - (z + depth) ** 2
    if x == 0:
        return np.asarray(r**2 < reach, dtype=float)
    return np.asarray(np.arccos(np.clip((r**2 + x**2 - reach) / (2 * r * x), -1, 1)) / np.pi)


def first_order(model: ContactModel, point: PathPoint, target: Floats) -> float:
    """Return S1 of a target at a point of a path without a tumour, at the same force."""
    _, derivatives = model.compute_responses(point.equilibrium.state, point.equilibrium.equations, target)
    by_modulus = derivatives[:, 1] - derivatives[:, 0] * (derivatives[:, 1].sum() / derivatives[:, 0].sum())
    return float(by_modulus @ ([1, -1] / point.films))


def row_beside(diameter: float, cover: float, offset: float) -> tuple[float | str, ...]:
    """Return a row of the second table: a tumour ``offset`` outer radii from the axis."""
    tumour_scene = build_tumour_scene(diameter, cover, NEARLY_ONE)
    x = offset * tumour_scene.probe.tube_radius
    bare = tumour_scene.model_copy(update={"inclusion": ()})
    cut = build_sections(bare)
    path = Path(ContactModel.from_section(cut.section, cut.materials, "bonded", FINENESS), sensitive=False)
    target = shares(path.model, x, tumour_scene.inclusion[0].depth, diameter)
    points = [path.press_to_indentation(depth * path.radius) for depth in (SMALL_DEPTH_OUTER_RADII, *DEPTHS)]
    derivatives = [first_order(path.model, point, target) for point in points]
    moved = tumour_scene.model_copy(
        update={"inclusion": (tumour_scene.inclusion[0].model_copy(update={"x": x, "target": True}),)}
    )
    linear = evaluate(moved, "equivalent-inclusion", 1e-3).log_sensitivity
    return (
        1e3 * diameter,
        cover,
        offset,
        derivatives[0],
        linear or 0.0,
        *(f"{derivative / derivatives[0]:.3f}" for derivative in derivatives[1:]),
    )


def main() -> None:
    """Print the table."""
    table = MeasuredTable(
        "tumour effects added to a loaded state",
        (
            "diameter, mm",
            "cover",
            "contrast",
            "indentation",
            "S1 over rest",
            "ln ratio, error",
            "log-sensitivity, error",
            "dipole: change",
            "its sensitivity",
            "carried: change",
            "carried sensitivity",
        ),
    )
    for diameter in DIAMETERS:
        for cover in COVERS:
            for contrast in CONTRASTS:
                for row in rows(diameter, cover, contrast):
                    table.add(*row)
    table.print(Console(width=160))
    columns = (
        "diameter, mm",
        "cover",
        "offset",
        "S1 at rest, error",
        "equivalent-inclusion, error",
        "0.1",
        "0.2",
        "0.3 outer radii",
    )
    table = MeasuredTable("S1 over S1 at rest, off the axis, by indentation", columns)
    for diameter in DIAMETERS:
        for offset in OFFSETS:
            table.add(*row_beside(diameter, 0.5, offset))
    table.print(Console(width=160))


if __name__ == "__main__":
    main()
