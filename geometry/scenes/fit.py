"""Whether the bodies of a scene fit: inclusions inside the tissue and apart, the probe on top of it."""

from __future__ import annotations

import math
from itertools import combinations, pairwise
from typing import TYPE_CHECKING

from geometry.common.errors import InputError
from geometry.common.limits import least_mm, most_mm, reaches
from geometry.scenes.probe import mm

if TYPE_CHECKING:
    from collections.abc import Callable

    from geometry.scenes.probe import Probe
    from geometry.scenes.scene import Inclusion, Scene

Matrix = list[list[float]]
_DIRECTIONS = 72  # in which a body's reach is looked for
_LARGEST_EDGE, _LEAST_EDGE = 0.4, 0.1  # edge radii: of the least part of a block, and of the gap or that part
_TOUCHING = 1 + 1e-9  # bodies nearer than this, relative to their size, count as touching


def check(scene: Scene) -> None:
    """Raise ``InputError`` naming the key at fault if the scene's bodies do not fit."""
    targets = [index for index, body in enumerate(scene.inclusion) if body.target]
    if len(targets) > 1:
        raise InputError(f"inclusion[{targets[1]}].target", True, f"true for one inclusion (it is for inclusion[{targets[0]}])")
    _check_probe(scene)
    _check_edges(scene)
    _check_layers(scene)
    _check_load(scene)
    bodies = [(index, body) for index, body in enumerate(scene.inclusion) if body.surface is None]
    for index, body in bodies:
        _check_inside(scene, index, body)
    for (i, one), (j, other) in combinations(bodies, 2):
        if overlap(one, other):
            raise InputError(f"inclusion[{j}].depth", mm(other.depth), f"inclusions apart (it overlaps inclusion[{i}])")


def semi_axes(body: Inclusion) -> Matrix:
    """Return the semi-axes of the ellipsoid as columns, R diag(a), 3 x 3, in m."""
    diameters = body.diameters if body.diameters is not None else (body.diameter or 0.0,) * 3
    rotation = _rotation(*(math.radians(angle) for angle in body.orientation))
    return [[entry * diameter / 2 for entry, diameter in zip(row, diameters, strict=True)] for row in rotation]


def overlap(one: Inclusion, other: Inclusion) -> bool:
    """Return whether two ellipsoids overlap or touch.

    Perram & Wertheim, J. Comput. Phys. 58 (1985) 409: they are apart exactly if
    max over 0 < s < 1 of s (1-s) v^T [(1-s) Q1 + s Q2]^-1 v exceeds 1, v joining the centres.
    """
    v = [other.x - one.x, other.y - one.y, one.depth - other.depth]
    distance, (low, high) = math.hypot(*v), sorted((_extent(one), _extent(other)))
    if distance > (low + high) * _TOUCHING:
        return False
    if one.diameter is not None and other.diameter is not None:
        return True
    a1, a2 = semi_axes(one), semi_axes(other)

    def apart(s: float) -> float:
        p, q = math.sqrt(1 - s), math.sqrt(s)
        rows = [[p * e for e in r1] + [q * e for e in r2] for r1, r2 in zip(a1, a2, strict=True)]
        return s * (1 - s) * _least_square(rows, v)

    return not _exceeds(apart, _TOUCHING)


def _exceeds(function: Callable[[float], float], bound: float) -> bool:
    """Return whether a concave function exceeds the bound between 0 and 1, by ternary search."""
    low, high = 0.0, 1.0
    for _ in range(100):
        left, right = low + (high - low) / 3, high - (high - low) / 3
        at_left, at_right = function(left), function(right)
        if max(at_left, at_right) > bound:
            return True
        low, high = (left, high) if at_left < at_right else (low, right)
    return False


