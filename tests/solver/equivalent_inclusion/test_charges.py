"""Charges of the films over tumours by scattering: against axisymmetric finite elements, symmetry, superposition, differences."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from geometry import Scene, read_scene
from solver.axisymmetric.evaluator import Axisymmetric
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed, solve_other_tissue, solve_undisturbed
from solver.equivalent_inclusion.readings import Readings, compute_readings
from solver.inclusions.tumours import Tumours
from solver.results.film_forces import FilmForces
from tests.support.paths import SCENE
from tests.support.slow import slow_unless

SOFT_TAPE = {"thickness": "50 um", "youngs_modulus": "0.4 MPa", "poisson_ratio": 0.49}
GLUE = {"thickness": "20 um", "youngs_modulus": "1 GPa", "poisson_ratio": 0.35}
STACKS: dict[str, dict[str, Any]] = {
    "rigid": {},
    "glue": {"bond_to_base": GLUE, "bond_to_block": GLUE},
    "tape": {"bond_to_base": {"thickness": "50 um", "youngs_modulus": "1 MPa", "poisson_ratio": 0.45}},
    "inset": {
        "bond_to_base": SOFT_TAPE, "bond_to_block": SOFT_TAPE, "electrode_inset": "0.3 mm", "outer": {"thickness": "28 um"},
    },
}  # fmt: skip
BODIES: dict[str, dict[str, Any]] = {
    "usual": {},
    "shallow": {"depth": "5.5 mm", "youngs_modulus": "100 kPa"},
    "soft": {"youngs_modulus": "1 kPa"},
    "near": {"depth": "4.3 mm", "youngs_modulus": "300 kPa"},
}
CASES = [(stack, body) for stack in STACKS for body in BODIES]


def build_scene(stack: str = "tape", **tumour: Any) -> Scene:
    """The example scene with films in a stack."""
    data = read_scene(SCENE).model_dump(exclude_unset=True)
    data["probe"]["film"] = STACKS[stack] | {"thickness": "110 um"}
    data["reading"] = {"observable": "charge"}
    data["inclusion"] = ({**data["inclusion"][0], **tumour},)
    return Scene.model_validate(data)


@cache
def solve(stack: str = "tape", accuracy: float = 0.001) -> Undisturbed:
    return solve_undisturbed(build_scene(stack), accuracy)


def place_tumours(**changed: Any) -> Tumours:
    values = {"x": 0.006, "y": 0.0, "depth": 0.012, "diameter": 0.007, "youngs_modulus": 3e4, "poisson_ratio": 0.4} | changed
    return Tumours(**{key: np.atleast_2d(value) for key, value in values.items()})


def get_charges(item: Readings | FilmForces) -> Any:
    assert item.charges is not None
    return item.charges


@cache
def solve_elements(stack: str, body: str, accuracy: float) -> FilmForces:
    return Axisymmetric().solve(build_scene(stack, **BODIES[body]), accuracy).films[0]


def chosen(case: tuple[str, str]) -> bool:
    return case in (("tape", "usual"), ("inset", "shallow"), ("glue", "soft"))


@pytest.mark.parametrize(("stack", "body"), slow_unless(chosen, CASES))
@pytest.mark.parametrize("accuracy", slow_unless((0.01).__eq__, [0.01, 0.003]))
def test_charges_on_the_axis_agree_with_finite_elements(stack: str, body: str, accuracy: float) -> None:
    scene = build_scene(stack, **BODIES[body])
    films = EquivalentInclusion().solve(scene, accuracy).films[0]
    # one finer reference for both accuracies, but for the quick cases
    expected = solve_elements(stack, body, 1e-3 if accuracy == 0.01 and chosen((stack, body)) else 3e-4)
    charges, reference = get_charges(films), get_charges(expected)
    deviation = np.abs(charges.totals / reference.totals - 1)
    assert np.all(deviation <= charges.relative_errors + reference.relative_errors)
    assert np.all(deviation <= 2e-4)
    ratio, expected_ratio = (values.totals[0] / values.totals[1] for values in (charges, reference))
    assert abs(ratio / expected_ratio - 1) <= charges.ratio_error + reference.ratio_error
    sensitivity_error = abs(charges.log_sensitivity - reference.log_sensitivity)
    assert sensitivity_error <= charges.sensitivity_error + reference.sensitivity_error
    assert sensitivity_error <= 1e-4
    if body != "near":  # so close to the surface the meshes' bound is 0.0031
        assert films.compute_max_error(scene) <= accuracy


@pytest.mark.parametrize("reflect", [False, True])
def test_only_the_distance_from_the_axis_matters(reflect: bool) -> None:
    base, angle = solve(accuracy=0.01), np.array([[0.0], [1.0], [2.5], [-2.0]])
    same = np.ones_like(angle)
    values = {key: value * same for key, value in (("depth", 0.006), ("diameter", 0.008), ("youngs_modulus", 6e4))}
    tumours = place_tumours(x=0.004 * np.cos(angle), y=0.004 * np.sin(angle), poisson_ratio=0.45 * same, **values)
    charges = get_charges(compute_readings(base, tumours, reflect=reflect)).forces
    assert charges == pytest.approx(np.broadcast_to(charges[:1], charges.shape), rel=1e-9)


def test_near_the_axis_is_the_limit_of_on_it() -> None:
    x, same = np.array([[0.0], [2e-5]]), np.ones((2, 1))  # the one by axisymmetric modes, the other by all orders
    values = {"y": 0.0, "depth": 0.006, "diameter": 0.008, "youngs_modulus": 6e4, "poisson_ratio": 0.45}
    tumours = place_tumours(x=x, **{key: value * same for key, value in values.items()})
    charges = get_charges(compute_readings(solve(accuracy=0.003), tumours, reflect=True)).forces
    assert charges[1] == pytest.approx(charges[0], rel=2e-4)


@pytest.mark.parametrize("reflect", [False, True])
def test_effects_of_weak_tumours_add(reflect: bool) -> None:
    base, modulus = solve(accuracy=0.01), 6.06e3  # 1 % more than the tissue's: what one reflects to the other is 1e-4 of it
    places = {"x": [0.005, -0.002, 0.0], "y": [0.0, 0.006, -0.007], "depth": [0.008, 0.012, 0.01], "diameter": [0.007] * 3}
    together = {key: [values] for key, values in places.items()} | {
        "youngs_modulus": [[modulus] * 3],
        "poisson_ratio": [[0.45] * 3],
    }
    alone = {key: np.transpose(values) for key, values in together.items()}
    changes = [
        get_charges(compute_readings(base, place_tumours(**tumours), reflect=reflect)).forces - get_charges(base.films).forces
        for tumours in (together, alone)
    ]
    assert changes[0][0] == pytest.approx(changes[1].sum(axis=0), abs=2e-3 * np.abs(changes[0]).max())


def test_a_tumour_of_tissue_is_none() -> None:
    base = solve(accuracy=0.01)
    tissue = base.scene.tissue
    tumours = place_tumours(youngs_modulus=tissue.youngs_modulus, poisson_ratio=tissue.poisson_ratio)
    for reflect in (False, True):
        charges = get_charges(compute_readings(base, tumours, reflect=reflect))
        assert charges.forces[0] == pytest.approx(get_charges(base.films).forces, rel=1e-9)


@pytest.mark.parametrize(
    ("key", "reflect"),
    [
        *((key, False) for key in ("depth", "diameter", "offset", "youngs_modulus", "poisson_ratio")),
        *(pytest.param(key, True, marks=pytest.mark.slow) for key in ("offset", "youngs_modulus")),
    ],
)
def test_derivatives_by_the_tumours_own_numbers(key: str, reflect: bool) -> None:
    """Central differences of the charges, which are integrals over the volume; derivatives are integrals over the surface."""
    base, attribute = solve(), {"offset": "x"}.get(key, key)
    value = float(getattr(place_tumours(), attribute)[0, 0])
    step = (2e-2 if reflect else 1e-3) * value  # with reflections, numbers of modes change from place to place
    low, high = (
        get_charges(compute_readings(base, place_tumours(**{attribute: value + change}), reflect=reflect)).forces[0]
        for change in (-step, step)
    )
    derivative = get_charges(compute_readings(base, place_tumours(), places=True, reflect=reflect)).derivatives[key][0]
    scale = 1.0 if key in ("offset", "poisson_ratio") else value
    differences = (high - low) / (2 * step)
    assert derivative / scale == pytest.approx(differences, abs=5e-3 * np.abs(differences).max())


def test_many_sets_are_what_each_is_alone() -> None:
    """The table of strain products, used for many tumours, against the elements."""
    base, rng = solve(accuracy=0.01), np.random.default_rng(3)
    same = np.ones((40, 1))
    drawn = {key: rng.uniform(*span, (40, 1)) for key, span in (("x", (0, 0.015)), ("depth", (0.009, 0.03)))}
    tumours = place_tumours(y=0 * same, diameter=0.006 * same, youngs_modulus=3e4 * same, poisson_ratio=0.45 * same, **drawn)
    together = get_charges(compute_readings(base, tumours, reflect=False))
    for k in (0, 7, 31):
        alone = get_charges(compute_readings(base, tumours.select(np.array([k])), reflect=False))
        change = alone.forces[0] - get_charges(base.films).forces
        assert together.forces[k] - alone.forces[0] == pytest.approx(0.0, abs=2e-3 * np.abs(change).max())
        assert together.log_sensitivity[k] == pytest.approx(alone.log_sensitivity[0], rel=5e-3, abs=1e-5)


@pytest.mark.slow
def test_bounds_to_first_order_hold_against_reflections() -> None:
    base, depths = solve(), np.array([[0.0085], [0.012], [0.02]])
    same = np.ones((3, 1))
    tumours = place_tumours(
        x=0.004 * same, y=0 * same, depth=depths, diameter=0.008 * same, youngs_modulus=2e5 * same, poisson_ratio=0.45 * same
    )
    first, reflected = (get_charges(compute_readings(base, tumours, reflect=reflect)) for reflect in (False, True))
    assert np.all(np.abs(first.totals - reflected.totals) <= first.bound + reflected.bound)
    assert np.all(np.abs(np.log(first.ratio / reflected.ratio)) <= first.log_ratio_bound + reflected.log_ratio_bound)
    assert np.all(
        np.abs(first.log_sensitivity - reflected.log_sensitivity) <= first.sensitivity_error + reflected.sensitivity_error
    )
    assert np.all(reflected.bound < first.bound)


def test_other_tissue_has_its_own_charges() -> None:
    scene = build_scene()
    stiffer = scene.replace({"tissue.youngs_modulus": 9e3})
    other = solve_other_tissue(solve(accuracy=0.003), stiffer)
    expected = Axisymmetric().solve(stiffer.model_copy(update={"inclusion": ()}), 1e-3).films[0]
    charges, reference = get_charges(other.films), get_charges(expected)
    assert np.all(np.abs(charges.totals / reference.totals - 1) <= charges.relative_errors + reference.relative_errors)
    alone = get_charges(EquivalentInclusion().solve_alone(stiffer, 0.003).films)
    assert np.all(np.abs(charges.totals / alone.totals - 1) <= charges.relative_errors + alone.relative_errors)


def test_an_ellipsoid_of_equal_diameters_is_a_sphere() -> None:
    scene = build_scene(x="3 mm")
    sphere = scene.inclusion[0]
    ball = sphere.model_copy(update={"diameter": None, "diameters": (sphere.diameter,) * 3})
    results = [
        EquivalentInclusion().solve(scene.model_copy(update={"inclusion": (body,)}), 0.01).films[0] for body in (sphere, ball)
    ]
    expected, charges = (get_charges(films) for films in results)
    assert charges.forces == pytest.approx(expected.forces, rel=1e-4)
    assert charges.log_sensitivity == pytest.approx(expected.log_sensitivity, rel=0.02)


def test_a_long_ellipsoid_changes_charges_as_two_spheres_in_it_do() -> None:
    """Between the change by a sphere inside and the change by one around it, as forces of stiffer bodies rise with their size."""
    scene = build_scene(depth="12 mm", x="3 mm")
    sphere = scene.inclusion[0]
    bodies = [sphere.model_copy(update={"diameter": size}) for size in (0.008, 0.0096)]
    bodies.append(sphere.model_copy(update={"diameter": None, "diameters": (0.0096, 0.008, 0.008)}))
    low, high, between = (
        np.abs(get_charges(EquivalentInclusion().solve(scene.model_copy(update={"inclusion": (body,)}), 0.01).films[0]).totals)
        for body in bodies
    )
    assert np.all((low < between) & (between < high))


def test_psi_in_place_of_the_films_stress_scales_the_forces() -> None:
    scene = build_scene()
    film = scene.probe.film.model_copy(update={"psi1": 0.5, "psi2": 0.1})
    scene = scene.model_copy(update={"probe": scene.probe.model_copy(update={"film": film})})
    readings = compute_readings(solve_undisturbed(scene, 0.01), Tumours.from_scene(scene))
    assert readings.charges is None
    charges = readings.get_observable(scene)
    assert charges.forces == pytest.approx(film.charge_per_force * readings.forces)
    assert charges.ratio == pytest.approx(readings.ratio)
    assert charges.sensitivity_error == pytest.approx(readings.sensitivity_error)
