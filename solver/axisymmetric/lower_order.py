"""Bound errors from one mesh, by comparison with solutions of lower polynomial order on the same mesh.

Without the functions of degree p on edges, the same element matrices are those of a smaller space: nothing is integrated or
condensed again, and a factorisation of at most two thirds of the unknowns gives the change by the last degree. The change by the
degree before is at most the energy of the smaller state's own part of degree p - 1: the best state without that part is closer.
With w_i the change of state i and W = w_1 + w_2, the film force F_ij changes by exactly the energy a(w_i, w_j) (Galerkin's
orthogonality). With a_e the energy in element e, the sum of magnitudes over the elements excludes that changes cancel unnoticed:

    e_i = sum over elements c_e d_e,   d_e = |a_e(w_i, W)| + 1/10 sqrt(a_e(w_i, w_i) a_e(W, W))        (AX.10)
    c_e = min(c, max(6/5, k q / (1 - q))),   q = d_e over that of the smaller state's part of degree p - 1        (AX.11)

Here e_i bounds the error of film i's total, d_e is the size of the change in element e, and c_e is a safety factor. Errors at
corners fall as p^-2 with the degree p: 16/9, 25/11 and 36/13 of the last change then remain at degrees 4 to 6, twice q / (1 - q).
Where changes fall by the factor q with each degree, q / (1 - q) of the last change remains, and at least the change itself once
only a corner's error is left. c = 5/2, 5/2 and 4 at degrees 4 to 6, and k = 12 at degree 4; above that degree c_e = c, as changes
in elements that are much longer than wide then fall more slowly than before (``benchmarks/extremes/one_mesh.py``).
Cells at an interface's end at the tissue's side, where a soft film is squeezed out under a stiff skin, are long and change
little from degree to degree: c_e = 16 there.

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
from geometry.meridian.section import Body, Section
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
MAX_LAMBDA_OVER_TWO_MU = 12.0  # above it one step of descent leaves half of the energy or more
CANCELLATION_FACTOR = 0.1  # the factor 1/10 of eq. AX.10
DEPENDENT_RELATIVE = 1e-12  # of the largest energy: vectors with less count as dependent
SAMPLED_MODULI = 5  # moduli of a curve at which eq. AX.12 uses single elements
SENSITIVITY_FACTOR = 2.0  # times the change of each film's log-sensitivity by the last degree


def is_graded_everywhere(section: Section) -> bool:
    """Return whether the mesh is graded at every singular point, as eq. AX.10 requires.

    With films, an elastic base or round edges it is not.
    """
    return not (section.has_details or np.any(section.edge_radius != 0))


@dataclass(frozen=True)
class _Change:
    """The difference between the states of a smaller space and those of the whole, at every modulus.

    Attributes
    ----------
    values
        Vectors that span the difference, elements' values, shape (n, 8 p, m).
    loads
        Their forces, shape (n, 8 p, m).
    low, whole
        The states of the smaller and the whole space; for a curve ``values`` holds the vectors of both.
    """

    values: Floats
    loads: Floats
    low: StateCurve
    whole: StateCurve

    @classmethod
    def from_curves(cls, model: MeridianModel, low: StateCurve, whole: StateCurve) -> _Change:
        """Build the difference of two curves; with several moduli their vectors differ, so that both sets are used."""
        values = low.edges - whole.edges if whole.rational is None else np.concatenate([low.edges, whole.edges], axis=2)
        return cls(values, model.system.stiffness @ values, low, whole)

    def compute_coefficients(self, times: Floats) -> Floats:
        """Return the coefficients of both states' difference on the vectors at some moduli, shape (k, m, 2)."""
        return (
            self.low.compute_states(times)[0]
            if self.whole.rational is None
            else np.hstack([self.low.compute_states(times)[0], -self.whole.compute_states(times)[0]])
        )

    def compute_energies(self, times: Floats) -> Floats:
        """Return energies a_e(w_i, w_j) by element, (k, n, 2, 2): w at ``times``, a_e with the model's own moduli."""
        turn = self.compute_coefficients(times)
        return _multiply_pairs(_combine_vectors(self.values, turn), _combine_vectors(self.loads, turn))


def bound_by_lower_order(sample: MeshSample) -> SampleErrors:
    """Bound the errors of a sample by its projection to the next lower order, one in ``ERROR_FACTOR_OF_ORDER``."""
    whole, order = sample.curve or StateCurve(sample.states.edge), sample.states.model.shapes.order
    low = _project_curve(sample, whole, order - 1)
    return _build_errors(
        sample,
        _Change.from_curves(sample.states.model, low, whole),
        ERROR_FACTOR_OF_ORDER[order],
        RATE_FACTOR_OF_ORDER.get(order),
    )


