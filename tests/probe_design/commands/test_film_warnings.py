"""What the program says of films without bonds, and of keys that an older version had: one line each, and JSON stays JSON."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.paths import EXAMPLES
from tests.support.program import run, started

EXAMPLE = (EXAMPLES / "scene.toml").read_text(encoding="utf-8")
ADHESIVE = 'adhesive_thickness = "50 um"\nadhesive_modulus = "1 MPa"\n'
BOND = 'bond_to_base = {thickness = "50 um", youngs_modulus = "1 MPa", poisson_ratio = 0.3}\n'


def write_scene(folder: Path, film: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(EXAMPLE.replace("[tissue]", f"[probe.film]\n{film}\n[tissue]"), encoding="utf-8")
    return path


def list_bond_warnings(output: dict[str, list[str]]) -> list[str]:
    return [line for line in output["warnings"] if "bonded rigidly" in line]


@pytest.mark.parametrize(
    ("film", "start"),
    [
        ("", "the film is"),
        ("[probe.film.outer]\n" + BOND, "the inner film is"),
        (BOND, None),
        ("psi1 = 0.0", None),
        ('bond_to_base = {name = "rigid"}', None),
    ],
    ids=["none", "outer", "bond", "psi", "rigid"],
)
def test_a_film_without_bonds_is_warned_of_once(tmp_path: Path, film: str, start: str | None) -> None:
    path = write_scene(tmp_path, film)
    warnings = list_bond_warnings(json.loads(run("evaluate", path, "--json").stdout))
    assert len(warnings) == (start is not None)
    assert run("evaluate", path).stderr.count("bonded rigidly") == (start is not None)
    if start is not None:
        assert warnings[0].startswith(start)
        assert "tape makes its charge 5 to 15 times larger: give [probe.film.bond_to_base]" in warnings[0]


READ_BY_CHARGE = '\n[reading]\nobservable = "charge"\n'


@pytest.mark.parametrize(
    "command",
    [
        ("curve", "SCENE", "--from", "10 kPa", "--to", "60 kPa", "--points", 3),
        ("scan", "SCENE", "--along", "x", "--from", "0 mm", "--to", "4 mm", "--points", 2),
        ("estimate", "SCENE", "--ratio", 0.48, "--noise", 0.05),
    ],
    ids=["curve", "scan", "estimate"],
)
def test_what_reads_charges_of_a_film_without_bonds_warns_of_it(tmp_path: Path, command: tuple[str | float, ...]) -> None:
    """And what reads stresses does not."""
    path = write_scene(tmp_path, "")
    arguments = [path if word == "SCENE" else word for word in command]
    assert "bonded rigidly" not in run(*arguments).stderr
    path.write_text(path.read_text(encoding="utf-8") + READ_BY_CHARGE, encoding="utf-8")
    assert run(*arguments).stderr.count("bonded rigidly") == 1


def test_bonds_that_eq_12_leaves_out_are_warned_of(tmp_path: Path) -> None:
    output = json.loads(run("evaluate", write_scene(tmp_path, "psi1 = 0.0\n" + BOND), "--json").stdout)
    assert any("eq. (12)" in line for line in output["warnings"])
    assert output["charge_per_force_outer"] == pytest.approx(-20e-12)


def test_an_adhesive_of_an_older_version_is_a_bond_and_one_line(tmp_path: Path) -> None:
    """In a process of its own, where every warning of Python is an error, and in one that shows them."""
    path = write_scene(tmp_path, ADHESIVE)
    ended = started("evaluate", path, "--json")
    lines = [line for line in ended.stderr.splitlines() if "adhesive_thickness" in line]
    assert ended.returncode == 0
    assert len(lines) == 1
    assert lines[0].startswith("probe-design: warning: [probe.film] adhesive_thickness")
    assert "FutureWarning" not in ended.stderr
    old = json.loads(ended.stdout)
    new = json.loads(run("evaluate", write_scene(tmp_path, BOND), "--json").stdout)
    assert {key: value for key, value in old.items() if "charge" in key} == {
        key: value for key, value in new.items() if "charge" in key
    }
