"""Draw a solution of evaluator solid: the mesh cut open, a close-up of the gap, and two stresses on the cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import EngFormatter

from geometry.cad.solids import PART_COLOURS
from geometry.common.arrays import Floats
from geometry.scenes.units import MM_PER_M
from geometry.tetra.tet_mesh import MeshBody
from probe_design.reporting.picture_files import check_format, save_figure
from probe_design.solid_output.faces import Faces, cut_section, extract_skin, list_bodies, name_region
from probe_design.solid_output.render import render_faces
from probe_design.solid_output.stress_panel import deform_section, draw_mesh_lines, draw_stress, label_axes
from solver.solid.base_states import SolidStates, compute_fields
from solver.solid.problem import Problem
from solver.solid.regions import Region

FIGURE_SIZE_INCHES, FIGURE_DPI = (12.5, 9.6), 140  # inches, and dots per inch
TISSUE_COLOUR, OUTER_TISSUE_COLOUR = (0.973, 0.875, 0.804), (0.985, 0.945, 0.915)
LAYER_COLOURS = ((0.93, 0.76, 0.66), (0.98, 0.91, 0.70), (0.88, 0.70, 0.70), (0.83, 0.80, 0.72))  # of tissue, in turn
INCLUSION_COLOURS = ((0.64, 0.23, 0.18), (0.45, 0.29, 0.58), (0.20, 0.50, 0.36), (0.60, 0.45, 0.05))  # inclusions, in turn
MESH_PANEL, GAP_PANEL = (0.01, 0.5, 0.53, 0.44), (0.61, 0.535, 0.335, 0.39)  # left, bottom, width, height of panels
# left edges of the two stress panels, then bottom, width and height
STRESS_PANEL_LEFTS, STRESS_PANEL, COLOUR_BAR = (0.06, 0.565), (0.06, 0.36, 0.37), (0.075, 0.013, 0.34)
WIDE_TISSUE_RADII = 15.0  # times the tube's radius: in wider tissue the probe is too small and gets an inset
DRAWN_DISPLACEMENT_RADII = 0.07  # of the tube's radius: largest displacement as drawn


@dataclass(frozen=True)
class MeshSizes:
    """Radii of inner block, hole and tube, and the greater height of the blocks, m."""

    inner: float
    hole: float
    tube: float
    height: float

    @classmethod
    def from_problem(cls, problem: Problem) -> MeshSizes:
        """Return the sizes, measured at the nodes of the mesh."""
        nodes, solid = problem.solid.nodes, problem.solid
        radius, core, ring = (
            np.hypot(nodes[:, 0], nodes[:, 1]),
            solid.find_nodes([MeshBody.INNER]),
            solid.find_nodes([MeshBody.OUTER]),
        )
        return cls(radius[core].max(), radius[ring].min(), radius[ring].max(), nodes[core | ring, 2].max())


def draw_solid(path: Path, states: SolidStates, motion: Sequence[float] | Floats) -> Path:
    """Draw the solution for a motion of the base: mesh cut open at y = 0, gap, pressure, von Mises stress; return ``path``.

    A whole mesh is shown for y >= 0. The stresses are drawn on the deformed cut, exaggerated by the factor in their title.

    Parameters
    ----------
    path
        File of the picture.
    states
        Solutions for unit motions of the base.
    motion
        How far the inner and the outer block go down (m) and the base turns about y (rad), shape (3,).

    Raises
    ------
    InputError
        The suffix of the file is of no known format.
    MissingLibrary
        VTK finds no OpenGL to render with; the text names the package to install.
    OSError
        The file cannot be written.
    """
    path = Path(path)
    check_format(path)

    problem, motion = states.problem, np.asarray(motion, dtype=np.float64)
    cut, sizes = cut_section(problem, compute_fields(states, motion)), MeshSizes.from_problem(problem)
    figure = Figure(figsize=FIGURE_SIZE_INCHES, dpi=FIGURE_DPI, facecolor="white")
    figure.suptitle(_format_title(states, motion), fontsize=12, y=0.985)
    _draw_mesh(figure.add_axes(MESH_PANEL), problem, cut, sizes)
    _draw_gap(figure.add_axes(GAP_PANEL), cut, sizes)
    shape = deform_section(cut, DRAWN_DISPLACEMENT_RADII * sizes.tube, _find_window(cut, sizes))
    for stress, left in zip(("pressure", "von_mises"), STRESS_PANEL_LEFTS, strict=True):
        draw_stress(
            figure.add_axes((left, *STRESS_PANEL)), figure.add_axes((left + STRESS_PANEL[1] + 0.012, *COLOUR_BAR)), shape, stress
        )
    return save_figure(figure, path)


def find_colour(number: int) -> tuple[float, float, float]:
    """Return the colour of the region with a number: red, green and blue from 0 to 1."""
    body, layer, _ = Region.from_number(number)
    if body >= MeshBody.FIRST_INCLUSION:
        return INCLUSION_COLOURS[(body - MeshBody.FIRST_INCLUSION) % len(INCLUSION_COLOURS)]
    if layer:
        return LAYER_COLOURS[(layer - 1) % len(LAYER_COLOURS)]
    return {
        MeshBody.INNER: PART_COLOURS["inner"],
        MeshBody.OUTER: PART_COLOURS["outer"],
        MeshBody.GROOVE: (0.45, 0.66, 0.82),
        MeshBody.TISSUE: TISSUE_COLOUR,
        MeshBody.BEYOND: OUTER_TISSUE_COLOUR,
    }[MeshBody(body)]


def _format_title(states: SolidStates, motion: Floats) -> str:
    """Describe the motion of the base and the film forces."""
    inner, outer = states.reactions[:2] @ motion  # forces on the films, N
    descents = [_format_value(amount, "m") for amount in motion[:2]]
    descent = descents[0] if motion[0] == motion[1] else f"{descents[0]} (inner) and {descents[1]} (outer)"
    tilt = f", turned by {_format_value(motion[2], 'rad')} about y" if motion[2] else ""
    return (
        f"base down by {descent}{tilt}: {_format_value(inner, 'N')} on the inner film, {_format_value(outer, 'N')} on the outer"
    )


def _draw_mesh(axes: Axes, problem: Problem, cut: Faces, sizes: MeshSizes) -> None:
    """Draw the mesh cut open, with an inset of the probe in wide tissue."""
    bodies = list_bodies(problem)
    count, half = int(np.isin(problem.solid.body, bodies).sum()), problem.solid.mesh.half
    parts = [extract_skin(problem)] if half else [extract_skin(problem), cut]
    axes.imshow(render_faces(parts, find_colour), interpolation="antialiased")
    axes.set_axis_off()
    if np.ptp(problem.solid.nodes[:, 0]) > WIDE_TISSUE_RADII * sizes.tube:
        inset = axes.inset_axes((0.6, 0.02, 0.4, 0.4))
        inset.imshow(render_faces(parts, find_colour, 1.6 * sizes.tube), interpolation="antialiased")
        inset.set(xticks=[], yticks=[])
    axes.set_title(f"{count:,} tetrahedra".replace(",", " ") + (", half by symmetry" if half else ", cut at y = 0"), fontsize=10)
    moduli = [f"{name_region(body)}, {_format_value(problem.laws[body].youngs_modulus, 'Pa')}" for body in bodies]
    patches = [
        Patch(facecolor=find_colour(body), edgecolor="0.4", label=label) for body, label in zip(bodies, moduli, strict=True)
    ]
    axes.legend(handles=patches, loc="upper center", bbox_to_anchor=(0.5, 0.02), ncols=4, fontsize=8, frameon=False)


def _format_value(value: float, unit: str) -> str:
    """Format a value with three digits and a prefix before its unit, such as 4.31 mN."""
    return str(EngFormatter(unit)(float(f"{value:.3g}")))


def _draw_gap(axes: Axes, cut: Faces, sizes: MeshSizes) -> None:
    """Draw the gap at the tissue, with an arrow for its width."""
    gap, middle = (sizes.hole - sizes.inner) * MM_PER_M, (sizes.inner + sizes.hole) / 2 * MM_PER_M
    # half the width of the view: a few gaps, but no more than the blocks
    reach = max(min(8 * gap, (sizes.tube - sizes.hole) * MM_PER_M, sizes.inner * MM_PER_M), 1.5 * gap)
    flat = cut.points[:, [0, 2]] * MM_PER_M
    axes.add_collection(
        PolyCollection(list(flat[cut.triangles]), facecolors=[find_colour(b) for b in cut.body.tolist()], antialiased=False)
    )
    draw_mesh_lines(axes, flat, cut.lines, 0.7)
    axes.set(xlim=(middle - reach, middle + reach), ylim=(-0.9 * reach, 0.9 * reach), aspect="equal")
    height = 0.45 * reach
    arrow = {"arrowstyle": "<->", "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (middle - gap / 2, height), (middle + gap / 2, height), arrowprops=arrow)
    words = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5}
    axes.text(middle + 0.7 * gap, height, f"gap {gap:.3g} mm", va="center", fontsize=9, bbox=words)
    axes.set_title("the gap at the tissue, as meshed", fontsize=10)
    label_axes(axes)


def _find_window(cut: Faces, sizes: MeshSizes) -> tuple[float, float, float, float]:
    """Return the window of the stress panels, m: left, right, bottom, top; it shows the probe and the inclusions near it."""
    inclusions = np.isin(
        cut.body,
        [number for number in np.unique(cut.body).tolist() if Region.from_number(number).body >= MeshBody.FIRST_INCLUSION],
    )
    inclusion_points = cut.points[np.unique(cut.triangles[inclusions])]
    inclusion_points = inclusion_points[
        (np.abs(inclusion_points[:, 0]) < 3 * sizes.tube) & (inclusion_points[:, 2] > -4 * sizes.tube)
    ]
    margin = 0.3 * sizes.tube
    sides = np.array(
        [-1.4 * sizes.tube, 1.4 * sizes.tube, *(inclusion_points[:, 0] + np.copysign(margin, inclusion_points[:, 0]))]
    )
    low, top = min(-1.2 * sizes.tube, float(inclusion_points[:, 2].min(initial=0.0)) - margin), sizes.height + 0.5 * margin
    # width over height of a panel
    shape = STRESS_PANEL[1] * FIGURE_SIZE_INCHES[0] / (STRESS_PANEL[2] * FIGURE_SIZE_INCHES[1])
    width, middle = max(np.ptp(sides), shape * (top - low)), (sides.min() + sides.max()) / 2
    floor = float(cut.points[:, 2].min()) - margin
    return middle - width / 2, middle + width / 2, max(top - width / shape, floor), top
