"""Error bounds from one mesh: its answer against those of lower orders on its corners and edges.

Functions of degree p on edges left out, the same element matrices are those of a smaller space: nothing is integrated or
condensed again, and a factorisation of two thirds of the unknowns or less tells what the last degree changed. What the one before
it did is no more than the energy of that state's own part of degree p - 1, which no other state of its space without it can be
farther from. With w the change of a state and W = w_1 + w_2, F_ij changes by the energy a(w_i, w_j) exactly
(Galerkin's orthogonality), element by element, so that changes cannot cancel unseen:

    e_i = sum over elements c_e d_e,   d_e = |a_e(w_i, W)| + 1/10 sqrt(a_e(w_i, w_i) a_e(W, W))        (AX.10)
    c_e = min(c, max(6/5, k q / (1 - q))),   q = d_e over that of the smaller state's part of degree p - 1        (AX.11)

bounds film i's total. Were all errors those of corners, where p^-2 is left at degree p, 16/9, 25/11 and 36/13 of the change
would be left at degrees 4 to 6, twice q / (1 - q); where changes fall by q with each degree, q / (1 - q) is, and never less than
the change once a corner's own error is all there is. c = 5/2, 5/2, 4 and k = 12 at degree 4; above it c_e = c, for changes in
elements that are much longer than wide fall less there than they did before (``benchmarks/extremes/one_mesh.py``).
Cells at an interface's end at the tissue's side, where a soft film squeezed under a stiff skin lets go, are long and change
little from degree to degree: c_e = 16 there.

From degree 5 on the state's own part of degree p tells nearly as much, and nothing is factorised: its energy is no less than
that of w, for the smaller state is the best of all without that part. c_e = 11/5 and 12/5 then. One step of descent from it
(``base_states.near_lower_order``) tells nearly what the best does: more energy widens bounds.

A curve's states at every modulus are sums of a few vectors (eq. AX.9), and so are those of the smaller space, the best of these
vectors' projections on it. There may be better ones, so that their energies tell too much if anything:

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
MOST_OF_OWN = {5: 2.2, 6: 2.4}  # likewise, of the state's own part of degree p
AT_ENDS = 16.0  # c_e at interfaces' ends at the tissue's side
RATES = {4: 12.0}  # by order: k of eq. AX.11
LEAST = 1.2  # of eq. AX.11
NEAR = 12.0  # lambda over 2 mu above which one step leaves too much: half of the energy and more
CANCELLING = 0.1  # of eq. AX.10
DEPENDENT = 1e-12  # share of the largest energy below which a vector of the smaller space is none
SAMPLED = 5  # moduli of a curve at which eq. AX.12 looks at single elements
SLOPES = 2.0  # times: what the last degree changed of each film's log-sensitivity


def graded_everywhere(section: Section) -> bool:
    """Return whether the mesh has layers of cells at every singular point, which eq. AX.10 needs.

    With films, an elastic base or round edges it has not.
    """
    return not (section.has_details or np.any(section.edge_radius != 0))


@dataclass(frozen=True)
class _Curve:
    """Both states at every modulus.

    Attributes:
        values: the elements', of both at the modulus that was solved for and of the vectors of eq. AX.9, shape (n, 8 p, 2 + m).
        rational: what the states are on these; None where there is one modulus, and no vectors.
    """

    values: Floats
    rational: RationalResponse | None

    def at(self, times: Floats) -> Floats:
        """What both states are on the vectors at some moduli, shape (k, 2 + m, 2)."""
        out = np.zeros((len(times), self.values.shape[2], 2))
        out[:, :2] = np.eye(2)
        if self.rational is not None:
            out[:, 2:] = self.rational.amplitudes(times)[0]
        return out


@dataclass(frozen=True)
class _Change:
    """What states of a smaller space differ by from the whole's, at every modulus.

    Attributes:
        values: vectors that all of it is made of, the elements' values, shape (n, 8 p, m).
        loads: their forces, likewise.
        low, own: both spaces' states; that of a curve's values come one after the other in ``values``.
    """

    values: Floats
    loads: Floats
    low: _Curve
    own: _Curve

    @classmethod
    def of(cls, model: MeridianModel, low: _Curve, own: _Curve) -> _Change:
        """Multiply by the elements' matrices; a curve's vectors have no counterpart in the other space."""
        values = low.values - own.values if own.rational is None else np.concatenate([low.values, own.values], axis=2)
        return cls(values, model.system.stiffness @ values, low, own)

    def at(self, times: Floats) -> Floats:
        """What both states' change is on the vectors at some moduli, shape (k, m, 2)."""
        return self.low.at(times) if self.own.rational is None else np.hstack([self.low.at(times), -self.own.at(times)])

    def of_elements(self, times: Floats) -> Floats:
        """a_e(w_i, w_j) with the model's moduli of the change at others, shape (k, n, 2, 2)."""
        turn = self.at(times)
        return _pairs(_turned(self.values, turn), _turned(self.loads, turn))


def order_errors(sample: MeshSample) -> SampleErrors:
    """Bounds on the errors of a sample from its own mesh, of an order in ``MOST``, and what it is on the next smaller space."""
    own, order = _own(sample), sample.states.model.shapes.order
    low = _lower(sample, own, order - 1)
    return _errors(sample, _Change.of(sample.states.model, low, own), MOST[order], RATES.get(order))


