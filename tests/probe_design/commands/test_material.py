"""`probe-design material`: tables that a scene takes as they are, each number with its source."""

from __future__ import annotations

import json
import math
import tomllib

import pytest

from geometry.scenes.scene_file import scene_from_dict
from tests.support.paths import EXAMPLES
from tests.support.program import refused, run

SCENE = (EXAMPLES / "scene.toml").read_text(encoding="utf-8")


def test_the_list_names_all() -> None:
    output = json.loads(run("material", "list", "--json").stdout)["materials"]
    assert {"elastomer", "base", "film", "bond"} == {entry["kind"] for entry in output.values()}
    lines = run("material", "list").stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(output)
    assert next(line for line in lines if line.startswith("ecoflex-00-10")).split()[2:6] == [
        "36.07",
        "kPa",
        "±",
        "41",
    ]  # not ± kPa


@pytest.mark.parametrize(
    "words",
    [("dragon-skin-30",), ("ecoflex-00-10", "--thinner", "0.3"), ("sylgard-184", "--ratio", "20"), ("pmma",), ("pvdf-28um",)],
)
def test_what_is_shown_is_a_table_of_a_scene(words: tuple[str, ...]) -> None:
    shown = tomllib.loads(run("material", "show", *words).stdout)
    output = json.loads(run("material", "show", *words, "--json").stdout)
    ((_, table),) = shown["probe"].items()
    assert [table] == list(output["table"].values())
    assert set(output["sources"]) == set(table)
    entries = tomllib.loads(SCENE)
    scene = scene_from_dict(entries | {"probe": entries["probe"] | shown["probe"]})
    (part,) = shown["probe"]
    assert getattr(scene.probe, part).youngs_modulus == pytest.approx(output["youngs_modulus"])


@pytest.mark.parametrize("name", ["rigid", "epoxy-20um", "tape-25um", "tape-50um", "tape-130um"])
def test_a_bond_is_shown_as_a_table_of_a_scene_whose_name_alone_does(name: str) -> None:
    text = run("material", "show", name).stdout
    shown, output = (
        tomllib.loads(text)["probe"]["film"]["bond_to_base"],
        json.loads(run("material", "show", name, "--json").stdout),
    )
    assert shown == output["table"]["probe.film.bond_to_base"]
    assert set(output["sources"]) == set(shown)
    assert all(f"\n{key} = " in text for key in shown)
    entries = tomllib.loads(SCENE)
    bonds = [
        scene_from_dict(entries | {"probe": entries["probe"] | {"film": {"bond_to_base": table}}}).probe.film.bond_to_base
        for table in (shown, {"name": name})
    ]
    assert bonds[0] == bonds[1]
    assert (bonds[0].thickness, bonds[0].youngs_modulus) == (output["thickness"], output["youngs_modulus"])


def test_a_tape_is_three_times_the_shear_modulus_of_the_sources() -> None:
    """FILM.md: shear modulus 0.05-0.2 MPa, E = 3 G, nu 0.49."""
    output = json.loads(run("material", "show", "tape-50um", "--json").stdout)
    assert output["thickness"] == pytest.approx(50e-6)
    assert output["poisson_ratio"] == 0.49
    for end in (0.05e6, 0.2e6):
        assert abs(math.log(3 * end / output["youngs_modulus"])) == pytest.approx(output["log_sd"], abs=0.005)


def test_both_databases_and_their_licences_are_shown() -> None:
    text = run("material", "show", "ecoflex-00-30").stdout
    for said in ("97.3 kPa", "48 kPa", "CC BY 4.0", "ODbL 1.0", "compression", "tension", "factor of 2.03"):
        assert said in text


REFUSED = (
    "show liver",
    "frob",
    "show ecoflex-00-30 --thinner 0.3",
    "show pmma --thinner x",
    "show tape-5um",
    "show tape-50um --ratio 2",
)


@pytest.mark.parametrize("words", REFUSED)
def test_what_is_not_there_is_refused(words: str) -> None:
    assert ": allowed: " in refused("material", *words.split())
