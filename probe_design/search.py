"""Global search on the closed form: a Sobol screening, then IPOPT from the best starts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from geometry.grading import Floats
from probe_design.objective import Noise
from probe_design.space import Space
from solver.closed_form import PROBE, function, parameters

SCREENED = 2048  # designs, a power of two as Sobol's sequence likes it
SEED = 20
QUIET: dict[str, Any] = {
    "ipopt.print_level": 0,
    "print_time": 0,
    "ipopt.sb": "yes",
    "error_on_fail": False,
    "show_eval_warnings": False,
}


def search(space: Space, starts: int, progress: Callable[[int, int], None]) -> Floats:
    """Return designs, best first, shape (6, n): local optima from several starts, then the best screened designs.

    Args:
        space: the bounds and constraints.
        starts: how many of the best screened designs IPOPT starts from.
        progress: called with the starts done and their number.
    """
    cost = log_objective(space)
    screened = screen(space, cost)
    solver = _ipopt(space, cost)
    found = []
    for k in range(starts):
        progress(k, starts)
        found.append(_polished(space, solver, screened[:, k]))
    progress(starts, starts)
    designs = np.concatenate([np.array(found).T, screened], axis=1)
    designs = designs[:, _nearly(space, designs)]
    values = np.array(cost.map(designs.shape[1])(np.log(designs))).ravel()
    return _distinct(designs[:, np.argsort(np.where(np.isfinite(values), values, np.inf))])


def log_objective(space: Space) -> Any:
    """The logarithm of the objective, eq. (O3), by the closed form: a casadi function of the variables' logarithms."""
    shape, values = parameters(space.scene)
    x = ca.SX.sym("x", 6)
    v = ca.exp(x)
    design = dict(zip(PROBE, values[: len(PROBE)], strict=True))
    design |= {"inner_radius": v[0], "gap": v[2], "outer_radius": space.derived_radius(ca.vertsplit(v))}
    design |= {"inner_height": v[3], "outer_height": v[3], "inner_modulus": v[4], "outer_modulus": v[5]}
    forces, slope, _ = function(shape)(ca.vertcat(*(design[name] for name in PROBE), *values[len(PROBE) :]))
    totals, slopes = ca.sum2(forces), ca.sum2(slope)
    sensitivity = slopes[0] / totals[0] - slopes[1] / totals[1]
    shares = totals / ca.sum1(totals)
    information = Noise.of(space.scene).information(sensitivity, shares[0], shares[1])
    return ca.Function("log_objective", [x], [-0.5 * ca.log(information)])


def screen(space: Space, cost: Any) -> Floats:
    """Return the admissible designs of a Sobol sequence, uniform in the logarithms, best first; shape (6, n)."""
    sample = qmc.Sobol(6, seed=SEED).random(SCREENED)
    designs = np.exp(qmc.scale(sample, np.log(space.low), np.log(space.high))).T
    designs = designs[:, space.admits(designs)]
    values = np.array(cost.map(designs.shape[1])(np.log(designs))).ravel()
    return np.asarray(designs[:, np.argsort(np.where(np.isfinite(values), values, np.inf))])


def _ipopt(space: Space, cost: Any) -> Any:
    x = ca.SX.sym("x", 6)
    v = ca.vertsplit(ca.exp(x))
    radius = space.derived_radius(v)
    constraints = ca.vertcat(radius / space.outer_radius, (radius - v[0] - v[2]) / space.wall)
    choices = {"ipopt.hessian_approximation": "limited-memory", "ipopt.max_iter": 80, "ipopt.tol": 1e-6}
    return ca.nlpsol("search", "ipopt", {"x": x, "f": cost(x), "g": constraints}, QUIET | choices)


def _polished(space: Space, solver: Any, start: Floats) -> Floats:
    bounds = {"lbx": np.log(space.low), "ubx": np.log(space.high), "lbg": [0.0, 1.0], "ubg": [1.0, np.inf]}
    optimum: Floats = np.exp(np.array(solver(x0=np.log(start), **bounds)["x"]).ravel())
    stopped_by_user(solver)
    return optimum


def stopped_by_user(solver: Any) -> None:
    """Raise the KeyboardInterrupt that casadi turned into a status."""
    if solver.stats()["return_status"] == "User_Requested_Stop":
        raise KeyboardInterrupt


def _nearly(space: Space, designs: Floats) -> NDArray[np.bool_]:
    """IPOPT meets constraints to about 1e-8; rounding for the workshop takes care of the rest."""
    radius = space.derived_radius(designs)
    room = (radius <= space.outer_radius * (1 + 1e-6)) & (radius - designs[0] - designs[2] >= space.wall * (1 - 1e-6))
    return np.asarray(room & np.all((designs >= 0.999 * space.low[:, None]) & (designs <= 1.001 * space.high[:, None]), axis=0))


def _distinct(designs: Floats) -> Floats:
    """Drop designs that differ from a better one by less than 5 % in every variable."""
    kept: list[Floats] = []
    for design in designs.T:
        if all(np.max(np.abs(np.log(design / other))) > 0.05 for other in kept):
            kept.append(design)
        if len(kept) == 50:
            break
    return np.array(kept).T
