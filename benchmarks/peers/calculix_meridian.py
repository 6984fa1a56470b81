"""Solve the scenes of ``axisymmetric.py`` by CalculiX (``ccx``): quadrilaterals of eight nodes, CAX8 or CAX8R.

``ccx`` reads the mesh from a file; the film forces are the reactions RF of the nodes at the blocks' ends, the base moved by
one inner radius. One thread. Times: mesh; writing the file; ``ccx`` with its reading, assembly, SPOOLES and writing, which
cannot be separated.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.peers.calculix_mesh import Fineness, Meridian, Mesh
from benchmarks.peers.measured import PeerAnswer, Stopwatch
from geometry import Material, Scene

HOW_TO_GET = "ccx not found: `apt-get install calculix-ccx` on Debian and Ubuntu, else www.calculix.de"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "CCX_NPROC_EQUATION_SOLVER": "1", "CCX_NPROC_STIFFNESS": "1", "CCX_NPROC_RESULTS": "1"}
REFINEMENTS = (Fineness(0.2, 1.5, 0.5), Fineness(0.1, 0.7, 0.25), Fineness(0.03, 0.35, 0.125))
ELEMENTS = ("CAX8", "CAX8R")
ENDS = ("end_inner", "end_outer")


def is_installed() -> bool:
    """Whether ``ccx`` is on the path."""
    return shutil.which("ccx") is not None


def deck(scene: Scene, mesh: Mesh, element: str) -> Iterator[str]:
    """Yield the lines of the input file."""
    yield "*NODE, NSET=NALL"
    yield from (f"{k},{r:.15g},{z:.15g}" for k, (r, z) in enumerate(mesh.nodes.tolist(), 1))
    number = 0
    for body, rows in mesh.elements.items():
        yield f"*ELEMENT, TYPE={element}, ELSET={body}"
        yield from (",".join(map(str, [number + k, *row])) for k, row in enumerate((rows + 1).tolist(), 1))
        number += len(rows)
    for name, nodes in mesh.sets.items():
        yield f"*NSET, NSET={name}"
        yield from (f"{k}," for k in (nodes + 1).tolist())
    yield from _materials(scene)
    yield from ("*BOUNDARY", "axis,1,1", "bottom,1,2", *(f"{end},1,1" for end in ENDS))
    yield from ("*STEP", "*STATIC, SOLVER=SPOOLES", "*BOUNDARY", *(f"{end},2,2,-1." for end in ENDS))
    for end in ENDS:
        yield from (f"*NODE PRINT, NSET={end}, TOTALS=ONLY", "RF")
    yield "*END STEP"


def _materials(scene: Scene) -> Iterator[str]:
    bodies: dict[str, Material] = {"tissue": scene.tissue, "inner": scene.probe.inner, "outer": scene.probe.outer}
    for name, body in (bodies | {"inclusion": scene.inclusion[0]}).items():
        yield from (f"*MATERIAL, NAME={name}", "*ELASTIC", f"{body.youngs_modulus:.12g},{body.poisson_ratio:.12g}")
        yield f"*SOLID SECTION, ELSET={name}, MATERIAL={name}"


def evaluate(scene: Scene, fineness: Fineness, element: str = "CAX8R") -> PeerAnswer:
    """Find the ratio by one run of ``ccx``."""
    watch = Stopwatch()
    mesh = Meridian(scene, fineness).build()
    watch.lap("mesh")
    with TemporaryDirectory() as folder:
        (Path(folder) / "probe.inp").write_text("\n".join([*deck(scene, mesh, element), ""]), encoding="ascii")
        watch.lap("write")
        command = ["ccx", "-i", "probe"]
        subprocess.run(command, cwd=folder, env=os.environ | ONE_THREAD, check=True, stdout=subprocess.DEVNULL)
        watch.lap("ccx")
        inner, outer = reactions((Path(folder) / "probe.dat").read_text(encoding="ascii"))
    probe = scene.probe
    return PeerAnswer(inner / probe.inner_area / (outer / probe.outer_area), 2 * len(mesh.nodes), watch.stages)


def reactions(text: str) -> tuple[float, float]:
    """Return the total axial forces on both ends from CalculiX's ``.dat`` file."""
    matches = re.findall(r"total force \(fx,fy,fz\) for set (\w+) .*\n\s*\S+\s+(\S+)", text)
    forces = {name.lower(): float(force) for name, force in matches}
    return forces[ENDS[0]], forces[ENDS[1]]
