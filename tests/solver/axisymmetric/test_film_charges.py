"""Charges of bonded films: against independent codes, by other forms of the same integral, limits and Taylor expansions."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.common.json_types import JsonObject
from geometry.meridian.mesh import compute_nodes
from geometry.meridian.mesh_cells import UNIT_SQUARE
from geometry.meridian.mesh_lines import MeridianFineness, find_kind
from geometry.meridian.section import Body
from geometry.meridian.stack_fineness import StackFineness
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_values
from solver import evaluate
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.film_states import CHARGE_UNIT
from solver.axisymmetric.gradients import CHARGE_NAMES, compute_gradients, compute_outputs
from solver.axisymmetric.sample import MeshSample, solve_on_mesh
from solver.axisymmetric.sections import add_details, build_sections
from solver.elements.shape_functions import evaluate_functions
from tests.support.film_scenes import build_scene, list_tissue_cases, read_cases
from tests.support.references import named
from tests.support.slow import slow_unless

TAPES, GLUED = "probe/two-tapes-0.4/tumour-300", "probe/bare/tumour-30"
QUICK = (TAPES, GLUED, "probe/two-tapes-0.4-inset/tumour-30", "probe/glue/plain-3", "frictionless/base-tape-1/tumour-30")
COARSE = MeridianFineness(1, 2, 4)


def solve(scene: Scene, fineness: MeridianFineness = COARSE, like: Scene | None = None) -> MeshSample:
    """A sample on the mesh topology of another scene."""
    sections = add_details(scene, build_sections(scene))
    kind = find_kind(add_details(like, build_sections(like)).section) if like else None
    return solve_on_mesh(sections.section, sections, scene, fineness, kind=kind)


@pytest.mark.parametrize("accuracy", [1e-2, 1e-3])
@pytest.mark.parametrize("name", slow_unless(QUICK.__contains__, list_tissue_cases()))
def test_against_independent_codes(name: str, accuracy: float) -> None:
    case, scene = read_cases()[name], build_scene(name)
    result = evaluate(scene.replace({"reading.observable": "charge"}), evaluator="axisymmetric", accuracy=accuracy)
    for value, error, expected in zip(
        (result.charge_per_force_inner, result.charge_per_force_outer),
        (result.charge_per_force_inner_error, result.charge_per_force_outer_error),
        case["charge_per_force"],
        strict=True,
    ):
        assert value is not None
        assert error is not None
        deviation = abs(value / (1e-12 * expected) - 1)
        assert deviation <= error + case["relative_uncertainty"]
        assert deviation <= 0.5 * accuracy + case["relative_uncertainty"]
    assert result.charge_ratio_error is not None
    assert result.charge_ratio_error <= accuracy


def test_films_take_few_more_elements_than_the_same_probe_without() -> None:
    """On the first mesh for an accuracy of 0.001."""
    scene, glue = named("axisymmetric", "published-materials").scene, {"thickness": 2e-5, "youngs_modulus": 1e9}
    tables = scene.model_dump(exclude_unset=True)
    bonds = {"bond_to_base": glue | {"poisson_ratio": 0.4}, "bond_to_block": glue | {"poisson_ratio": 0.4}}
    glued = Scene.from_tables(tables | {"probe": tables["probe"] | {"film": bonds}, "reading": {"observable": "charge"}})
    plain, layered = (Axisymmetric().compute_converged(item, 1e-3).sample.states.model for item in (scene, glued))
    assert plain.shapes.order == layered.shapes.order
    assert len(layered.mesh.body) <= 1.15 * len(plain.mesh.body)


@pytest.mark.parametrize(
    ("base", "block", "order"),
    [
        ({"thickness": 7e-6, "youngs_modulus": 8e8, "poisson_ratio": 0.4}, {"thickness": 2.6e-5, "youngs_modulus": 2.3e6}, 5),
        ({"thickness": 5e-6, "youngs_modulus": 3.4e9, "poisson_ratio": 0.35}, {"thickness": 2.9e-5, "youngs_modulus": 5e8}, 5),
        ({"thickness": 4e-5, "youngs_modulus": 3.8e7}, None, 6),
    ],
    ids=["thin glue and tape", "thin glue", "stiff tape"],
)
def test_thin_bonds_need_no_fine_mesh(base: JsonObject, block: JsonObject | None, order: int) -> None:
    """Their charges reach 0.001 without elements of order 8, within the stated errors of those on such a mesh."""
    bonds = {side: {"poisson_ratio": 0.45} | bond for side, bond in (("bond_to_base", base), ("bond_to_block", block)) if bond}
    scene = named("axisymmetric", "published-materials").scene
    tables = scene.model_dump(exclude_unset=True)
    film = {"thickness": 2.8e-5} | bonds
    scene = Scene.from_tables(tables | {"probe": tables["probe"] | {"film": film}, "reading": {"observable": "charge"}})
    converged = Axisymmetric().compute_converged(scene, 1e-3)
    charges = converged.films[0].charges
    assert charges is not None
    assert converged.sample.states.model.shapes.order <= order
    # twice as many strips of other widths at the walls, and order 8
    true = CHARGE_UNIT * solve(scene, MeridianFineness(1, 4, 8, stack=StackFineness(6, (2, 2, 2), 4, 0.3))).totals[0, 2:]
    assert charges.ratio_error <= 1e-3
    assert np.all(np.abs(charges.totals / true - 1) <= charges.relative_errors)


def test_displacements_give_the_same_charge() -> None:
    """FILM.md eq. 1: Int (s_r + s_t) dA = E/(1-nu) 2 pi [r u] + 2 nu/(1-nu) Int s_z dA, u the mean over the thickness."""
    scene = build_scene(TAPES)
    sample = solve(scene, MeridianFineness(1, 3, 6))
    model, film = sample.states.model, scene.probe.film
    assert film is not None
    corners = compute_nodes(model.section, model.mesh, UNIT_SQUARE)
    radii = {
        Body.INNER_FILM: (0.0, scene.probe.inner_radius),
        Body.OUTER_FILM: (scene.probe.hole_radius, scene.probe.tube_radius),
    }
    for k, (body, ends) in enumerate(radii.items()):
        moved = 0.0  # of Int r u dz / thickness at the outer end less that at the inner end
        for e in np.flatnonzero(model.mesh.body == body):
            for radius, sign in zip(ends, (-1, 1), strict=True):
                moved += sign * radius * _integrate_side(sample, e, corners[e], radius)
        force = sample.totals[0, k]
        ratio = film.poisson_ratio / (1 - film.poisson_ratio)
        lateral = film.youngs_modulus / (1 - film.poisson_ratio) * 2 * np.pi * moved / film.thickness - 2 * ratio * force
        charge = film.mean_lateral_charge * lateral - film.d33 * force
        assert -charge == pytest.approx(CHARGE_UNIT * sample.totals[0, 2 + k], rel=2e-4)


def _integrate_side(sample: MeshSample, element: int, corners: np.ndarray, radius: float) -> float:
    """Int u_r dz along an element's side at a radius, for a unit displacement of both bases; 0 where it has none there."""
    shapes, (points, weights) = sample.states.model.shapes, np.polynomial.legendre.leggauss(12)
    for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)):
        if np.allclose(corners[[a, b], 0], radius, rtol=1e-12, atol=1e-15):
            places = UNIT_SQUARE[a] + (points[:, None] + 1) / 2 * (UNIT_SQUARE[b] - UNIT_SQUARE[a])
            functions = evaluate_functions(places, shapes.degrees)[0]
            u = functions @ sample.states.values[element, : len(shapes.degrees), :2].sum(axis=1)
            return float(u @ weights / 2 * np.ptp(corners[[a, b], 1]))
    return 0.0


