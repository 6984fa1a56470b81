"""Parts with round lower edges: read by the plain reader, measured against quadrature, drawn, distinguished from sharp ones."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from scipy.integrate import quad

from geometry.cad import export as step
from geometry.cad import parts_record, solids
from geometry.common.errors import ExportError, InputError
from geometry.workshop import overview
from geometry.workshop.parts import build_section_outlines
from tests.support.parts import make, read

EDGE = 0.1  # mm
HOLE, RIM = 5.1, math.sqrt(5.1**2 + 25 / 3.7)  # of the outer block of ``make()``, mm


def volume(radius: float, top: float, towards: float, edge: float = EDGE) -> float:
    """Of what a wall whose lower edge recedes by ``towards`` (-1 to the axis, 1 away) encloses, by discs."""

    def disc(z: float) -> float:
        return math.pi * (radius + towards * (edge - math.sqrt(edge**2 - (edge - z) ** 2))) ** 2

    return quad(disc, 0, edge, epsabs=0, epsrel=1e-12)[0] + math.pi * radius**2 * (top - edge)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("round")
    step.export_parts(make(groove=None), folder, edge_radius=EDGE * 1e-3)
    return folder


def test_volumes_against_quadrature(exported):
    wanted = {"inner": volume(5, 5, -1), "outer": volume(RIM, 5, -1) - volume(HOLE, 5, 1), "film-inner": math.pi * 25 * 0.11}
    volumes_m3 = {name: read(exported / f"{name}.step").Volume() for name in wanted}
    assert volumes_m3 == pytest.approx(wanted, rel=1e-9)
    pappus = math.tau * (4.9 * (1 - math.pi / 4) * EDGE**2 + EDGE**3 / 6)  # the square less the quarter disc, about the axis
    assert volumes_m3["inner"] == pytest.approx(math.pi * 125 - pappus, rel=1e-9)


def test_round_edges_stand_in_the_text_as_tori(exported):
    def tori(name: str) -> list[tuple[float, float]]:
        rows = re.findall(r"= TOROIDAL_SURFACE\('[^']*',#\d+,([^,)]*),([^,)]*)\)", (exported / f"{name}.step").read_text())
        return sorted((float(centres), float(edge)) for centres, edge in rows)

    assert tori("inner") == [pytest.approx((5 - EDGE, EDGE), rel=1e-12)]
    assert tori("outer") == [pytest.approx((centres, EDGE), rel=1e-12) for centres in (HOLE + EDGE, RIM - EDGE)]
    assert tori("assembly") == [pytest.approx((centres, EDGE), rel=1e-12) for centres in (5 - EDGE, HOLE + EDGE, RIM - EDGE)]
    assert all(tori(name) == [] for name in ("film-inner", "film-outer", "base"))


def test_points_inside_and_outside_the_arcs(exported):
    cq, outer, inner = solids.load_cadquery(), *(read(exported / f"{name}.step").Solids()[0] for name in ("outer", "inner"))
    inside, far = EDGE * (1 - 0.5**0.5) * 1.02, EDGE * (1 - 0.5**0.5) * 0.98  # along both axes, from the corner to the arc
    for solid, x in ((inner, 5.0), (outer, RIM)):
        assert solid.isInside(cq.Vector(x - inside, 0, inside))
        assert not solid.isInside(cq.Vector(x - far, 0, far))
    assert outer.isInside(cq.Vector(HOLE + inside, 0, inside))
    assert not outer.isInside(cq.Vector(HOLE + far, 0, far))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("radius", "gap", "edge"),
    [(1e-4, 1e-6, 1e-7), (1e-4, 1e-6, 1e-5), (5e-2, 1e-6, 1e-7), (5e-2, 5e-3, 8e-3)],
    ids=["micro, least", "micro", "large, least", "large"],
)
def test_smallest_and_largest(tmp_path, radius, gap, edge):
    probe = make(radius, 1.0, gap, radius, groove=(0.2 * radius, 0.2 * radius))
    step.export_parts(probe, tmp_path, edge_radius=edge)
    wanted = volume(radius * 1e3, radius * 1e3, -1, edge * 1e3)
    assert read(tmp_path / "inner.step").Volume() == pytest.approx(wanted, rel=1e-9)


def test_a_sharp_part_is_no_round_one(tmp_path, monkeypatch):
    sharp = solids.build_inner_block
    monkeypatch.setattr(solids, "build_inner_block", lambda probe, edge_radius: sharp(probe))
    with pytest.raises(ExportError, match=r"^inner\.step: number of edges = 0, expected 1$"):
        step.export_parts(make(), tmp_path, edge_radius=1e-4)
    monkeypatch.setattr(solids, "build_inner_block", lambda probe, edge_radius: sharp(probe, edge_radius * (1 + 3e-6)))
    with pytest.raises(ExportError, match=r"^inner\.step: .*radius of a round edge = 0\.1000003, expected 0\.1 "):
        step.export_parts(make(), tmp_path, edge_radius=1e-4)
    assert list(tmp_path.iterdir()) == []


def test_a_groove_down_into_the_round_edges_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"^probe\.groove\.depth = 4\.91 mm: allowed: up to 4\.9 mm \(down to the round edges"):
        step.export_parts(make(groove=(2e-3, 4.91e-3)), tmp_path, edge_radius=1e-4)
    assert list(tmp_path.iterdir()) == []


def test_other_edges_are_another_design(exported):
    with pytest.raises(InputError, match="of another design"):
        parts_record.check_same_design(exported, make(groove=None))
    with pytest.raises(InputError, match="of another design"):
        parts_record.check_same_design(exported, make(groove=None), 1.0001e-4)
    assert parts_record.check_same_design(exported, make(groove=None), 1e-4) is not None
    assert parts_record.compute_design_digest(make(), 0.0) == parts_record.compute_design_digest(make())


@pytest.mark.parametrize("name", ["inner", "outer"])
def test_outlines_lose_what_the_arcs_leave_of_their_squares(name):
    def area(polygon: list[tuple[float, float]]) -> float:
        return sum(a * d - b * c for (a, b), (c, d) in zip(polygon, polygon[1:] + polygon[:1], strict=True)) / 2

    sharp, rounded = (build_section_outlines(make(), edge)[name] for edge in (0.0, 1e-4))
    for sharp_outline, rounded_outline in zip(sharp, rounded, strict=True):
        lost = 2 * (1 - math.pi / 4) * EDGE**2
        assert area(sharp_outline) - area(rounded_outline) == pytest.approx(lost, rel=2e-3)  # chords for arcs


def test_the_drawing_tells_the_radius(tmp_path, monkeypatch):
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **_: drawn.append(figure) or Path(path).touch())
    for edge in (1e-4, 0.0):
        overview.draw_probe(make(), tmp_path / "probe.png", edge)
    rounded, sharp = ([text.get_text() for text in figure.findobj(Text)] for figure in drawn)
    assert "lower edges R 0.1; A1, A2 as if sharp" in rounded
    assert not any("R 0" in text or "lower edges" in text for text in sharp)
