"""Count how many of the closed form's charges of films on an elastic base are within their stated errors.

``python -m benchmarks.closed_form.base_charges [--scenes N] [--seed K]`` draws scenes of bare tissue and films on bonds, on a
base of 1 to 70 GPa, half of them with a flange, and compares both charges with those of ``axisymmetric``. Where a charge is
below its own error none is stated.

Duration: three seconds per scene.
"""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.closed_form.film_scenes import draw_film
from benchmarks.closed_form.random_scenes import draw
from geometry import InputError, Scene
from solver import evaluate

ACCURACY = 0.01
MAX_BASE_MODULUS_PA = 70e9


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=80)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    solved, stated, covered, number = 0, 0, 0, 0
    while solved < options.scenes:
        number += 1
        try:
            scene = draw_scene(np.random.default_rng([options.seed, number]))
            exact, formulas = evaluate(scene, "axisymmetric", ACCURACY), evaluate(scene, "closed-form")
        except (InputError, ValueError):
            continue
        solved += 1
        for key in ("charge_inner", "charge_outer"):
            value, error = getattr(formulas, key), getattr(formulas, f"{key}_error")
            if value is not None and error is not None:
                stated += 1
                covered += abs(getattr(exact, key) / value - 1) <= error
    print(f"{solved} scenes, {2 * solved} charges, stated: {stated}, of which within their errors: {covered}")


def draw_scene(rng: np.random.Generator) -> Scene:
    """Draw a scene of bare tissue with films, on a base of printed plastic to aluminium.

    Raises
    ------
    InputError, ValueError
        Its parts do not fit.
    """
    scene = draw(rng, "bare")
    base = {"youngs_modulus": float(np.exp(rng.uniform(np.log(1e9), np.log(MAX_BASE_MODULUS_PA)))), "poisson_ratio": 0.35}
    if rng.random() < 0.5:
        base["flange_radius"] = scene.probe.tube_radius * float(rng.uniform(1, 2))
        base["thickness"], base["step_height"] = (float(rng.uniform(1e-3, 10e-3)) for _ in range(2))
    film = draw_film(rng, scene.probe.tube_radius - scene.probe.hole_radius)
    table = scene.model_dump(exclude_unset=True)
    return Scene.model_validate(table | {"probe": table["probe"] | {"film": film, "base": base}})


if __name__ == "__main__":
    main()
