"""Compute reference solutions of axisymmetric scenes by NGSolve, independently of ``solver``.

The problem: linear elasticity of a cylinder of tissue bonded at its bottom, two concentric blocks, a bonded or
frictionless interface, at most one sphere on the axis (PHYSICS.md sections 5 and 7). Between each block and the base lie,
if the scene has a film, the film (its modulus) and, if it has a thickness, the adhesive (its modulus, or the film's), both
with ``FILM_POISSON``, which no scene gives, both bonded to all that they touch. A rigid base holds them, or the blocks'
ends. The elastic base (``outline``) is bonded to the machine: its upper face moves as a rigid plane, the rest
of its surface is free of traction.

The method: displacements of order 6 to 12 (no locking near incompressibility) on curved triangles that netgen grades by
the local feature size, refined geometrically (factor 1/8) towards every singular corner, the tissue's bottom edge
included. With u_1, u_2 the displacements for a jump of one unit inserted between one block and what is above it, and all
that the machine holds at rest, F_ij = a(u_i, u_j) are the film forces: their error is the square of the energy norm's.
F_i0 + F_i1 is the force on film i when the machine moves by one unit, for that is both jumps and a rigid shift. The
energies are integrals over the fields: of the matrix's rounding, which the modulus of a stiff or nearly incompressible
body multiplies, they see the square only. The value is that of the finest mesh; ``relative_uncertainty`` is the largest
change from the mesh before, coarser in size, order and corner layers at once.

Usage, after ``pip install ngsolve``: ``python -m benchmarks.references.axisymmetric SCENE.toml ...``; a folder in place of
a scene means all its scenes and writes its ``expected.json``

Duration: a minute per scene.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import ngsolve as ngs
import numpy as np

from benchmarks.references.outline import (
    ADHESIVE,
    BASE,
    ENDS,
    FILM,
    INCLUSION,
    INNER,
    LAYERS,
    NAMES,
    OUTER,
    TISSUE,
    Refinement,
    held,
    make_mesh,
)
from geometry import Material, Scene, read_scene

SENSITIVITY_FLOOR = 1e-4  # below it the error of log_sensitivity counts relative to this, see ``difference``
LADDER = (Refinement(0.9, 6, 6), Refinement(0.7, 8, 8), Refinement(0.55, 10, 10), Refinement(0.4, 12, 12))
BLOCKS, ABOVE_BLOCKS, TISSUE_PATTERN = "inner|outer", "film|adhesive|base", "tissue|layer."
SHIFTS = 3  # solutions with the inclusion's shift from the one before

Part = tuple[str, int, tuple[int, ...]]
"""Bodies, and which components their u_r and the summands of their u_z are."""
Mesher = Callable[[Scene, Refinement], ngs.Mesh]


@dataclass(frozen=True)
class ReferenceAnswer:
    """Film stresses (Pa) at the scene's load, stiffness (N/m), log-sensitivity (None without an inclusion)."""

    stress_inner: float
    stress_outer: float
    ratio: float
    stiffness: float
    log_sensitivity: float | None
    relative_uncertainty: float = math.nan
    seconds: float = 0.0


def materials(scene: Scene) -> dict[int, Material]:
    """Return the material of each body."""
    probe = scene.probe
    bodies: dict[int, Material] = {TISSUE: scene.tissue, INNER: probe.inner, OUTER: probe.outer}
    bodies |= dict(zip(LAYERS, scene.tissue.layer, strict=False))
    if scene.inclusion:
        bodies[INCLUSION] = scene.inclusion[0]
    if probe.film is not None:
        for k, layer in ((FILM, probe.film), (ADHESIVE, probe.film.bond_to_base)):
            if layer is not None and layer.youngs_modulus is not None and layer.poisson_ratio is not None:
                bodies[k] = Material(youngs_modulus=layer.youngs_modulus, poisson_ratio=layer.poisson_ratio)
    if probe.base.youngs_modulus is not None and probe.base.poisson_ratio is not None:
        bodies[BASE] = Material(youngs_modulus=probe.base.youngs_modulus, poisson_ratio=probe.base.poisson_ratio)
    return bodies


