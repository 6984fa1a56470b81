"""Tetrahedra: what they must represent exactly, how fast they converge, and film forces of a small probe.

The meshes of tests/meshes are netgen's (benchmarks/references/solid_meshes.py): cylinders of unit radius and height, and half a
probe on round tissue (radii 4, 4.1 and 6 mm, height 3 mm, groove 2 mm x 1 mm; tissue of radius 16 mm and, beyond it, 20 mm, 16
mm deep; a sphere of 5 mm whose centre is 6 mm deep and 3 mm off the axis).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geometry.common.errors import SolveError
from geometry.scenes.scene_file import scene_from_dict
from geometry.tetra.tet_mesh import MeshBody, TetMesh, evaluate_quadratic_functions
from solver.axisymmetric.converged_forces import compute_converged_forces
from solver.linalg import conjugate_gradients as solid_factor
from solver.linalg.conjugate_gradients import Stiffness, solve
from solver.materials.linear import Isotropic
from solver.solid import base_states as solid_states_module
from solver.solid.base_states import SolidStates, average_at_nodes, compute_fields, compute_solid_response, solve_states
from solver.solid.body_stiffness import assemble, integrate_part
from solver.solid.problem import Problem, Solid
from solver.solid.regions import Region
from solver.solid.tetrahedron import find_curved, iterate_quadrature
from tests.support.meshes import stored_mesh
from tests.support.slow import slow_unless


def material(modulus: float, ratio: float = 0.45) -> Isotropic:
    return Isotropic(modulus, ratio)


def materials(sphere: float, ratio: float = 0.45) -> dict[int, Isotropic]:
    """The reference where the sphere's modulus is the tissue's."""
    blocks = {MeshBody.INNER: material(1e6, 0.48), MeshBody.OUTER: material(8e4, 0.48), MeshBody.GROOVE: material(8e4, 0.48)}
    return {**blocks, MeshBody.TISSUE: material(6e3, ratio), MeshBody.FIRST_INCLUSION: material(sphere, ratio)}


@cache
def solid(frictionless: bool = False) -> Solid:
    return Solid.from_mesh(stored_mesh("probe"), frictionless)


@cache
def states(sphere: float = 6e4, frictionless: bool = False, ratio: float = 0.45) -> SolidStates:
    return solve_states(Problem.assemble(solid(frictionless), materials(sphere, ratio)))


class TestElements:
    def test_functions_add_up_to_one_and_are_one_at_their_node(self) -> None:
        places = np.random.default_rng(1).dirichlet(np.ones(4), 20)[:, 1:]
        values, derivatives = evaluate_quadratic_functions(places)
        assert values.sum(axis=1) == pytest.approx(np.ones(20))
        assert derivatives.sum(axis=1) == pytest.approx(np.zeros((20, 3)), abs=1e-12)

    def test_volume_of_curved_elements(self) -> None:
        """Quadratic sides: 418 elements have the cylinder's volume to 1e-5, where straight ones have it to 1 %."""
        m = stored_mesh(CYLINDERS[0])
        assert find_curved(m.nodes[m.elements]).any()
        assert sum(w.sum() for _, _, _, w in iterate_quadrature(m.nodes[m.elements])) == pytest.approx(np.pi, rel=1e-5)

    @pytest.mark.parametrize("averaged", [False, True])
    def test_patch(self, averaged: bool) -> None:
        """A linear field leaves no force on any node inside, curved elements included; a rigid motion none anywhere."""
        m = stored_mesh(CYLINDERS[0])
        piece, random = integrate_part(m.nodes, m.elements, averaged), np.random.default_rng(2)
        linear = m.nodes @ random.normal(size=(3, 3)) + random.normal(size=3)
        turn = np.cross(m.nodes, random.normal(size=3)) + random.normal(size=3)
        forces = piece.compute_forces(material(1.0, 0.3), np.stack([linear.ravel(), turn.ravel()], axis=1)).reshape(-1, 3, 2)
        inside = np.setdiff1d(np.arange(len(m.nodes)), m.boundary(MeshBody.TISSUE))
        assert np.abs(forces[..., 0]).max() > 1e-3
        assert forces[inside, :, 0] == pytest.approx(np.zeros((len(inside), 3)), abs=1e-13)
        assert forces[..., 1] == pytest.approx(np.zeros((len(forces), 3)), abs=1e-13)

    def test_an_element_inside_out_is_refused(self) -> None:
        m = stored_mesh(CYLINDERS[0])
        with pytest.raises(SolveError, match="1 elements of the mesh are turned inside out"):
            integrate_part(m.nodes, np.vstack([m.elements[:5], m.elements[5, [1, 0, 2, 3, 4, 6, 5, 8, 7, 9]]]))


