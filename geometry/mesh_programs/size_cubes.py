"""A field of sizes as cubes, halved until each is as small as what is wanted at its middle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points

_CUBE_EDGE_FRACTION = 0.8  # of the sizes wanted: edges of cubes that tell them closely
_MAX_CUBES = 200_000  # cubes of one edge: a mesh of more than a million tetrahedra need not be told more closely
_CHILD_OFFSETS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 4


@dataclass(frozen=True)
class SizeCubes:
    """Cubes that cover what is meshed, in m.

    Attributes:
        middles: (n, 3).
        edges: of the cubes, (n,).
        sizes: wanted of tetrahedra at the middles, (n,).
    """

    middles: Points
    edges: Points
    sizes: Points


def build_size_cubes(
    sizes: Callable[[Points], Points], is_near: Callable[[Points, float], NDArray[np.bool_]], *, centre: Points, edge: float
) -> SizeCubes:
    """Halve a cube until its parts are not larger than a share of the sizes at their middles.

    Args:
        sizes: lengths at points (n, 3).
        is_near: which points (n, 3) lie in what is meshed or within a distance of it; the others' cubes are left out.
        centre: of the cube that begins, (3,).
        edge: of that cube.
    """
    cubes, accepted = centre[None, :], []
    while len(cubes):
        size = sizes(cubes)
        small = (edge <= _CUBE_EDGE_FRACTION * size) | (len(cubes) > _MAX_CUBES)
        accepted.append((cubes[small], np.full(np.count_nonzero(small), edge), size[small]))
        cubes = (cubes[~small][:, None] + edge * _CHILD_OFFSETS).reshape(-1, 3)
        edge /= 2
        cubes = cubes[is_near(cubes, edge * 3**0.5 / 2)]
    return SizeCubes(*(np.concatenate(parts) for parts in zip(*accepted, strict=True)))
