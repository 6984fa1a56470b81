"""Solve the scenes of ``axisymmetric.py`` by NGSolve, used as its best user would.

Triangles of high order, graded to the local feature size, geometric layers at the singular corners; the inner unknowns
condensed; ``sparsecholesky``; reactions in place of stresses. Times are those of one thread. Lengths are in inner radii.
Interfaces are bonded, the base is rigid and meets the blocks, one sphere lies on the axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import ngsolve as ngs
import numpy as np
from netgen.geom2d import SplineGeometry
from netgen.meshing import MeshingParameters

from benchmarks.peers.measured import PeerAnswer, Stopwatch
from benchmarks.references.outline import ENDS, INCLUSION, INNER, NAMES, OUTER, OUTSIDE, TISSUE, Edge, outline
from geometry import Material, Scene
from geometry.common.arrays import Floats

Vertex = tuple[float, float]
HELD_BOUNDARIES = "|".join(["bottom", *ENDS])
CONTACT, ENDS_TOO, ALL_SINGULAR = ("contact",), ("contact", *ENDS), ("contact", *ENDS, "bottom")


@dataclass(frozen=True)
class MeridianSetting:
    """One discretisation.

    Attributes
    ----------
    order
        Of the polynomials.
    size
        Of an element at a vertex of the outline, over the distance to the nearest edge that does not end there.
    grading
        Netgen's, how fast elements may grow.
    layers
        Geometric layers at the singular corners.
    factor
        By which one layer is thinner than the next.
    singular
        The edges that end in corners with layers.
    smoothing
        Netgen's rounds of mesh optimisation.
    halvings
        Of all elements, before the layers.
    """

    order: int
    size: float
    grading: float
    layers: int
    factor: float = 0.125
    singular: tuple[str, ...] = CONTACT
    smoothing: int = 3
    halvings: int = 0


def make_mesh(scene: Scene, setting: MeridianSetting) -> ngs.Mesh:
    """Mesh the meridian plane."""
    edges = outline(scene)
    singular = corners(edges, setting.singular)
    sizes = {vertex: setting.size * feature(edges, vertex) for vertex in vertices(edges)}
    parameters = MeshingParameters(maxh=1e9, grading=setting.grading, optsteps2d=setting.smoothing)
    triangles = geometry(edges, sizes, singular).GenerateMesh(mp=parameters)
    for _ in range(setting.halvings):
        triangles.Refine()
    mesh = ngs.Mesh(triangles)
    if setting.layers:
        mesh.RefineHP(setting.layers, setting.factor)
    mesh.Curve(setting.order)
    return mesh


def geometry(edges: list[Edge], sizes: dict[Vertex, float], singular: set[Vertex] | None = None) -> SplineGeometry:
    """Return netgen's form of the outline, with the mesh size at each vertex."""
    shape = SplineGeometry()
    index = {p: shape.AddPoint(*p, hpref=float(p in (singular or ())), maxh=size) for p, size in sizes.items()}
    for edge in edges:
        spline: list[Any] = ["line", index[edge.start], index[edge.end]]
        if edge.centre is not None:
            radius, pole = max(edge.start[0], edge.end[0]), edge.start if edge.start[0] == 0 else edge.end
            spline = ["spline3", index[edge.start], shape.AddPoint(radius, pole[1]), index[edge.end]]
        shape.Append(spline, leftdomain=edge.left, rightdomain=edge.right, bc=edge.name)
    for number, name in NAMES.items():
        shape.SetMaterial(number, name)
    return shape


def vertices(edges: list[Edge]) -> list[Vertex]:
    """Return the vertices of the outline."""
    return list(dict.fromkeys(p for edge in edges for p in (edge.start, edge.end)))


def corners(edges: list[Edge], names: tuple[str, ...]) -> set[Vertex]:
    """Return the ends, off the axis, of the edges of these names."""
    return {p for edge in edges if edge.name in names for p in (edge.start, edge.end) if p[0] > 0}


def feature(edges: list[Edge], vertex: Vertex) -> float:
    """Return the distance to the nearest edge of the same bodies that does not end at the vertex, or the shortest that does."""
    adjacent = [edge for edge in edges if vertex in (edge.start, edge.end)]
    bodies = {body for edge in adjacent for body in (edge.left, edge.right)} - {OUTSIDE}
    neighbours = [edge for edge in edges if edge not in adjacent and bodies & {edge.left, edge.right}]
    return min([edge.distance(np.array(vertex)) for edge in neighbours] + [math.dist(edge.start, edge.end) for edge in adjacent])