CYLINDERS = ("bonded-coarse", "bonded-fine")
BONDED = {0.3: 1.118576, 0.49: 1.502552, 0.4999: 1.544227}  # PHYSICS section 7, R/h = 1


def apparent_modulus(m: TetMesh, ratio: float, averaged: bool) -> float:
    """E_app / E of a cylinder between bonded rigid plates."""
    z, stuff = m.nodes[:, 2], material(1.0, ratio)
    held = (np.abs(z) < 1e-9) | (np.abs(z - 1) < 1e-9)
    number = np.full(m.nodes.shape, -1)
    number[~held] = np.arange(3 * np.sum(~held)).reshape(-1, 3)
    piece = integrate_part(m.nodes, m.elements, averaged)
    matrix = Stiffness(assemble({0: piece}, {0: stuff}, number))
    u = np.zeros((m.nodes.size, 1))
    u[2::3, 0] = np.where(z > 0.5, -1.0 * held, 0.0)
    free = number.ravel() >= 0
    u[free] = solve(matrix, -piece.compute_forces(stuff, u)[free], matrix.factor())
    return float((u.T @ piece.compute_forces(stuff, u)).item() / np.pi)


@pytest.mark.parametrize(("ratio", "worst"), [(0.3, 0.005), (0.49, 0.011), (0.4999, 0.012)])
def test_bonded_cylinder(ratio: float, worst: float) -> None:
    """Mean dilation: no locking, and the singular edges' rate (1.4 to 1.7 for a halved size) at every Poisson ratio."""
    coarse, fine = (apparent_modulus(stored_mesh(name), ratio, True) / BONDED[ratio] - 1 for name in CYLINDERS)
    assert abs(coarse) < worst
    assert np.log2(abs(coarse / fine)) > 1.4


def test_plain_elements_lock() -> None:
    plain, averaged = (apparent_modulus(stored_mesh(CYLINDERS[0]), 0.4999, way) / BONDED[0.4999] - 1 for way in (False, True))
    assert plain > 10 * averaged > 0


