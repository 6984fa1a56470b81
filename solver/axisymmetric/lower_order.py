"""Error bounds from one mesh: its answer against that of lower order on its corners and edges.

Functions of degree p on edges left out, the same element matrices are those of a smaller space: nothing is integrated or
condensed again, and a factorisation of two thirds of the unknowns or less tells what the last degree changed. With w the
change of a state, F_ij changes by the energy a(w_i, w_j) exactly (Galerkin's orthogonality), element by element, so that changes
cannot cancel unseen:

    e_i = c (sum over elements |a(w_i, w_1 + w_2)| + 1/10 sqrt(a(w_i, w_i) a(w_1 + w_2, w_1 + w_2)))        (AX.10)

bounds film i's total. Were all errors those of corners, where p^-2 is left at degree p, 4/5, 9/7, 16/9 and 25/11 of the change
would be left at degrees 3 to 6; elsewhere a tenth and less is. c = 3/2, 2, 5/2 and 4 (``benchmarks/extremes/one_mesh.py``).
"""

from __future__ import annotations

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.section import Body, Section
from solver.axisymmetric.base_states import products
from solver.axisymmetric.condensed_system import System
from solver.axisymmetric.dofs import numbering
from solver.axisymmetric.refinement import SampleErrors
from solver.axisymmetric.sample import MeshSample

FACTORS = {3: 1.5, 4: 2.0, 5: 2.5, 6: 4.0}  # by order: c of eq. AX.10
CANCELLING = 0.1  # of eq. AX.10
SLOPES = 2.0  # times: what the last degree changed of each film's log-sensitivity


def graded_everywhere(section: Section) -> bool:
    """Return whether the mesh has layers of cells at every singular point, which eq. AX.10 needs.

    Interfaces of the tissue meet its side and the sphere ungraded: under a skin 7000 times as stiff as what lies below, the error
    was 5 times the bound.
    """
    return not (section.interfaces or section.has_details or np.any(section.edge_radius != 0))


def order_errors(sample: MeshSample) -> SampleErrors:
    """Bounds on the errors of a sample of one modulus, from its own mesh.

    The log-sensitivity is the difference of both films' own: each of these is bounded by what the last degree changed of it and,
    should that vanish by chance, by as large a share of itself as its film's force. A smaller system that is solved badly adds to
    the bounds: its energy is the least.
    """
    states = sample.states
    model, stiffness = states.model, states.model.system.stiffness
    change = lower_order(sample) - states.edge
    energies = change.transpose(0, 2, 1) @ (stiffness @ change)  # (n, 2, 2)
    by_total, whole = energies.sum(axis=2), energies.sum()
    size = np.sqrt(np.abs(np.diag(energies.sum(axis=0)) * whole))
    bound = FACTORS[model.shapes.order] * (np.abs(by_total).sum(axis=0) + CANCELLING * size)
    totals, slope = sample.totals[0], sample.slope[0].sum(axis=1)
    inside = np.flatnonzero(model.mesh.body == Body.INCLUSION)
    lower = (states.edge + change)[inside]
    lower_slope, lower_totals = products(lower, stiffness[inside] @ lower).sum(axis=1), totals + by_total.sum(axis=0)
    share = _share(slope, totals)
    films = SLOPES * np.abs(_share(lower_slope, lower_totals) - share) + np.abs(share) * _share(bound, np.abs(totals))
    return SampleErrors(_known(bound[None] + sample.rounding), _known(films.sum(keepdims=True)))


def lower_order(sample: MeshSample) -> Floats:
    """Values of the elements in both states with edge functions of degree p - 1 at most, shape (n, 8 p, 2)."""
    model = sample.states.model
    degrees = model.shapes.degrees[: model.shapes.skeleton].max(axis=1)
    kept = np.flatnonzero(np.tile(degrees, 2) < model.shapes.order)
    numbers = numbering(model.mesh, model.shapes.order - 1, model.interface)
    smaller = System.of(numbers, np.ascontiguousarray(model.system.stiffness[:, kept][:, :, kept]))
    values = np.zeros_like(sample.states.edge)
    values[:, kept] = smaller.own(-smaller.factor.solve(smaller.lifted(numbers.lift)), numbers.lift)
    return values


def _known(bounds: Floats) -> Floats:
    """Infinite where rounding has left no number."""
    return np.where(np.isnan(bounds), np.inf, bounds)


def _share(part: Floats, whole: Floats) -> Floats:
    """Parts over wholes; 0 where a whole is 0."""
    return np.divide(part, whole, out=np.zeros_like(whole), where=whole != 0)
