"""Predict readings on a tumour's axis at loads beyond linear elasticity, from ``contact`` at few values of the unknown.

With m_0(u) the linear predictions of ``profile.py`` and m_c those of ``contact`` at some of its nodes,

    m(u) = m_0(u) + c(u),   c the cubic spline through m_c - m_0 at those nodes                     (ES.10)

Here u is the coordinate of the unknown, and m the prediction of a datum. Nodes are added where c is least accurate, until the
spline through the other nodes misses the last one by less than a tenth of the noise, or of the distance between data and
prediction there, as values that fit badly need no accuracy. The miss counts as error over the whole span, in addition to the
error bound of ``contact``. Values at which ``contact`` does not reach the load are not searched.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from threadpoolctl import threadpool_limits

from geometry.common.arrays import Bools, Floats
from geometry.common.errors import ProbeError, Refusal
from geometry.common.resources import start_clock
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load, Placement
from probe_design.estimation.model import TARGET_UNKNOWNS, TargetModel
from probe_design.estimation.predictions import MAX_LOG_RATIO_ERROR
from probe_design.estimation.profile import Track
from solver.contact.evaluator import ContactEvaluator
from solver.contact.loaded_scene import LoadedScene, solve_neighbour
from solver.contact.tumours_anywhere import DECISION_FEATURE
from solver.planning.load_check import LINEAR_REMEDY
from solver.results.film_forces import FilmForces
from solver.results.result import Decision

MAX_MISS_FRACTION = 0.1  # of the noise, or of the misfit of a datum: allowed miss of the spline
MIN_IMPROVEMENT_FACTOR = 4.0  # minimum factor by which a new node reduces the miss
LogPrediction = tuple[Floats, Floats]  # logarithms of the data, and bounds on their errors, both of shape (k,)


def can_mesh_target(model: TargetModel, has_nuisances: bool) -> bool:
    """Return whether the tumour can be part of the mesh of ``contact``: one, read on its axis under one load, all else known.

    Otherwise it acts by its first-order effects about the load (``TargetModel.pressing``).
    """
    if has_nuisances or len(model.scene.inclusion) > 1 or not np.isnan(model.data.force).all():
        return False
    places = model.data.places[model.data.place[~model.data.is_blank]]
    if model.scene.inclusion:
        lateral_offset = np.hypot(*(places - [model.target.x, model.target.y]).T)
        if (lateral_offset > 1e-9 * (model.target.diameter or 0.0)).any():
            return False
    return ContactEvaluator().refusal_of_mesh(_place_on_axis(model)) is None


def _place_on_axis(model: TargetModel) -> Scene:
    """Return the scene with the probe over its target, or without inclusions at the reading farthest from the tissue's middle."""
    placement = Placement(x=model.target.x, y=model.target.y) if model.scene.inclusion else model.base.scene.placement
    return model.scene.model_copy(update={"placement": placement})


