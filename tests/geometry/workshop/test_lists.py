"""Bill of materials, tolerances and order of assembly: what they state, compared with the scene's numbers."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest
from pypdf import PdfReader

from geometry.scenes.catalogue import find_material, list_materials
from geometry.scenes.film import Bond, Film
from geometry.scenes.probe import Base, Material
from geometry.workshop.package import Casting, build_writers
from geometry.workshop.tolerance import find_process, find_tolerance, format_deviation
from tests.support.parts import make
from tests.support.workshop import BUDGET, EDGE, probe

EDGE_MM = 1e3 * EDGE


def rows(path: Path, key: str) -> dict[str, dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return {row[key]: row for row in csv.DictReader(file)}


def held(path: Path) -> dict[str, dict[str, str]]:
    """Rows of ``tolerances.csv`` by drawing and quantity."""
    with path.open(encoding="utf-8") as file:
        return {f"{row['drawing']} {row['quantity']}": row for row in csv.DictReader(file)}


def text(name: str, folder: Path, **options: object) -> str:
    build_writers(make(**options))[name](folder / name)
    return (folder / name).read_text(encoding="utf-8")


def test_bill_of_materials(package: Path) -> None:
    bill = rows(package / "bill-of-materials.csv", "part")
    parts = ["inner", "outer", "film-inner", "film-outer", "base"]
    assert list(bill)[:5] == parts
    assert [bill[name]["source_file"] for name in parts] == [f"{name}.step" for name in parts]
    volume = math.pi * 25 * 0.11
    assert float(bill["film-inner"]["volume_mm3"]) == pytest.approx(volume, rel=1e-5)
    assert float(bill["film-inner"]["mass_g"]) == pytest.approx(volume * 1.78e-3, rel=1e-5)  # 1780 kg/m^3
    assert bill["inner"]["mass_g"] == ""  # nobody has said which product
    assert bill["inner"]["properties"] == "E = 1 MPa, Poisson's ratio 0.4"
    lid, shrunk = 6.0, 1 - 1e-3  # mm; linear
    sprues = math.pi * (1.25**2 + 2 * 0.5**2) * lid  # the hole is a quarter of the radius
    # eq. WS.1 undone, to what the draft adds to a block of these walls: (h tan(draft))^2 / 12 of the mean radius squared
    block = math.pi * (25 * 5) - math.tau * (4.8 * (1 - math.pi / 4) * EDGE_MM**2 + EDGE_MM**3 / 6)
    mixed = float(bill["casting-inner"]["volume_mm3"])
    assert (mixed - sprues) * shrunk**3 == pytest.approx(block, rel=1e-3)
    assert (bill["casting-inner"]["material"], bill["casting-inner"]["mass_g"]) == ("mixed elastomer", "")
    assert all(float(row["volume_mm3"]) > 0 for name, row in bill.items() if name != "shim")
    assert {name for name in bill if "mould" in name} == {
        f"mould-{b}-{h}" for b in ("inner", "outer") for h in ("lower", "upper")
    }


def test_a_named_material_is_on_the_bill_and_in_the_drawings(tmp_path: Path) -> None:
    named = make(outer=Material.model_validate({"material": "dragon-skin-30"}), base=Base(rigid=True, material="pmma"))
    made = build_writers(named)
    for name in ("bill-of-materials.csv", "outer.pdf", "assembly.pdf", "assembly.md"):
        made[name](tmp_path / name)
    bill = rows(tmp_path / "bill-of-materials.csv", "part")
    assert [bill[part]["material"] for part in ("inner", "outer", "base")] == ["elastomer", "dragon-skin-30", "pmma"]
    assert bill["outer"]["properties"] == "E = 668 kPa, Poisson's ratio 0.495"
    assert bill["casting-outer"]["material"] == "mixed dragon-skin-30"
    assert "of degassed dragon-skin-30 through" in (tmp_path / "assembly.md").read_text(encoding="utf-8")
    for name in ("outer.pdf", "assembly.pdf"):
        assert "dragon-skin-30, E = 668 kPa" in PdfReader(tmp_path / name).pages[0].extract_text()


def test_bonds_are_counted(tmp_path: Path) -> None:
    film = Film(thickness=110e-6, bond_to_base=Bond(thickness=20e-6, youngs_modulus=1e9, poisson_ratio=0.4))
    (tmp_path / "bill-of-materials.csv").write_text(text("bill-of-materials.csv", tmp_path, film=film, groove=None))
    bill = rows(tmp_path / "bill-of-materials.csv", "part")
    for name, share in (("inner", 1.0), ("outer", 1 / 3.7)):
        volume = float(bill[f"bond-{name}-to-base"]["volume_mm3"])
        assert volume == pytest.approx(0.02 * math.pi * 25 * share, rel=1e-5)
    assert "0.02 mm of bond" in text("assembly.md", tmp_path, film=film)


def test_tolerances(package: Path) -> None:
    """Castings by ISO 3302-1 M2, whatever the ratio wants; a deviation is sqrt(3) standard deviations."""
    table = held(package / "tolerances.csv")
    inner, height = table["inner inner_diameter"], table["outer outer_height"]
    assert (inner["nominal"], inner["deviation"], inner["from"], inner["wanted"]) == ("10", "0.2", "ISO 3302-1 M2", "0.04")
    assert float(inner["ratio_percent"]) == pytest.approx(100 * 0.6 * 0.2 / 10 / math.sqrt(3), rel=5e-3)
    assert (height["deviation"], height["from"]) == ("0.2", "ISO 3302-1 M2")  # tighter than the ratio wants it
    assert float(height["ratio_percent"]) == pytest.approx(100 * 0.05 * 0.2 / 5 / math.sqrt(3), rel=5e-3)
    assert table["film-inner inner_diameter"]["from"] == "ISO 2768-m"
    assert "assembly gap" not in table  # it follows from both castings


def test_tolerances_of_machined_blocks(tmp_path: Path) -> None:
    hard = Material(youngs_modulus=3e9, poisson_ratio=0.35)
    made = build_writers(make(inner=hard, outer=hard), budget=BUDGET)
    made["tolerances.csv"](tmp_path / "tolerances.csv")
    table = held(tmp_path / "tolerances.csv")
    deviations = {name: (row["deviation"], row["from"]) for name, row in table.items()}
    assert deviations["inner inner_diameter"] == ("0.04", "the ratio")
    assert deviations["outer outer_height"] == ("0.1", "ISO 2768-m")
    assert deviations["assembly gap"] == ("0.01", "10 % of the size")
    assert not [name for name in made if "mould" in name]  # nothing is cast


def test_the_order_of_assembly_tells_the_shim(package: Path) -> None:
    page = (package / "assembly.md").read_text(encoding="utf-8")
    assert "three shims of 0.1 mm" in page
    assert f"0.1 mm, \u00b1{math.sqrt(2) * 0.2 / 2:.2f} mm by their tolerances" in page  # both walls' deviations
    assert "is within reach of the castings' tolerances" in page
    total = 100 * math.hypot(0.6 * 0.2 / 10, 0.05 * 0.2 / 5) / math.sqrt(3)
    assert f"scatter in the ratio by {total:.3g} % (1 sd" in page
    assert "inner block's diameter 0.69 %" in page
    steps = [line for line in page.splitlines() if line[:1].isdigit()]
    assert [int(line.split(".")[0]) for line in steps] == list(range(1, len(steps) + 1))


def test_without_films_there_is_nothing_of_them(tmp_path: Path) -> None:
    names = build_writers(make(film=None, groove=None)).keys()
    assert not [name for name in names if "film" in name]
    assert "film" not in text("assembly.md", tmp_path, film=None, groove=None).replace("film end", "")


def test_a_lead_that_cannot_leave_is_told(tmp_path: Path) -> None:
    assert "give the scene a [probe.groove]" in text("assembly.md", tmp_path, groove=None)


def test_casting_is_handed_on(tmp_path: Path) -> None:
    build_writers(probe(), EDGE, casting=Casting(shrinkage=0.02))["assembly.md"](tmp_path / "assembly.md")
    assert "shrinkage 2 %" in (tmp_path / "assembly.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("size", "bound", "radius", "wanted"),  # ISO 2768-1, tables 1 and 2, class m
    [
        (1.0, None, False, (0.1, False)),
        (6.0, None, False, (0.1, False)),
        (6.1, None, False, (0.2, False)),
        (30.1, None, False, (0.3, False)),
        (120.0, None, False, (0.3, False)),
        (0.4, None, False, (0.04, True)),
        (0.6, None, False, (0.06, True)),
        (5.0, None, True, (0.5, False)),
        (10.0, 0.03, False, (0.03, True)),
        (10.0, 0.001, False, (0.0075, True)),  # half of IT7, ISO 286-1
        (10.0, 0.3, False, (0.2, False)),
        (5000.0, None, False, (500.0, True)),
    ],
)
def test_general_tolerances(size: float, bound: float | None, radius: bool, wanted: tuple[float, bool]) -> None:
    deviation = find_tolerance(size, bound, radius)
    assert (deviation.deviation, deviation.is_stated) == (pytest.approx(wanted[0]), wanted[1])


@pytest.mark.parametrize(
    ("process", "size", "closure", "wanted"),  # ISO 3302-1, table 1, class M2; 1 % or 0.5 mm; 0.5 % or 0.16 mm
    [
        ("casting", 4.0, False, 0.10),
        ("casting", 4.0, True, 0.15),
        ("casting", 6.3, False, 0.15),
        ("casting", 6.3, True, 0.20),
        ("casting", 10.1, False, 0.20),
        ("casting", 10.1, True, 0.25),
        ("casting", 30.0, False, 0.35),
        ("casting", 200.0, True, 1.4),
        ("filament-printing", 10.0, False, 0.5),
        ("filament-printing", 100.0, False, 1.0),
        ("resin-printing", 10.0, False, 0.16),
        ("resin-printing", 100.0, False, 0.5),
    ],
)
def test_tolerances_of_processes(process: str, size: float, closure: bool, wanted: float) -> None:
    for bound in (None, 1e-3):
        deviation = find_tolerance(size, bound, process=process, closure=closure)
        assert (deviation.deviation, deviation.is_stated) == (pytest.approx(wanted), True)


def test_every_material_has_a_process() -> None:
    for material in list_materials().values():
        assert find_process(material.process).source
    assert find_material("pla-printed").process == "filament-printing"


@pytest.mark.parametrize(
    ("value", "wanted"), [(0.0299, "0.029"), (0.1, "0.1"), (1.299, "1.2"), (129.0, "120"), (3.7e-5, "0.000037")]
)
def test_deviations_are_rounded_down(value: float, wanted: str) -> None:
    assert format_deviation(value) == wanted
