"""Make ``tests/reference/gradients.json``: exact derivatives of the reference code's results, on three meshes.

Per scene and parameter x: the derivatives of ln(ratio), ln(stress_inner), ln(stress_outer), all at given indentation, and
of log_sensitivity, with respect to ln x, for a Poisson's ratio with respect to x. ``inner_radius`` and ``hole_radius``
change the gap and keep the other radii; stresses stay referred to the end areas, which change with the radii.

F_ij = a(u_i, u_j) is stationary in both states, so that its derivative is that of the form at fixed states: for moduli and
Poisson's ratios an integral over their body, for a length with nodes moved by V (harmonic between the edges)

    dF_ij = Int [ de_i : C : e_j + e_i : C : de_j + e_i : C : e_j (div V + V_r / r) ],  d grad u = -grad u grad V,
    d(u_r / r) = -(u_r / r) V_r / r

No mesh changes, so that no noise enters. The derivative of log_sensitivity is that of d ln(ratio) / d ln x by the inclusion's
ln E: central differences of three steps, extrapolated to order six. ``error``: what the last mesh, finer in size, order and
corner layers at once, or the last extrapolation changes.

Usage: ``python -m benchmarks.references.gradients FILE``

Duration: an hour.
"""

from __future__ import annotations

import json
import math
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import ngsolve as ngs
import numpy as np

from benchmarks.references.axisymmetric import LADDER, ReferenceProblem, materials
from benchmarks.references.outline import NAMES, Refinement
from geometry import Scene, read_scene

ROOT = Path(__file__).resolve().parents[2]
SCENES = (
    "examples/scene.toml",
    "tests/reference/axisymmetric/shallow.toml",
    "tests/reference/extra/soft-inner-rigid-outer-frictionless.toml",
    "tests/reference/extra/incompressible-everything-shallow.toml",
)
RESULTS = ("ratio", "stress_inner", "stress_outer", "log_sensitivity")
LOG_MODULUS_STEPS = (0.4, 0.2, 0.1)  # of the inclusion's ln E
MIN_ERROR = 1e-9

Derivatives = dict[str, np.ndarray]
"""By parameter: the derivatives of ``RESULTS``."""


def lengths(scene: Scene) -> dict[str, float]:
    """Return the scene's lengths in inner radii."""
    probe, tissue, body = scene.probe, scene.tissue, scene.inclusion[0]
    assert tissue.shape == "cylinder"
    values = {"inner_radius": probe.inner_radius, "hole_radius": probe.hole_radius, "tube_radius": probe.tube_radius}
    values |= {"inner_height": probe.core_height, "outer_height": probe.tube_height}
    values |= {"tissue_radius": tissue.radius, "tissue_depth": tissue.depth}
    values |= {"inclusion_radius": (body.diameter or 0.0) / 2, "inclusion_depth": body.depth}
    return {name: length / probe.inner_radius for name, length in values.items()}


def velocity(x: dict[str, float], name: str) -> tuple[Any, Any, bool]:
    """Return V_r and V_z on the edges per unit of a length, and whether they are meant for the sphere or for all the rest."""
    knots = [0.0, *(x[key] for key in ("inner_radius", "hole_radius", "tube_radius", "tissue_radius"))]
    above, middle = ngs.y + MIN_ERROR, (knots[1] + knots[2]) / 2
    up = ngs.IfPos(ngs.y, ngs.y, 0.0)
    if name.startswith("inclusion"):
        radius, depth = x["inclusion_radius"], x["inclusion_depth"]
        return (0.0, -1.0, True) if name == "inclusion_depth" else (ngs.x / radius, (ngs.y + depth) / radius, True)
    if name.endswith("height"):
        axial = middle - ngs.x if name == "inner_height" else ngs.x - middle
        return 0.0, ngs.IfPos(axial, up / x[name], 0.0), False
    if name == "tissue_depth":
        return 0.0, ngs.IfPos(above, 0.0, ngs.y / x[name]), False
    below = smooth(ngs.x / x[name]) if name == "tissue_radius" else 0.0
    return ngs.IfPos(above, hat(knots, x[name]), below), 0.0, False


