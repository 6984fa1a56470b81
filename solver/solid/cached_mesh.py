"""Cache the parts of one mesh's solution that the next scene can use: the integrated mesh, one factor, and the last states.

The factor is that of all regions together, with tissue in place of inclusions. Scene and reference leave some of them out: the
groove, tissue beyond the reference cylinder. With the stiffness K of all regions and the restriction R to the unknowns in use,
R K^-1 R^T is the inverse of the stiffness in use plus that of the other regions, condensed on the faces between both. The others
store a bounded multiple of the energy next to them. Conjugate gradients with this preconditioner therefore take a bounded number
of steps on any mesh.

For other moduli, their change bounds the condition number k of the preconditioned matrix. Conjugate gradients then take

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
from geometry.tetra.tet_mesh import FIRST_INCLUSION_BODY, TetMesh
from solver.linalg.cholesky import Factor
from solver.linalg.conjugate_gradients import MAX_RESIDUAL_FACTOR, TARGET_RESIDUAL, get_analysis
from solver.linalg.workspace import get_workspace
from solver.materials.linear import Isotropic, LinearLaw
from solver.solid.base_states import FactorisedStates, SolidStates, factor_of, solid_states
from solver.solid.problem import Problem, Solid, Supports
from solver.solid.regions import Region

REUSE_STEPS_COEFFICIENT = 0.03  # steps that cost as much as a factorisation, over unknowns^(2/3), the ratio of their operations
MIN_MODULUS_RATIO = 1e-4  # of the old modulus: smaller new moduli are assembled, not added as a difference
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
        """Restrict a factor of all regions to the unknowns in use; return it unchanged if all are."""
        if np.array_equal(whole.number, supports.number):
            return factor
        has, place = supports.number >= 0, np.empty(supports.unknowns, dtype=np.int64)
        place[supports.number[has]] = whole.number[has]
        return cls(factor, place, whole.unknowns)

    def solve(self, forces: Floats) -> Floats:
        """Return R K^-1 R^T forces, shape (unknowns, k)."""
        wide = np.zeros((self.size, forces.shape[1]))
        wide[self.place] = forces
        return np.asarray(self.whole.solve(wide)[self.place])


@dataclass(frozen=True)
class FactorisedRegions:
    """All regions of a mesh, the laws they had, and the factor."""

    laws: Laws
    supports: Supports
    factor: Factor


@dataclass
class CachedMesh:
    """A mesh with its factor and last solutions; scenes that differ in moduli, Poisson's ratios and loads share it.

    Attributes
    ----------
    solid
        The mesh, integrated.
    regions
        The factorised problem, or None.
    lock
        Held while states are solved.
    """

    solid: Solid
    regions: FactorisedRegions | None = None
    lock: RLock = field(default_factory=RLock)
    _states: dict[str, SolidStates] = field(default_factory=dict)
    _own_factors: dict[str, Factor] = field(default_factory=dict)  # of states for which the shared factor was too far away

    def find_states(self, kind: str, laws: Laws, base: Laws, target: float = TARGET_RESIDUAL) -> FactorisedStates:
        """Return the states for a scene's laws: the cached ones, or solved from there.

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

        Raises
        ------
        SolveError
            The equations could not be solved.
        LimitReached
            A factor would exceed the limits of memory or time.
        """
        with self.lock:
            previous = self._states.get(kind)
            if previous is not None and previous.problem.laws == laws and previous.residual <= MAX_RESIDUAL_FACTOR * target:
                factor = self._own_factors.get(kind) or self._find_factor(previous.problem, base)
                return FactorisedStates(previous.problem, previous.v, previous.energies, factor)
            problem = self._assemble_problem(laws)
            shared_factor = self._find_factor(problem, base)
            known = [states.v for states in (previous, *self._states.values()) if states is not None]
            start = next((v for v in known if len(v) == problem.supports.unknowns), None)
            states = solid_states(problem, factor=shared_factor, start=start, target=target)
            self._states[kind] = states.bare_states
            self._own_factors = {kind: states.factor} if states.factor is not shared_factor else {}
            return states

    def _find_factor(self, problem: Problem, base: Laws) -> Factor:
        """Return a factor near a problem's matrix; factorise again if iterating with the cached one costs more than a new one.

        The inclusions' contrast adds to the steps of both alike.
        """
        if self.regions is not None:
            step_count = SOLVES_PER_FACTOR * estimate_steps(compute_modulus_spread(self.regions.laws, base))
            worth_reusing = step_count <= REUSE_STEPS_COEFFICIENT * self.regions.supports.unknowns ** (2 / 3)
        if self.regions is None or not worth_reusing:
            like = None if self.regions is None else get_analysis(self.regions.factor)
            self.regions = None  # frees it before the next is made
            whole = problem if problem.laws == base else Problem.assemble(problem.solid, base)
            self.regions = FactorisedRegions(base, whole.supports, factor_of(whole, like))
        return RestrictedFactor.restrict(self.regions.factor, self.regions.supports, problem.supports)

    def _assemble_problem(self, laws: Laws) -> Problem:
        """Assemble a problem, by the difference from earlier states of the same regions if rounding allows it."""
        problems = [states.problem for states in self._states.values() if set(states.problem.laws) == set(laws)]
        for known_problem in problems:
            changed = [body for body in laws if laws[body] != known_problem.laws[body]]
            if all(
                Region.from_number(body).body >= FIRST_INCLUSION_BODY
                and not _is_rounded_away(laws[body], known_problem.laws[body])
                for body in changed
            ):
                return known_problem.change_laws(laws)
        return Problem.assemble(self.solid, laws, problems[0].supports if problems else None)


def find_cached_mesh(mesh: TetMesh, frictionless: bool) -> CachedMesh:
    """Return the workspace's cached mesh with the same content.

    Raises
    ------
    SolveError
        An element is turned inside out.
    """
    digest = hashlib.sha256(f"{frictionless} {mesh.half}".encode())
    for array in (mesh.elements, mesh.body, mesh.beyond, mesh.layer, mesh.nodes):
        digest.update(np.ascontiguousarray(array).tobytes())
    return get_workspace().keep((CachedMesh, digest.hexdigest()), lambda: CachedMesh(Solid.from_mesh(mesh, frictionless)))


def estimate_steps(condition: float) -> float:
    """Estimate the steps of conjugate gradients, eq. SO.8, to the target residual for a condition number."""
    root = np.sqrt(max(condition, 1 + 1e-9))
    return float(np.log(2 / TARGET_RESIDUAL) / np.log((root + 1) / (root - 1)))


def compute_modulus_spread(old: Laws, new: Laws) -> float:
    """Return how much the moduli of all regions changed relative to each other: the maximum change over the minimum."""
    changes = [_compute_modulus_changes(new[body], old[body]) for body in old]
    return float(np.max(changes) / np.min(changes))


def _is_rounded_away(new: LinearLaw, old: LinearLaw) -> bool:
    """Return whether new moduli are so small that a difference from the old ones would lose them to rounding."""
    return bool(np.min(_compute_modulus_changes(new, old)) < MIN_MODULUS_RATIO)


def _compute_modulus_changes(new: LinearLaw, old: LinearLaw) -> Floats:
    """Return the extremes over all strains of the ratio of both laws' energies; of isotropic ones, of bulk or shear moduli."""
    return np.asarray(eigvalsh(new.build_stiffness(), old.build_stiffness())[[0, -1]])
