"""Interpolate predictions along one unknown at loads beyond linear elasticity, from ``contact`` at few nodes.

With m_0(u) the linear predictions of ``profile.py`` and m_c those of ``contact`` at some of its nodes,

    m(u) = m_0(u) + c(u),   c the cubic spline through m_c - m_0 at those nodes                     (ES.10)

Here u is the coordinate of the unknown, and m the prediction of a datum. Nodes are added where c is least accurate, until the
spline through the other nodes misses the last one by less than a tenth of the noise, or of the distance between data and
prediction there, as values that fit badly need no accuracy. The miss counts as error over the whole span, in addition to the
error bound of ``contact``. Values at which ``contact`` does not reach the load are not searched.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import ProbeError, Refusal
from probe_design.estimation.loaded_model import LoadedModel, LogPrediction
from probe_design.estimation.profile import Track
from solver.planning.load_check import LINEAR_REMEDY

MAX_MISS_FRACTION = 0.1  # of the noise, or of the misfit of a datum: allowed miss of the spline
MIN_IMPROVEMENT_FACTOR = 4.0  # factor by which a new node reduces the miss, at least


@dataclass(frozen=True)
class Span:
    """The range between two neighbouring nodes that ``contact`` has computed.

    Attributes
    ----------
    first, last
        Indices of the nodes.
    miss
        Of the spline at the last node that was added, shape (k,); before any, the change from end to end.
    remaining_miss
        Expected miss over the allowed one.
    """

    first: int
    last: int
    miss: Floats
    remaining_miss: float

    @property
    def middle(self) -> int:
        """The node halfway, or the first where there is none between."""
        return (self.first + self.last) // 2


@dataclass
class LoadedTrack:
    """A track to which ``contact`` adds the effect of the load, node by node.

    Attributes
    ----------
    track
        Predictions without load.
    loaded
        The model under load.
    changes
        Effect of the load on the data at each solved node, with error bounds of ``contact``, both of shape (k,).
    """

    track: Track
    loaded: LoadedModel
    changes: dict[int, LogPrediction] = field(default_factory=dict)

    def solve_first(self, node: int) -> None:
        """Solve the first node.

        Raises
        ------
        Refusal
            ``contact`` does not reach the scene's load.
        """
        try:
            self._solve(node)
        except Refusal as fault:
            raise Refusal(fault.key, fault.value, f"{fault.allowed}, {LINEAR_REMEDY}") from None

    def try_node(self, node: int) -> bool:
        """Solve a node, and return whether that succeeded."""
        if node not in self.changes:
            try:
                self._solve(node)
            except (ProbeError, ValueError):
                return False
        return node in self.changes

    def _solve(self, node: int) -> None:
        prediction = self.loaded.predict(float(self.track.compute_values(self.track.x[node])))
        if prediction is not None:
            self.changes[node] = prediction[0] - self.track.predicted.value[node], prediction[1]

    def find_farthest(self, solved: int, end: int) -> int:
        """Return the node nearest to an end of the track that can be solved, by bisection from a solved node."""
        if self.try_node(end):
            return end
        while abs(end - solved) > 1:
            middle = (solved + end) // 2
            solved, end = (middle, end) if self.try_node(middle) else (solved, middle)
        return solved

    def _compute_change(self, first: int, last: int) -> Floats:
        return np.asarray(np.abs(self.changes[last][0] - self.changes[first][0]))

    def build_spline(self) -> CubicSpline:
        """Return the effect of the load on the data, shape (k,), as a spline along the track."""
        nodes = sorted(self.changes)
        return CubicSpline(self.track.x[nodes], [self.changes[node][0] for node in nodes])

    def refine_spans(self) -> tuple[list[Span], Bools]:
        """Solve nodes until the spline is accurate; return its spans, and which nodes of the track have no prediction."""
        nodes = sorted(self.changes)
        spans = [Span(a, b, self._compute_change(a, b), np.inf) for a, b in pairwise(nodes)]
        is_unsolved = np.ones(len(self.track.x), dtype=bool)
        is_unsolved[nodes[0] : nodes[-1] + 1] = False
        while open_spans := [span for span in spans if span.remaining_miss > 1 and span.middle > span.first]:
            span = max(open_spans, key=lambda span: span.remaining_miss)
            spans.remove(span)
            expected_change = self.build_spline()(self.track.x[span.middle])
            if not self.try_node(span.middle):
                is_unsolved[span.first + 1 : span.last] = True
                continue
            miss = np.abs(expected_change - self.changes[span.middle][0])
            halves = ((span.first, span.middle), (span.middle, span.last))
            spans += [Span(a, b, miss, self._estimate_remaining_miss(a, b, miss)) for a, b in halves]
        return spans, is_unsolved

    def _estimate_remaining_miss(self, first: int, last: int, miss: Floats) -> float:
        """Return the expected miss of the spline between two neighbouring nodes over the allowed one."""
        data = self.loaded.model.data
        residual = np.array([self.track.predicted.value[node] + self.changes[node][0] - data.value for node in (first, last)])
        close_residual = np.where(residual[0] * residual[1] > 0, np.abs(residual).min(axis=0), 0.0)
        relative_miss = miss / MIN_IMPROVEMENT_FACTOR / (MAX_MISS_FRACTION * data.noise)
        return float(relative_miss.max() / max(1.0, (close_residual / data.noise).max()))


def add_load(track: Track, loaded_model: LoadedModel) -> Track:
    """Return a track with the effect of the load, eq. ES.10.

    Parameters
    ----------
    track
        Of the model without load.
    loaded_model
        The model under load.

    Raises
    ------
    Refusal
        ``contact`` does not reach the scene's load at the middle of the search range.
    """
    usable = np.flatnonzero(track.predicted.usable)
    if len(usable) < 2:
        return track
    loaded_track = LoadedTrack(track, loaded_model)
    middle = int(usable[len(usable) // 2])
    loaded_track.solve_first(middle)
    ends = {loaded_track.find_farthest(middle, int(end)) for end in usable[[0, -1]]} & loaded_track.changes.keys()
    if len(ends) < 2:
        unresolved = replace(track.predicted, resolved=np.zeros(len(track.x), dtype=bool))
        return replace(track, predicted=unresolved, evaluator=loaded_model.name)
    spans, is_unsolved = loaded_track.refine_spans()
    return _combine(loaded_track, spans, is_unsolved)


def _combine(loaded_track: LoadedTrack, spans: list[Span], is_unsolved: Bools) -> Track:
    """Return the track with the effect of the load; the error at a node is at least that of its neighbouring spans."""
    track, spline, nodes = loaded_track.track, loaded_track.build_spline(), sorted(loaded_track.changes)
    contact_bounds = np.array([loaded_track.changes[node][1] for node in nodes])
    bound = np.stack([np.interp(track.x, track.x[nodes], column) for column in contact_bounds.T], axis=1)
    miss = np.zeros_like(bound)
    for span in spans:
        indices = slice(span.first, span.last + 1)
        miss[indices] = np.maximum(miss[indices], span.miss)
    ratios = ~loaded_track.loaded.model.data.is_stiffness
    change = max(float(np.abs(loaded_track.changes[node][0][ratios]).max()) for node in nodes)
    predictions_at_rest = track.predicted
    value = np.where(is_unsolved[:, None], 0.0, predictions_at_rest.value + spline(track.x))
    predicted = replace(
        predictions_at_rest, value=value, bound=bound + miss, resolved=predictions_at_rest.resolved & ~is_unsolved
    )
    plan = (loaded_track.loaded.build_decision(float(np.expm1(change))),)
    return replace(
        track, predicted=predicted, slope=track.slope + spline(track.x, 1), evaluator=loaded_track.loaded.name, plan=plan
    )