def hat(knots: list[float], top: float) -> Any:
    """Return the function of r, even at the knots lest V be singular there, that is 1 at one of them and 0 at the others."""
    k = knots.index(top)
    height = (ngs.x - knots[k - 1]) / (top - knots[k - 1])
    if k + 1 < len(knots):
        falling = (knots[k + 1] - ngs.x) / (knots[k + 1] - top)
        height = ngs.IfPos(falling - height, height, falling)
    return smooth(ngs.IfPos(height, height, 0.0))


def smooth(t: Any) -> Any:
    """Return a cubic from 0 to 1, even at both ends."""
    return t**2 * (3 - 2 * t)


def extension(problem: ReferenceProblem, on_edges: Any, sphere: bool, names: set[str]) -> ngs.GridFunction:
    """Return the harmonic function with the given values on the sphere or on the other edges, zero on the rest of ``names``."""
    space = ngs.H1(problem.mesh, order=problem.order, dirichlet="|".join(names))
    u, v = space.TnT()
    form = ngs.BilinearForm(ngs.grad(u) * ngs.grad(v) * ngs.dx).Assemble()
    field = ngs.GridFunction(space)
    edges = "sphere" if sphere else "|".join(names - {"sphere"})
    field.Set(ngs.CoefficientFunction(on_edges), definedon=problem.mesh.Boundaries(edges))
    field.vec.data -= form.mat.Inverse(space.FreeDofs(), "sparsecholesky") * (form.mat * field.vec).Evaluate()
    return field


def fields(problem: ReferenceProblem, x: dict[str, float], name: str) -> tuple[ngs.GridFunction, ngs.GridFunction]:
    """Return the nodes' velocity for a length; the axis is an edge for V_r alone."""
    across, along, sphere = velocity(x, name)
    names = set(problem.mesh.GetBoundaries())
    return extension(problem, across, sphere, names), extension(problem, along, sphere, names - {"axis"})


def strains(problem: ReferenceProblem, state: ngs.GridFunction, part: Any, moved: Any) -> tuple[Any, Any]:
    """Return a state's strain and its derivative where the nodes move."""
    _, radial, axial = part
    u = state.components[radial]
    rows = ngs.grad(u), sum((ngs.grad(state.components[k]) for k in axial[1:]), ngs.grad(state.components[axial[0]]))
    across, along = (ngs.grad(velocity) for velocity in moved)
    change_r, change_z = ([-(row[0] * across[k] + row[1] * along[k]) for k in (0, 1)] for row in rows)
    change = (change_r[0], -u * moved[0] / ngs.x**2, change_z[1]), change_r[1] + change_z[0]
    return problem.strain(state.components, part), change


def integral(problem: ReferenceProblem, densities: list[Any], bodies: str) -> np.ndarray:
    """Integrate the densities of 00, 01 and 11 and return the row sums of the symmetric matrix."""
    compiled, order = ngs.CoefficientFunction(tuple(densities)).Compile(), 2 * problem.order + 5
    value = ngs.Integrate(compiled, problem.mesh, order=order, definedon=problem.mesh.Materials(bodies))
    return np.array([value[0] + value[1], value[1] + value[2]])


def differentiate_by_length(problem: ReferenceProblem, states: list[ngs.GridFunction], moved: tuple[Any, Any]) -> np.ndarray:
    """Return the derivative of the films' total forces by a length."""
    total, (across, along) = np.zeros(2), moved
    growth = ngs.grad(across)[0] + ngs.grad(along)[1] + across / ngs.x
    for part in problem.parts[:3]:
        (e, de), (f, df) = (strains(problem, state, part, moved) for state in states)
        pairs = [(e, de, e, de), (e, de, f, df), (f, df, f, df)]
        work = [problem.energy(c, b) + problem.energy(a, d) + problem.energy(a, b) * growth for a, c, b, d in pairs]
        total += integral(problem, work, part[0])
    return total


