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
from probe_design.estimation.loaded_model import LoadedModel, Told
from probe_design.estimation.profile import Track
from solver.planning.load_check import REMEDY

MISSES = 0.1  # of the noise, or of the misfit of a datum: allowed miss of the spline
BETTER = 4.0  # factor by which a new node reduces the miss, at least


@dataclass(frozen=True)
class Span:
    """The range between two neighbouring nodes that ``contact`` has computed.

    Attributes:
        first, last: indices of the nodes.
        miss: of the spline at the last node that was added, shape (k,); before any, the change from end to end.
        remaining_miss: expected miss over the allowed one.
    """

    first: int
    last: int
    missed: Floats
    left: float

    @property
    def middle(self) -> int:
        """The node halfway, or the first where there is none between."""
        return (self.first + self.last) // 2


@dataclass
class LoadedTrack:
    """A track to which ``contact`` adds the effect of the load, node by node.

    Attributes:
        track: predictions without load.
        loaded: the model under load.
        changes: effect of the load on the data at each solved node, with error bounds of ``contact``, both of shape (k,).
    """

    track: Track
    loaded: LoadedModel
    changes: dict[int, Told] = field(default_factory=dict)

    def first(self, node: int) -> None:
        """Solve the first node.

        Raises:
            Refusal: ``contact`` does not reach the scene's load.
        """
        try:
            self._ask(node)
        except Refusal as fault:
            raise Refusal(fault.key, fault.value, f"{fault.allowed}, {REMEDY}") from None

    def told(self, node: int) -> bool:
        """Solve a node, and return whether that succeeded."""
        if node not in self.changes:
            try:
                self._ask(node)
            except (ProbeError, ValueError):
                return False
        return node in self.changes

    def _ask(self, node: int) -> None:
        answer = self.loaded.told(float(self.track.values(self.track.x[node])))
        if answer is not None:
            self.changes[node] = answer[0] - self.track.predicted.value[node], answer[1]

    def farthest(self, good: int, end: int) -> int:
        """Return the node nearest to an end of the track that can be solved, by bisection from a solved node."""
        if self.told(end):
            return end
        while abs(end - good) > 1:
            middle = (good + end) // 2
            good, end = (middle, end) if self.told(middle) else (good, middle)
        return good

    def _between(self, first: int, last: int) -> Floats:
        return np.asarray(np.abs(self.changes[last][0] - self.changes[first][0]))

    def spline(self) -> CubicSpline:
        """Return the effect of the load on the data, shape (k,), as a spline along the track."""
        nodes = sorted(self.changes)
        return CubicSpline(self.track.x[nodes], [self.changes[node][0] for node in nodes])

    def spans(self) -> tuple[list[Span], Bools]:
        """Solve nodes until the spline is accurate; return its spans, and which nodes of the track have no prediction."""
        nodes = sorted(self.changes)
        spans = [Span(a, b, self._between(a, b), np.inf) for a, b in pairwise(nodes)]
        dark = np.ones(len(self.track.x), dtype=bool)
        dark[nodes[0] : nodes[-1] + 1] = False
        while open_spans := [span for span in spans if span.left > 1 and span.middle > span.first]:
            span = max(open_spans, key=lambda span: span.left)
            spans.remove(span)
            before = self.spline()(self.track.x[span.middle])
            if not self.told(span.middle):
                dark[span.first + 1 : span.last] = True
                continue
            missed = np.abs(before - self.changes[span.middle][0])
            halves = ((span.first, span.middle), (span.middle, span.last))
            spans += [Span(a, b, missed, self._left(a, b, missed)) for a, b in halves]
        return spans, dark

    def _left(self, first: int, last: int, missed: Floats) -> float:
        """Return the expected miss of the spline between two neighbouring nodes over the allowed one."""
        data = self.loaded.model.data
        off = np.array([self.track.predicted.value[node] + self.changes[node][0] - data.value for node in (first, last)])
        beside = np.where(off[0] * off[1] > 0, np.abs(off).min(axis=0), 0.0)
        share = missed / BETTER / (MISSES * data.noise)
        return float(share.max() / max(1.0, (beside / data.noise).max()))


def under_load(track: Track, loaded: LoadedModel) -> Track:
    """Return a track with the effect of the load, eq. ES.10.

    Args:
        track: of the model without load.
        loaded_model: the model under load.

    Raises:
        Refusal: ``contact`` does not reach the scene's load at the middle of the search range.
    """
    usable = np.flatnonzero(track.predicted.usable)
    if len(usable) < 2:
        return track
    pressing = LoadedTrack(track, loaded)
    middle = int(usable[len(usable) // 2])
    pressing.first(middle)
    ends = {pressing.farthest(middle, int(end)) for end in usable[[0, -1]]} & pressing.changes.keys()
    if len(ends) < 2:
        nothing = replace(track.predicted, resolved=np.zeros(len(track.x), dtype=bool))
        return replace(track, predicted=nothing, level=loaded.name)
    spans, dark = pressing.spans()
    return _moved(pressing, spans, dark)


def _moved(pressing: LoadedTrack, spans: list[Span], dark: Bools) -> Track:
    """Return the track with the effect of the load; the error at a node is at least that of its neighbouring spans."""
    track, spline, nodes = pressing.track, pressing.spline(), sorted(pressing.changes)
    own = np.array([pressing.changes[node][1] for node in nodes])
    bound = np.stack([np.interp(track.x, track.x[nodes], one) for one in own.T], axis=1)
    missed = np.zeros_like(bound)
    for span in spans:
        within = slice(span.first, span.last + 1)
        missed[within] = np.maximum(missed[within], span.missed)
    ratios = ~pressing.loaded.model.data.is_stiffness
    change = max(float(np.abs(pressing.changes[node][0][ratios]).max()) for node in nodes)
    before = track.predicted
    value = np.where(dark[:, None], 0.0, before.value + spline(track.x))
    predicted = replace(before, value=value, bound=bound + missed, resolved=before.resolved & ~dark)
    plan = (pressing.loaded.decision(float(np.expm1(change))),)
    return replace(track, predicted=predicted, slope=track.slope + spline(track.x, 1), level=pressing.loaded.name, plan=plan)
