"""Bonds take up height: STEP files, drawings and lists of a probe with tape on both sides of its films, read back.

The inner film is 110 um between tapes of 50 um, 0.21 mm together; the outer film of 52 um has a tape of 130 um towards its block
and glue of 20 um towards the base, 0.202 mm together. The blocks are 5 mm high, so that the base steps by 8 um.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import pytest
from pypdf import PdfReader

from geometry.cad import export
from geometry.scenes.film import Film
from geometry.scenes.units import SI_CONTEXT
from geometry.workshop.package import build_writers
from probe_design.reporting.bodies import iterate_probe_meshes
from tests.geometry.workshop.test_film_pattern import OUTER, area
from tests.support.parts import make, read
from tests.support.workshop import distance, entities, outlines

TAPE = {"name": "tape-50um"}
FILM: dict[str, Any] = {"thickness": 110e-6, "bond_to_base": TAPE, "bond_to_block": TAPE}
OTHER = {"thickness": 52e-6, "bond_to_block": {"name": "tape-130um"}, "bond_to_base": {"name": "epoxy-20um"}}
AREAS_MM2 = {"inner": math.pi * 25, "outer": math.pi * 25 / 3.7}


def build_film(**fields: Any) -> Film:
    return Film.model_validate(FILM | fields, context=SI_CONTEXT)


def read_heights(folder: Path) -> dict[str, tuple[float, float]]:
    """Lower and upper end of each part's box, mm."""
    boxes = {path.stem: read(path).BoundingBox(1e-7) for path in folder.glob("*.step")}
    return {name: (box.zmin, box.zmax) for name, box in boxes.items()}


