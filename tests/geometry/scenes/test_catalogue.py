"""The catalogue of materials: what databases measured, no more exactly than they agree."""

from __future__ import annotations

import math
from importlib.resources import files

import pytest

from geometry.common.errors import InputError
from geometry.scenes.catalogue import CatalogueMaterial, find_material, list_materials
from geometry.scenes.probe import Material
from probe_design import fit_material
from tests.support.paths import EXAMPLES

BOTH = {  # product: kPa by compression (Dawood et al., CC BY 4.0) and by tension (Marechal et al., ODbL)
    "ecoflex-00-10": (54.2, 24.0),
    "ecoflex-00-30": (97.3, 48.0),
    "ecoflex-00-50": (152.7, 67.0),
}


@pytest.mark.parametrize(("name", "measured"), BOTH.items())
def test_a_product_of_both_databases_is_between_them_and_its_tolerance_reaches_both(
    name: str, measured: tuple[float, float]
) -> None:
    material = find_material(name)
    assert material.youngs_modulus == pytest.approx(1e3 * math.sqrt(math.prod(measured)), rel=5e-4)  # four digits
    for value in measured:
        assert abs(math.log(1e3 * value / material.youngs_modulus)) == pytest.approx(material.log_sd, abs=5e-4)
    assert {publication.licence for publication in material.published} == {"CC BY 4.0", "ODbL 1.0"}


def test_the_databases_differ_by_2_to_2_3() -> None:
    ratios = [math.exp(2 * find_material(name).log_sd) for name in BOTH]
    assert min(ratios) == pytest.approx(2.0, abs=0.05)
    assert max(ratios) == pytest.approx(2.3, abs=0.05)


def test_what_one_method_tells_is_as_uncertain_as_methods_differ() -> None:
    """By simulation: values by either method scatter alike about the true one; their gaps are those of the three products."""
    gap = math.sqrt(sum(math.log(first / second) ** 2 for first, second in BOTH.values()) / len(BOTH))
    material = find_material("dragon-skin-30")
    assert material.youngs_modulus == 668e3
    assert material.log_sd == pytest.approx(gap / math.sqrt(2), rel=1e-6)
    assert material.log_sd > max(find_material(name).log_sd for name in BOTH)


def test_a_recipe_is_what_was_measured_where_it_was() -> None:
    """37.3 of 54.2 kPa with 12.5 % thinner; 5.4 with 100 %."""
    plain = find_material("ecoflex-00-10").youngs_modulus
    for share, kpa in ((0.125, 37.3), (0.5, 15.5), (1.0, 5.4)):
        softer = find_material("ecoflex-00-10", thinner=share).youngs_modulus
        assert softer / plain == pytest.approx(kpa / 54.2, rel=1e-3)  # two moduli of four digits


def test_a_recipe_between_is_between_and_no_more_certain() -> None:
    thick, middle, thin = (find_material("ecoflex-00-10", thinner=share) for share in (0.25, 0.3, 0.375))
    assert thick.youngs_modulus > middle.youngs_modulus > thin.youngs_modulus
    assert middle.log_sd > find_material("ecoflex-00-10").log_sd


def test_sylgard_is_softer_with_less_agent() -> None:
    """Measured: 3.7 MPa at 5:1, 0.57 MPa at 33:1 (J. Appl. Polym. Sci. 2014, 131, 41050)."""
    for ratio, measured in ((5.0, 3.7e6), (33.0, 0.57e6)):
        material = find_material("sylgard-184", ratio=ratio)
        assert abs(math.log(material.youngs_modulus / measured)) < material.log_sd
    assert find_material("sylgard-184").name == "sylgard-184 10:1"


@pytest.mark.parametrize(
    ("words", "recipe"),
    [
        ("Ecoflex 00-10 with 30 % thinner", {"thinner": 0.3}),
        ("ecoflex-00-10 with thinner 30%", {"thinner": 0.3}),
        ("ecoflex_00-10 with 30% thinner", {"thinner": 0.3}),
        ("sylgard-184 20:1", {"ratio": 20.0}),
    ],
)
def test_a_recipe_may_stand_in_the_name(words: str, recipe: dict[str, float]) -> None:
    plain = "sylgard-184" if "ratio" in recipe else "ecoflex-00-10"
    assert find_material(words) == find_material(plain, **recipe)
    assert find_material(find_material(words).name) == find_material(words)


