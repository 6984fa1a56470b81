"""A folder holds the parts of one design: another's are refused, whatever became of the record, and replaced as a whole."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from geometry.cad import export as step
from geometry.cad.parts_record import (
    PART_FILES,
    RECORD_NAME,
    check_same_design,
    check_same_question,
    compute_design_digest,
    compute_digest,
)
from geometry.common.errors import InputError
from geometry.scenes.film import Film
from geometry.scenes.probe import Material, Probe

RUBBER = Material(youngs_modulus=1e6, poisson_ratio=0.4)
FILM = Film(thickness=110e-6)
ASKED, OTHERS = compute_digest({"scene": "one"}), compute_digest({"scene": "another"})


def make(height: float = 5e-3, film: Film | None = FILM, **others: object) -> Probe:
    sizes = {"inner_radius": 5e-3, "area_ratio": 3.7, "gap": 1e-4} | others
    return Probe(height=height, inner=RUBBER, outer=RUBBER, film=film, **sizes)  # type: ignore[arg-type]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    step.export_parts(make(), folder)
    return folder


@pytest.fixture
def folder(exported: Path, tmp_path: Path) -> Path:
    """A copy of exported parts."""
    for name, content in contents(exported).items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def test_the_record_tells_design_assumptions_and_files(exported: Path) -> None:
    record = json.loads((exported / RECORD_NAME).read_text())
    assert (record["format"], record["version"], record["asked"]) == ("probe-design parts", 1, None)
    assert record["assumed"] == {"probe.base.thickness": f"{0.3 * math.sqrt(5.1**2 + 25 / 3.7):.6g} mm"}  # 0.3 Ro
    assert record["files"] == {name: hashlib.sha256((exported / name).read_bytes()).hexdigest() for name in PART_FILES}


def test_the_same_design_is_exported_again(folder: Path) -> None:
    step.export_parts(make(), folder, other_files={"drawing.png": lambda path: path.write_bytes(b"drawn")})
    step.export_parts(make(), folder)
    record = json.loads((folder / RECORD_NAME).read_text())
    assert record["files"]["drawing.png"] == hashlib.sha256(b"drawn").hexdigest()
    assert check_same_design(folder, make()) is not None


def test_another_design_is_refused_and_nothing_changes(folder: Path) -> None:
    contents_before = contents(folder)
    with pytest.raises(InputError, match=r"^output = .*those there are of another design\); --force replaces them$") as fault:
        step.export_parts(make(height=5.001e-3), folder)
    assert fault.value.exit_code == 2
    assert contents(folder) == contents_before


def missing(folder: Path) -> None:
    (folder / RECORD_NAME).unlink()


def empty(folder: Path) -> None:
    (folder / RECORD_NAME).write_bytes(b"")


def torn(folder: Path) -> None:
    (folder / RECORD_NAME).write_bytes((folder / RECORD_NAME).read_bytes()[:-20])


def of_another_version(folder: Path) -> None:
    (folder / RECORD_NAME).write_text((folder / RECORD_NAME).read_text().replace('"version": 1', '"version": 2'))


def nested(folder: Path) -> None:
    (folder / RECORD_NAME).write_text("[" * 100_000)


def a_folder(folder: Path) -> None:
    (folder / RECORD_NAME).unlink()
    (folder / RECORD_NAME).mkdir()


def a_pipe(folder: Path) -> None:
    (folder / RECORD_NAME).unlink()
    os.mkfifo(folder / RECORD_NAME)


def no_text(folder: Path) -> None:
    (folder / RECORD_NAME).write_bytes(b"\xff\xfe\x00")


def a_part_of_another(folder: Path) -> None:
    (folder / "inner.step").write_text("another")


def a_part_that_is_a_pipe(folder: Path) -> None:
    (folder / "base.step").unlink()
    os.mkfifo(folder / "base.step")


DAMAGE = [missing, empty, torn, of_another_version, nested, a_folder, a_pipe, no_text, a_part_of_another, a_part_that_is_a_pipe]


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda function: function.__name__)
def test_parts_whose_design_cannot_be_told_are_refused(damage: Callable[[Path], None], folder: Path) -> None:
    damage(folder)
    for probe in (make(), make(height=6e-3)):
        with pytest.raises(InputError, match=r"(is missing|is damaged|is not the file listed in parts\.json)\); --force"):
            check_same_design(folder, probe)
    with pytest.raises(InputError, match="--force"):
        check_same_question(folder, ASKED)


@given(st.data())
def test_any_damage_to_the_record_is_refused_or_leaves_it_as_it_was(exported: Path, data: st.DataObject) -> None:
    whole = (exported / RECORD_NAME).read_bytes()
    start = data.draw(st.integers(0, len(whole)))
    damaged = whole[:start] + data.draw(st.binary(max_size=8)) + whole[data.draw(st.integers(start, len(whole))) :]
    (exported / RECORD_NAME).write_bytes(damaged)
    try:
        taken = check_same_design(exported, make()) is not None
    except InputError:
        taken = False
    finally:
        (exported / RECORD_NAME).write_bytes(whole)
    assert not taken or json.loads(damaged)["design"] == json.loads(whole)["design"]


def test_force_replaces_all_that_was_written_of_the_other_design(folder: Path) -> None:
    first = {name: lambda path: path.write_text("of the first") for name in ("report.html", "design.toml")}
    step.export_parts(make(), folder, other_files=first)
    (folder / "design.toml").write_text("changed by its user")
    (folder / "notes.txt").write_text("the user's own")
    step.export_parts(make(film=None), folder, force=True)
    assert sorted(contents(folder)) == sorted(
        ["inner.step", "outer.step", "base.step", "assembly.step", RECORD_NAME, "design.toml", "notes.txt"]
    )
    assert check_same_design(folder, make(film=None)) is not None


def test_force_on_the_same_design_keeps_what_was_written_of_it(folder: Path) -> None:
    step.export_parts(make(), folder, other_files={"report.html": lambda path: path.write_text("of this design")})
    a_part_of_another(folder)
    step.export_parts(make(), folder, force=True)
    assert (folder / "report.html").exists()
    assert check_same_design(folder, make()) is not None


def test_a_question_is_asked_again_but_no_other(tmp_path: Path, folder: Path) -> None:
    check_same_question(tmp_path / "new", ASKED)
    with pytest.raises(InputError, match="of another design"):
        check_same_question(folder, ASKED)  # exported by hand
    step.export_parts(make(), folder, question_digest=ASKED)
    step.export_parts(make(), folder)  # the same design, by hand
    check_same_question(folder, ASKED)
    with pytest.raises(InputError, match="of another design"):
        check_same_question(folder, OTHERS)


def test_a_design_is_its_numbers_however_they_are_given() -> None:
    radius = make().tube_radius
    same_design = make(area_ratio=None, outer_radius=radius, base={"rigid": True, "thickness": 0.3 * radius})
    assert compute_design_digest(same_design) == compute_design_digest(make())
    designs = [make(height=5.0001e-3), make(film=None), make(film=Film(thickness=111e-6)), make(gap=1.0001e-4)]
    designs += [make(base={"rigid": True, "thickness": 2e-3}), make(groove={"width": 2e-3, "depth": 1e-3})]
    assert len({compute_design_digest(design) for design in (make(), *designs)}) == 1 + len(designs)
