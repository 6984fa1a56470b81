"""Layers of tissue around spheres: against ``axisymmetric`` and an independent code, one material cut up, laws, refusals."""

import json

import numpy as np
import pytest

from geometry import Refusal, Scene, read_scene
from geometry.scenes.variables import list_values
from probe_design.maps.detectability import detectability
from probe_design.maps.scan import scan
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.gradients import OUTPUT_NAMES, compute_gradients
from solver.axisymmetric.sections import build_sections
from solver.casadi_functions.finite_elements import TumourCallback
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.gradients import compute_tumour_gradients, solve_first_order
from solver.equivalent_inclusion.readings import Readings, compute_readings
from solver.evaluation import plan
from solver.inclusions.tumours import Tumours
from solver.multiple_scattering.exchange import Reflector
from solver.multiple_scattering.lockstep import run_in_lockstep
from solver.multiple_scattering.solve import iterate_scattering
from solver.results.refusals import find_refusal
from tests.solver.axisymmetric.test_layers import EXAMPLE, FOLDER, OWN, add_layers, forces

EXPECTED = json.loads((FOLDER / "expected.json").read_text())
SCENES = {name: read_scene(FOLDER / f"{name}.toml") for name in EXPECTED}
CROSSED = ("crossed", "crossed sphere")
INSIDE = [name for name, scene in SCENES.items() if scene.inclusion and find_refusal(scene, CROSSED) is None]
LEVEL = EquivalentInclusion()


def sphere(depth: float, diameter: float = 8.0, *, x: float = 0.0, y: float = 0.0, modulus: float = 3e4) -> dict[str, float]:
    """A sphere, lengths in mm."""
    return {
        "diameter": 1e-3 * diameter, "depth": 1e-3 * depth, "x": 1e-3 * x, "y": 1e-3 * y,
        "youngs_modulus": modulus, "poisson_ratio": 0.45,
    }  # fmt: skip


def assert_within_accuracy(scene: Scene, accuracy: float = 1e-2, uncertain: float = 1e-4) -> None:
    """The evaluator's result is as close to that of the meridian's elements as it states."""
    result, expected = LEVEL.evaluate(scene, accuracy), Axisymmetric().evaluate(scene, uncertain)
    assert result.error_estimate is not None
    for key in ("ratio", "stress_inner", "stress_outer"):
        assert abs(getattr(result, key) / getattr(expected, key) - 1) <= result.error_estimate + uncertain, key


@pytest.mark.slow
def test_a_sphere_in_one_of_three_layers_is_as_good_as_stated():
    assert_within_accuracy(add_layers((1.0, 2e4), (14.0, 4e3), (10.0, 2e4), inclusion=[sphere(8.0, 6.0)]))


def test_the_material_at_a_depth():
    tissue = add_layers((1.0, 2e4), (2.0, 4e3)).tissue
    assert [tissue.find_material(1e-3 * depth).youngs_modulus for depth in (0.0, 0.5, 1.0, 2.9, 3.1, 40.0)] == [
        2e4, 2e4, 4e3, 4e3, 6e3, 6e3,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("bodies", "words"),
    [
        ([sphere(9.0)], "axisymmetric for an inclusion that an interface"),
        ([sphere(9.0, x=3.0)], "solid for an inclusion that an interface"),
        ([sphere(9.0), sphere(30.0)], "solid for an inclusion that an interface"),
    ],
)
def test_a_sphere_across_an_interface_is_refused(bodies, words):
    with pytest.raises(Refusal, match=words):
        LEVEL.evaluate(add_layers((6.0, 2e4), inclusion=bodies))


def read(scene: Scene, accuracy: float = 1e-2, **options) -> Readings:
    """What the evaluator predicts with reflections."""
    return compute_readings(LEVEL.prepare(scene, accuracy), Tumours.from_scene(scene), scene.target or 0, reflect=True, **options)


def changes(scene: Scene) -> np.ndarray:
    """What spheres change of the film forces, and its derivative by the target's modulus, with reflections, (2, 2, 2)."""
    solution = read(scene)
    return np.array([solution.forces[0] - LEVEL.prepare(scene, 1e-2).films.forces, solution.derivatives["youngs_modulus"][0]])


def agree(first: np.ndarray, second: np.ndarray) -> None:
    """Both are as close as meshes that differ allow."""
    assert np.all(np.abs(first - second) <= 3e-3 * np.abs(second).max(axis=(1, 2), keepdims=True))


