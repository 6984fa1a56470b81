"""Check that a probe anywhere on its tissue can be meshed, near edges and corners, with tumours near bottom and sides.

Each line: number, distance of the probe's rim from the nearest edge in outer radii, bodies, groove, tilt; tetrahedra, trials and
seconds of both first meshes of ``solid``, or what failed.

    python -m benchmarks.evaluators.mesh_draws --scenes 60 --seed 0

Duration: half an hour.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from geometry import Refusal, Scene, SolveError, read_scene
from geometry.common.errors import InputError
from geometry.tetra.layout import build_layout, find_extent
from geometry.tetra.mesher import mesh_layout
from geometry.tetra.sizing import COARSE_FINENESS, ROUGH_FINENESS
from solver.solid.domain import choose_domain, compute_reach
from solver.solid.symmetric_part import MIN_SIDE_TISSUE_RADII, find_reference_wall

EXAMPLE = Path(__file__).parents[2] / "examples" / "scene.toml"


def draws(seed: int) -> Iterator[Scene]:
    """Scenes that fit, without an end."""
    random, example = np.random.default_rng(seed), read_scene(EXAMPLE)
    while True:
        try:
            yield Scene.model_validate(_draw(random, example))
        except ValueError:  # bodies that overlap or leave the tissue
            continue


def _draw(random: np.random.Generator, example: Scene) -> dict[str, Any]:
    scene, tube = example.model_dump(exclude_unset=True), example.probe.tube_radius
    half = random.uniform(2.5, 12, 2) * tube
    depth = float(random.uniform(2.5, 12) * tube)
    soft = {"youngs_modulus": 6e3, "poisson_ratio": 0.45}
    round_ = random.random() < 0.3
    tissue = (
        {"shape": "cylinder", "radius": half[0]} if round_ else {"shape": "block", "length": 2 * half[0], "breadth": 2 * half[1]}
    )
    position = _place(random, tube, half, round_)
    bodies = [_body(random, tube, half, depth) for _ in range(random.integers(1, 4))]
    bodies[0]["target"] = True
    if random.random() < 0.4:
        scene["probe"]["groove"] = {
            "width": float(random.uniform(0.1, 0.35) * tube),
            "depth": float(random.uniform(0.1, 0.4) * 3e-3),
        }
    tilt = float(random.uniform(-0.1, 0.1)) if random.random() < 0.25 else 0.0
    placement = {"x": position[0], "y": position[1], "tilt": tilt}
    return scene | {"tissue": {**tissue, "depth": depth, **soft}, "inclusion": bodies, "placement": placement}


def _place(random: np.random.Generator, tube: float, half: Any, round_: bool) -> tuple[float, float]:
    """Draw a place of the probe whose rim is 0.12 to 1.5 outer radii from one edge or, in a corner of a block, from two."""
    side_distances = tube * (1 + np.exp(random.uniform(math.log(1.1 * MIN_SIDE_TISSUE_RADII), math.log(1.5), 2)))
    if round_:
        return float(max(half[0] - side_distances[0], 0.0)), 0.0
    x, y = np.maximum(half - side_distances, 0.0)
    kind = random.integers(3)
    return float(x), (0.0, float(random.uniform(0, y)), float(y))[kind]


def _body(random: np.random.Generator, tube: float, half: Any, depth: float) -> dict[str, Any]:
    """Draw a sphere or an ellipsoid of up to 3 : 1, in half of the cases near bottom or side."""
    size = float(random.uniform(0.4, 1.6) * tube)
    shape: dict[str, Any] = {"diameter": size}
    if random.random() < 0.3:
        shape = {"diameters": tuple(size * random.uniform(0.6, 1.8, 3)), "orientation": tuple(random.uniform(-90, 90, 3))}
    cover = float(np.exp(random.uniform(math.log(0.1), math.log(1.0)))) * size
    low, high = 0.5 * size + cover, depth - 0.5 * size - cover
    place = random.uniform(-0.9, 0.9, 2) * half
    if random.random() < 0.4:
        place[0] = half[0] - 0.5 * size - cover
    return {
        **shape,
        "depth": float(random.choice([low, high, random.uniform(min(low, high), max(low, high))])),
        "x": float(place[0]),
        "y": float(place[1]) if random.random() < 0.6 else 0.0,
        "youngs_modulus": 3e4,
        "poisson_ratio": 0.45,
    }


def outcome(scene: Scene) -> tuple[bool, str]:
    """Whether both meshes passed the checks, and what they are."""
    said, start = [], time.perf_counter()
    try:
        chosen = choose_domain(scene, compute_reach(scene), find_reference_wall(scene))
        layout = build_layout(chosen.scene, chosen.half, find_extent(chosen.scene, None), chosen.radius)
        for fineness in (ROUGH_FINENESS, COARSE_FINENESS):
            mesh, timing = mesh_layout(layout, fineness)
            said.append(f"{len(mesh.elements)} in {timing.trials}")
    except (SolveError, Refusal, InputError) as fault:
        return False, f"{' '.join(said)} {fault} after {time.perf_counter() - start:.0f} s"
    return True, f"{', '.join(said)}; {time.perf_counter() - start:.0f} s"


def main() -> None:
    """Draw, mesh, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--first", type=int, default=0, help="the number of the first that is meshed")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    good = 0
    for number, scene in zip(range(options.first + options.scenes), draws(options.seed), strict=False):
        if number < options.first:
            continue
        fine, said = outcome(scene)
        good += fine
        print(f"{number:3} {_words(scene)}: {'' if fine else 'FAILED '}{said}", flush=True)
    print(f"{good} of {options.scenes} meshed")


def _words(scene: Scene) -> str:
    tissue, placement, tube = scene.tissue, scene.placement, scene.probe.tube_radius
    if tissue.shape == "cylinder":
        room = tissue.radius - math.hypot(placement.x, placement.y)
    elif tissue.shape == "block":
        room = min(tissue.length / 2 - abs(placement.x), tissue.breadth / 2 - abs(placement.y))
    else:
        room = math.inf
    kinds = "".join("o" if body.diameter else "e" for body in scene.inclusion)
    extras = (" groove" if scene.probe.groove else "") + (" tilt" if placement.tilt else "")
    return f"{tissue.shape} edge {room / tube - 1:.2f} {kinds}{extras}"


if __name__ == "__main__":
    main()
