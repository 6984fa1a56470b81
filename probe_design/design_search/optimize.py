"""Optimise a design: verify the start, search with the closed form, then verify and refine the best by finite elements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Any, Protocol, TypeVar, overload

from geometry.scenes.scene import Scene
from probe_design.design_search.choices import ChoiceSearch, search_combinations
from probe_design.design_search.objective import SearchObjective
from probe_design.design_search.optimum import Optimum
from probe_design.design_search.population_optimum import PopulationOptimum
from probe_design.design_search.population_study import PopulationStudy
from probe_design.design_search.pressing import check_load
from probe_design.design_search.search_space import SearchSpace
from probe_design.design_search.tumour_optimum import TumourOptimum
from probe_design.design_search.tumour_study import TumourStudy
from probe_design.design_search.verification import VerifiedDesign
from probe_design.populations.design_file import Design

Progress = Callable[[str, int, int], None]
Verified = TypeVar("Verified", bound=VerifiedDesign)
Found = TypeVar("Found", bound=Optimum[Any], covariant=True)


class Study(Protocol[Verified, Found]):
    """Search and verification for one kind of question, a population or one tumour."""

    @property
    def search_space(self) -> SearchSpace:
        """The designs among which the search chooses."""

    @property
    def objective(self) -> SearchObjective:
        """The objective of the search, by the closed form."""

    def verify_start(self, tell: Progress) -> Verified:
        """Verify the start by a finer evaluator."""

    def verify_choices(self, start: Verified, search: ChoiceSearch, tell: Progress) -> Found:
        """Verify the best designs of a search, refine them, and compare with the start."""


@overload
def optimize(question: Design, progress: Progress | None = None) -> PopulationOptimum: ...
@overload
def optimize(question: Scene, progress: Progress | None = None, **settings: Any) -> TumourOptimum: ...
@overload
def optimize(
    question: Design | Scene, progress: Progress | None = None, **settings: Any
) -> PopulationOptimum | TumourOptimum: ...
def optimize(question: Design | Scene, progress: Progress | None = None, **settings: Any) -> PopulationOptimum | TumourOptimum:
    """Find the best probe for a design file's population, or for a single reading of a scene's target.

    Parameters
    ----------
    question
        A design file, or the scene to start from, whose tissue, inclusions, contact and load stay.
    progress
        Called with a stage's name, the number of steps done and their total.
    settings
        For a scene; a design file states these itself: ``outer_radius``, ``starts``, ``evaluator`` and ``noise``, see
        ``TumourStudy.from_scene``.

    Returns
    -------
    PopulationOptimum or TumourOptimum
        The start, the verified designs and the recommended one.

    Raises
    ------
    InputError
        A load of 0, no target, no allowed design, a population that does not fit the tissue, or a setting that is not allowed.
    Refusal
        The evaluators cannot model the scene.
    """
    tell, begin = progress or (lambda stage, done, total: None), perf_counter()
    if isinstance(question, Scene):
        return _run(TumourStudy.from_scene(question, **settings), begin, tell)
    check_load(question.scene)
    return _run(PopulationStudy.from_design(question, tell), begin, tell)


def _run(study: Study[Verified, Found], begin: float, tell: Progress) -> Found:
    start = study.verify_start(tell)
    searching = perf_counter()
    search = search_combinations(study.objective, study.search_space, partial(tell, "searching with the closed form"))
    searched = perf_counter()
    optimum = study.verify_choices(start, search, tell)
    end = perf_counter()
    seconds = {"search": searched - searching, "judge": end - searched + searching - begin, "all": end - begin}
    return replace(optimum, seconds=seconds)
