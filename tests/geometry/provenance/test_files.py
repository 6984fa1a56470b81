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

from geometry.cad.export import export
from geometry.provenance.block import about, command, provenance
from geometry.provenance.texts import block_of, pieces
from geometry.scenes.scene_file import read_scene
from geometry.workshop.package import writers
from tests.support.paths import SCENE
from tests.support.workshop import EDGE, probe

WORDS = ["export", str(SCENE), "-o", 'it\'s an\\odd <ü --> %s 100 % "folder"']


def of_step(path: Path) -> Any:
    told = p21.readfile(str(path)).header.entities["FILE_DESCRIPTION"].params[0]
    return json.loads("".join(told[1:]))


def of_dxf(path: Path) -> Any:
    header = dxf_parser.parse(path.read_bytes())["header"]
    assert header["$CUSTOMPROPERTYTAG"] == "provenance"
    return json.loads(header["$CUSTOMPROPERTY"])


def of_pdf(path: Path) -> Any:
    told = PdfReader(path).metadata
    assert told is not None
    return json.loads(told["/Subject"])


def of_markdown(path: Path) -> Any:
    (found,) = re.findall(r"<!--(?:(?!-->).)*-->", path.read_text(encoding="utf-8"), re.S)
    return json.loads(found.removeprefix("<!-- provenance =").removesuffix("-->"))


READERS = {".step": of_step, ".dxf": of_dxf, ".pdf": of_pdf, ".md": of_markdown}
FILES = [
    "inner.step", "assembly.step", "mould-outer-upper.step", "outer.dxf", "film-inner-pattern.dxf", "assembly.pdf", "assembly.md",
]  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("made")
    with command(WORDS, SCENE):
        export(probe(), folder, beside=writers(probe(), EDGE), edge_radius=EDGE)
        return folder, provenance()


@pytest.mark.parametrize("name", FILES)
def test_the_whole_block_is_read_back(made: tuple[Path, dict[str, Any]], name: str) -> None:
    folder, block = made
    assert READERS[Path(name).suffix](folder / name) == block
    assert block["command"][-1] == WORDS[-1]
    assert block_of(folder)[0] == block  # parts.json's


def test_strings_of_a_step_header_are_as_short_as_the_standard_has_them(made: tuple[Path, dict[str, Any]]) -> None:
    told = p21.readfile(str(made[0] / "inner.step")).header.entities["FILE_DESCRIPTION"].params[0]
    assert max(map(len, told)) <= 256  # ISO 10303-21:2016, 8.2.2


def test_pieces_are_one_text() -> None:
    block = {"command": ["a" * 500, "ü"]}
    assert json.loads("".join(pieces(block, 7))) == block
    assert max(map(len, pieces(block, 7))) == 7


def test_what_python_makes_tells_of_its_scene() -> None:
    scene = read_scene(SCENE)
    with about(scene):
        inside = provenance()
        with command(["plan", str(SCENE)], SCENE):
            assert provenance()["command"] == ["plan", SCENE.name]
    assert inside["scene"] == provenance(scene)["scene"]
    assert provenance()["scene"] is None
