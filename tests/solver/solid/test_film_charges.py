"""Charges of films in three dimensions: displacements of stacks, reciprocity, and scenes whose charges are known."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.special import ive

from geometry.scenes.scene import Scene
from geometry.tetra.sizing import ROUGH_FINENESS, ROUGHEST_FINENESS
from solver.axisymmetric.film_states import CHARGE_UNIT
from solver.multiple_scattering.stack_motion import StackMotion, compute_stack_motion
from solver.solid.difference import SceneDifference, solve_difference
from solver.solid.domain import Domain, choose_domain, compute_reach
from solver.solid.evaluator import SolidEvaluator
from solver.solid.film_forces import compute_solid_forces
from solver.solid.symmetric_part import compute_symmetric_part
from tests.support.film_scenes import build_scene, read_cases
from tests.support.meshes import SCENE, scene_mesh
from tests.support.references import named

TAPES, GLUED, SOFT_BELOW = "probe/two-tapes-0.4/tumour-300", "probe/bare/tumour-30", "probe/base-tape-1/tumour-30"
D31, D32, D33 = 20e-12, 2e-12, -20e-12
TAPE = {"thickness": 5e-5, "youngs_modulus": 1e6, "poisson_ratio": 0.45}


def bonded(name: str = SCENE, **film: object) -> Scene:
    """A scene of tests/reference/solid whose films have a tape towards the base, or what ``film`` says."""
    scene = named("solid", name).scene
    data = scene.model_dump(exclude_unset=True)
    data["probe"]["film"] = {"bond_to_base": TAPE, **film}
    return Scene.model_validate(data)


@cache
def motion(modulus: float) -> StackMotion:
    """Of films on tape of a Young's modulus, Pa, without tape towards the blocks."""
    return compute_stack_motion(bonded(bond_to_base={**TAPE, "youngs_modulus": modulus}))


def test_a_film_on_a_bond_without_stiffness_is_strained_freely() -> None:
    """Its strain is d31 / t along its length, d32 / t across it, d33 / t along z."""
    free, places = motion(1.0), np.array([[1e-3, 0.0], [0.0, 2e-3], [-1.5e-3, 1e-3]])
    w = CHARGE_UNIT * free.evaluate(0, places, 0.0, False)[..., 0] * 110e-6
    assert w[:, 0] == pytest.approx(D31 * places[:, 0], rel=2e-3, abs=1e-18)
    assert w[:, 1] == pytest.approx(D32 * places[:, 1], rel=2e-2, abs=1e-18)
    turned = CHARGE_UNIT * free.evaluate(0, places[:1], np.pi / 2, False)[..., 0] * 110e-6  # x lies across the film's length
    assert turned[0, 0] == pytest.approx(D32 * 1e-3, rel=2e-2)
    slanted, mirrored = (free.evaluate(0, places[:1], np.pi / 4, half)[0, :, 0] for half in (False, True))
    assert slanted[0] == pytest.approx(mirrored[0])
    assert CHARGE_UNIT * abs(slanted[1]) * 110e-6 == pytest.approx((D31 - D32) / 2 * 1e-3, rel=2e-3)
    assert mirrored[1] == 0.0


def test_a_rigidly_bonded_film_thickens_and_does_not_stretch() -> None:
    """FILM.md eq. 3: d33 + 2 d_p nu / (1 - nu), away from edges."""
    stiff = compute_stack_motion(bonded(bond_to_base=None))
    places = np.array([[1e-3, 0.0], [0.0, 2e-3]])
    w = CHARGE_UNIT * stiff.evaluate(0, places, 0.0, False)[..., 0]
    assert -w[:, 2] == pytest.approx(D33 + (D31 + D32) * 0.34 / 0.66, rel=1e-3)
    assert np.abs(w[:, :2]).max() < 1e-3 * D31 * 2e-3 / 110e-6


@pytest.mark.parametrize("modulus", [2e5, 1e6, 1e7])
def test_a_film_on_tape_stretches_as_a_membrane_on_springs(modulus: float) -> None:
    """FILM.md eq. 3: v = A I1(r / lambda), v' + nu v / r = 1 + nu at the free edge; to the membrane's own accuracy."""
    film, nu = 2.5e9, 0.34
    spring = 1 / (50e-6 / (modulus / (2 * 1.45)) + 110e-6 / (3 * film / (2 * (1 + nu))))
    length = np.sqrt(film * 110e-6 / (1 - nu**2) / spring)
    edge = bonded().probe.inner_radius
    r, scale = np.array([0.3, 0.6, 0.9]) * edge, edge / length
    # I1' = I0 - I1 / x; scaled by exp(-edge / lambda)
    slope = (ive(0, scale) - ive(1, scale) / scale) / length + nu * ive(1, scale) / edge
    v = (1 + nu) * ive(1, r / length) * np.exp(r / length - scale) / slope
    points = np.column_stack([r, np.zeros(3)])
    w = CHARGE_UNIT * motion(modulus).evaluate(0, points, np.pi / 4, True)[:, 0, 0]  # at 45 degrees: the mean part alone
    assert w * 110e-6 / ((D31 + D32) / 2) == pytest.approx(v, rel=0.06)


