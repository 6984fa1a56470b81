"""Measure the margin of eq. PL.14: how much more a load changes charges on tape than the bound on forces allows for.

    python -m benchmarks.films.load_margins [--scenes 40] [--seed 1]

Probes of ``benchmarks.built_probe.film_calibration`` with other radii and heights, pressed by ``contact`` to three loads. The
change of both charges per indentation and of their ratio against ``axisymmetric`` is compared with the bound on film forces. The
margin is that quotient over the same quotient at a light load without a tumour, which eq. PL.14 computes on a coarse mesh.

Duration: four minutes.
"""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.built_probe.film_calibration import draw_scene
from benchmarks.films.bonds import print_table
from geometry.common.errors import ProbeError
from geometry.scenes.scene import Scene
from solver import evaluate
from solver.planning.charge_changes import CHANGE_MARGIN_FACTOR, add_charges, has_soft_bond
from solver.planning.coarse_model import CoarseModel, remove_tumours
from solver.results.result import Result

RADII, HEIGHTS = (3e-3, 7e-3), (1.5e-3, 6e-3)  # m: inner radii and heights of probes
LOADS_X = (0.03, 0.1, 0.25)  # x of the loads
ACCURACY = 3e-3


def main() -> None:
    """Print a row for each load."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    measured: list[tuple[float, float, float]] = []
    for number in range(options.scenes):
        random = np.random.default_rng([options.seed, number])
        scene = draw_scene(random)[0]
        sizes = {"probe.inner_radius": random.uniform(*RADII), "probe.height": random.uniform(*HEIGHTS)}
        scene = scene.replace(sizes | {"probe.outer_radius": 1.35 * sizes["probe.inner_radius"]})
        if has_soft_bond(scene):
            measured += measure(scene)
    rows = []
    for x in LOADS_X:
        margins, shares = np.array([row[1:] for row in measured if row[0] == x]).T
        worst = f"{margins.max():.2f}", f"{shares.max():.2f}", str(int((shares > 1).sum()))
        rows.append((f"{x:g}", str(len(margins)), f"{np.median(margins):.2f}", *worst))
    columns = "margin: median", f"largest (eq. PL.14: {CHANGE_MARGIN_FACTOR:g})", "change over bound: largest", "above it"
    print_table(("x", "presses", *columns), rows)


def measure(scene: Scene) -> list[tuple[float, float, float]]:
    """Return for each load its x, the margin that it needs, and the change over its bound."""
    coarse = CoarseModel.from_scene(remove_tumours(scene), details=False)
    rule, factor = coarse.build_rule(scene), coarse.charge_factor
    measured = []
    for x in LOADS_X:
        force = x / rule.strain * rule.stiffness
        loaded = scene.replace({"load.force": force})
        try:
            linear = evaluate(loaded, evaluator="axisymmetric", accuracy=ACCURACY)
            pressed = evaluate(loaded, evaluator="contact", accuracy=ACCURACY)
        except ProbeError:
            continue
        if not rule.is_known(force) or linear.charge_ratio is None or pressed.charge_ratio is None:
            continue
        change = max(abs(a / b - 1) for a, b in zip(list_charges(pressed), list_charges(linear), strict=True))
        light = factor / CHANGE_MARGIN_FACTOR  # c / b of eq. PL.14
        bound = add_charges(rule, 1 / factor).bound_ratio_change(force)
        measured.append((x, change / (bound * light), change / rule.bound_ratio_change(force)))
    return measured


def list_charges(result: Result) -> tuple[float, float, float]:
    """Return both charges per stiffness and force, so per indentation, and their ratio."""
    stiffness = result.stiffness or np.nan
    inner, outer = (stiffness * (charge or np.nan) for charge in (result.charge_inner, result.charge_outer))
    return inner, outer, result.charge_ratio or np.nan


if __name__ == "__main__":
    main()