def bound_by_descent(sample: MeshSample) -> SampleErrors | None:
    """Bound the errors of a sample by one step of descent, in at most half of the time of a projection.

    None for several moduli, or where Poisson's ratio is above 0.48.
    """
    whole, order, law = sample.curve or StateCurve(sample.states.edge), sample.states.model.shapes.order, sample.states.model.law
    if whole.rational is not None or np.any(law.dilation_modulus > MAX_LAMBDA_OVER_TWO_MU * law.two_mu):
        return None
    values, loads = approximate_lower_order(sample.states, order - 1)
    change = _Change(values - whole.edges, loads, StateCurve(values), whole)
    return _build_errors(sample, change, ERROR_FACTOR_OF_ORDER[order], RATE_FACTOR_OF_ORDER.get(order))


def bound_by_last_degree(sample: MeshSample) -> SampleErrors | None:
    """Bound the errors of a sample by the energy of its last degree: wider bounds in a tenth of the time.

    None where the order is not in ``OWN_DEGREE_FACTOR_OF_ORDER``.
    """
    whole, order = sample.curve or StateCurve(sample.states.edge), sample.states.model.shapes.order
    if order not in OWN_DEGREE_FACTOR_OF_ORDER:
        return None
    values = whole.edges.copy()
    values[:, find_values_of_degree(sample.states.model, order)] = 0.0
    low = StateCurve(values, whole.rational)
    return _build_errors(sample, _Change.from_curves(sample.states.model, low, whole), OWN_DEGREE_FACTOR_OF_ORDER[order])


def _build_errors(sample: MeshSample, change: _Change, factor: float, rate: float | None = None) -> SampleErrors:
    """Build error bounds from a smaller space, by c of eq. AX.10 and, where changes may fall faster, k of eq. AX.11.

    The log-sensitivity is the difference of those of both films. The error of each is bounded by its change with the last degree
    plus, in case that vanishes by chance, the relative error of the film's force times the sensitivity. A smaller system that is
    solved inaccurately widens the bounds: the exact solution has the smallest energy.
    """
    times, low = sample.times, change.low
    energies = _compute_energies(sample, change)
    bound = _compute_shares(sample, change, factor, rate) * _bound_products(energies)
    totals, slope = sample.totals, sample.modulus_derivative.sum(axis=2)
    share = _divide(slope, totals)
    lower_slope = times[:, None] * _compute_inclusion_energies(sample, low.edges, low.compute_states(times)[0]).sum(axis=2)
    moved = np.abs(_divide(lower_slope, totals + energies.sum(axis=2)) - share)
    part = _divide(bound, np.maximum(np.abs(totals) - bound, 0.0), np.inf)  # relative to the smallest force within the error
    films = SENSITIVITY_FACTOR * moved + np.multiply(
        np.abs(share), part, out=np.zeros_like(part), where=share != 0
    )  # 0 without variation
    return SampleErrors(_replace_nan(bound + sample.rounding), _replace_nan(films.sum(axis=1)))


def _project_curve(sample: MeshSample, whole: StateCurve, degree: int) -> StateCurve:
    """Project the vectors of a curve to a lower degree, and return the best states on them."""
    model = sample.states.model
    values = project_to_lower_order(sample.states, whole.edges[..., 2:], degree, float(sample.times.max()))
    if whole.rational is None:
        return StateCurve(values)
    states, vectors = values[..., :2], values[..., 2:]
    size, turn = np.linalg.eigh(sum_products(vectors, model.system.stiffness @ vectors))
    independent = size > DEPENDENT_RELATIVE * size[-1]
    vectors = vectors @ (turn[:, independent] / np.sqrt(size[independent]))
    inside = np.flatnonzero(model.mesh.body == Body.INCLUSION)
    part = model.system.stiffness[inside] @ vectors[inside]
    nothing = np.zeros((2, 2))
    rational = RationalResponse.from_energies(
        sum_products(vectors[inside], part), sum_products(part, states[inside]), start=nothing, inside=nothing
    )
    return StateCurve(np.concatenate([states, vectors @ rational.turn], axis=2), rational)


def _compute_inclusion_energies(sample: MeshSample, values: Floats, coefficients: Floats) -> Floats:
    """Return energies within the inclusion, at the modulus of ``sample.states``, shape (k, 2, 2)."""
    inside = np.flatnonzero(sample.states.model.mesh.body == Body.INCLUSION)
    part = values[inside]
    return np.asarray(
        coefficients.transpose(0, 2, 1) @ sum_products(part, sample.states.model.system.stiffness[inside] @ part) @ coefficients
    )


