"""Bound errors from one mesh, by comparison with lower orders of the functions on its corners and edges.

Without the functions of degree p on edges, the same element matrices are those of a smaller space: nothing is integrated or
condensed again, and a factorisation of at most two thirds of the unknowns gives the change by the last degree. The change by the
degree before is at most the energy of the smaller state's own part of degree p - 1: the best state without that part is nearer.
With w the change of a state and W = w_1 + w_2, F_ij changes by the energy a(w_i, w_j) exactly
(Galerkin's orthogonality), element by element, so that changes cannot cancel unnoticed:

    e_i = sum over elements c_e d_e,   d_e = |a_e(w_i, W)| + 1/10 sqrt(a_e(w_i, w_i) a_e(W, W))        (AX.10)
    c_e = min(c, max(6/5, k q / (1 - q))),   q = d_e over that of the smaller state's part of degree p - 1        (AX.11)

bounds film i's total. Were all errors those of corners, where p^-2 is left at degree p, 16/9, 25/11 and 36/13 of the change
would be left at degrees 4 to 6, twice q / (1 - q); where changes fall by q with each degree, q / (1 - q) is, and never less than
the change once a corner's own error is all there is. c = 5/2, 5/2, 4 and k = 12 at degree 4; above it c_e = c, for changes in
elements that are much longer than wide fall less there than they did before (``benchmarks/extremes/one_mesh.py``).
Cells at an interface's end at the tissue's side, where a soft film squeezed under a stiff skin lets go, are long and change
little from degree to degree: c_e = 16 there.

From degree 5 on the state's own part of degree p gives nearly as good a bound without a factorisation: its energy is at least
that of w, for the smaller state is the best of all without that part. c_e = 11/5 and 12/5 then. One step of descent from it
(``base_states.approximate_lower_order``) comes close to the best state; the energy it has in excess widens the bounds.

A curve's states at every modulus are sums of a few vectors (eq. AX.9), and so are those of the smaller space, the best of these
vectors' projections on it. There may be better ones, so that their energies are, if anything, too large:

    e_i(t) = max over t' of [e_i / sqrt(a(w_i, w_i) a(W, W))](t') times sqrt(a(w_i, w_i) a(W, W))(t)        (AX.12)

with t' the next of five moduli on either side of t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.meridian.mesh import interface_ends
from geometry.meridian.section import Body, Section
from solver.axisymmetric.base_states import MeridianModel, in_inclusion, lower_order, near_lower_order, of_degree, products
from solver.axisymmetric.refinement import SampleErrors
from solver.axisymmetric.sample import MeshSample
from solver.linalg.rational_response import RationalResponse

MOST = {4: 2.5, 5: 2.5, 6: 4.0, 8: 4.0}  # by order: c of eq. AX.10
MOST_OF_OWN = {5: 2.2, 6: 2.4}  # likewise, for the state's own part of degree p
AT_ENDS = 16.0  # c_e in cells at interfaces' ends at the tissue's side
RATES = {4: 12.0}  # by order: k of eq. AX.11
LEAST = 1.2  # of eq. AX.11
NEAR = 12.0  # above it one step of descent leaves half of the energy or more
CANCELLING = 0.1  # the factor 1/10 of eq. AX.10
DEPENDENT = 1e-12  # of the largest energy: vectors with less count as dependent
SAMPLED = 5  # moduli of a curve at which eq. AX.12 uses single elements
SLOPES = 2.0  # times the change of each film's log-sensitivity by the last degree


def graded_everywhere(section: Section) -> bool:
    """Return whether the mesh is graded at every singular point, as eq. AX.10 requires.

    With films, an elastic base or round edges it is not.
    """
    return not (section.has_details or np.any(section.edge_radius != 0))


@dataclass(frozen=True)
class _Curve:
    """Both base states as functions of the inclusion's modulus.

    Attributes:
        values: the elements', of both at the modulus that was solved for and of the vectors of eq. AX.9, shape (n, 8 p, 2 + m).
        rational: coefficients of the states on these vectors; None where there is one modulus, and so no vectors.
    """

    values: Floats
    rational: RationalResponse | None

    def at(self, times: Floats) -> Floats:
        """Return the coefficients of both states on the vectors at some moduli, shape (k, 2 + m, 2)."""
        out = np.zeros((len(times), self.values.shape[2], 2))
        out[:, :2] = np.eye(2)
        if self.rational is not None:
            out[:, 2:] = self.rational.amplitudes(times)[0]
        return out


@dataclass(frozen=True)
class _Change:
    """The difference between the states of a smaller space and those of the whole, at every modulus.

    Attributes:
        values: vectors that span the difference, elements' values, shape (n, 8 p, m).
        loads: their forces, shape (n, 8 p, m).
        low, whole: the states of the smaller and the whole space; for a curve ``values`` holds the vectors of both.
    """

    values: Floats
    loads: Floats
    low: _Curve
    own: _Curve

    @classmethod
    def of(cls, model: MeridianModel, low: _Curve, own: _Curve) -> _Change:
        """Build the difference of two curves; with several moduli their vectors differ, so that both sets are used."""
        values = low.values - own.values if own.rational is None else np.concatenate([low.values, own.values], axis=2)
        return cls(values, model.system.stiffness @ values, low, own)

    def at(self, times: Floats) -> Floats:
        """Return the coefficients of both states' difference on the vectors at some moduli, shape (k, m, 2)."""
        return self.low.at(times) if self.own.rational is None else np.hstack([self.low.at(times), -self.own.at(times)])

    def of_elements(self, times: Floats) -> Floats:
        """Return energies a_e(w_i, w_j) by element, (k, n, 2, 2): w at ``times``, a_e with the model's own moduli."""
        turn = self.at(times)
        return _pairs(_turned(self.values, turn), _turned(self.loads, turn))