def lateral_reach(body: Inclusion) -> float:
    """Return the largest distance of the body's points from the tissue's axis, in m.

    The maximum over directions n of the support function n.c + sqrt(n^T Q n): the best of some directions, refined.
    """
    if body.diameter is not None:
        return math.hypot(body.x, body.y) + body.diameter / 2
    across, along, _ = semi_axes(body)

    def support(angle: float) -> float:
        n, m = math.cos(angle), math.sin(angle)
        return n * body.x + m * body.y + math.hypot(*(n * a + m * b for a, b in zip(across, along, strict=True)))

    step = 2 * math.pi / _DIRECTIONS
    best = max((step * k for k in range(_DIRECTIONS)), key=support)
    low, high = best - step, best + step
    for _ in range(60):
        left, right = low + (high - low) / 3, high - (high - low) / 3
        low, high = (left, high) if support(left) < support(right) else (low, right)
    return support((low + high) / 2)


def doubts(scene: Scene) -> tuple[str, ...]:
    """Return what is allowed but probably a slip of a unit or a digit, each in a sentence."""
    probe = scene.probe
    if probe.gap <= probe.inner_radius:
        return ()
    return (f"probe.gap = {mm(probe.gap)} is wider than probe.inner_radius, {mm(probe.inner_radius)}: is its unit right?",)


def _check_probe(scene: Scene) -> None:
    at, reach, tissue = scene.placement, scene.probe.tube_radius, scene.tissue
    if tissue.shape == "cylinder":
        _check_gap(scene.probe, tissue.radius)
        key = "x" if abs(at.x) >= abs(at.y) else "y"
        _check_stands(
            "radius", tissue.radius, reach, key=f"placement.{key}", position=getattr(at, key), offset=math.hypot(at.x, at.y)
        )
    elif tissue.shape == "block":
        _check_gap(scene.probe, min(tissue.length, tissue.breadth) / 2)
        _check_stands("length", tissue.length / 2, reach, key="placement.x", position=at.x, offset=abs(at.x))
        _check_stands("breadth", tissue.breadth / 2, reach, key="placement.y", position=at.y, offset=abs(at.y))


def _check_gap(probe: Probe, room: float) -> None:
    """Blame the gap for a probe larger than the tissue where it is wider than the core, and with less of it the probe fits."""
    square = room**2 - probe.tube_radius**2 + probe.hole_radius**2  # of the hole's radius with which the probe just fits
    if probe.area_ratio is None or not probe.gap > probe.inner_radius or square <= probe.inner_radius**2:
        return
    widest = math.sqrt(square) - probe.inner_radius
    if reaches(probe.gap, widest):
        raise InputError("probe.gap", mm(probe.gap), f"less than {most_mm(widest)} (the whole probe has to stand on the tissue)")


def _check_edges(scene: Scene) -> None:
    """A face has to be left between round edges; how much sharper ones close no mesh follows."""
    probe, radius = scene.probe, scene.contact.edge_radius
    size = min(probe.inner_radius, probe.tube_radius - probe.hole_radius, probe.core_height, probe.tube_height)
    if radius > _LARGEST_EDGE * size:
        why = f"{_LARGEST_EDGE:g} of the blocks' radius, wall and heights"
        raise InputError("contact.edge_radius", mm(radius), f"up to {most_mm(_LARGEST_EDGE * size)} ({why}), or 0: sharp")
    low = _LEAST_EDGE * min(size, probe.gap)
    if 0 < radius < low:
        raise InputError("contact.edge_radius", mm(radius), f"0, sharp, or {least_mm(low)} or more")


def _check_layers(scene: Scene) -> None:
    tissue = scene.tissue
    for index, (upper, lower) in enumerate(pairwise((0.0, *tissue.interfaces))):
        if tissue.shape != "half-space" and reaches(lower, tissue.depth):
            own = f"the tissue's own material has to be below the layers, and it is {mm(tissue.depth)} deep"
            allowed = f"less than {most_mm(tissue.depth - upper)}: {own}"
            raise InputError(f"tissue.layer[{index}].thickness", mm(tissue.layer[index].thickness), allowed)


