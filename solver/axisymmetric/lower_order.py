"""Bound errors from one mesh, by comparison with solutions of lower polynomial order on the same mesh.

Without the functions of degree p on edges, the same element matrices are those of a smaller space: nothing is integrated or
condensed again, and a factorisation of at most two thirds of the unknowns gives the change by the last degree. The change by the
degree before is at most the energy of the smaller state's own part of degree p - 1: the best state without that part is closer.
With w_i the change of state i and W = w_1 + w_2, the film force F_ij changes by exactly the energy a(w_i, w_j) (Galerkin's
orthogonality). With a_e the energy in element e, the sum of magnitudes over the elements excludes that changes cancel unnoticed:

    e_i = sum over elements c_e d_e,   d_e = |a_e(w_i, W)| + 1/10 sqrt(a_e(w_i, w_i) a_e(W, W))        (AX.10)
    c_e = min(c, max(6/5, k q / (1 - q))),   q = d_e over that of the smaller state's part of degree p - 1        (AX.11)

Here e_i bounds the error of film i's total (its charge, where w_i is the change of its film state), d_e is the size of the
change in element e, and c_e is a safety factor. Errors at corners fall as p^-2 with the degree p: 16/9, 25/11 and 36/13 of the
last change then remain at degrees 4 to 6, twice q / (1 - q). Where changes fall by the factor q with each degree, q / (1 - q)
of the last change remains, and at least the change itself once only a corner's error is left. c = 5/2, 5/2 and 4 at degrees 4
to 6, and k = 12 at degree 4; above that degree c_e = c, as changes in elements that are much longer than wide then fall more
slowly than before (``benchmarks/extremes/one_mesh.py``). Cells at an interface's end at the tissue's side, where a soft film is
squeezed out under a stiff skin, are long and change little from degree to degree: c_e = 16 there.

A charge's error lies mostly in thin cells of its film and bonds, whose fields at the walls fall quickly with the degree: its c_e
is ``CHARGE_SHARE_OF_ORDER`` of a force's. At degree 4 this holds for cells of the probe alone, as the tissue's are large there.

From degree 5 on the state's own part of degree p gives nearly as good a bound without a factorisation: its energy is at least
that of w, as the smaller state is the best of all without that part. c_e = 11/5 and 12/5 then. One step of descent from it
(``base_states.approximate_lower_order``) comes close to the best state; the energy it has in excess widens the bounds.

A curve's states at every modulus are sums of a few vectors (eq. AX.9), and so are those of the smaller space, the best of these
vectors' projections on it. Better states may exist, so that these energies are never too small:

    e_i(t) = max over t' of [e_i / sqrt(a(w_i, w_i) a(W, W))](t') times sqrt(a(w_i, w_i) a(W, W))(t)        (AX.12)

with t the target's modulus relative to that of the solved states, e_i the bound of eq. AX.10 and a(w_i, w_j) the energy of the
changes, both at that modulus; t' are the two nearest of five moduli, one on either side of t, at which eq. AX.10 is evaluated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.mesh import find_interface_ends
from geometry.meridian.section import STACKS, TISSUES, Body, Section
from solver.axisymmetric.base_states import (
    MeridianModel,
    approximate_lower_order,
    find_values_of_degree,
    project_to_lower_order,
    scale_inclusion,
    sum_products,
)
from solver.axisymmetric.modulus_response import StateCurve
from solver.axisymmetric.refinement import SampleErrors
from solver.axisymmetric.sample import MeshSample
from solver.linalg.rational_response import RationalResponse

ERROR_FACTOR_OF_ORDER = {4: 2.5, 5: 2.5, 6: 4.0, 8: 4.0}  # by order: c of eq. AX.10
OWN_DEGREE_FACTOR_OF_ORDER = {5: 2.2, 6: 2.4}  # likewise, for the state's own part of degree p
INTERFACE_END_FACTOR = 16.0  # c_e in cells at interfaces' ends at the tissue's side
RATE_FACTOR_OF_ORDER = {4: 12.0}  # by order: k of eq. AX.11
MIN_ERROR_FACTOR = 1.2  # of eq. AX.11
# of a force's c_e, for charges: bounds of 300 random charges, each at 0.01, 0.002 and 0.001, were at least 1.4 times the error
CHARGE_SHARE_OF_ORDER = {4: 0.6, 5: 0.5, 6: 0.5, 8: 0.5}
OWN_DEGREE_CHARGE_SHARE_OF_ORDER = {5: 0.4, 6: 0.5}  # likewise, for the state's own part of degree p
MIN_SHARED_TISSUE_ORDER = 5  # below it the tissue's part of a charge's error is not smaller than that of a force's
MAX_LAMBDA_OVER_TWO_MU = 12.0  # above it one step of descent leaves half of the energy or more
CANCELLATION_FACTOR = 0.1  # the factor 1/10 of eq. AX.10
DEPENDENT_RELATIVE = 1e-12  # of the largest energy: vectors with less count as dependent
SAMPLED_MODULI = 5  # moduli of a curve at which eq. AX.12 uses single elements
SENSITIVITY_FACTOR = 2.0  # times the change of each film's log-sensitivity by the last degree


def is_graded_everywhere(section: Section) -> bool:
    """Return whether the mesh is graded at every singular point that matters, as eq. AX.10 requires.

    With an elastic base or round edges it is not.
    """
    return not np.any(section.flange_thickness != 0) and not np.any(section.edge_radius != 0)


@dataclass(frozen=True)
class _Change:
    """The difference between the states of a smaller space and those of the full space, at every modulus.

    Attributes
    ----------
    model
        The model on the full space.
    values
        Vectors that span the difference, elements' values, shape (n, 8 p, m).
    loads
        Their forces, shape (n, 8 p, m).
    lower, full
        The states of the smaller and of the full space; for a curve ``values`` holds the vectors of both.
    """

    model: MeridianModel
    values: Floats
    loads: Floats
    lower: StateCurve
    full: StateCurve

    @classmethod
    def from_curves(cls, model: MeridianModel, lower: StateCurve, full: StateCurve) -> _Change:
        """Build the difference of two curves of states.

        For one modulus (``full.rational`` None) it is the difference of their vectors; for several, the curves have different
        vectors, so that both sets are kept.
        """
        values = lower.edges - full.edges if full.rational is None else np.concatenate([lower.edges, full.edges], axis=2)
        return cls(model, values, model.system.stiffness @ values, lower, full)

    def compute_coefficients(self, ratios: Floats) -> Floats:
        """Return the coefficients of the states' differences on the vectors at some ratios of the modulus, shape (k, m, s)."""
        lower = self.lower.compute_states(ratios)[0]
        return lower if self.full.rational is None else np.hstack([lower, -self.full.compute_states(ratios)[0]])

    def compute_energies(self, ratios: Floats) -> Floats:
        """Return energies a(w_i, w_j) at some ratios of the modulus, shape (k, s, s)."""
        coefficients = self.compute_coefficients(ratios)
        energies = np.asarray(coefficients.transpose(0, 2, 1) @ sum_products(self.values, self.loads) @ coefficients)
        if self.full.rational is None:
            return energies
        return energies + (ratios[:, None, None] - 1) * _compute_inclusion_energies(self.model, self.values, coefficients)

    def compute_element_energies(self, ratios: Floats) -> Floats:
        """Return energies a_e(w_i, w_j) by element, (k, n, s, s): w at ``ratios``, a_e with the model's own moduli."""
        coefficients = self.compute_coefficients(ratios)
        values, loads = (_combine_vectors(vectors, coefficients) for vectors in (self.values, self.loads))
        return _multiply_states(values, loads, coefficients.shape[2])


