"""Mesh a scene by quadratic tetrahedra labelled by body: by netgen, or by pytetwild where netgen cannot.

A mesh that fails the checks is made again, finer; one that fails still is refused, never used.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from geometry.cad.decimation import DECIMATED_TRIANGLES, MAX_DIRECT_TRIANGLES
from geometry.common.errors import SolveError
from geometry.common.resources import check_time
from geometry.processes.child import Failure, TooLong
from geometry.tetra.body_layout import BodyLayout, Ellipsoid
from geometry.tetra.irregular_mesh import mesh_irregular_layout
from geometry.tetra.mesh_check import check_mesh, find_max_error
from geometry.tetra.regular_mesh import MIN_RELATIVE_GAP, estimate_tetrahedra, mesh_regular_layout
from geometry.tetra.sizing import TetraFineness
from geometry.tetra.surface_files import Sheet
from geometry.tetra.tet_mesh import TetMesh

_MAX_TRIALS = 3
_ACCEPTED_VOLUME_ERROR = 3e-3  # error of a block's or ellipsoid's volume above which another trial is made
_NETGEN_TETRAHEDRA_PER_SQUARE = 5.0  # tetrahedra of a thin layer on an area equal to the square of their edge length
_TETWILD_SURPLUS_FACTOR = 1.2  # tetrahedra of pytetwild over those of the requested sizes
_TETWILD_TETRAHEDRA_PER_SQUARE = 11.0  # tetrahedra that a plane adds on an area equal to the square of their edge length


@dataclass(frozen=True)
class Timing:
    """Which mesher made a mesh, in how many seconds and trials."""

    mesher: str
    seconds: float
    trials: int


@dataclass(frozen=True)
class Mesher:
    """A meshing library by name, and its function (layout, fineness, number of the trial from 0) that returns a mesh."""

    name: str
    trial: Callable[[BodyLayout, TetraFineness, int], TetMesh]


NETGEN_MESHER = Mesher("netgen", lambda layout, fineness, _: mesh_regular_layout(layout, fineness))
TETWILD_MESHER = Mesher("pytetwild", mesh_irregular_layout)


def is_regular(layout: BodyLayout) -> bool:
    """Return whether netgen can mesh a layout: no inclusion is a surface from a file, and the gap is not extremely narrow."""
    return layout.gap >= MIN_RELATIVE_GAP * layout.inner and all(isinstance(body, Ellipsoid) for body in layout.inclusions)


def mesh_layout(layout: BodyLayout, fineness: TetraFineness) -> tuple[TetMesh, Timing]:
    """Mesh a layout by netgen if it is regular, else or where no mesh by netgen passes the checks by pytetwild.

    Returns
    -------
    tuple[TetMesh, Timing]
        The mesh with the smallest volume error of those that passed the checks, and how long all trials took.

    Raises
    ------
    SolveError
        No mesh passed the checks, or pytetwild took longer than its limit twice; the text says why.
    LimitReached
        The time is over before there is a mesh.
    KeyboardInterrupt
        Ctrl-C, at once.
    """
    if is_regular(layout):
        with suppress(SolveError):
            return _try_mesher(layout, fineness, NETGEN_MESHER)
    return _try_mesher(layout, fineness, TETWILD_MESHER)


def _try_mesher(layout: BodyLayout, fineness: TetraFineness, mesher: Mesher) -> tuple[TetMesh, Timing]:
    """Mesh a layout; again, finer, while a mesh fails the checks or its volume error is too large; see ``mesh_layout``."""
    fault, best, min_error = "", None, np.inf
    trials, start = 0, time.perf_counter()
    while trials < _MAX_TRIALS and min_error > _ACCEPTED_VOLUME_ERROR:
        try:
            mesh = mesher.trial(layout, fineness, trials)
            check_mesh(mesh, layout)
            if (error := find_max_error(mesh, layout)) < min_error:
                best, min_error = mesh, error
        except TooLong as failure:
            if best is None:
                # raises LimitReached if it was the evaluation's own time limit that ended the mesher
                check_time(_describe_work(layout))
            fault = f"{mesher.name}: {failure}"
            if trials > 0:
                break
        except Failure as failure:
            fault = f"{mesher.name}: {failure}"
        except SolveError as failure:
            fault = str(failure).removeprefix("volume mesh: ")
        trials += 1
        # the next trial is finer; the loop ends before it if this one's volume error is accepted
        fineness = replace(fineness, rim=0.9 * fineness.rim, sphere=0.9 * fineness.sphere)
    if best is None:
        raise SolveError(f"volume mesh: none passed the checks, the last one as {fault}")
    return best, Timing(mesher.name, time.perf_counter() - start, trials)


def _describe_work(layout: BodyLayout) -> str:
    """Return what takes long when a layout is meshed, and what would shorten it, for the message of a time limit."""
    # surfaces from files that cannot be simplified: ``fewer``, the same surface of fewer triangles, is None
    triangle_counts = [len(body.triangles) for body in layout.inclusions if isinstance(body, Sheet) and body.fewer is None]
    if max(triangle_counts, default=0) <= MAX_DIRECT_TRIANGLES:
        return "meshing"
    return (
        f"meshing a surface of {max(triangle_counts)} triangles too uneven to be followed by {DECIMATED_TRIANGLES} (a "
        "smoother one takes less)"
    )


def estimate_elements(layout: BodyLayout, fineness: TetraFineness) -> float:
    """Return about how many tetrahedra a layout's mesh will have, from their wanted sizes, without meshing.

    netgen makes 0.7 to 1.2 times as many, pytetwild 1.0 to 1.5 times, near an edge of the tissue up to 2.4 times.
    """
    if is_regular(layout):
        return estimate_tetrahedra(layout, fineness, _NETGEN_TETRAHEDRA_PER_SQUARE)
    per_square = _TETWILD_TETRAHEDRA_PER_SQUARE / _TETWILD_SURPLUS_FACTOR
    return _TETWILD_SURPLUS_FACTOR * estimate_tetrahedra(layout, fineness, per_square)
