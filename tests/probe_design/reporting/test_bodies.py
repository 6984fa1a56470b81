"""Bodies that turn: closed, of the volume that formulas give, in the places that the scene says."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

from geometry import read_scene
from geometry.common.arrays import Floats, Ints
from probe_design.data.builtin import read_builtin_scene
from probe_design.reporting.bodies import build_bodies, build_ring, build_sphere, iterate_probe_meshes
from tests.support.paths import EXAMPLES

QUARTERS = 0.75


def volume(places: Floats, triangles: Ints) -> float:
    a, b, c = (places[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize(
    "mesh",
    [build_ring(1.0, 2.0, 3.0, 5.0), build_ring(0.0, 2.0, 3.0, 5.0), build_ring(1.0, 2.0, 0.0, 1.0, begin=0.3), build_sphere()],
)
def test_surfaces_are_closed_and_face_outwards(mesh: tuple[Floats, Ints]) -> None:
    places, triangles = mesh
    _, number = np.unique(np.round(places, 12), axis=0, return_inverse=True)
    corners = number[triangles]
    whole = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]  # those on the axis have no area
    edges = Counter((int(triangle[k]), int(triangle[(k + 1) % 3])) for triangle in whole for k in range(3))
    assert all(edges[a, b] == edges[b, a] for a, b in edges)
    assert volume(places, triangles) > 0


def test_volumes_are_those_of_the_parts() -> None:
    """Three quarters of each, chords of 5 degrees making them 0.13 % smaller; the groove, cut by angle, is not compared."""
    probe = read_builtin_scene().probe.model_copy(update={"groove": None})
    volumes_m3: Counter[str] = Counter()
    for name, mesh in iterate_probe_meshes(probe):
        volumes_m3[name] += volume(*mesh)
    assert volumes_m3["inner"] == pytest.approx(QUARTERS * probe.inner_area * probe.core_height, rel=2e-3)
    assert volumes_m3["outer"] == pytest.approx(QUARTERS * probe.outer_area * probe.tube_height, rel=2e-3)
    assert probe.film is not None
    film = QUARTERS * (probe.inner_area + probe.outer_area) * probe.film.thickness
    assert volumes_m3["film"] == pytest.approx(film, rel=2e-3)
    assert volume(*build_sphere()) == pytest.approx(4 / 3 * math.pi, rel=0.015)  # inscribed, in steps of 10 degrees


def test_bodies_stand_where_the_scene_says() -> None:
    scene = read_scene(EXAMPLES / "two-tumours.toml")
    tumours = [np.array(entry["vertices"]) for entry in build_bodies(scene)][-len(scene.inclusion) :]
    for body, places in zip(scene.inclusion, tumours, strict=True):
        middle = (places.min(axis=0) + places.max(axis=0)) / 2
        assert middle == pytest.approx([1e3 * body.x, 1e3 * body.y, -1e3 * body.depth], abs=1e-3)