def order_errors(sample: MeshSample) -> SampleErrors:
    """Bound the errors of a sample by its projection to the next lower order, one in ``ERROR_FACTOR_OF_ORDER``."""
    own, order = _own(sample), sample.states.model.shapes.order
    low = _lower(sample, own, order - 1)
    return _errors(sample, _Change.of(sample.states.model, low, own), MOST[order], RATES.get(order))


def near_errors(sample: MeshSample) -> SampleErrors | None:
    """Bound the errors of a sample by one step of descent, in at most half of the time of a projection.

    None for several moduli, or where Poisson's ratio is above 0.48.
    """
    own, order = _own(sample), sample.states.model.shapes.order
    if own.rational is not None or np.any(sample.states.model.lam > NEAR * sample.states.model.two_mu):
        return None
    values, loads = near_lower_order(sample.states, order - 1)
    change = _Change(values - own.values, loads, _Curve(values, None), own)
    return _errors(sample, change, MOST[order], RATES.get(order))


def own_errors(sample: MeshSample) -> SampleErrors | None:
    """Bound the errors of a sample by the energy of its last degree: wider bounds in a tenth of the time.

    None where the order is not in ``OWN_DEGREE_FACTOR_OF_ORDER``.
    """
    own, order = _own(sample), sample.states.model.shapes.order
    if order not in MOST_OF_OWN:
        return None
    values = own.values.copy()
    values[:, of_degree(sample.states.model, order)] = 0.0
    low = _Curve(values, own.rational)
    return _errors(sample, _Change.of(sample.states.model, low, own), MOST_OF_OWN[order])


def _errors(sample: MeshSample, change: _Change, most: float, rate: float | None = None) -> SampleErrors:
    """Build error bounds from a smaller space, by c of eq. AX.10 and, where changes may fall faster, k of eq. AX.11.

    The log-sensitivity is the difference of those of both films. The error of each is bounded by its change with the last degree
    plus, in case that vanishes by chance, the relative error of the film's force times the sensitivity. A smaller system that is
    solved inaccurately widens the bounds: the exact solution has the smallest energy.
    """
    times, low = sample.times, change.low
    energies = _energies(sample, change)
    bound = _shares(sample, change, most, rate) * _cauchy(energies)
    totals, slope = sample.totals, sample.slope.sum(axis=2)
    share = _share(slope, totals)
    lower_slope = times[:, None] * _inclusion_energies(sample, low.values, low.at(times)).sum(axis=2)
    moved = np.abs(_share(lower_slope, totals + energies.sum(axis=2)) - share)
    part = _share(bound, np.maximum(np.abs(totals) - bound, 0.0), np.inf)  # relative to the smallest force within the error
    films = SLOPES * moved + np.multiply(np.abs(share), part, out=np.zeros_like(part), where=share != 0)  # 0 without variation
    return SampleErrors(_known(bound + sample.rounding), _known(films.sum(axis=1)))


def _own(sample: MeshSample) -> _Curve:
    """Return the sample's own states."""
    states, response = sample.states, sample.response
    if response is None:
        return _Curve(states.edge, None)
    return _Curve(response.edges, response.rational)


def _lower(sample: MeshSample, own: _Curve, degree: int) -> _Curve:
    """Project the vectors of a curve to a lower degree, and return the best states on them."""
    model = sample.states.model
    values = lower_order(sample.states, own.values[..., 2:], degree, float(sample.times.max()))
    if own.rational is None:
        return _Curve(values, None)
    states, vectors = values[..., :2], values[..., 2:]
    size, turn = np.linalg.eigh(products(vectors, model.system.stiffness @ vectors))
    some = size > DEPENDENT * size[-1]
    vectors = vectors @ (turn[:, some] / np.sqrt(size[some]))
    inside = np.flatnonzero(model.mesh.body == Body.INCLUSION)
    part = model.system.stiffness[inside] @ vectors[inside]
    nothing = np.zeros((2, 2))
    rational = RationalResponse.of(products(vectors[inside], part), products(part, states[inside]), start=nothing, inside=nothing)
    return _Curve(np.concatenate([states, vectors @ rational.turn], axis=2), rational)