class ReferenceProblem:
    """The discrete problem on one mesh.

    Its unknowns are u_z and u_r of each region. To u_z belong two given fields: in the blocks the jump at their ends; in the
    tissue a shift at the sphere, which the inclusion lacks: there u_z counts from it, for a rigid shift has no energy.
    Near the mean displacement of a stiff inclusion, the shift leaves its modulus nothing to multiply the rounding of.
    """

    def __init__(self, scene: Scene, refinement: Refinement, mesher: Mesher = make_mesh) -> None:
        self.mesh, self.order, self.filled = mesher(scene, refinement), refinement.order, bool(scene.inclusion)
        self.fill(scene)
        regions = [".*"] if scene.contact.interface == "bonded" else [f"{TISSUE_PATTERN}|inclusion", f"{BLOCKS}|{ABOVE_BLOCKS}"]
        film_number = len(regions) + 2
        self.parts: list[Part] = [
            (TISSUE_PATTERN, 3, (0, 2)),
            ("inclusion", 3, (0,)),
            (BLOCKS, film_number, (0, 1)),
            (ABOVE_BLOCKS, film_number, (0,)),
        ]
        self.space = ngs.FESpace(self.spaces("|".join(held(scene.probe)), regions))

    def fill(self, scene: Scene) -> None:
        """Take the bodies' materials from a scene."""
        bodies = materials(scene)
        young = self.mesh.MaterialCF({NAMES[k]: body.youngs_modulus for k, body in bodies.items()})
        poisson = self.mesh.MaterialCF({NAMES[k]: body.poisson_ratio for k, body in bodies.items()})
        self.mu, self.lam = young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))

    def spaces(self, held_boundaries: str, regions: list[str]) -> list[ngs.H1]:
        """Return the spaces of u_z, jump, shift and u_r of each region."""
        domains = [self.mesh.Materials(region) for region in regions]
        given = [ngs.H1(self.mesh, order=1, definedon=self.mesh.Materials(region)) for region in (BLOCKS, TISSUE_PATTERN)]
        radial = [
            ngs.H1(self.mesh, order=self.order, dirichlet=held_boundaries + "|axis", definedon=region) for region in domains
        ]
        return [ngs.H1(self.mesh, order=self.order, dirichlet=held_boundaries), *given, *radial]

    def strain(self, components: Any, part: Part) -> tuple[Any, Any]:
        """Return (e_r, e_theta, e_z) and the engineering shear in a part."""
        _, radial, (axial, *rest_of_part) = part
        across, along = (ngs.grad(components[k]) for k in (radial, axial))
        along = sum((ngs.grad(components[k]) for k in rest_of_part), along)
        return (across[0], components[radial] / ngs.x, along[1]), across[1] + along[0]

    def energy(self, u: Any, v: Any) -> Any:
        """Return the work of the stress of strain u on strain v, per volume, times 2 pi r."""
        (e, shear_u), (f, shear_v) = u, v
        product = sum(i * j for i, j in zip(e, f, strict=True)) + shear_u * shear_v / 2
        return 2 * math.pi * ngs.x * (self.lam * sum(e) * sum(f) + 2 * self.mu * product)

    def states(self) -> list[ngs.GridFunction]:
        """Solve for the displacements under a unit jump at each block's end."""
        u, v = self.space.TnT()
        form = ngs.BilinearForm(self.space, symmetric=True, condense=True)
        for part in self.parts:
            measure = ngs.dx(definedon=self.mesh.Materials(part[0]), bonus_intorder=4)
            form += self.energy(self.strain(u, part), self.strain(v, part)) * measure
        form.Assemble()
        free = self.space.FreeDofs(coupling=True)
        for given in (1, 2):
            free[self.space.Range(given).start : self.space.Range(given).stop] = False
        inverse = form.mat.Inverse(free, "sparsecholesky")
        return [self.state(form, inverse, end) for end in ENDS]

    def state(self, form: ngs.BilinearForm, inverse: Any, end: str) -> ngs.GridFunction:
        """Solve for one jump; again with the inclusion's shift, once it is known."""
        shift, inclusion = 0.0, self.mesh.Materials("inclusion")
        for _ in range(SHIFTS if self.filled else 1):
            displacement = ngs.GridFunction(self.space)
            displacement.components[1].Set(-1.0, definedon=self.mesh.Boundaries(end))
            if self.filled:
                displacement.components[2].Set(shift, definedon=self.mesh.Boundaries("sphere"))
            for _ in range(2):  # the second pass is iterative refinement
                displacement.vec.data -= inverse * (form.mat * displacement.vec).Evaluate()
            displacement.vec.data += form.harmonic_extension * displacement.vec
            if self.filled:
                area = ngs.Integrate(1.0, self.mesh, definedon=inclusion)
                shift += ngs.Integrate(displacement.components[0], self.mesh, order=2 * self.order, definedon=inclusion) / area
        return displacement

    def work(self, states: list[ngs.GridFunction], part: Part) -> np.ndarray:
        """Return a(u_i, u_j) over a part, in N per m of displacement and per inner radius."""
        u, v = (self.strain(state.components, part) for state in states)
        densities = ngs.CoefficientFunction((self.energy(u, u), self.energy(u, v), self.energy(v, v))).Compile()
        energies = ngs.Integrate(densities, self.mesh, order=2 * self.order + 5, definedon=self.mesh.Materials(part[0]))
        return np.array([[energies[0], energies[1]], [energies[1], energies[2]]])