def near_errors(sample: MeshSample) -> SampleErrors | None:
    """Likewise from what is nearly on that space, for half of the time or less: at one modulus, ratios up to 0.48, else None."""
    own, order = _own(sample), sample.states.model.shapes.order
    if own.rational is not None or np.any(sample.states.model.lam > NEAR * sample.states.model.two_mu):
        return None
    values, loads = near_lower_order(sample.states, order - 1)
    change = _Change(values - own.values, loads, _Curve(values, None), own)
    return _errors(sample, change, MOST[order], RATES.get(order))


def own_errors(sample: MeshSample) -> SampleErrors | None:
    """Likewise without a smaller space, from an order in ``MOST_OF_OWN``, else None; wider, and for a tenth of the time."""
    own, order = _own(sample), sample.states.model.shapes.order
    if order not in MOST_OF_OWN:
        return None
    values = own.values.copy()
    values[:, of_degree(sample.states.model, order)] = 0.0
    low = _Curve(values, own.rational)
    return _errors(sample, _Change.of(sample.states.model, low, own), MOST_OF_OWN[order])


def _errors(sample: MeshSample, change: _Change, most: float, rate: float | None = None) -> SampleErrors:
    """Bounds from a smaller space, by c of eq. AX.10 and, where changes may fall faster, k of eq. AX.11.

    The log-sensitivity is the difference of both films' own: each of these is bounded by what the last degree changed of it and,
    should that vanish by chance, by as large a share of itself as its film's force. A smaller system that is solved badly adds to
    the bounds: its energy is the least.
    """
    times, low = sample.times, change.low
    energies = _energies(sample, change)
    bound = _shares(sample, change, most, rate) * _cauchy(energies)
    totals, slope = sample.totals, sample.slope.sum(axis=2)
    share = _share(slope, totals)
    lower_slope = times[:, None] * _inclusion_energies(sample, low.values, low.at(times)).sum(axis=2)
    moved = np.abs(_share(lower_slope, totals + energies.sum(axis=2)) - share)
    part = _share(bound, np.maximum(np.abs(totals) - bound, 0.0), np.inf)  # of the force that the error may leave
    films = SLOPES * moved + np.multiply(np.abs(share), part, out=np.zeros_like(part), where=share != 0)  # where nothing varies
    return SampleErrors(_known(bound + sample.rounding), _known(films.sum(axis=1)))


def _own(sample: MeshSample) -> _Curve:
    """The sample's own states."""
    states, response = sample.states, sample.response
    if response is None:
        return _Curve(states.edge, None)
    return _Curve(response.edges, response.rational)


def _lower(sample: MeshSample, own: _Curve, degree: int) -> _Curve:
    """The best of what the projections of its vectors can be."""
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
    """Energies of both states within the inclusion at the modulus of ``sample.states``, shape (k, 2, 2)."""
    inside = np.flatnonzero(sample.states.model.mesh.body == Body.INCLUSION)
    part = values[inside]
    return np.asarray(at.transpose(0, 2, 1) @ products(part, sample.states.model.system.stiffness[inside] @ part) @ at)


def _energies(sample: MeshSample, change: _Change) -> Floats:
    """Energies a(w_i, w_j) at all moduli, shape (k, 2, 2)."""
    times, at = sample.times, change.at(sample.times)
    whole = np.asarray(at.transpose(0, 2, 1) @ products(change.values, change.loads) @ at)
    if change.own.rational is None:
        return whole
    return np.asarray(whole + (times[:, None, None] - 1) * _inclusion_energies(sample, change.values, at))


def _shares(sample: MeshSample, change: _Change, most: float, rate: float | None = None) -> Floats:
    """What of eq. AX.12 changes little with the modulus, shape (k, 2)."""
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
    """a_e of both states' parts of one degree with the model's moduli, at some others, shape (k, n, 2, 2)."""
    some = of_degree(model, degree)
    part = _turned(states.values[:, some], states.at(times))
    return _pairs(part, model.system.stiffness[:, some[:, None], some] @ part)


def _turned(values: Floats, turn: Floats) -> Floats:
    """Sums of vectors (n, s, m) by k times two shares of each, (k, m, 2), shape (n, s, 2 k)."""
    return np.asarray(values @ turn.transpose(1, 0, 2).reshape(turn.shape[1], -1))


def _pairs(values: Floats, loads: Floats) -> Floats:
    """Products of two values and two loads, element by element, (n, s, 2 k) both to (k, n, 2, 2)."""
    n, s, _ = values.shape
    a, b = (one.reshape(n, s, -1, 2).transpose(2, 0, 1, 3) for one in (values, loads))
    return np.asarray(a.transpose(0, 1, 3, 2) @ b)


def _cauchy(energies: Floats) -> Floats:
    """sqrt(a(w_i, w_i) a(W, W)) from a(w_i, w_j), (k, 2, 2) to (k, 2)."""
    return np.asarray(np.sqrt(np.abs(np.diagonal(energies, axis1=1, axis2=2) * energies.sum(axis=(1, 2))[:, None])))


def _sizes(energies: Floats) -> Floats:
    """d_e of eq. AX.10, (..., 2, 2) to (..., 2)."""
    whole, single = energies.sum(axis=(-2, -1)), np.diagonal(energies, axis1=-2, axis2=-1)
    return np.asarray(np.abs(energies.sum(axis=-1)) + CANCELLING * np.sqrt(np.abs(single * whole[..., None])))


def _known(bounds: Floats) -> Floats:
    """Infinite where rounding has left no number."""
    return np.where(np.isnan(bounds), np.inf, bounds)


def _share(part: Floats, whole: Floats, otherwise: float = 0.0) -> Floats:
    """Parts over wholes; ``otherwise`` where a whole is 0."""
    return np.divide(part, whole, out=np.full_like(whole, otherwise), where=whole != 0)
