"""Whether the bodies of a scene fit: inclusions inside the tissue and apart, the probe on top of it."""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING

from geometry.errors import InputError
from geometry.probe import mm

if TYPE_CHECKING:
    from geometry.scene import Inclusion, Scene

Matrix = list[list[float]]


def check(scene: Scene) -> None:
    """Raise ``InputError`` naming the key at fault if the scene's bodies do not fit."""
    if sum(body.target for body in scene.inclusion) > 1:
        raise InputError("inclusion.target", True, "true for one inclusion at most")
    _check_probe(scene)
    bodies = [(index, body) for index, body in enumerate(scene.inclusion) if body.surface is None]
    for index, body in bodies:
        _check_inside(scene, index, body)
    for (i, one), (j, other) in combinations(bodies, 2):
        if overlap(one, other):
            raise InputError(f"inclusion[{j}].depth", mm(other.depth), f"inclusions apart (it overlaps inclusion[{i}])")


def shape_matrix(body: Inclusion) -> Matrix:
    """The matrix Q of the ellipsoid (p-c)^T Q^-1 (p-c) <= 1, 3 x 3, in m^2: R diag(a^2) R^T with semi-axes a."""
    diameters = body.diameters if body.diameters is not None else (body.diameter or 0.0,) * 3
    rotation = _rotation(*(math.radians(angle) for angle in body.orientation))
    squares = [(diameter / 2) ** 2 for diameter in diameters]
    return [[sum(row[k] * squares[k] * col[k] for k in range(3)) for col in rotation] for row in rotation]


def overlap(one: Inclusion, other: Inclusion) -> bool:
    """Whether two ellipsoids overlap or touch.

    Perram & Wertheim, J. Comput. Phys. 58 (1985) 409: they are apart exactly if
    max over 0 < s < 1 of s (1-s) v^T [(1-s) Q1 + s Q2]^-1 v exceeds 1, v joining the centres.
    """
    q1, q2 = shape_matrix(one), shape_matrix(other)
    v = [other.x - one.x, other.y - one.y, one.depth - other.depth]

    def contact(s: float) -> float:
        mixed = [[(1 - s) * a + s * b for a, b in zip(r1, r2, strict=True)] for r1, r2 in zip(q1, q2, strict=True)]
        return s * (1 - s) * _quadratic_form_of_inverse(mixed, v)

    low, high = 0.0, 1.0
    for _ in range(100):  # the function is concave: ternary search
        left, right = low + (high - low) / 3, high - (high - low) / 3
        low, high = (left, high) if contact(left) < contact(right) else (low, right)
    return contact((low + high) / 2) <= 1 + 1e-9


def lateral_reach(body: Inclusion, samples: int = 720) -> float:
    """Largest distance of the body's points from the tissue's axis, in m.

    The maximum over directions n of the support function n.c + sqrt(n^T Q n), bounded from above.
    """
    if body.diameter is not None:
        return math.hypot(body.x, body.y) + body.diameter / 2
    q = shape_matrix(body)
    angles = (2 * math.pi * k / samples for k in range(samples))
    directions = ((math.cos(angle), math.sin(angle)) for angle in angles)
    return max(
        n * body.x + m * body.y + math.sqrt(n * n * q[0][0] + 2 * n * m * q[0][1] + m * m * q[1][1]) for n, m in directions
    )


def _check_probe(scene: Scene) -> None:
    tissue, at, reach = scene.tissue, scene.placement, scene.probe.tube_radius
    if tissue.shape == "cylinder":
        rooms = [("tissue.radius", tissue.radius, math.hypot(at.x, at.y) + reach)]
    elif tissue.shape == "block":
        rooms = [
            ("tissue.length", tissue.length, 2 * (abs(at.x) + reach)),
            ("tissue.breadth", tissue.breadth, 2 * (abs(at.y) + reach)),
        ]
    else:
        rooms = []
    for key, room, used in rooms:
        if used >= room:
            why = "the whole probe, from its placement and outer radius, has to stand on the tissue"
            raise InputError(key, mm(room), f"above {mm(used)} ({why})")


def _check_inside(scene: Scene, index: int, body: Inclusion) -> None:
    tissue, name = scene.tissue, f"inclusion[{index}]"
    half = _half_sizes(body)
    if body.depth <= half[2]:
        raise InputError(f"{name}.depth", mm(body.depth), f"above {mm(half[2])} (it leaves the tissue's surface)")
    if tissue.shape != "half-space" and body.depth + half[2] >= tissue.depth:
        raise InputError(f"{name}.depth", mm(body.depth), f"below {mm(tissue.depth - half[2])} (it leaves the tissue's bottom)")
    if tissue.shape == "cylinder" and lateral_reach(body) >= tissue.radius:
        at = f"within {mm(tissue.radius)} of the tissue's axis (it leaves the tissue's side)"
        raise InputError(f"{name}.x", mm(body.x), at)
    if tissue.shape == "block":
        for k, key, room, centre in ((0, "x", tissue.length / 2, body.x), (1, "y", tissue.breadth / 2, body.y)):
            if abs(centre) + half[k] >= room:
                raise InputError(f"{name}.{key}", mm(centre), f"within {mm(room - half[k])} of 0 (it leaves the tissue's side)")


def _half_sizes(body: Inclusion) -> list[float]:
    if body.diameter is not None:
        return [body.diameter / 2] * 3
    q = shape_matrix(body)
    return [math.sqrt(q[k][k]) for k in range(3)]


def _rotation(rz: float, ry: float, rx: float) -> Matrix:
    """Turn about the fixed axes x, then y, then z: R = Rz Ry Rx."""
    (cz, sz), (cy, sy), (cx, sx) = ((math.cos(a), math.sin(a)) for a in (rz, ry, rx))
    return [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]


def _quadratic_form_of_inverse(m: Matrix, v: list[float]) -> float:
    """v^T m^-1 v for a symmetric positive definite 3 x 3 matrix, by its Cholesky factor."""
    total, factor, solved = 0.0, [[0.0] * 3 for _ in range(3)], [0.0] * 3
    for i in range(3):
        for j in range(i + 1):
            rest = m[i][j] - sum(factor[i][k] * factor[j][k] for k in range(j))
            factor[i][j] = math.sqrt(rest) if i == j else rest / factor[j][j]
        solved[i] = (v[i] - sum(factor[i][k] * solved[k] for k in range(i))) / factor[i][i]
        total += solved[i] ** 2
    return total