ASIDE = [sphere(9.0, x=4.0)]
PAIR = [sphere(7.0, 6.0, x=3.0) | {"target": True}, sphere(15.0, 8.0, x=1.0, y=2.0, modulus=6e4)]


@pytest.mark.parametrize(
    ("thicknesses", "bodies"),
    [
        ((4.0,), ASIDE),
        pytest.param((14.0,), ASIDE, marks=pytest.mark.slow),
        pytest.param((4.5, 9.0), ASIDE, marks=pytest.mark.slow),
        pytest.param((10.5,), PAIR, marks=pytest.mark.slow),
    ],
)
def test_a_layer_of_the_tissues_own_material_changes_nothing(thicknesses, bodies):
    """Below the sphere, above it, both, and between two spheres, whose fields then meet through the interface alone."""
    agree(
        changes(add_layers(*((thickness, *OWN) for thickness in thicknesses), inclusion=bodies)),
        changes(add_layers(inclusion=bodies)),
    )


NARROW = EXAMPLE.model_copy(update={"tissue": EXAMPLE.tissue.model_copy(update={"radius": 8e-3})})


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    [add_layers((10.5, 2e4), inclusion=PAIR), add_layers((5.0, 3e4), scene=NARROW, inclusion=[sphere(13.0, modulus=6e5)])],
)
def test_both_ways_of_reflection_agree(scene):
    """By spheres' work on the faces and sides of their layers, and at their own points: in two layers, close to the side."""
    base, spheres = LEVEL.prepare(scene, 1e-2), Tumours.from_scene(scene).flatten()
    ways = [Reflector(base.field.states, "bonded", close) for close in (False, True)]
    steps = (iterate_scattering(base.field, way, base.strata, spheres, 1e-5) for way in ways)
    iterated, eliminated = (run_in_lockstep([set_steps])[0] for set_steps in steps)
    agree(np.array([iterated.products, *iterated.by_log_modulus]), np.array([eliminated.products, *eliminated.by_log_modulus]))


@pytest.mark.slow
def test_two_half_layers_are_one_and_turning_the_tissue_changes_nothing():
    whole = changes(add_layers((3.0, 2e4), inclusion=ASIDE))
    agree(changes(add_layers((1.5, 2e4), (1.5, 2e4), inclusion=ASIDE)), whole)
    np.testing.assert_allclose(changes(add_layers((3.0, 2e4), inclusion=[sphere(9.0, y=4.0)])), whole, rtol=1e-9)


@pytest.mark.slow
def test_a_thick_layer_around_a_sphere_is_all_that_matters():
    """On rock far below it is the result in tissue of that material alone."""
    endless = EXAMPLE.tissue.model_dump(exclude_unset=True, exclude={"radius", "depth"}) | {"shape": "half-space"}
    alone = Scene.model_validate(EXAMPLE.model_dump(exclude_unset=True) | {"tissue": endless, "inclusion": ASIDE})
    rock = Scene.model_validate(EXAMPLE.model_dump(exclude_unset=True) | {"tissue": endless | {"youngs_modulus": 1e8}})
    solution, expected = read(add_layers((3000.0, *OWN), scene=rock, inclusion=ASIDE)), read(alone)
    assert solution.ratio == pytest.approx(expected.ratio, rel=5e-4)
    assert solution.log_sensitivity == pytest.approx(expected.log_sensitivity, rel=5e-3)


TWO = ((1.4, 2e4, 0.49), (14.0, 4e3))
NAMES = tuple(f"tissue.layer[{key}" for key in ("0].thickness", "1].thickness", "1].youngs_modulus", "1].poisson_ratio"))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_central_differences_by_layers_converge_at_second_order(name):
    scene = add_layers(*TWO, inclusion=[sphere(8.0, 6.0, x=4.0) | {"target": True}, sphere(25.0, 4.0, x=-3.0, y=2.0)])
    solution = solve_first_order(scene, build_sections(scene))
    kind, value = solution.states.model.mesh.layout.kind, list_values(scene)[name]
    exact = compute_tumour_gradients(scene, solution, (name,))

    def outputs(step: float) -> np.ndarray:
        moved = scene.replace({name: value * (1 + step)})
        computed = compute_tumour_gradients(moved, solve_first_order(moved, build_sections(moved), kind=kind), ())
        return np.array([computed.values[key][0] for key in OUTPUT_NAMES])

    mine, size = (np.array([part[key].flat[0] for key in OUTPUT_NAMES]) for part in (exact.derivatives, exact.values))
    errors = [np.abs((outputs(h) - outputs(-h)) / (2 * h) - mine * value) for h in (6e-4, 1.5e-4)]
    assert np.all((errors[1] < errors[0] / 12) | (errors[1] < 1e-8 * np.abs(size)))  # 16 at second order


