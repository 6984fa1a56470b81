"""The closed-form search: quasi-random designs on arrays, then IPOPT with exact gradients from the best of every size.

What is screened does not depend on a limit but by what the limit takes away, and IPOPT starts from the best design of each
shell of outer radii before it starts from the second best of any: a wider limit adds designs and starts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np
from scipy.stats import qmc

from geometry.common.arrays import Floats, Ints
from probe_design.design_search.steered_population import DesignObjective
from probe_design.optimisation.design_space import Space
from probe_design.optimisation.global_search import IPOPT_QUIET_OPTIONS, SHELLS_PER_OCTAVE, raise_user_interrupt
from solver.casadi_functions.base import DifferentiableFunction

SOBOL_SEED = 21
SCREENED_PER_SHELL = 64  # designs in each shell, a power of two as Sobol's sequence likes it
IPOPT_STARTS, MAX_IPOPT_STEPS = 4, 25  # of IPOPT
BOUNDS_TOLERANCE_RELATIVE = 1e-9  # relative: bounds this near are one value


@dataclass(frozen=True)
class FoundDesigns:
    """Designs of a search, best first, shape (6 or 7, n), and their objectives by the closed form, shape (n,)."""

    designs: Floats
    values: Floats


class ExactGradients(Protocol):
    """An objective with exact derivatives, as IPOPT needs it."""

    def gradient(self, x: Floats, poisson: tuple[float, float], which: list[int]) -> tuple[Floats, Floats]:
        """See ``DesignObjective.gradient``."""


class ObjectiveFunction(DifferentiableFunction):
    """ln of some variables -> the objective, and the margin of the weaker channel's charge, with exact derivatives.

    Args:
        steered: the objective.
        start: all variables.
        which: those that vary.
        poisson: ratios of both blocks.
    """

    def __init__(self, steered: ExactGradients, start: Floats, which: list[int], poisson: tuple[float, float]) -> None:
        super().__init__()
        self.steered, self.start, self.which, self.poisson = steered, start, which, poisson
        self.evaluations = 0
        self.begin("population", len(which), 2)

    def compute(self, x: Floats) -> tuple[Floats, Floats]:
        """Return both values and their derivatives; NaN where the formulas break down, from which IPOPT steps back."""
        design = self.start.copy()
        design[self.which] = np.exp(x)
        self.evaluations += 1
        return self.steered.gradient(design, self.poisson, self.which)


def search(
    steered: DesignObjective, space: Space, poisson: tuple[float, float], *, starts: int = IPOPT_STARTS,
    screened: int = SCREENED_PER_SHELL,
    steps: int = MAX_IPOPT_STEPS,
) -> FoundDesigns:  # fmt: skip
    """Search designs within bounds and return local optima and screened designs together, best first.

    Args:
        steered: the objective.
        space: bounds and constraints; a variable whose bounds are one value stays there.
        poisson: of both blocks.
        starts: from how many of the screened designs IPOPT starts.
        screened: designs in each shell of outer radii.
        steps: of IPOPT from each.
    """
    designs = screen(space, screened)
    values = steered.evaluate_designs(designs, poisson)
    free = [k for k in range(len(space.low)) if space.low[k] < space.high[k] * (1 - BOUNDS_TOLERANCE_RELATIVE)]
    if not free or not np.isfinite(values).any():
        return _sort_designs(designs, values)
    optima = [
        refine_by_ipopt(steered, space, designs[:, k], poisson=poisson, free=free, steps=steps)
        for k in _order_starts(space, designs, values)[:starts]
    ]
    all_designs = np.concatenate([np.array(optima).T, designs], axis=1)
    all_values = np.concatenate([steered.evaluate_designs(np.array(optima).T, poisson), values])
    keeps = _meets_constraints(space, all_designs)
    return _sort_designs(all_designs[:, keeps], all_values[keeps])


def screen(space: Space, count: int = SCREENED_PER_SHELL) -> Floats:
    """Return the admissible designs of Sobol sequences, even in the logarithms, shell by shell of outer radii, shape (6, n)."""
    low, high = np.maximum(space.low, 1e-12), np.maximum(space.high, 1e-12)
    if not np.any(low < high * (1 - BOUNDS_TOLERANCE_RELATIVE)):
        return low[:, None]
    min_radius = low[0] + low[2] + space.wall
    first, last = (
        math.floor(SHELLS_PER_OCTAVE * math.log2(radius)) for radius in (min_radius, max(space.outer_radius, min_radius))
    )
    sample = qmc.Sobol(len(low), seed=SOBOL_SEED).random(count)
    designs = np.concatenate([_sample_shell(space, low, high, sample, k) for k in range(first, last + 1)], axis=1)
    inside = space.admits(designs) & np.all(
        (designs >= low[:, None] * (1 - 1e-9)) & (designs <= high[:, None] * (1 + 1e-9)), axis=0
    )
    return np.concatenate([_build_corners(space, low, high), designs[:, inside]], axis=1)


def _build_corners(space: Space, low: Floats, high: Floats) -> Floats:
    """Return the design at the lower bounds and that in the middle of all bounds, those of them that are admissible."""
    middle = np.exp((np.log(low) + np.log(high)) / 2)
    candidates = np.array([low, middle]).T
    for column in candidates.T:
        min_radius = column[0] + column[2] + space.wall * (1 + 1e-9)
        widest = min(max(float(space.compute_outer_radius(column)), min_radius), max(space.outer_radius * (1 - 1e-9), min_radius))
        ratio = column[0] ** 2 / (widest**2 - (column[0] + column[2]) ** 2)
        column[1] = np.clip(ratio, low[1], high[1])
    return np.asarray(candidates[:, space.admits(candidates)])


def _sample_shell(space: Space, low: Floats, high: Floats, sample: Floats, k: int) -> Floats:
    """Sample designs with outer radii between 2^(k / SHELLS) and 2^((k + 1) / SHELLS) m; fixed variables take precedence."""
    radius = 2 ** ((k + sample[:, 0]) / SHELLS_PER_OCTAVE)
    ratio, gap, *other_variables = np.exp(np.log(low[1:]) + sample[:, 1:] * (np.log(high[1:]) - np.log(low[1:]))).T
    if low[0] < high[0] * (1 - BOUNDS_TOLERANCE_RELATIVE):
        a, b, c = 1 + 1 / ratio, gap, gap**2 - radius**2  # a r^2 + 2 b r + c = 0 is r^2 / ratio = radius^2 - (r + gap)^2
        inner = (np.sqrt(np.maximum(b**2 - a * c, 0.0)) - b) / a
    else:
        inner = np.full_like(radius, low[0])
        ring = np.maximum(radius**2 - (inner + gap) ** 2, 1e-12)
        ratio = inner**2 / ring if low[1] < high[1] * (1 - BOUNDS_TOLERANCE_RELATIVE) else ratio
    return np.array([inner, ratio, gap, *other_variables])


def _order_starts(space: Space, designs: Floats, values: Floats) -> Ints:
    """Return the indices of designs in the order of IPOPT's starts: the best of each shell, then the second best, ..."""
    shells = np.floor(SHELLS_PER_OCTAVE * np.log2(space.compute_outer_radius(designs)))
    best_first = np.argsort(-values, kind="stable")
    best_first = best_first[np.isfinite(values[best_first])]
    turn = np.full(len(values), len(values))
    for shell in np.unique(shells):
        members = best_first[shells[best_first] == shell]
        turn[members] = np.arange(len(members))
    order = np.lexsort((-values, turn))
    return np.asarray([k for k in order if np.isfinite(values[k])], dtype=int)


