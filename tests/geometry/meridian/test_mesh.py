"""Meridian meshes: cells cover every promised section once, and nodes are smooth in its lengths."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from geometry.common.errors import SolveError
from geometry.meridian.mesh import Topology, compute_labels, compute_nodes, find_interface_ends, label_line
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.meridian.mesh_lines import find_kind as kind_of
from geometry.meridian.section import STACKS, TISSUES, Body, Section
from geometry.scenes.probe import Material
from solver.axisymmetric.base_states import build_model
from solver.axisymmetric.energy_derivatives import compute_velocities
from solver.axisymmetric.refinement import LIGHT_MESH, MESH_LEVELS
from tests.support.meridian_sections import (
    COARSE,
    DEFAULTS,
    FILMS_AND_BASE,
    PAPER,
    SPECIAL,
    geometry_of,
    many_examples,
    mesh_of,
    numbers,
    rounding,
    section,
    special,
    volumes,
)

ARCS = 3e-6  # of a sphere's volume: what polynomials of order 6 leave out of arcs as long as the coarsest mesh has


def assert_covered_once(s: Section, mesh: Topology) -> None:
    """Bodies have their volumes; what tissue and sphere take from each other counts once."""
    geometry = geometry_of(s, mesh, 6)
    areas = {body: geometry.weight[mesh.body == body].sum() for body in Body}
    areas[Body.TISSUE] += areas[Body.INCLUSION]
    for body, volume in volumes(s).items():
        assert areas[body] == pytest.approx(volume, rel=ARCS if body == Body.INCLUSION else 1e-8), body


@special
@pytest.mark.parametrize("level", [COARSE, MESH_LEVELS[1]], ids=["usual", "lean"])
def test_special_sections_are_covered_once(case: dict[str, float], level: MeridianFineness) -> None:
    assert_covered_once(section(**case), mesh_of(section(**case), level))


def test_a_lean_mesh_has_fewer_cells_where_a_sphere_is() -> None:
    """And as many where there is none, or edges are round."""
    for case, fewer in ((PAPER, True), ({"below": 1.0}, False)):
        usual, lean = (len(mesh_of(section(**case), replace(COARSE, lean=lean_option)).body) for lean_option in (False, True))
        assert (lean < 0.85 * usual) == fewer
        assert lean <= usual


@pytest.mark.parametrize("level", [LIGHT_MESH, *MESH_LEVELS[1:4]])
def test_cells_are_cut_towards_interfaces_ends_unless_they_are_slender(level: MeridianFineness) -> None:
    """The cells above and below such an end become one and two for each layer; the volume stays."""
    s = section(**PAPER)
    thin = s.tissue_depth / 1000
    counts = []
    for thicknesses in ((s.tissue_depth / 6, s.tissue_depth / 2), (thin, s.tissue_depth / 2), (thin, thin)):
        layered = replace(s, layer_0=thicknesses[0], layer_1=thicknesses[1])
        mesh = mesh_of(layered, level)
        geometry = geometry_of(layered, mesh, 4)
        assert geometry.weight.sum() == pytest.approx(sum(volumes(s).values()) - volumes(s)[Body.INCLUSION], rel=1e-4)
        touching = mesh.vertices[..., 0] == mesh.layout.column["side"]
        counts.append([np.sum(np.any(touching & (mesh.vertices[..., 1] == end), axis=1)) for end in mesh.layout.interfaces])
        assert len(find_interface_ends(mesh)) == sum(counts[-1])
    cut = 2 * (1 + 2 * level.layers)
    assert counts[:2] == [[cut, cut], [2, cut]]


@pytest.mark.slow
@many_examples
@given(numbers)
def test_promised_sections_are_covered_once(case: dict[str, float]) -> None:
    assert_covered_once(section(**case), mesh_of(section(**case)))


def assert_conforming(mesh: Topology) -> None:
    """Of each body's side of the surface two elements share an edge, but on the axis, where bodies end, and around the gap."""
    layout, corners = mesh.layout, compute_labels(mesh)
    block = ~np.isin(mesh.body, (*TISSUES, Body.INCLUSION))
    ends = corners[:, [[0, 1], [1, 2], [3, 2], [0, 3]]]  # (n, edges, ends, 2)
    ends = np.take_along_axis(ends, np.lexsort((ends[..., 1], ends[..., 0]))[..., None], axis=2)
    edges = np.concatenate([ends.reshape(len(ends), 4, 4), np.broadcast_to(block[:, None, None], (len(ends), 4, 1))], axis=2)
    single, times = np.unique(edges.reshape(-1, 5), axis=0, return_counts=True)
    assert times.max() == 2
    single = single[times == 1]
    radii = [label_line(layout.column[name]) for name in ("axis", "inner", "hole", "tube", "side")]
    levels = [label_line(number) for number in (layout.row["floor"], layout.row["surface"], layout.inner[-1], layout.outer[-1])]
    upright = (single[:, 0] == single[:, 2]) & np.isin(single[:, 0], radii)
    level = (single[:, 1] == single[:, 3]) & np.isin(single[:, 1], levels)
    assert np.all(upright | level), single[~(upright | level)]


