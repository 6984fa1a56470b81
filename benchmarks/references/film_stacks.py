"""Outline and mesh a probe with a film and bonds on each block, for NGSolve; lengths in inner radii, the base rigid.

Each layer is a body of its own on its own block, and the film's margin outside its electrode another. A thin layer has
``MESH_HEIGHT`` in the mesh, so that its triangles need not be as small as it is thick: true heights are less than the mesh's,
by a factor that divides derivatives along z and multiplies volumes. Blocks on frictionless faces start ``CLEARANCE`` above the
tissue, and have a lower face of their own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import ngsolve as ngs
from netgen.meshing import MeshingParameters

from benchmarks.contact.ngsolve_pressing import ContactSetting, name_contact_line
from benchmarks.peers.ngsolve_meridian import CONTACT, corners, geometry, vertices
from benchmarks.references.outline import ENDS, INNER, OUTER, OUTSIDE, Edge, sizes, tissue
from geometry import Film, Material, Scene
from geometry.scenes.film import Bond

MESH_HEIGHT = 0.08  # of a layer in the mesh, inner radii, where it is thinner
FIRST_BODY = 16  # of the layers
CLEARANCE = 1e-4  # of blocks over the tissue in the mesh, inner radii
FACES, SOLES = ("face_inner", "face_outer"), ("sole_inner", "sole_outer")  # the tissue's and the blocks', where these may slide
SIDES = ("inner", "outer")
PARTS = ("to_block", "film", "to_base")


@dataclass(frozen=True)
class Layer:
    """One layer on one block: its true and its mesh's lower and upper height over the tissue, and its bodies by inner radius."""

    material: Material
    thickness: float
    low: float
    high: float
    columns: tuple[tuple[float, int, str], ...]


def find_layers(scene: Scene) -> list[list[Layer]]:
    """Return the layers on both blocks, from the block upwards."""
    probe, unit, number, stacks = scene.probe, scene.probe.inner_radius, FIRST_BODY - 1, list[list[Layer]]()
    assert probe.film is not None
    assert probe.base.rigid
    radii = ((0.0, 1.0), (probe.hole_radius / unit, probe.tube_radius / unit))
    for side, film, (a, b), top in zip(SIDES, probe.film.by_block, radii, (probe.core_height, probe.tube_height), strict=True):
        height, layers, inset = top / unit, list[Layer](), film.electrode_inset / unit
        for part, body in zip(PARTS, film.stack, strict=True):
            if not body.thickness:
                continue
            columns = [(a, f"{part}_{side}")]
            if part == "film" and inset:
                margin = f"margin_{side}"
                columns = [*([(a, margin)] if a else []), (a + inset if a else a, f"film_{side}"), (b - inset, margin)]
            numbered = []
            for radius, name in columns:
                number += 1
                numbered.append((radius, number, name))
            thickness = body.thickness / unit
            upper = height + max(thickness, MESH_HEIGHT)
            layers.append(Layer(convert_to_material(body), thickness, height, upper, tuple(numbered)))
            height = upper
        stacks.append(layers)
    return stacks


def convert_to_material(layer: Film | Bond) -> Material:
    """Return what a layer is made of."""
    assert layer.youngs_modulus is not None
    assert layer.poisson_ratio is not None
    return Material(youngs_modulus=layer.youngs_modulus, poisson_ratio=layer.poisson_ratio)


def draw_stacks(scene: Scene, stacks: list[list[Layer]], lift: float) -> Iterator[Edge]:
    """Yield the edges of the blocks and of what is above them, all raised by ``lift``; a raised block has a lower face too."""
    probe, unit = scene.probe, scene.probe.inner_radius
    radii = ((0.0, 1.0), (probe.hole_radius / unit, probe.tube_radius / unit))
    for block, height, (a, b), end, sole, layers in zip(
        (INNER, OUTER), (probe.core_height, probe.tube_height), radii, ENDS, SOLES, stacks, strict=True
    ):
        if lift:
            yield Edge((a, lift), (b, lift), block, OUTSIDE, sole)
        rows = [(0.0, height / unit, [(a, block)])]
        rows += [(each.low, each.high, [(r, number) for r, number, _ in each.columns]) for each in layers]
        for (low, high, columns), above in zip(rows, [*(row[2] for row in rows[1:]), [(a, OUTSIDE)]], strict=True):
            low, high = low + lift, high + lift
            for (r, body), (_, left) in zip(columns, [(a, OUTSIDE), *columns], strict=False):
                name = "axis" if r == 0 else "free" if left == OUTSIDE else "electrode"
                yield Edge((r, low), (r, high), left, body, name)
            yield Edge((b, high), (b, low), OUTSIDE, columns[-1][1])
            stops = sorted({r for r, _ in columns} | {r for r, _ in above} | {b})
            for r, next_r in pairwise(stops):
                upper, lower = (max((c for c in each if c[0] <= r), key=lambda c: c[0])[1] for each in (above, columns))
                yield Edge((r, high), (next_r, high), upper, lower, end if upper == OUTSIDE else "layer")


def draw_tissue(scene: Scene, lift: float) -> Iterator[Edge]:
    """Yield the edges of the tissue, free under raised blocks."""
    for edge in tissue(scene):
        raised = lift and edge.name == "contact"
        yield replace(edge, left=OUTSIDE, name=FACES[edge.left == OUTER]) if raised else edge


def make_stack_mesh(scene: Scene, setting: ContactSetting, corner_layers: int) -> ngs.Mesh:
    """Mesh the meridian plane, with ``corner_layers`` at the ends of films and bonds, the setting's at the blocks' corners."""
    stacks = find_layers(scene)
    lift = CLEARANCE if scene.contact.interface == "frictionless" else 0.0
    drawn = [*draw_tissue(scene, lift), *draw_stacks(scene, stacks, lift)]
    edges = [replace(edge, name=name_contact_line(edge, scene.probe)) for edge in drawn]
    lower, ends = corners(edges, (*CONTACT, *FACES, *SOLES)), corners(edges, ("layer", *ENDS))
    layers = max(corner_layers, setting.layers, 1)
    shape = geometry(edges, dict.fromkeys(vertices(edges), 1e9))
    parameters = MeshingParameters(maxh=1e9, grading=0.5 * setting.size)
    for stack in stacks:
        for each in stack:
            for _, number, name in each.columns:
                shape.SetMaterial(number, name)
    for r, z, h in sizes(edges, setting.size):
        parameters.RestrictH(r, z, 0.0, h)
    triangles = shape.GenerateMesh(mp=parameters)
    # netgen refines a point in as many of the layers as its share of them
    share = dict.fromkeys(lower, 1.01 * setting.layers / layers) | dict.fromkeys(ends, 1.01 * corner_layers / layers)
    for k, point in enumerate(triangles.Points(), 1):
        for p, singular in share.items():
            if singular and math.dist(p, (point[0], point[1])) < 1e-9:
                triangles.AddSingularity(k, singular)
    mesh = ngs.Mesh(triangles)
    mesh.RefineHP(layers)
    mesh.Curve(setting.order)
    return mesh
