"""The drawing: what there is, what is assumed, and outlines of the area that the solids have."""

import struct
from pathlib import Path

import pytest

from geometry.cad import solids
from geometry.scenes.base_sizes import assume_sizes
from geometry.scenes.film import Film
from geometry.scenes.probe import Base
from geometry.workshop import overview
from geometry.workshop.parts import build_section_outlines
from geometry.workshop.sheet import format_number
from tests.support.parts import FLANGE, make


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        ({}, {"base.thickness": 1.8e-3}),
        ({"film": None}, {"base.thickness": 1.8e-3}),
        ({"film": Film(d33=-2e-11)}, {"base.thickness": 1.8e-3, "film.thickness": 110e-6}),
        ({"base": FLANGE}, {}),
        ({"base": Base(rigid=True, flange_radius=9e-3)}, {"base.thickness": 1.8e-3, "base.step_height": 1.2e-3}),
        (
            {"base": Base(youngs_modulus=1e9, poisson_ratio=0.3, thickness=2e-3)},
            {"base.flange_radius": 7.5e-3, "base.step_height": 1.2e-3},
        ),
    ],
)
def test_what_the_scene_leaves_open(options, wanted):
    assert assume_sizes(make(outer_radius=6e-3, **options)) == pytest.approx({f"probe.{k}": v for k, v in wanted.items()})


def test_png_of_its_size_written_whole(tmp_path):
    path = overview.draw_probe(make(inner_height=5e-3, outer_height=6e-3), tmp_path / "probe.png")
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", data[16:24])  # two upright sheets beside each other
    assert width / height == pytest.approx(2 / 2**0.5, abs=0.01)
    assert height > 1700
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(("gap", "height", "groove"), [(1e-6, 0.1e-3, None), (5e-3, 100e-3, (5e-3, 50e-3))])
def test_extremes(tmp_path, gap, height, groove):
    overview.draw_probe(make(gap=gap, height=height, groove=groove), tmp_path / "probe.png")


@pytest.mark.parametrize(
    ("options", "present", "not_there"),
    [
        (
            {"film": None, "groove": None},
            ["Probe, overview", "no films: the scene has none", "(\u00d812)", "(1.8*)", "(6.8)"],
            ["groove", "(0.11)", "(\u00d815)"],
        ),
        ({"base": FLANGE}, ["groove 2 wide", "(0.11)", "(\u00d818)", "groove's footprint"], ["*", "assumed"]),
        ({"film": Film(d33=-2e-11)}, ["(0.11*)", "* assumed: the scene does not give this size"], ["(\u00d815)"]),
        (
            {"groove": None, "base": Base(youngs_modulus=1e9, poisson_ratio=0.3)},
            ["(\u00d815*)", "(1.2*)", "(1.8*)", "A2/A1"],
            ["groove", "(0.11*)"],
        ),
    ],
)
def test_says_what_there_is_and_what_is_assumed(tmp_path, monkeypatch, options, present, not_there):
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **_: drawn.append(figure) or Path(path).touch())
    overview.draw_probe(make(outer_radius=6e-3, **options), tmp_path / "probe.png")
    texts = [text.get_text() for text in drawn[0].findobj(Text)]
    for word in present:
        assert any(word in text for text in texts), (word, texts)
    for word in not_there:
        assert not any(word in text for text in texts), (word, texts)


@pytest.mark.parametrize("options", [{}, {"film": None}, {"base": FLANGE}], ids=["film", "bare", "flange"])
def test_outlines_enclose_the_area_that_the_solids_have_in_the_plane(options):
    probe = make(inner_height=4e-3, outer_height=5e-3, **options)
    cq = solids.load_cadquery()
    plane = cq.Face.makePlane(100, 100, (0, 0, 0), (0, 1, 0))
    for name, polygons in build_section_outlines(probe).items():
        area = sum(abs(sum(a * d - b * c for (a, b), (c, d) in zip(p, p[1:] + p[:1], strict=True))) / 2 for p in polygons)
        assert area == pytest.approx(plane.intersect(solids.build_parts(probe)[name]).Area(), rel=1e-9), name


@pytest.mark.parametrize(
    ("length", "text"), [(5.0, "5"), (11.44849, "11.4485"), (0.001, "0.001"), (0.0001, "0.0001"), (100.0, "100")]
)
def test_numbers(length, text):
    assert format_number(length) == text