def energy(u: tuple[Any, Any], v: tuple[Any, Any], mu: Any, lam: Any) -> Any:
    """Return the work of the stress of u = (u_r, u_z) on the strain of v, per area of the meridian plane."""
    (e, shear_u), (f, shear_v) = (
        ((ngs.grad(r)[0], r / ngs.x, ngs.grad(z)[1]), ngs.grad(r)[1] + ngs.grad(z)[0]) for r, z in (u, v)
    )
    product = sum(i * j for i, j in zip(e, f, strict=True)) + shear_u * shear_v / 2
    return 2 * math.pi * ngs.x * (lam * sum(e) * sum(f) + 2 * mu * product)


class NGSolveProblem:
    """Mesh, space and lifted boundary values: all that does not depend on the moduli."""

    def __init__(self, scene: Scene, mesh: ngs.Mesh, order: int) -> None:
        self.scene, self.mesh = scene, mesh
        self.space = ngs.FESpace(
            [ngs.H1(mesh, order=order, dirichlet=HELD_BOUNDARIES + "|axis"), ngs.H1(mesh, order=order, dirichlet=HELD_BOUNDARIES)]
        )
        self.free = self.space.FreeDofs(coupling=True)
        self.unknowns = int(self.free.NumSet())
        self.lifts = [self._lift(end) for end in ENDS]

    def _lift(self, end: str) -> Any:
        lift = ngs.GridFunction(self.space)
        lift.components[1].Set(-1.0, definedon=self.mesh.Boundaries(end))
        return lift.vec

    def form(self, modulus: float | None = None, bodies: tuple[int, ...] = (TISSUE, INCLUSION, INNER, OUTER)) -> ngs.BilinearForm:
        """Assemble the stiffness of some bodies, condensed, with the inclusion's own or another modulus."""
        known = {TISSUE: self.scene.tissue, INNER: self.scene.probe.inner, OUTER: self.scene.probe.outer}
        materials: dict[int, Material] = known | {INCLUSION: self.scene.inclusion[0]}
        young = {body: material.youngs_modulus for body, material in materials.items()}
        young[INCLUSION] = young[INCLUSION] if modulus is None else modulus
        nu = {body: material.poisson_ratio for body, material in materials.items()}
        mu = self.mesh.MaterialCF({NAMES[b]: young[b] / (2 * (1 + nu[b])) for b in bodies})
        lam = self.mesh.MaterialCF({NAMES[b]: young[b] * nu[b] / ((1 + nu[b]) * (1 - 2 * nu[b])) for b in bodies})
        u, v = self.space.TnT()
        region = self.mesh.Materials("|".join(NAMES[b] for b in bodies))
        form = ngs.BilinearForm(self.space, symmetric=True, condense=True)
        form += energy(u, v, mu, lam) * ngs.dx(definedon=region, bonus_intorder=2)
        return form.Assemble()

    def solve(self, matrix: Any, inverse: Any, lift: Any) -> Any:
        """Return the condensed unknowns for given boundary values."""
        solution = lift.CreateVector()
        solution.data = lift - inverse * (matrix * lift).Evaluate()
        return solution

    def ratio(self, forces: Floats) -> float:
        """Return the ratio of the mean stresses of two film forces."""
        probe = self.scene.probe
        return float(forces[0] / probe.inner_area / (forces[1] / probe.outer_area))


def evaluate(scene: Scene, setting: MeridianSetting) -> PeerAnswer:
    """Find the ratio: one mesh, one factorisation, one solve."""
    watch = Stopwatch()
    mesh = make_mesh(scene, setting)
    watch.lap("mesh")
    problem = NGSolveProblem(scene, mesh, setting.order)
    watch.lap("space")
    matrix = problem.form().mat
    watch.lap("assemble")
    inverse = matrix.Inverse(problem.free, "sparsecholesky")
    watch.lap("factorise")
    pressed = problem.lifts[0].CreateVector()
    pressed.data = problem.lifts[0] + problem.lifts[1]
    reaction = (matrix * problem.solve(matrix, inverse, pressed)).Evaluate()
    forces = np.array([ngs.InnerProduct(reaction, lift) for lift in problem.lifts])
    watch.lap("solve")
    return PeerAnswer(problem.ratio(forces), problem.unknowns, watch.stages)
