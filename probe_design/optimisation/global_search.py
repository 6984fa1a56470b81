"""Global search on the closed form: a Sobol screening, then IPOPT from the best starts.

What is screened does not depend on the limit of the outer radius but by what the limit takes away, and IPOPT starts from the best
design of each shell of outer radii before it starts from the second best of any: a wider limit adds designs and starts, and
takes none away as long as there are starts enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from geometry.common.arrays import Floats, Ints
from geometry.common.errors import Refusal, Words
from probe_design.optimisation.design_space import Space
from probe_design.optimisation.objective import Noise
from probe_design.optimisation.pressing import compute_pressing_force
from solver.casadi_functions.closed_form import ClosedFormFunction
from solver.closed_form.designs import PROBE_PARAMETERS, build_parameters, compute_forces

SCREENED_PER_SHELL = 512  # designs in each shell, a power of two as Sobol's sequence likes it
SHELLS_PER_OCTAVE = 2  # of outer radii in each octave
MIN_LOG_DISTANCE = 0.05  # of the logarithm of a variable: designs nearer to each other are searched and judged once
MAX_DESIGNS = 50  # designs that are handed on
SOBOL_SEED = 20
IPOPT_QUIET_OPTIONS: dict[str, Any] = {
    "ipopt.print_level": 0,
    "print_time": 0,
    "ipopt.sb": "yes",
    "error_on_fail": False,
    "show_eval_warnings": False,
}


def search_designs(space: Space, noise: Noise, starts: int, progress: Callable[[int, int], None]) -> Floats:
    """Return designs, best first, shape (6, n): local optima from several starts, then the best screened designs.

    Args:
        space: the bounds and constraints.
        noise: of a reading.
        starts: how many of the screened designs IPOPT starts from.
        progress: called with the starts done and their number.

    Raises:
        Refusal: the formulas can tell nothing of any design.
    """
    screened = screen_designs(space)
    values = compute_log_objectives(space, noise, screened)
    if not np.isfinite(values).any():
        raise Refusal("inclusion", Words("of a kind without sensitivity in the closed form"), "a sphere as the target")
    solver, formula = _build_ipopt_solver(space, noise)
    optima = []
    for k, start in enumerate(_order_starts(space, screened, values)[:starts]):
        progress(k, starts)
        optima.append(_refine_by_ipopt(space, solver, screened[:, start]))
    progress(starts, starts)
    del formula  # casadi holds no reference to it
    designs = np.concatenate([np.array(optima).T, screened], axis=1)
    designs = designs[:, _meets_constraints(space, designs)]
    return _drop_similar(designs[:, np.argsort(compute_log_objectives(space, noise, designs))])


def compute_log_objectives(space: Space, noise: Noise, designs: Floats) -> Floats:
    """The logarithm of the objective, eq. OP.3, of designs (6, n) by the closed form, inf where it cannot tell; shape (n,)."""
    shape, values = build_parameters(space.scene)
    columns = np.repeat(values[:, None], designs.shape[1], axis=1)
    columns[_VARIED_PARAMETERS] = _list_varied_parameters(space, designs)
    with np.errstate(all="ignore"):  # what is not finite is no candidate
        parts = (part.sum(axis=2).T for part in compute_forces(shape, columns))
        objectives = -0.5 * np.log(_compute_information(space, noise, designs, *parts))
    return np.where(np.isfinite(objectives), objectives, np.inf)


_VARIED_PARAMETERS = [
    PROBE_PARAMETERS.index(name) for name in ("inner_radius", "gap", "outer_radius", "inner_height", "outer_height")
]
_VARIED_PARAMETERS += [PROBE_PARAMETERS.index(name) for name in ("inner_modulus", "outer_modulus")]


def _list_varied_parameters(space: Space, v: Any) -> list[Any]:
    """The parameters ``_VARIED_PARAMETERS`` of designs, floats or casadi."""
    return [v[0], v[2], space.compute_outer_radius(v), v[3], v[3], v[4], v[5]]


def _compute_information(space: Space, noise: Noise, v: Any, totals: Any, slopes: Any) -> Any:
    """Eq. OP.2 from both films' forces under a common displacement and their slopes; arrays or casadi."""
    sensitivity = slopes[0] / totals[0] - slopes[1] / totals[1]
    force = compute_pressing_force(space.scene, v, space.compute_outer_radius(v), totals)
    return noise.compute_information(sensitivity, totals[0] / (totals[0] + totals[1]), force)