def test_film_state_and_direct_integral_agree() -> None:
    """Reciprocity: film state and base state have the energy that actuator and base state have in the film alone."""
    sample = solve(build_scene(TAPES))
    states, model = sample.states, sample.states.model
    loads = model.system.stiffness @ states.edge[..., :2]
    direct = np.einsum("eps,epj->sj", model.lift[..., 2:], loads)
    np.testing.assert_allclose(direct, states.products[2:], rtol=1e-8, atol=1e-10 * np.abs(direct).max())


def test_a_film_that_cannot_stretch() -> None:
    """Rigidly bonded between stiff faces a thin film is clamped: d33 + 2 d_p nu / (1 - nu), FILM.md eq. 3."""
    scene = build_scene("probe/bare/plain-6").replace(
        {"probe.film.thickness": 1e-6, "probe.film.youngs_modulus": 1e5, "probe.inner.youngs_modulus": 1e9}
    )
    film = scene.probe.film
    assert film is not None
    clamped = film.d33 + 2 * film.mean_lateral_charge * film.poisson_ratio / (1 - film.poisson_ratio)
    result = evaluate(scene, evaluator="axisymmetric", accuracy=0.01)
    assert result.charge_per_force_inner == pytest.approx(clamped, rel=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", [TAPES, GLUED])
def test_taylor_rate_is_two_for_every_variable(name: str) -> None:
    scene = build_scene(name)
    if name == TAPES:
        scene = scene.replace({"probe.film.electrode_inset": 2e-4, "probe.film.outer.thickness": 9e-5})
    start = compute_gradients(scene, solve(scene))
    values = list_values(scene)
    for k, variable in enumerate(start.variables):
        x = values[variable]
        step = 2e-2 * (min(x, 0.5 - x) if variable.endswith("poisson_ratio") else x)
        step *= 0.2 if variable in ("probe.inner_radius", "inclusion.diameter", "inclusion.depth") else 1.0
        left = []
        for h in (step, step / 2):
            moved = scene.replace({variable: x + h})
            sample = solve(moved, like=scene)
            after = compute_outputs(moved, sample.totals, sample.log_sensitivities)
            left.append([after[key][0] - start.values[key][0] - h * start.derivatives[key][0, k] for key in CHARGE_NAMES])
        for key, first, second in zip(CHARGE_NAMES, *left, strict=True):
            # below it are rounding and second derivatives that nearly vanish
            if abs(second) > 2e-5 * abs(step * start.derivatives[key][0, k]) + 1e-12 * abs(start.values[key][0]):
                assert np.log2(abs(first / second)) == pytest.approx(2, abs=0.45), (variable, key)


def test_curve_is_that_of_its_points() -> None:
    scene = build_scene(TAPES).replace({"reading.observable": "charge"})
    moduli = np.array([2e3, 3e5])
    films = Axisymmetric().solve(scene, 1e-3, moduli).films
    for modulus, point in zip(moduli, films, strict=True):
        alone = Axisymmetric().solve(scene.replace({"inclusion.youngs_modulus": float(modulus)}), 1e-3).films[0]
        assert point.charges is not None
        assert alone.charges is not None
        bound = point.charges.relative_errors + alone.charges.relative_errors
        assert np.all(np.abs(point.charges.totals / alone.charges.totals - 1) <= bound)
        assert point.charges.log_sensitivity == pytest.approx(
            alone.charges.log_sensitivity, abs=point.charges.sensitivity_error + alone.charges.sensitivity_error
        )


def test_one_reading_key_decides_the_accuracy() -> None:
    """Where charges are read, their error is within the accuracy; stresses alone may leave it wider, and say so."""
    scene = build_scene("probe/glue/plain-3")
    for observable, narrow in (("charge", True), ("stress", False)):
        result = evaluate(scene.replace({"reading.observable": observable}), evaluator="axisymmetric", accuracy=0.003)
        assert result.charge_ratio_error is not None
        assert result.error_estimate is not None
        assert result.error_estimate <= 0.003
        assert not narrow or result.charge_ratio_error <= 0.003


def test_eq_12_takes_the_place_of_the_film_s_stress() -> None:
    scene = build_scene(TAPES).replace({"probe.film.psi1": 0.5, "probe.film.psi2": 1.0})
    film, result = scene.probe.film, evaluate(scene, evaluator="axisymmetric")
    assert film is not None
    expected = 0.5 * film.d31 + film.d32 + film.d33
    assert (result.charge_per_force_inner, result.charge_per_force_outer) == pytest.approx((expected, expected))
    assert result.charge_ratio == pytest.approx(result.ratio)