def differentiate_by_materials(problem: ReferenceProblem, states: list[ngs.GridFunction], scene: Scene) -> Derivatives:
    """Return the derivatives of the films' total forces by ln E and by nu of each body."""
    derivatives, lam, mu = {}, problem.lam, problem.mu
    for number, body in materials(scene).items():
        modulus, nu, name = body.youngs_modulus, body.poisson_ratio, NAMES[number]
        part = (name, *next(part for part in problem.parts if name in part[0].split("|"))[1:])
        e, f = (problem.strain(state.components, part) for state in states)
        pairs = [(e, e), (e, f), (f, f)]
        derivatives[f"{name}_youngs_modulus"] = integral(problem, [problem.energy(*pair) for pair in pairs], name)
        problem.lam = ngs.CoefficientFunction(modulus * (1 + 2 * nu**2) / ((1 + nu) * (1 - 2 * nu)) ** 2)
        problem.mu = ngs.CoefficientFunction(-modulus / (2 * (1 + nu) ** 2))
        derivatives[f"{name}_poisson_ratio"] = integral(problem, [problem.energy(*pair) for pair in pairs], name)
        problem.lam, problem.mu = lam, mu
    return derivatives


def log_areas(x: dict[str, float], name: str) -> np.ndarray:
    """Return the derivatives of ln of both end areas by the logarithm of a length."""
    outer = x["tube_radius"] ** 2 - x["hole_radius"] ** 2
    return np.array(
        [2.0 * (name == "inner_radius"), 2 * x[name] ** 2 / outer * ((name == "tube_radius") - (name == "hole_radius"))]
    )


def first_order(problem: ReferenceProblem, scene: Scene, moved: dict[str, Any]) -> Derivatives:
    """Return the derivatives of ln(ratio), ln(stress_inner) and ln(stress_outer) by every parameter."""
    problem.fill(scene)
    states, x = problem.states(), lengths(scene)
    totals = np.sum([problem.work(states, part) for part in problem.parts], axis=(0, 2))
    logs = {name: change / totals for name, change in differentiate_by_materials(problem, states, scene).items()}
    logs |= {name: x[name] * differentiate_by_length(problem, states, moved[name]) / totals - log_areas(x, name) for name in x}
    return {name: np.array([inner - outer, inner, outer]) for name, (inner, outer) in logs.items()}


def all_orders(scene: Scene, refinement: Refinement) -> tuple[Derivatives, Derivatives]:
    """Return the derivatives of all results on one mesh, and the change by the last extrapolation."""
    problem, body, x = ReferenceProblem(scene, refinement), scene.inclusion[0], lengths(scene)
    moved = {name: fields(problem, x, name) for name in x}

    def compute_stiffened(step: float) -> Derivatives:
        changed = body.model_copy(update={"youngs_modulus": body.youngs_modulus * math.exp(step)})
        other = scene.model_copy(update={"inclusion": (changed,)})
        return first_order(problem, other, moved)

    centre, around = compute_stiffened(0.0), [(compute_stiffened(h), compute_stiffened(-h), h) for h in LOG_MODULUS_STEPS]
    derivatives, change = {}, {}
    for name, slopes in centre.items():
        first = [(up[name][0] - down[name][0]) / (2 * h) for up, down, h in around]
        second = [(4 * b - a) / 3 for a, b in pairwise(first)]
        third = (16 * second[1] - second[0]) / 15
        derivatives[name], change[name] = np.array([*slopes, third]), np.array([0.0, 0.0, 0.0, abs(third - second[1])])
    return derivatives, change


def gradients(scene: Scene) -> dict[str, Any]:
    """Differentiate by every parameter; log_sensitivity on meshes one step coarser than the rest."""
    (coarse, _), (middle, change) = (all_orders(scene, refinement) for refinement in LADDER[1:3])
    problem, x = ReferenceProblem(scene, LADDER[3]), lengths(scene)
    fine = first_order(problem, scene, {name: fields(problem, x, name) for name in x})
    derivatives = {}
    for name, slopes in fine.items():
        best, previous = np.array([*slopes, middle[name][3]]), np.array([*middle[name][:3], coarse[name][3]])
        derivatives[name] = name_results(best) | {
            "error": name_results(np.maximum(np.maximum(abs(best - previous), change[name]), MIN_ERROR))
        }
    return derivatives


def name_results(values: np.ndarray) -> dict[str, Any]:
    """Return the values by the results' names."""
    return dict(zip(RESULTS, values.tolist(), strict=True))


def main(path: Path) -> None:
    """Write the file."""
    ngs.SetNumThreads(1)
    document = {}
    for scene in SCENES:
        document[scene] = gradients(read_scene(ROOT / scene))
        print(scene, file=sys.stderr, flush=True)
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
