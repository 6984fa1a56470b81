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
from geometry.cad.record import NAME, PARTS, check_asked, check_same, design_of, digest
from geometry.common.errors import InputError
from geometry.scenes.probe import Film, Material, Probe

RUBBER = Material(youngs_modulus=1e6, poisson_ratio=0.4)
FILM = Film(thickness=110e-6)
ASKED, OTHERS = digest({"scene": "one"}), digest({"scene": "another"})


def make(height: float = 5e-3, film: Film | None = FILM, **others: object) -> Probe:
    sizes = {"inner_radius": 5e-3, "area_ratio": 3.7, "gap": 1e-4} | others
    return Probe(height=height, inner=RUBBER, outer=RUBBER, film=film, **sizes)  # type: ignore[arg-type]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    step.export(make(), folder)
    return folder


@pytest.fixture
def folder(exported: Path, tmp_path: Path) -> Path:
    """A copy of exported parts."""
    for name, content in contents(exported).items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def test_the_record_tells_design_assumptions_and_files(exported: Path) -> None:
    told = json.loads((exported / NAME).read_text())
    assert (told["format"], told["version"], told["asked"]) == ("probe-design parts", 1, None)
    assert told["assumed"] == {"probe.base.thickness": f"{0.3 * math.sqrt(5.1**2 + 25 / 3.7):.6g} mm"}  # 0.3 Ro
    assert told["files"] == {name: hashlib.sha256((exported / name).read_bytes()).hexdigest() for name in PARTS}


def test_the_same_design_is_exported_again(folder: Path) -> None:
    step.export(make(), folder, beside={"drawing.png": lambda path: path.write_bytes(b"drawn")})
    step.export(make(), folder)
    told = json.loads((folder / NAME).read_text())
    assert told["files"]["drawing.png"] == hashlib.sha256(b"drawn").hexdigest()
    assert check_same(folder, make()) is not None


def test_another_design_is_refused_and_nothing_changes(folder: Path) -> None:
    before = contents(folder)
    with pytest.raises(InputError, match=r"^output = .*those there are of another design\); --force replaces them$") as fault:
        step.export(make(height=5.001e-3), folder)
    assert fault.value.exit_code == 2
    assert contents(folder) == before


def missing(folder: Path) -> None:
    (folder / NAME).unlink()


def empty(folder: Path) -> None:
    (folder / NAME).write_bytes(b"")


def torn(folder: Path) -> None:
    (folder / NAME).write_bytes((folder / NAME).read_bytes()[:-20])


def of_another_version(folder: Path) -> None:
    (folder / NAME).write_text((folder / NAME).read_text().replace('"version": 1', '"version": 2'))


def nested(folder: Path) -> None:
    (folder / NAME).write_text("[" * 100_000)


def a_folder(folder: Path) -> None:
    (folder / NAME).unlink()
    (folder / NAME).mkdir()


def a_pipe(folder: Path) -> None:
    (folder / NAME).unlink()
    os.mkfifo(folder / NAME)


def no_text(folder: Path) -> None:
    (folder / NAME).write_bytes(b"\xff\xfe\x00")


def a_part_of_another(folder: Path) -> None:
    (folder / "inner.step").write_text("another")


def a_part_that_is_a_pipe(folder: Path) -> None:
    (folder / "base.step").unlink()
    os.mkfifo(folder / "base.step")


DAMAGE = [missing, empty, torn, of_another_version, nested, a_folder, a_pipe, no_text, a_part_of_another, a_part_that_is_a_pipe]


@pytest.mark.parametrize("damage", DAMAGE, ids=lambda one: one.__name__)
def test_parts_whose_design_cannot_be_told_are_refused(damage: Callable[[Path], None], folder: Path) -> None:
    damage(folder)
    for probe in (make(), make(height=6e-3)):
        with pytest.raises(InputError, match=r"(is missing|is damaged|is not the file listed in parts\.json)\); --force"):
            check_same(folder, probe)
    with pytest.raises(InputError, match="--force"):
        check_asked(folder, ASKED)


@given(st.data())
def test_any_damage_to_the_record_is_refused_or_leaves_it_as_it_was(exported: Path, data: st.DataObject) -> None:
    whole = (exported / NAME).read_bytes()
    start = data.draw(st.integers(0, len(whole)))
    damaged = whole[:start] + data.draw(st.binary(max_size=8)) + whole[data.draw(st.integers(start, len(whole))) :]
    (exported / NAME).write_bytes(damaged)
    try:
        taken = check_same(exported, make()) is not None
    except InputError:
        taken = False
    finally:
        (exported / NAME).write_bytes(whole)
    assert not taken or json.loads(damaged)["design"] == json.loads(whole)["design"]


def test_force_replaces_all_that_was_written_of_the_other_design(folder: Path) -> None:
    first = {name: lambda path: path.write_text("of the first") for name in ("report.html", "design.toml")}
    step.export(make(), folder, beside=first)
    (folder / "design.toml").write_text("changed by its user")
    (folder / "notes.txt").write_text("the user's own")
    step.export(make(film=None), folder, force=True)
    assert sorted(contents(folder)) == sorted(
        ["inner.step", "outer.step", "base.step", "assembly.step", NAME, "design.toml", "notes.txt"]
    )
    assert check_same(folder, make(film=None)) is not None


def test_force_on_the_same_design_keeps_what_was_written_of_it(folder: Path) -> None:
    step.export(make(), folder, beside={"report.html": lambda path: path.write_text("of this design")})
    a_part_of_another(folder)
    step.export(make(), folder, force=True)
    assert (folder / "report.html").exists()
    assert check_same(folder, make()) is not None


def test_a_question_is_asked_again_but_no_other(tmp_path: Path, folder: Path) -> None:
    check_asked(tmp_path / "new", ASKED)
    with pytest.raises(InputError, match="of another design"):
        check_asked(folder, ASKED)  # exported by hand
    step.export(make(), folder, asked=ASKED)
    step.export(make(), folder)  # the same design, by hand
    check_asked(folder, ASKED)
    with pytest.raises(InputError, match="of another design"):
        check_asked(folder, OTHERS)


def test_a_design_is_its_numbers_however_they_are_given() -> None:
    radius = make().tube_radius
    same = make(area_ratio=None, outer_radius=radius, base={"rigid": True, "thickness": 0.3 * radius})
    assert design_of(same) == design_of(make())
    others = [make(height=5.0001e-3), make(film=None), make(film=Film(thickness=111e-6)), make(gap=1.0001e-4)]
    others += [make(base={"rigid": True, "thickness": 2e-3}), make(groove={"width": 2e-3, "depth": 1e-3})]
    assert len({design_of(one) for one in (make(), *others)}) == 1 + len(others)
