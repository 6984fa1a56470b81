"""Reference solutions of axisymmetric scenes by NGSolve, independent of ``solver``.

The problem: linear elasticity of a cylinder of tissue bonded at its bottom, two concentric blocks under a rigid base,
a bonded or frictionless interface, at most one sphere on the axis (PHYSICS.md sections 5 and 7).

The method: displacements of order 6 to 12 (no locking near incompressibility) on curved triangles that netgen grades by
the local feature size, refined geometrically (factor 1/8) towards every singular corner, the tissue's bottom edge
included. With u_1, u_2 the displacements for the base of one block moved down by one unit and the other held,
F_ij = a(u_i, u_j) are the film forces: their error is the square of the energy norm's. The value is that of the finest
mesh; ``relative_uncertainty`` is the largest change from the mesh before, coarser in size, order and corner layers at once.

Usage, after ``pip install ngsolve``: ``python benchmarks/reference_axisymmetric.py SCENE.toml ...``
"""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import ngsolve as ngs
import numpy as np
from netgen.geom2d import SplineGeometry
from netgen.meshing import MeshingParameters

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from geometry import Material, Scene, read_scene

OUTSIDE, TISSUE, INCLUSION, INNER, OUTER = range(5)
NAMES = {TISSUE: "tissue", INCLUSION: "inclusion", INNER: "inner", OUTER: "outer"}
BASES = ("base_inner", "base_outer")
SENSITIVITY_FLOOR = 1e-4  # below it the error of log_sensitivity counts relative to this, see ``difference``


@dataclass(frozen=True)
class Refinement:
    """One mesh: element size over local feature size, polynomial order, geometric layers at the corners."""

    size: float
    order: int
    layers: int


LADDER = (Refinement(0.9, 6, 6), Refinement(0.7, 8, 8), Refinement(0.55, 10, 10), Refinement(0.4, 12, 12))


@dataclass(frozen=True)
class Reference:
    """Film stresses (Pa) at the scene's load, stiffness (N/m), log-sensitivity (None without an inclusion)."""

    stress_inner: float
    stress_outer: float
    ratio: float
    stiffness: float
    log_sensitivity: float | None
    relative_uncertainty: float = math.nan
    seconds: float = 0.0


@dataclass(frozen=True)
class Edge:
    """A straight edge or, with ``centre``, a quarter circle about a point on the axis; lengths in inner radii."""

    start: tuple[float, float]
    end: tuple[float, float]
    left: int
    right: int
    name: str = "free"
    centre: float | None = None

    def point(self, t: float) -> np.ndarray:
        """Return the point at parameter 0 <= t <= 1."""
        a, b = np.array(self.start), np.array(self.end)
        if self.centre is None:
            return np.asarray(a + t * (b - a))
        c, angle = np.array([0.0, self.centre]), t * math.pi / 2
        return np.asarray(c + math.cos(angle) * (a - c) + math.sin(angle) * (b - c))

    def distance(self, p: np.ndarray) -> float:
        """Distance of a point with r >= 0 from the edge."""
        a, b = np.array(self.start), np.array(self.end)
        if self.centre is not None:
            if (p[1] > self.centre) != (a[1] + b[1] > 2 * self.centre):  # beside the other quarter: an end is nearest
                return min(math.dist(p, a), math.dist(p, b))
            return float(abs(math.hypot(p[0], p[1] - self.centre) - max(a[0], b[0])))
        t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        return float(np.hypot(*(p - a - t * (b - a))))


