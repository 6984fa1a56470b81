"""Press a probe at finite strain with contact by CalculiX (``ccx``): quadrilaterals of eight nodes, CAX8R.

The mesh is that of ``benchmarks/peers/calculix_mesh.py``. Contact is face to face, with a linear penalty, between the gap's walls
and between each wall and the tissue beside it. Its neo-Hookean law stores K/2 (J - 1)^2, which moves a ratio by about 0.01 %.
``ccx`` chooses its increments between the loads asked for. Lengths are in inner radii, moduli in the tissue's.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.peers.calculix_meridian import ENDS, ONE_THREAD
from benchmarks.peers.calculix_mesh import RESOLUTION, Fineness, Meridian, Mesh
from geometry import Scene
from geometry.common.arrays import Bools, Floats

PENALTY_MODULI_PER_INNER_RADIUS = 800.0  # tissue moduli per inner radius
TOP_STRIP_INNER_RADII = 0.6  # inner radii of the tissue's top that may meet the tube's wall
SECTOR_FACTOR = 180.0  # ccx turns axisymmetric elements into two degrees of a ring
PAIRS = (("strip", "inner_wall"), ("strip", "hole_wall"), ("top", "tube_wall"), ("hole_wall", "inner_wall"))
WALLS = ("inner_wall", "hole_wall")


@dataclass(frozen=True)
class PressedRows:
    """Ratio, force (tissue moduli times inner radii squared) and closest walls (inner radii) at each load, and what they cost."""

    ratio: Floats
    force: Floats
    walls: Floats
    unknowns: int
    seconds: float


def press(scene: Scene, fineness: Fineness, indentations: Sequence[float]) -> PressedRows:
    """Press to rising indentations, inner radii, in one run of ``ccx``; seconds are the processor's."""
    meridian = Meridian(scene, fineness)
    mesh = meridian.build()
    with TemporaryDirectory() as folder:
        (Path(folder) / "probe.inp").write_text("\n".join([*deck(scene, meridian, mesh, indentations), ""]), encoding="ascii")
        start = _processor()
        subprocess.run(["ccx", "-i", "probe"], cwd=folder, env=os.environ | ONE_THREAD, check=True, stdout=subprocess.DEVNULL)
        seconds, text = _processor() - start, (Path(folder) / "probe.dat").read_text(encoding="ascii")
    forces = np.stack([_forces(text, end) for end in ENDS], axis=1) * -SECTOR_FACTOR
    if len(forces) != len(indentations):
        raise ArithmeticError(f"ccx ended after {len(forces)} of {len(indentations)} loads")
    walls = np.array([_closest(mesh, *moved) for moved in zip(*(_read_displacements(text, wall) for wall in WALLS), strict=True)])
    areas = scene.probe.outer_area / scene.probe.inner_area
    return PressedRows(forces[:, 0] / forces[:, 1] * areas, forces.sum(axis=1), walls, 2 * len(mesh.nodes), seconds)


def deck(scene: Scene, meridian: Meridian, mesh: Mesh, indentations: Sequence[float]) -> Iterator[str]:
    """Yield the lines of the input file."""
    yield "*NODE, NSET=NALL"
    yield from (f"{k},{r:.15g},{z:.15g}" for k, (r, z) in enumerate(mesh.nodes.tolist(), 1))
    first, number = {}, 0
    for body, rows in mesh.elements.items():
        yield f"*ELEMENT, TYPE=CAX8R, ELSET={body}"
        yield from (",".join(map(str, [number + k, *row])) for k, row in enumerate((rows + 1).tolist(), 1))
        first[body], number = number, number + len(rows)
    for name, (body, is_member) in _lines(meridian, mesh.nodes).items():
        yield f"*SURFACE, NAME={name}, TYPE=ELEMENT"
        corners = is_member[mesh.elements[body][:, :4]]
        sides = np.argwhere(corners & np.roll(corners, -1, axis=1)).tolist()
        yield from (f"{first[body] + element + 1},S{face + 1}" for element, face in sides)
    walls = {name: np.flatnonzero(is_member) for name, (_, is_member) in _lines(meridian, mesh.nodes).items() if name in WALLS}
    for name, nodes in (mesh.sets | {f"on_{name}": nodes for name, nodes in walls.items()}).items():
        yield f"*NSET, NSET={name}"
        yield from (f"{k}," for k in (nodes + 1).tolist())
    yield from _materials(scene)
    yield from (
        "*SURFACE INTERACTION, NAME=touching",
        "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
        f"{PENALTY_MODULI_PER_INNER_RADIUS},1e-3,1e-4",
    )
    for pair in PAIRS:
        yield from ("*CONTACT PAIR, INTERACTION=touching, TYPE=SURFACE TO SURFACE", ",".join(pair))
    yield from ("*BOUNDARY", "axis,1,1", "bottom,1,2", *(f"{end},1,1" for end in ENDS))
    for depth in indentations:
        yield from _step(depth)


