"""Scenes on one mesh share its factor: what comes out must be what a factor of their own gives (``test_elements`` holds that)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from geometry.tetra.tet_mesh import MeshBody, TetMesh
from solver.linalg.conjugate_gradients import TARGET_RESIDUAL
from solver.linalg.workspace import Workspace, use_workspace
from solver.materials.linear import Isotropic
from solver.solid import cached_mesh as kept_mesh_module
from solver.solid.base_states import solve_states
from solver.solid.cached_mesh import CachedMesh, compute_modulus_spread, estimate_steps, find_cached_mesh
from solver.solid.moved_mesh import compute_stretches
from solver.solid.problem import Problem, Solid
from tests.support.meshes import stored_mesh

WHOLE = (MeshBody.INNER, MeshBody.OUTER, MeshBody.GROOVE, MeshBody.TISSUE, MeshBody.BEYOND, MeshBody.FIRST_INCLUSION)
SCENE = (MeshBody.INNER, MeshBody.OUTER, MeshBody.TISSUE, MeshBody.BEYOND, MeshBody.FIRST_INCLUSION)  # the groove is air
REFERENCE = (
    MeshBody.INNER,
    MeshBody.OUTER,
    MeshBody.GROOVE,
    MeshBody.TISSUE,
    MeshBody.FIRST_INCLUSION,
)  # nothing beyond the cylinder


def materials(bodies: tuple[int, ...], sphere: float = 6e3, tissue: float = 6e3, ratio: float = 0.45) -> dict[int, Isotropic]:
    moduli = {
        MeshBody.INNER: 1e6,
        MeshBody.OUTER: 8e4,
        MeshBody.GROOVE: 8e4,
        MeshBody.TISSUE: tissue,
        MeshBody.BEYOND: tissue,
        MeshBody.FIRST_INCLUSION: sphere,
    }
    return {body: Isotropic(moduli[body], ratio) for body in bodies}


@pytest.fixture
def workspace() -> Iterator[Workspace]:
    with use_workspace(Workspace()) as kept_workspace:
        yield kept_workspace


@pytest.fixture
def kept(workspace: Workspace) -> CachedMesh:
    return find_cached_mesh(stored_mesh("probe"), frictionless=False)


@pytest.fixture
def factors(monkeypatch: pytest.MonkeyPatch) -> list[Problem]:
    """Every problem that is factorised for a cached mesh."""
    made: list[Problem] = []
    factorise = kept_mesh_module.factorise_problem

    def record(problem, like=None):
        made.append(problem)
        return factorise(problem, like)

    monkeypatch.setattr(kept_mesh_module, "factorise_problem", record)
    return made


@pytest.mark.parametrize(
    ("bodies", "sphere"), [(WHOLE, 6.0), (SCENE, 6e6), (REFERENCE, 6e4)], ids=["whole", "scene", "reference"]
)
def test_what_is_left_out_needs_no_factor_of_its_own(
    kept: CachedMesh, factors: list[Problem], bodies: tuple[int, ...], sphere: float
) -> None:
    kept.find_states("before", materials(WHOLE), materials(WHOLE))
    solution = kept.find_states("scene", materials(bodies, sphere), materials(WHOLE))
    expected = solve_states(Problem.assemble(kept.solid, materials(bodies, sphere)))
    assert solution.reactions == pytest.approx(expected.reactions, rel=1e-7, abs=1e-7 * abs(expected.reactions[0, 0]) * 1e-3)
    assert solution.residual <= 1e-8
    assert len(factors) == 1


def test_the_same_materials_are_not_solved_again(kept: CachedMesh, monkeypatch: pytest.MonkeyPatch) -> None:
    first = kept.find_states("scene", materials(SCENE, 6e4), materials(WHOLE))
    monkeypatch.setattr(kept_mesh_module, "solve_states", lambda *_, **__: pytest.fail("solved again"))
    repeated = kept.find_states("scene", materials(SCENE, 6e4), materials(WHOLE))
    assert repeated.v is first.v
    assert repeated.factor is not None


@pytest.mark.slow
def test_other_tissue_uses_the_factor_while_moduli_are_near(kept: CachedMesh, factors: list[Problem]) -> None:
    for tissue, ratio, expected in ((6e3, 0.45, 1), (6.3e3, 0.45, 1), (6e5, 0.45, 2), (6e5, 0.4999, 3)):
        base = materials(WHOLE, tissue, tissue, ratio)
        solution = kept.find_states("scene", materials(SCENE, 6e4, tissue, ratio), base)
        solved_anew = solve_states(Problem.assemble(kept.solid, materials(SCENE, 6e4, tissue, ratio)))
        assert solution.forces == pytest.approx(solved_anew.forces, rel=1e-7)
        assert len(factors) == expected


@pytest.mark.slow
def test_moved_nodes_share_the_factor_but_not_the_states(workspace: Workspace, factors: list[Problem]) -> None:
    mesh = stored_mesh("probe")
    thicker = replace(mesh, nodes=np.where(mesh.nodes[:, 2:] < 0, mesh.nodes * [1.0, 1.0, 1.02], mesh.nodes))
    solutions = [states_on(tetrahedra) for tetrahedra in (mesh, thicker)]
    assert len(factors) == 1
    assert solutions[1] == pytest.approx(own_states_on(thicker), rel=1e-7)
    assert abs(solutions[1][0, 0] / solutions[0][0, 0] - 1) > 1e-5


def states_on(mesh: TetMesh) -> np.ndarray:
    return find_cached_mesh(mesh, frictionless=False).find_states("scene", materials(SCENE, 6e4), materials(WHOLE)).forces


def own_states_on(mesh: TetMesh) -> np.ndarray:
    return solve_states(Problem.assemble(Solid.from_mesh(mesh), materials(SCENE, 6e4))).forces


def test_what_is_kept_is_counted_and_may_go(workspace: Workspace, kept: CachedMesh) -> None:
    kept.find_states("scene", materials(SCENE, 6e4), materials(WHOLE))
    factor = kept.shared.regions.factor  # type: ignore[union-attr]
    assert workspace.bytes_held > getattr(factor, "foreign_bytes", 0) > 0
    workspace.limit = 0.0
    workspace.begin()
    workspace.make_room()
    assert workspace.bytes_held == 0


def test_spread_is_blind_to_a_common_factor() -> None:
    first, second = materials(WHOLE), materials(WHOLE, tissue=6e4)
    twice = {body: replace(m, youngs_modulus=2 * m.youngs_modulus) for body, m in first.items()}
    assert compute_modulus_spread(first, twice) == pytest.approx(1.0)
    assert compute_modulus_spread(first, second) == pytest.approx(10.0)


def test_expected_steps_are_those_that_conjugate_gradients_take() -> None:
    """A diagonal matrix with evenly spread eigenvalues, solved step by step: the bound holds, and is at most twice the truth."""
    for condition in (1.5, 4.0, 30.0):
        diagonal, b = np.linspace(1.0, condition, 2000), np.ones(2000)
        x, r = np.zeros(2000), b.copy()
        p, count = r.copy(), 0
        while np.sqrt(np.sum(r**2)) > TARGET_RESIDUAL * np.sqrt(2000.0):
            gain = (r @ r) / (p @ (diagonal * p))
            x, new = x + gain * p, r - gain * diagonal * p
            p, r, count = new + (new @ new) / (r @ r) * p, new, count + 1
        assert count <= np.ceil(estimate_steps(condition)) + 1
        assert count >= estimate_steps(condition) / 2


def test_stretches_of_a_shear() -> None:
    """Of x -> x + g z the principal stretches are those of the right Cauchy-Green tensor: sqrt(1 + g^2/4) +- g/2, and 1."""
    nodes, g = np.vstack([np.zeros(3), np.eye(3)]), 0.7
    computed = np.sort(compute_stretches(np.arange(4)[None], nodes, nodes + g * nodes[:, [2]] * [1.0, 0.0, 0.0])[0])
    root = np.sqrt(1 + g**2 / 4)
    assert computed == pytest.approx([root - g / 2, 1.0, root + g / 2])
