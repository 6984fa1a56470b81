"""Films and their bonds in a scene: what is given, what is inherited, and what is refused."""

from __future__ import annotations

import tomllib
import warnings
from typing import Any

import pytest

from geometry import InputError, Scene, read_scene, scene_from_dict, scene_from_toml, scene_to_toml
from geometry.common.errors import ObsoleteKeyWarning
from geometry.scenes.fit_check import list_doubts
from tests.support.paths import EXAMPLES

TABLES = tomllib.loads((EXAMPLES / "scene.toml").read_text(encoding="utf-8"))
TAPE = {"thickness": "50 um", "youngs_modulus": "400 kPa", "poisson_ratio": 0.49}
WALL_MM = 1.390294  # of the ring of examples/scene.toml: sqrt(4.1^2 + 4^2 / 1.2) - 4.1


def make_scene(film: dict[str, Any], edge: str = "0 mm") -> Scene:
    contact = TABLES["contact"] | {"edge_radius": edge}
    return scene_from_dict(TABLES | {"probe": TABLES["probe"] | {"film": film}, "contact": contact})


def test_two_tapes_of_50_um_and_a_film_of_110_um_are_0_21_mm_high() -> None:
    film = make_scene({"bond_to_base": TAPE, "bond_to_block": TAPE}).probe.film
    assert film is not None
    assert [layer.thickness for layer in film.stack] == pytest.approx([50e-6, 110e-6, 50e-6])
    assert film.stack_height == pytest.approx(0.21e-3)


def test_the_outer_film_has_what_its_own_table_changes() -> None:
    film = make_scene({"thickness": "52 um", "bond_to_base": TAPE, "outer": {"bond_to_base": {"name": "epoxy-20um"}}}).probe.film
    assert film is not None
    inner, outer = film.by_block
    assert (inner.thickness, outer.thickness) == pytest.approx((52e-6, 52e-6))
    assert (inner.stack_height, outer.stack_height) == pytest.approx((102e-6, 72e-6))


def test_bonds_of_the_outer_film_alone_are_bonds_that_charges_are_read_of() -> None:
    assert make_scene({"outer": {"bond_to_base": TAPE}}).observable == "charge"
    assert make_scene({}).observable == "stress"


@pytest.mark.parametrize(
    ("film", "key", "allowed"),
    [
        ({"bond_to_base": TAPE | {"thickness": "50"}}, "probe.film.bond_to_base.thickness", "unit is missing"),
        (
            {"outer": {"bond_to_base": TAPE | {"thickness": 0.05}}},
            "probe.film.outer.bond_to_base.thickness",
            "unit is missing",
        ),
        (
            {"outer": {"bond_to_block": TAPE | {"youngs_modulus": "1"}}},
            "probe.film.outer.bond_to_block.youngs_modulus",
            "'5 kPa'",
        ),
        ({"bond_to_base": {"thickness": "50 um"}}, "probe.film.bond_to_base.youngs_modulus", "a bond with a thickness"),
        ({"bond_to_block": {"name": "tape-5um"}}, "probe.film.bond_to_block.name", "did you mean 'tape-50um'?"),
        (
            {"bond_to_block": {"name": "tape-50um", "youngs_modulus": "3 GPa"}},
            "probe.film.bond_to_block.youngs_modulus",
            "75.47 kPa",
        ),
        (
            {"bond_to_base": {"name": "rigid", "youngs_modulus": "3 GPa"}},
            "probe.film.bond_to_base.youngs_modulus",
            "none for rigid",
        ),
        ({"bond_to_bse": TAPE}, "probe.film.bond_to_bse", "bond_to_base"),
        ({"outer": {"psi1": 0.0}}, "probe.film.outer.psi1", "beside psi1 or psi2 in [probe.film]"),
        ({"electrode_inset": "0.7 mm"}, "probe.film.electrode_inset", "half the outer block's wall"),
        ({"outer": {"electrode_inset": "0.7 mm"}}, "probe.film.outer.electrode_inset", "half the outer block's wall"),
        ({"electrode_inset": "4 mm", "outer": {"electrode_inset": "0 mm"}}, "probe.film.electrode_inset", "inner block's radius"),
        ({"adhesive_modulus": "2 MPa", "bond_to_base": TAPE}, "probe.film.adhesive_modulus", "bond_to_base alone"),
        ({"adhesive_thickness": "20 um", "bond_to_base": TAPE}, "probe.film.adhesive_thickness", "bond_to_base alone"),
        ({"adhesive_modulus": "2 MPa"}, "probe.film.adhesive_modulus", "bond_to_base"),
    ],
)
def test_a_refusal_names_the_key(film: dict[str, Any], key: str, allowed: str) -> None:
    with pytest.raises(InputError) as refusal:
        make_scene(film)
    assert str(refusal.value).startswith(f"{key} = ")
    assert allowed in str(refusal.value)


