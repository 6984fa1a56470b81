"""Check that the bodies of a scene fit: inclusions inside the tissue and apart, the probe on top of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import combinations, pairwise

from geometry.common.errors import InputError, Words
from geometry.common.limits import format_maximum_mm, format_minimum_mm, is_at_least
from geometry.common.percent import format_percent
from geometry.scenes.film import Film
from geometry.scenes.probe import Probe, format_mm
from geometry.scenes.scene_tables import Inclusion, SceneTables

Matrix = list[list[float]]
_SEARCH_STEPS = 60  # each leaves two thirds of an interval: 1e-10 of it in the end
_DIRECTION_COUNT = 72  # in which a body's reach is looked for
_MAX_EDGE_FRACTION, _MIN_EDGE_FRACTION = 0.4, 0.1  # edge radii: of the smallest part of a block, and of the gap or that part
_MAX_INSET_FRACTION = 0.98  # of half the ring's wall, or of the inner radius: beyond, hardly an electrode is left
_INSET_SEPARATION = 0.01  # of an edge's radius: mesh lines of edge and inset nearer than this make cells without area
_TOUCHING_FACTOR = 1 + 1e-9  # bodies nearer than this, relative to their size, count as touching


def check_bodies_fit(scene: SceneTables) -> None:
    """Raise ``InputError`` naming the key at fault if the scene's bodies do not fit."""
    targets = [index for index, body in enumerate(scene.inclusion) if body.target]
    if len(targets) > 1:
        raise InputError(f"inclusion[{targets[1]}].target", True, f"true for one inclusion (it is for inclusion[{targets[0]}])")
    _check_probe(scene)
    _check_edges(scene)
    _check_insets(scene)
    _check_layers(scene)
    _check_load(scene)
    bodies = [(index, body) for index, body in enumerate(scene.inclusion) if body.surface is None]
    for index, body in bodies:
        _check_inside(scene, index, body)
    for (i, first), (j, second) in combinations(bodies, 2):
        if do_overlap(first, second):
            raise InputError(f"inclusion[{j}].depth", format_mm(second.depth), f"inclusions apart (it overlaps inclusion[{i}])")


def compute_semi_axes(body: Inclusion) -> Matrix:
    """Return the semi-axes of the ellipsoid as columns, R diag(a), 3 x 3, in m."""
    diameters = body.diameters if body.diameters is not None else (body.diameter or 0.0,) * 3
    rotation = _build_rotation_matrix(*(math.radians(angle) for angle in body.orientation))
    return [[entry * diameter / 2 for entry, diameter in zip(row, diameters, strict=True)] for row in rotation]


def compute_offset(scene: SceneTables, body: Inclusion) -> float:
    """Return the distance of an inclusion's centre from the probe's axis at the tissue's surface, m."""
    return math.hypot(body.x - scene.placement.x, body.y - scene.placement.y)


def do_overlap(first: Inclusion, second: Inclusion) -> bool:
    """Return whether two ellipsoids overlap or touch.

    Perram & Wertheim, J. Comput. Phys. 58 (1985) 409: they are apart exactly if
    max over 0 < s < 1 of s (1-s) v^T [(1-s) Q1 + s Q2]^-1 v exceeds 1. v joins the centres; Q = a a^T with the semi-axes as the
    columns of a.
    """
    v = [second.x - first.x, second.y - first.y, first.depth - second.depth]
    distance, (low, high) = math.hypot(*v), sorted((_compute_half_extent(first), _compute_half_extent(second)))
    if distance > (low + high) * _TOUCHING_FACTOR:
        return False
    if first.diameter is not None and second.diameter is not None:
        return True
    a1, a2 = compute_semi_axes(first), compute_semi_axes(second)

    def measure_separation(s: float) -> float:
        """Return the function of s above, with (1-s) Q1 + s Q2 = A A^T and A = [sqrt(1-s) a1, sqrt(s) a2], 3 x 6."""
        p, q = math.sqrt(1 - s), math.sqrt(s)
        rows = [[p * e for e in r1] + [q * e for e in r2] for r1, r2 in zip(a1, a2, strict=True)]
        return s * (1 - s) * _compute_min_norm_squared(rows, v)

    return _maximise(measure_separation, 0.0, 1.0) <= _TOUCHING_FACTOR


