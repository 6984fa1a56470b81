"""The last step of the design loop: IPOPT on finite elements with their exact derivatives, from the best designs so far."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np

from geometry.common.arrays import Floats
from geometry.scenes.scene import Load, Scene
from geometry.scenes.units import SI_CONTEXT
from probe_design.optimisation.design_space import Space, read_variables
from probe_design.optimisation.global_search import IPOPT_QUIET_OPTIONS, raise_user_interrupt
from probe_design.optimisation.objective import Noise
from probe_design.optimisation.pressing import compute_pressing_force
from solver.casadi_functions.finite_elements import FilmCallback, TumourCallback

# keys of ``geometry.scenes.variables.list_values`` in the order of ``probe_design.optimisation.design_space.VARIABLES``
SCENE_KEYS = (
    "probe.inner_radius", "probe.area_ratio", "probe.gap", "probe.height", "probe.inner.youngs_modulus",
    "probe.outer.youngs_modulus",
)  # fmt: skip
SEARCH_ACCURACY = 0.03  # of the outputs at the start: what is found is judged more finely
UNIT_INDENTATION_M = 1e-6  # m
MAX_IPOPT_STEPS = 15  # of IPOPT; each costs one to a few solutions with their derivatives


def refine_by_finite_elements(space: Space, noise: Noise, start: Scene, wall_approach: float, judge: str) -> Floats:
    """Return the local optimum near a design, six variables in the order of ``VARIABLES``, shape (6,).

    Args:
        space: bounds and constraints.
        noise: of a reading.
        start: a scene with a design within them.
        wall_approach: of the start's walls per unit indentation, see ``pressing.compute_pressing_force``; taken as constant.
        judge: ``axisymmetric``, or ``equivalent-inclusion``, whose derivatives are those of its first order.

    Raises:
        Refusal: the judge cannot take the scene.
        KeyboardInterrupt: Ctrl-C, also where casadi swallows it.
    """
    scene = _rewrite_by_area_ratio(start)
    films = (FilmCallback if judge == "axisymmetric" else TumourCallback)(scene, SCENE_KEYS, SEARCH_ACCURACY)
    x = ca.MX.sym("x", len(SCENE_KEYS))
    v = ca.vertsplit(ca.exp(x))
    _, inner, outer, sensitivity = ca.vertsplit(films(ca.vertcat(*v)))
    totals = [inner / UNIT_INDENTATION_M * np.pi * v[0] ** 2, outer / UNIT_INDENTATION_M * np.pi * v[0] ** 2 / v[1]]
    radius = space.compute_outer_radius(v)
    force = compute_pressing_force(space.scene, v, radius, totals, wall_approach)
    information = noise.compute_information(sensitivity, totals[0] / (totals[0] + totals[1]), force)
    constraints = ca.vertcat(radius / space.outer_radius, (radius - v[0] - v[2]) / space.wall)
    choices: dict[str, Any] = {
        "ipopt.hessian_approximation": "limited-memory",
        "ipopt.max_iter": MAX_IPOPT_STEPS,
        "ipopt.tol": 1e-3,
    }
    solver = ca.nlpsol(
        "polish", "ipopt", {"x": x, "f": -0.5 * ca.log(information), "g": constraints}, IPOPT_QUIET_OPTIONS | choices
    )
    low, high = np.log(space.low), np.log(space.high)
    start_inside = np.clip(np.log(read_variables(start)), low, high)
    with np.errstate(all="ignore"):  # IPOPT steps back from what is not finite
        optimum = np.exp(np.array(solver(x0=start_inside, lbx=low, ubx=high, lbg=[0.0, 1.0], ubg=[1.0, math.inf])["x"]).ravel())
    raise_user_interrupt(solver)
    return np.asarray(np.clip(optimum, space.low, space.high))


def _rewrite_by_area_ratio(scene: Scene) -> Scene:
    """Write the scene's probe by A2/A1 and one height, as the variables do, under an indentation of ``UNIT_INDENTATION_M``."""
    probe = scene.probe
    data = probe.model_dump(exclude={"outer_radius", "inner_height", "outer_height"}, exclude_unset=True)
    data |= {"area_ratio": probe.inner_area / probe.outer_area, "height": probe.core_height}
    return Scene.model_validate(
        scene.model_dump(exclude_unset=True) | {"probe": data, "load": Load(indentation=UNIT_INDENTATION_M)}, context=SI_CONTEXT
    )