def test_an_inset_up_to_half_the_wall_is_taken() -> None:
    assert make_scene({"electrode_inset": f"{0.48 * WALL_MM} mm"}).probe.film
    with pytest.raises(InputError, match=r"up to 0\.681"):
        make_scene({"electrode_inset": f"{0.495 * WALL_MM} mm"})


@pytest.mark.parametrize(
    ("inset", "is_taken"), [("0.2 mm", False), ("0.2015 mm", False), ("0.1985 mm", False), ("0.21 mm", True)]
)
def test_electrode_and_round_edge_do_not_end_at_one_radius(inset: str, is_taken: bool) -> None:
    if is_taken:
        assert make_scene({"electrode_inset": inset}, "0.2 mm").probe.film
        return
    with pytest.raises(InputError, match=r"^probe\.film\.electrode_inset .* contact\.edge_radius is 0\.2 mm"):
        make_scene({"electrode_inset": inset}, "0.2 mm")


def test_a_stack_thicker_than_its_block_is_doubted() -> None:
    assert list_doubts(make_scene({"bond_to_base": TAPE})) == ()
    (doubt,) = list_doubts(make_scene({"outer": {"thickness": "110 mm"}}))
    assert "outer block are 110 mm thick together" in doubt


def test_adhesive_keys_of_older_versions_are_the_bond_to_the_base() -> None:
    with pytest.warns(ObsoleteKeyWarning, match="bond_to_base"):
        film = make_scene({"adhesive_thickness": "20 um", "adhesive_modulus": "2 MPa"}).probe.film
    assert film is not None
    assert film.bond_to_base is not None
    assert (film.bond_to_base.thickness, film.bond_to_base.youngs_modulus) == pytest.approx((20e-6, 2e6))
    assert film.bond_to_block is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a scene that was read, and is written again, has the new table
        written = scene_to_toml(read_scene(EXAMPLES / "scene.toml").model_copy(update={"probe": make_scene({}).probe}))
        assert scene_from_toml(written)


def test_a_bond_with_a_new_number_loses_its_name_and_one_with_a_new_name_its_numbers() -> None:
    scene = make_scene({"bond_to_base": {"name": "tape-50um"}})
    film = scene.replace({"probe.film.bond_to_base.thickness": "60 um"}).probe.film
    assert film is not None
    assert film.bond_to_base is not None
    assert (film.bond_to_base.name, film.bond_to_base.thickness) == (None, 60e-6)
    assert film.bond_to_base.youngs_modulus == 300e3
    film = scene.replace({"probe.film.bond_to_base.name": "epoxy-20um"}).probe.film
    assert film is not None
    assert film.bond_to_base is not None
    assert (film.bond_to_base.name, film.bond_to_base.thickness) == ("epoxy-20um", 20e-6)
    assert film.bond_to_base.youngs_modulus == 1.7e9


def test_a_film_without_any_charge_is_refused_where_charges_are_read() -> None:
    powerless = {"d31": "2 pC/N", "d32": "-2 pC/N", "d33": "0 pC/N"}
    make_scene(powerless)  # reads stresses
    with pytest.raises(InputError, match=r"probe\.film\.d33 = '0 pC/N': allowed: other than 0"):
        make_scene(powerless | {"bond_to_base": TAPE})
