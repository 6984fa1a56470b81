"""Represent a field of mesh sizes by cubes, subdivided until each is as small as the size requested at its centre."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points

_CUBE_EDGE_FRACTION = 0.8  # edge of a cube over the requested size at its centre
_MAX_CUBES = 200_000  # cubes of one edge length: enough for meshes of more than a million tetrahedra
_CHILD_OFFSETS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 4


@dataclass(frozen=True)
class SizeCubes:
    """Cubes that cover the meshed region, in m.

    Attributes
    ----------
    middles
        Centres of the cubes, (n, 3).
    edges
        Edge lengths of the cubes, (n,).
    sizes
        Sizes of tetrahedra requested at the centres, (n,).
    """

    middles: Points
    edges: Points
    sizes: Points


def build_size_cubes(
    sizes: Callable[[Points], Points], is_near: Callable[[Points, float], NDArray[np.bool_]], *, centre: Points, edge: float
) -> SizeCubes:
    """Subdivide a cube until its parts are no larger than a fraction of the sizes requested at their centres.

    Parameters
    ----------
    sizes
        Function that returns the requested lengths at points (n, 3).
    is_near
        Function that returns which points (n, 3) lie in the meshed region or within a distance of it; other cubes are left out.
    centre
        Centre of the first cube, (3,).
    edge
        Edge length of the first cube.
    """
    cubes, accepted = centre[None, :], []
    while len(cubes):
        size = sizes(cubes)
        # also accepted: cubes that are too large, where dividing them would give too many
        small = (edge <= _CUBE_EDGE_FRACTION * size) | (len(cubes) > _MAX_CUBES)
        accepted.append((cubes[small], np.full(np.count_nonzero(small), edge), size[small]))
        cubes = (cubes[~small][:, None] + edge * _CHILD_OFFSETS).reshape(-1, 3)
        edge /= 2
        # half a cube's diagonal: a cube whose centre is farther away does not touch the region
        cubes = cubes[is_near(cubes, edge * 3**0.5 / 2)]
    return SizeCubes(*(np.concatenate(parts) for parts in zip(*accepted, strict=True)))