def _check_load(scene: Scene) -> None:
    deep, tissue = scene.load.indentation, scene.tissue
    if deep is not None and tissue.shape != "half-space" and reaches(deep, tissue.depth):
        raise InputError("load.indentation", mm(deep), f"less than the tissue's depth of {mm(tissue.depth)}")


def _check_stands(size: str, room: float, reach: float, *, key: str, position: float, offset: float) -> None:
    why = f"the whole probe, of radius {mm(reach)}, has to stand on the tissue"
    if reaches(reach, room):
        times = 1 if size == "radius" else 2
        raise InputError(f"tissue.{size}", mm(times * room), f"above {least_mm(times * reach)} ({why})")
    if reaches(offset + reach, room):
        raise InputError(key, mm(position), f"the probe's axis less than {most_mm(room - reach)} from the tissue's ({why})")


def _check_inside(scene: Scene, index: int, body: Inclusion) -> None:
    tissue, name = scene.tissue, f"inclusion[{index}]"
    half = [math.hypot(*row) for row in semi_axes(body)]
    if reaches(half[2], body.depth):
        raise InputError(f"{name}.depth", mm(body.depth), f"above {least_mm(half[2])} (it leaves the tissue's surface)")
    if tissue.shape != "half-space" and reaches(body.depth + half[2], tissue.depth):
        least = f"a centre less than {most_mm(tissue.depth - half[2])} deep" if tissue.depth > 2 * half[2] else "a smaller body"
        raise InputError(f"{name}.depth", mm(body.depth), f"{least} (it leaves the tissue's bottom at {mm(tissue.depth)})")
    if tissue.shape == "cylinder" and reaches(lateral_reach(body), tissue.radius):
        key = "x" if abs(body.x) >= abs(body.y) else "y"
        at = f"the whole body within {most_mm(tissue.radius)} of the tissue's axis (it leaves the tissue's side)"
        raise InputError(f"{name}.{key}", mm(getattr(body, key)), at)
    if tissue.shape == "block":
        _check_beside(name, body, half, (tissue.length / 2, tissue.breadth / 2))


def _check_beside(name: str, body: Inclusion, half: list[float], rooms: tuple[float, float]) -> None:
    for key, centre, size, room in zip("xy", (body.x, body.y), half, rooms, strict=False):
        if reaches(abs(centre) + size, room):
            at = f"the whole body within {most_mm(room)} of the tissue's middle (it leaves the tissue's side)"
            raise InputError(f"{name}.{key}", mm(centre), at)


def _extent(body: Inclusion) -> float:
    return max(body.diameters or (body.diameter or 0.0,)) / 2


def _rotation(rz: float, ry: float, rx: float) -> Matrix:
    """Return the rotation matrix about the fixed axes x, then y, then z: R = Rz Ry Rx; angles in rad."""
    (cz, sz), (cy, sy), (cx, sx) = ((math.cos(a), math.sin(a)) for a in (rz, ry, rx))
    return [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]


def _least_square(rows: Matrix, v: list[float]) -> float:
    """Return v^T (A A^T)^-1 v, the squared norm of the shortest w with A w = v, for A of full rank with the three ``rows``.

    By orthogonalising the rows: the semi-axes of a needle stay exact where their squares in A A^T would drown.
    """
    basis: Matrix = []
    total, solved = 0.0, list[float]()
    for row, component in zip(rows, v, strict=True):
        rest, projected = list(row), 0.0
        for unit, part in zip(basis, solved, strict=True):
            along = _dot(rest, unit)
            rest = [a - along * b for a, b in zip(rest, unit, strict=True)]
            projected += along * part
        length = math.hypot(*rest)
        basis.append([a / length for a in rest])
        solved.append((component - projected) / length)
        total += solved[-1] ** 2
    return total


def _dot(one: list[float], other: list[float]) -> float:
    return sum(a * b for a, b in zip(one, other, strict=True))