def bound_by_lower_order(sample: MeshSample) -> SampleErrors:
    """Bound the errors of a sample by its projection to the next lower order, one in ``ERROR_FACTOR_OF_ORDER``."""
    model, full = sample.states.model, sample.state_curve
    lower = _project_curve(sample, full, model.shapes.order - 1)
    return _build_errors(sample, _Change.from_curves(model, lower, full), _Factors.from_order(model.shapes.order))


def bound_by_descent(sample: MeshSample) -> SampleErrors | None:
    """Bound the errors of a sample by one step of descent, in at most half of the time of a projection.

    None for several moduli, or where Poisson's ratio is too near to 1/2 (``MAX_LAMBDA_OVER_TWO_MU``).
    """
    model, full = sample.states.model, sample.state_curve
    in_bulk = ~np.isin(model.mesh.body, STACKS)  # thin layers hold little of the change's energy, whatever their moduli
    if full.rational is not None or np.any((model.law.dilation_modulus > MAX_LAMBDA_OVER_TWO_MU * model.law.two_mu) & in_bulk):
        return None
    values, loads = approximate_lower_order(sample.states)
    change = _Change(model, values, loads, StateCurve(full.edges + values), full)
    return _build_errors(sample, change, _Factors.from_order(model.shapes.order))


def bound_by_last_degree(sample: MeshSample) -> SampleErrors | None:
    """Bound the errors of a sample by the energy of its last degree: wider bounds in a tenth of the time.

    None where the order is not in ``OWN_DEGREE_FACTOR_OF_ORDER``.
    """
    model, full, order = sample.states.model, sample.state_curve, sample.states.model.shapes.order
    if order not in OWN_DEGREE_FACTOR_OF_ORDER:
        return None
    if full.rational is None:
        values, loads = sample.states.last_degree_removal
        change = _Change(model, values, loads, StateCurve(full.edges + values), full)
    else:
        values = full.edges.copy()
        values[:, find_values_of_degree(model, order)] = 0.0
        change = _Change.from_curves(model, StateCurve(values, full.rational), full)
    return _build_errors(
        sample, change, _Factors(OWN_DEGREE_FACTOR_OF_ORDER[order], None, OWN_DEGREE_CHARGE_SHARE_OF_ORDER[order])
    )