def _maximise(function: Callable[[float], float], low: float, high: float) -> float:
    """Return the maximum between two numbers of a function that has only one there, by ternary search."""
    for _ in range(_SEARCH_STEPS):
        left, right = low + (high - low) / 3, high - (high - low) / 3
        low, high = (left, high) if function(left) < function(right) else (low, right)
    return function((low + high) / 2)


def compute_lateral_reach(body: Inclusion) -> float:
    """Return the largest distance of the body's points from the tissue's axis, in m.

    The maximum over horizontal directions n of the support function n.c + sqrt(n^T Q n), with c the centre and Q as in
    ``do_overlap``: the best of ``_DIRECTION_COUNT`` directions, refined by ternary search.
    """
    if body.diameter is not None:
        return math.hypot(body.x, body.y) + body.diameter / 2
    first_axis, second_axis, _ = compute_semi_axes(body)

    def support(angle: float) -> float:
        """Return the support function in the direction n = (cos, sin) of an angle."""
        n, m = math.cos(angle), math.sin(angle)
        return n * body.x + m * body.y + math.hypot(*(n * a + m * b for a, b in zip(first_axis, second_axis, strict=True)))

    step = 2 * math.pi / _DIRECTION_COUNT
    best = max((step * k for k in range(_DIRECTION_COUNT)), key=support)
    return _maximise(support, best - step, best + step)


def list_doubts(scene: SceneTables) -> tuple[str, ...]:
    """Return a sentence for each value that is allowed, but probably has a wrong unit or digit."""
    probe, doubts = scene.probe, list[str]()
    if probe.gap > probe.inner_radius:
        widths = f"probe.gap = {format_mm(probe.gap)} is wider than probe.inner_radius, {format_mm(probe.inner_radius)}"
        doubts.append(f"{widths}: is its unit right?")
    for block, film, height in _list_films(probe):
        if film.stack_height > height:
            thicknesses = f"film and bonds of the {block} block are {format_mm(film.stack_height)} thick together"
            doubts.append(f"{thicknesses}, more than the block's height of {format_mm(height)}: are their units right?")
    return tuple(doubts)


def _list_films(probe: Probe) -> list[tuple[str, Film, float]]:
    """Return name, film and height (m) of each block; nothing for a probe without films."""
    if probe.film is None:
        return []
    return [*zip(("inner", "outer"), probe.film.by_block, (probe.core_height, probe.tube_height), strict=True)]


def _check_probe(scene: SceneTables) -> None:
    """Raise ``InputError`` unless the whole probe stands on the tissue's top."""
    placement, reach, tissue = scene.placement, scene.probe.tube_radius, scene.tissue
    if tissue.shape == "cylinder":
        _check_gap(scene.probe, tissue.radius)
        key = "x" if abs(placement.x) >= abs(placement.y) else "y"
        _check_probe_on_tissue(
            "radius",
            tissue.radius,
            reach,
            key=f"placement.{key}",
            position=getattr(placement, key),
            offset=math.hypot(placement.x, placement.y),
        )
    elif tissue.shape == "block":
        _check_gap(scene.probe, min(tissue.length, tissue.breadth) / 2)
        _check_probe_on_tissue(
            "length", tissue.length / 2, reach, key="placement.x", position=placement.x, offset=abs(placement.x)
        )
        _check_probe_on_tissue(
            "breadth", tissue.breadth / 2, reach, key="placement.y", position=placement.y, offset=abs(placement.y)
        )


def _check_gap(probe: Probe, half_size: float) -> None:
    """Refuse the gap if it is wider than the inner block's radius and the probe would fit the tissue with a narrower gap.

    ``half_size`` is the tissue's radius, or half the shorter side of a block, in m. The probe's radius depends on the gap
    where the scene gives ``area_ratio``.
    """
    square = half_size**2 - probe.tube_radius**2 + probe.hole_radius**2  # of the hole's radius with which the probe just fits
    if probe.area_ratio is None or not probe.gap > probe.inner_radius or square <= probe.inner_radius**2:
        return
    widest = math.sqrt(square) - probe.inner_radius
    if is_at_least(probe.gap, widest):
        raise InputError(
            "probe.gap",
            format_mm(probe.gap),
            f"less than {format_maximum_mm(widest)} (the whole probe has to stand on the tissue)",
        )