def _lines(meridian: Meridian, nodes: Floats) -> dict[str, tuple[str, Bools]]:
    """Lines that may touch: the body they bound, and which nodes lie on them."""
    r, z = nodes.T

    def wall(radius: float) -> Bools:
        return np.asarray((np.abs(r - radius) < RESOLUTION) & (z > -RESOLUTION))

    surface = np.abs(z) < RESOLUTION
    return {
        "inner_wall": ("inner", wall(1.0)),
        "hole_wall": ("outer", wall(meridian.hole)),
        "tube_wall": ("outer", wall(meridian.tube)),
        "strip": ("tissue", surface & (r > 1 - RESOLUTION) & (r < meridian.hole + RESOLUTION)),
        "top": ("tissue", surface & (r > meridian.tube - RESOLUTION) & (r < meridian.tube + TOP_STRIP_INNER_RADII)),
    }


def _materials(scene: Scene) -> Iterator[str]:
    bodies = {"tissue": scene.tissue, "inner": scene.probe.inner, "outer": scene.probe.outer, "inclusion": scene.inclusion[0]}
    for name, body in bodies.items():
        young, nu = body.youngs_modulus / scene.tissue.youngs_modulus, body.poisson_ratio
        shear, bulk = young / (2 * (1 + nu)), young / (3 * (1 - 2 * nu))
        yield from (f"*MATERIAL, NAME={name}", "*HYPERELASTIC, NEO HOOKE", f"{shear / 2:.12g},{2 / bulk:.12g}")
        yield f"*SOLID SECTION, ELSET={name}, MATERIAL={name}"


def _step(depth: float) -> Iterator[str]:
    yield from ("*STEP, NLGEOM, INC=1000", "*STATIC, SOLVER=SPOOLES", "0.25,1.,1e-4,0.3")
    yield from ("*BOUNDARY", *(f"{end},2,2,{-depth:.12g}" for end in ENDS))
    for end in ENDS:
        yield from (f"*NODE PRINT, NSET={end}, TOTALS=ONLY, FREQUENCY=1000", "RF")
    for wall in WALLS:
        yield from (f"*NODE PRINT, NSET=on_{wall}, FREQUENCY=1000", "U")
    yield "*END STEP"


def _forces(text: str, end: str) -> Floats:
    """Axial forces on an end, one for each load."""
    matches = re.findall(rf"total force \(fx,fy,fz\) for set {end.upper()} .*\n\s*\S+\s+(\S+)", text)
    return np.array([float(force) for force in matches])


def _read_displacements(text: str, wall: str) -> list[Floats]:
    """Nodes of a wall and their displacements, shape (n, 3), for each load."""
    blocks = re.findall(rf"displacements \(vx,vy,vz\) for set ON_{wall.upper()} .*\n\n((?:\s+\d+ .*\n)+)", text)
    return [np.array([[float(x) for x in line.split()[:3]] for line in block.split("\n") if line.strip()]) for block in blocks]


def _closest(mesh: Mesh, inner: Floats, hole: Floats) -> float:
    """Return the smallest distance of two walls at one height."""
    places = []
    for moved in (inner, hole):
        place = mesh.nodes[moved[:, 0].astype(int) - 1] + moved[:, 1:]
        places.append(place[np.argsort(place[:, 1])])
    return float(np.min(np.interp(places[0][:, 1], places[1][:, 1], places[1][:, 0]) - places[0][:, 0]))


def _processor() -> float:
    """Seconds of the processor that children took."""
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