@dataclass(frozen=True)
class _Factors:
    """c of eq. AX.10, k of eq. AX.11 (None where c_e = c), and the share of c_e that charges have."""

    error: float
    rate: float | None
    charge_share: float

    @classmethod
    def from_order(cls, order: int) -> _Factors:
        """Return those of the best states of the next lower order."""
        return cls(ERROR_FACTOR_OF_ORDER[order], RATE_FACTOR_OF_ORDER.get(order), CHARGE_SHARE_OF_ORDER[order])


def _build_errors(sample: MeshSample, change: _Change, factors: _Factors) -> SampleErrors:
    """Build error bounds from a smaller space, by eq. AX.10 and, where changes may fall faster, eq. AX.11.

    The log-sensitivity is the difference of those of both films. The error of each is bounded by its change with the last degree
    plus, in case that vanishes by chance, the relative error of the film's force times the sensitivity. A smaller system that is
    solved inaccurately widens the bounds: the exact solution has the smallest energy.
    """
    ratios, lower, totals = sample.modulus_ratios, change.lower, sample.totals
    energies = change.compute_energies(ratios)
    bound = _compute_error_ratios(sample, change, factors) * _bound_products(energies)
    sensitivities = _divide(sample.product_derivatives.sum(axis=2), totals)  # of each film's force and charge
    lower_energies = _compute_inclusion_energies(change.model, lower.edges, lower.compute_states(ratios)[0])
    lower_sensitivities = _divide(ratios[:, None] * _sum_bases(lower_energies), totals + _sum_bases(energies))
    # relative to the smallest force within the error; 0 without variation
    relative_bound = _divide(bound, np.maximum(np.abs(totals) - bound, 0.0), np.inf)
    vanishing_guard = np.multiply(
        np.abs(sensitivities), relative_bound, out=np.zeros_like(relative_bound), where=sensitivities != 0
    )
    film_bounds = SENSITIVITY_FACTOR * np.abs(lower_sensitivities - sensitivities) + vanishing_guard
    # inner and outer film together, of forces and of charges
    return SampleErrors(_replace_nan(bound + sample.rounding), _replace_nan(film_bounds[:, ::2] + film_bounds[:, 1::2]))


def _project_curve(sample: MeshSample, full: StateCurve, degree: int) -> StateCurve:
    """Project the vectors of a curve to a lower degree, and return the curve of the best states on them.

    For a curve of moduli, the projected vectors are made orthonormal in energy, without those that depend on others; on them the
    states are given by eq. AX.8 again.
    """
    model = sample.states.model
    count = full.count
    values = project_to_lower_order(sample.states, full.edges[..., count:], degree, float(sample.modulus_ratios.max()))
    if full.rational is None:
        return StateCurve(values)
    states, vectors = values[..., :count], values[..., count:]
    sizes, turn = np.linalg.eigh(sum_products(vectors, model.system.stiffness @ vectors))
    independent = sizes > DEPENDENT_RELATIVE * sizes[-1]
    vectors = vectors @ (turn[:, independent] / np.sqrt(sizes[independent]))
    inclusion = np.flatnonzero(model.mesh.body == Body.INCLUSION)
    loads, unused = model.system.stiffness[inclusion] @ vectors[inclusion], np.zeros((count, 2))
    rational = RationalResponse.from_energies(
        sum_products(vectors[inclusion], loads), sum_products(loads, states[inclusion]), start=unused, inside=unused
    )
    return StateCurve(np.concatenate([states, vectors @ rational.turn], axis=2), rational)


def _compute_inclusion_energies(model: MeridianModel, values: Floats, coefficients: Floats) -> Floats:
    """Return energies within the inclusion, at the model's own modulus, of k sets of states, shape (k, s, s).

    The states are sums of the vectors ``values``, (n, 8 p, m), with ``coefficients``, (k, m, s).
    """
    inclusion = np.flatnonzero(model.mesh.body == Body.INCLUSION)
    vectors = values[inclusion]
    products = sum_products(vectors, model.system.stiffness[inclusion] @ vectors)
    return np.asarray(coefficients.transpose(0, 2, 1) @ products @ coefficients)