class TestStates:
    def test_reactions_are_symmetric_and_shared_by_the_floor(self) -> None:
        """The nodal forces of the field itself: on the tops those of the energies, on the bottom the opposite, elsewhere none."""
        solution, s = states(), solid()
        problem, total = solution.problem, np.zeros((s.nodes.size, 3))
        for body, stuff in problem.laws.items():
            total += s.parts[body].compute_forces(stuff, problem.compute_displacements(solution.v, body))
        vertical, z = 2 * total.reshape(-1, 3, 3)[:, 2], s.nodes[:, 2]
        for film, block in enumerate(([MeshBody.INNER], [MeshBody.OUTER, MeshBody.GROOVE])):
            top = s.find_nodes(block) & (z > 0.003 - 1e-9)
            assert -vertical[top].sum(axis=0) == pytest.approx(solution.reactions[film], rel=1e-7)
        assert vertical[z < -0.016 + 1e-9].sum(axis=0) == pytest.approx(solution.reactions[:2].sum(axis=0), rel=1e-7)
        inside = problem.supports.number >= 0
        assert np.abs(total.reshape(-1, 3, 3)[inside]).max() < 1e-9 * np.abs(vertical).max()

    def test_equal_blocks_moved_together_are_one_punch(self) -> None:
        """F is positive definite, its rows have the sign of a press, and a stiffer sphere stiffens the whole (Rayleigh)."""
        soft, hard = (states(e).forces for e in (6e3, 6e4))
        assert np.linalg.eigvalsh(hard).min() > 0
        assert hard.sum() > soft.sum()
        assert np.all(hard.sum(axis=1) > 0)

    def test_tilt_needs_something_off_the_axis(self) -> None:
        """By symmetry a tilt over round tissue puts no force on either film; here but for the mesh's own asymmetry."""
        size = 0.006 * states().forces.sum()
        assert np.abs(states(6e3).tilt).max() < 2e-3 * size < np.abs(states(6e4).tilt).max()

    def test_against_the_axisymmetric_level(self) -> None:
        """The reference, bonded and frictionless: within 2.5 %; what friction changes within 1.5 %."""
        exact = {kind: axisymmetric(kind) for kind in ("bonded", "frictionless")}
        film_sums = {kind: states(6e3, kind == "frictionless").forces.sum(axis=1) for kind in exact}
        for kind, forces in exact.items():
            assert film_sums[kind] == pytest.approx(forces, rel=0.025)
        change = film_sums["frictionless"] / film_sums["bonded"]
        assert change == pytest.approx(exact["frictionless"] / exact["bonded"], rel=0.015)

    def test_slope(self) -> None:
        """Taylor: F(e^h) - F - h F' is of second order."""
        solution, rests = states(), []
        for h in (0.1, 0.05):
            moved = solve_states(
                Problem.assemble(solid(), materials(6e4 * np.exp(h)), solution.problem.supports), start=solution.v
            )
            rests.append(
                np.abs(
                    moved.reactions - solution.reactions - h * solution.compute_modulus_derivative([MeshBody.FIRST_INCLUSION])
                ).max()
            )
        assert np.log2(rests[0] / rests[1]) == pytest.approx(2, abs=0.1)

    @pytest.mark.parametrize("sphere", [6e9, 6e-3])
    def test_states_from_the_factor_of_another_material(self, sphere: float) -> None:
        problem = Problem.assemble(solid(), materials(sphere), states().problem.supports)
        close = solve_states(problem, factor=states().factor, start=states().v)
        assert close.factor is states().factor
        assert close.forces == pytest.approx(states(sphere).forces, rel=1e-8)
        assert close.tilt == pytest.approx(states(sphere).tilt, rel=1e-6)

    def test_forces_are_exact_long_before_states(self) -> None:
        """They are in error by about the square of the residual; their derivatives by about itself."""
        problem, known = Problem.assemble(solid(), materials(6e6), states().problem.supports), states()
        early, late = (solve_states(problem, factor=known.factor, start=known.v, target=target) for target in (1e-6, 1e-11))
        assert early.residual > 1e-8
        assert early.forces == pytest.approx(late.forces, rel=1e-9)
        assert early.compute_modulus_derivative([MeshBody.FIRST_INCLUSION]) == pytest.approx(
            late.compute_modulus_derivative([MeshBody.FIRST_INCLUSION]), rel=1e-4, abs=1e-5 * late.forces.max()
        )

    def test_absent_bodies(self) -> None:
        """A groove takes stiffness away, tissue beyond adds some; another choice of bodies is another system."""
        cut = solve_states(Problem.assemble(solid(), {k: v for k, v in materials(6e4).items() if k != MeshBody.GROOVE}))
        wide = solve_states(Problem.assemble(solid(), {**materials(6e4), MeshBody.BEYOND: material(6e3)}))
        assert cut.factor is not states().factor
        assert cut.forces.sum() < states().forces.sum() < wide.forces.sum()

    def test_an_inclusion_beyond_the_reference_is_a_body_of_its_own(self) -> None:
        m = stored_mesh("probe")
        across = replace(m, body=np.where(m.body == MeshBody.BEYOND, MeshBody.FIRST_INCLUSION, m.body))
        assert set(Solid.from_mesh(across).parts) == {
            MeshBody.INNER,
            MeshBody.OUTER,
            MeshBody.GROOVE,
            MeshBody.TISSUE,
            MeshBody.FIRST_INCLUSION,
            Region(MeshBody.FIRST_INCLUSION, outside=True).number,
        }


