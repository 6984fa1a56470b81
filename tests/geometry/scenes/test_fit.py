"""Whether bodies fit: against other formulas and against sampling."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geometry import (
    BlockTissue,
    CylinderTissue,
    HalfSpaceTissue,
    Inclusion,
    InputError,
    Load,
    Material,
    Placement,
    Probe,
    Scene,
    scene_from_dict,
    scene_to_dict,
)
from geometry.common.arrays import Floats
from geometry.scenes.fit_check import compute_lateral_reach, compute_semi_axes, do_overlap
from geometry.scenes.units import SI_CONTEXT

SOFT = {"youngs_modulus": 1e3, "poisson_ratio": 0.4}
PROBE = Probe(inner_radius=5e-3, outer_radius=6e-3, gap=1e-4, height=5e-3, inner=Material(**SOFT), outer=Material(**SOFT))
ROUND = CylinderTissue(shape="cylinder", radius=45e-3, depth=60e-3, **SOFT)
BLOCK = BlockTissue(shape="block", length=100e-3, breadth=80e-3, depth=60e-3, **SOFT)
ENDLESS = HalfSpaceTissue(shape="half-space", **SOFT)
Tissue = CylinderTissue | BlockTissue | HalfSpaceTissue


def sphere(diameter: float, depth: float, x: float = 0.0, y: float = 0.0) -> Inclusion:
    return Inclusion.model_validate({"diameter": diameter, "depth": depth, "x": x, "y": y, **SOFT}, context=SI_CONTEXT)


def ellipsoid(diameters: Floats, orientation: Floats, x: float = 0.0, y: float = 0.0, depth: float = 1.0) -> Inclusion:
    sizes, angles = tuple(map(float, diameters)), tuple(map(float, orientation))
    tables = {"diameters": sizes, "orientation": angles, "x": float(x), "y": float(y), "depth": float(depth), **SOFT}
    return Inclusion.model_validate(
        tables, context=SI_CONTEXT
    )  # metres: of another size than any tumour, as the shapes alone matter


def refusal(tissue: Tissue, *bodies: Inclusion, x: float = 0.0, y: float = 0.0) -> str | None:
    """What reading the scene's file says, None where it is taken."""
    scene = Scene.model_construct(
        probe=PROBE, tissue=tissue, inclusion=bodies, placement=Placement(x=x, y=y), load=Load(force=1.0)
    )
    try:
        scene_from_dict(scene_to_dict(scene))
    except InputError as fault:
        return str(fault)
    return None


def on_sphere(count: int) -> Floats:
    """Points spread evenly over the unit sphere (golden spiral), shape (count, 3)."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, math.pi * (1 + math.sqrt(5)) * k
    return np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], axis=1)


def to_global(body: Inclusion, points: Floats) -> Floats:
    """Points of the unit ball in the body's own frame as points of the body, from the definition of ``orientation``."""
    rz, ry, rx = body.orientation
    semi = np.array(body.diameters or (body.diameter,) * 3) / 2
    turned = Rotation.from_euler("xyz", [rx, ry, rz], degrees=True).apply(points * semi)
    return np.asarray(turned + np.array([body.x, body.y, -body.depth]))


def gauge(body: Inclusion, points: Floats) -> Floats:
    """How far points lie out: below 1 inside the body."""
    rz, ry, rx = body.orientation
    semi = np.array(body.diameters or (body.diameter,) * 3) / 2
    local = Rotation.from_euler("xyz", [rx, ry, rz], degrees=True).inv().apply(points - [body.x, body.y, -body.depth])
    return np.asarray(np.linalg.norm(local / semi, axis=1))


BALL = np.concatenate([radius * on_sphere(4000) for radius in np.linspace(0.1, 1.0, 10)])


class TestShape:
    def test_axes_are_turned_about_the_fixed_axes_x_then_y_then_z(self) -> None:
        body = ellipsoid(np.array([8e-3, 6e-3, 4e-3]), np.array([30.0, -50.0, 70.0]))
        wanted = Rotation.from_euler("xyz", [70, -50, 30], degrees=True).as_matrix() * [4e-3, 3e-3, 2e-3]
        assert np.array(compute_semi_axes(body)) == pytest.approx(wanted, rel=1e-12, abs=1e-18)

    def test_reach_against_sampling(self) -> None:
        random, surface = np.random.default_rng(1), on_sphere(40_000)
        for _ in range(40):
            x, y, depth = random.uniform(-1, 1, 3)
            body = ellipsoid(random.uniform(0.05, 2, 3), random.uniform(-180, 180, 3), x, y, 2 + depth)
            sampled = np.hypot(*to_global(body, surface)[:, :2].T).max()
            assert sampled * (1 - 1e-9) <= compute_lateral_reach(body) <= sampled * 1.001

    def test_reach_of_a_needle_pointing_away(self) -> None:
        body = ellipsoid(np.array([2.0, 1e-6, 1e-6]), np.array([30.0, 0, 0]), math.cos(math.pi / 6), math.sin(math.pi / 6))
        assert compute_lateral_reach(body) == pytest.approx(2.0, rel=1e-9)