def _inclusion_energies(sample: MeshSample, values: Floats, at: Floats) -> Floats:
    """Return energies within the inclusion, at the modulus of ``sample.states``, shape (k, 2, 2)."""
    inside = np.flatnonzero(sample.states.model.mesh.body == Body.INCLUSION)
    part = values[inside]
    return np.asarray(at.transpose(0, 2, 1) @ products(part, sample.states.model.system.stiffness[inside] @ part) @ at)


def _energies(sample: MeshSample, change: _Change) -> Floats:
    """Return energies a(w_i, w_j) at all moduli, shape (k, 2, 2)."""
    times, at = sample.times, change.at(sample.times)
    whole = np.asarray(at.transpose(0, 2, 1) @ products(change.values, change.loads) @ at)
    if change.own.rational is None:
        return whole
    return np.asarray(whole + (times[:, None, None] - 1) * _inclusion_energies(sample, change.values, at))


def _shares(sample: MeshSample, change: _Change, most: float, rate: float | None = None) -> Floats:
    """Return the first factor of eq. AX.12, which changes little with the modulus, shape (k, 2)."""
    model, order = sample.states.model, sample.states.model.shapes.order
    times = np.ones(1) if sample.response is None else np.geomspace(sample.times.min(), sample.times.max(), SAMPLED)
    stiffness = np.stack([in_inclusion(model, time) for time in times])
    energies = stiffness * change.of_elements(times)
    last = _sizes(energies)
    left = np.full_like(last, most)
    if rate is not None:
        before = _sizes(stiffness * _of_degree(model, change.low, order - 1, times))
        left = np.clip(rate * _share(last, np.maximum(before - last, 0.0), np.inf), LEAST, left)  # eq. AX.11
    left[:, interface_ends(model.mesh)] = AT_ENDS
    shares = _share((left * last).sum(axis=1), _cauchy(energies.sum(axis=1)))
    above = np.clip(np.searchsorted(times, sample.times), min(1, len(times) - 1), len(times) - 1)
    return np.asarray(np.maximum(shares[above], shares[np.maximum(above - 1, 0)]))


def _of_degree(model: MeridianModel, states: _Curve, degree: int, times: Floats) -> Floats:
    """Return energies a_e of both states' parts of one degree, (k, n, 2, 2): states at ``times``, a_e with the model's moduli."""
    some = of_degree(model, degree)
    part = _turned(states.values[:, some], states.at(times))
    return _pairs(part, model.system.stiffness[:, some[:, None], some] @ part)


def _turned(values: Floats, turn: Floats) -> Floats:
    """Combine vectors (n, s, m) by k pairs of coefficients, (k, m, 2), to shape (n, s, 2 k)."""
    return np.asarray(values @ turn.transpose(1, 0, 2).reshape(turn.shape[1], -1))


def _pairs(values: Floats, loads: Floats) -> Floats:
    """Return products of pairs of values and loads, element by element, (n, s, 2 k) both to (k, n, 2, 2)."""
    n, s, _ = values.shape
    a, b = (one.reshape(n, s, -1, 2).transpose(2, 0, 1, 3) for one in (values, loads))
    return np.asarray(a.transpose(0, 1, 3, 2) @ b)


def _cauchy(energies: Floats) -> Floats:
    """Return the Cauchy-Schwarz bounds sqrt(a(w_i, w_i) a(W, W)) from a(w_i, w_j), (k, 2, 2) to (k, 2)."""
    return np.asarray(np.sqrt(np.abs(np.diagonal(energies, axis1=1, axis2=2) * energies.sum(axis=(1, 2))[:, None])))


def _sizes(energies: Floats) -> Floats:
    """Return d_e of eq. AX.10 from a_e(w_i, w_j), (..., 2, 2) to (..., 2)."""
    whole, single = energies.sum(axis=(-2, -1)), np.diagonal(energies, axis1=-2, axis2=-1)
    return np.asarray(np.abs(energies.sum(axis=-1)) + CANCELLING * np.sqrt(np.abs(single * whole[..., None])))


def _known(bounds: Floats) -> Floats:
    """Return bounds with infinity in place of NaN, which rounding may cause."""
    return np.where(np.isnan(bounds), np.inf, bounds)


def _share(part: Floats, whole: Floats, otherwise: float = 0.0) -> Floats:
    """Return parts divided by wholes; ``otherwise`` where a whole is 0."""
    return np.divide(part, whole, out=np.full_like(whole, otherwise), where=whole != 0)
