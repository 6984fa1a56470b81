"""Where eq. CF.10 of ``solver/closed_form/block_compliance.py`` comes from.

Usage: ``python -m benchmarks.closed_form.blocks [--scenes N] [--seed K]``.

Random blocks on ground a million times stiffer, by ``axisymmetric``: by how much the Ritz functions are too stiff, and the fit of

    (2 nu)^power / (tall h/w (w/radius)^(3/2) + constant + flat w/h)

to it for discs and tubes, bonded and frictionless, with what is left.

Duration: minutes.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from scipy.optimize import least_squares

import solver.closed_form.block_compliance as blocks
from geometry import Contact, CylinderTissue, InputError, Load, Material, Probe, Scene
from geometry.common.arrays import Floats
from solver import evaluate
from solver.closed_form.contact import Tissue, solve_contact
from solver.closed_form.tractions import ElasticBlocks

GROUND_MODULUS_PA = 1e10  # Pa, under blocks of 1 kPa


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=150)
    parser.add_argument("--seed", type=int, default=7)
    options = parser.parse_args()
    blocks._correct_modulus = lambda block, bonded: block.E  # without the correction that is looked for
    rng = np.random.default_rng(options.seed)
    rows = np.array([row for _ in range(options.scenes) for row in compare_blocks(rng)])
    for solid in (True, False):
        for bonded in (True, False):
            name = f"{'disc' if solid else 'tube'}, {'bonded' if bonded else 'frictionless'}"
            fit(name, rows[(rows[:, 0] == solid) & (rows[:, 1] == bonded)])


def compare_blocks(rng: np.random.Generator) -> list[tuple[float, ...]]:
    """Return (solid, bonded, height/width, width/radius, nu, surplus of stiffness) of both blocks of one random probe."""
    wall, *heights = np.exp(rng.uniform(np.log([0.03, 0.03, 0.03]), np.log([8, 15, 15])))
    nu = [float(rng.choice([rng.uniform(0, 0.49), 0.45, 0.48, 0.49, 0.499, 0.4999])) for _ in range(2)]
    bonded, inner, hole = bool(rng.random() < 0.6), 1e-3, 1.02e-3
    sizes = [(inner, inner), (wall * inner, hole + wall * inner)]
    tall = [heights[0] * inner, heights[1] * wall * inner]
    try:
        scene = _scene(sizes[1][1], tall, nu, bonded)
        exact = evaluate(scene, "axisymmetric", 0.001)
    except InputError:
        return []
    unit = np.ones(1)
    made = (
        ElasticBlocks(None, inner * unit, tall[0] * unit, 1e3 * unit, nu[0] * unit),
        ElasticBlocks(hole * unit, sizes[1][1] * unit, tall[1] * unit, 1e3 * unit, nu[1] * unit),
    )
    forces = np.diag(
        solve_contact(made, Tissue(None, GROUND_MODULUS_PA * unit, 0 * unit), [], target=None, bonded=bonded, nodes=16).forces[0]
    )
    stresses = [(exact.stress_inner or 0.0) * scene.probe.inner_area, (exact.stress_outer or 0.0) * scene.probe.outer_area]
    surplus = forces * 1e-6 / stresses - 1
    return [(k == 0, bonded, tall[k] / sizes[k][0], sizes[k][0] / sizes[k][1], nu[k], surplus[k]) for k in (0, 1)]


def _scene(radius: float, tall: list[float], nu: list[float], bonded: bool) -> Scene:
    materials = [Material(youngs_modulus=1e3, poisson_ratio=value) for value in nu]
    probe = Probe(
        inner_radius=1e-3,
        gap=2e-5,
        outer_radius=radius,
        inner_height=tall[0],
        outer_height=tall[1],
        inner=materials[0],
        outer=materials[1],
    )
    ground = CylinderTissue(
        shape="cylinder", radius=1.5 * radius, depth=radius, youngs_modulus=GROUND_MODULUS_PA, poisson_ratio=0.0
    )
    contact: Any = Contact(interface="bonded" if bonded else "frictionless")
    return Scene(probe=probe, tissue=ground, inclusion=(), contact=contact, load=Load(indentation=1e-6))


def fit(name: str, rows: Floats) -> None:
    """Print the coefficients and what they leave."""
    slender, thin, nu, surplus = rows[:, 2:].T

    def compute_residuals(t: Floats) -> Floats:
        tall, constant, flat = np.exp(t[:3])
        return np.asarray(
            np.log1p(surplus) - np.log1p((2 * nu) ** t[3] / (tall * slender * thin**1.5 + constant + flat / slender))
        )

    solution = least_squares(compute_residuals, [0, 2, 1, 4.5], max_nfev=4000)
    worst = np.abs(solution.fun).max()
    print(
        f"{name}: {np.round(np.exp(solution.x[:3]), 2)}, power {solution.x[3]:.2f}; surplus up to {surplus.max():.1%}, "
        f"{worst:.1%} left"
    )


if __name__ == "__main__":
    main()