def screen_designs(space: Space) -> Floats:
    """Return the admissible designs of Sobol sequences, uniform in the logarithms, and the smallest of all, shape (6, n)."""
    inner, _, gap, *other_bounds = space.low
    min_radius = inner + gap + space.wall
    first, last = (math.floor(SHELLS_PER_OCTAVE * math.log2(radius)) for radius in (min_radius, space.outer_radius))
    designs = np.concatenate([_sample_shell(space, k) for k in range(first, last + 1)], axis=1)
    smallest = np.array([[inner, inner**2 / (min_radius**2 - (inner + gap) ** 2), gap, *other_bounds]]).T
    return np.concatenate([smallest, designs[:, space.admits(designs) & (designs[0] >= inner)]], axis=1)


def _sample_shell(space: Space, k: int) -> Floats:
    """Designs whose outer radius is between 2^(k / SHELLS) and 2^((k + 1) / SHELLS) m."""
    sample = qmc.Sobol(6, seed=SOBOL_SEED).random(SCREENED_PER_SHELL)
    radius = 2 ** ((k + sample[:, 0]) / SHELLS_PER_OCTAVE)
    ratio, gap, *other_variables = np.exp(qmc.scale(sample[:, 1:], np.log(space.low[1:]), np.log(space.high[1:]))).T
    a, b, c = 1 + 1 / ratio, gap, gap**2 - radius**2  # a r^2 + 2 b r + c = 0 is r^2 / ratio = radius^2 - (r + gap)^2
    inner = (np.sqrt(np.maximum(b**2 - a * c, 0.0)) - b) / a
    return np.array([inner, ratio, gap, *other_variables])


def _order_starts(space: Space, designs: Floats, values: Floats) -> Ints:
    """Indices of designs in the order in which IPOPT starts from them: the best of each shell, then the second best, ..."""
    shells = np.floor(SHELLS_PER_OCTAVE * np.log2(space.compute_outer_radius(designs)))
    best_first = np.argsort(values)
    turn = np.empty(len(values), dtype=int)
    for shell in np.unique(shells):
        members = best_first[shells[best_first] == shell]
        turn[members] = np.arange(len(members))
    return np.lexsort((values, turn))


def _build_ipopt_solver(space: Space, noise: Noise) -> tuple[Any, ClosedFormFunction]:
    formula = ClosedFormFunction(*build_parameters(space.scene), _VARIED_PARAMETERS)
    x = ca.MX.sym("x", 6)
    v = ca.vertsplit(ca.exp(x))
    radius = space.compute_outer_radius(v)
    parts = ca.vertsplit(formula(ca.vertcat(*_list_varied_parameters(space, v))))
    totals, slopes = [parts[0] + parts[1], parts[2] + parts[3]], [parts[4] + parts[5], parts[6] + parts[7]]
    cost = -0.5 * ca.log(_compute_information(space, noise, v, totals, slopes))
    constraints = ca.vertcat(radius / space.outer_radius, (radius - v[0] - v[2]) / space.wall)
    choices = {"ipopt.hessian_approximation": "limited-memory", "ipopt.max_iter": 40, "ipopt.tol": 1e-6}
    return ca.nlpsol("search", "ipopt", {"x": x, "f": cost, "g": constraints}, IPOPT_QUIET_OPTIONS | choices), formula


def _refine_by_ipopt(space: Space, solver: Any, start: Floats) -> Floats:
    bounds = {"lbx": np.log(space.low), "ubx": np.log(space.high), "lbg": [0.0, 1.0], "ubg": [1.0, np.inf]}
    optimum: Floats = np.exp(np.array(solver(x0=np.log(start), **bounds)["x"]).ravel())
    raise_user_interrupt(solver)
    return optimum


def raise_user_interrupt(solver: Any) -> None:
    """Raise the KeyboardInterrupt that casadi turned into a status."""
    if solver.stats()["return_status"] == "User_Requested_Stop":
        raise KeyboardInterrupt


def _meets_constraints(space: Space, designs: Floats) -> NDArray[np.bool_]:
    """IPOPT meets constraints to about 1e-8; rounding for the workshop takes care of the rest."""
    radius = space.compute_outer_radius(designs)
    design_space = (radius <= space.outer_radius * (1 + 1e-6)) & (radius - designs[0] - designs[2] >= space.wall * (1 - 1e-6))
    return np.asarray(
        design_space & np.all((designs >= 0.999 * space.low[:, None]) & (designs <= 1.001 * space.high[:, None]), axis=0)
    )


def _drop_similar(designs: Floats) -> Floats:
    """Drop designs that differ from a better one by less than ``MIN_LOG_DISTANCE`` in every variable."""
    distinct: list[Floats] = []
    for design in designs.T:
        if all(np.max(np.abs(np.log(design / better))) > MIN_LOG_DISTANCE for better in distinct):
            distinct.append(design)
        if len(distinct) == MAX_DESIGNS:
            break
    return np.array(distinct).T
