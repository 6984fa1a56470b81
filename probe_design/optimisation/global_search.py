"""Global search on the closed form: a Sobol screening, then IPOPT from the best starts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from geometry.common.arrays import Floats
from probe_design.optimisation.design_space import Space
from probe_design.optimisation.objective import Noise
from solver.casadi_functions.closed_form import ClosedFormFunction
from solver.closed_form.designs import PROBE, forces, parameters

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
    screened = screen(space)
    solver, formula = _ipopt(space)
    optima = []
    for k in range(starts):
        progress(k, starts)
        optima.append(_polished(space, solver, screened[:, k]))
    progress(starts, starts)
    del formula  # casadi holds no reference to it
    designs = np.concatenate([np.array(optima).T, screened], axis=1)
    designs = designs[:, _nearly(space, designs)]
    return _distinct(designs[:, np.argsort(log_objectives(space, designs))])


def log_objectives(space: Space, designs: Floats) -> Floats:
    """The logarithm of the objective, eq. OP.3, of designs (6, n) by the closed form, inf where it cannot tell; shape (n,)."""
    shape, values = parameters(space.scene)
    columns = np.repeat(values[:, None], designs.shape[1], axis=1)
    columns[_VARIED] = _varied(space, designs)
    with np.errstate(all="ignore"):  # what is not finite is no candidate
        objectives = -0.5 * np.log(_information(space, *(part.sum(axis=2).T for part in forces(shape, columns))))
    return np.where(np.isfinite(objectives), objectives, np.inf)


_VARIED = [PROBE.index(name) for name in ("inner_radius", "gap", "outer_radius", "inner_height", "outer_height")]
_VARIED += [PROBE.index(name) for name in ("inner_modulus", "outer_modulus")]


def _varied(space: Space, v: Any) -> list[Any]:
    """The parameters ``_VARIED`` of designs, floats or casadi."""
    return [v[0], v[2], space.derived_radius(v), v[3], v[3], v[4], v[5]]


def _information(space: Space, totals: Any, slopes: Any) -> Any:
    """Eq. OP.2 from both films' forces under a common displacement and their slopes; arrays or casadi."""
    sensitivity = slopes[0] / totals[0] - slopes[1] / totals[1]
    whole = totals[0] + totals[1]
    return Noise.of(space.scene).information(sensitivity, totals[0] / whole, totals[1] / whole)


def screen(space: Space) -> Floats:
    """Return the admissible designs of a Sobol sequence, uniform in the logarithms, best first; shape (6, n)."""
    sample = qmc.Sobol(6, seed=SEED).random(SCREENED)
    designs = np.exp(qmc.scale(sample, np.log(space.low), np.log(space.high))).T
    designs = designs[:, space.admits(designs)]
    return np.asarray(designs[:, np.argsort(log_objectives(space, designs))])


def _ipopt(space: Space) -> tuple[Any, ClosedFormFunction]:
    formula = ClosedFormFunction(*parameters(space.scene), _VARIED)
    x = ca.MX.sym("x", 6)
    v = ca.vertsplit(ca.exp(x))
    radius = space.derived_radius(v)
    parts = ca.vertsplit(formula(ca.vertcat(*_varied(space, v))))
    cost = -0.5 * ca.log(
        _information(space, [parts[0] + parts[1], parts[2] + parts[3]], [parts[4] + parts[5], parts[6] + parts[7]])
    )
    constraints = ca.vertcat(radius / space.outer_radius, (radius - v[0] - v[2]) / space.wall)
    choices = {"ipopt.hessian_approximation": "limited-memory", "ipopt.max_iter": 80, "ipopt.tol": 1e-6}
    return ca.nlpsol("search", "ipopt", {"x": x, "f": cost, "g": constraints}, QUIET | choices), formula


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
    distinct: list[Floats] = []
    for design in designs.T:
        if all(np.max(np.abs(np.log(design / other))) > 0.05 for other in distinct):
            distinct.append(design)
        if len(distinct) == 50:
            break
    return np.array(distinct).T
