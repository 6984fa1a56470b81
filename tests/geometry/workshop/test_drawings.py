"""The drawings: DXF read by dxf-parser, PDF by pypdf, neither of which wrote them; every size against the scene's own numbers."""

from __future__ import annotations

import math
import re
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import dxf_parser
import pytest
from pypdf import PdfReader

from geometry.cad.parts_record import compute_design_digest
from geometry.cad.stamp import build_stamp
from geometry.scenes.film import Film
from geometry.scenes.probe import Base, Material, Probe
from geometry.workshop import drawings, pdf
from geometry.workshop.parts import build_assembly_view, build_part_views, list_parts
from geometry.workshop.tolerance import NO_BUDGET, Budget
from tests.support.parts import make
from tests.support.workshop import EDGE, distance, entities, probe

OUTER = math.sqrt(5.1**2 + 25 / 3.7)  # Ro^2 = hole^2 + r2^2 / (A2/A1), mm
STEPPED = math.sqrt(2.72**2 + 6.25 / 0.12)  # of the probe with two heights
SIZES = {  # of each drawing's dimensions, from the scene by hand, mm
    "inner": [10, 5, 0.2],
    "outer": [10.2, 2 * OUTER, 5, 1, 2, 0.2],
    "film-inner": [10, 0.11],
    "film-outer": [10.2, 2 * OUTER, 0.11, 2],
    "base": [2 * OUTER, 18, 3, 2, 5],
    "assembly": [0.1, 2 * OUTER, 18, 5, 5 + 0.11 + 2 + 3],
}
TEXTS = {  # what stands at them
    # castings: ISO 3302-1, table 1, class M2, of fixed sizes, and of heights as closure sizes
    "inner": ["\u00d810 \u00b10.2", "5 \u00b10.2", "R0.2 \u00b10.1"],
    "outer": [
        "\u00d810.2 \u00b10.2",
        f"\u00d8{2 * OUTER:.4f} \u00b10.2",
        "5 \u00b10.2",
        "1 \u00b10.1",
        "2 \u00b10.1",
        "R0.2 \u00b10.1",
    ],
    "film-inner": ["\u00d810", "0.11 \u00b10.011"],
    "film-outer": ["\u00d810.2", f"\u00d8{2 * OUTER:.4f}", "0.11 \u00b10.011", "2"],
    "base": [f"\u00d8{2 * OUTER:.4f}", "\u00d818", "3", "2", "(5)"],  # the whole follows from its steps, ISO 129-1
    "assembly": ["(0.1)", f"(\u00d8{2 * OUTER:.4f})", "(\u00d818)", "(5)", "(10.11)"],  # the parts' drawings give them
}


GENERAL = {"inner": "ISO 3302-1 M2", "outer": "ISO 3302-1 M2", "assembly": "see the parts' drawings"}
HARD = Material(youngs_modulus=3e9, poisson_ratio=0.35)


def dimensions(path: Path) -> list[dict[str, Any]]:
    return entities(path, "DIMENSION")


@pytest.mark.parametrize("name", SIZES)
def test_dxf_holds_every_size_of_the_scene(package: Path, name: str) -> None:
    entries = dimensions(package / f"{name}.dxf")
    assert sorted(distance(entry) for entry in entries) == pytest.approx(sorted(SIZES[name]), rel=1e-9)
    assert sorted(entry["actualMeasurement"] for entry in entries) == pytest.approx(sorted(SIZES[name]), rel=1e-9)
    assert sorted(entry["text"] for entry in entries) == sorted(TEXTS[name])
    for entry in entries:  # and each text says what its dimension measures
        number = float(re.sub(r"^[^0-9]*", "", entry["text"]).split()[0].rstrip("*)"))
        assert number == pytest.approx(distance(entry), abs=0.51e-4)


@pytest.mark.parametrize("name", SIZES)
def test_pdf_holds_the_same_sizes_and_the_title_block(package: Path, name: str) -> None:
    page = PdfReader(package / f"{name}.pdf").pages[0].extract_text()
    assert [text for text in TEXTS[name] if text not in page.splitlines()] == []
    design, program = compute_design_digest(probe(), EDGE), build_stamp(probe()).program
    for words in (
        f"Design {design}\n",
        f"Program {program} ",
        "Units mm",
        f"General tolerances {GENERAL.get(name, 'ISO 2768-m')}",
        f" {name}\n",
    ):
        assert words in page, words
    assert re.search(r"Scale \d+:1 Sheet A4", page)


