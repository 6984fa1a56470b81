"""Error bounds from one mesh, against independent codes and the laws of Galerkin's method."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from geometry import Contact, CylinderTissue, Inclusion, Load, Material, Probe, Scene
from geometry.meridian.mesh_lines import MeridianFineness
from geometry.scenes.scene_tables import Layer
from solver import evaluate
from solver.axisymmetric import converged_forces
from solver.axisymmetric.base_states import approximate_lower_order, project_to_lower_order
from solver.axisymmetric.condensed_system import System
from solver.axisymmetric.dofs import Interface, number_unknowns
from solver.axisymmetric.lower_order import bound_by_descent, bound_by_last_degree, bound_by_lower_order
from solver.axisymmetric.refinement import LIGHT_MESH, MESH_LEVELS
from solver.axisymmetric.sample import MeshSample, solve_on_mesh
from solver.axisymmetric.sections import build_sections
from tests.support.references import Expected, named
from tests.support.slow import slow_unless

HARD = (
    ("extremes", "gap-5-mm-micro-probe"), ("extremes", "flat-soft-incompressible-blocks"), ("extremes", "corner-13"),
    ("extremes", "inner-just-pulled"), ("extremes", "cover-10-um-contrast-1e6"),
    ("tissue-layers", "bone-below"), ("tissue-layers", "plate-on-gel"), ("tissue-layers", "film-of-a-tenth-millimetre"),
)  # fmt: skip

CURVES = (
    ("axisymmetric", "shallow"), ("extremes", "gap-5-mm-micro-probe"), ("extremes", "corner-13"),
    ("extremes", "cover-10-um-contrast-1e6"), ("tissue-layers", "plate-on-gel"),
)  # fmt: skip


def sample_on(reference: Expected, level: MeridianFineness) -> MeshSample:
    scene_sections = build_sections(reference.scene)
    return solve_on_mesh(scene_sections.section, scene_sections, reference.scene, level)


@pytest.mark.parametrize(("folder", "name"), slow_unless(lambda case: case in (*HARD[:2], HARD[-2]), HARD))
@pytest.mark.parametrize("level", [LIGHT_MESH, *MESH_LEVELS[1:4]], ids=["light", "4", "5", "6"])
def test_bounds_of_one_mesh_hold_where_references_are_hardest(folder: str, name: str, level: MeridianFineness) -> None:
    """The films' shares of the force and the stiffness follow from the references' stresses."""
    reference = named(folder, name)
    probe = reference.scene.probe
    forces = np.array([reference.stress_inner * probe.inner_area, reference.stress_outer * probe.outer_area])
    true = reference.stiffness * forces / forces.sum()
    solution = sample_on(reference, level)
    for bounds in (bound_by_lower_order(solution), bound_by_descent(solution), bound_by_last_degree(solution)):
        if bounds is not None:
            assert np.all(np.abs(solution.totals[0] - true) <= bounds.totals[0] + reference.uncertainty * np.abs(true))
            if reference.log_sensitivity is not None:
                assert abs(solution.log_sensitivities[0, 0] - reference.log_sensitivity) <= bounds.sensitivity[0, 0] + 1e-6


@pytest.mark.parametrize(("folder", "name"), slow_unless(lambda case: case == CURVES[0], CURVES))
@pytest.mark.parametrize("level", [LIGHT_MESH, *MESH_LEVELS[1:4]], ids=["light", "4", "5", "6"])
def test_bounds_of_a_curve_hold_at_a_modulus_that_references_know(folder: str, name: str, level: MeridianFineness) -> None:
    """The modulus lies at either end of the curve, or within: none of them is the one that the states are solved for."""
    reference, scene_sections = named(folder, name), build_sections(named(folder, name).scene)
    probe, modulus = reference.scene.probe, reference.scene.inclusion[0].youngs_modulus
    forces = np.array([reference.stress_inner * probe.inner_area, reference.stress_outer * probe.outer_area])
    true = reference.stiffness * forces / forces.sum()
    for times in ([1.0, 1e3], [1e-3, 0.1, 1.0], [0.01, 1.0, 30.0]):
        solution = solve_on_mesh(scene_sections.section, scene_sections, reference.scene, level, moduli=modulus * np.array(times))
        bounds, k = bound_by_last_degree(solution) or bound_by_lower_order(solution), times.index(1.0)
        assert np.all(np.abs(solution.totals[k] - true) <= bounds.totals[k] + reference.uncertainty * np.abs(true))
        if reference.log_sensitivity is not None:
            assert abs(solution.log_sensitivities[k, 0] - reference.log_sensitivity) <= bounds.sensitivity[k, 0] + 1e-6


@pytest.mark.parametrize("level", [LIGHT_MESH, MESH_LEVELS[3]], ids=["light", "6"])
def test_a_curves_bounds_are_little_wider_than_those_of_its_moduli(level: MeridianFineness) -> None:
    """Sums of projected vectors are nearly the best states of the smaller space, also where the inclusion is all but rigid."""
    bare_scene = named("axisymmetric", "shallow").scene
    moduli = bare_scene.inclusion[0].youngs_modulus * np.geomspace(1e-3, 1e3, 4)
    scene_sections = build_sections(bare_scene)
    curve = bound_by_lower_order(solve_on_mesh(scene_sections.section, scene_sections, bare_scene, level, moduli=moduli)).totals
    for modulus, solution in zip(moduli, curve, strict=True):
        body = bare_scene.inclusion[0].model_copy(update={"youngs_modulus": float(modulus)})
        scene = bare_scene.model_copy(update={"inclusion": (body,)})
        alone = bound_by_lower_order(solve_on_mesh(scene_sections.section, build_sections(scene), scene, level)).totals[0]
        assert np.all((solution > 0.9 * alone) & (solution < 2.5 * alone))


@pytest.mark.parametrize("interface", ["published-materials", "published-materials-frictionless"])
def test_a_smaller_space_has_more_energy(interface: str) -> None:
    """Of the prescribed displacements the true state has the least energy: F_ii and the stiffness fall as the space grows."""
    solution = sample_on(named("axisymmetric", interface), MESH_LEVELS[1])
    stiffness, smaller = (
        solution.states.model.system.stiffness,
        project_to_lower_order(solution.states, solution.states.edge[..., :0], 3),
    )
    forces = np.einsum("nai,nab,nbj->ij", smaller, stiffness, smaller, optimize=True)
    added = forces - solution.forces[0]
    assert np.all(np.linalg.eigvalsh(added) > 0)
    change = smaller - solution.states.edge
    np.testing.assert_allclose(np.einsum("nai,nab,nbj->ij", change, stiffness, change, optimize=True), added, rtol=1e-6)


@pytest.mark.parametrize("interface", ["bonded", "frictionless"])
def test_a_smaller_space_is_that_of_a_mesh_of_lower_order(interface: Interface) -> None:
    """Numbered and added up anew, from the same condensed matrices without the rows of the last degree."""
    name = "published-materials" + ("-frictionless" if interface == "frictionless" else "")
    states = sample_on(named("axisymmetric", name), MESH_LEVELS[1]).states
    model, degrees = states.model, states.model.shapes.degrees[: states.model.shapes.skeleton].max(axis=1)
    kept = np.flatnonzero(np.tile(degrees, 2) <= 3)
    numbers = number_unknowns(model.mesh, 3, interface)
    smaller = System.from_stiffness(numbers, np.ascontiguousarray(model.system.stiffness[:, kept][:, :, kept]))
    expected = smaller.solve(np.zeros((numbers.unknowns, 2)), numbers.lift).values
    lowered = project_to_lower_order(states, states.edge[..., :0], 3)
    np.testing.assert_allclose(lowered[:, kept], expected, atol=1e-9)
    assert not np.any(np.delete(lowered, kept, axis=1))


@pytest.mark.parametrize("name", ["published-materials", "shallow", "soft-cyst"])
def test_the_smaller_spaces_state_is_nearer_than_the_own_one_without_its_last_degree(name: str) -> None:
    """Galerkin: it is the best of all in that space."""
    solution = sample_on(named("axisymmetric", name), MESH_LEVELS[2])
    model, edge = solution.states.model, solution.states.edge
    cut = edge.copy()
    cut[:, np.tile(model.shapes.degrees[: model.shapes.skeleton].max(axis=1), 2) == 5] = 0.0
    sizes = [
        np.einsum("nai,nab,nbi->i", change, model.system.stiffness, change, optimize=True)
        for change in (project_to_lower_order(solution.states, edge[..., :0], 4) - edge, cut - edge)
    ]
    assert np.all(sizes[0] < sizes[1])


@pytest.mark.parametrize("name", ["published-materials", "shallow", "soft-cyst", "published-materials-frictionless"])
@pytest.mark.parametrize("level", [LIGHT_MESH, MESH_LEVELS[3]], ids=["light", "6"])
def test_one_step_without_a_factorisation_is_nearly_the_best_of_the_smaller_space(name: str, level: MeridianFineness) -> None:
    """Never nearer than it is (Galerkin), and not by a fifth farther: by so much the bound may be wider."""
    states = sample_on(named("axisymmetric", name), level).states
    edge, stiffness = states.edge, states.model.system.stiffness
    best = project_to_lower_order(states, edge[..., :0], level.order - 1) - edge
    nearby, loads = approximate_lower_order(states)
    sizes = [np.einsum("nai,nab,nbi->i", change, stiffness, change, optimize=True) for change in (best, nearby)]
    assert np.all((sizes[0] < sizes[1]) & (sizes[1] < 1.2 * sizes[0]))
    last = np.tile(states.model.shapes.degrees[: states.model.shapes.skeleton].max(axis=1), 2) == level.order
    assert not np.any((edge + nearby)[:, last])
    np.testing.assert_allclose(loads, stiffness @ nearby, rtol=0, atol=1e-10 * np.abs(loads).max())


@pytest.mark.parametrize("tell", [bound_by_last_degree, bound_by_lower_order])
def test_bounds_wider_than_a_total_are_numbers_where_nothing_varies(tell: Any) -> None:
    """Of a probe on tissue without a tumour whose inner block is hardly pressed."""
    scene = named("extremes", "corner-13").scene.model_copy(update={"inclusion": ()})
    scene_sections = build_sections(scene)
    solution = solve_on_mesh(scene_sections.section, scene_sections, scene, MESH_LEVELS[2])
    with np.errstate(all="raise"):
        bounds = tell(solution)
    assert np.all(bounds.sensitivity < 1e-6)


@pytest.mark.slow
def test_a_second_mesh_is_solved_only_where_one_does_not_do(monkeypatch: pytest.MonkeyPatch) -> None:
    meshes: list[int] = []

    def counted(*args: Any, **named: Any) -> MeshSample:
        meshes.append(args[3].order)
        return solve_on_mesh(*args, **named)

    monkeypatch.setattr(converged_forces, "solve_on_mesh", counted)
    usual, hard = named("axisymmetric", "soft-cyst").scene, named("extremes", "gap-5-mm-micro-probe").scene
    for scene, accuracy in ((usual, 0.005), (usual, 0.001), (hard, 0.005)):
        meshes.append(0)
        assert evaluate(scene, "axisymmetric", accuracy).error_estimate <= accuracy
    assert meshes[:7] == [0, 4, 0, 5, 0, 4, 4]


@pytest.mark.parametrize("level", [LIGHT_MESH, MESH_LEVELS[3]], ids=["light", "6"])
def test_bounds_hold_where_a_stiff_layer_ends_nearby(level: MeridianFineness) -> None:
    """Against a finer mesh: where cells were not cut there the usual factors were too small at order 6."""
    layer = Layer(thickness=4.1e-3, youngs_modulus=1.9464e6, poisson_ratio=0.45)
    probe = Probe(
        inner_radius=0.508e-3, outer_radius=0.714e-3, gap=0.148e-3, inner_height=0.693e-3, outer_height=0.827e-3,
        inner=Material(youngs_modulus=102e3, poisson_ratio=0.307), outer=Material(youngs_modulus=2e3, poisson_ratio=0.307),
    )  # fmt: skip
    tissue = CylinderTissue(
        shape="cylinder", radius=6.2e-3, depth=4.87e-3, youngs_modulus=6e3, poisson_ratio=0.45, layer=(layer,)
    )
    body = Inclusion(diameter=3.12e-3, depth=2.34e-3, youngs_modulus=126e3, poisson_ratio=0.366)
    scene = Scene(probe=probe, tissue=tissue, inclusion=(body,), contact=Contact(interface="frictionless"), load=Load(force=1e-6))
    scene_sections = build_sections(scene)
    computed, true = (
        solve_on_mesh(scene_sections.section, scene_sections, scene, fineness) for fineness in (level, MESH_LEVELS[4])
    )
    for tell in (bound_by_last_degree, bound_by_descent, bound_by_lower_order):
        bounds = tell(computed)
        assert bounds is None or np.all(np.abs(computed.totals - true.totals) <= bounds.totals)


@pytest.mark.parametrize("name", ["soft-skin", "sphere-across"])
def test_layers_take_one_mesh(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Layers of cells lie wherever interfaces end, at the tissue's side or on the sphere."""
    samples: list[MeshSample] = []

    def counted(*args: Any, **names: Any) -> MeshSample:
        samples.append(solve_on_mesh(*args, **names))
        return samples[-1]

    monkeypatch.setattr(converged_forces, "solve_on_mesh", counted)
    evaluate(named("tissue-layers", name).scene, "axisymmetric", 0.02, linear=True)
    assert len(samples) == 1
