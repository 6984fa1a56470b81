"""Meridian meshes conform: cells share whole edges, and bodies end where their outlines say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial import cKDTree

from geometry.meridian.mesh import Topology, compute_labels, compute_nodes
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.section import Section
from tests.support.meridian_sections import (
    CROSSED,
    crossed_section,
    few_examples,
    mesh_of,
    numbers,
    of_probe,
    rounding,
    section,
    special,
)


def corners_of(mesh: Topology) -> np.ndarray:
    """Numbers of the elements' corners, (n, 4): by label, those of the probe apart from those of the tissue."""
    side_flags = np.broadcast_to(of_probe(mesh)[:, None, None], (len(mesh.body), 4, 1))
    keys = np.concatenate([compute_labels(mesh), side_flags], axis=2).reshape(-1, 3)
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1, 4)


def spread(points: np.ndarray, number: np.ndarray) -> float:
    """How far points of the same number lie apart."""
    first = np.unique(number, return_index=True)[1]
    return float(np.abs(points - points[first[number]]).max())


@special
def test_special_sections_conform(case: dict[str, float]) -> None:
    assert_corners_are_told_apart(section(**case))
    assert_edges_are_shared(section(**case))


@special
def test_sections_with_round_edges_conform(case: dict[str, float]) -> None:
    sharp = section(**case)
    size = min(sharp.inner_radius, sharp.tube_radius - sharp.hole_radius, sharp.inner_height, sharp.outer_height)
    for share in (0.05, 0.4):
        assert_corners_are_told_apart(replace(sharp, edge_radius=share * size))
        assert_edges_are_shared(replace(sharp, edge_radius=share * size))


@pytest.mark.parametrize("depths", CROSSED)
@pytest.mark.parametrize(
    "probe", [{}, {"sphere": 2.0, "cover": 0.05}, {"sphere": 0.2, "gap": 2e-3}], ids=["usual", "wide", "small"]
)
def test_sections_with_interfaces_across_the_sphere_conform(depths: tuple[float, ...], probe: dict[str, float]) -> None:
    assert_edges_are_shared(crossed_section(depths, **probe))


@pytest.mark.slow
@few_examples
@given(numbers)
def test_promised_sections_conform(case: dict[str, float]) -> None:
    assert_corners_are_told_apart(section(**case))
    assert_edges_are_shared(section(**case))


def assert_corners_are_told_apart(s: Section) -> None:
    """Corners lie in one point if they have the same label and lie on the same side, else further apart than rounding."""
    mesh = mesh_of(s)
    positions, number = compute_nodes(s, mesh, UNIT_SQUARE), corners_of(mesh)
    assert spread(positions.reshape(-1, 2), number.ravel()) <= rounding(s)
    lengths = np.linalg.norm(positions - np.roll(positions, -1, axis=1), axis=2)
    shortest = np.full(number.max() + 1, np.inf)
    np.minimum.at(shortest, number, np.minimum(lengths, np.roll(lengths, 1, axis=1)))
    for side in (of_probe(mesh), ~of_probe(mesh)):
        side_places, first = np.unique(number[side], return_index=True)
        points = positions[side].reshape(-1, 2)[first]
        assert np.all(cKDTree(points).query(points, k=2)[0][:, 1] > 0.01 * shortest[side_places])


def assert_edges_are_shared(s: Section) -> None:
    """Neighbours have the same points along an edge; edges of a single element make up the outlines and nothing else."""
    mesh = mesh_of(s)
    positions, corner = compute_nodes(s, mesh, UNIT_SQUARE), corners_of(mesh)
    ends, sides = (np.stack([x, np.roll(x, -1, axis=1)], axis=2) for x in (corner, positions))  # (n, 4, 2), (n, 4, 2, 2)
    edge_keys = np.unique(np.sort(ends, axis=2).reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    number, count = (
        edge_keys[1].ravel(),
        np.where(edge_keys[0][:, 0] == edge_keys[0][:, 1], 2, edge_keys[2]),
    )  # points have any number of cells
    assert spread(along_edges(s, mesh, ends[..., 0] < ends[..., 1]), number) <= rounding(s)
    assert count.max() == 2
    alone = (count[number] == 1).reshape(-1, 4)
    for side, polygons in zip((of_probe(mesh), ~of_probe(mesh)), outlines(s), strict=True):
        assert_make_up(sides[side][alone[side]], polygons, rounding(s))


def along_edges(s: Section, mesh: Topology, forth: np.ndarray) -> np.ndarray:
    """The point a third of the way along each element's edges, forth (where told so, (n, 4)) or back; (4 n, 2)."""
    next_corner = np.roll(UNIT_SQUARE, -1, axis=0)
    places = np.concatenate([(2 * UNIT_SQUARE + next_corner) / 3, (UNIT_SQUARE + 2 * next_corner) / 3])
    points = compute_nodes(s, mesh, places)
    return np.where(forth[..., None], points[:, :4], points[:, 4:]).reshape(-1, 2)


def assert_make_up(edges: np.ndarray, polygons: list[np.ndarray], tolerance: float) -> None:
    """Each of the edges, (m, 2, 2), lies on a side of the polygons, and they are as long together."""
    sides = np.concatenate([np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1) for polygon in polygons])
    low, high = sides.min(axis=1) - tolerance, sides.max(axis=1) + tolerance
    covers = (edges[:, None] >= low[:, None]) & (edges[:, None] <= high[:, None])
    assert np.all(np.any(np.all(covers, axis=(2, 3)), axis=1))
    lengths = (np.abs(np.diff(x, axis=1)).sum() for x in (edges, sides))
    assert next(lengths) == pytest.approx(next(lengths), rel=1e-9)


def outlines(s: Section) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The outlines of probe and tissue in the meridian plane."""
    inner, outer = s.top_heights
    a, b, c = s.inner_radius, s.hole_radius, s.tube_radius
    tissue = [np.array([(0, 0), (0, -s.tissue_depth), (s.tissue_radius, -s.tissue_depth), (s.tissue_radius, 0)])]
    if not s.flange_thickness:
        return [np.array([(0, 0), (a, 0), (a, inner), (0, inner)]), np.array([(b, 0), (c, 0), (c, outer), (b, outer)])], tissue
    middle, flange, step = (a + b) / 2, max(s.flange_radius, c), max(inner, outer) + s.step_height
    top = step + s.flange_thickness
    gap = [(0, 0), (a, 0), (a, inner), (middle, inner), (middle, outer), (b, outer), (b, 0)]
    return [np.array([*gap, (c, 0), (c, step), (flange, step), (flange, top), (0, top)])], tissue
