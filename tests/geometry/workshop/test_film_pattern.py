"""Film patterns, read by dxf-parser; areas and distances against formulas written out here."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import dxf_parser
import pytest

from geometry.cad.stamp import build_stamp
from geometry.workshop import film_pattern
from tests.support.parts import make
from tests.support.workshop import outlines

OUTER = math.sqrt(5.1**2 + 25 / 3.7)
INSET = 0.1 * (OUTER - 5.1)
Corners = list[tuple[float, float, float]]


def sampled(loop: Corners, count: int = 2000) -> list[tuple[float, float]]:
    """Points along an outline, arcs by the definition of their bulge: tan of a quarter of the angle that they turn by."""
    points = []
    for (x, y, bulge), (next_x, next_y, _) in pairwise([*loop, loop[0]]):
        if not bulge:
            points.append((x, y))
            continue
        angle, chord = 4 * math.atan(bulge), math.hypot(next_x - x, next_y - y)
        radius, direction = chord / 2 / math.sin(angle / 2), math.atan2(next_y - y, next_x - x)
        start = direction - angle / 2 - math.pi / 2
        centre = x - radius * math.cos(start), y - radius * math.sin(start)
        turns = (start + angle * step / count for step in range(count))
        points += [(centre[0] + radius * math.cos(turn), centre[1] + radius * math.sin(turn)) for turn in turns]
    return points


def area(loop: Corners) -> float:
    points = sampled(loop)
    return abs(sum(x * b - a * y for (x, y), (a, b) in pairwise([*points, points[0]]))) / 2


def test_layers_and_units(package: Path) -> None:
    drawing = dxf_parser.parse((package / "film-inner-pattern.dxf").read_bytes())
    assert drawing["header"]["$INSUNITS"] == 4
    used = {entity["layer"] for entity in drawing["entities"]}
    sides = {f"{layer}_{side}" for layer in ("ELECTRODE", "LEAD", "TAB") for side in ("TOP", "BOTTOM")}
    assert used == {"FILM_OUTLINE", "ADHESIVE", "TEXT", *sides}


def test_inner_film(package: Path) -> None:
    path = package / "film-inner-pattern.dxf"
    (face,), (electrode,) = outlines(path, "ADHESIVE"), outlines(path, "ELECTRODE_TOP")
    assert area(face) == pytest.approx(math.pi * 25, rel=1e-5)
    assert area(electrode) == pytest.approx(math.pi * 4.5**2, rel=1e-5)
    assert outlines(path, "ELECTRODE_BOTTOM") == [electrode]
    (outline,) = outlines(path, "FILM_OUTLINE")
    half = 0.8  # of the groove's half width of 1 mm
    strip = (OUTER + 5) * 2 * half - (half * math.sqrt(25 - half**2) + 25 * math.asin(half / 5))
    assert area(outline) == pytest.approx(math.pi * 25 + strip, rel=1e-5)
    assert max(abs(y) for x, y in sampled(outline) if x > 5.1) == pytest.approx(half)  # it goes through the groove


def test_outer_film_is_open_above_the_groove(package: Path) -> None:
    path = package / "film-outer-pattern.dxf"
    (electrode,), (outline,) = outlines(path, "ELECTRODE_TOP"), outlines(path, "FILM_OUTLINE")
    half = {radius: math.asin((1 + INSET) / radius) for radius in (5.1 + INSET, OUTER - INSET)}
    (low, small), (high, large) = sorted((radius, angle) for radius, angle in half.items())
    strips = {radius: (1 + INSET) * math.sqrt(radius**2 - (1 + INSET) ** 2) + radius**2 * half[radius] for radius in half}
    assert small > large
    wanted = math.pi * (high**2 - low**2) - (strips[high] - strips[low])
    assert area(electrode) == pytest.approx(wanted, rel=1e-5)
    cut = {radius: math.sqrt(radius**2 - 1) + radius**2 * math.asin(1 / radius) for radius in (5.1, OUTER)}
    face = math.pi * (OUTER**2 - 5.1**2) - (cut[OUTER] - cut[5.1])
    (adhesive,) = outlines(path, "ADHESIVE")
    assert area(adhesive) == pytest.approx(face, rel=1e-5)
    assert area(outline) > face
    assert all(x < 0 for x, _ in sampled(outline) if math.hypot(x, _) > OUTER * (1 + 1e-9))


@pytest.mark.parametrize("name", ["film-inner", "film-outer"])
def test_electrodes_keep_away_from_the_edge_and_leads_from_each_other(package: Path, name: str) -> None:
    path = package / f"{name}-pattern.dxf"
    edges = [point for loop in outlines(path, "ADHESIVE") for point in sampled(loop, 700)]
    inset = 0.5 if name == "film-inner" else INSET
    points = [point for loop in outlines(path, "ELECTRODE_TOP") for point in sampled(loop, 100)]
    assert min(math.dist(point, edge) for point in points for edge in edges) > 0.97 * inset
    for layer in ("LEAD", "TAB"):
        (top,), (bottom,) = (outlines(path, f"{layer}_{side}") for side in ("TOP", "BOTTOM"))
        assert min(y for _, y, _ in top) > 0 > max(y for _, y, _ in bottom) or max(y for _, y, _ in top) < 0
    (lead,), (tab,) = outlines(path, "LEAD_TOP"), outlines(path, "TAB_TOP")
    assert min(math.hypot(x, y) for x, y, _ in lead) < max(math.hypot(x, y) for x, y in points)  # they touch
    assert {abs(x) for x, _, _ in lead} & {abs(x) for x, _, _ in tab}


@pytest.mark.parametrize(
    ("options", "way"),
    [({}, "groove"), ({"groove": None, "gap": 2e-4}, "gap"), ({"groove": None}, ""), ({"groove": (2e-3, 5e-5)}, "")],
)
def test_the_inner_leads_way_out(options: dict[str, object], way: str, tmp_path: Path) -> None:
    pattern, outer = film_pattern.build_film_patterns(make(**options))
    assert (pattern.exit, outer.exit) == (way, "outside")
    assert ("LEAD_TOP" in pattern.layers) == bool(way)
    film_pattern.write_pattern(pattern, build_stamp(make(**options)), tmp_path / "pattern.dxf")


def test_no_films_no_patterns() -> None:
    assert film_pattern.build_film_patterns(make(film=None)) == ()
