"""Solve the scenes of ``solid.py`` by CalculiX (``ccx``): netgen's tetrahedra with ten nodes (C3D10), mid nodes on the surfaces.

The film forces are the reactions RF of the nodes at the blocks' ends, the base moved by 1 mm. Run as a program it takes a
scene's file and a ``SolidSetting`` as JSON, and prints ratio, unknowns and seconds as JSON; ``ccx`` with its reading, assembly,
solving and writing cannot be separated. Solvers: those Debian's package has, ``SPOOLES``, ``ITERATIVE CHOLESKY``,
``ITERATIVE SCALING``.

Duration: a minute.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.peers.measured_solid import Laps, SolidAnswer
from benchmarks.peers.solid_mesh import ENDS, FLAT_TOLERANCE, MM, SolidSetting, materials, tetrahedra
from geometry import Scene, read_scene

HOW_TO_GET = "ccx not found: `apt-get install calculix-ccx` on Debian and Ubuntu, else www.calculix.de"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "CCX_NPROC_EQUATION_SOLVER": "1", "CCX_NPROC_STIFFNESS": "1", "CCX_NPROC_RESULTS": "1"}
ORDER = [0, 2, 1, 3, 5, 7, 4, 6, 9, 8]  # of CalculiX's nodes among netgen's: corners turned to the right hand, then middles


def deck(scene: Scene, mesh: Any, solver: str) -> Iterator[str]:
    """Yield the lines of the input file, lengths in mm."""
    nodes, elements = mesh.Coordinates(), mesh.Elements3D().NumPy()
    rows, bodies = elements["nodes"][:, ORDER], elements["index"]
    yield "*NODE, NSET=NALL"
    yield from (f"{k},{x:.12g},{y:.12g},{z:.12g}" for k, (x, y, z) in enumerate(nodes.tolist(), 1))
    for index in np.unique(bodies).tolist():
        chosen = np.flatnonzero(bodies == index)
        yield f"*ELEMENT, TYPE=C3D10, ELSET={mesh.GetMaterial(index)}_{index}"
        yield from (",".join(map(str, [k + 1, *row])) for k, row in zip(chosen.tolist(), rows[chosen].tolist(), strict=True))
    for name, members in _sets(scene, nodes, np.unique(rows)).items():
        yield f"*NSET, NSET={name}"
        yield from (f"{k}," for k in members.tolist())
    known = materials(scene)
    for name, body in known.items():
        yield from (f"*MATERIAL, NAME={name}", "*ELASTIC", f"{body.youngs_modulus:.12g},{body.poisson_ratio:.12g}")
    for index in np.unique(bodies).tolist():
        yield f"*SOLID SECTION, ELSET={mesh.GetMaterial(index)}_{index}, MATERIAL={mesh.GetMaterial(index)}"
    yield from ("*BOUNDARY", "bottom,1,3", "mirror,2,2", *(f"{end},1,2" for end in ENDS))
    yield from ("*STEP", f"*STATIC, SOLVER={solver}", "*BOUNDARY", *(f"{end},3,3,-1." for end in ENDS))
    for end in ENDS:
        yield from (f"*NODE PRINT, NSET={end}, TOTALS=ONLY", "RF")
    yield "*END STEP"


def _sets(scene: Scene, nodes: Any, used: Any) -> dict[str, Any]:
    """Return the numbers of the nodes that are held or moved; the mirror's without those held already."""
    x, y, z = nodes[used - 1].T
    probe, inside = scene.probe, np.hypot(x, y) < MM * (scene.probe.inner_radius + scene.probe.hole_radius) / 2
    assert scene.tissue.shape != "half-space"  # no scene here is one
    conditions = {
        "bottom": z < FLAT_TOLERANCE - MM * scene.tissue.depth,
        ENDS[0]: inside & (z > MM * probe.core_height - FLAT_TOLERANCE),
        ENDS[1]: ~inside & (z > MM * probe.tube_height - FLAT_TOLERANCE),
    }
    conditions["mirror"] = (np.abs(y) < FLAT_TOLERANCE) & ~np.any(list(conditions.values()), axis=0)
    return {name: used[mask] for name, mask in conditions.items()}


def evaluate(scene: Scene, setting: SolidSetting) -> SolidAnswer:
    """Find the ratio by one run of ``ccx``."""
    laps = Laps()
    mesh = tetrahedra(scene, setting)
    mesh.SecondOrder()
    laps.lap("mesh")
    with TemporaryDirectory() as folder:
        lines = "\n".join([*deck(scene, mesh, setting.solver or "SPOOLES"), ""])
        (Path(folder) / "probe.inp").write_text(lines, encoding="ascii")
        laps.lap("write")
        subprocess.run(["ccx", "-i", "probe"], cwd=folder, env=os.environ | ONE_THREAD, check=True, stdout=subprocess.DEVNULL)
        laps.lap("solve")
        inner, outer = (2 * force for force in reactions((Path(folder) / "probe.dat").read_text(encoding="ascii")))
    ratio = inner / scene.probe.inner_area / (outer / scene.probe.outer_area)
    unknowns = 3 * len(np.unique(mesh.Elements3D().NumPy()["nodes"][:, :10]))
    return SolidAnswer(ratio, -inner - outer, unknowns, len(mesh.Elements3D()), laps.wall, laps.process)


def reactions(text: str) -> tuple[float, float]:
    """Return the total forces along z on both ends from CalculiX's ``.dat`` file."""
    matches = re.findall(r"total force \(fx,fy,fz\) for set (\w+) .*\n\s*\S+\s+\S+\s+(\S+)", text)
    forces = {name.lower(): float(force) for name, force in matches}
    return forces[ENDS[0]], forces[ENDS[1]]


if __name__ == "__main__":
    if shutil.which("ccx") is None:
        sys.exit(HOW_TO_GET)
    print(json.dumps(vars(evaluate(read_scene(sys.argv[1]), SolidSetting(**json.loads(sys.argv[2]))))), flush=True)
    os._exit(0)
