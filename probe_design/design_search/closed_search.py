"""Search designs with the closed form: quasi-random designs on arrays, then IPOPT with exact gradients from the best per size.

A limit only removes designs from those screened. IPOPT starts from the best design of each shell of outer radii before it starts
from the second best of any. A wider limit therefore only adds designs and starts.
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
from scipy.stats import qmc

from geometry.common.arrays import Floats, Ints
from geometry.common.json_types import JsonObject
from probe_design.design_search.objective import ExactGradients, SearchEffort, SearchObjective
from probe_design.design_search.search_space import SearchSpace
from probe_design.design_search.variables import ProbeSizes
from solver.casadi_functions.base import DifferentiableFunction

SOBOL_SEED = 21
SHELLS_PER_OCTAVE = 2  # of outer radii in each octave
IPOPT_TOLERANCE = 1e-5  # of the objective
CONSTRAINT_TOLERANCE_RELATIVE = 1e-6  # IPOPT satisfies constraints to about 1e-8, and rounding removes the rest
IPOPT_OPTIONS: JsonObject = {
    "ipopt.print_level": 0,
    "print_time": 0,
    "ipopt.sb": "yes",
    "error_on_fail": False,
    "show_eval_warnings": False,
    "ipopt.hessian_approximation": "limited-memory",
}


class ObjectiveFunction(DifferentiableFunction):
    """The objective, and the margin of the weaker channel's charge, as functions of ln of some variables, with derivatives.

    Parameters
    ----------
    objective
        The objective.
    start
        Values of all variables.
    which
        Indices of the variables that vary.
    poisson
        Poisson's ratios of both blocks.
    """

    def __init__(self, objective: ExactGradients, start: Floats, which: list[int], poisson: tuple[float, float]) -> None:
        super().__init__()
        self.objective, self.start, self.which, self.poisson = objective, start, which, poisson
        self.begin("population", len(which), 2)

    def compute(self, x: Floats) -> tuple[Floats, Floats]:
        """Return both values and their derivatives; NaN where the closed form fails, from which IPOPT steps back."""
        design = self.start.copy()
        design[self.which] = np.exp(x)
        return self.objective.gradient(design, self.poisson, self.which)


def search(
    objective: SearchObjective, space: SearchSpace, poisson: tuple[float, float], effort: SearchEffort | None = None
) -> tuple[Floats, Floats]:
    """Search designs within bounds; return local optima and screened designs, best first, and their objectives.

    Parameters
    ----------
    objective
        The objective to be maximised.
    space
        Bounds and constraints; a variable whose bounds are equal is fixed.
    poisson
        Poisson's ratios of both blocks.
    effort
        Effort of the search; default: that of the objective.

    Returns
    -------
    tuple[Floats, Floats]
        Designs, shape (variables, n), and their objectives by the closed form, shape (n,).
    """
    effort = effort or objective.effort
    designs = screen(space, effort.screened)
    values = objective.evaluate_designs(designs, poisson)
    if not space.free or not np.isfinite(values).any():
        return _sort_designs(designs, values)
    optima = [
        refine_by_ipopt(objective, space, designs[:, k], poisson=poisson, steps=effort.steps)
        for k in _order_starts(designs, values)[: effort.starts]
    ]
    all_designs = np.concatenate([np.array(optima).T, designs], axis=1)
    all_values = np.concatenate([objective.evaluate_designs(np.array(optima).T, poisson), values])
    is_admitted = space.admits(all_designs, CONSTRAINT_TOLERANCE_RELATIVE)
    return _sort_designs(all_designs[:, is_admitted], all_values[is_admitted])


def screen(space: SearchSpace, count: int) -> Floats:
    """Return the designs from which a search starts: admissible designs that fill the space evenly.

    For each shell of outer radii (``SHELLS_PER_OCTAVE`` in each doubling) a Sobol sequence of ``count`` designs is spread
    uniformly over the logarithms of the variables; those within the bounds and constraints are kept. Before them come the design
    at the lower bounds and, if the sequences give none, the one in the middle of all bounds, as far as they are admissible; both
    have the thinnest wall allowed. Without free variables the only design is returned as it is.

    Returns
    -------
    Floats
        Designs, shape (variables, n).
    """
    low, high = np.maximum(space.low, 1e-12), np.maximum(space.high, 1e-12)  # above 0, as logarithms are taken
    if not space.free:
        return low[:, None]
    min_radius = space.wall + sum(low[space.names.index(name)] for name in ("inner_radius", "gap"))
    first, last = (
        math.floor(SHELLS_PER_OCTAVE * math.log2(radius)) for radius in (min_radius, max(space.outer_radius, min_radius))
    )
    sample = qmc.Sobol(len(low), seed=SOBOL_SEED).random(count)
    designs = np.concatenate([_sample_shell(space, low, high, sample, k) for k in range(first, last + 1)], axis=1)
    inside = space.admits(designs) & np.all(
        (designs >= low[:, None] * (1 - 1e-9)) & (designs <= high[:, None] * (1 + 1e-9)), axis=0
    )
    extra_designs = [low] if inside.any() else [low, np.exp((np.log(low) + np.log(high)) / 2)]
    candidates = np.array([_thin_wall(space, extra_design) for extra_design in extra_designs]).T
    return np.concatenate([candidates[:, space.admits(candidates)], designs[:, inside]], axis=1)


def _thin_wall(space: SearchSpace, design: Floats) -> Floats:
    """Return a design, shape (variables,), with its area ratio changed in place to that of the thinnest wall allowed."""
    sizes, k = ProbeSizes.from_vector(design), space.names.index("area_ratio")
    hole = sizes.inner_radius + sizes.gap
    outer_radius = hole + space.wall * (1 + 1e-9)
    design[k] = np.clip(sizes.inner_radius**2 / (outer_radius**2 - hole**2), space.low[k], space.high[k])
    return design


def _sample_shell(space: SearchSpace, low: Floats, high: Floats, sample: Floats, k: int) -> Floats:
    """Return designs in the k-th shell: outer radii from 2^(k / s) to 2^((k + 1) / s) m, s being ``SHELLS_PER_OCTAVE``.

    The sequence's number of the inner radius gives the outer radius instead, and the inner radius, or the area ratio if the
    inner radius is fixed, follows from it. If both are fixed, all designs have the outer radius that follows.

    Parameters
    ----------
    space
        Bounds; a variable whose bounds are equal is fixed.
    low, high
        Bounds, above 0, shape (variables,).
    sample
        Points of a Sobol sequence, 0 to 1, shape (n, variables).
    k
        Number of the shell.

    Returns
    -------
    Floats
        Designs, shape (variables, n), some of which may be beyond the bounds.
    """
    inner_index, ratio_index = (space.names.index(name) for name in ("inner_radius", "area_ratio"))
    designs: Floats = np.exp(np.log(low) + sample * (np.log(high) - np.log(low))).T
    radius = 2 ** ((k + sample[:, inner_index]) / SHELLS_PER_OCTAVE)
    ratio, gap = designs[ratio_index], designs[space.names.index("gap")]
    if inner_index in space.free:
        a, b, c = 1 + 1 / ratio, gap, gap**2 - radius**2  # a r^2 + 2 b r + c = 0 is r^2 / ratio = radius^2 - (r + gap)^2
        designs[inner_index] = (np.sqrt(np.maximum(b**2 - a * c, 0.0)) - b) / a
    elif ratio_index in space.free:
        inner = designs[inner_index]
        designs[ratio_index] = inner**2 / np.maximum(radius**2 - (inner + gap) ** 2, 1e-12)
    return designs


def _order_starts(designs: Floats, values: Floats) -> Ints:
    """Return the indices of designs in the order of IPOPT's starts: the best of each shell, then the second best, ..."""
    shells = np.floor(SHELLS_PER_OCTAVE * np.log2(ProbeSizes.from_vector(designs).outer_radius))
    best_first = np.argsort(-values, kind="stable")
    best_first = best_first[np.isfinite(values[best_first])]
    # turn: rank of each design within its shell; those without a finite objective come last
    turn = np.full(len(values), len(values))
    for shell in np.unique(shells):
        members = best_first[shells[best_first] == shell]
        turn[members] = np.arange(len(members))
    order = np.lexsort((-values, turn))
    return np.asarray([k for k in order if np.isfinite(values[k])], dtype=int)


