"""Compute film forces of a probe on tissue in three dimensions from three states of its base, solved with one factor."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import SolveError
from geometry.tetra.tet_mesh import MeshBody
from solver.linalg.cholesky import Factor
from solver.linalg.conjugate_gradients import (
    TARGET_RESIDUAL,
    MatrixAnalysis,
    compute_residual,
    factorise_lower,
    round_to_single,
    solve,
)
from solver.linalg.rational_response import BodySpace, RationalResponse
from solver.materials.linear import VOIGT_PAIRS, VOIGT_WEIGHTS, LinearLaw
from solver.solid.problem import BLOCK_BODIES, STATE_NAMES, Problem
from solver.solid.regions import Region
from solver.solid.tetrahedron import iterate_quadrature

MAX_DOUBLE_PRECISION_UNKNOWNS = (
    20_000  # unknowns up to which factors are in double precision; above, single precision is faster and half as large
)
MAX_MODULUS_RATIO = 100.0
FORCE_TOLERANCE_RELATIVE = 1e-7  # of the film forces: change by the last step of a curve, above the remaining error
MAX_BASIS_STEPS = 60
MIN_NEW_ENERGY_SHARE = 1e-16  # of a vector's energy: new directions with less are dropped


@dataclass(frozen=True)
class SolidStates:
    """Base states: solutions for three unit motions of the base; and, where films' charges are wanted, two film states.

    In the first two, the base of the inner or of the outer block moves down by one unit while the other is held; in the third,
    both rotate together about y (a positive angle lowers the side +x).

    Attributes
    ----------
    problem
        The problem that was solved.
    v
        The unknowns of the s states, shape (unknowns, s), s = 3 or 5.
    energies
        v_i^T K_b v_j of each body b, with its stiffness K_b, for the whole mesh, shape (s, s).
    """

    problem: Problem
    v: Floats
    energies: Mapping[int, Floats]

    @property
    def products(self) -> Floats:
        """Energies of all s states with the base states, shape (s, 3): ``reactions``, below them charges in ``CHARGE_UNIT``."""
        return self.compute_modulus_derivative(self.energies)

    @property
    def reactions(self) -> Floats:
        """Forces on both films and the moment about y, by rows, in the three states: N/m, N/rad, N m/rad; (3, 3), symmetric."""
        return self.products[: len(STATE_NAMES)]

    @property
    def forces(self) -> Floats:
        """F_ij: force on film i (0 inner, 1 outer) per unit displacement of base j, N/m, shape (2, 2)."""
        return self.reactions[:2, :2]

    @property
    def residual(self) -> float:
        """Maximum residual of the states, relative to the loads."""
        return compute_residual(self.problem.matrix, self.problem.loads, self.v)

    @property
    def tilt(self) -> Floats:
        """Forces on both films per unit rotation of the base about y, N/rad, shape (2,)."""
        return self.reactions[:2, 2]

    def compute_modulus_derivative(self, bodies: Iterable[int]) -> Floats:
        """Return the derivative of ``products`` with respect to ln E, with E the common modulus of some bodies, shape (s, 3).

        They are the energy products v_i^T K v_j of states i and j. As the states v minimise the energy, their own
        change with E has no effect of first order: the derivative is the bodies' part, the sum of their v_i^T K_b v_j.

        Parameters
        ----------
        bodies
            The bodies' numbers, keys of ``energies``.
        """
        total = sum((self.energies[body] for body in bodies), start=np.zeros((self.v.shape[1],) * 2))
        return np.asarray(total[:, : len(STATE_NAMES)])

    def compute_charges(self, film_lift: Floats) -> Floats:
        """Return the charges of films in the base states as the work of the blocks' end forces on w of eq. MS.12, shape (2, 3).

        That takes no film states, of which the error is the same. ``film_lift`` is w as in ``Problem``.
        """
        problem, charges = self.problem, np.zeros((film_lift.shape[1], len(STATE_NAMES)))
        for body in problem.laws:
            if body in BLOCK_BODIES and body in problem.solid.parts:
                u = problem.compute_displacements(self.v, body)[:, : len(STATE_NAMES)]
                charges += film_lift.T @ problem.compute_forces([body], u)
        return problem.symmetry_factor * charges


@dataclass(frozen=True)
class FactorisedStates(SolidStates):
    """States together with the factor that solved them.

    Attributes
    ----------
    factor
        Factor of the problem's matrix or of one near it.
    """

    factor: Factor

    @property
    def bare_states(self) -> SolidStates:
        """The states alone, without the factorised stiffness matrix, which takes most of their memory."""
        return SolidStates(self.problem, self.v, self.energies)


def solve_states(
    problem: Problem,
    *,
    factor: Factor | None = None,
    start: Floats | None = None,
    target: float = TARGET_RESIDUAL,
) -> FactorisedStates:
    """Solve a problem for the three base states and its film states.

    Parameters
    ----------
    problem
        The problem to solve.
    factor
        Factor of a matrix near the problem's; None for its own.
    start
        Start of the iteration, such as the states for other materials.
    target
        Relative residual at which the iteration ends.

    Raises
    ------
    SolveError
        The residual is too large.
    """
    factor, loads = factor or factorise_problem(problem), problem.loads
    try:
        v = solve(problem.matrix, loads, factor, start, target)
    except SolveError:  # the factor's matrix is too far from this one, or single precision is too rough
        factor = problem.matrix.factor(single=False)
        v = solve(problem.matrix, loads, factor, target=target)
    return FactorisedStates(problem, v, compute_energies(problem, v), factor)


def factorise_problem(problem: Problem, like: MatrixAnalysis | None = None) -> Factor:
    """Factorise a problem's matrix; large systems in single precision, with the contrast of moduli limited.

    Parameters
    ----------
    problem
        The problem.
    like
        The analysis of a matrix with the same sparsity pattern, or None.

    Notes
    -----
    In single precision, errors in very stiff bodies would outweigh the softest layer.
    """
    if problem.supports.unknowns <= MAX_DOUBLE_PRECISION_UNKNOWNS:
        return problem.matrix.factor(like=like)
    limited_laws = dict(problem.laws)
    # the softest tissue's modulus
    tissue = min(law.youngs_modulus for body, law in limited_laws.items() if Region.from_number(body).body == MeshBody.TISSUE)
    for body, law in problem.laws.items():
        if Region.from_number(body).body >= MeshBody.TISSUE:
            modulus = float(np.clip(law.youngs_modulus, tissue / MAX_MODULUS_RATIO, tissue * MAX_MODULUS_RATIO))
            if modulus != law.youngs_modulus:
                limited_laws[body] = replace(law, youngs_modulus=modulus)
    if limited_laws == problem.laws:
        return problem.matrix.factor(single=True, like=like)
    return factorise_lower(  # nothing else refers to the double-precision matrix, which is freed before the factorisation
        round_to_single(Problem.assemble(problem.solid, limited_laws, problem.supports).matrix.lower), like
    )


def compute_energies(problem: Problem, v: Floats) -> Mapping[int, Floats]:
    """Return twice the elastic energies of pairs of states, v_i^T K_b v_j, for each body b that is present.

    ``v`` are the unknowns of k states, shape (unknowns, k); each energy has shape (k, k) and is symmetric.
    """
    products = {body: problem.compute_energy(body, v) for body in problem.laws if body in problem.solid.parts}
    return {body: (e + e.T) / 2 for body, e in products.items()}


def compute_solid_response(states: FactorisedStates, bodies: tuple[int, ...], low: float, high: float) -> RationalResponse:
    """Compute products as a function of an inclusion's modulus; ``bodies`` are the numbers of its parts.

    With the inclusion's part K_b of the stiffness, F are the products of ``SolidStates``, and on a basis v_k orthonormal in K in
    which K_b is diagonal, K_b v_k = l_k K v_k, c_kj = v_k^T K_b u_j and G_ij = u_i^T K_b u_j:

        F(t) = F(1) + (t - 1) G - (t - 1)^2 sum_k c_k c_k^T / (1 + (t - 1) l_k),   t = E / E_0         (SO.7)

    The basis grows until F no longer changes at either end of the range. Galerkin's error in F is the square of the states'.

    Moduli range from ``low`` to ``high``, multiples of the modulus that ``states`` were solved with. That modulus should be
    within a factor of 100 of the tissue's: at a million times the tissue's, 1 - l_k is lost to rounding (errors of 1e-4 were
    measured), and at a millionth it takes several times as many steps.

    Raises
    ------
    SolveError
        The range is too wide for the tolerance, or a system could not be solved.
    """
    problem, ends, previous = states.problem, np.array([low, high]), states.products[None]

    def apply_body_stiffness(displacements: Floats) -> Floats:
        """Return K_b times displacements of all nodes (3 n, k), on the unknowns."""
        return problem.restrict(problem.compute_forces(bodies, displacements))

    space = BodySpace(
        problem.matrix,
        lambda loads: solve(problem.matrix, loads, states.factor),
        lambda v: apply_body_stiffness(problem.expand(v)),
        apply_body_stiffness(problem.compute_displacements(states.v, bodies[0])),
        MIN_NEW_ENERGY_SHARE,
    )
    for _ in range(MAX_BASIS_STEPS):
        grown = space.grow()
        curve = space.build_response(states.products, states.compute_modulus_derivative(bodies), problem.symmetry_factor)
        products = curve.evaluate(ends)[0]  # eq. SO.7
        scale = np.sqrt(np.abs(np.einsum("nii->ni", products[:, : len(STATE_NAMES)])))
        # relative to the reactions' diagonal, so that N/m, N/rad and N m/rad compare; only the film forces must settle
        change = np.abs(products - previous)[:, :2] / (scale[:, :2, None] * scale[:, None])
        if not grown or np.all(change < FORCE_TOLERANCE_RELATIVE):
            return curve
        previous = products
    raise SolveError(f"the curve from {low:g} to {high:g} times the modulus did not converge to {FORCE_TOLERANCE_RELATIVE:.0e}")


@dataclass(frozen=True)
class SolidFields:
    """Displacements and stresses for output; bodies that are absent have zeros.

    Attributes
    ----------
    displacement
        Displacements of the solid's nodes, m, shape (nodes, 3).
    stress
        Means over elements, tension positive, xx yy zz yz xz xy, Pa, shape (t, 6).
    """

    displacement: Floats
    stress: Floats

    @property
    def von_mises(self) -> Floats:
        """Von Mises stress of each element's mean stress, Pa, shape (t,).

        Its square is half the sum of (xx - yy)^2, (yy - zz)^2 and (zz - xx)^2, plus three times that of yz^2, xz^2 and xy^2.
        """
        direct, shear = self.stress[:, :3], self.stress[:, 3:]
        differences = direct - np.roll(direct, 1, axis=1)  # xx - zz, yy - xx, zz - yy
        return np.asarray(np.sqrt((differences**2).sum(axis=1) / 2 + 3 * (shear**2).sum(axis=1)))

    @property
    def vertical_stress(self) -> Floats:
        """Stress zz, compression positive, Pa, shape (t,)."""
        return -self.stress[:, 2]


def compute_fields(states: SolidStates, motion: Floats) -> SolidFields:
    """Compute displacements and stresses for a motion of the base.

    ``motion`` holds the amounts of the three states, shape (3,): both blocks' displacements down, m, and the rotation, rad.
    """
    problem, solid = states.problem, states.problem.solid
    u, body = np.zeros(solid.nodes.size), solid.body
    stress = np.zeros((len(body), 6))
    for number, law in problem.laws.items():
        inside = np.flatnonzero(body == number)
        displacements = problem.compute_displacements(states.v, number)[:, : len(motion)] @ motion
        stress[inside] = _compute_stresses(
            solid.nodes[solid.elements[inside]], displacements.reshape(-1, 3)[solid.elements[inside]], law
        )
        if number in BLOCK_BODIES:  # their unknowns are relative to the base's rigid motion
            displacements = displacements + problem.supports.motion.reshape(-1, len(STATE_NAMES)) @ motion
        components = (3 * np.unique(solid.elements[inside])[:, None] + np.arange(3)).ravel()
        u[components] = displacements[components]
    return SolidFields(u.reshape(-1, 3), stress)


def _compute_stresses(x: Floats, u: Floats, law: LinearLaw) -> Floats:
    """Compute the mean stresses of elements, Pa, shape (t, 6), in the order xx yy zz yz xz xy.

    ``x`` are the elements' nodes and ``u`` their displacements, m, shape (t, 10, 3) both; ``law`` is the material of all.
    """
    stiffness, stresses, (rows, columns) = law.build_stiffness(), np.zeros((len(x), 6)), np.transpose(VOIGT_PAIRS)
    for selection, _, g, weight in iterate_quadrature(x):
        mean = np.einsum("nqaj,nq->naj", g, weight / weight.sum(axis=1, keepdims=True))  # mean gradients of the functions
        gradient = u[selection].transpose(0, 2, 1) @ mean
        strain = (gradient + gradient.transpose(0, 2, 1)) / 2
        stresses[selection] = (strain[:, rows, columns] * VOIGT_WEIGHTS) @ stiffness
    return stresses


def average_at_nodes(elements: Ints, values: Floats, count: int) -> Floats:
    """Average the values of elements at each node that they share.

    Where bodies meet this would mix their values: pass the elements of one body.

    Parameters
    ----------
    elements
        Nodes of the elements, shape (t, nodes of one).
    values
        Value of each element, shape (t,).
    count
        Number of all nodes.

    Returns
    -------
    Floats
        Mean over the elements of each node, shape (count,); 0 where there are none.
    """
    number = np.bincount(elements.ravel(), minlength=count)
    total = np.bincount(elements.ravel(), weights=np.repeat(values, elements.shape[1]), minlength=count)
    return np.asarray(total / np.maximum(number, 1))  # nodes without elements: 0 / 1
