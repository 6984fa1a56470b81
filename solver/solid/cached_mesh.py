"""Cache the parts of one mesh's solution that the next scene can use: the integrated mesh, one factor, and the last states.

The factor is that of all regions together, with tissue in place of inclusions. Scene and reference leave some of them out: the
groove, tissue beyond the reference cylinder. With the stiffness K of all regions and the restriction R to the unknowns in use,
R K^-1 R^T is the inverse of the stiffness in use plus that of the other regions, condensed on the faces between both. The others
store a bounded multiple of the energy next to them. Conjugate gradients with this preconditioner therefore take a bounded number
of steps on any mesh.

Meshes with the same elements, made by moving the nodes of one mesh, may share the factor: an element's energy changes at most by
the fourth power of the ratio of its principal stretches. That and the change of the moduli bound the condition number k of the
preconditioned matrix. Conjugate gradients then take

    n <= ln(2 / e) / ln((sqrt k + 1) / (sqrt k - 1))  steps to a relative error e;                  (SO.8)

if these cost more than a factorisation, the matrix is factorised again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from threading import RLock

import numpy as np
from scipy.linalg import eigvalsh

from geometry.common.arrays import Floats, Ints
from geometry.tetra.tet_mesh import TetMesh
from solver.linalg.cholesky import Factor
from solver.linalg.conjugate_gradients import MAX_RESIDUAL_FACTOR, TARGET_RESIDUAL, get_analysis
from solver.linalg.workspace import get_workspace
from solver.materials.linear import Isotropic, LinearLaw
from solver.solid.base_states import FactorisedStates, SolidStates, factorise_problem, solve_states
from solver.solid.moved_mesh import compute_stretches
from solver.solid.problem import Problem, Solid, Supports

REUSE_STEPS_COEFFICIENT = 0.03  # steps that cost as much as a factorisation, over unknowns^(2/3), the ratio of their operations
SOLVES_PER_FACTOR = 2  # solutions with one factor: reference and scene
Laws = Mapping[int, Isotropic]


@dataclass(frozen=True)
class RestrictedFactor:
    """The inverse of a larger problem's stiffness on some of its unknowns.

    Attributes
    ----------
    whole
        The larger problem's factor.
    place
        Index of each unknown among the larger problem's, shape (unknowns,).
    size
        Number of unknowns of the larger problem.
    """

    whole: Factor
    place: Ints
    size: int

    @classmethod
    def restrict(cls, factor: Factor, whole: Supports, supports: Supports) -> Factor:
        """Restrict a factor of all regions to the unknowns in use; return it unchanged if all are.

        Parameters
        ----------
        factor
            Factor of the stiffness of all regions.
        whole, supports
            Numbers of the unknowns of all regions, and of those in use; a number below 0 is no unknown.
        """
        if np.array_equal(whole.number, supports.number):
            return factor
        is_used, place = supports.number >= 0, np.empty(supports.unknowns, dtype=np.int64)
        place[supports.number[is_used]] = whole.number[is_used]
        return cls(factor, place, whole.unknowns)

    def solve(self, forces: Floats) -> Floats:
        """Return R K^-1 R^T times forces, shape (unknowns, k) both, with the larger problem's stiffness K."""
        wide = np.zeros((self.size, forces.shape[1]))
        wide[self.place] = forces
        return np.asarray(self.whole.solve(wide)[self.place])


@dataclass(frozen=True)
class FactorisedRegions:
    """All regions of a mesh as they were factorised.

    Attributes
    ----------
    laws, nodes
        Laws of the regions and nodes of the mesh, m, shape (n, 3), at that time.
    supports
        Unknowns of all regions together.
    factor
        Factor of their stiffness.
    """

    laws: Laws
    nodes: Floats
    supports: Supports
    factor: Factor


@dataclass
class SharedFactor:
    """Factor and states that meshes with the same elements share.

    Attributes
    ----------
    regions
        The factorised problem, or None.
    solid
        The mesh integrated last.
    latest
        The last solution of each kind of states, from which others start.
    lock
        Held while states are solved.
    """

    regions: FactorisedRegions | None = None
    solid: Solid | None = None
    latest: dict[str, Floats] = field(default_factory=dict)
    lock: RLock = field(default_factory=RLock)

    def find_factor(self, problem: Problem, base: Laws) -> Factor:
        """Return a factor near a problem's matrix; factorise again if the cached one is too far away.

        ``base`` are the laws of all regions with which a new factor is made; see ``find_base_material``.
        """
        if self.regions is None or not self._is_worth_reusing(problem, base, self.regions):
            like = None if self.regions is None else get_analysis(self.regions.factor)
            self.regions = None  # frees it before the next is made
            whole = problem if problem.laws == base else Problem.assemble(problem.solid, base)
            self.regions = FactorisedRegions(base, problem.solid.nodes, whole.supports, factorise_problem(whole, like))
        return RestrictedFactor.restrict(self.regions.factor, self.regions.supports, problem.supports)

    @staticmethod
    def _is_worth_reusing(problem: Problem, base: Laws, regions: FactorisedRegions) -> bool:
        """Return whether iterating with the factor of ``regions`` costs less than a new factor, made with the laws ``base``.

        The inclusions' contrast with the tissue adds the same number of steps in both cases.
        """
        solid = problem.solid
        stretch = 1.0
        if regions.nodes is not solid.nodes:
            lengths = compute_stretches(solid.elements, regions.nodes, solid.nodes)
            stretch = float(lengths.max() / lengths.min())
        step_count = SOLVES_PER_FACTOR * estimate_steps(compute_modulus_spread(regions.laws, base) * stretch**4)
        return bool(step_count <= REUSE_STEPS_COEFFICIENT * regions.supports.unknowns ** (2 / 3))

    def find_start(self, kind: str, unknowns: int, count: int) -> Floats | None:
        """Return ``count`` columns of the last solution with so many unknowns, preferably of the states named ``kind``, or None.

        States that it lacks start from zero.
        """
        candidates = (self.latest.get(kind), *self.latest.values())
        start = next((v for v in candidates if v is not None and len(v) == unknowns), None)
        if start is None or start.shape[1] == count:
            return start
        return np.hstack([start[:, :count], np.zeros((unknowns, max(0, count - start.shape[1])))])


