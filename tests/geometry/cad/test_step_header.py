"""What the headers of STEP files state, read by steputils: a reader of ISO 10303-21 that knows nothing of OpenCASCADE."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from steputils import p21

from geometry.cad import export as step
from geometry.cad.parts_record import compute_design_digest
from geometry.scenes.probe import Base, Material
from tests.support.parts import make

PROGRAM = f"probe-design {version('palpation-probe-design')}"
NAMES = ["inner", "outer", "film-inner", "film-outer", "base"]


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("step")
    step.export_parts(make(), folder)
    return folder


def entities(file: Any, name: str) -> Iterator[tuple[Any, ...]]:
    for entity in file.data[0].instances.values():
        if p21.is_simple_entity_instance(entity) and entity.entity.name == name:
            yield entity.entity.params


@pytest.mark.parametrize("name", [*NAMES, "assembly"])
def test_header_tells_schema_design_program_and_unit(exported: Path, name: str) -> None:
    header = p21.readfile(str(exported / f"{name}.step")).header.entities
    assert header["FILE_SCHEMA"].params[0][0].startswith("AP242_MANAGED_MODEL_BASED_3D_ENGINEERING")
    text = header["FILE_DESCRIPTION"].params[0][0]
    assert compute_design_digest(make()) in text
    assert text.endswith(f"{PROGRAM}; millimetres")
    file, time, _, _, _, system, _ = header["FILE_NAME"].params
    assert (file, time, system) == (f"{name}.step", "1970-01-01T00:00:00", PROGRAM)


@pytest.mark.parametrize("name", NAMES)
def test_each_part_tells_its_material(exported: Path, name: str) -> None:
    wanted = {"film-inner": ("piezoelectric PVDF film", "E = 2.5 GPa, Poisson's ratio 0.34, density 1780 kg/m3")}
    wanted["film-outer"] = wanted["film-inner"]
    wanted["base"] = ("rigid material", "metal or glass-filled polymer, far stiffer than the blocks")
    rubber = ("elastomer", "E = 1 MPa, Poisson's ratio 0.4")
    file = p21.readfile(str(exported / f"{name}.step"))
    assert [(kind, text) for kind, text in entities(file, "DESCRIPTIVE_REPRESENTATION_ITEM")] == [wanted.get(name, rubber)]


def test_a_named_material_is_told_by_its_name(tmp_path: Path) -> None:
    cast, plate = Material.model_validate({"material": "dragon-skin-30"}), Base(rigid=True, material="pmma")
    step.export_parts(make(outer=cast, base=plate), tmp_path)
    file = p21.readfile(str(tmp_path / "outer.step"))
    assert [*entities(file, "DESCRIPTIVE_REPRESENTATION_ITEM")] == [("dragon-skin-30", "E = 668 kPa, Poisson's ratio 0.495")]
    kinds = {params[0] for params in entities(p21.readfile(str(tmp_path / "assembly.step")), "DESCRIPTIVE_REPRESENTATION_ITEM")}
    assert kinds == {"elastomer", "dragon-skin-30", "piezoelectric PVDF film", "pmma"}
    assert compute_design_digest(make(outer=cast)) != compute_design_digest(
        make(outer=Material(youngs_modulus=668e3, poisson_ratio=0.495))
    )


def test_the_assembly_names_its_parts_and_their_materials(exported: Path) -> None:
    file = p21.readfile(str(exported / "assembly.step"))
    assert [params[0] for params in entities(file, "PRODUCT")] == ["probe", *NAMES]
    kinds = {params[0] for params in entities(file, "DESCRIPTIVE_REPRESENTATION_ITEM")}
    assert kinds == {"elastomer", "piezoelectric PVDF film", "rigid material"}
    assert len(list(entities(file, "PROPERTY_DEFINITION"))) == len(NAMES)


def test_the_same_design_gives_the_same_file(exported: Path, tmp_path: Path) -> None:
    step.export_parts(make(), tmp_path)
    assert all((tmp_path / f"{name}.step").read_bytes() == (exported / f"{name}.step").read_bytes() for name in NAMES)
