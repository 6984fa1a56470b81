"""Compare the closed-form stage of `optimize DESIGN` with SciPy's differential evolution, and run whole searches.

python -m benchmarks.populations.search            # the closed-form stage, both searches, three populations
python -m benchmarks.populations.search --verified   # the whole loop: start, one-tumour optimum, population optimum, all verified

Duration: ten minutes.
"""

from __future__ import annotations

import argparse
from time import perf_counter
from typing import Any

import numpy as np
from rich.console import Console
from scipy.optimize import Bounds, differential_evolution

from benchmarks.tables import MeasuredTable
from geometry.common.arrays import Floats
from probe_design.data.builtin import read_typical_scenes
from probe_design.design_search.choices import search_combinations
from probe_design.design_search.population_objective import PopulationObjective
from probe_design.design_search.population_study import optimize_for_population
from probe_design.design_search.search_space import SearchSpace, build_search_space
from probe_design.populations.design_file import Design, design_from_dict

EVALUATIONS = 3000
MEMBERS = 60  # ten for each variable, scipy's default of 15 rounded to what divides the evaluations
TUMOURS: dict[str, Any] = {"diameter": [5e-3, 12e-3], "object": [2e4, 6e4], "tissue": [4e3, 8e3], "x": [-4e-3, 4e-3]}
POPULATIONS: dict[str, dict[str, Any]] = {
    "superficial, 3-10 mm": TUMOURS | {"depth": [3e-3, 10e-3]},
    "deep, 10-25 mm": TUMOURS | {"depth": [10e-3, 25e-3]},
    "mixed under a skin, 3-25 mm": TUMOURS
    | {"depth": [3e-3, 25e-3], "layer": [{"thickness": [1.2e-3, 1.7e-3], "modulus": [4e4, 7e4]}]},
}


def design(name: str) -> Design:
    """Return a population's design file; limits of 8 mm and 0.5 N, the ratio alone is read."""
    scene = read_typical_scenes()["on-axis"]
    if "skin" in name:
        skin = {"thickness": 1.44e-3, "youngs_modulus": 56.3e3, "poisson_ratio": 0.45}  # Briot 2022, OSTI 22130565
        tissue = scene.tissue.model_dump(exclude_unset=True) | {"layer": [skin]}
        scene = type(scene).model_validate(scene.model_dump(exclude_unset=True) | {"tissue": tissue})
    tables = {"population": POPULATIONS[name], "protocol": {"stiffness": False}, "limits": {"outer_radius": 8e-3, "force": 0.5}}
    return design_from_dict({"scene": scene, **tables})


def find_evolved_objective(objective: PopulationObjective, search_space: SearchSpace) -> float:
    """Return the best objective that differential evolution finds in ``EVALUATIONS``; designs beyond constraints are worth 0."""

    def worth(x: Floats) -> float:
        design_column = np.exp(x)[:, None]
        return (
            -float(objective.evaluate_designs(design_column, search_space.start_poisson)[0])
            if search_space.admits(design_column)[0]
            else 0.0
        )

    bounds = Bounds(np.log(search_space.low), np.log(search_space.high))
    settings: dict[str, Any] = {"polish": False, "tol": 0.0, "seed": 1, "popsize": MEMBERS // 6}
    return -float(differential_evolution(worth, bounds, maxiter=EVALUATIONS // MEMBERS - 1, **settings).fun)


def closed_form() -> MeasuredTable:
    """Time both searches on the three populations."""
    columns = ("population", "this search", "time, s", "differential evolution", "its time, s", "faster, times")
    table = MeasuredTable(f"closed-form stage against {EVALUATIONS} evaluations of differential evolution", columns)
    for name in POPULATIONS:
        population_design = design(name)
        search_space = build_search_space(population_design)
        objective = PopulationObjective.from_design(population_design, search_space.outer_radius)
        start = perf_counter()
        mine = search_combinations(objective, search_space, lambda done, total: None).choices[0].value
        middle = perf_counter()
        theirs = find_evolved_objective(objective, search_space)
        end = perf_counter()
        table.add(name, round(mine, 5), middle - start, round(theirs, 5), end - middle, (end - middle) / (middle - start))
    return table


def verify_populations() -> MeasuredTable:
    """Design for the three populations and verify on tumours that the search did not use."""
    columns = ("population", "start", "one tumour", "population optimum", "gain", "error of the gain", "search, s", "all, s")
    table = MeasuredTable("probability of detection on tumours that the search did not use", columns)
    for name in POPULATIONS:
        optimum = optimize_for_population(design(name), lambda stage, done, total: None)
        cells = [
            "-" if candidate is None else "{:.3f} ± {:.3f}".format(*candidate.objective)
            for candidate in (optimum.start, optimum.single, optimum.best_tried)
        ]
        table.add(
            name, *cells, *(round(candidate, 3) for candidate in optimum.gain), optimum.seconds["search"], optimum.seconds["all"]
        )
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--verified", action="store_true", help="whole searches")
    (verify_populations() if parser.parse_args().verified else closed_form()).print(Console(width=160))
