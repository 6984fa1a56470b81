"""Measure how accurately linear elasticity without tumours predicts the approach of the walls at the gap.

    python -m benchmarks.extremes.gap_closing --scenes 250 --seed 0 --seed 1 --seed 2

Reference scenes, then drawn ones of ``load_bounds`` and of ``benchmarks.evaluators.inclusion_draws``, with layers and without.
Of each the largest nearing by the coarsest mesh, which the rule for loads takes: over that by a fine one, and over eq. PL.4.

Duration: minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from itertools import islice

import numpy as np

from benchmarks.evaluators.inclusion_draws import draw, draw_layered
from benchmarks.extremes.load_bounds import draws
from geometry import ProbeError, Scene, read_scene
from geometry.common.errors import InputError, SolveError
from geometry.common.resources import start_clock
from solver.axisymmetric.refinement import MESH_LEVELS
from solver.axisymmetric.sample import solve_on_mesh
from solver.axisymmetric.sections import build_sections
from solver.linalg.workspace import get_workspace
from solver.planning.coarse_model import CoarseModel, GapProfile
from solver.planning.loads import bound_wall_nearing
from tests.support.paths import REFERENCE

FINE, SMALL_NEARING_SHARE = (
    MESH_LEVELS[3],
    0.05,
)  # where the nearing is less than this share of eq. PL.4 the bottom of eq. PL.9 counts
FOLDERS = ("axisymmetric", "contact", "extra", "extremes", "half-space", "solid")


def scenes(seeds: list[int], count: int) -> Iterator[Scene]:
    """Yield reference scenes, then drawn ones."""
    for path in (path for folder in FOLDERS for path in sorted((REFERENCE / folder).glob("*.toml"))):
        yield read_scene(path)
    for seed in seeds:
        yield from islice(draws(seed), count)
        for drawn in (draw_function(seed, k) for k in range(count) for draw_function in (draw, draw_layered)):
            try:
                yield drawn.scene()
            except (InputError, ValueError):
                continue


def shares(scene: Scene) -> tuple[float, float]:
    """Return the coarsest mesh's nearing over a fine one's, and over eq. PL.4."""
    get_workspace().begin()
    with start_clock():
        rough = CoarseModel.from_scene(scene, details=False)
        plain = build_sections(rough.scene)
        fine = GapProfile.from_states(solve_on_mesh(plain.section, plain, rough.scene, FINE).states)
    by_formula = rough.gap_profile.max_nearing / bound_wall_nearing(rough.scene, rough.forces.sum(axis=1))
    return rough.gap_profile.max_nearing / fine.max_nearing if by_formula > SMALL_NEARING_SHARE else 1.0, by_formula


def main() -> None:
    """Compare all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=250)
    parser.add_argument("--seed", type=int, action="append")
    options = parser.parse_args()
    ratios, refused = [], 0
    for scene in scenes(options.seed or [0], options.scenes):
        try:
            ratios.append(shares(scene))
        except (ProbeError, SolveError):
            refused += 1
    meshes, formula = np.array(ratios).T
    print(f"{len(ratios)} scenes, {refused} refused")
    print("coarsest over fine mesh, smallest, 1 %, 99 %, largest:", np.round(np.quantile(meshes, [0, 0.01, 0.99, 1]), 3).tolist())
    print(f"of eq. PL.4, largest and median: {formula.max():.2f}, {np.median(formula):.2f}")


if __name__ == "__main__":
    main()