@dataclass
class LoadedModel:
    """Predictions by ``contact`` under the scene's load.

    Attributes
    ----------
    model
        Scene and data; ``contact`` can model the scene.
    unknown
        The number that is varied.
    accuracy
        Relative, required of ``contact``.
    """

    model: TargetModel
    unknown: str
    accuracy: float
    _blank_films: dict[Scene, FilmForces] = field(default_factory=dict)  # cache: film forces by scene without tumours
    _loaded_scenes: dict[float, LoadedScene] = field(default_factory=dict)  # cache: solved states by the target's modulus, Pa

    @property
    def unloaded_model(self) -> TargetModel:
        """The model without load, which linear elasticity describes exactly."""
        zero_load = Load(force=0.0) if self.model.scene.load.indentation is None else Load(indentation=0.0)
        return replace(self.model, scene=self.model.scene.model_copy(update={"load": zero_load}))

    def predict(self, value: float) -> LogPrediction | None:
        """Return predictions for a value of the unknown, SI; None where errors are too large, or the sign of a ratio differs.

        Raises
        ------
        ProbeError, ValueError
            ``contact`` does not reach the load, or the scene is not valid.
        """
        data, scene, probe = self.model.data, self._build_scene(value), self.model.scene.probe
        values, bounds = np.zeros((2, len(data.value)))
        for blank in set(data.is_blank.tolist()):
            films = self._solve_blank(scene) if blank else self._solve_with_target(scene, value)
            rows = data.is_blank == blank
            values[rows], bounds[rows] = np.log(films.totals.sum()), films.stiffness_error
            # the ratio of stresses or of charges: inner over outer, each over its block's area
            read = films.get_observable(scene)
            ratios, ratio = rows & ~data.is_stiffness, read.totals[0] / read.totals[1] * probe.outer_area / probe.inner_area
            values[ratios], bounds[ratios] = np.log(abs(ratio)), read.bound.log_ratio
            if (data.sign[ratios] != np.sign(ratio)).any() or bounds[rows].max() > MAX_LOG_RATIO_ERROR:
                return None
        return values, bounds

    def _build_scene(self, value: float) -> Scene:
        """Return the scene with a value of the unknown, SI, and the probe on the target's axis."""
        scene = _place_on_axis(self.model)
        if self.unknown not in TARGET_UNKNOWNS:
            return scene.replace({self.unknown: value})
        return scene.model_copy(update={"inclusion": (scene.inclusion[0].model_copy(update={self.unknown: value}),)})

    def _solve_blank(self, scene: Scene) -> FilmForces:
        """Return the film forces over tumour-free tissue."""
        blank_scene = scene.model_copy(update={"inclusion": ()})
        if blank_scene not in self._blank_films:
            self._blank_films[blank_scene] = self._solve(blank_scene)
        return self._blank_films[blank_scene]

    def _solve_with_target(self, scene: Scene, value: float) -> FilmForces:
        """Return the film forces over the target; where its modulus varies, start from the solved state with the nearest one."""
        if self.unknown != "youngs_modulus":
            return self._solve(scene)
        with start_clock(), threadpool_limits(1, user_api="blas"):
            if self._loaded_scenes:
                nearest = min(self._loaded_scenes, key=lambda modulus: abs(np.log(modulus / value)))
                forces, loaded_scene = solve_neighbour(self._loaded_scenes[nearest], value)
            else:
                loaded_scene = ContactEvaluator().load_scene(scene, self.accuracy)
                forces = loaded_scene.press_to_scene_load()
        self._loaded_scenes[value] = loaded_scene
        return forces.films

    def _solve(self, scene: Scene) -> FilmForces:
        """Return the film forces by ``contact``, computed from the unloaded state."""
        with start_clock():
            return ContactEvaluator().solve(scene, self.accuracy).films[0]


