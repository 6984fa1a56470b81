"""Write solutions of evaluator solid as a VTU file for ParaView.

pyvista is imported in the function that needs it. No function opens a window or needs a graphics card.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.files import write_whole
from probe_design.solid_output.faces import list_bodies, name_region
from solver.solid.base_states import SolidStates, compute_fields

TENSOR_COMPONENTS = ("XX", "YY", "ZZ", "XY", "YZ", "XZ")  # VTK's order
_TO_TENSOR = [0, 1, 2, 5, 3, 4]  # from xx yy zz yz xz xy
HALF_SYMMETRY = "the half y >= 0 of a whole that is its own mirror image; film_forces are those of the whole"


def write_vtu(path: Path, states: SolidStates, motion: Sequence[float] | Floats) -> Path:
    """Write the fields for a motion of the base as quadratic tetrahedra for ParaView; return ``path``.

    Bodies without a material are left out; a half mesh is written as a half.

    Points carry ``displacement`` (m). Cells carry ``body`` (a number, named by the field data ``body_number`` and ``body_name``),
    ``stress`` (their mean, Pa, tension positive, in VTK's order XX YY ZZ XY YZ XZ), ``von_mises`` and ``pressure`` (vertical, Pa,
    compression positive). Field data also say ``symmetry``, ``motion`` (m, m, rad) and ``film_forces`` (inner, outer, N).

    Parameters
    ----------
    path
        File to write, ending in ``.vtu``.
    states
        Solutions for unit motions of the base.
    motion
        How far the inner and the outer block go down (m) and the base turns about y (rad), shape (3,).

    Raises
    ------
    OSError
        The file cannot be written.
    """
    grid = _build_grid(states, np.asarray(motion, dtype=np.float64))
    with write_whole(Path(path)) as draft:
        grid.save(draft)
    return Path(path)


def _build_grid(states: SolidStates, motion: Floats) -> Any:
    """Return the VTK grid with all fields for a motion of the base, see ``write_vtu``."""
    import pyvista

    problem, solution = states.problem, compute_fields(states, motion)
    solid, bodies = problem.solid, list_bodies(problem)
    is_shown = np.isin(solid.body, bodies)
    used_nodes, number = np.unique(solid.elements[is_shown], return_inverse=True)
    grid = pyvista.UnstructuredGrid({pyvista.CellType.QUADRATIC_TETRA: number.reshape(-1, 10)}, solid.nodes[used_nodes])
    grid.point_data["displacement"] = solution.displacement[used_nodes]
    grid.cell_data["body"] = solid.body[is_shown]
    grid.cell_data["stress"] = solution.stress[is_shown][:, _TO_TENSOR]
    grid.cell_data["von_mises"] = solution.von_mises[is_shown]
    grid.cell_data["pressure"] = solution.vertical_stress[is_shown]
    stress = grid.GetCellData().GetAbstractArray("stress")
    for component, label in enumerate(TENSOR_COMPONENTS):
        stress.SetComponentName(component, label)
    grid.field_data["body_number"] = np.array(bodies)
    grid.field_data["body_name"] = [name_region(body) for body in bodies]
    grid.field_data["symmetry"] = [HALF_SYMMETRY if solid.mesh.half else "whole"]
    grid.field_data["motion"] = motion
    grid.field_data["film_forces"] = states.reactions[:2] @ motion
    return grid
