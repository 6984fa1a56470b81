"""Error bounds from one mesh: its answer against those of lower orders on its corners and edges.

Functions of degree p on edges left out, the same element matrices are those of a smaller space: nothing is integrated or
condensed again, and a factorisation of two thirds of the unknowns or less tells what the last degree changed; another, of fewer
still, what the one before it did. With w the change of a state and W = w_1 + w_2, F_ij changes by the energy a(w_i, w_j) exactly
(Galerkin's orthogonality), element by element, so that changes cannot cancel unseen:

    e_i = sum over elements c_e d_e,   d_e = |a_e(w_i, W)| + 1/10 sqrt(a_e(w_i, w_i) a_e(W, W))        (AX.10)
    c_e = min(c, max(1/4, k q / (1 - q))),   q = d_e at degree p over d_e at degree p - 1        (AX.11)

bounds film i's total. Were all errors those of corners, where p^-2 is left at degree p, 16/9, 25/11 and 36/13 of the change
would be left at degrees 4 to 6, twice q / (1 - q); where changes fall by q with each degree, q / (1 - q) is. c = 2, 5/2, 4 and
k = 6 at degree 4; above it c_e = c, for elements that are much longer than wide there fall less than they did before
(``benchmarks/extremes/one_mesh.py``).
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

MOST = {4: 2.0, 5: 2.5, 6: 4.0}  # by order: c of eq. AX.10
RATES = {4: 6.0}  # by order: k of eq. AX.11
LEAST = 0.25  # of eq. AX.11
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
    order = model.shapes.order
    low = lower_order(sample, order - 1)
    energies = _energies(stiffness, low - states.edge)
    last = _sizes(energies)
    left = np.full_like(last, MOST[order])
    if order in RATES:
        before = _sizes(_energies(stiffness, lower_order(sample, order - 2) - low))
        left = np.clip(RATES[order] * _share(last, np.maximum(before - last, 0.0), np.inf), LEAST, left)  # eq. AX.11
    bound = (left * last).sum(axis=0)
    totals, slope = sample.totals[0], sample.slope[0].sum(axis=1)
    inside = np.flatnonzero(model.mesh.body == Body.INCLUSION)
    lower_slope = products(low[inside], stiffness[inside] @ low[inside]).sum(axis=1)
    lower_totals = totals + energies.sum(axis=(0, 2))
    share = _share(slope, totals)
    films = SLOPES * np.abs(_share(lower_slope, lower_totals) - share) + np.abs(share) * _share(bound, np.abs(totals))
    return SampleErrors(_known(bound[None] + sample.rounding), _known(films.sum(keepdims=True)))


def lower_order(sample: MeshSample, degree: int) -> Floats:
    """Values of the elements in both states with edge functions up to a degree at most, shape (n, 8 p, 2)."""
    model = sample.states.model
    degrees = model.shapes.degrees[: model.shapes.skeleton].max(axis=1)
    kept = np.flatnonzero(np.tile(degrees, 2) <= degree)
    numbers = numbering(model.mesh, degree, model.interface)
    smaller = System.of(numbers, np.ascontiguousarray(model.system.stiffness[:, kept][:, :, kept]))
    values = np.zeros_like(sample.states.edge)
    values[:, kept] = smaller.own(-smaller.factor.solve(smaller.lifted(numbers.lift)), numbers.lift)
    return values


def _energies(stiffness: Floats, change: Floats) -> Floats:
    """a_e(w_i, w_j) of a change of both states, shape (n, 2, 2)."""
    return np.asarray(change.transpose(0, 2, 1) @ (stiffness @ change))


def _sizes(energies: Floats) -> Floats:
    """d_e of eq. AX.10, shape (n, 2)."""
    whole, single = energies.sum(axis=(1, 2)), np.diagonal(energies, axis1=1, axis2=2)
    return np.asarray(np.abs(energies.sum(axis=2)) + CANCELLING * np.sqrt(np.abs(single * whole[:, None])))


def _known(bounds: Floats) -> Floats:
    """Infinite where rounding has left no number."""
    return np.where(np.isnan(bounds), np.inf, bounds)


def _share(part: Floats, whole: Floats, otherwise: float = 0.0) -> Floats:
    """Parts over wholes; ``otherwise`` where a whole is 0."""
    return np.divide(part, whole, out=np.full_like(whole, otherwise), where=whole != 0)
