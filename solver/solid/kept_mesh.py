"""What solving on one mesh leaves for the next scene on it: the integrated mesh, one factor, and the states found last.

The factor is that of all regions together, with tissue in place of inclusions. Scene and reference leave some of them out: the
groove, tissue beyond the reference cylinder. The factor's inverse on the unknowns they have, R K^-1 R^T, is the inverse of their
own stiffness plus that of what they leave out, condensed on the faces between both. What is left out stores a bounded multiple of
the energy that is beside it, so conjugate gradients begun with it take a bounded number of steps, whatever the mesh.

Meshes whose elements hang together in the same way, of one whose nodes were moved, may share the factor: an
element's energy changes at most by the fourth power of how much it is stretched one way more than another. With that and the
moduli's change bounding the condition k of the preconditioned matrix, conjugate gradients take

    n <= ln(2 / e) / ln((sqrt k + 1) / (sqrt k - 1))  steps to a relative error e;                  (SO.8)

where these cost more than a factor, it is made anew.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from threading import RLock

import numpy as np

from geometry.common.arrays import Floats, Ints
from geometry.tetra.tet_mesh import INCLUSION, TetMesh
from solver.linalg.cholesky import Factor
from solver.linalg.conjugate_gradients import MOST, TARGET_RESIDUAL, pattern_of
from solver.linalg.workspace import current
from solver.solid.base_states import FactorisedStates, SolidStates, factor_of, solid_states
from solver.solid.body_stiffness import Elastic, Isotropic, lame
from solver.solid.moved_mesh import stretches
from solver.solid.problem import Problem, Solid, Supports
from solver.solid.regions import Region

WORTH = 0.03  # steps that take as long as a factor, over the unknowns to the power of 2/3: so operations and bytes are
BESIDE = 1e-4  # of a modulus: smaller ones are assembled, not found as a difference from it
SOLVED = 2  # times that a factor serves: for the reference and for the scene
Materials = Mapping[int, Elastic]


@dataclass(frozen=True)
class RestrictedFactor:
    """The inverse of a larger problem's stiffness on some of its unknowns.

    Attributes:
        whole: the larger problem's factor.
        place: of each unknown among the larger problem's, shape (unknowns,).
        size: how many the larger problem has.
    """

    whole: Factor
    place: Ints
    size: int

    @classmethod
    def of(cls, factor: Factor, whole: Supports, some: Supports) -> Factor:
        """Restrict a factor of all regions to what some of them have; itself, where that is all."""
        if np.array_equal(whole.number, some.number):
            return factor
        has, place = some.number >= 0, np.empty(some.unknowns, dtype=np.int64)
        place[some.number[has]] = whole.number[has]
        return cls(factor, place, whole.unknowns)

    def solve(self, forces: Floats) -> Floats:
        """Return R K^-1 R^T forces, shape (unknowns, k)."""
        wide = np.zeros((self.size, forces.shape[1]))
        wide[self.place] = forces
        return np.asarray(self.whole.solve(wide)[self.place])


@dataclass(frozen=True)
class FactorisedRegions:
    """All regions of a mesh, the materials and nodes they had, and the factor."""

    materials: Materials
    nodes: Floats
    supports: Supports
    factor: Factor


@dataclass
class KeptFactor:
    """What meshes with the same elements share.

    Attributes:
        regions: what was factorised, or None yet.
        solid: the mesh integrated last.
        latest: the unknowns found last of each kind of states: where others start.
        lock: held while states are solved.
    """

    regions: FactorisedRegions | None = None
    solid: Solid | None = None
    latest: dict[str, Floats] = field(default_factory=dict)
    lock: RLock = field(default_factory=RLock)

    def near(self, problem: Problem, base: Materials) -> Factor:
        """Return a factor near a problem's matrix, made anew where that one would be too far away."""
        if self.regions is None or not self._serves(problem, base, self.regions):
            like = None if self.regions is None else pattern_of(self.regions.factor)
            self.regions = None  # before there is another
            whole = problem if problem.materials == base else Problem.of(problem.solid, base)
            self.regions = FactorisedRegions(base, problem.solid.nodes, whole.supports, factor_of(whole, like))
        return RestrictedFactor.of(self.regions.factor, self.regions.supports, problem.supports)

    @staticmethod
    def _serves(problem: Problem, base: Materials, regions: FactorisedRegions) -> bool:
        """Whether steps from a factor cost less than another factor; steps for the inclusions' contrast come on top of both."""
        solid = problem.solid
        stretch = 1.0
        if regions.nodes is not solid.nodes:
            lengths = stretches(solid.elements, regions.nodes, solid.nodes)
            stretch = float(lengths.max() / lengths.min())
        many = SOLVED * steps(spread(regions.materials, base) * stretch**4)
        return bool(many <= WORTH * regions.supports.unknowns ** (2 / 3))

    def start(self, kind: str, unknowns: int) -> Floats | None:
        """The unknowns found last, of this kind or another one that has as many."""
        of_kinds = (self.latest.get(kind), *self.latest.values())
        return next((v for v in of_kinds if v is not None and len(v) == unknowns), None)


