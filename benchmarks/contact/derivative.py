"""Compare the log-sensitivity under load with differences of whole load paths, by this project and by NGSolve.

    python -m benchmarks.contact.derivative

Differences are those of ln ratio at one force between moduli ``MODULUS_STEP_RELATIVE`` below and above, over those of ln E;
values are those of each code's mesh, nothing taken off at rest.

Duration: minutes.
"""

from __future__ import annotations

from collections.abc import Callable
from math import log

import ngsolve as ngs
import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.contact.ngsolve_pressing import ContactSetting, PressedProbe
from benchmarks.contact.peers import scene
from geometry import Scene
from geometry.common.arrays import Floats
from geometry.meridian.mesh_lines import MeridianFineness
from solver.axisymmetric.sections import build_sections
from solver.contact.model import ContactModel
from solver.contact.path import Path

MODULUS_STEP_RELATIVE = 0.04
DEPTHS = (*np.arange(0.2e-3, 1.9e-3, 0.2e-3).tolist(), 1.9e-3, 2.0e-3)
FIRST_FITTED_DEPTH_M, SHOWN_DEPTHS_M = (
    1.1e-3,
    (1.2e-3, 1.4e-3, 1.6e-3, 1.8e-3, 2.0e-3),
)  # m, between which and the last forces are interpolated
FilmPoint = tuple[Floats, float]
"""Film forces and log-sensitivity."""


def ours(pressed_scene: Scene) -> list[FilmPoint]:
    """Return the results of one mesh of order 3 at ``DEPTHS``."""
    cut = build_sections(pressed_scene)
    path = Path(ContactModel.from_section(cut.section, cut.materials, "bonded", MeridianFineness(1, 0, 3)), sensitive=True)
    points = [path.press_to_indentation(depth) for depth in DEPTHS]
    return [(point.films, point.log_sensitivity) for point in points]


def press_by_ngsolve(pressed_scene: Scene) -> list[FilmPoint]:
    """Return NGSolve's results there."""
    problem, points = PressedProbe(pressed_scene, ContactSetting(3, 1.5, layers=1, mixed=True, tolerance=1e-5)), list[FilmPoint]()
    for depth in DEPTHS:
        problem.press(depth / pressed_scene.probe.inner_radius)
        films = problem.films()
        points.append((films, problem.log_sensitivity(films)))
    return points


def replace_modulus(base: Scene, factor: float) -> Scene:
    """Return a scene with another Young's modulus of the tumour."""
    body = base.inclusion[0]
    changed = body.model_copy(update={"youngs_modulus": factor * body.youngs_modulus})
    return base.model_copy(update={"inclusion": (changed,)})


def difference(press: Callable[[Scene], list[FilmPoint]], base: Scene, points: list[FilmPoint]) -> Floats:
    """Return the differences at the forces that ``points`` reach, at ``SHOWN_DEPTHS_M``."""
    last = [k for k, depth in enumerate(DEPTHS) if depth > FIRST_FITTED_DEPTH_M]
    wanted = [points[k][0].sum() for k in last if np.min(np.abs(np.subtract(SHOWN_DEPTHS_M, DEPTHS[k]))) < 1e-9]
    logs = []
    for factor in (1 - MODULUS_STEP_RELATIVE, 1 + MODULUS_STEP_RELATIVE):
        films = np.array([point[0] for point in press(replace_modulus(base, factor))])[last]
        logs.append(CubicSpline(films.sum(axis=1), np.log(films[:, 0] / films[:, 1]))(wanted))
    return np.asarray((logs[1] - logs[0]) / log((1 + MODULUS_STEP_RELATIVE) / (1 - MODULUS_STEP_RELATIVE)))


def main() -> None:
    """Print a table."""
    ngs.SetNumThreads(1)
    print("| code | indentation, mm | log-sensitivity | by differences | off |\n|---|---|---|---|---|")
    for name, press in (("ours, order 3", ours), ("NGSolve, P3/P1", press_by_ngsolve)):
        points = press(scene())
        derivatives = [
            points[k][1] for k, depth in enumerate(DEPTHS) if np.min(np.abs(np.subtract(SHOWN_DEPTHS_M, depth))) < 1e-9
        ]
        for depth, exact, differenced in zip(SHOWN_DEPTHS_M, derivatives, difference(press, scene(), points), strict=True):
            print(f"| {name} | {1e3 * depth:g} | {exact:.5f} | {differenced:.5f} | {exact / differenced - 1:+.2%} |", flush=True)


if __name__ == "__main__":
    main()
