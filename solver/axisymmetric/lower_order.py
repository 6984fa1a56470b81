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

from geometry.common.arrays import Floats, Ints
from geometry.meridian.mesh import interface_ends
from geometry.meridian.section import Body, Section
from solver.axisymmetric.base_states import MeridianModel, in_inclusion, lower_order, near_lower_order, of_degree, products
from solver.axisymmetric.refinement import SampleErrors
from solver.axisymmetric.sample import MeshSample
from solver.linalg.rational_response import RationalResponse

MOST = {4: 2.5, 5: 2.5, 6: 4.0}  # by order: c of eq. AX.10
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

    Interfaces of the tissue may cross the sphere's surface, where none lie.
    """
    across = section.interfaces_apart[1]
    return not (across or section.has_details or np.any(section.edge_radius != 0))


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

    def state(self, time: float) -> Floats:
        """Both states at a modulus, shape (n, 8 p, 2)."""
        return self.values if self.rational is None else np.asarray(self.values @ self.at(np.array([time]))[0])


def order_errors(sample: MeshSample) -> SampleErrors:
    """Bounds on the errors of a sample from its own mesh, of an order in ``MOST``, and what it is on the next smaller space."""
    own, order = _own(sample), sample.states.model.shapes.order
    low = _lower(sample, own, order - 1)
    return _errors(sample, own, low, _shares(sample, own, low, MOST[order], RATES.get(order)))


def near_errors(sample: MeshSample) -> SampleErrors | None:
    """Likewise from what is nearly on that space, for half of the time or less: at one modulus, ratios up to 0.48, else None."""
    own, order = _own(sample), sample.states.model.shapes.order
    if own.rational is not None or np.any(sample.states.model.lam > NEAR * sample.states.model.two_mu):
        return None
    low = _Curve(near_lower_order(sample.states, order - 1), None)
    return _errors(sample, own, low, _shares(sample, own, low, MOST[order], RATES.get(order)))


def own_errors(sample: MeshSample) -> SampleErrors | None:
    """Likewise without a smaller space, from an order in ``MOST_OF_OWN``, else None; wider, and for a tenth of the time."""
    own, order = _own(sample), sample.states.model.shapes.order
    if order not in MOST_OF_OWN:
        return None
    values = own.values.copy()
    values[:, of_degree(sample.states.model, order)] = 0.0
    low = _Curve(values, own.rational)
    return _errors(sample, own, low, _shares(sample, own, low, MOST_OF_OWN[order]))


def _errors(sample: MeshSample, own: _Curve, low: _Curve, shares: Floats) -> SampleErrors:
    """Bounds from states of a smaller space and the shares of eq. AX.12.

    The log-sensitivity is the difference of both films' own: each of these is bounded by what the last degree changed of it and,
    should that vanish by chance, by as large a share of itself as its film's force. A smaller system that is solved badly adds to
    the bounds: its energy is the least.
    """
    times = sample.times
    energies = _energies(sample, low, own)
    bound = shares * _cauchy(energies)
    totals, slope = sample.totals, sample.slope.sum(axis=2)
    share = _share(slope, totals)
    lower_slope = times[:, None] * _inclusion_energies(sample, low.values, low.at(times)).sum(axis=2)
    change = np.abs(_share(lower_slope, totals + energies.sum(axis=2)) - share)
    part = _share(bound, np.maximum(np.abs(totals) - bound, 0.0), np.inf)  # of the force that the error may leave
    films = SLOPES * change + np.multiply(np.abs(share), part, out=np.zeros_like(part), where=share != 0)  # where nothing varies
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


def _energies(sample: MeshSample, low: _Curve, own: _Curve) -> Floats:
    """Energies a(w_i, w_j) at all moduli, shape (k, 2, 2)."""
    times, at = sample.times, own.at(sample.times)
    if own.rational is None:
        values = low.values - own.values
    else:  # vectors have no counterpart in the other space
        values, at = np.concatenate([low.values, own.values], axis=2), np.hstack([low.at(times), -at])
    whole = products(values, sample.states.model.system.stiffness @ values)
    return np.asarray(at.transpose(0, 2, 1) @ whole @ at + (times[:, None, None] - 1) * _inclusion_energies(sample, values, at))


def _shares(sample: MeshSample, own: _Curve, low: _Curve, most: float, rate: float | None = None) -> Floats:
    """What of eq. AX.12 changes little with the modulus, shape (k, 2)."""
    model, order = sample.states.model, sample.states.model.shapes.order
    times = np.ones(1) if sample.response is None else np.geomspace(sample.times.min(), sample.times.max(), SAMPLED)
    before_last, ends, shares = of_degree(model, order - 1), interface_ends(model.mesh), []
    for time in times:
        smaller, stiffness = low.state(time), in_inclusion(model, time)
        energies = stiffness * _of_elements(model, smaller - own.state(time))
        last = _sizes(energies)
        left = np.full_like(last, most)
        if rate is not None:
            before = _sizes(stiffness * _of_elements(model, smaller, before_last))
            left = np.clip(rate * _share(last, np.maximum(before - last, 0.0), np.inf), LEAST, left)  # eq. AX.11
        left[ends] = AT_ENDS
        shares.append(_share((left * last).sum(axis=0), _cauchy(energies.sum(axis=0)[None])[0]))
    above = np.clip(np.searchsorted(times, sample.times), min(1, len(times) - 1), len(times) - 1)
    return np.asarray(np.maximum(np.array(shares)[above], np.array(shares)[np.maximum(above - 1, 0)]))


def _of_elements(model: MeridianModel, change: Floats, some: Ints | None = None) -> Floats:
    """a_e(w_i, w_j) at the model's moduli, of all or of some of the elements' values, shape (n, 2, 2)."""
    stiffness = model.system.stiffness
    if some is not None:
        change, stiffness = change[:, some], stiffness[:, some[:, None], some]
    return np.asarray(change.transpose(0, 2, 1) @ (stiffness @ change))


def _cauchy(energies: Floats) -> Floats:
    """sqrt(a(w_i, w_i) a(W, W)) from a(w_i, w_j), (k, 2, 2) to (k, 2)."""
    return np.asarray(np.sqrt(np.abs(np.diagonal(energies, axis1=1, axis2=2) * energies.sum(axis=(1, 2))[:, None])))


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