class TestOverlap:
    @pytest.mark.parametrize(
        ("distance", "wanted"), [(1.5, True), (2.0, True), (2 * (1 + 1e-8), False), (0.0, True), (2.5, False)]
    )
    def test_two_spheres(self, distance: float, wanted: bool) -> None:
        for x, y in ((distance, 0.0), (0.6 * distance, -0.8 * distance)):
            first, second = sphere(1.0, 2.0), sphere(3.0, 2.0, x, y)
            assert do_overlap(first, second) is wanted
            round_one = ellipsoid(np.ones(3), np.array([10, 20, 30]), depth=2.0)
            assert do_overlap(round_one, second) is wanted
            assert do_overlap(second, round_one) is wanted

    def test_turned_ellipsoids_against_sampling(self) -> None:
        random, counts = np.random.default_rng(2), {True: 0, False: 0}
        for _ in range(80):
            sizes, angles = np.exp(random.uniform(-1.5, 1, (2, 3))), random.uniform(-180, 180, (2, 3))
            first = ellipsoid(sizes[0], angles[0], depth=5.0)
            second = ellipsoid(sizes[1], angles[1], *random.uniform(-1.2, 1.2, 2), depth=5 + random.uniform(-1.2, 1.2))
            nearest = min(gauge(second, to_global(first, BALL)).min(), gauge(first, to_global(second, BALL)).min())
            counts[do_overlap(first, second)] += 1
            assert do_overlap(first, second) is do_overlap(second, first)
            if do_overlap(first, second):
                assert nearest < 1.05  # the samples lie 5 % of a semi-axis apart
            else:
                assert nearest > 1
        assert min(counts.values()) > 12

    @pytest.mark.parametrize("clearance", [1e-6, -1e-6])
    def test_touching_along_a_common_axis(self, clearance: float) -> None:
        turn = np.array([25.0, 40.0, -70.0])
        way = Rotation.from_euler("xyz", turn[::-1], degrees=True).apply([1.5 + clearance, 0, 0])
        first, second = (
            ellipsoid(np.array([2.0, 0.3, 0.1]), turn),
            ellipsoid(np.array([1.0, 0.2, 0.7]), turn, way[0], way[1], 1 - way[2]),
        )
        assert do_overlap(first, second) is (clearance < 0)

    @pytest.mark.parametrize("thin", [1e-9, 1e-6])
    def test_needles_and_discs(self, thin: float) -> None:
        needle, disc = np.array([10.0, thin, thin]), np.array([thin, 10.0, 10.0])
        for sizes in (needle, disc):
            for angles in (np.zeros(3), np.array([33.0, 44.0, 55.0])):
                way = Rotation.from_euler("xyz", angles[::-1], degrees=True).apply([0.0, 0.1, 0.0])
                neighbour = ellipsoid(sizes, angles, way[0], way[1], 1 - way[2])
                separate = sizes is needle
                assert do_overlap(ellipsoid(sizes, angles), neighbour) is not separate
        assert do_overlap(ellipsoid(needle, np.zeros(3)), ellipsoid(disc, np.zeros(3)))