@special
@pytest.mark.parametrize("level", [LIGHT_MESH, *MESH_LEVELS[:3]])
def test_elements_of_special_sections_meet_along_whole_edges(case: dict[str, float], level: MeridianFineness) -> None:
    if not section(**case).has_details:
        assert_conforming(mesh_of(section(**case), level))


@pytest.mark.slow
@many_examples
@given(numbers)
def test_elements_of_promised_sections_meet_along_whole_edges(case: dict[str, float]) -> None:
    bare = dict.fromkeys(
        (
            "inner_film",
            "outer_film",
            "inner_bond_to_base",
            "outer_bond_to_base",
            "flange_radius",
            "flange_thickness",
            "step_height",
        ),
        0.0,
    )
    assert_conforming(mesh_of(replace(section(**case), **bare), LIGHT_MESH))


@pytest.mark.slow
@many_examples
@given(numbers, st.sampled_from((LIGHT_MESH, *MESH_LEVELS)))
def test_no_cell_is_turned_inside_out_on_any_level(case: dict[str, float], level: MeridianFineness) -> None:
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
        geometry = geometry_of(s, mesh_of(s), 4)
    except SolveError:
        assert small < 1e-5
    else:
        assert geometry.weight.sum() == pytest.approx(sum(volumes(s).values()) - volumes(s)[Body.INCLUSION], rel=1e-8)


def test_a_sphere_that_all_but_touches_the_surface_is_refused() -> None:
    s = replace(section(**PAPER), sphere_depth=section(**PAPER).sphere_radius * (1 + 1e-15))
    with pytest.raises(SolveError, match="lengths of the scene are too far apart"):
        geometry_of(s, mesh_of(s), 4)


def is_same(first: Topology, second: Topology) -> bool:
    """Whether two meshes have the same elements between the same lines."""
    arrays = ("shape", "vertices", "circles", "corners", "body")
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in arrays)


def test_a_kind_has_one_topology() -> None:
    s = section(**PAPER)
    wider = replace(s, tissue_radius=1.01 * s.tissue_radius)
    assert kind_of(wider) == kind_of(s)
    assert is_same(mesh_of(wider), mesh_of(s))
    assert not is_same(mesh_of(wider, replace(COARSE, layers=3)), mesh_of(s))


@pytest.mark.parametrize("key", [*DEFAULTS, *PAPER])
@pytest.mark.parametrize("factor", [0.85, 1.15])
def test_designs_near_the_papers_fit_on_its_mesh(key: str, factor: float) -> None:
    """Of the numbers of ``section`` one at a time; so bracketing sections and Taylor tests may stay on one mesh."""
    start = section(**PAPER)
    s = section(**PAPER | {key: factor * (DEFAULTS | PAPER)[key]})
    assert_covered_once(s, mesh_of(start))
    assert is_same(mesh_of(s), mesh_of(start)) == (kind_of(s) == kind_of(start))


def test_nodes_are_smooth_where_the_limits_of_the_spheres_box_change_places() -> None:
    def room(sphere: float) -> float:
        s = section(**PAPER | {"sphere": sphere})
        return s.compute_box_limits()[0] - s.tube_radius

    assert_smooth(PAPER | {"sphere": brentq(room, 0.3, 1.0)}, {"sphere": 1.0, "cover": 0.0})