@pytest.mark.parametrize("name", ["inner", "base"])
def test_pdf_is_to_scale(package: Path, name: str) -> None:
    """A line of the page is as long as the part's size times the scale that the title block states."""
    page = PdfReader(package / f"{name}.pdf").pages[0]
    assert [float(side) / 72 * 25.4 for side in page.mediabox[2:]] == pytest.approx([210, 297], abs=0.1)
    scale = int(re.findall(r"Scale (\d+):1", page.extract_text())[0])
    points: list[tuple[float, float]] = []
    page.extract_text(visitor_operand_before=lambda op, args, *_: op in (b"m", b"l") and points.append(tuple(map(float, args))))
    lengths = [abs(x - next_x) / 72 * 25.4 for (x, y), (next_x, next_y) in pairwise(points) if y == next_y]
    width = {"inner": 10, "base": 18}[name]  # the face above; the flange
    assert min(abs(length / scale - width) for length in lengths) < 1e-3


def test_dxf_declares_millimetres_and_layers(package: Path) -> None:
    drawing = dxf_parser.parse((package / "outer.dxf").read_bytes())
    assert drawing["header"]["$INSUNITS"] == 4
    layers = drawing["tables"]["layer"]["layers"]
    assert {"OUTLINE", "HIDDEN", "AXIS", "SECTION", "DIMENSION", "TEXT", "FRAME"} <= set(layers)


def test_the_seat_of_a_film_has_its_roughness(package: Path) -> None:
    for name, symbols in {"inner": 0, "outer": 0, "base": 1, "film-inner": 0}.items():  # no symbol of machining on a casting
        assert [entity["text"] for entity in entities(package / f"{name}.dxf", "TEXT")].count("Ra 0.8") == symbols


def texts(sheet: Any) -> list[str]:
    return [entity.dxf.text for kind in ("DIMENSION", "TEXT") for entity in sheet.model.query(kind)]


def test_a_casting_says_what_is_measured_and_how(package: Path) -> None:
    """The mould's cavity, larger by the shrinkage of 0.1 %, to half of IT7; the modulus by a specimen; no soft block."""
    page = PdfReader(package / "outer.pdf").pages[0].extract_text()
    cavity = [2 * OUTER / (1 - 1e-3), 10.2 / (1 - 1e-3), 5 / (1 - 1e-3)]
    sizes = [float(size) for size in re.findall(r"(?:cavity \u00d8|pin \u00d8|height) ([\d.]+) \u00b1", page)]
    assert sizes == pytest.approx(cavity, abs=1e-4)
    assert "Measure the mould, not the soft block" in page
    assert "test a cylinder cast of the same pour in compression (ISO 7743)" in page
    assert "Ra 3.2" not in page


@pytest.mark.parametrize(
    ("bound", "wanted"), [(0.02, "\u00d810 \u00b10.04"), (0.001, "\u00d810 \u00b10.0075"), (0.5, "\u00d810")]
)
def test_a_hard_block_keeps_machining_s_tolerances(bound: float, wanted: str) -> None:
    """The ratio's where it is tighter, half of IT7 (ISO 286-1: 15 um of 10 mm) at the tightest, else ISO 2768-m in the title."""
    probe = make(inner=HARD, outer=HARD)
    said = texts(drawings.draw_part(build_part_views(probe)["inner"], build_stamp(probe), Budget(1.0, {"inner_radius": bound})))
    assert wanted in said
    assert {"ISO 2768-m", "Ra 3.2", "Ra 0.8"} <= set(said)
    assert not any("mould" in text for text in said)
    soft = texts(drawings.draw_part(build_part_views(make())["inner"], build_stamp(make()), Budget(1.0, {"inner_radius": bound})))
    assert "\u00d810 \u00b10.2" in soft  # no bound makes a casting more exact


