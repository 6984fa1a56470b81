"""Read and check inclusions from STL and STEP files, and compute distances of points from them.

A file's own coordinates are relative to the inclusion's centre (x, y, -depth) in the scene's axes. An STL file is in
millimetres; a STEP file states its unit, and cadquery converts it to millimetres. Files are read in a separate process.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from geometry.common.arrays import Arrays, Points
from geometry.common.errors import InputError, Words
from geometry.common.resources import find_seconds_left, get_limits
from geometry.common.text_files import read_bytes
from geometry.common.winding import WindingTree
from geometry.processes.child import Failure
from geometry.processes.programs import run_program
from geometry.scenes.surface_names import check_surface_name

if TYPE_CHECKING:
    import pyvista


_READER_PROGRAM = Path(__file__).parents[1] / "cad" / "surface_program.py"
LARGEST_FILE = 50_000_000  # bytes: a million triangles, some hundred times as many as a mesh can follow
_READ_TIME_LIMIT_S = 60.0  # s for reading a file: sound ones take one or two
_INSIDE_WINDING = 0.5  # winding number from which a point counts as inside
_VOLUME_SAMPLES = 10_000
_DISTANCE_TOLERANCE = 0.1  # relative


@dataclass(frozen=True)
class Sheet:
    """A triangulated surface in the probe's axes, in m.

    Attributes
    ----------
    points
        (n, 3).
    triangles
        (t, 3) indices of points.
    centre
        The inclusion's, (3,).
    fewer
        The surface with fewer triangles, for meshers, where it has very many; else None.
    decimation_error
        Distance of ``fewer`` from the surface, m.
    """

    points: Points
    triangles: NDArray[np.int64]
    centre: Points
    fewer: Sheet | None = None
    decimation_error: float = 0.0

    @property
    def reach(self) -> Points:
        """Extent of the surface from its centre along each axis, (3,)."""
        result: Points = np.abs(self.points - self.centre).max(axis=0)
        return result

    @property
    def min_semi_axis(self) -> float:
        """Half the shortest side of its bounding box."""
        return float(np.ptp(self.points, axis=0).min()) / 2

    @cached_property
    def volume(self) -> float:
        """The volume inside, in m^3: from the triangles, or from random points where the two differ by more than 4 %.

        They differ where triangles cross or the surface is open.
        """
        a, b, c = (self.points[self.triangles[:, k]] - self.centre for k in range(3))
        signed = abs(float(np.einsum("ij,ij->", a, np.cross(b, c)))) / 6
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        draws = np.random.default_rng(0).uniform(low, high, (_VOLUME_SAMPLES, 3))
        sampled = float(self.is_inside(draws).mean() * np.prod(high - low))
        return signed if abs(signed - sampled) < 0.04 * sampled else sampled

    @cached_property
    def is_closed(self) -> bool:
        """Whether every edge belongs to two triangles that run along it in opposite directions."""
        edges = self.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        forth = np.unique(edges, axis=0)
        return len(forth) == len(edges) and len(np.unique(np.vstack([edges, edges[:, ::-1]]), axis=0)) == len(edges)

    def compute_winding(self, points: Points) -> Points:
        """Return winding numbers of the surface about points (m, 3), (m,): 1 inside, 0 outside, between them where it is open.

        They are -1 inside where the triangles are turned inside out.
        """
        return self._winding_tree.compute_winding(points)

    def is_inside(self, points: Points) -> NDArray[np.bool_]:
        """Return whether points (m, 3) lie inside."""
        is_in_box = (np.abs(points - self._middle) <= self._half_sides).all(axis=1)
        result = np.zeros(len(points), dtype=bool)
        result[is_in_box] = np.abs(self.compute_winding(points[is_in_box])) > _INSIDE_WINDING
        return result

    def find_nearest(self, points: Points) -> Points:
        """Return the point of the surface that is nearest to each of the points (m, 3), (m, 3)."""
        _, nearest = self._poly.find_closest_cell(points, return_closest_point=True)  # type: ignore[misc]  # a pair if asked for
        return np.asarray(nearest, dtype=float).reshape(-1, 3)

    def find_level(self, points: Points) -> tuple[Points, Points]:
        """Return distances (n,) of points (n, 3) from the surface, never negative, and their unit gradients (n, 3)."""
        offset = points - self.find_nearest(points)
        distance = np.linalg.norm(offset, axis=1)
        return distance, offset / np.maximum(distance, 1e-300)[:, None]

    def crosses(self, second: Sheet) -> bool:
        """Return whether a triangle of one surface touches one of the other."""
        return bool(self._poly.collision(second._poly, contact_mode=1)[1])

    def estimate_distance(self, points: Points) -> Points:
        """Estimate the distance of points (m, 3) from the surface, (m,): from the nearest corner or middle of a triangle.

        It may be too large by ``_DISTANCE_TOLERANCE``: the exact search takes minutes from a ball's middle, to which all its
        triangles are equally near.
        """
        return np.asarray(self._tree.query(points, eps=_DISTANCE_TOLERANCE)[0])

    @cached_property
    def _winding_tree(self) -> WindingTree:
        return WindingTree.from_triangles(self.points[self.triangles])

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(np.vstack([self.points, self.points[self.triangles].mean(axis=1)]))

    @cached_property
    def _middle(self) -> Points:
        return np.asarray((self.points.max(axis=0) + self.points.min(axis=0)) / 2)

    @cached_property
    def _half_sides(self) -> Points:
        return np.asarray(np.ptp(self.points, axis=0) / 2)

    @cached_property
    def _poly(self) -> pyvista.PolyData:
        surface: pyvista.PolyData = _load_pyvista().PolyData.from_regular_faces(self.points, self.triangles)
        return surface


def read_surface(name: str, key: str, centre: Points) -> Sheet:
    """Read an inclusion's surface from an STL or STEP file; ``key`` names it in messages.

    A surface that is open, crosses itself or is turned inside out is accepted if its winding numbers still distinguish inside
    from outside.

    Raises
    ------
    InputError
        The file cannot be read, holds no triangles, or does not define an inside.
    """
    check_surface_name(name, key)
    content = read_bytes(name, key, "an STL or STEP file", LARGEST_FILE)
    try:
        read = _read_triangles(Path(name).suffix.lower(), content)
    except (Failure, OSError) as fault:
        raise InputError(key, name, f"an STL or STEP file that can be read ({fault})") from None
    points, triangles = read["points"], read["triangles"]
    if len(triangles) < 4 or not np.isfinite(points).all():
        raise InputError(key, Words(f"{name}, with {len(triangles)} triangles"), "a closed surface of finite triangles")
    fewer = Sheet(read["few_points"] * 1e-3 + centre, read["few_triangles"], centre) if "off" in read else None
    sheet = Sheet(points * 1e-3 + centre, triangles, centre, fewer, 1e-3 * float(read.get("off", 0.0)))
    _check_enclosing(sheet, name, key)
    return sheet


@lru_cache(maxsize=8)
def _read_triangles(suffix: str, content: bytes) -> Arrays:
    """Return the result of ``geometry/cad/surface_program.py`` for a file; the latest results are cached.

    Raises
    ------
    Failure
        It cannot be read.
    """
    with tempfile.TemporaryDirectory(prefix="surface-", ignore_cleanup_errors=True) as folder:
        path = Path(folder, f"surface{suffix}")
        path.write_bytes(content)
        arguments = {"name": np.array(str(path)), "suffix": np.array(suffix)}
        mesh: dict[str, NDArray[Any]] = run_program(
            _READER_PROGRAM, arguments, min(_READ_TIME_LIMIT_S, find_seconds_left()), get_limits().memory
        )
    for array in mesh.values():
        array.setflags(write=False)
    return mesh


def _check_enclosing(sheet: Sheet, name: str, key: str) -> None:
    """Refuse a surface that encloses nothing, by the winding numbers at random points of its bounding box.

    Some have to be nearly 1 (inside), and few between 0 and 1, as they are near an opening.
    """
    if np.ptp(sheet.points, axis=0).min() <= 0:
        raise InputError(key, Words(f"{name}, a flat surface"), "a closed surface")
    draws = np.random.default_rng(0).uniform(sheet.points.min(axis=0), sheet.points.max(axis=0), (400, 3))
    winding = np.abs(sheet.compute_winding(draws))
    vague = float(((winding > 0.2) & (winding < 0.8)).mean())
    if winding.max() < 0.8 or vague > 0.1:
        value = Words(f"{name}, open: of {vague:.0%} of the points in its box it cannot be said whether they are inside")
        raise InputError(key, value, "a closed surface, or one with small holes only")


def _load_pyvista() -> Any:
    import pyvista

    return pyvista
