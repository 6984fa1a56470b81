"""Evaluate many scenes at once: work that they share is done once, and a refused scene does not affect the others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TypeVar

from geometry.common.errors import ProbeError
from geometry.common.resources import Limits, limited, limits, timed
from geometry.provenance.block import provenance
from geometry.scenes.scene import Scene
from geometry.scenes.surface_names import check_surface_names
from solver import levels
from solver.answers import evaluate
from solver.automatic import allowed_plan
from solver.families import families
from solver.results.evaluator import Answer, FilmLevel, Tell
from solver.results.kinds import is_round
from solver.results.result import Result

TOGETHER = ("closed-form", "axisymmetric")  # evaluators that are faster on many scenes at once than one by one
AXISYMMETRIC, FORMULAS = "axisymmetric", "closed-form"
T = TypeVar("T")
Answered = Result | ProbeError


@dataclass(frozen=True)
class _Question:
    """The arguments of ``evaluate_many`` that hold for every scene."""

    evaluator: str
    accuracy: float
    tell: Tell | None
    linear: bool

    def alone(self, scene: Scene) -> Answered:
        """Return the result of ``evaluate`` for one scene, or the error that it raises."""
        return _caught(lambda: evaluate(scene, self.evaluator, self.accuracy, self.tell, linear=self.linear))


def evaluate_many(
    scenes: Sequence[Scene | Path | str],
    evaluator: str = levels.AUTO,
    accuracy: float = 0.01,
    tell: Tell | None = None,
    *,
    linear: bool = False,
    limits: Limits | None = None,
) -> list[Result | ProbeError]:
    """Evaluate many scenes of any kinds: what ``evaluate`` returns for each, in order, or the error that it raises.

    ``closed-form`` computes scenes of one structure on arrays, bit for bit as one by one. ``axisymmetric``, also where ``auto``
    chooses it, computes scenes that differ only in the target's modulus and the load from one curve. If it is named, and 10 or
    more scenes differ in one other number, it solves a few and interpolates the others where that adds at most 1 % of the
    accuracy to their errors. Both agree with single results within the ``error_estimate`` of both. Results that are computed
    together share ``seconds`` evenly.

    Args:
        scenes: scenes, or names of scene files.
        evaluator: see ``evaluate``.
        accuracy: see ``evaluate``.
        tell: see ``evaluate``.
        linear: see ``evaluate``.
        limits: for each scene, see ``evaluate``; scenes that are computed together may use the time of all of them.

    Raises:
        InputError: no such evaluator or accuracy. Errors of single scenes are not raised but returned in their places.

    Example:
        >>> from solver import evaluate_many
        >>> [one.ratio for one in evaluate_many(["examples/scene.toml"] * 2)]  # doctest: +SKIP
    """
    levels.check_accuracy(accuracy)
    if evaluator != levels.AUTO:
        levels.evaluator(evaluator)
    asked = _Question(evaluator, accuracy, tell, linear)
    with limited(limits):
        every = [_caught(partial(_checked, scene)) for scene in scenes]
        known = [one for one in every if isinstance(one, Scene)]
        found = iter(zip(known, answered(known, asked.evaluator, accuracy, tell, linear=linear), strict=True))
        return [_told(*next(found), asked) if isinstance(one, Scene) else one for one in every]


def answered(
    scenes: Sequence[Scene], evaluator: str, accuracy: float, tell: Tell | None = None, *, linear: bool = False
) -> list[Answered]:
    """Evaluate checked scenes as ``evaluate_many`` does; results that were computed together have no provenance."""
    alone = _Question(evaluator, accuracy, tell, linear).alone
    found = together(scenes, evaluator, accuracy, tell, linear=linear)
    return [alone(scene) if one is None else one for one, scene in zip(found, scenes, strict=True)]


def together(
    scenes: Sequence[Scene], evaluator: str, accuracy: float, tell: Tell | None = None, *, linear: bool = False
) -> list[Answered | None]:
    """Evaluate the scenes that can be computed together, without provenance; None for each that has to be evaluated alone."""
    asked = _Question(evaluator, accuracy, tell, linear)
    several = len(scenes) > 1
    if evaluator in TOGETHER and (several or evaluator == FORMULAS):  # one of formulas, too: its limits are those of many
        return [*_named(scenes, asked)]
    return _automatic(scenes, asked) if several and evaluator == levels.AUTO else [None] * len(scenes)


def _checked(scene: Scene | Path | str) -> Scene:
    known = levels.read(scene)
    check_surface_names(known)
    return known


def _told(scene: Scene, answer: Answered, asked: _Question) -> Answered:
    if isinstance(answer, Result) and answer.provenance is None:
        return replace(answer, provenance=provenance(scene, evaluator=asked.evaluator, accuracy=asked.accuracy))
    return answer


def _named(scenes: Sequence[Scene], asked: _Question) -> list[Answered]:
    """Evaluate scenes with a batch evaluator, with warnings of loads beyond linear elasticity."""
    from solver.planning.load_check import rule_by_formulas, with_warning

    level, formulas = levels.evaluator(asked.evaluator, asked.tell), asked.evaluator == FORMULAS
    assert isinstance(level, FilmLevel)
    found = _smooth(scenes, asked, level) if asked.evaluator == AXISYMMETRIC else {}
    rest = [place for place in range(len(scenes)) if place not in found]
    results = level.evaluate_many([scenes[place] for place in rest], asked.accuracy)

    def warned(result: Result, scene: Scene) -> Result:
        with timed():
            if formulas and result.stiffness is not None:  # there may be thousands of scenes: do not mesh each of them
                return with_warning(result, scene, asked.accuracy, rule_by_formulas(scene, result), "formulas")
            return with_warning(result, scene, asked.accuracy)

    for place, one in zip(rest, results, strict=True):
        found[place] = _caught(partial(warned, one, scenes[place])) if isinstance(one, Result) else one
    return [found[place] for place in range(len(scenes))]


def _smooth(scenes: Sequence[Scene], asked: _Question, level: FilmLevel) -> dict[int, Answered]:
    """Evaluate scenes that differ in one number, by their places: some are solved, the others interpolated where accurate."""
    from solver.interpolation import interpolated
    from solver.planning.load_check import rule_of_answer, with_warning

    found: dict[int, Answered] = {}
    for family in families(scenes, smooth_kinds):
        start, members = perf_counter(), [scenes[place] for place in family.places]
        pairs = interpolated(family, members, level, asked.accuracy)
        share = (perf_counter() - start) / max(sum(pair is not None for pair in pairs), 1)
        for place, scene, pair in zip(family.places.tolist(), members, pairs, strict=True):
            if pair is not None:
                with timed():
                    result = _caught(partial(pair[0].result, AXISYMMETRIC, scene, share))
                    if isinstance(result, Result):
                        rule = None if pair[1] is None else rule_of_answer(pair[1], result)
                        result = with_warning(result, scene, asked.accuracy, rule)
                    found[place] = result
    return found


def smooth_kinds(scene: Scene) -> object:
    """Return a key that scenes share if their forces and load rules are smooth functions of their numbers."""
    from solver.axisymmetric.shared_designs import smooth_kind
    from solver.planning.coarse_model import without_tumours

    return smooth_kind(scene), smooth_kind(without_tumours(scene))


def _automatic(scenes: Sequence[Scene], asked: _Question) -> list[Answered | None]:
    """Evaluate the scenes that share a design and for which the plan names ``axisymmetric``; None for the others."""
    from solver.axisymmetric.shared_designs import design

    groups: dict[Scene, list[int]] = defaultdict(list)
    for place, scene in enumerate(scenes):
        if is_round(scene):
            groups[design(scene)].append(place)
    found: dict[int, Answered | None] = {}
    for places in groups.values():
        if len(places) > 1:
            found |= zip(places, _of_one_design([scenes[place] for place in places], asked), strict=True)
    return [found.get(place) for place in range(len(scenes))]


def _of_one_design(scenes: Sequence[Scene], asked: _Question) -> Iterator[Answered | None]:
    """Evaluate scenes that share a design, in order; None where ``auto`` may choose another evaluator for the scene alone."""
    from solver.planning.coarse_model import CoarseModel

    start = perf_counter()
    with limited(replace(limits(), seconds=len(scenes) * limits().seconds)), timed():
        rough = _caught(lambda: CoarseModel.of(scenes[0]))
        if isinstance(rough, ProbeError):
            return (None for _ in scenes)
        plans = [_caught(partial(allowed_plan, one, asked.accuracy, asked.linear, rough)) for one in scenes]
    shared = {k: plan for k, plan in enumerate(plans) if not isinstance(plan, ProbeError) and plan.evaluator == AXISYMMETRIC}
    level = levels.evaluator(AXISYMMETRIC, asked.tell)
    assert isinstance(level, FilmLevel)
    every = level.answers([plan.scene for plan in shared.values()], [plan.accuracy for plan in shared.values()])
    answers = dict(zip(shared, every, strict=True))
    share = (perf_counter() - start) / len(scenes)

    def completed(k: int) -> Answered | None:
        plan, answer = plans[k], answers.get(k)
        if isinstance(plan, ProbeError):
            return plan
        if not isinstance(answer, Answer) or answer.films[0].error_under(plan.scene) > plan.allowed:
            return None
        result = _caught(
            lambda: plan.completed(answer.result(AXISYMMETRIC, plan.scene, share), scenes[k], asked.accuracy, asked.linear)
        )
        return result if isinstance(result, Result) else None  # alone, another evaluator may answer

    return (completed(k) for k in range(len(scenes)))


def _caught(made: Callable[[], T]) -> T | ProbeError:
    """Return what a function makes, or the error that the toolkit raises on purpose."""
    try:
        return made()
    except ProbeError as fault:
        return fault