def _check_edges(scene: SceneTables) -> None:
    """Raise ``InputError`` if round edges leave no face between them, or are too sharp for any mesh."""
    probe, radius = scene.probe, scene.contact.edge_radius
    size = min(probe.inner_radius, probe.tube_radius - probe.hole_radius, probe.core_height, probe.tube_height)
    if radius > _MAX_EDGE_FRACTION * size:
        reason = f"{_MAX_EDGE_FRACTION:g} of the blocks' radius, wall and heights"
        raise InputError(
            "contact.edge_radius",
            format_mm(radius),
            f"up to {format_maximum_mm(_MAX_EDGE_FRACTION * size)} ({reason}), or 0: sharp",
        )
    low = _MIN_EDGE_FRACTION * min(size, probe.gap)
    if 0 < radius < low:
        raise InputError("contact.edge_radius", format_mm(radius), f"0, sharp, or {format_minimum_mm(low)} or more")


def _check_insets(scene: SceneTables) -> None:
    """Raise ``InputError`` if an electrode's inset leaves no electrode, or ends where the block's round edge does."""
    probe, edge = scene.probe, scene.contact.edge_radius
    widths = {"inner": probe.inner_radius, "outer": (probe.tube_radius - probe.hole_radius) / 2}
    for block, film, _ in _list_films(probe):
        assert probe.film is not None  # else the list is empty
        inset, limit = film.electrode_inset, _MAX_INSET_FRACTION * widths[block]
        table = "probe.film" if film.electrode_inset == probe.film.electrode_inset else "probe.film.outer"
        if inset > limit:
            width = "the inner block's radius" if block == "inner" else "half the outer block's wall"
            allowed = f"up to {format_maximum_mm(limit)}, {_MAX_INSET_FRACTION:g} of {width}: some electrode has to be left"
            raise InputError(f"{table}.electrode_inset", format_mm(inset), allowed)
        if edge > 0 and abs(inset - edge) < _INSET_SEPARATION * edge:
            reason = f"mesh lines of both would coincide: contact.edge_radius is {format_mm(edge)}"
            allowed = f"more than {format_percent(_INSET_SEPARATION, 6)} above or below contact.edge_radius ({reason})"
            raise InputError(f"{table}.electrode_inset", format_mm(inset), allowed)


def _check_layers(scene: SceneTables) -> None:
    """Raise ``InputError`` if a layer reaches the tissue's bottom."""
    tissue = scene.tissue
    for index, (upper, lower) in enumerate(pairwise((0.0, *tissue.interfaces))):
        if is_at_least(lower, tissue.bottom):
            reason = f"the tissue's own material has to be below the layers, and it is {format_mm(tissue.bottom)} deep"
            allowed = f"less than {format_maximum_mm(tissue.bottom - upper)}: {reason}"
            raise InputError(f"tissue.layer[{index}].thickness", format_mm(tissue.layer[index].thickness), allowed)


def _check_load(scene: SceneTables) -> None:
    """Raise ``InputError`` if the indentation is as large as the tissue is deep."""
    deep, tissue = scene.load.indentation, scene.tissue
    if deep is not None and is_at_least(deep, tissue.bottom):
        raise InputError("load.indentation", format_mm(deep), f"less than the tissue's depth of {format_mm(tissue.bottom)}")


def _check_probe_on_tissue(size: str, half_size: float, reach: float, *, key: str, position: float, offset: float) -> None:
    """Raise ``InputError`` if the probe does not stand on the tissue along one of its sizes.

    ``size`` is that key of the tissue, ``half_size`` its half (or the radius) and ``reach`` the probe's radius, in m. ``key`` and
    ``position`` are those of the placement, for the message; ``offset`` is the distance between the axes.
    """
    reason = f"the whole probe, of radius {format_mm(reach)}, has to stand on the tissue"
    if is_at_least(reach, half_size):
        times = 1 if size == "radius" else 2
        raise InputError(f"tissue.{size}", format_mm(times * half_size), f"above {format_minimum_mm(times * reach)} ({reason})")
    if is_at_least(offset + reach, half_size):
        raise InputError(
            key,
            format_mm(position),
            f"the probe's axis less than {format_maximum_mm(half_size - reach)} from the tissue's ({reason})",
        )


