"""Meridian meshes: cells cover every promised section once, nodes are smooth in its lengths, elements have their energies."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from geometry.errors import SolveError
from geometry.frame import Fineness, Layout
from geometry.frame import kind as kind_of
from geometry.grading import folds, graded, smooth_max, smooth_min
from geometry.meridian import SQUARE, Topology, labels, nodes, topology
from geometry.probe import Material
from geometry.section import Body, Section
from solver.base_states import model
from solver.convergence import LEVELS
from solver.derivatives import velocities
from solver.numbering import Numbering, numbering
from solver.quadrilateral import Geometry, geometry, gradients, matrices, projected
from solver.sections import HALF_SPACE
from solver.shapes import functions, shapes

COARSE = Fineness(1, 2, 4)
few, many = (settings(derandomize=True, deadline=None, max_examples=count) for count in (100, 250))


def section(
    inner: Any = 5e-3,
    gap: Any = 1e-4,
    area_ratio: Any = 3.7,
    inner_height: Any = 1.0,
    outer_height: Any = 1.0,
    sphere: Any = 0.0,
    cover: Any = 1.0,
    below: Any = 5.0,
    beside: Any = 7.0,
    **layers: Any,
) -> Section:
    """A section by numbers that may be any positive ones: heights in inner radii, the sphere's radius in the tube's.

    ``cover`` and ``below`` are the tissue above and below the sphere in its diameters (without one, the tissue is ``below``
    tube radii deep), ``beside`` that beyond probe and sphere in the wider one's radii. Film and adhesive are lengths,
    the base's sizes are told in tube radii, ``flange`` from the tube to the edge.
    """
    hole = inner + gap
    tube = (hole**2 + inner**2 / area_ratio) ** 0.5
    s = sphere * tube
    widest = s if np.real(s) > np.real(tube) else tube
    depth = 2 * s * (1 + cover + below) if sphere else below * tube
    sizes = {name: layers.get(name, 0.0) * tube for name in ("flange_thickness", "step_height")}
    flange = tube * (1 + layers["flange"]) if "flange" in layers else 0.0
    blocks = inner, hole, tube, inner * inner_height, inner * outer_height
    body = (s, s * (1 + 2 * cover)) if sphere else (0.0, 0.0)
    films = layers.get("film", 0.0), layers.get("adhesive", 0.0)
    return Section(*blocks, widest * (1 + beside), depth, *body, *films, flange, **sizes)


def between(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(math.log(low), math.log(high)).map(math.exp)


BLOCKS = {
    "inner": between(1e-4, 2e-2),
    "gap": between(5e-6, 5e-3),
    "area_ratio": between(0.05, 50),
    "inner_height": between(0.05, 10),
    "outer_height": between(0.05, 10),
    "beside": between(0.02, HALF_SPACE),
}
NO_SPHERE = {"below": between(0.02, HALF_SPACE)}
SPHERE = {"sphere": between(0.05, 20), "cover": between(0.005, 3), "below": between(0.005, HALF_SPACE)}
FILM = {"film": between(1e-6, 1e-3)}
BASE = {"flange_thickness": between(0.05, 2), "step_height": between(0.05, 2)}
films = st.sampled_from([{}, FILM, FILM | {"adhesive": between(1e-6, 1e-3)}])
bases = st.sampled_from([{}, BASE, BASE | {"flange": between(0.02, 2)}])
numbers = st.tuples(st.sampled_from([NO_SPHERE, SPHERE, SPHERE]), films, bases).flatmap(
    lambda parts: st.fixed_dictionaries(BLOCKS | parts[0] | parts[1] | parts[2])
)

PAPER: dict[str, float] = {"sphere": 0.7, "cover": 0.5}
DEFAULTS = {"inner": 5e-3, "gap": 1e-4, "area_ratio": 3.7, "inner_height": 1.0, "outer_height": 1.0, "below": 5.0, "beside": 7.0}
ELASTIC = {"flange_thickness": 0.3, "step_height": 0.2, "flange": 0.25}
FILMS_AND_BASE = ELASTIC | {"film": 1.1e-4, "adhesive": 5e-5}
HAIRLINE = ELASTIC | {"gap": 1e-5, "area_ratio": 0.1, "inner_height": 0.5, "outer_height": 0.5, "sphere": 0.3}
FLAT = {"inner_height": 0.1, "outer_height": 0.1, "below": 1.0}
ROOMY = {"area_ratio": 1.0, "below": 1.0, "beside": 3.0}
# kinds that random numbers seldom meet
SPECIAL: dict[str, dict[str, float]] = {
    "the paper's": PAPER,
    "box in a gap of two columns and one": FLAT | {"gap": 2e-3, "area_ratio": 2.0, "sphere": 0.5},
    "box in a gap of one column and two": ROOMY | {"gap": 5e-3, "sphere": 0.3, "cover": 2.0},
    "box in a gap beyond the inner radius": FLAT | ROOMY | {"gap": 3e-3, "sphere": 0.5},
    "thin cover": PAPER | {"cover": 0.005, "below": 0.005},
    "sphere wider than the probe": {"sphere": 20.0, "cover": 0.005, "beside": 0.02},
    "sheet": {"below": 0.02, "beside": HALF_SPACE},
    "half-space": {"below": HALF_SPACE, "beside": HALF_SPACE},
    "boss": PAPER | FILMS_AND_BASE | {"inner_height": 0.5},
    "recess": PAPER | FILMS_AND_BASE | {"inner_height": 1.5},
    "level base": PAPER | FILMS_AND_BASE,
    # lines across the gap numbered 20 and 21 beyond the inner radius: 0.15 of that is a whole number, or ends as a layer does
    "base twenty lines further": HAIRLINE | {"cover": 0.5},
    "base twenty-one lines further": HAIRLINE | {"cover": 0.1, "below": 1.0},
}
special = pytest.mark.parametrize("case", [pytest.param(case, id=name) for name, case in SPECIAL.items()])


def mesh_of(s: Section, fineness: Fineness = COARSE) -> Topology:
    return topology(kind_of(s), fineness)


def geometry_of(s: Section, mesh: Topology, order: int) -> Geometry:
    return geometry(nodes(s, mesh, shapes(order).places), shapes(order))


def ring(low: float, high: float) -> float:
    return math.pi * (high - low) * (high + low)


def volumes(s: Section) -> dict[Body, float]:
    """Of all bodies by closed forms; tissue with what is in it."""
    discs = ring(0, s.inner_radius), ring(s.hole_radius, s.tube_radius)
    found = {Body.TISSUE: ring(0, s.tissue_radius) * s.tissue_depth, Body.INCLUSION: 4 / 3 * math.pi * s.sphere_radius**3}
    found |= {Body.INNER: discs[0] * s.inner_height, Body.OUTER: discs[1] * s.outer_height}
    found |= {Body.FILM: sum(discs) * s.film, Body.ADHESIVE: sum(discs) * s.adhesive}
    if s.flange_thickness:
        high, middle = max(s.inner_height, s.outer_height), (s.inner_radius + s.hole_radius) / 2
        boss = ring(0, middle) * (high - s.inner_height) + ring(middle, s.tube_radius) * (high - s.outer_height)
        whole = ring(0, max(s.flange_radius, s.tube_radius)) * s.flange_thickness
        found[Body.BASE] = boss + ring(0, s.tube_radius) * s.step_height + whole
    return {body: volume for body, volume in found.items() if volume}


ARCS = 3e-6  # of a sphere's volume: what polynomials of order 6 leave out of arcs as long as the coarsest mesh has


def assert_covered_once(s: Section, mesh: Topology) -> None:
    """Bodies have their volumes; what tissue and sphere take from each other counts once."""
    at = geometry_of(s, mesh, 6)
    found = {body: at.weight[mesh.body == body].sum() for body in Body}
    found[Body.TISSUE] += found[Body.INCLUSION]
    for body, volume in volumes(s).items():
        assert found[body] == pytest.approx(volume, rel=ARCS if body == Body.INCLUSION else 1e-8), body


@special
def test_special_sections_are_covered_once(case: dict[str, float]) -> None:
    assert_covered_once(section(**case), mesh_of(section(**case)))


@many
@given(numbers)
def test_promised_sections_are_covered_once(case: dict[str, float]) -> None:
    assert_covered_once(section(**case), mesh_of(section(**case)))


@many
@given(numbers, st.sampled_from(LEVELS))
def test_no_cell_is_turned_inside_out_on_any_level(case: dict[str, float], level: Fineness) -> None:
    geometry_of(section(**case), mesh_of(section(**case), level), 4)


def test_spheres_volume_converges_with_the_order() -> None:
    s = section(**PAPER)
    mesh, true = mesh_of(s), volumes(s)[Body.INCLUSION]
    wrong = [abs(geometry_of(s, mesh, p).weight[mesh.body == Body.INCLUSION].sum() / true - 1) for p in (2, 4, 6, 8)]
    assert all(fine < coarse / 30 for coarse, fine in pairwise(wrong))


@pytest.mark.parametrize("key", ["cover", "below", "gap", "beside", "inner_height", "sphere", "area_ratio"])
@pytest.mark.parametrize("small", np.geomspace(1e-3, 1e-14, 12))
def test_lengths_too_far_apart_are_refused_or_right(key: str, small: float) -> None:
    """Far beyond the promised range: no wrong answer without a word."""
    value = {"gap": 5e-3 * small, "area_ratio": 1 / small}.get(key, small)
    s = section(**PAPER | {key: value})
    try:
        at = geometry_of(s, mesh_of(s), 4)
    except SolveError:
        assert small < 1e-5
    else:
        assert at.weight.sum() == pytest.approx(sum(volumes(s).values()) - volumes(s)[Body.INCLUSION], rel=1e-8)


def test_a_sphere_that_all_but_touches_the_surface_is_refused() -> None:
    s = replace(section(**PAPER), sphere_depth=section(**PAPER).sphere_radius * (1 + 1e-15))
    with pytest.raises(SolveError, match="lengths of the scene are too far apart"):
        geometry_of(s, mesh_of(s), 4)


def corners_of(mesh: Topology) -> np.ndarray:
    """Numbers of the elements' corners, (n, 4): by label, those of the probe apart from those of the tissue."""
    apart = np.broadcast_to(of_probe(mesh)[:, None, None], (len(mesh.body), 4, 1))
    told = np.concatenate([labels(mesh), apart], axis=2).reshape(-1, 3)
    return np.unique(told, axis=0, return_inverse=True)[1].reshape(-1, 4)


