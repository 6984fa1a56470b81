"""Evaluate many scenes at once: work that they share is done once, and a refused scene does not affect the others."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, TypeVar, cast

from geometry.common.calls import check_call
from geometry.common.errors import InputError, ProbeError, import_extra
from geometry.common.resources import Limits, get_limits, start_clock, use_limits
from geometry.provenance.block import build_provenance
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import load_scene
from geometry.scenes.surface_names import check_surface_names
from solver import evaluators
from solver.automatic import build_allowed_plan
from solver.evaluation import evaluate, explain_error, find_doubts
from solver.results.evaluator import FilmEvaluator, FilmSolution, ProgressCallback
from solver.results.lazy_sequence import LazySequence
from solver.results.refusals import is_round
from solver.results.result import Result

if TYPE_CHECKING:
    import pandas as pd

    from solver.closed_form.evaluator import ClosedForm, SolvedScene

AXISYMMETRIC, CLOSED_FORM = "axisymmetric", "closed-form"
T = TypeVar("T")
ResultOrError = Result | ProbeError
_Joint = ResultOrError | Callable[[], ResultOrError] | None  # a result, what builds it, or None: to be evaluated alone


class ResultList(LazySequence[ResultOrError]):
    """Results in the order of their scenes, with errors in the place of scenes that were refused."""

    def to_frame(self) -> pd.DataFrame:
        """Return a pandas frame: a row for each scene, its numbers by name in SI units, and ``error``, None where there is none.

        Raises
        ------
        MissingLibrary
            Pandas is not installed.
        """
        rows = [
            {"error": str(item)} if isinstance(item, ProbeError) else item.collect_numbers() | {"error": None} for item in self
        ]
        frame: pd.DataFrame = import_extra("pandas").DataFrame(rows)
        return frame


@dataclass(frozen=True)
class _Request:
    """The arguments of ``evaluate_many`` that hold for every scene."""

    evaluator: str
    accuracy: float
    progress: ProgressCallback | None
    linear: bool


@check_call
def evaluate_many(
    scenes: Sequence[Scene | Path | str],
    evaluator: str = evaluators.AUTO,
    accuracy: float | None = None,
    progress: ProgressCallback | None = None,
    *,
    linear: bool = False,
    limits: Limits | None = None,
) -> ResultList:
    """Evaluate many scenes of any kinds: what ``evaluate`` returns for each, in order, or the error that it raises.

    ``closed-form`` computes scenes of one structure on arrays, bit for bit as one by one, and builds each result when it is read
    from the sequence; load limits are those of formulas, without a mesh. ``axisymmetric``, also where ``auto``
    chooses it, computes scenes that differ only in the target's modulus and the load from one curve, which agrees with single
    results within the ``error_estimate`` of both. Results that are computed together share ``seconds`` evenly. ``to_frame()`` of
    what is returned has a row for each scene.

    Parameters
    ----------
    scenes
        Scenes, or names of scene files.
    evaluator
        See ``evaluate``.
    accuracy
        See ``evaluate``.
    progress
        See ``evaluate``.
    linear
        See ``evaluate``.
    limits
        For each scene, see ``evaluate``; scenes that are computed together may use the time of all of them.

    Raises
    ------
    InputError
        No such evaluator or accuracy. Errors of single scenes are not raised but returned in their places.

    Examples
    --------
    >>> from solver import evaluate_many
    >>> [result.ratio for result in evaluate_many(["examples/scene.toml"] * 2)]  # doctest: +SKIP
    """
    if isinstance(scenes, Scene | str | Path) or not isinstance(scenes, Iterable):
        raise InputError("scenes", scenes, "several scenes or names of scene files; evaluate takes one")
    is_of_scene = accuracy is None
    if accuracy is not None:
        evaluators.check_accuracy(accuracy)
    if evaluator != evaluators.AUTO:
        evaluators.evaluator(evaluator)
    with use_limits(limits):
        checked = [_catch_error(partial(_read_and_check, scene)) for scene in scenes]
        valid_scenes = [item for item in checked if isinstance(item, Scene)]
        accuracies = [evaluators.choose_accuracy(scene, accuracy) for scene in valid_scenes]
        joint_results = iter(_evaluate_by_accuracy(valid_scenes, accuracies, evaluator, progress, linear=linear))

        def complete(scene: Scene, result: ResultOrError | Callable[[], ResultOrError]) -> ResultOrError:
            """Return the result of a scene with its doubts and its provenance, or its error."""
            result = result() if callable(result) else result
            if isinstance(result, ProbeError):
                return result
            record = build_provenance(scene, evaluator=evaluator, accuracy=evaluators.choose_accuracy(scene, accuracy))
            notes = explain_error(scene, result) if is_of_scene else ()
            return replace(result, warnings=(*find_doubts(scene), *result.warnings, *notes), provenance=record)

        def prepare(item: Scene | ProbeError) -> Callable[[], ResultOrError]:
            """Return what builds the result of a scene; a scene that cannot be computed with others is evaluated at once."""
            if isinstance(item, ProbeError):
                return lambda: item
            result = next(joint_results)
            if result is not None:
                return partial(complete, item, result)
            alone = _catch_error(lambda: evaluate(item, evaluator, accuracy, progress, linear=linear))
            return lambda: alone

        return ResultList([prepare(item) for item in checked])


def evaluate_together(
    scenes: Sequence[Scene], evaluator: str, accuracy: float, progress: ProgressCallback | None = None, *, linear: bool = False
) -> list[ResultOrError | None]:
    """Evaluate the scenes that can be computed together, without provenance; None for each that has to be evaluated alone."""
    results = _evaluate_jointly(scenes, _Request(evaluator, accuracy, progress, linear))
    return [result() if callable(result) else result for result in results]


def _evaluate_by_accuracy(
    scenes: Sequence[Scene],
    accuracies: Sequence[float],
    evaluator: str,
    progress: ProgressCallback | None,
    *,
    linear: bool,
) -> list[_Joint]:
    """Evaluate the scenes of each accuracy together, as ``_evaluate_jointly``; return results in the order of the scenes."""
    results: list[_Joint] = [None] * len(scenes)
    for accuracy in dict.fromkeys(accuracies):
        places = [place for place, value in enumerate(accuracies) if value == accuracy]
        request = _Request(evaluator, accuracy, progress, linear)
        for place, result in zip(places, _evaluate_jointly([scenes[place] for place in places], request), strict=True):
            results[place] = result
    return results


def _evaluate_jointly(scenes: Sequence[Scene], request: _Request) -> Sequence[_Joint]:
    """Evaluate the scenes that can be computed together; a result of the formulas is a function that builds it."""
    if request.evaluator == CLOSED_FORM:
        return _evaluate_formulas(scenes, request)  # also a single scene, so that load limits are the same for many
    if request.evaluator == AXISYMMETRIC and len(scenes) > 1:
        return _evaluate_axisymmetric(scenes, request)
    return _evaluate_shared_designs(scenes, request) if request.evaluator == evaluators.AUTO else [None] * len(scenes)


def _read_and_check(scene: Scene | Path | str) -> Scene:
    """Read a scene, and check the names of its surface files."""
    valid_scene = load_scene(scene)
    check_surface_names(valid_scene)
    return valid_scene


def _evaluate_formulas(scenes: Sequence[Scene], request: _Request) -> list[_Joint]:
    """Evaluate scenes with ``closed-form`` on arrays; return a refusal, or a function that builds the result."""
    from solver.planning.load_check import add_load_warning, build_rule_from_formulas

    formulas = cast("ClosedForm", evaluators.evaluator(CLOSED_FORM))  # by its name, as other commands need not load it
    start = perf_counter()
    solved = formulas.solve_arrays(scenes)
    seconds_each = (perf_counter() - start) / max(len(scenes), 1)

    def build(item: SolvedScene) -> Result:
        """Build a result with load limits, and with a warning where the load is beyond them."""
        with start_clock():
            solution = item.build_solution(request.accuracy)
            result = solution.build_result(CLOSED_FORM, item.scene, seconds_each)
            # by formulas: there may be thousands of scenes, so that none is meshed
            rule = build_rule_from_formulas(item.scene, result)
            return add_load_warning(result, item.scene, request.accuracy, rule, "formulas")

    return [item if isinstance(item, ProbeError) else partial(_catch_error, partial(build, item)) for item in solved]


def _evaluate_axisymmetric(scenes: Sequence[Scene], request: _Request) -> list[ResultOrError]:
    """Evaluate scenes with ``axisymmetric``, all at once, and warn of loads beyond linear elasticity."""
    from solver.planning.load_check import add_load_warning

    film_evaluator = evaluators.evaluator(AXISYMMETRIC, request.progress)
    assert isinstance(film_evaluator, FilmEvaluator)
    results = film_evaluator.evaluate_many(scenes, request.accuracy)

    def add_warning(result: Result, scene: Scene) -> Result:
        """Add load limits, and a warning beyond the linear limit."""
        with start_clock():
            return add_load_warning(result, scene, request.accuracy)

    return [
        _catch_error(partial(add_warning, result, scene)) if isinstance(result, Result) else result
        for result, scene in zip(results, scenes, strict=True)
    ]


def _evaluate_shared_designs(scenes: Sequence[Scene], request: _Request) -> list[ResultOrError | None]:
    """Evaluate the scenes that share a design and for which the plan names ``axisymmetric``; None for the others.

    Scenes of one design differ only in the target's modulus and the load.
    """
    from solver.axisymmetric.shared_designs import get_design

    groups: dict[Scene, list[int]] = defaultdict(list)
    for place, scene in enumerate(scenes):
        if is_round(scene):
            groups[get_design(scene)].append(place)
    results: dict[int, ResultOrError | None] = {}
    for places in groups.values():
        if len(places) > 1:
            results |= zip(places, _evaluate_one_design([scenes[place] for place in places], request), strict=True)
    return [results.get(place) for place in range(len(scenes))]


def _evaluate_one_design(scenes: Sequence[Scene], request: _Request) -> Iterator[ResultOrError | None]:
    """Evaluate scenes that share a design, in order; None where ``auto`` may choose another evaluator for the scene alone."""
    from solver.planning.coarse_model import CoarseModel

    start = perf_counter()
    with use_limits(replace(get_limits(), seconds=len(scenes) * get_limits().seconds)), start_clock():
        coarse = _catch_error(lambda: CoarseModel.from_scene(scenes[0]))
        if isinstance(coarse, ProbeError):
            return (None for _ in scenes)  # each alone raises the error
        plans = [_catch_error(partial(build_allowed_plan, scene, request.accuracy, request.linear, coarse)) for scene in scenes]
    shared = {k: plan for k, plan in enumerate(plans) if not isinstance(plan, ProbeError) and plan.evaluator == AXISYMMETRIC}
    film_evaluator = evaluators.evaluator(AXISYMMETRIC, request.progress)
    assert isinstance(film_evaluator, FilmEvaluator)
    solutions = film_evaluator.solve_many([plan.scene for plan in shared.values()], [plan.accuracy for plan in shared.values()])
    solution_of_place = dict(zip(shared, solutions, strict=True))
    seconds_each = (perf_counter() - start) / len(scenes)

    def complete(k: int) -> ResultOrError | None:
        """Return the result or the refusal of scene k; None where it is not accurate enough."""
        plan, solution = plans[k], solution_of_place.get(k)
        if isinstance(plan, ProbeError):
            return plan
        if not isinstance(solution, FilmSolution) or solution.films[0].compute_max_error(plan.scene) > plan.allowed:
            return None
        result = _catch_error(
            lambda: plan.complete_result(
                solution.build_result(AXISYMMETRIC, plan.scene, seconds_each), scenes[k], request.accuracy, request.linear
            )
        )
        return result if isinstance(result, Result) else None  # evaluated alone, another evaluator may reach the accuracy

    return (complete(k) for k in range(len(scenes)))


def _catch_error(make: Callable[[], T]) -> T | ProbeError:
    """Return what a function returns, or the ``ProbeError`` that it raises; other errors are raised further."""
    try:
        return make()
    except ProbeError as fault:
        return fault