def refine_by_ipopt(
    objective: ExactGradients,
    space: SearchSpace,
    start: Floats,
    *,
    poisson: tuple[float, float],
    steps: int,
    tolerance: float = IPOPT_TOLERANCE,
) -> Floats:
    """Return the local optimum near a design, shape (variables,), by a limited number of IPOPT's steps.

    Parameters
    ----------
    objective
        The objective to be maximised.
    space
        Bounds and constraints.
    start
        The design to start from, shape (variables,).
    poisson
        Poisson's ratios of both blocks.
    steps
        Maximum of IPOPT's steps.
    tolerance
        Of the objective.

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C, even if casadi catches it.
    """
    free = space.free
    formula = ObjectiveFunction(objective, start, free, poisson)
    x = ca.MX.sym("x", len(free))
    v = [ca.MX(value) for value in start]
    for position, k in enumerate(free):
        v[k] = ca.exp(x[position])
    value, margin = ca.vertsplit(formula(x))
    sizes = ProbeSizes.from_vector(v)
    constraints = ca.vertcat(sizes.outer_radius / space.outer_radius, sizes.wall / space.wall, margin)
    choices = IPOPT_OPTIONS | {"ipopt.max_iter": steps, "ipopt.tol": tolerance}
    solver = ca.nlpsol("design", "ipopt", {"x": x, "f": -value, "g": constraints}, choices)
    low, high = np.log(space.low[free]), np.log(space.high[free])
    x0 = np.clip(np.log(start[free]), low, high)
    # constraints in order: outer radius up to its limit, wall at least its minimum, charge at least its minimum
    solution = solver(x0=x0, lbx=low, ubx=high, lbg=[0.0, 1.0, 0.0], ubg=[1.0, np.inf, np.inf])
    optimum = start.copy()
    optimum[free] = np.exp(np.array(solution["x"]).ravel())
    if solver.stats()["return_status"] == "User_Requested_Stop":  # casadi turns an interrupt into a status
        raise KeyboardInterrupt
    return np.asarray(np.clip(optimum, space.low, space.high))


def _sort_designs(designs: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return designs and their objectives, best first."""
    order = np.argsort(-values, kind="stable")
    return designs[:, order], values[order]
