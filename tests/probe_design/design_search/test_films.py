"""Films and bonds of the catalogue as choices, and a population's designs judged by the charges of their films."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geometry.common.errors import InputError
from geometry.scenes.film import Film
from geometry.scenes.scene import Scene
from probe_design.design_report.population_report import build_choice_table
from probe_design.design_report.verdict import format_bonds, format_film
from probe_design.design_search.film_choices import list_film_choices
from probe_design.design_search.population_objective import PopulationObjective
from probe_design.design_search.search_space import build_search_space
from probe_design.design_search.variables import read_vector
from probe_design.populations.design_file import Design, design_from_dict, read_design
from probe_design.populations.examination import examine
from solver import evaluate
from tests.probe_design.design_search.test_charges import EXAMPLE, TAPE, build_taped
from tests.support.paths import ROOT

POPULATION = {"depth": [7e-3, 11e-3], "diameter": [6e-3, 8e-3], "object": [20e3, 60e3], "samples": 4}


def build_design(scene: Scene, **tables: Any) -> Design:
    """Return a design file round a scene with a few tumours under three positions."""
    given = {"population": POPULATION, "objective": {"maximise": "information"}} | tables
    protocol = {"positions": [-6e-3, 0.0, 6e-3]} | given.pop("protocol", {})
    return design_from_dict({"scene": scene, "protocol": protocol, **given})


def test_every_film_is_tried_with_every_bond() -> None:
    """The example's nine stacks: film from the catalogue, the bond on both sides, d32 of the scene."""
    choices = list_film_choices(read_design(ROOT / "examples/films.toml"))
    assert len(choices) == 9
    assert choices[1].description == "film pvdf-28um, bond tape-25um"
    film = choices[1].film
    assert (film.thickness, film.d31, film.d32, film.d33) == pytest.approx((28e-6, 23e-12, 2e-12, -33e-12))
    assert film.bond_to_base == film.bond_to_block
    assert (film.bond_to_base.name, film.bond_to_base.thickness) == ("tape-25um", pytest.approx(25e-6))  # type: ignore[union-attr]


def test_what_is_fixed_has_no_limits() -> None:
    """The example's gap and inner modulus."""
    design = read_design(ROOT / "examples/films.toml")
    names = {limit.name for limit in build_search_space(design).list_limits(design.scene)}
    assert {"least height", "largest outer_modulus"} <= names
    assert not {name for name in names if name.endswith((" gap", " inner_modulus"))}


def test_films_are_described_by_thickness_and_bonds() -> None:
    film = list_film_choices(read_design(ROOT / "examples/films.toml"))[1].film
    assert (format_film(film), format_bonds(film)) == ("28", "tape-25um / tape-25um")


def test_the_table_of_choices_has_each_choice_once_with_its_best_verified_design() -> None:
    """The second film with its bond was searched twice and verified twice, the first one searched alone."""
    design = read_design(ROOT / "examples/films.toml")
    first, second, *_ = list_film_choices(design)
    searched = [(second, 3.0), (first, 2.0), (second, 1.0)]
    choices = [SimpleNamespace(combination=SimpleNamespace(film=film), value=value) for film, value in searched]
    worse, best = (
        SimpleNamespace(scene=second.set_film(design.scene), protocol=design.protocol, objective=(value, 0.1))
        for value in (2.5, 2.8)
    )
    optimum: Any = SimpleNamespace(design=design, search=SimpleNamespace(choices=choices), finalists=(worse, best), winner=best)
    table = build_choice_table(optimum, "film")
    assert table.headings[:2] == ("film", "bond")
    verified = design.objective.format_value(2.8, 0.1)
    assert [(*row[:2], *row[3:]) for row in table.rows] == [
        ("pvdf-28um", "tape-25um", verified, "yes"),
        ("pvdf-28um", "tape-50um", "-", "no"),
    ]


def test_thicknesses_of_film_and_bonds_are_tried_one_by_one() -> None:
    """Choices, steps between bounds, and five values between bounds without a step."""
    variables = {"film_thickness": {"choices": [28e-6, 52e-6]}, "bond_thickness": {"bounds": [20e-6, 60e-6], "step": 20e-6}}
    films = [choice.film for choice in list_film_choices(build_design(build_taped(3e-3), variables=variables))]
    assert [film.thickness for film in films] == pytest.approx([28e-6] * 3 + [52e-6] * 3)
    assert [film.bond_to_base.thickness for film in films[:3]] == pytest.approx([20e-6, 40e-6, 60e-6])  # type: ignore[union-attr]
    assert all(film.bond_to_base.youngs_modulus == TAPE["youngs_modulus"] for film in films)  # type: ignore[union-attr]
    (space,) = [build_search_space(build_design(build_taped(3e-3), variables={"film_thickness": [20e-6, 320e-6]}))]
    thicknesses = [choice.film.thickness for choice in space.film_choices]
    assert thicknesses == pytest.approx([20e-6, 40e-6, 80e-6, 160e-6, 320e-6])
    assert space.combinations == 5


@pytest.mark.parametrize(
    ("variables", "named"),
    [
        ({"film": ["pvdf-29um"]}, "one of pvdf-9um, pvdf-28um, pvdf-52um, pvdf-110um; did you mean"),
        ({"film": ["ecoflex-00-30"]}, "one of pvdf-9um"),
        ({"film": ["pvdf-28um", "52 um"]}, "film_thickness"),
        ({"bond": ["tape-51um"]}, "tape-50um"),
        ({"bond": ["tape-50um"], "bond_to_base": ["rigid"]}, "one of both"),
        ({"film": ["pvdf-28um"], "film_thickness": {"choices": [28e-6]}}, "one of both"),
    ],
)
def test_choices_that_contradict_or_are_unknown_are_refused(variables: dict[str, Any], named: str) -> None:
    """One sentence names what is allowed."""
    with pytest.raises(InputError, match=named):
        build_search_space(build_design(build_taped(3e-3), variables=variables))