def of_probe(mesh: Topology) -> np.ndarray:
    return (mesh.body != Body.TISSUE) & (mesh.body != Body.INCLUSION)


def rounding(s: Section) -> float:
    sizes = s.tissue_radius + s.tissue_depth, s.inner_height + s.outer_height + s.flange_thickness + s.step_height
    return 8 * np.finfo(float).eps * sum(sizes)


def spread(points: np.ndarray, number: np.ndarray) -> float:
    """How far points of the same number lie apart."""
    first = np.unique(number, return_index=True)[1]
    return float(np.abs(points - points[first[number]]).max())


@special
def test_special_sections_conform(case: dict[str, float]) -> None:
    assert_corners_are_told_apart(section(**case))
    assert_edges_are_shared(section(**case))


@few
@given(numbers)
def test_promised_sections_conform(case: dict[str, float]) -> None:
    assert_corners_are_told_apart(section(**case))
    assert_edges_are_shared(section(**case))


def assert_corners_are_told_apart(s: Section) -> None:
    """Corners lie in one point if they have the same label and lie on the same side, else further apart than rounding."""
    mesh = mesh_of(s)
    at, number = nodes(s, mesh, SQUARE), corners_of(mesh)
    assert spread(at.reshape(-1, 2), number.ravel()) <= rounding(s)
    lengths = np.linalg.norm(at - np.roll(at, -1, axis=1), axis=2)
    shortest = np.full(number.max() + 1, np.inf)
    np.minimum.at(shortest, number, np.minimum(lengths, np.roll(lengths, 1, axis=1)))
    for side in (of_probe(mesh), ~of_probe(mesh)):
        there, first = np.unique(number[side], return_index=True)
        points = at[side].reshape(-1, 2)[first]
        assert np.all(cKDTree(points).query(points, k=2)[0][:, 1] > 0.01 * shortest[there])


