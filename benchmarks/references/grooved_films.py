"""Compute charges of films in three dimensions by NGSolve, layers meshed as prisms, independently of ``solver``.

For tumours on and off the axis and grooves, with the outer film whole or cut above the groove, it prints the charge per force
(pC/N) of both films, with d31 along x and along y. Half of the probe, y > 0, is meshed; the charge is the integral of the film's
stress over its volume. Both bases move down by one unit. On the axis, where ``axisymmetric`` gives -124.96 and -85.62 pC/N on
tape, order 3 gives -126.09 and -85.77: quotients of two cases are more accurate.

Usage: ``python -m benchmarks.references.grooved_films [CASE ...]``

Duration: minutes per case.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import ngsolve as ngs
from netgen.meshing import IdentificationType
from netgen.occ import Box, Cylinder, Glue, OCCGeometry, Pnt, Sphere, Z

INNER, HOLE, OUTER, HEIGHT = 4.0, 4.1, 6.0, 3.0  # mm: radii and height of the blocks
TISSUE_RADIUS, TISSUE_DEPTH, TUMOUR_RADIUS, TUMOUR_DEPTH = 20.0, 16.0, 2.5, 6.0  # mm
FILM, TAPE = ("film", 0.11), ("tape", 0.05)  # layers and their thickness, mm
MATERIALS = {
    "inner": (1.0, 0.48),
    "outer": (0.08, 0.48),
    "tissue": (0.006, 0.45),
    "tumour": (0.06, 0.45),
    "film": (2500.0, 0.34),
}  # Young's modulus, MPa, and Poisson's ratio
D31, D32, D33 = 20.0, 2.0, -20.0  # pC/N
GROOVE_WIDTH, GROOVE_DEPTH = 2.0, 1.0  # mm
EDGE_SIZE, BLOCK_SIZE, TISSUE_SIZE, ORDER = 0.35, 1.0, 5.0, 3  # of elements, mm, and their polynomial order
FAR = 500.0  # mm
TOLERANCE = 1e-6  # mm


@dataclass(frozen=True)
class Case:
    """Layers from block to base, the tumour's distance from the axis, mm, a groove, whether it cuts the outer film, the tape."""

    layers: tuple[tuple[str, float], ...]
    offset: float = 3.0
    groove: bool = False
    cut: bool = False
    tape: tuple[float, float] = (1.0, 0.45)


CASES = {
    "tape, on the axis": Case((FILM, TAPE), offset=0.0),
    "tape": Case((FILM, TAPE)),
    "tape, groove, film whole": Case((FILM, TAPE), groove=True),
    "tape, groove, film cut": Case((FILM, TAPE), groove=True, cut=True),
    "two tapes, groove, film cut": Case((TAPE, FILM, TAPE), groove=True, cut=True, tape=(0.4, 0.49)),
    "rigid, on the axis": Case((FILM,), offset=0.0),
    "rigid, groove, film whole": Case((FILM,), groove=True),
    "rigid, groove, film cut": Case((FILM,), groove=True, cut=True),
}


def list_bodies(case: Case) -> Iterator[tuple[str, Any]]:
    """Yield the name and the shape of each body; layers are named after the layer and the block."""

    def cut(shape: Any, bottom: float) -> Any:
        """Cut the groove out of a shape, from a height upwards."""
        return shape - Box(Pnt(0, -GROOVE_WIDTH / 2, bottom), Pnt(FAR, GROOVE_WIDTH / 2, FAR))

    tube = Cylinder((0, 0, 0), Z, OUTER, HEIGHT) - Cylinder((0, 0, 0), Z, HOLE, HEIGHT)
    yield "inner", Cylinder((0, 0, 0), Z, INNER, HEIGHT)
    yield "outer", cut(tube, HEIGHT - GROOVE_DEPTH) if case.groove else tube
    level = HEIGHT
    for name, thickness in case.layers:
        yield f"{name}_inner", Cylinder((0, 0, level), Z, INNER, thickness)
        ring = Cylinder((0, 0, level), Z, OUTER, thickness) - Cylinder((0, 0, level), Z, HOLE, thickness)
        yield f"{name}_outer", cut(ring, level - thickness) if case.cut else ring
        level += thickness
    tumour = Sphere(Pnt(case.offset, 0, -TUMOUR_DEPTH), TUMOUR_RADIUS)
    yield "tissue", Cylinder((0, 0, -TISSUE_DEPTH), Z, TISSUE_RADIUS, TISSUE_DEPTH) - tumour
    yield "tumour", tumour