def test_thicknesses_are_those_of_the_bonds_that_have_some() -> None:
    """A rigid bond stays rigid, and the outer film's own bond keeps its modulus."""
    glue = {"thickness": 20e-6, "youngs_modulus": 1.7e9, "poisson_ratio": 0.4}
    variables = {"bond_thickness": {"choices": [30e-6, 60e-6]}}

    def list_bonds(film: dict[str, Any]) -> list[list[tuple[float, float | None]]]:
        probe = EXAMPLE.probe.model_copy(update={"film": Film.model_validate(film)})
        choices = list_film_choices(build_design(EXAMPLE.model_copy(update={"probe": probe}), variables=variables))
        return [[(bond.thickness, bond.youngs_modulus) for bond in part.bonds] for part in choices[1].film.by_block]

    tape = TAPE["youngs_modulus"]
    mixed = {"bond_to_base": TAPE, "bond_to_block": {"name": "rigid"}, "outer": {"bond_to_base": glue, "bond_to_block": glue}}
    assert list_bonds(mixed) == [[(0.0, None), (60e-6, tape)], [(60e-6, 1.7e9), (60e-6, 1.7e9)]]
    assert list_bonds({"bond_to_base": TAPE, "outer": {"bond_to_base": {"name": "rigid"}}})[1] == [(0.0, None), (0.0, None)]
    with pytest.raises(InputError, match="has a bond with a thickness"):
        list_bonds({"bond_to_base": {"name": "rigid"}, "bond_to_block": {"name": "rigid"}})


@pytest.mark.parametrize("name", ["bond", "bond_to_base", "film_thickness"])
def test_bonds_and_thicknesses_are_no_choice_where_eq_12_gives_the_charge(name: str) -> None:
    """Every choice would have the same charges."""
    scene = build_taped(3e-3).replace({"probe.film.psi1": 0.3, "reading.observable": "charge"})
    values: Any = {"choices": [28e-6, 52e-6]} if name == "film_thickness" else ["tape-50um", "epoxy-20um"]
    with pytest.raises(InputError, match=rf"variables\.{name} = given beside psi1 or psi2: allowed: a scene without both"):
        build_search_space(build_design(scene, variables={name: values}))


def test_films_are_no_choice_where_stresses_are_read() -> None:
    """The protocol decides what is read; charges of a probe without films are refused."""
    variables = {"film": ["pvdf-28um"]}
    with pytest.raises(InputError, match="observable = 'charge'"):
        build_search_space(build_design(build_taped(3e-3), variables=variables, protocol={"observable": "stress"}))
    with pytest.raises(InputError, match=r"protocol\.observable"):
        build_design(EXAMPLE, protocol={"observable": "charge"})
    assert build_design(build_taped(3e-3)).scene.observable == "charge"


def test_readings_of_a_population_are_ratios_of_charges() -> None:
    """The signal of each tumour under the axis against two evaluations: ln of charge_ratio with it and without."""
    design = build_design(build_taped(3e-3), protocol={"positions": [0.0]})
    examined = examine(design.scene, design, unseen=True)
    draw = examined.draw
    for k in range(2):
        tables = draw.tissues[draw.tissue[k]].model_dump(exclude_unset=True)
        bare = evaluate(Scene.from_tables(tables), evaluator="axisymmetric")
        sphere = {"diameter": draw.diameter[k], "depth": draw.depth[k], "youngs_modulus": draw.youngs_modulus[k]}
        tables["inclusion"] = [{key: float(value) for key, value in sphere.items()} | {"poisson_ratio": draw.poisson_ratio}]
        result = evaluate(Scene.from_tables(tables), evaluator="axisymmetric", accuracy=0.003)
        signal, stated = np.log(result.charge_ratio / bare.charge_ratio), examined.readings.error[k, 0]
        assert abs(examined.readings.signal[k, 0] - signal) <= stated + result.charge_ratio_error
        assert abs(signal - np.log(result.ratio / bare.ratio)) > 2 * abs(examined.readings.signal[k, 0] - signal)


def test_derivatives_of_the_population_objective_by_charges_are_exact() -> None:
    """Complex steps against central differences."""
    design = build_design(build_taped(3e-3))
    objective = PopulationObjective.from_design(design, 8e-3)
    x = read_vector(design.scene)
    poisson = design.scene.probe.inner.poisson_ratio, design.scene.probe.outer.poisson_ratio
    derivatives = objective.gradient(x, poisson, list(range(len(x))))[1][0]
    for k, step in enumerate(1e-5 * np.eye(len(x))):
        values = [objective.evaluate_designs((x * np.exp(sign * step))[:, None], poisson)[0] for sign in (1, -1)]
        assert (values[0] - values[1]) / 2e-5 == pytest.approx(derivatives[k], rel=1e-4, abs=1e-9)


def test_a_better_film_has_a_better_objective() -> None:
    """FILM.md: on tape a film of 28 um gives three times the charge of one of 110 um, which noise is compared with."""
    design = build_design(build_taped(3e-3), variables={"film_thickness": {"choices": [28e-6, 110e-6]}})
    objective, x = PopulationObjective.from_design(design, 8e-3), read_vector(design.scene)[:, None]
    poisson = design.scene.probe.inner.poisson_ratio, design.scene.probe.outer.poisson_ratio
    thin, thick = (objective.set_film(choice).evaluate_designs(x, poisson)[0] for choice in list_film_choices(design))
    assert thin > 1.2 * thick
    assert thick == pytest.approx(objective.evaluate_designs(x, poisson)[0], rel=1e-12)