def outline(scene: Scene) -> list[Edge]:
    """Return the meridian plane's edges: r >= 0, tissue below z = 0, lengths in units of the inner radius."""
    probe, tissue, unit = scene.probe, scene.tissue, scene.probe.inner_radius
    off_axis = len(scene.inclusion) > 1 or any(body.x or body.y or body.diameter is None for body in scene.inclusion)
    if off_axis or tissue.shape != "cylinder" or not probe.base.rigid or scene.contact.interface == "unilateral":
        raise ValueError("the reference takes tissue in a cylinder, one sphere on the axis, a rigid base, no lift-off")
    r1, r2, r3, rt = 1.0, probe.hole_radius / unit, probe.tube_radius / unit, tissue.radius / unit
    bottom, h1, h2 = -tissue.depth / unit, probe.core_height / unit, probe.tube_height / unit
    edges = [
        Edge((0, 0), (r1, 0), INNER, TISSUE, "contact"),
        Edge((r1, 0), (r2, 0), OUTSIDE, TISSUE),
        Edge((r2, 0), (r3, 0), OUTER, TISSUE, "contact"),
        Edge((r3, 0), (rt, 0), OUTSIDE, TISSUE),
        Edge((rt, 0), (rt, bottom), OUTSIDE, TISSUE),
        Edge((rt, bottom), (0, bottom), OUTSIDE, TISSUE, "bottom"),
        Edge((0, 0), (0, h1), OUTSIDE, INNER, "axis"),
        Edge((0, h1), (r1, h1), OUTSIDE, INNER, BASES[0]),
        Edge((r1, h1), (r1, 0), OUTSIDE, INNER),
        Edge((r2, 0), (r2, h2), OUTSIDE, OUTER),
        Edge((r2, h2), (r3, h2), OUTSIDE, OUTER, BASES[1]),
        Edge((r3, h2), (r3, 0), OUTSIDE, OUTER),
    ]
    if not scene.inclusion:
        return [*edges, Edge((0, bottom), (0, 0), OUTSIDE, TISSUE, "axis")]
    radius, centre = scene.inclusion[0].diameter / 2 / unit, -scene.inclusion[0].depth / unit  # type: ignore[operator]
    south, east, north = (0, centre - radius), (radius, centre), (0, centre + radius)
    return [
        *edges,
        Edge((0, bottom), south, OUTSIDE, TISSUE, "axis"),
        Edge(south, north, OUTSIDE, INCLUSION, "axis"),
        Edge(north, (0, 0), OUTSIDE, TISSUE, "axis"),
        Edge(south, east, INCLUSION, TISSUE, "sphere", centre),
        Edge(east, north, INCLUSION, TISSUE, "sphere", centre),
    ]


def sizes(edges: list[Edge], size: float) -> list[tuple[float, float, float]]:
    """Return mesh sizes (r, z, h) along the edges: ``size`` times the distance to the next edge of the same body."""
    found: list[tuple[float, float, float]] = []
    for edge in edges:
        t, bodies, length = 0.0, {edge.left, edge.right} - {OUTSIDE}, math.dist(edge.start, edge.end)
        others = [o for o in edges if bodies & {o.left, o.right} and not {edge.start, edge.end} & {o.start, o.end}]
        while t < 1.0:
            for s in (t, 1.0 - t):  # from both ends, for an end may have the smaller features
                p = edge.point(s)
                found.append((float(p[0]), float(p[1]), size * min([0.5 * length, *(o.distance(p) for o in others)])))
            t += 0.3 * min(found[-1][2], found[-2][2]) / length
    return found


def make_mesh(scene: Scene, refinement: Refinement) -> ngs.Mesh:
    """Build the graded, curved mesh with geometric layers at every corner of the blocks and of the tissue's bottom."""
    edges = outline(scene)
    geometry = SplineGeometry()
    singular = {p for edge in edges if edge.name in {"contact", "bottom", *BASES} for p in (edge.start, edge.end) if p[0] > 0}
    index = {p: geometry.AddPoint(*p, hpref=float(p in singular)) for p in {edge.start: 0 for edge in edges}}
    for edge in edges:
        shape: list[Any] = ["line", index[edge.start], index[edge.end]]
        if edge.centre is not None:
            radius, pole = max(edge.start[0], edge.end[0]), edge.start if edge.start[0] == 0 else edge.end
            shape = ["spline3", index[edge.start], geometry.AddPoint(radius, pole[1]), index[edge.end]]
        geometry.Append(shape, leftdomain=edge.left, rightdomain=edge.right, bc=edge.name)
    for number, name in NAMES.items():
        geometry.SetMaterial(number, name)
    parameters = MeshingParameters(maxh=1e9, grading=0.5 * refinement.size)
    for r, z, h in sizes(edges, refinement.size):
        parameters.RestrictH(r, z, 0.0, h)
    mesh = ngs.Mesh(geometry.GenerateMesh(mp=parameters))
    mesh.RefineHP(refinement.layers)
    mesh.Curve(refinement.order)
    return mesh