@cache
def axisymmetric(interface: str) -> np.ndarray:
    blocks = {"inner": (1e6, 0.48), "outer": (8e4, 0.48)}
    probe = {key: {"youngs_modulus": f"{e} Pa", "poisson_ratio": nu} for key, (e, nu) in blocks.items()}
    sizes = {"inner_radius": "4 mm", "outer_radius": "6 mm", "gap": "0.1 mm", "height": "3 mm", "base": {"rigid": True}}
    tissue = {"shape": "cylinder", "radius": "16 mm", "depth": "16 mm", "youngs_modulus": "6 kPa", "poisson_ratio": 0.45}
    data = {"probe": {**sizes, **probe}, "tissue": tissue, "contact": {"interface": interface}, "load": {"force": "0.1 N"}}
    return compute_converged_forces(scene_from_dict(data), 1e-3).films[0].totals


class TestCurve:
    @pytest.mark.parametrize("ratio", slow_unless((0.45).__eq__, [0.45, 0.4999]))
    def test_twelve_decades_from_one_factor(self, ratio: float) -> None:
        curve = compute_solid_response(states(6e4, ratio=ratio), (MeshBody.FIRST_INCLUSION,), 1e-7, 1e5)
        for t in (1e-7, 1.0, 30.0, 1e5):
            alone = states(6e4 * t, ratio=ratio)
            reactions, derivatives = curve.evaluate(np.array([t]))
            assert np.abs(reactions[0] / alone.reactions - 1)[:2, :2].max() < 1e-7
            assert reactions[0] == pytest.approx(alone.reactions, abs=1e-7 * alone.forces.max())
            assert derivatives[0] == pytest.approx(
                alone.compute_modulus_derivative([MeshBody.FIRST_INCLUSION]), abs=1e-6 * np.abs(alone.forces).max()
            )


class TestFields:
    def test_equilibrium_of_stresses(self) -> None:
        """Mean stress zz of a block's upper layer is about its film's stress; nothing strains a rigidly held part."""
        solution, motion = states(), np.array([1e-6, 1e-6, 0.0])
        field_values, centre = compute_fields(solution, motion), solid().nodes[solid().elements].mean(axis=1)
        inner = (solid().body == MeshBody.INNER) & (centre[:, 2] > 0.002)
        pressure = solution.forces.sum(axis=1)[0] * 1e-6 / (np.pi * 16e-6)
        assert np.mean(field_values.vertical_stress[inner]) == pytest.approx(pressure, rel=0.3)
        assert field_values.von_mises.min() >= 0
        assert average_at_nodes(solid().elements, np.ones(len(centre)), len(solid().nodes)).max() == 1.0

    def test_the_base_goes_down(self) -> None:
        field_values, top = compute_fields(states(), np.array([1e-6, 1e-6, 0.0])), solid().nodes[:, 2] > 0.003 - 1e-9
        assert field_values.displacement[top, 2] == pytest.approx(-1e-6 * np.ones(top.sum()))


class TestSolver:
    def test_single_precision_gives_the_same(self) -> None:
        problem = states(6e6, ratio=0.49).problem
        v = solve(problem.matrix, problem.loads, problem.matrix.factor(single=True))
        assert v == pytest.approx(states(6e6, ratio=0.49).v, abs=1e-7)

    def test_where_single_precision_fails_double_serves(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(solid_factor, "MAX_STEPS", 10)
        monkeypatch.setattr(solid_states_module, "MAX_DOUBLE_PRECISION_UNKNOWNS", 0)
        solution = solve_states(states(6e9, ratio=0.4999).problem)
        assert solution.forces == pytest.approx(states(6e9, ratio=0.4999).forces, rel=1e-9)

    def test_large_systems(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(solid_states_module, "MAX_DOUBLE_PRECISION_UNKNOWNS", 0)
        for sphere in (6e-3, 6e9):
            solution = solve_states(states(sphere).problem)
            assert solution.forces == pytest.approx(states(sphere).forces, rel=1e-8)

    def test_without_rslab(self, monkeypatch: pytest.MonkeyPatch) -> None:
        pytest.importorskip("pymklpardiso", reason="SuperLU would take a minute")
        monkeypatch.setattr(solid_factor, "_load_rslab", lambda: None)
        assert solve_states(states().problem).reactions == pytest.approx(states().reactions, rel=1e-9)

    def test_a_bad_factor_is_noticed(self) -> None:
        class Wrong:
            def solve(self, forces: np.ndarray) -> np.ndarray:
                return forces

        with pytest.raises(SolveError, match="relative residual"):
            solve(states().problem.matrix, states().problem.loads, Wrong())