@dataclass
class KeptMesh:
    """A mesh with what was found on it; scenes that differ in moduli, Poisson's ratios and loads share it.

    Attributes:
        solid: the mesh, integrated.
        shared: with other meshes of the same elements.
    """

    solid: Solid
    shared: KeptFactor
    _states: dict[str, SolidStates] = field(default_factory=dict)
    _own_factors: dict[str, Factor] = field(default_factory=dict)  # of states that the shared one was not near enough for

    def states(self, kind: str, materials: Materials, base: Materials, target: float = TARGET_RESIDUAL) -> FactorisedStates:
        """Return the states of a scene's materials: those found last, or solved from there.

        Args:
            kind: whose states they begin with, and replace.
            materials: of the regions that are there.
            base: of all regions; a factor made of others serves as long as they are near.
            target: relative residual that they are solved to.

        Raises:
            SolveError: the equations could not be solved.
            LimitReached: a factor would take more memory or time than is allowed.
        """
        own, whole = constants(materials), constants(base)
        with self.shared.lock:
            before = self._states.get(kind)
            if before is not None and before.problem.materials == own and before.residual <= MOST * target:
                factor = self._own_factors.get(kind) or self.shared.near(before.problem, whole)
                return FactorisedStates(before.problem, before.v, before.energies, factor)
            problem = self._problem(own)
            near, start = self.shared.near(problem, whole), self.shared.start(kind, problem.supports.unknowns)
            found = solid_states(problem, factor=near, start=start, target=target)
            self._states[kind], self.shared.latest[kind] = found.bare, found.v
            self._own_factors = {kind: found.factor} if found.factor is not near else {}
            return found

    def _problem(self, materials: Materials) -> Problem:
        """Assemble; only what differs from earlier states of the same regions, where that is little and not lost in what was."""
        alike = [one.problem for one in self._states.values() if set(one.problem.materials) == set(materials)]
        for other in alike:
            changed = [body for body in materials if materials[body] != other.materials[body]]
            if all(Region.of(body).body >= INCLUSION and not _lost(materials[body], other.materials[body]) for body in changed):
                return other.like(materials)
        return Problem.of(self.solid, materials, alike[0].supports if alike else None)


def kept_mesh(mesh: TetMesh, frictionless: bool) -> KeptMesh:
    """Return what the workspace keeps of a mesh, by its content.

    Raises:
        SolveError: an element is turned inside out.
    """
    elements = _digest(f"{frictionless} {mesh.half}", mesh.elements, mesh.body, mesh.beyond, mesh.layer)
    shared = current().keep((KeptFactor, elements), KeptFactor)
    nodes = _digest(elements, mesh.nodes)

    def made() -> KeptMesh:
        shared.solid = Solid.of(mesh, frictionless, like=shared.solid)
        return KeptMesh(shared.solid, shared)

    return current().keep((KeptMesh, nodes), made)


def _digest(head: str, *arrays: np.ndarray) -> str:
    digest = hashlib.sha256(head.encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def constants(materials: Materials) -> dict[int, Isotropic]:
    """Materials by their two constants alone, to be compared."""
    return {body: Isotropic(stuff.youngs_modulus, stuff.poisson_ratio) for body, stuff in materials.items()}


def steps(condition: float) -> float:
    """Steps of conjugate gradients, eq. SO.8, to the residual that they end with."""
    root = np.sqrt(max(condition, 1 + 1e-9))
    return float(np.log(2 / TARGET_RESIDUAL) / np.log((root + 1) / (root - 1)))


def spread(one: Materials, other: Materials) -> float:
    """How far the moduli of all regions moved against each other: the largest change over the least."""
    changes = [np.divide(_moduli(other[body]), _moduli(one[body])) for body in one]
    return float(np.max(changes) / np.min(changes))


def _lost(new: Elastic, old: Elastic) -> bool:
    """Whether moduli are so much smaller than others that they would be rounded away beside them."""
    return bool(np.min(np.divide(_moduli(new), _moduli(old))) < BESIDE)


def _moduli(stuff: Elastic) -> tuple[float, float]:
    """Bulk and shear modulus, between which all others lie, Pa."""
    lam, mu = lame(stuff)
    return lam + 2 * mu / 3, mu