def assert_edges_are_shared(s: Section) -> None:
    """Neighbours have the same points along an edge; edges of a single element make up the outlines and nothing else."""
    mesh = mesh_of(s)
    at, corner = nodes(s, mesh, SQUARE), corners_of(mesh)
    ends, sides = (np.stack([x, np.roll(x, -1, axis=1)], axis=2) for x in (corner, at))  # (n, 4, 2), (n, 4, 2, 2)
    told = np.unique(np.sort(ends, axis=2).reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    number, count = told[1].ravel(), told[2]
    assert spread(along_edges(s, mesh, ends[..., 0] < ends[..., 1]), number) <= rounding(s)
    assert count.max() == 2
    alone = (count[number] == 1).reshape(-1, 4)
    for side, polygons in zip((of_probe(mesh), ~of_probe(mesh)), outlines(s), strict=True):
        assert_make_up(sides[side][alone[side]], polygons, rounding(s))


def along_edges(s: Section, mesh: Topology, forth: np.ndarray) -> np.ndarray:
    """The point a third of the way along each element's edges, forth (where told so, (n, 4)) or back; (4 n, 2)."""
    after = np.roll(SQUARE, -1, axis=0)
    both = np.concatenate([(2 * SQUARE + after) / 3, (SQUARE + 2 * after) / 3])
    points = nodes(s, mesh, both)
    return np.where(forth[..., None], points[:, :4], points[:, 4:]).reshape(-1, 2)


def assert_make_up(edges: np.ndarray, polygons: list[np.ndarray], within: float) -> None:
    """Each of the edges, (m, 2, 2), lies on a side of the polygons, and they are as long together."""
    sides = np.concatenate([np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1) for polygon in polygons])
    low, high = sides.min(axis=1) - within, sides.max(axis=1) + within
    on = (edges[:, None] >= low[:, None]) & (edges[:, None] <= high[:, None])
    assert np.all(np.any(np.all(on, axis=(2, 3)), axis=1))
    lengths = (np.abs(np.diff(x, axis=1)).sum() for x in (edges, sides))
    assert next(lengths) == pytest.approx(next(lengths), rel=1e-9)