@dataclass(frozen=True)
class Span:
    """The range between two neighbouring nodes that ``contact`` has computed.

    Attributes
    ----------
    first, last
        Indices of the nodes.
    miss
        By how much the spline missed the last node that was added, shape (k,); before any, the change from end to end.
    remaining_miss
        Expected miss of the spline within the span, over the allowed one.
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

    def solve_node(self, node: int) -> None:
        """Compute the effect of the load at a node, unless errors are too large there; raises as ``LoadedModel.predict``."""
        prediction = self.loaded.predict(float(self.track.compute_values(self.track.x[node])))
        if prediction is not None:
            self.changes[node] = prediction[0] - self.track.predicted.value[node], prediction[1]

    def try_node(self, node: int) -> bool:
        """Solve a node, and return whether that succeeded."""
        if node not in self.changes:
            with suppress(ProbeError, ValueError):
                self.solve_node(node)
        return node in self.changes

    def find_farthest(self, solved: int, end: int) -> int:
        """Return the node nearest to an end of the track that can be solved, by bisection from a solved node."""
        if self.try_node(end):
            return end
        while abs(end - solved) > 1:
            middle = (solved + end) // 2
            solved, end = (middle, end) if self.try_node(middle) else (solved, middle)
        return solved

    def build_spline(self) -> CubicSpline:
        """Return the effect of the load on the data, shape (k,), as a spline along the track."""
        nodes = sorted(self.changes)
        return CubicSpline(self.track.x[nodes], [self.changes[node][0] for node in nodes])

    def refine_spans(self) -> tuple[list[Span], Bools]:
        """Solve nodes until the spline is accurate; return its spans, and which of the n nodes have no prediction, shape (n,)."""
        nodes = sorted(self.changes)
        spans = [Span(a, b, np.abs(self.changes[b][0] - self.changes[a][0]), np.inf) for a, b in pairwise(nodes)]
        is_unsolved = np.ones(len(self.track.x), dtype=bool)
        is_unsolved[nodes[0] : nodes[-1] + 1] = False
        while open_spans := [span for span in spans if span.remaining_miss > 1 and span.middle > span.first]:
            span = max(open_spans, key=lambda span: span.remaining_miss)
            spans.remove(span)  # its halves replace it, or it counts as unsolved
            expected_change = self.build_spline()(self.track.x[span.middle])
            if not self.try_node(span.middle):
                is_unsolved[span.first + 1 : span.last] = True
                continue
            miss = np.abs(expected_change - self.changes[span.middle][0])
            halves = ((span.first, span.middle), (span.middle, span.last))
            spans += [Span(a, b, miss, self._estimate_remaining_miss(a, b, miss)) for a, b in halves]
        return spans, is_unsolved

    def _estimate_remaining_miss(self, first: int, last: int, miss: Floats) -> float:
        """Return the expected miss of the spline between two neighbouring solved nodes, over the allowed one.

        ``miss`` is that at the last node that was added, shape (k,); a further node reduces it by ``MIN_IMPROVEMENT_FACTOR``.
        """
        data = self.loaded.model.data
        residual = np.array([self.track.predicted.value[node] + self.changes[node][0] - data.value for node in (first, last)])
        # smallest distance between data and prediction within the span: zero where it changes its sign
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
    loaded_track, middle = LoadedTrack(track, loaded_model), int(usable[len(usable) // 2])
    try:
        loaded_track.solve_node(middle)
    except Refusal as fault:
        raise Refusal(fault.key, fault.value, f"{fault.allowed}, {LINEAR_REMEDY}") from None
    ends = {loaded_track.find_farthest(middle, int(end)) for end in usable[[0, -1]]} & loaded_track.changes.keys()
    if len(ends) < 2:
        unresolved = replace(track.predicted, resolved=np.zeros(len(track.x), dtype=bool))
        return replace(track, predicted=unresolved, evaluator=ContactEvaluator.name)
    spans, is_unsolved = loaded_track.refine_spans()
    return _combine(loaded_track, spans, is_unsolved)


def _combine(loaded_track: LoadedTrack, spans: list[Span], is_unsolved: Bools) -> Track:
    """Return the track with the effect of the load.

    The error bound at a node is the bound of ``contact`` plus the larger miss of the spans that meet there; ``is_unsolved`` says
    which nodes have no prediction.
    """
    track, spline, nodes = loaded_track.track, loaded_track.build_spline(), sorted(loaded_track.changes)
    contact_bounds = np.array([loaded_track.changes[node][1] for node in nodes])
    bound = np.stack([np.interp(track.x, track.x[nodes], column) for column in contact_bounds.T], axis=1)
    miss = np.zeros_like(bound)
    for span in spans:
        indices = slice(span.first, span.last + 1)
        miss[indices] = np.maximum(miss[indices], span.miss)
    ratios = ~loaded_track.loaded.model.data.is_stiffness
    change = float(np.expm1(max(np.abs(loaded_track.changes[node][0][ratios]).max() for node in nodes)))
    accuracy = loaded_track.loaded.accuracy
    predicted = replace(
        track.predicted,
        value=np.where(is_unsolved[:, None], 0.0, track.predicted.value + spline(track.x)),
        bound=bound + miss,
        resolved=track.predicted.resolved & ~is_unsolved,
    )
    return replace(
        track,
        predicted=predicted,
        derivative=track.derivative + spline(track.x, 1),
        evaluator=ContactEvaluator.name,
        plan=(Decision(DECISION_FEATURE, True, change, accuracy, "what they change of the ratio at this load"),),
    )