def test_what_is_assumed_has_a_star() -> None:
    sheet = drawings.draw_part(build_part_views(make())["base"], build_stamp(make()), NO_BUDGET)
    assert [entity.dxf.text for entity in sheet.model.query("DIMENSION") if "*" in entity.dxf.text] == ["1.7173*"]
    assert any(entity.dxf.text.startswith("* assumed") for entity in sheet.model.query("TEXT"))


def drawn(probe: Probe, edge: float, name: str) -> Any:
    view = build_assembly_view(probe, edge) if name == "assembly" else build_part_views(probe, edge)[name]
    stamp = build_stamp(probe, edge)
    return drawings.draw_part(view, stamp, NO_BUDGET, list_parts(probe, stamp.materials) if name == "assembly" else ())


WIDE = Base(rigid=True, flange_radius=0.1, step_height=0.01)
PROBES = {
    "usual": (make(), 0.0),
    "micro": (make(1e-4, 1.2, 5e-6, 1e-4, groove=(5e-5, 3e-5), film=Film(thickness=9e-6)), 1e-5),
    "large": (make(5e-2, 0.7, 2e-3, 6e-2, groove=(5e-3, 3e-3), base=WIDE), 1e-3),
    "slender": (make(1e-3, 1.2, 1e-4, 2e-2, groove=None, film=None), 0.0),
    "flat": (make(2e-2, 1.2, 1e-4, 5e-4, groove=(2e-3, 2e-4)), 1e-4),
    "stepped": (make(2.5e-3, 0.12, 2.2e-4, groove=None, inner_height=2e-3, outer_height=2.5e-3), 0.0),
    "recessed": (make(2.5e-3, 0.12, 2.2e-4, inner_height=3e-3, outer_height=2.5e-3, base=WIDE), 0.0),
    "thin gap": (make(5e-2, 50, 1e-6, 1e-3, groove=(9.9e-2, 9e-4)), 0.0),
}
SLOW = [
    pytest.param(name, part, marks=pytest.mark.slow) for name in PROBES for part in ("outer", "film-outer", "base", "assembly")
]


@pytest.mark.parametrize(("name", "part"), [("flat", "outer"), *SLOW])
def test_nothing_overlaps_nor_leaves_the_frame(name: str, part: str) -> None:
    probe, edge = PROBES[name]
    if part == "film-outer" and probe.film is None:
        return
    sheet = drawn(probe, edge, part)
    figure = pdf.draw_figure(sheet)
    figure.draw_without_rendering()
    boxes = {text: text.get_window_extent() for text in figure.axes[0].texts}
    per_mm = figure.dpi / 25.4
    left, bottom, right, top = (side * per_mm for side in sheet.frame)
    for text, box in boxes.items():
        inside = box.x0 > left and box.x1 < right and box.y0 > bottom and box.y1 < top
        assert inside, text.get_text()
    for (text, box), (second_text, second) in combinations(boxes.items(), 2):
        assert not box.padded(-0.3 * per_mm).overlaps(second.padded(-0.3 * per_mm)), (text.get_text(), second_text.get_text())


def test_scales_are_standard() -> None:
    for name, scale, size in (("micro", 500, "A4"), ("large", 1, "A3")):
        sheet = drawn(*PROBES[name], "base" if name == "large" else "film-inner")
        assert (sheet.scale, sheet.size) == (scale, size)


@pytest.mark.parametrize(
    ("name", "sizes"),  # by hand, mm: boss or recess, tube, flange; step between the blocks' ends; flange; whole
    [
        ("stepped", [5.22, 2 * STEPPED, 0.5, 0.3 * STEPPED, 0.5 + 0.3 * STEPPED]),
        ("recessed", [5.22, 2 * STEPPED, 200, 0.5, 10, 0.3 * STEPPED, 10.5 + 0.3 * STEPPED]),
    ],
)
def test_a_base_with_a_boss_or_a_recess(name: str, sizes: list[float]) -> None:
    measurements = [entity.dxf.actual_measurement for entity in drawn(*PROBES[name], "base").model.query("DIMENSION")]
    assert sorted(measurements) == pytest.approx(sorted(sizes), rel=1e-9)