def make_mesh(case: Case) -> ngs.Mesh:
    """Mesh half of a case, with prisms in the layers."""
    pieces = []
    for name, body in list_bodies(case):
        for piece in (body * Box(Pnt(-FAR, 0, -FAR), Pnt(FAR, FAR, FAR))).solids:
            piece.mat(name)
            piece.maxh = TISSUE_SIZE if name == "tissue" else BLOCK_SIZE
            pieces.append(piece)
    shape = Glue(pieces)
    levels = [HEIGHT]
    for _, thickness in case.layers:
        levels.append(levels[-1] + thickness)
    flat: dict[tuple[bool, int], list[Any]] = {}
    for face in shape.faces:
        low, high = face.bounding_box
        if abs(low.z - levels[-1]) < TOLERANCE:
            face.name = "top"
        elif abs(high.z + TISSUE_DEPTH) < TOLERANCE:
            face.name = "bottom"
        elif high.y < TOLERANCE:
            face.name = "mirror"
        for k, level in enumerate(levels):
            if max(abs(low.z - level), abs(high.z - level)) < TOLERANCE:
                is_inner = max(abs(low.x), abs(high.x)) < INNER + TOLERANCE
                flat.setdefault((is_inner, k), []).append(face)
    for edge in shape.edges:
        low, high = edge.bounding_box
        if low.z > -TOLERANCE and max(abs(low.x), abs(high.x)) < OUTER + TOLERANCE and high.z - low.z < TOLERANCE:
            edge.maxh = EDGE_SIZE
    for (is_inner, k), faces in flat.items():
        for face in faces:
            above = flat.get((is_inner, k + 1), [])
            if above:
                twin = min(above, key=lambda other: abs(other.center.x - face.center.x) + abs(other.center.y - face.center.y))
                face.Identify(twin, f"layer {k} {is_inner}", IdentificationType.CLOSESURFACES)
    mesh = ngs.Mesh(OCCGeometry(shape).GenerateMesh(maxh=TISSUE_SIZE, grading=0.4))
    mesh.Curve(ORDER)
    return mesh


def compute_charges(case: Case) -> dict[str, tuple[float, float]]:
    """Return each film's charge per force, pC/N, with d31 along x and with d31 along y."""
    mesh = make_mesh(case)
    space = ngs.VectorH1(mesh, order=ORDER, dirichlet="top|bottom", dirichlety="top|bottom|mirror")
    materials = MATERIALS | {"tape": case.tape}
    laws = {name: materials[name.split("_")[0]] for name in mesh.GetMaterials()}
    mu = mesh.MaterialCF({name: e / (2 * (1 + nu)) for name, (e, nu) in laws.items()})
    lam = mesh.MaterialCF({name: e * nu / ((1 + nu) * (1 - 2 * nu)) for name, (e, nu) in laws.items()})

    def strain(u: Any) -> Any:
        return (ngs.Grad(u) + ngs.Grad(u).trans) / 2

    def stress(u: Any) -> Any:
        return 2 * mu * strain(u) + lam * ngs.Trace(strain(u)) * ngs.Id(3)

    u, v = space.TnT()
    form = ngs.BilinearForm(space, symmetric=True, condense=True)
    form += ngs.InnerProduct(stress(u), strain(v)) * ngs.dx
    form.Assemble()
    state = ngs.GridFunction(space)
    state.Set(ngs.CF((0, 0, -1)), definedon=mesh.Boundaries("top"))
    loads = state.vec.CreateVector()
    loads.data = -form.mat * state.vec
    state.vec.data += form.mat.Inverse(space.FreeDofs(True), inverse="sparsecholesky") * loads
    state.vec.data += form.harmonic_extension * state.vec
    charges = {}
    for block in ("inner", "outer"):
        film = ngs.dx(definedon=mesh.Materials(f"film_{block}"))
        x, y, z = (ngs.Integrate(stress(state)[k, k] * film, mesh) for k in range(3))
        along, across = ((d1 * x + d2 * y + D33 * z) / z for d1, d2 in ((D31, D32), (D32, D31)))
        charges[block] = (along, across)
    return charges


def main() -> None:
    for name in sys.argv[1:] or CASES:
        with ngs.TaskManager():
            print(name, compute_charges(CASES[name]), flush=True)


if __name__ == "__main__":
    main()