@pytest.mark.slow
def test_derivatives_are_those_of_the_meridians_elements():
    """By the sphere with reflections, by the layers to first order, of which a weak sphere far from all needs no more."""
    close, weak = add_layers(*TWO, inclusion=[sphere(7.0, 6.0)]), add_layers(*TWO, inclusion=[sphere(9.0, 2.0, modulus=8e3)])
    solution, exact = read(close, places=True), compute_gradients(close, forces(close), ("inclusion.depth", "inclusion.diameter"))
    for k, key in enumerate(("depth", "diameter")):
        mine = exact.derivatives["stiffness"][0, k] * getattr(close.inclusion[0], key)
        assert solution.compute_log_stiffness_derivative(key)[0] * solution.stiffness[0] == pytest.approx(mine, rel=0.02), key
    mine, whole = (
        compute_tumour_gradients(weak, solve_first_order(weak, build_sections(weak)), NAMES),
        compute_gradients(weak, forces(weak), NAMES),
    )
    for key in ("ratio", "stiffness"):
        np.testing.assert_allclose(mine.derivatives[key], whole.derivatives[key], rtol=5e-3)


def test_a_design_whose_layer_reaches_into_a_sphere_gives_no_number():
    """IPOPT steps back from it."""
    films = TumourCallback(
        add_layers((3.0, 2e4), inclusion=[sphere(9.0, x=4.0) | {"target": True}]), ("tissue.layer[0].thickness",), 0.1
    )
    inside, across = (np.array(films(np.array([thickness]))).ravel() for thickness in (3e-3, 7e-3))
    assert np.all(np.isfinite(inside))
    assert np.all(np.isnan(across))


@pytest.mark.slow
def test_auto_takes_this_level_off_the_axis_and_maps_leave_out_what_crosses():
    scene = add_layers((1.4, 2e4), inclusion=ASIDE)
    planned = plan(scene, 0.02)
    assert (planned.evaluator, plan(add_layers((1.4, 2e4))).evaluator) == ("equivalent-inclusion", "axisymmetric")
    change = detectability(scene, np.array([1e-3, 2e-3, 9e-3]), np.array([1e-3, 6e-3]), accuracy=0.02).change
    assert [[value is None for value in row] for row in change] == [[True, True], [False, True], [False, False]]


def test_arrays_of_spheres_are_refused_where_one_is_crossed():
    base = LEVEL.prepare(add_layers((1.4, 2e4), inclusion=ASIDE), 0.02)
    with pytest.raises(Refusal, match=r"inclusion.depth = 3 mm: allowed: spheres of 4 mm that no interface"):
        compute_readings(base, Tumours(0.0, 0.0, [[9e-3], [3e-3]], 4e-3, 3e4, 0.45))


@pytest.mark.slow
def test_a_scan_over_a_sphere_under_a_skin():
    """Even about the sphere; above it the result of the meridian's elements; one position gives the same alone as among many."""
    scene = add_layers((1.4, 2e4), inclusion=[sphere(9.0) | {"target": True}])
    line = scan(scene, "x", np.linspace(-7e-3, 7e-3, 15), accuracy=3e-3, linear=True)
    np.testing.assert_allclose(line.ratio, line.ratio[::-1], rtol=1e-6)
    expected = Axisymmetric().evaluate(scene, 1e-4)
    assert abs(line.ratio[7] / expected.ratio - 1) <= line.error_estimate[7] + 1e-4
    assert line.log_sensitivity[7] == pytest.approx(expected.log_sensitivity, rel=0.015)
    alone = scan(scene, "x", np.array([4e-3]), accuracy=3e-3, linear=True)
    assert alone.ratio[0] == pytest.approx(line.ratio[11], rel=line.error_estimate[11])


@pytest.mark.slow
@pytest.mark.parametrize("name", INSIDE)
def test_against_an_independent_code(name):
    """NGSolve's results (benchmarks.references.axisymmetric): the true error is within the one that is stated."""
    scene, expected = SCENES[name], EXPECTED[name]
    for accuracy in (1e-2, 1e-3):
        result, uncertain = LEVEL.evaluate(scene, accuracy), expected["relative_uncertainty"]
        for key, unit in {"ratio": "", "stress_inner": "_pa", "stress_outer": "_pa"}.items():
            assert abs(getattr(result, key) / expected[f"{key}{unit}"] - 1) <= result.error_estimate + uncertain, key
