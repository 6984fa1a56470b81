"""Draw a solution of evaluator solid: the mesh cut open, a close-up of the gap, and two stresses on the cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geometry.cad.solids import COLOURS, MM
from geometry.common.arrays import Floats
from geometry.tetra.tet_mesh import BEYOND, GROOVE, INCLUSION, INNER, OUTER, TISSUE
from probe_design.pictures.formats import check_format, save
from probe_design.solid_output.faces import Faces, name, present, section, skin
from probe_design.solid_output.render import rendered
from probe_design.solid_output.stress_panel import deformed, draw_stress, in_millimetres, mesh_lines
from solver.solid.base_states import SolidStates, fields
from solver.solid.problem import Problem
from solver.solid.regions import Region

SIZE, DPI = (12.5, 9.6), 140  # inches, and dots per inch
PALE, PALER = (0.973, 0.875, 0.804), (0.985, 0.945, 0.915)
LAYERS = ((0.93, 0.76, 0.66), (0.98, 0.91, 0.70), (0.88, 0.70, 0.70), (0.83, 0.80, 0.72))  # of tissue, in turn
LUMPS = ((0.64, 0.23, 0.18), (0.45, 0.29, 0.58), (0.20, 0.50, 0.36), (0.60, 0.45, 0.05))  # inclusions, in turn
WHOLE, NEAR = (0.01, 0.5, 0.53, 0.44), (0.61, 0.535, 0.335, 0.39)  # left, bottom, width, height of panels
# left edges of the two stress panels, then bottom, width and height
LEFTS, STRESS, BAR = (0.06, 0.565), (0.06, 0.36, 0.37), (0.075, 0.013, 0.34)
FAR = 15.0  # times the tube's radius: in wider tissue the probe is too small and gets an inset
DESCENT = 0.07  # of the tube's radius: largest displacement as drawn


@dataclass(frozen=True)
class Sizes:
    """Radii of inner block, hole and tube, and the greater height of the blocks, m."""

    inner: float
    hole: float
    tube: float
    height: float

    @classmethod
    def of(cls, problem: Problem) -> Sizes:
        """Read the sizes from the nodes of the mesh."""
        nodes, solid = problem.solid.nodes, problem.solid
        radius, core, ring = np.hypot(nodes[:, 0], nodes[:, 1]), solid.on([INNER]), solid.on([OUTER])
        return cls(radius[core].max(), radius[ring].min(), radius[ring].max(), nodes[core | ring, 2].max())


def draw_solid(path: Path, states: SolidStates, motion: Sequence[float] | Floats) -> Path:
    """Draw the solution for a motion of the base: mesh cut open at y = 0, gap, pressure, von Mises stress; return ``path``.

    A whole mesh is shown for y >= 0. The stresses are drawn on the deformed cut, exaggerated by the factor in their title.

    Args:
        path: of the picture.
        states: as solved.
        motion: how far the inner and the outer block go down (m) and the base turns about y (rad), shape (3,).

    Raises:
        InputError: the suffix of the file is of no known format.
        MissingLibrary: VTK finds no OpenGL to render with; the text names the package to install.
        OSError: the file cannot be written.
    """
    path = Path(path)
    check_format(path)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    problem, motion = states.problem, np.asarray(motion, dtype=np.float64)
    cut, sizes = section(problem, fields(states, motion)), Sizes.of(problem)
    figure = Figure(figsize=SIZE, dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    figure.suptitle(_title(states, motion), fontsize=12, y=0.985)
    _whole(figure.add_axes(WHOLE), problem, cut, sizes)
    _near(figure.add_axes(NEAR), cut, sizes)
    shape = deformed(cut, DESCENT * sizes.tube, _window(cut, sizes))
    for one, left in zip(("pressure", "von_mises"), LEFTS, strict=True):
        draw_stress(figure.add_axes((left, *STRESS)), figure.add_axes((left + STRESS[1] + 0.012, *BAR)), shape, one)
    return save(figure, path)


def colour(number: int) -> tuple[float, float, float]:
    """Return the colour of a region: red, green and blue from 0 to 1."""
    body, layer, _ = Region.of(number)
    if body >= INCLUSION:
        return LUMPS[(body - INCLUSION) % len(LUMPS)]
    if layer:
        return LAYERS[(layer - 1) % len(LAYERS)]
    return {INNER: COLOURS["inner"], OUTER: COLOURS["outer"], GROOVE: (0.45, 0.66, 0.82), TISSUE: PALE, BEYOND: PALER}[body]


def _title(states: SolidStates, motion: Floats) -> str:
    """Describe the motion of the base and the film forces."""
    inner, outer = states.reactions[:2] @ motion
    each = [_rounded(amount, "m") for amount in motion[:2]]
    down = each[0] if motion[0] == motion[1] else f"{each[0]} (inner) and {each[1]} (outer)"
    tilt = f", turned by {_rounded(motion[2], 'rad')} about y" if motion[2] else ""
    return f"base down by {down}{tilt}: {_rounded(inner, 'N')} on the inner film, {_rounded(outer, 'N')} on the outer"


def _whole(axes: Any, problem: Problem, cut: Faces, sizes: Sizes) -> None:
    """Draw the mesh cut open, with an inset of the probe in wide tissue."""
    from matplotlib.patches import Patch

    shown = present(problem)
    count, half = int(np.isin(problem.solid.body, shown).sum()), problem.solid.mesh.half
    parts = [skin(problem)] if half else [skin(problem), cut]
    axes.imshow(rendered(parts, colour), interpolation="antialiased")
    axes.set_axis_off()
    if np.ptp(problem.solid.nodes[:, 0]) > FAR * sizes.tube:
        inset = axes.inset_axes((0.6, 0.02, 0.4, 0.4))
        inset.imshow(rendered(parts, colour, 1.6 * sizes.tube), interpolation="antialiased")
        inset.set(xticks=[], yticks=[])
    axes.set_title(f"{count:,} tetrahedra".replace(",", " ") + (", half by symmetry" if half else ", cut at y = 0"), fontsize=10)
    moduli = [f"{name(body)}, {_rounded(problem.materials[body].youngs_modulus, 'Pa')}" for body in shown]
    patches = [Patch(facecolor=colour(body), edgecolor="0.4", label=label) for body, label in zip(shown, moduli, strict=True)]
    axes.legend(handles=patches, loc="upper center", bbox_to_anchor=(0.5, 0.02), ncols=4, fontsize=8, frameon=False)


def _rounded(value: float, unit: str) -> str:
    from matplotlib.ticker import EngFormatter

    return str(EngFormatter(unit)(float(f"{value:.3g}")))


def _near(axes: Any, cut: Faces, sizes: Sizes) -> None:
    """Draw the gap at the tissue, with an arrow for its width."""
    from matplotlib.collections import PolyCollection

    gap, middle = (sizes.hole - sizes.inner) * MM, (sizes.inner + sizes.hole) / 2 * MM
    reach = max(min(8 * gap, (sizes.tube - sizes.hole) * MM, sizes.inner * MM), 1.5 * gap)
    flat = cut.points[:, [0, 2]] * MM
    axes.add_collection(PolyCollection(flat[cut.triangles], facecolors=[colour(b) for b in cut.body.tolist()], antialiased=False))
    mesh_lines(axes, flat, cut.lines, 0.7)
    axes.set(xlim=(middle - reach, middle + reach), ylim=(-0.9 * reach, 0.9 * reach), aspect="equal")
    height = 0.45 * reach
    arrow = {"arrowstyle": "<->", "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (middle - gap / 2, height), (middle + gap / 2, height), arrowprops=arrow)
    words = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5}
    axes.text(middle + 0.7 * gap, height, f"gap {gap:.3g} mm", va="center", fontsize=9, bbox=words)
    axes.set_title("the gap at the tissue, as meshed", fontsize=10)
    in_millimetres(axes)


def _window(cut: Faces, sizes: Sizes) -> tuple[float, float, float, float]:
    """Return the window of the stress panels, m: left, right, bottom, top; it shows the probe and the inclusions near it."""
    inclusions = np.isin(cut.body, [number for number in np.unique(cut.body).tolist() if Region.of(number).body >= INCLUSION])
    lumps = cut.points[np.unique(cut.triangles[inclusions])]
    lumps = lumps[(np.abs(lumps[:, 0]) < 3 * sizes.tube) & (lumps[:, 2] > -4 * sizes.tube)]
    room = 0.3 * sizes.tube
    sides = np.array([-1.4 * sizes.tube, 1.4 * sizes.tube, *(lumps[:, 0] + np.copysign(room, lumps[:, 0]))])
    low, top = min(-1.2 * sizes.tube, float(lumps[:, 2].min(initial=0.0)) - room), sizes.height + 0.5 * room
    shape = STRESS[1] * SIZE[0] / (STRESS[2] * SIZE[1])
    wide, middle = max(np.ptp(sides), shape * (top - low)), (sides.min() + sides.max()) / 2
    floor = float(cut.points[:, 2].min()) - room
    return middle - wide / 2, middle + wide / 2, max(top - wide / shape, floor), top