def refine_by_ipopt(
    steered: ExactGradients, space: Space, start: Floats, *, poisson: tuple[float, float], free: list[int], steps: int
) -> Floats:
    """Return the local optimum near a design (6,) by IPOPT; ``free`` are the variables that vary, ``steps`` its steps."""
    formula = ObjectiveFunction(steered, start, free, poisson)
    x = ca.MX.sym("x", len(free))
    v = [ca.MX(value) for value in start]
    for position, k in enumerate(free):
        v[k] = ca.exp(x[position])
    value, margin = ca.vertsplit(formula(x))
    radius = space.compute_outer_radius(v)
    constraints = ca.vertcat(radius / space.outer_radius, (radius - v[0] - v[2]) / space.wall, margin)
    choices: dict[str, Any] = {"ipopt.hessian_approximation": "limited-memory", "ipopt.max_iter": steps, "ipopt.tol": 1e-5}
    solver = ca.nlpsol("population", "ipopt", {"x": x, "f": -value, "g": constraints}, IPOPT_QUIET_OPTIONS | choices)
    solution = solver(
        x0=np.log(start[free]),
        lbx=np.log(space.low[free]),
        ubx=np.log(space.high[free]),
        lbg=[0.0, 1.0, 0.0],
        ubg=[1.0, np.inf, np.inf],
    )
    optimum = start.copy()
    optimum[free] = np.exp(np.array(solution["x"]).ravel())
    raise_user_interrupt(solver)
    return np.clip(optimum, space.low, space.high)


def _meets_constraints(space: Space, designs: Floats) -> Any:
    """Return which designs meet the constraints to 1e-6; IPOPT meets them to about 1e-8, and rounding removes the rest."""
    radius = space.compute_outer_radius(designs)
    return (radius <= space.outer_radius * (1 + 1e-6)) & (radius - designs[0] - designs[2] >= space.wall * (1 - 1e-6))


def _sort_designs(designs: Floats, values: Floats) -> FoundDesigns:
    order = np.argsort(-values, kind="stable")
    return FoundDesigns(designs[:, order], values[order])