class TestInclusions:
    @pytest.mark.parametrize("tissue", [ROUND, BLOCK, ENDLESS], ids=["cylinder", "block", "half-space"])
    def test_top(self, tissue: Tissue) -> None:
        wanted = "inclusion[1].depth = 4 mm: allowed: above 4 mm (it leaves the tissue's surface)"
        assert refusal(tissue, sphere(2e-3, 20e-3), sphere(8e-3, 4e-3)) == wanted
        assert refusal(tissue, sphere(8e-3, 4.0001e-3)) is None

    @pytest.mark.parametrize("tissue", [ROUND, BLOCK], ids=["cylinder", "block"])
    def test_bottom(self, tissue: Tissue) -> None:
        reason = "(it leaves the tissue's bottom at 60 mm)"
        wanted = f"inclusion[0].depth = 56 mm: allowed: a centre less than 56 mm deep {reason}"
        assert refusal(tissue, sphere(8e-3, 56e-3)) == wanted
        assert refusal(tissue, sphere(8e-3, 55.999e-3)) is None
        too_large = "inclusion[0].diameter = 61 mm: allowed: a smaller body: the tissue ends 60 mm deep"
        assert refusal(tissue, sphere(61e-3, 31e-3)) == refusal(tissue, sphere(61e-3, 9e-3)) == too_large
        assert refusal(ENDLESS, sphere(8e-3, 1.0)) is None

    @pytest.mark.parametrize(
        ("tissue", "x", "y", "message"),
        [
            (ROUND, 41e-3, 0.0, r"^inclusion\[0\]\.x = 41 mm: allowed: the whole body within 45 mm of the tissue's axis"),
            (ROUND, -20e-3, -37e-3, r"^inclusion\[0\]\.y = -37 mm: allowed: the whole body within 45 mm"),
            (BLOCK, -46e-3, 0.0, r"^inclusion\[0\]\.x = -46 mm: allowed: the whole body within 50 mm of the tissue's middle"),
            (
                BLOCK,
                45e-3,
                36e-3,
                r"^inclusion\[0\]\.y = 36 mm: allowed: the whole body within 40 mm .* \(it leaves the tissue's side\)$",
            ),
        ],
    )
    def test_side(self, tissue: Tissue, x: float, y: float, message: str) -> None:
        assert re.search(message, str(refusal(tissue, sphere(8e-3, 20e-3, x, y))))
        assert refusal(tissue, sphere(8e-3, 20e-3, 0.97 * x, 0.97 * y)) is None
        assert refusal(ENDLESS, sphere(8e-3, 20e-3, x, y)) is None

    def test_turned_ellipsoid(self) -> None:
        def needle(rz: float, ry: float, depth: float = 30e-3, x: float = 0.0) -> str | None:
            return refusal(BLOCK, ellipsoid(np.array([50e-3, 2e-3, 2e-3]), np.array([rz, ry, 0.0]), x, 0.0, depth))

        assert needle(0, 0) is None
        assert needle(0, 90) is None
        assert "leaves the tissue's surface" in str(needle(0, 90, 25e-3))
        assert "leaves the tissue's bottom" in str(needle(0, -90, 36e-3))
        assert "leaves the tissue's side" in str(needle(0, 0, x=26e-3))
        assert needle(90, 0, x=26e-3) is None

    def test_overlapping(self) -> None:
        bodies = [sphere(8e-3, 20e-3), sphere(4e-3, 20e-3, 20e-3), sphere(8e-3, 26e-3)]
        wanted = "inclusion[2].depth = 26 mm: allowed: inclusions apart (it overlaps inclusion[0])"
        assert refusal(ROUND, *bodies) == wanted
        assert refusal(ROUND, *bodies[:2]) is None
        turned = ellipsoid(np.array([30e-3, 4e-3, 4e-3]), np.array([0.0, 90.0, 0.0]), 18e-3, 0.0, 20e-3)
        assert refusal(ROUND, bodies[0], turned) is None
        assert "overlaps inclusion[0]" in str(
            refusal(ROUND, bodies[0], turned.model_copy(update={"orientation": (0.0, 0.0, 0.0)}))
        )

    @pytest.mark.timeout(20)
    def test_a_thousand_are_checked_in_seconds(self) -> None:
        bodies = [sphere(1e-5, 1e-2 + 2e-5 * index) for index in range(1000)]
        assert refusal(ROUND, *bodies) is None


class TestProbe:
    @pytest.mark.parametrize(
        ("tissue", "x", "y", "message"),
        [
            (ROUND, 0.2, 0.0, "placement.x = 200 mm: allowed: the probe's axis less than 39 mm from the tissue's"),
            (ROUND, 20e-3, -34e-3, "placement.y = -34 mm: allowed: the probe's axis less than 39 mm from the tissue's"),
            (BLOCK, 44e-3, 0.0, "placement.x = 44 mm: allowed: the probe's axis less than 44 mm from the tissue's"),
            (BLOCK, 40e-3, -35e-3, "placement.y = -35 mm: allowed: the probe's axis less than 34 mm from the tissue's"),
        ],
    )
    def test_over_the_edge(self, tissue: Tissue, x: float, y: float, message: str) -> None:
        reason = " (the whole probe, of radius 6 mm, has to stand on the tissue)"
        assert refusal(tissue, x=x, y=y) == message + reason
        assert refusal(ENDLESS, x=x, y=y) is None

    @pytest.mark.parametrize(("key", "size"), [("radius", 6e-3), ("length", 12e-3), ("breadth", 11e-3)])
    def test_tissue_smaller_than_the_probe(self, key: str, size: float) -> None:
        tissue = (ROUND if key == "radius" else BLOCK).model_copy(update={key: size})
        minimum = 6 if key == "radius" else 12
        assert str(refusal(tissue)).startswith(f"tissue.{key} = {size * 1e3:g} mm: allowed: above {minimum} mm (the whole probe")

    def test_just_inside(self) -> None:
        assert refusal(ROUND, x=38.999e-3) is None
        assert refusal(BLOCK, x=43.999e-3, y=33.999e-3) is None
