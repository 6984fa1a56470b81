"""The block in every kind of file for the workshop, as readers that wrote none of them find it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import dxf_parser
import pytest
from pypdf import PdfReader
from steputils import p21

from geometry.cad.export import export_parts
from geometry.provenance.block import build_provenance, record_command, record_scene
from geometry.provenance.texts import read_block, split_block
from geometry.scenes.scene_file import read_scene
from geometry.workshop.package import build_writers
from tests.support.paths import SCENE
from tests.support.workshop import EDGE, probe

WORDS = ["export", str(SCENE), "-o", 'it\'s an\\odd <ü --> %s 100 % "folder"']


def of_step(path: Path) -> Any:
    description = p21.readfile(str(path)).header.entities["FILE_DESCRIPTION"].params[0]
    return json.loads("".join(description[1:]))


def of_dxf(path: Path) -> Any:
    header = dxf_parser.parse(path.read_bytes())["header"]
    assert header["$CUSTOMPROPERTYTAG"] == "provenance"
    return json.loads(header["$CUSTOMPROPERTY"])


def of_pdf(path: Path) -> Any:
    metadata = PdfReader(path).metadata
    assert metadata is not None
    return json.loads(metadata["/Subject"])


def of_markdown(path: Path) -> Any:
    (comment,) = re.findall(r"<!--(?:(?!-->).)*-->", path.read_text(encoding="utf-8"), re.S)
    return json.loads(comment.removeprefix("<!-- provenance =").removesuffix("-->"))


READERS = {".step": of_step, ".dxf": of_dxf, ".pdf": of_pdf, ".md": of_markdown}
FILES = [
    "inner.step", "assembly.step", "mould-outer-upper.step", "outer.dxf", "film-inner-pattern.dxf", "assembly.pdf", "assembly.md",
]  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("made")
    with record_command(WORDS, SCENE):
        export_parts(probe(), folder, other_files=build_writers(probe(), EDGE), edge_radius=EDGE)
        return folder, build_provenance()


@pytest.mark.parametrize("name", FILES)
def test_the_whole_block_is_read_back(made: tuple[Path, dict[str, Any]], name: str) -> None:
    folder, block = made
    assert READERS[Path(name).suffix](folder / name) == block
    assert block["command"][-1] == WORDS[-1]
    assert read_block(folder)[0] == block  # parts.json's


def test_strings_of_a_step_header_are_as_short_as_the_standard_has_them(made: tuple[Path, dict[str, Any]]) -> None:
    description = p21.readfile(str(made[0] / "inner.step")).header.entities["FILE_DESCRIPTION"].params[0]
    assert max(map(len, description)) <= 256  # ISO 10303-21:2016, 8.2.2


def test_pieces_are_one_text() -> None:
    block = {"command": ["a" * 500, "ü"]}
    assert json.loads("".join(split_block(block, 7))) == block
    assert max(map(len, split_block(block, 7))) == 7


def test_what_python_makes_tells_of_its_scene() -> None:
    scene = read_scene(SCENE)
    with record_scene(scene):
        inside = build_provenance()
        with record_command(["plan", str(SCENE)], SCENE):
            assert build_provenance()["command"] == ["plan", SCENE.name]
    assert inside["scene"] == build_provenance(scene)["scene"]
    assert build_provenance()["scene"] is None