def _compute_energies(sample: MeshSample, change: _Change) -> Floats:
    """Return energies a(w_i, w_j) at all moduli, shape (k, 2, 2)."""
    times, coefficients = sample.times, change.compute_coefficients(sample.times)
    energies = np.asarray(coefficients.transpose(0, 2, 1) @ sum_products(change.values, change.loads) @ coefficients)
    if change.whole.rational is None:
        return energies
    return np.asarray(energies + (times[:, None, None] - 1) * _compute_inclusion_energies(sample, change.values, coefficients))


def _compute_shares(sample: MeshSample, change: _Change, factor: float, rate: float | None = None) -> Floats:
    """Return the first factor of eq. AX.12, which changes little with the modulus, shape (k, 2)."""
    model, order = sample.states.model, sample.states.model.shapes.order
    times = np.ones(1) if sample.curve is None else np.geomspace(sample.times.min(), sample.times.max(), SAMPLED_MODULI)
    stiffness = np.stack([scale_inclusion(model, time) for time in times])
    energies = stiffness * change.compute_energies(times)
    last = _compute_sizes(energies)
    left = np.full_like(last, factor)
    if rate is not None:
        previous = _compute_sizes(stiffness * _compute_degree_energies(model, change.low, order - 1, times))
        left = np.clip(rate * _divide(last, np.maximum(previous - last, 0.0), np.inf), MIN_ERROR_FACTOR, left)  # eq. AX.11
    left[:, find_interface_ends(model.mesh)] = INTERFACE_END_FACTOR
    shares = _divide((left * last).sum(axis=1), _bound_products(energies.sum(axis=1)))
    upper = np.clip(np.searchsorted(times, sample.times), min(1, len(times) - 1), len(times) - 1)
    return np.asarray(np.maximum(shares[upper], shares[np.maximum(upper - 1, 0)]))


def _compute_degree_energies(model: MeridianModel, states: StateCurve, degree: int, times: Floats) -> Floats:
    """Return energies a_e of both states' parts of one degree, (k, n, 2, 2): states at ``times``, a_e with the model's moduli."""
    chosen = find_values_of_degree(model, degree)
    part = _combine_vectors(states.edges[:, chosen], states.compute_states(times)[0])
    return _multiply_pairs(part, model.system.stiffness[:, chosen[:, None], chosen] @ part)


def _combine_vectors(values: Floats, turn: Floats) -> Floats:
    """Combine vectors (n, s, m) by k pairs of coefficients, (k, m, 2), to shape (n, s, 2 k)."""
    return np.asarray(values @ turn.transpose(1, 0, 2).reshape(turn.shape[1], -1))


def _multiply_pairs(values: Floats, loads: Floats) -> Floats:
    """Return products of pairs of values and loads, element by element, (n, s, 2 k) both to (k, n, 2, 2)."""
    n, s, _ = values.shape
    a, b = (array.reshape(n, s, -1, 2).transpose(2, 0, 1, 3) for array in (values, loads))
    return np.asarray(a.transpose(0, 1, 3, 2) @ b)


def _bound_products(energies: Floats) -> Floats:
    """Return the Cauchy-Schwarz bounds sqrt(a(w_i, w_i) a(W, W)) from a(w_i, w_j), (k, 2, 2) to (k, 2)."""
    return np.asarray(np.sqrt(np.abs(np.diagonal(energies, axis1=1, axis2=2) * energies.sum(axis=(1, 2))[:, None])))


def _compute_sizes(energies: Floats) -> Floats:
    """Return d_e of eq. AX.10 from a_e(w_i, w_j), (..., 2, 2) to (..., 2)."""
    whole, single = energies.sum(axis=(-2, -1)), np.diagonal(energies, axis1=-2, axis2=-1)
    return np.asarray(np.abs(energies.sum(axis=-1)) + CANCELLATION_FACTOR * np.sqrt(np.abs(single * whole[..., None])))


def _replace_nan(bounds: Floats) -> Floats:
    """Return bounds with infinity in place of NaN, which rounding may cause."""
    return np.where(np.isnan(bounds), np.inf, bounds)


def _divide(part: Floats, whole: Floats, otherwise: float = 0.0) -> Floats:
    """Return parts divided by wholes; ``otherwise`` where a whole is 0."""
    return np.divide(part, whole, out=np.full_like(whole, otherwise), where=whole != 0)