def film_forces(scene: Scene, refinement: Refinement, mesher: Mesher = make_mesh) -> tuple[np.ndarray, np.ndarray]:
    """Find F_ij (N per m of displacement) and dF_ij / d ln E_object on one mesh."""
    problem, unit = ReferenceProblem(scene, refinement, mesher), scene.probe.inner_radius
    states = problem.states()
    works = [problem.work(states, part) * unit for part in problem.parts]
    return np.asarray(sum(works)), works[1]


def solve(scene: Scene, refinement: Refinement, mesher: Mesher = make_mesh) -> ReferenceAnswer:
    """Find the stresses on one mesh, and what follows from them."""
    return summary(scene, *film_forces(scene, refinement, mesher))


def summary(scene: Scene, forces: np.ndarray, derivatives: np.ndarray) -> ReferenceAnswer:
    """Return stresses and the like from F_ij (N per m of base displacement) and dF_ij / d ln E_object."""
    per_metre, change = forces.sum(axis=1), derivatives.sum(axis=1)
    stiffness = float(per_metre.sum())
    indentation = scene.load.indentation if scene.load.force is None else scene.load.force / stiffness
    inner = float(per_metre[0] * indentation / scene.probe.inner_area)
    outer = float(per_metre[1] * indentation / scene.probe.outer_area)
    sensitivity = float(change[0] / per_metre[0] - change[1] / per_metre[1]) if scene.inclusion else None
    return ReferenceAnswer(inner, outer, inner / outer, stiffness, sensitivity)


def difference(a: ReferenceAnswer, b: ReferenceAnswer) -> float:
    """Return the largest relative difference; the log-sensitivity's is relative to at least ``SENSITIVITY_FLOOR``."""
    differences = [abs(getattr(a, key) / getattr(b, key) - 1) for key in ("stress_inner", "stress_outer", "ratio", "stiffness")]
    if a.log_sensitivity is not None and b.log_sensitivity is not None:
        differences.append(abs(a.log_sensitivity - b.log_sensitivity) / max(abs(b.log_sensitivity), SENSITIVITY_FLOOR))
    return float(max(differences))


def reference(scene: Scene, tolerance: float = 1e-6) -> ReferenceAnswer:
    """Climb the ladder of refinements until two in a row agree within the tolerance or the ladder ends."""
    start, coarse = time.perf_counter(), solve(scene, LADDER[0])
    for refinement in LADDER[1:]:
        fine = solve(scene, refinement)
        uncertainty = max(difference(coarse, fine), 1e-9)
        if uncertainty <= tolerance:
            break
        coarse = fine
    return replace(fine, relative_uncertainty=uncertainty, seconds=time.perf_counter() - start)


def print_reference(path: Path) -> ReferenceAnswer:
    """Find the reference of a scene file and print it as one JSON object."""
    answer = reference(read_scene(path))
    print(json.dumps({"scene": path.stem} | asdict(answer)), flush=True)
    return answer


def entry(answer: ReferenceAnswer) -> dict[str, float]:
    """Return the values as ``expected.json`` names them."""
    units = {"stress_inner": "_pa", "stress_outer": "_pa", "stiffness": "_n_per_m"}
    values = {f"{key}{units.get(key, '')}": value for key, value in asdict(answer).items() if key != "seconds"}
    return {key: value for key, value in values.items() if value is not None}


def main(paths: list[Path]) -> None:
    """Print one JSON object per scene file."""
    ngs.SetNumThreads(1)
    for path in paths:
        if path.is_dir():
            entries = {scene.stem: entry(print_reference(scene)) for scene in sorted(path.glob("*.toml"))}
            (path / "expected.json").write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")
        else:
            print_reference(path)


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
