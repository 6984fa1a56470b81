"""Error bounds from one mesh, against independent codes and the laws of Galerkin's method."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from geometry import Contact, CylinderTissue, Inclusion, Load, Material, Probe, Scene
from geometry.meridian.frame import MeridianFineness
from geometry.scenes.scene import Layer
from solver import evaluate
from solver.axisymmetric import converged_forces
from solver.axisymmetric.base_states import lower_order, near_lower_order
from solver.axisymmetric.condensed_system import System
from solver.axisymmetric.dofs import Interface, numbering
from solver.axisymmetric.lower_order import near_errors, order_errors, own_errors
from solver.axisymmetric.refinement import LEVELS, LIGHT
from solver.axisymmetric.sample import MeshSample, sample
from solver.axisymmetric.sections import sections
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


def on(one: Expected, level: MeridianFineness) -> MeshSample:
    of = sections(one.scene)
    return sample(of.section, of, one.scene, level)


@pytest.mark.parametrize(("folder", "name"), slow_unless(lambda case: case in (*HARD[:2], HARD[-2]), HARD))
@pytest.mark.parametrize("level", [LIGHT, *LEVELS[1:4]], ids=["light", "4", "5", "6"])
def test_bounds_of_one_mesh_hold_where_references_are_hardest(folder: str, name: str, level: MeridianFineness) -> None:
    """The films' shares of the force and the stiffness follow from the references' stresses."""
    one = named(folder, name)
    probe = one.scene.probe
    forces = np.array([one.stress_inner * probe.inner_area, one.stress_outer * probe.outer_area])
    true = one.stiffness * forces / forces.sum()
    found = on(one, level)
    for bounds in (order_errors(found), near_errors(found), own_errors(found)):
        if bounds is not None:
            assert np.all(np.abs(found.totals[0] - true) <= bounds.totals[0] + one.uncertainty * np.abs(true))
            if one.log_sensitivity is not None:
                assert abs(found.log_sensitivity[0] - one.log_sensitivity) <= bounds.sensitivity[0] + 1e-6


@pytest.mark.parametrize(("folder", "name"), slow_unless(lambda case: case == CURVES[0], CURVES))
@pytest.mark.parametrize("level", [LIGHT, *LEVELS[1:4]], ids=["light", "4", "5", "6"])
def test_bounds_of_a_curve_hold_at_a_modulus_that_references_know(folder: str, name: str, level: MeridianFineness) -> None:
    """The modulus lies at either end of the curve, or within: none of them is the one that the states are solved for."""
    one, of = named(folder, name), sections(named(folder, name).scene)
    probe, own = one.scene.probe, one.scene.inclusion[0].youngs_modulus
    forces = np.array([one.stress_inner * probe.inner_area, one.stress_outer * probe.outer_area])
    true = one.stiffness * forces / forces.sum()
    for times in ([1.0, 1e3], [1e-3, 0.1, 1.0], [0.01, 1.0, 30.0]):
        found = sample(of.section, of, one.scene, level, moduli=own * np.array(times))
        bounds, k = own_errors(found) or order_errors(found), times.index(1.0)
        assert np.all(np.abs(found.totals[k] - true) <= bounds.totals[k] + one.uncertainty * np.abs(true))
        if one.log_sensitivity is not None:
            assert abs(found.log_sensitivity[k] - one.log_sensitivity) <= bounds.sensitivity[k] + 1e-6


@pytest.mark.parametrize("level", [LIGHT, LEVELS[3]], ids=["light", "6"])
def test_a_curves_bounds_are_little_wider_than_those_of_its_moduli(level: MeridianFineness) -> None:
    """Sums of projected vectors are nearly the best states of the smaller space, also where the inclusion is all but rigid."""
    one = named("axisymmetric", "shallow").scene
    moduli = one.inclusion[0].youngs_modulus * np.geomspace(1e-3, 1e3, 4)
    of = sections(one)
    curve = order_errors(sample(of.section, of, one, level, moduli=moduli)).totals
    for modulus, found in zip(moduli, curve, strict=True):
        body = one.inclusion[0].model_copy(update={"youngs_modulus": float(modulus)})
        scene = one.model_copy(update={"inclusion": (body,)})
        alone = order_errors(sample(of.section, sections(scene), scene, level)).totals[0]
        assert np.all((found > 0.9 * alone) & (found < 2.5 * alone))


@pytest.mark.parametrize("interface", ["published-materials", "published-materials-frictionless"])
def test_a_smaller_space_has_more_energy(interface: str) -> None:
    """Of the prescribed displacements the true state has the least energy: F_ii and the stiffness fall as the space grows."""
    found = on(named("axisymmetric", interface), LEVELS[1])
    stiffness, smaller = found.states.model.system.stiffness, lower_order(found.states, found.states.edge[..., :0], 3)
    forces = np.einsum("nai,nab,nbj->ij", smaller, stiffness, smaller, optimize=True)
    more = forces - found.forces[0]
    assert np.all(np.linalg.eigvalsh(more) > 0)
    change = smaller - found.states.edge
    np.testing.assert_allclose(np.einsum("nai,nab,nbj->ij", change, stiffness, change, optimize=True), more, rtol=1e-6)


@pytest.mark.parametrize("interface", ["bonded", "frictionless"])
def test_a_smaller_space_is_that_of_a_mesh_of_lower_order(interface: Interface) -> None:
    """Numbered and added up anew, from the same condensed matrices without the rows of the last degree."""
    name = "published-materials" + ("-frictionless" if interface == "frictionless" else "")
    states = on(named("axisymmetric", name), LEVELS[1]).states
    model, degrees = states.model, states.model.shapes.degrees[: states.model.shapes.skeleton].max(axis=1)
    kept = np.flatnonzero(np.tile(degrees, 2) <= 3)
    numbers = numbering(model.mesh, 3, interface)
    smaller = System.of(numbers, np.ascontiguousarray(model.system.stiffness[:, kept][:, :, kept]))
    expected = smaller.solve(np.zeros((numbers.unknowns, 2)), numbers.lift).own
    found = lower_order(states, states.edge[..., :0], 3)
    np.testing.assert_allclose(found[:, kept], expected, atol=1e-9)
    assert not np.any(np.delete(found, kept, axis=1))


@pytest.mark.parametrize("name", ["published-materials", "shallow", "soft-cyst"])
def test_the_smaller_spaces_state_is_nearer_than_the_own_one_without_its_last_degree(name: str) -> None:
    """Galerkin: it is the best of all in that space."""
    found = on(named("axisymmetric", name), LEVELS[2])
    model, own = found.states.model, found.states.edge
    cut = own.copy()
    cut[:, np.tile(model.shapes.degrees[: model.shapes.skeleton].max(axis=1), 2) == 5] = 0.0
    sizes = [
        np.einsum("nai,nab,nbi->i", change, model.system.stiffness, change, optimize=True)
        for change in (lower_order(found.states, own[..., :0], 4) - own, cut - own)
    ]
    assert np.all(sizes[0] < sizes[1])


@pytest.mark.parametrize("name", ["published-materials", "shallow", "soft-cyst", "published-materials-frictionless"])
@pytest.mark.parametrize("level", [LIGHT, LEVELS[3]], ids=["light", "6"])
def test_one_step_without_a_factorisation_is_nearly_the_best_of_the_smaller_space(name: str, level: MeridianFineness) -> None:
    """Never nearer than it is (Galerkin), and not by a fifth farther: by so much the bound may be wider."""
    states = on(named("axisymmetric", name), level).states
    own, stiffness = states.edge, states.model.system.stiffness
    best, (near, loads) = lower_order(states, own[..., :0], level.order - 1), near_lower_order(states, level.order - 1)
    sizes = [np.einsum("nai,nab,nbi->i", one - own, stiffness, one - own, optimize=True) for one in (best, near)]
    assert np.all((sizes[0] < sizes[1]) & (sizes[1] < 1.2 * sizes[0]))
    last = np.tile(states.model.shapes.degrees[: states.model.shapes.skeleton].max(axis=1), 2) == level.order
    assert not np.any(near[:, last])
    np.testing.assert_allclose(loads, stiffness @ (near - own), rtol=0, atol=1e-10 * np.abs(loads).max())


@pytest.mark.parametrize("tell", [own_errors, order_errors])
def test_bounds_wider_than_a_total_are_numbers_where_nothing_varies(tell: Any) -> None:
    """Of a probe on tissue without a tumour whose inner block is hardly pressed."""
    one = named("extremes", "corner-13").scene.model_copy(update={"inclusion": ()})
    of = sections(one)
    found = sample(of.section, of, one, LEVELS[2])
    with np.errstate(all="raise"):
        bounds = tell(found)
    assert np.all(bounds.sensitivity < 1e-6)


def test_a_second_mesh_is_solved_only_where_one_does_not_do(monkeypatch: pytest.MonkeyPatch) -> None:
    meshes: list[int] = []

    def counted(*args: Any, **named: Any) -> MeshSample:
        meshes.append(args[3].order)
        return sample(*args, **named)

    monkeypatch.setattr(converged_forces, "sample", counted)
    usual, hard = named("axisymmetric", "soft-cyst").scene, named("extremes", "gap-5-mm-micro-probe").scene
    for scene, accuracy in ((usual, 0.005), (usual, 0.001), (hard, 0.005)):
        meshes.append(0)
        assert evaluate(scene, "axisymmetric", accuracy).error_estimate <= accuracy
    assert meshes[:7] == [0, 4, 0, 5, 0, 4, 4]


@pytest.mark.parametrize("level", [LIGHT, LEVELS[3]], ids=["light", "6"])
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
    of = sections(scene)
    found, true = (sample(of.section, of, scene, one) for one in (level, LEVELS[4]))
    for tell in (own_errors, near_errors, order_errors):
        bounds = tell(found)
        assert bounds is None or np.all(np.abs(found.totals - true.totals) <= bounds.totals)


@pytest.mark.parametrize("name", ["soft-skin", "sphere-across"])
def test_layers_take_one_mesh(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Layers of cells lie wherever interfaces end, at the tissue's side or on the sphere."""
    asked: list[MeshSample] = []

    def counted(*args: Any, **names: Any) -> MeshSample:
        asked.append(sample(*args, **names))
        return asked[-1]

    monkeypatch.setattr(converged_forces, "sample", counted)
    evaluate(named("tissue-layers", name).scene, "axisymmetric", 0.02, linear=True)
    assert len(asked) == 1