@pytest.mark.parametrize(
    ("words", "recipe", "allowed"),
    [
        ("ecoflex-00-30", {"thinner": 0.3}, "from 0 % to 25 %"),
        ("ecoflex-00-10", {"thinner": -0.1}, "from 0 % to 100 %"),
        ("ecoflex-00-10", {"thinner": math.nan}, "from 0 % to 100 %"),
        ("sylgard-184", {"ratio": 50.0}, "from 5 to 33"),
        ("sylgard-184", {"thinner": 0.1}, "none for sylgard-184"),
        ("dragon-skin-30", {"ratio": 10.0}, "none for dragon-skin-30"),
        ("dragonskin-30", {}, "did you mean 'dragon-skin-30'"),
        ("unobtainium", {}, "one of ecoflex-00-10"),
        ("ecoflex-00-10 with 3.0.0 % thinner", {}, "a name"),
        ("", {}, "one of ecoflex-00-10"),
    ],
)
def test_nothing_is_extrapolated_or_guessed(words: str, recipe: dict[str, float], allowed: str) -> None:
    with pytest.raises(InputError) as refusal:
        find_material(words, **recipe)
    assert allowed in str(refusal.value)


@pytest.mark.parametrize(
    "material",
    [material for material in list_materials().values() if material.kind != "film"],
    ids=lambda material: material.name,
)
def test_a_scene_takes_every_block_and_base(material: CatalogueMaterial) -> None:
    assert Material(youngs_modulus=material.youngs_modulus, poisson_ratio=material.poisson_ratio)
    assert material.published
    assert all(value.source and value.method and value.licence for value in material.published)
    assert 0.0 < material.log_sd < 2.0


def test_a_film_has_a_poisson_ratio_but_is_no_material_of_a_block() -> None:
    assert find_material("pvdf-28um").poisson_ratio == 0.34  # as FILM.md assumes
    with pytest.raises(ValueError, match=r"belong in \[probe\.film\]"):
        Material.model_validate({"material": "pvdf-28um"})


@pytest.mark.parametrize(
    ("file", "licence", "link"),
    [
        ("materials-cc-by.toml", "Creative Commons Attribution 4.0", "https://creativecommons.org/licenses/by/4.0/"),
        ("materials-odbl.toml", "Open Database License", "https://opendatacommons.org/licenses/odbl/1-0/"),
    ],
)
def test_rows_of_a_licence_lie_in_a_file_with_its_notice(file: str, licence: str, link: str) -> None:
    head = files("geometry.scenes").joinpath(file).read_text(encoding="utf-8").partition("\n\n")[0]
    assert licence in " ".join(head.replace("#", " ").split())
    assert link in head


@pytest.mark.parametrize("name", ["ecoflex-00-30", "ecoflex-00-50", "dragon-skin-10", "dragon-skin-30"])
def test_a_law_is_the_one_that_its_curve_gives(name: str) -> None:
    fit = fit_material(EXAMPLES / "curves" / f"{name}.csv", test="tension", max_strain=1.0, law="yeoh")
    law = find_material(name).law
    assert law["c2_over_c1"].value == pytest.approx(fit.chosen.ratios[0], abs=6e-4)
    assert law["law_strain"].value == pytest.approx(fit.law_strain, rel=1e-3)
    assert "ODbL" in law["law"].source


def test_a_name_gives_its_law_where_the_table_asks_for_yeoh_without_constants() -> None:
    tables = ({}, {"law": "yeoh"}, {"law": "yeoh", "c2_over_c1": 0.2})
    plain, stiffening, measured = (Material.model_validate({"material": "dragon-skin-30"} | more) for more in tables)
    assert (plain.law, plain.law_strain) == ("neo-hookean", None)
    assert (stiffening.c2_over_c1, stiffening.law_strain) == (0.098, 1.0)
    assert (measured.c2_over_c1, measured.law_strain) == (0.2, None)
    assert find_material("ecoflex-00-30", thinner=0.2).law == {}  # the curve is of the product without thinner