@dataclass
class CachedMesh:
    """A mesh with its last solutions; scenes that differ in moduli, Poisson's ratios and loads share it.

    Attributes
    ----------
    solid
        The mesh, integrated.
    shared
        Factor and states shared with other meshes of the same elements.
    """

    solid: Solid
    shared: SharedFactor
    _states: dict[str, SolidStates] = field(default_factory=dict)
    _own_factors: dict[str, Factor] = field(default_factory=dict)  # of states for which the shared factor was too far away

    def find_states(
        self, kind: str, laws: Laws, base: Laws, target: float = TARGET_RESIDUAL, film_lift: Floats | None = None
    ) -> FactorisedStates:
        """Return the states for a scene's laws: the cached ones, or new ones solved from these.

        Parameters
        ----------
        kind
            Name of the cached states to start from and to replace.
        laws
            Laws of the regions that are present.
        base
            Laws of all regions, for the factor; a factor of similar laws is used again.
        target
            Relative residual of the solution.
        film_lift
            See ``Problem``.

        Raises
        ------
        SolveError
            The equations could not be solved.
        LimitReached
            A factor would exceed the limits of memory or time.
        """
        with self.shared.lock:
            previous = self._states.get(kind)
            if (
                previous is not None
                and previous.problem.laws == laws
                and _is_same_lift(previous.problem.film_lift, film_lift)
                and previous.residual <= MAX_RESIDUAL_FACTOR * target
            ):
                factor = self._own_factors.get(kind) or self.shared.find_factor(previous.problem, base)
                return FactorisedStates(previous.problem, previous.v, previous.energies, factor)
            # supports depend only on which regions are present
            supports = [item.problem.supports for item in self._states.values() if set(item.problem.laws) == set(laws)]
            problem = Problem.assemble(self.solid, laws, supports[0] if supports else None, film_lift)
            shared_factor, start = (
                self.shared.find_factor(problem, base),
                self.shared.find_start(kind, problem.supports.unknowns, problem.loads.shape[1]),
            )
            states = solve_states(problem, factor=shared_factor, start=start, target=target)
            self._states[kind], self.shared.latest[kind] = states.bare_states, states.v
            # solve_states makes a new factor where the shared one is too far away; only the last such factor is kept
            self._own_factors = {kind: states.factor} if states.factor is not shared_factor else {}
            return states


def _is_same_lift(first: Floats | None, second: Floats | None) -> bool:
    """Return whether two problems have the same film states, or both have none."""
    return first is second or (first is not None and second is not None and np.array_equal(first, second))


def find_cached_mesh(mesh: TetMesh, frictionless: bool) -> CachedMesh:
    """Return the workspace's cached mesh with the same content; integrate the mesh if there is none.

    ``frictionless`` faces slide on the tissue; otherwise they are bonded.

    Raises
    ------
    SolveError
        An element is turned inside out.
    """
    elements = _compute_digest(f"{frictionless} {mesh.half}", mesh.elements, mesh.body, mesh.beyond, mesh.layer)
    shared = get_workspace().keep((SharedFactor, elements), SharedFactor)
    nodes = _compute_digest(elements, mesh.nodes)

    def build() -> CachedMesh:
        """Integrate the mesh, with the parts of the last one whose nodes have not moved."""
        shared.solid = Solid.from_mesh(mesh, frictionless, like=shared.solid)
        return CachedMesh(shared.solid, shared)

    return get_workspace().keep((CachedMesh, nodes), build)


def _compute_digest(head: str, *arrays: np.ndarray) -> str:
    """Return a hash of a text and some arrays."""
    digest = hashlib.sha256(head.encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def estimate_steps(condition: float) -> float:
    """Estimate the steps of conjugate gradients, eq. SO.8, to the target residual for a condition number."""
    root = np.sqrt(max(condition, 1 + 1e-9))  # above 1, where the formula divides by zero
    return float(np.log(2 / TARGET_RESIDUAL) / np.log((root + 1) / (root - 1)))


def compute_modulus_spread(old: Laws, new: Laws) -> float:
    """Return how much the moduli of all regions changed relative to each other: the maximum ratio new / old over the minimum."""
    changes = [_compute_modulus_changes(new[body], old[body]) for body in old]
    return float(np.max(changes) / np.min(changes))


def _compute_modulus_changes(new: LinearLaw, old: LinearLaw) -> Floats:
    """Return the minimum and maximum, over all strains, of the new law's energy over the old law's, shape (2,).

    For isotropic laws these are ratios of bulk or of shear moduli.
    """
    return np.asarray(eigvalsh(new.build_stiffness(), old.build_stiffness())[[0, -1]])
