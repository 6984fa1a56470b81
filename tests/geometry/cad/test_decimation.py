"""Surfaces of very many triangles by fewer: against the ellipsoid's own equation and volume."""

from __future__ import annotations

import math

import numpy as np
import pytest
import pyvista

from geometry.cad.decimation import (
    DECIMATED_TRIANGLES,
    MAX_DIRECT_TRIANGLES,
    MAX_RELATIVE_DISTANCE,
    decimate,
    measure_distance,
)

AXES = np.array([4.0, 3.0, 2.5])  # mm


def ellipsoid(times: int, axes: np.ndarray = AXES) -> pyvista.PolyData:
    """20 times 4^times triangles with corners on an ellipsoid."""
    ball = pyvista.Icosphere(radius=1.0, nsub=times)
    return pyvista.PolyData.from_regular_faces(np.asarray(ball.points, dtype=float) * axes, ball.regular_faces)


def test_fewer_triangles_are_the_ellipsoid_within_the_distance_that_is_stated() -> None:
    fine = ellipsoid(6)
    result = decimate(fine)
    assert result is not None
    coarse, deviation = result
    assert fine.n_cells == 81_920
    assert coarse.n_cells <= DECIMATED_TRIANGLES
    assert coarse.is_manifold  # closed, no edge with other than two triangles
    assert 0 < deviation <= MAX_RELATIVE_DISTANCE * AXES.min()
    size = np.linalg.norm(
        coarse.points / AXES, axis=1
    )  # a corner lies within off of the surface, and that on or in the ellipsoid
    assert np.all(np.abs(size - 1) * AXES.min() <= deviation + 1e-4)
    middles = coarse.points[coarse.regular_faces].mean(axis=1)
    assert np.all(np.abs(np.linalg.norm(middles / AXES, axis=1) - 1) * AXES.min() <= deviation + 1e-4)
    assert coarse.volume == pytest.approx(4 / 3 * math.pi * AXES.prod(), rel=2e-3)


def test_how_far_spheres_are_apart() -> None:
    ones = np.ones(3)
    assert measure_distance(ellipsoid(4, 2.0 * ones), ellipsoid(3, 1.9 * ones)) == pytest.approx(0.1, abs=0.01)


@pytest.mark.slow
def test_small_and_uneven_surfaces_stay_as_they_are() -> None:
    small, rough = ellipsoid(4), ellipsoid(6)
    assert small.n_cells < MAX_DIRECT_TRIANGLES
    assert decimate(small) is None
    rough.points = rough.points * np.random.default_rng(0).normal(1.0, 0.02, (rough.n_points, 1))
    assert decimate(rough) is None


@pytest.mark.slow
def test_a_ridge_thinner_than_the_others_are_large_is_kept() -> None:
    body = ellipsoid(6)
    turn = np.arctan2(body.points[:, 1], body.points[:, 0])
    body.points = body.points * (1 + 0.5 * np.exp(-((turn / 0.06) ** 2)) * (np.abs(body.points[:, 2]) < 2.0))[:, None]
    result = decimate(body)
    assert result is not None
    assert np.ptp(result[0].points, axis=0) == pytest.approx(np.ptp(body.points, axis=0), abs=2 * result[1])