def _compute_error_ratios(sample: MeshSample, change: _Change, factors: _Factors) -> Floats:
    """Return the first factor of eq. AX.12, e_i over the Cauchy-Schwarz bound of its energies, shape (k, s).

    It changes little with the modulus, so that it is computed at ``SAMPLED_MODULI`` moduli only.
    """
    model, order = change.model, change.model.shapes.order
    ratios = (
        np.ones(1)
        if sample.curve is None
        else np.geomspace(sample.modulus_ratios.min(), sample.modulus_ratios.max(), SAMPLED_MODULI)
    )
    scales = np.stack([scale_inclusion(model, ratio) for ratio in ratios])
    energies = scales * change.compute_element_energies(ratios)
    sizes = _compute_sizes(energies)
    weights = np.full_like(sizes, factors.error)  # c_e
    if factors.rate is not None:
        previous = _compute_sizes(scales * _compute_degree_energies(model, change.lower, order - 1, ratios))
        steady = factors.rate * _divide(sizes, np.maximum(previous - sizes, 0.0), np.inf)  # eq. AX.11
        weights = np.clip(steady, MIN_ERROR_FACTOR, weights)
    shared = ~np.isin(model.mesh.body, TISSUES) if order < MIN_SHARED_TISSUE_ORDER else slice(None)
    weights[:, shared, 2:] *= factors.charge_share
    weights[:, find_interface_ends(model.mesh)] = INTERFACE_END_FACTOR
    error_ratios = _divide((weights * sizes).sum(axis=1), _bound_products(energies.sum(axis=1)))
    # the two nearest of the sampled moduli, t' of eq. AX.12
    upper = np.clip(np.searchsorted(ratios, sample.modulus_ratios), min(1, len(ratios) - 1), len(ratios) - 1)
    return np.asarray(np.maximum(error_ratios[upper], error_ratios[np.maximum(upper - 1, 0)]))


def _compute_degree_energies(model: MeridianModel, states: StateCurve, degree: int, ratios: Floats) -> Floats:
    """Return the energies a_e, by element, of the parts of one degree of the states, shape (k, n, s, s).

    The states are those at ``ratios`` of the modulus, shape (k,); a_e is taken with the model's own moduli.
    """
    chosen = find_values_of_degree(model, degree)
    parts = _combine_vectors(states.edges[:, chosen], states.compute_states(ratios)[0])
    return _multiply_states(parts, model.system.stiffness[:, chosen[:, None], chosen] @ parts, states.count)


def _combine_vectors(values: Floats, coefficients: Floats) -> Floats:
    """Combine vectors (n, f, m) by k sets of coefficients, (k, m, s), to shape (n, f, s k)."""
    return np.asarray(values @ coefficients.transpose(1, 0, 2).reshape(coefficients.shape[1], -1))


def _multiply_states(values: Floats, loads: Floats, count: int) -> Floats:
    """Return products of k sets of s = ``count`` states, element by element, (k, n, s, s), from values and loads (n, f, s k)."""
    n, functions, _ = values.shape
    a, b = (array.reshape(n, functions, -1, count).transpose(2, 0, 1, 3) for array in (values, loads))
    return np.asarray(a.transpose(0, 1, 3, 2) @ b)


def _sum_bases(energies: Floats) -> Floats:
    """Return a(w_i, W) from a(w_i, w_j), with W the sum of both base states' changes, the first two: (..., s, s) to (..., s)."""
    return np.asarray(energies[..., :2].sum(axis=-1))


def _bound_products(energies: Floats) -> Floats:
    """Return the Cauchy-Schwarz bounds sqrt(a(w_i, w_i) a(W, W)) from a(w_i, w_j), (k, s, s) to (k, s)."""
    total = _sum_bases(energies)[..., :2].sum(axis=-1)
    return np.asarray(np.sqrt(np.abs(np.diagonal(energies, axis1=1, axis2=2) * total[:, None])))


def _compute_sizes(energies: Floats) -> Floats:
    """Return d_e of eq. AX.10, the size of the change in an element, from a_e(w_i, w_j), (..., s, s) to (..., s)."""
    bases, single = _sum_bases(energies), np.diagonal(energies, axis1=-2, axis2=-1)
    total = bases[..., :2].sum(axis=-1)
    return np.asarray(np.abs(bases) + CANCELLATION_FACTOR * np.sqrt(np.abs(single * total[..., None])))


def _replace_nan(bounds: Floats) -> Floats:
    """Return bounds with infinity in place of NaN, which rounding may cause."""
    return np.where(np.isnan(bounds), np.inf, bounds)


def _divide(numerator: Floats, denominator: Floats, otherwise: float = 0.0) -> Floats:
    """Return the quotients of two arrays of one shape; ``otherwise`` where a denominator is 0."""
    return np.divide(numerator, denominator, out=np.full_like(denominator, otherwise), where=denominator != 0)