def assert_smooth(case: dict[str, float], way: dict[str, float]) -> None:
    mesh, noise = mesh_of(section(**case)), rounding(section(**case))

    def moved(step: complex) -> np.ndarray:
        return compute_nodes(section(**{key: value * np.exp(step * way[key]) for key, value in case.items()}), mesh, UNIT_SQUARE)

    exact = moved(1e-30j).imag / 1e-30
    coarse, fine = (np.abs((moved(h) - moved(-h)) / (2 * h) - exact).max(axis=(1, 2)) for h in (1e-2, 5e-3))
    assert np.all(fine <= coarse / 2**1.75 + noise / 5e-3)


def test_many_designs_at_once_have_the_nodes_of_each() -> None:
    s = section(**PAPER | FILMS_AND_BASE | {"inner_height": 0.5})
    scales = 1 + 1e-3 * np.eye(len(s.lengths))
    designs = [
        replace(s, **{name: getattr(s, name) * scale for name, scale in zip(s.lengths, row, strict=True)}) for row in scales
    ]
    together = replace(s, **{name: getattr(s, name) * scales[:, k] for k, name in enumerate(s.lengths)})
    single = [compute_nodes(design, mesh_of(s), UNIT_SQUARE) for design in designs]
    np.testing.assert_allclose(compute_nodes(together, mesh_of(s), UNIT_SQUARE), single, rtol=1e-12, atol=1e-15)


def test_some_elements_have_their_own_nodes() -> None:
    s, chosen = section(**PAPER), np.array([3, 250, 40, 0])
    np.testing.assert_array_equal(
        compute_nodes(s, mesh_of(s), UNIT_SQUARE, chosen), compute_nodes(s, mesh_of(s), UNIT_SQUARE)[chosen]
    )


@pytest.mark.parametrize("name", ["the paper's", "boss", "recess", "level base"])
def test_bodies_follow_every_length_on_a_mesh_that_stays(name: str) -> None:
    """Else derivatives by that length are those of another change."""
    start = section(**SPECIAL[name])
    mesh, bodies = mesh_of(start, MeridianFineness(1, 2, 6)), (Body.INNER, Body.OUTER, *STACKS[0], *STACKS[1])
    for lengths in independent(start):
        s = replace(start, **{length: getattr(start, length) * 1.001 for length in lengths})
        geometry, true = geometry_of(s, mesh, 6), volumes(s)
        for body in set(bodies) & set(true):
            assert geometry.weight[mesh.body == body].sum() == pytest.approx(true[body], rel=1e-8), (lengths, body)


def independent(s: Section) -> list[tuple[str, ...]]:
    """Lengths that may change alone; under a level base, which would get a step, the heights do so together."""
    pairs = [(f"inner_{name}", f"outer_{name}") for name in ("height", "bond_to_block", "film", "bond_to_base")]
    pairs = [pair for pair in pairs if pair[0] in s.lengths] if kind_of(s).base == 0 else []
    paired = {name for pair in pairs for name in pair}
    return [(name,) for name in s.lengths if name not in paired] + pairs


SOFT = Material(youngs_modulus=1e4, poisson_ratio=0.4)


def test_velocities_add_up_to_the_derivatives_by_all_lengths() -> None:
    """Those with the corners' size held, and that size's share, against complex steps through the whole mesh."""
    s = section(**PAPER | FILMS_AND_BASE | {"inner_height": 0.5})
    solved = build_model(s, dict.fromkeys(Body, SOFT), "bonded", MeridianFineness(1, 1, 2))
    all_velocities, shares = compute_velocities(solved)
    for name, velocity, share in zip(s.lengths, all_velocities[:-1], shares, strict=True):
        steps = {name_moved: getattr(s, name_moved) * (1 + 1e-30j * (name_moved == name)) for name_moved in s.lengths}
        exact = compute_nodes(replace(s, **steps), solved.mesh, solved.shapes.places).imag / 1e-30
        np.testing.assert_allclose(velocity + share * all_velocities[-1], exact, rtol=1e-10, atol=1e-12 * s.tissue_depth)