def domain(scene: Scene) -> Domain:
    return choose_domain(scene, compute_reach(scene), None)


@cache
def difference(modulus: float = 3e4, d32: float = D32) -> SceneDifference:
    scene = bonded(d32=d32)
    body = scene.inclusion[0].model_copy(update={"youngs_modulus": modulus})
    here = domain(scene.model_copy(update={"inclusion": (body,)}))
    return solve_difference(here, scene_mesh(here, ROUGHEST_FINENESS))[0]


def test_film_states_give_the_work_of_the_blocks_end_forces() -> None:
    """Reciprocity: two ways to the same charge."""
    here = domain(bonded())
    solution = solve_difference(here, scene_mesh(here, ROUGHEST_FINENESS))[1]
    assert solution.problem.film_lift is not None
    work = solution.compute_charges(solution.problem.film_lift)
    assert solution.products[3:] == pytest.approx(work, rel=1e-6, abs=1e-6 * np.abs(work[:, :2]).max())


def test_derivatives_of_charges_by_the_modulus() -> None:
    step = 2e-2
    low, high, middle = (difference(3e4 * np.exp(h)).charges for h in (-step, step, 0.0))
    assert low is not None
    assert high is not None
    assert middle is not None
    slope = (high.scene - low.scene) / (2 * step)
    assert middle.derivative == pytest.approx(slope, rel=3e-3, abs=1e-4 * np.abs(slope).max())


@pytest.mark.slow
def test_a_curve_is_what_single_moduli_give() -> None:
    here, moduli = domain(bonded()), np.array([1e3, 3e5])
    curve = solve_difference(here, scene_mesh(here, ROUGHEST_FINENESS), moduli)[0].charges
    assert curve is not None
    for k, modulus in enumerate(moduli):
        alone = difference(float(modulus)).charges
        assert alone is not None
        assert curve.scene[k] == pytest.approx(alone.scene[0], rel=1e-5, abs=1e-6 * np.abs(alone.scene).max())
        assert curve.derivative[k] == pytest.approx(alone.derivative[0], rel=1e-3, abs=1e-5 * np.abs(alone.scene).max())


def test_charges_of_the_reference_are_those_of_the_meridian_plane() -> None:
    """The stack holds the block as a rigid face does where the film is glued, FILM.md eq. 4: 0.1 % without the mesh's error."""
    scene = bonded(bond_to_base=None)
    symmetric = compute_symmetric_part(scene, 0.02)
    films = symmetric.whole.films
    assert films.charges is not None
    here = symmetric.domain
    made = solve_difference(here, scene_mesh(here, ROUGH_FINENESS))[0]
    assert made.charges is not None
    reference = made.charges.reference[:, :2].sum(axis=1) / made.reference.sum(axis=1)
    assert reference == pytest.approx(films.charges.totals / films.totals, rel=0.1)


@pytest.mark.slow
def test_a_turned_scene_has_other_charges_where_d31_and_d32_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter turn of the tumour exchanges d31 and d32; with both equal it changes nothing."""
    monkeypatch.setattr("solver.solid.film_forces.mesh_domain", scene_mesh)

    def charges(angle: float, d31: float, d32: float) -> np.ndarray:
        scene = bonded(d31=d31, d32=d32)
        body = scene.inclusion[0]
        far = np.hypot(body.x, body.y)
        turned = body.model_copy(update={"x": far * np.cos(angle), "y": far * np.sin(angle)})
        films = compute_solid_forces(scene.model_copy(update={"inclusion": (turned,)}), 0.05).films[0]
        assert films.charges is not None
        return films.charges.totals / films.totals

    along, across = charges(0.0, D31, D32), charges(np.pi / 2, D31, D32)
    assert charges(np.pi / 2, D32, D31) == pytest.approx(along, rel=1e-6)
    assert charges(np.pi / 4, D31, D32) == pytest.approx((along + across) / 2, rel=1e-6)
    assert np.abs(along / across - 1).max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", [TAPES, GLUED, SOFT_BELOW])
def test_tumours_on_the_axis_against_independent_codes(name: str) -> None:
    """The meshes know nothing of the symmetry."""
    case = read_cases()[name]
    result = SolidEvaluator().evaluate(build_scene(name).replace({"reading.observable": "charge"}), 0.02)
    for value, error, expected in zip(
        (result.charge_per_force_inner, result.charge_per_force_outer),
        (result.charge_per_force_inner_error, result.charge_per_force_outer_error),
        case["charge_per_force"],
        strict=True,
    ):
        assert value is not None
        assert error is not None
        deviation = abs(value / (1e-12 * expected) - 1)
        assert deviation <= min(error, 0.01) + case["relative_uncertainty"]
