"""A field of sizes as cubes, halved until each is as small as what is wanted at its middle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geometry.common.arrays import Points

_SHARE = 0.8  # of the sizes wanted: edges of cubes that tell them closely
_MOST = 200_000  # cubes of one edge: a mesh of more than a million tetrahedra need not be told more closely
_CHILDREN = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 4


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


def size_cubes(
    sizes: Callable[[Points], Points], near: Callable[[Points, float], NDArray[np.bool_]], *, centre: Points, edge: float
) -> SizeCubes:
    """Halve a cube until its parts are not larger than a share of the sizes at their middles.

    Args:
        sizes: lengths at points (n, 3).
        is_near: which points (n, 3) lie in what is meshed or within a distance of it; the others' cubes are left out.
        centre: of the cube that begins, (3,).
        edge: of that cube.
    """
    cubes, found = centre[None, :], []
    while len(cubes):
        size = sizes(cubes)
        small = (edge <= _SHARE * size) | (len(cubes) > _MOST)
        found.append((cubes[small], np.full(np.count_nonzero(small), edge), size[small]))
        cubes = (cubes[~small][:, None] + edge * _CHILDREN).reshape(-1, 3)
        edge /= 2
        cubes = cubes[near(cubes, edge * 3**0.5 / 2)]
    return SizeCubes(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