def solve(scene: Scene, refinement: Refinement) -> Reference:
    """Find the film forces of both base states on one mesh, and what follows from them."""
    mesh, p = make_mesh(scene, refinement), refinement.order
    bodies: dict[int, Material] = {TISSUE: scene.tissue, INNER: scene.probe.inner, OUTER: scene.probe.outer}
    if scene.inclusion:
        bodies[INCLUSION] = scene.inclusion[0]
    young = mesh.MaterialCF({NAMES[k]: body.youngs_modulus for k, body in bodies.items()})
    poisson = mesh.MaterialCF({NAMES[k]: body.poisson_ratio for k, body in bodies.items()})
    mu, lam = young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))

    def energy(ur: Any, uz: Any, vr: Any, vz: Any) -> Any:
        """Return the work of the stress of u on the strain of v, per volume, times 2 pi r."""
        (e, shear_u), (f, shear_v) = (
            ((ngs.grad(a)[0], a / ngs.x, ngs.grad(b)[1]), ngs.grad(a)[1] + ngs.grad(b)[0]) for a, b in ((ur, uz), (vr, vz))
        )
        product = sum(i * j for i, j in zip(e, f, strict=True)) + shear_u * shear_v / 2
        return 2 * math.pi * ngs.x * (lam * sum(e) * sum(f) + 2 * mu * product)

    held = "|".join(["bottom", *BASES])
    regions = [".*"] if scene.contact.interface == "bonded" else ["tissue|inclusion", "inner|outer"]
    spaces = [ngs.H1(mesh, order=p, dirichlet=held)]
    spaces += [ngs.H1(mesh, order=p, dirichlet=held + "|axis", definedon=mesh.Materials(region)) for region in regions]
    space = ngs.FESpace(spaces)
    (uz, *ur), (vz, *vr) = space.TnT()
    form = ngs.BilinearForm(space, symmetric=True, condense=True)
    for region, u, v in zip(regions, ur, vr, strict=True):
        form += energy(u, uz, v, vz) * ngs.dx(definedon=mesh.Materials(region), bonus_intorder=4)
    form.Assemble()
    inverse = form.mat.Inverse(space.FreeDofs(coupling=True), "sparsecholesky")
    states = [ngs.GridFunction(space) for _ in BASES]
    for base, state in zip(BASES, states, strict=True):
        state.components[0].Set(-1.0, definedon=mesh.Boundaries(base))
        for _ in range(2):  # the second pass is iterative refinement
            state.vec.data -= inverse * (form.mat * state.vec).Evaluate()
    forces = np.array([[ngs.InnerProduct(form.mat * i.vec, j.vec) for j in states] for i in states])
    slopes = np.zeros((2, 2))
    if scene.inclusion:
        for state in states:
            state.vec.data += form.harmonic_extension * state.vec
        where, fields = ngs.dx("inclusion", bonus_intorder=2 * p), [state.components[1::-1] for state in states]
        slopes = np.array([[ngs.Integrate(energy(*i, *j) * where, mesh) for j in fields] for i in fields])
    return summary(scene, forces * scene.probe.inner_radius, slopes * scene.probe.inner_radius)


def summary(scene: Scene, forces: np.ndarray, slopes: np.ndarray) -> Reference:
    """Return stresses and the like from F_ij (N per m of base displacement) and dF_ij / d ln E_object."""
    per_metre, change = forces.sum(axis=1), slopes.sum(axis=1)
    stiffness = float(per_metre.sum())
    indentation = scene.load.indentation if scene.load.force is None else scene.load.force / stiffness
    inner = float(per_metre[0] * indentation / scene.probe.inner_area)
    outer = float(per_metre[1] * indentation / scene.probe.outer_area)
    sensitivity = float(change[0] / per_metre[0] - change[1] / per_metre[1]) if scene.inclusion else None
    return Reference(inner, outer, inner / outer, stiffness, sensitivity)


def difference(a: Reference, b: Reference) -> float:
    """Return the largest relative difference; the log-sensitivity's is relative to at least ``SENSITIVITY_FLOOR``."""
    found = [abs(getattr(a, key) / getattr(b, key) - 1) for key in ("stress_inner", "stress_outer", "ratio", "stiffness")]
    if a.log_sensitivity is not None and b.log_sensitivity is not None:
        found.append(abs(a.log_sensitivity - b.log_sensitivity) / max(abs(b.log_sensitivity), SENSITIVITY_FLOOR))
    return float(max(found))


def reference(scene: Scene, tolerance: float = 1e-6) -> Reference:
    """Climb the ladder of refinements until two in a row agree within the tolerance or the ladder ends."""
    start, coarse = time.perf_counter(), solve(scene, LADDER[0])
    for refinement in LADDER[1:]:
        fine = solve(scene, refinement)
        uncertainty = max(difference(coarse, fine), 1e-9)
        if uncertainty <= tolerance:
            break
        coarse = fine
    return replace(fine, relative_uncertainty=uncertainty, seconds=time.perf_counter() - start)


def main(paths: list[str]) -> None:
    """Print one JSON object per scene file."""
    ngs.SetNumThreads(1)
    for path in paths:
        print(json.dumps({"scene": Path(path).stem} | asdict(reference(read_scene(Path(path))))), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