def outlines(s: Section) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The outlines of probe and tissue in the meridian plane."""
    inner, outer = (height + s.film + s.adhesive for height in (s.inner_height, s.outer_height))
    a, b, c = s.inner_radius, s.hole_radius, s.tube_radius
    tissue = [np.array([(0, 0), (0, -s.tissue_depth), (s.tissue_radius, -s.tissue_depth), (s.tissue_radius, 0)])]
    if not s.flange_thickness:
        return [np.array([(0, 0), (a, 0), (a, inner), (0, inner)]), np.array([(b, 0), (c, 0), (c, outer), (b, outer)])], tissue
    middle, flange, step = (a + b) / 2, max(s.flange_radius, c), max(inner, outer) + s.step_height
    top = step + s.flange_thickness
    gap = [(0, 0), (a, 0), (a, inner), (middle, inner), (middle, outer), (b, outer), (b, 0)]
    return [np.array([*gap, (c, 0), (c, step), (flange, step), (flange, top), (0, top)])], tissue


def test_a_kind_has_one_topology() -> None:
    s = section(**PAPER)
    wider = replace(s, tissue_radius=1.01 * s.tissue_radius)
    assert kind_of(wider) == kind_of(s)
    assert mesh_of(wider) is mesh_of(s)
    assert mesh_of(wider, replace(COARSE, layers=3)) is not mesh_of(s)


@pytest.mark.parametrize("key", [*DEFAULTS, *PAPER])
@pytest.mark.parametrize("factor", [0.85, 1.15])
def test_designs_near_the_papers_fit_on_its_mesh(key: str, factor: float) -> None:
    """Of the numbers of ``section`` one at a time; so bracketing sections and Taylor tests may stay on one mesh."""
    start = section(**PAPER)
    s = section(**PAPER | {key: factor * (DEFAULTS | PAPER)[key]})
    assert_covered_once(s, mesh_of(start))
    assert (mesh_of(s) is mesh_of(start)) == (kind_of(s) == kind_of(start))


def test_nodes_are_smooth_where_the_limits_of_the_spheres_box_change_places() -> None:
    def room(sphere: float) -> float:
        s = section(**PAPER | {"sphere": sphere})
        return s.box_limits()[0] - s.tube_radius

    assert_smooth(PAPER | {"sphere": brentq(room, 0.3, 1.0)}, {"sphere": 1.0, "cover": 0.0})


def assert_smooth(case: dict[str, float], way: dict[str, float]) -> None:
    mesh, noise = mesh_of(section(**case)), rounding(section(**case))

    def moved(step: complex) -> np.ndarray:
        return nodes(section(**{key: value * np.exp(step * way[key]) for key, value in case.items()}), mesh, SQUARE)

    exact = moved(1e-30j).imag / 1e-30
    coarse, fine = (np.abs((moved(h) - moved(-h)) / (2 * h) - exact).max(axis=(1, 2)) for h in (1e-2, 5e-3))
    assert np.all(fine <= coarse / 2**1.75 + noise / 5e-3)


def test_many_designs_at_once_have_the_nodes_of_each() -> None:
    s = section(**PAPER | FILMS_AND_BASE | {"inner_height": 0.5})
    scales = 1 + 1e-3 * np.eye(len(s.given))
    each = [replace(s, **{name: getattr(s, name) * scale for name, scale in zip(s.given, row, strict=True)}) for row in scales]
    together = replace(s, **{name: getattr(s, name) * scales[:, k] for k, name in enumerate(s.given)})
    one = [nodes(design, mesh_of(s), SQUARE) for design in each]
    np.testing.assert_allclose(nodes(together, mesh_of(s), SQUARE), one, rtol=1e-12, atol=1e-15)


def test_some_elements_have_their_own_nodes() -> None:
    s, chosen = section(**PAPER), np.array([3, 250, 40, 0])
    np.testing.assert_array_equal(nodes(s, mesh_of(s), SQUARE, chosen), nodes(s, mesh_of(s), SQUARE)[chosen])


@pytest.mark.parametrize("name", ["the paper's", "boss", "recess", "level base"])
def test_bodies_follow_every_length_on_a_mesh_that_stays(name: str) -> None:
    """Else derivatives by that length are those of another change."""
    start = section(**SPECIAL[name])
    mesh, bodies = mesh_of(start, Fineness(1, 2, 6)), (Body.INNER, Body.OUTER, Body.FILM, Body.ADHESIVE)
    for lengths in independent(start):
        s = replace(start, **{length: getattr(start, length) * 1.001 for length in lengths})
        at, true = geometry_of(s, mesh, 6), volumes(s)
        for body in set(bodies) & set(true):
            assert at.weight[mesh.body == body].sum() == pytest.approx(true[body], rel=1e-8), (lengths, body)


def independent(s: Section) -> list[tuple[str, ...]]:
    """Lengths that may change alone; under a level base, which would get a step, the heights do so together."""
    heights = "inner_height", "outer_height"
    level = kind_of(s).base == 0
    return [(name,) for name in s.given if not (level and name in heights)] + [heights] * level


SOFT = Material(youngs_modulus=1e4, poisson_ratio=0.4)


def test_velocities_add_up_to_the_derivatives_by_all_lengths() -> None:
    """Those with the corners' size held, and that size's share, against complex steps through the whole mesh."""
    s = section(**PAPER | FILMS_AND_BASE | {"inner_height": 0.5})
    solved = model(s, dict.fromkeys(Body, SOFT), "bonded", Fineness(1, 1, 2))
    every, shares = velocities(solved)
    for name, velocity, share in zip(s.given, every[:-1], shares, strict=True):
        steps = {other: getattr(s, other) * (1 + 1e-30j * (other == name)) for other in s.given}
        exact = nodes(replace(s, **steps), solved.mesh, solved.shapes.places).imag / 1e-30
        np.testing.assert_allclose(velocity + share * every[-1], exact, rtol=1e-10, atol=1e-12 * s.tissue_depth)


sizes = st.tuples(*[st.none() | between(1e-5, 1e2)] * 2)  # of cells at the ends, in the length between these


def density(x: float, length: float, low: float | None, high: float | None) -> float:
    """The integrand of eq. (M2)."""
    return sum(1 / (away + size) for away, size in ((x, low), (length - x, high)) if size is not None)


@many
@given(st.floats(-10, 10), between(1e-6, 1e6), st.integers(1, 40), sizes)
def test_cells_have_equal_shares_of_the_integral(start: float, length: float, cells: int, ends: tuple[Any, Any]) -> None:
    low, high = start * length, start * length + length
    a, b = (None if size is None else size * length for size in ends)
    x = graded(low, high, cells, a, b)
    assert (x[0], x[-1], x.shape) == (low, high, (cells + 1,))
    assert np.all(np.diff(x) > 0)
    if a is None and b is None:
        np.testing.assert_allclose(np.diff(x), length / cells, rtol=1e-10)
        return
    shares = [quad(density, *cell, (length, a, b), epsabs=0)[0] for cell in zip(x - low, x[1:] - low, strict=False)]
    np.testing.assert_allclose(shares, folds(low, high, a, b) / cells, rtol=1e-6)


@given(st.lists(between(1e-9, 1e9), min_size=1, max_size=8))
def test_smooth_min_is_close_below(lengths: list[float]) -> None:
    least = min(lengths)
    assert least / math.sqrt(len(lengths)) * (1 - 1e-12) <= smooth_min(*lengths) <= least * (1 + 1e-12)


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), between(1e-3, 1e3))
def test_smooth_max_is_close_above(a: float, b: float, blur: float) -> None:
    above = smooth_max(a, b, blur) - max(a, b)
    assert -1e-12 * max(abs(a), abs(b)) <= above <= blur / 2 * (1 + 1e-12) + 1e-12 * max(abs(a), abs(b))
    assert smooth_max(a, b, blur) == smooth_max(b, a, blur)


def interpolated(s: Section, mesh: Topology, order: int, field: Any) -> np.ndarray:
    """Values of the elements' functions, (n, 2, s), that make field(r, z) = (u_r, u_z) right at the nodes."""
    table = shapes(order)
    u = np.stack(field(*np.moveaxis(nodes(s, mesh, table.places), -1, 0)), axis=1)
    return np.linalg.solve(functions(table.places, table.degrees)[0], u.transpose(0, 2, 1)).transpose(0, 2, 1)