@pytest.fixture(scope="module")
def alike(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both films between tapes of 50 um."""
    return write_all(tmp_path_factory.mktemp("alike"), build_film())


@pytest.fixture(scope="module")
def different(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The outer film as ``OTHER`` has it."""
    return write_all(tmp_path_factory.mktemp("different"), build_film(outer=OTHER))


def write_all(folder: Path, film: Film) -> Path:
    probe = make(film=film, groove=None)
    export.export_parts(probe, folder, other_files=build_writers(probe))
    return folder


def test_parts_stand_above_and_below_their_bonds(alike: Path) -> None:
    heights = read_heights(alike)
    assert heights["inner"] == pytest.approx((0.0, 5.0), abs=1e-6)
    for film in ("film-inner", "film-outer"):
        assert heights[film] == pytest.approx((5.05, 5.16), abs=1e-6)
    assert heights["base"][0] == pytest.approx(5.21, abs=1e-6)
    whole = sorted(read(alike / "assembly.step").Solids(), key=lambda solid: solid.BoundingBox().zmin)
    assert [solid.BoundingBox(1e-7).zmin for solid in whole] == pytest.approx([0, 0, 5.05, 5.05, 5.21], abs=1e-6)


def test_the_base_steps_where_the_stacks_differ(different: Path) -> None:
    heights = read_heights(different)
    assert heights["film-inner"] == pytest.approx((5.05, 5.16), abs=1e-6)
    assert heights["film-outer"] == pytest.approx((5.13, 5.182), abs=1e-6)
    base = read(different / "base.step")
    faces = sorted(face.Center().z for face in base.Faces() if face.geomType() == "PLANE")
    assert faces[:2] == pytest.approx([5.202, 5.21], abs=1e-6)  # over the outer and the inner block
    inner, outer = (read(different / f"{name}.step") for name in ("inner", "outer"))
    assert (base.distance(inner), base.distance(outer)) == pytest.approx((math.hypot(0.202, 0.05), 0.202), rel=1e-6)


def read_sizes(path: Path) -> list[float]:
    return [round(distance(entity), 6) for entity in entities(path, "DIMENSION")]


def test_drawings_give_the_heights(alike: Path, different: Path) -> None:
    assert read_sizes(alike / "assembly.dxf").count(0.21) == 1
    assert {0.21, 0.202} <= set(read_sizes(different / "assembly.dxf"))
    assert [0.11 in read_sizes(different / f"film-{name}.dxf") for name in ("inner", "outer")] == [True, False]
    assert 0.052 in read_sizes(different / "film-outer.dxf")
    assert 0.008 in read_sizes(different / "base.dxf")


def test_the_assembly_s_list_names_the_bonds(alike: Path, different: Path) -> None:
    text = PdfReader(alike / "assembly.pdf").pages[0].extract_text()
    assert "Film bonded to the base with tape-50um (0.05 mm), to the block with tape-50um (0.05 mm)" in text
    text = PdfReader(different / "assembly.pdf").pages[0].extract_text()
    assert "Outer film bonded to the base with epoxy-20um (0.02 mm), to the block with tape-130um (0.13 mm)" in text


def read_bill(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / "bill-of-materials.csv").open(encoding="utf-8") as file:
        return {row["part"]: row for row in csv.DictReader(file)}


def test_the_bill_has_every_bond(different: Path) -> None:
    bill = read_bill(different)
    wanted = {
        "bond-inner-to-base": ("tape-50um", 0.05, "inner"),
        "bond-inner-to-block": ("tape-50um", 0.05, "inner"),
        "bond-outer-to-base": ("epoxy-20um", 0.02, "outer"),
        "bond-outer-to-block": ("tape-130um", 0.13, "outer"),
    }
    assert {name for name in bill if name.startswith("bond")} == set(wanted)
    for name, (material, thickness, block) in wanted.items():
        assert bill[name]["material"] == material
        assert bill[name]["properties"].startswith(f"{thickness} mm thick, E = ")
        assert float(bill[name]["volume_mm3"]) == pytest.approx(thickness * AREAS_MM2[block], rel=1e-5)
    assert float(bill["film-outer"]["volume_mm3"]) == pytest.approx(0.052 * AREAS_MM2["outer"], rel=1e-5)
    assert bill["film-outer"]["properties"] == "E = 2.5 GPa, Poisson's ratio 0.34"


def test_the_order_of_assembly_names_the_bonds_and_their_heights(alike: Path, different: Path) -> None:
    page = (alike / "assembly.md").read_text(encoding="utf-8")
    assert "Bond each film to the base with tape-50um (0.05 mm);" in page
    assert "then the outer block to the films with tape-50um (0.05 mm)." in page
    assert "Measure the height of film and bonds between block and base: 0.21 mm;" in page
    page = (different / "assembly.md").read_text(encoding="utf-8")
    assert "the inner one with tape-50um (0.05 mm), the outer one with epoxy-20um (0.02 mm)" in page
    assert "the inner one with tape-50um (0.05 mm), the outer one with tape-130um (0.13 mm)" in page
    assert "0.21 mm (inner) and 0.202 mm (outer)" in page


def test_an_inset_of_the_scene_is_that_of_the_pattern(tmp_path: Path, alike: Path) -> None:
    assert 'electrode_inset = "0.5 mm" and [probe.film.outer] electrode_inset = "0.0' in (alike / "assembly.md").read_text()
    folder = write_all(tmp_path, build_film(electrode_inset=0.2e-3, outer={"electrode_inset": 0.03e-3}))
    (inner,) = outlines(folder / "film-inner-pattern.dxf", "ELECTRODE_TOP")
    rim, hole = sorted(outlines(folder / "film-outer-pattern.dxf", "ELECTRODE_TOP"), key=area, reverse=True)
    assert area(inner) == pytest.approx(math.pi * 4.8**2, rel=1e-5)
    assert area(rim) - area(hole) == pytest.approx(math.pi * ((OUTER - 0.03) ** 2 - 5.13**2), rel=1e-5)
    assert "electrode_inset" not in (folder / "assembly.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(("fields", "faces"), [({}, (5.21, 5.21)), ({"outer": OTHER}, (5.21, 5.202))])
def test_the_view_of_a_report_has_the_base_at_the_same_heights(fields: dict[str, Any], faces: tuple[float, float]) -> None:
    lows = [
        1e3 * places[:, 2].min() for name, (places, _) in iterate_probe_meshes(make(film=build_film(**fields))) if name == "base"
    ]
    assert min(lows) == pytest.approx(min(faces), rel=1e-9)
    films = [1e3 * places[:, 2] for name, (places, _) in iterate_probe_meshes(make(film=build_film(**fields))) if name == "film"]
    assert [float(heights.min()) for heights in films] == pytest.approx([5.05, 5.13 if fields else 5.05])