def _check_inside(scene: SceneTables, index: int, body: Inclusion) -> None:
    """Raise ``InputError`` if an ellipsoid reaches beyond the tissue's surface, bottom or side."""
    tissue, name = scene.tissue, f"inclusion[{index}]"
    half = [math.hypot(*row) for row in compute_semi_axes(body)]
    if is_at_least(2 * half[2], tissue.bottom):  # at no depth: its size is the mistake
        size = format_mm(body.diameter) if body.diameter is not None else Words(f"{format_mm(2 * half[2])} high")
        allowed_size = f"a smaller body: the tissue ends {format_mm(tissue.bottom)} deep"
        raise InputError(f"{name}.{'diameters' if body.diameter is None else 'diameter'}", size, allowed_size)
    if is_at_least(half[2], body.depth):
        raise InputError(
            f"{name}.depth", format_mm(body.depth), f"above {format_minimum_mm(half[2])} (it leaves the tissue's surface)"
        )
    if is_at_least(body.depth + half[2], tissue.bottom):
        allowed_depth = f"a centre less than {format_maximum_mm(tissue.bottom - half[2])} deep"
        raise InputError(
            f"{name}.depth",
            format_mm(body.depth),
            f"{allowed_depth} (it leaves the tissue's bottom at {format_mm(tissue.bottom)})",
        )
    if tissue.shape == "cylinder" and is_at_least(compute_lateral_reach(body), tissue.radius):
        key = "x" if abs(body.x) >= abs(body.y) else "y"
        allowed_position = (
            f"the whole body within {format_maximum_mm(tissue.radius)} of the tissue's axis (it leaves the tissue's side)"
        )
        raise InputError(f"{name}.{key}", format_mm(getattr(body, key)), allowed_position)
    if tissue.shape == "block":
        _check_inside_block(name, body, half, (tissue.length / 2, tissue.breadth / 2))


def _check_inside_block(name: str, body: Inclusion, half_extents: list[float], half_sides: tuple[float, float]) -> None:
    """Raise ``InputError`` if an ellipsoid reaches beyond a side of a block of tissue.

    ``name`` is the inclusion's in messages, ``half_extents`` are the ellipsoid's along x, y and z, ``half_sides`` those of the
    block along x and y, m.
    """
    for key, centre, half_extent, half_side in zip("xy", (body.x, body.y), half_extents, half_sides, strict=False):
        if is_at_least(abs(centre) + half_extent, half_side):
            allowed = f"the whole body within {format_maximum_mm(half_side)} of the tissue's middle (it leaves the tissue's side)"
            raise InputError(f"{name}.{key}", format_mm(centre), allowed)


def _compute_half_extent(body: Inclusion) -> float:
    """Return the largest semi-axis of an ellipsoid, m."""
    return max(body.diameters or (body.diameter or 0.0,)) / 2


def _build_rotation_matrix(rz: float, ry: float, rx: float) -> Matrix:
    """Return the rotation matrix about the fixed axes x, then y, then z: R = Rz Ry Rx; angles in rad."""
    (cz, sz), (cy, sy), (cx, sx) = ((math.cos(a), math.sin(a)) for a in (rz, ry, rx))
    return [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]


def _compute_min_norm_squared(rows: Matrix, v: list[float]) -> float:
    """Return v^T (A A^T)^-1 v, the squared norm of the shortest w with A w = v, for A of full rank with the three ``rows``.

    By the triangle R of A^T = Q R: so the small semi-axes of a needle stay exact, while in A A^T their squares would be lost in
    rounding errors.
    """
    import numpy as np

    _, triangle = np.linalg.qr(np.array(rows).T)
    shortest = np.linalg.solve(triangle.T, np.array(v))
    return float(shortest @ shortest)