def energies(stiffness: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.einsum("nis,nisjt,njt->n", u, stiffness, u, optimize=True)


def by_body(mesh: Topology, parts: np.ndarray) -> np.ndarray:
    return np.bincount(mesh.body, parts)[: Body.INCLUSION + 1]


@pytest.mark.parametrize("order", [3, 5, 8])
def test_uniform_strain_has_its_energy_in_every_body(order: int) -> None:
    """Patch test: u_r = a r, u_z = b z + c + d r."""
    a, b, c, d = 0.7, -1.3, 2e-3, 0.4
    s = section(**PAPER)
    mesh = mesh_of(s)
    at = geometry_of(s, mesh, order)
    u = interpolated(s, mesh, order, lambda r, z: (a * r, b * z + c + d * r))
    shear, volume = (by_body(mesh, energies(part, u)) for part in matrices(at, shapes(order)))
    rings = by_body(mesh, at.weight.sum(axis=1))
    np.testing.assert_allclose(shear, (2 * a**2 + b**2 + d**2 / 2) * rings, rtol=1e-9)
    np.testing.assert_allclose(volume, (2 * a + b) ** 2 * rings, rtol=1e-9)


@pytest.mark.parametrize("order", [2, 5])
def test_matrices_integrate_the_strains_at_the_gauss_points(order: int) -> None:
    """Any displacements: the tables of products against the strains themselves, the dilation projected."""
    s, table = section(**PAPER), shapes(order)
    at = geometry_of(s, mesh_of(s), order)
    u = np.random.default_rng(1).normal(size=(len(at.weight), 2, len(table.degrees)))
    slopes, hoop = gradients(at, table, u[..., None])
    rr, rz, zr, zz = slopes
    squares = rr**2 + zz**2 + hoop**2 + (rz + zr) ** 2 / 2, projected(at, table, rr + zz + hoop) ** 2
    for stiffness, square in zip(matrices(at, table), squares, strict=True):
        np.testing.assert_allclose(energies(stiffness, u), (at.weight * square[..., 0]).sum(axis=1), rtol=1e-9)
        np.testing.assert_allclose(stiffness, stiffness.transpose(0, 3, 4, 1, 2), atol=1e-10 * np.abs(stiffness).max())


@pytest.mark.parametrize("order", [2, 5, 8])
def test_pressures_are_all_polynomials_of_a_lower_total_degree(order: int) -> None:
    table = shapes(order)
    x, y = table.points.T
    powers = np.stack([x**i * y**j for i in range(order) for j in range(order - i)], axis=1)
    assert table.pressure.shape == powers.shape
    assert np.linalg.matrix_rank(table.pressure) == powers.shape[1]
    best = table.pressure @ np.linalg.lstsq(table.pressure, powers, rcond=None)[0]
    np.testing.assert_allclose(best, powers, atol=1e-12)


WAVE = 600.0  # per m: three radians over the inner radius
# thin tissue, under which no lines end, so that all cells halve as their number doubles
THIN = {"gap": 2e-3, "area_ratio": 1.0, "sphere": 0.4, "cover": 0.5, "below": 1.0, "beside": 2.0, "inner_height": 0.6}


def wave(r: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return r * np.sin(WAVE * z), np.cos(WAVE * r) / WAVE


def wave_strains(r: np.ndarray, z: np.ndarray) -> np.ndarray:
    """eps_rr, eps_zz, u_r / r and eps_rz times the root of 2, whose squares add up to eps:eps."""
    rz = (WAVE * r * np.cos(WAVE * z) - np.sin(WAVE * r)) / 2
    return np.stack([np.sin(WAVE * z), 0 * z, np.sin(WAVE * z), math.sqrt(2) * rz])


@pytest.mark.parametrize("order", [3, 4])
def test_interpolated_strains_converge_at_the_rate_of_the_order(order: int) -> None:
    """In every body, curved elements too."""
    s, table, wrong = section(**THIN), shapes(order), []
    for cells in (2, 4):
        mesh = mesh_of(s, Fineness(cells, 0, order))
        at, height = geometry_of(s, mesh, order), nodes(s, mesh, table.places)[..., 1] @ table.geometry.T
        (rr, rz, zr, zz), hoop = gradients(at, table, interpolated(s, mesh, order, wave)[..., None])
        found = np.stack([rr, zz, hoop, (rz + zr) / math.sqrt(2)])[..., 0]
        wrong.append(by_body(mesh, (at.weight * (found - wave_strains(at.radius, height)) ** 2).sum(axis=(0, 2))))
    np.testing.assert_allclose(np.log2(wrong[0] / wrong[1]) / 2, order, atol=0.15)


@pytest.mark.parametrize("order", [3, 4])
def test_energy_of_a_block_converges_faster_than_its_strains(order: int) -> None:
    s = section(**THIN)
    x, weight = np.polynomial.legendre.leggauss(40)
    r, z = np.meshgrid(s.inner_radius * (1 + x) / 2, s.inner_height * (1 + x) / 2, indexing="ij")
    area = np.outer(weight, weight) * s.inner_radius * s.inner_height / 4
    exact, wrong = (2 * np.pi * r * area * (wave_strains(r, z) ** 2).sum(axis=0)).sum(), []
    for cells in (1, 2, 4):
        mesh = mesh_of(s, Fineness(cells, 0, order))
        shear = matrices(geometry_of(s, mesh, order), shapes(order))[0]
        wrong.append(abs(by_body(mesh, energies(shear, interpolated(s, mesh, order, wave)))[Body.INNER] - exact))
    assert np.all(np.log2(wrong[:-1]) - np.log2(wrong[1:]) > order)


def numberings(s: Section, order: int) -> tuple[Numbering, Numbering]:
    mesh = mesh_of(s, Fineness(1, 1, order))
    return numbering(mesh, order, "bonded"), numbering(mesh, order, "frictionless")


@special
def test_a_bond_ties_the_radial_unknowns_under_the_blocks(case: dict[str, float]) -> None:
    """On every contact of m edges m p + 1 functions, of which the one on the axis is held anyway."""
    s, order, layers = section(**case), 3, 1
    column = Layout(kind_of(s), COARSE).column
    inner, outer = column["inner"] + layers, column["tube"] - column["hole"] + 2 * layers
    bonded, frictionless = numberings(s, order)
    assert frictionless.unknowns - bonded.unknowns == inner * order + outer * order + 1


@special
@pytest.mark.parametrize("order", [2, 5])
def test_a_continuous_field_has_unknowns(case: dict[str, float], order: int) -> None:
    """Elements agree on what they share, odd functions along edges that run against each other with it."""
    s = section(**case)
    mesh = mesh_of(s, Fineness(1, 1, order))
    size = s.tube_radius

    def field(r: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.sin(r / size) * np.exp(z / size), np.cos(r / size + z / size)

    own = interpolated(s, mesh, order, field)[:, :, : shapes(order).skeleton].ravel()
    for numbers in numberings(s, order):
        gather, free = numbers.gather, np.diff(numbers.gather.indptr) > 0
        unknowns = (gather.T @ own) / (abs(gather).T @ np.ones(len(own)))
        np.testing.assert_allclose((gather @ unknowns)[free], own[free], atol=1e-9)


@special
def test_what_is_held(case: dict[str, float]) -> None:
    """u_r on the axis; both displacements on the floor and under a rigid base, or on an elastic base's top; nothing else."""
    s, order = section(**case), 3
    mesh = mesh_of(s, Fineness(1, 1, order))
    at = nodes(s, mesh, SQUARE)
    tops = [height + s.film + s.adhesive for height in (s.inner_height, s.outer_height)]
    if s.flange_thickness:
        tops = [max(tops) + s.step_height + s.flange_thickness]
    supports = np.isclose(at[..., 1, None], [-s.tissue_depth, *tops], rtol=1e-9, atol=0).any(axis=-1)
    for numbers in numberings(s, order):
        free = (np.diff(numbers.gather.indptr) > 0).reshape(len(at), 2, -1)[..., :4]
        np.testing.assert_array_equal(free[:, 1], ~supports)
        np.testing.assert_array_equal(free[:, 0], ~supports & (at[..., 0] > 0))


@special
def test_lift_is_what_a_block_moved_down_does_to_the_tissue_under_it(case: dict[str, float]) -> None:
    s, order = section(**case), 3
    mesh = mesh_of(s, Fineness(1, 1, order))
    r, z = np.moveaxis(nodes(s, mesh, SQUARE), -1, 0)
    touching = (~of_probe(mesh))[:, None] & (z == 0)
    under = touching & (r <= s.inner_radius), touching & (r >= s.hole_radius) & (r <= s.tube_radius)
    for numbers in numberings(s, order):
        lift = numbers.lift.reshape(len(r), 2, -1, 2)
        np.testing.assert_array_equal(lift[:, 1, :4], -np.stack(under, axis=-1).astype(float))
        assert not lift[:, 0].any()
        assert not lift[:, 1, 4:].any()


def test_a_rigid_shift_strains_nothing() -> None:
    """``vertical`` is one, in the elements and in the unknowns of all that no support holds."""
    s, order = section(**PAPER), 4
    mesh = mesh_of(s, Fineness(1, 1, order))
    bonded = numbering(mesh, order, "bonded")
    shift = np.tile(bonded.vertical, len(mesh.body))
    unknowns = (bonded.gather.T @ shift > 0).astype(float)
    free = np.diff(bonded.gather.indptr) > 0
    np.testing.assert_array_equal((bonded.gather @ unknowns)[free], shift[free])
    up = np.zeros((len(mesh.body), 2, len(shapes(order).degrees)))
    up[:, 1, :4] = 1.0
    for stiffness in matrices(geometry_of(s, mesh, order), shapes(order)):
        assert np.abs(np.einsum("nisjt,njt->nis", stiffness, up)).max() < 1e-12 * np.abs(stiffness).max()


def test_assembled_matrix_adds_the_elements_up() -> None:
    mesh = mesh_of(section(**PAPER), Fineness(1, 0, 2))
    numbers = numbering(mesh, 2, "frictionless")
    stiffness = np.random.default_rng(2).normal(size=(len(mesh.body), 16, 16))
    whole = numbers.gather.T @ (sp.block_diag(stiffness, format="csr") @ numbers.gather)
    np.testing.assert_allclose(numbers.assemble(stiffness).toarray(), whole.toarray(), atol=1e-12)
