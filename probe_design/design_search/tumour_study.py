"""Design a probe for one tumour read once: a population of one, verified by finite elements under the scene's load.

If the scene allows more load than linear elasticity, the load is one more variable, and ``contact`` verifies the designs. If the
limit of the load influenced the choice of designs, a wider limit would choose other designs, which might be worse. Designs under
larger loads therefore come from searches whose load is limited by linear elasticity alone: the best ``PRESSED_DESIGNS`` within
the limits, and the best within each smaller radius of ``OUTER_RADII_M``, since the same force presses a narrower probe deeper.
Designs that would not become better than the best so far if their log-sensitivity grew by the factor ``MAX_SENSITIVITY_GROWTH``
are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from time import perf_counter
from typing import Any

from geometry.common.errors import InputError, Refusal, SolveError, describe_choices
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Load
from probe_design.data.noise import DEFAULT_NOISE
from probe_design.design_search.choices import ChoiceSearch, iterate_distinct, search_combinations
from probe_design.design_search.closed_search import refine_by_ipopt
from probe_design.design_search.contact_verification import (
    CONTACT_EVALUATOR,
    evaluate_by_contact,
    needs_contact,
    optimize_load,
)
from probe_design.design_search.loads import PressingRule, check_load
from probe_design.design_search.optimum import TumourOptimum
from probe_design.design_search.search_space import SearchSpace, build_search_space
from probe_design.design_search.tumour_objective import FiniteElementObjective, Noise, TumourObjective
from probe_design.design_search.variables import read_vector
from probe_design.design_search.verification import (
    FINER_ACCURACY,
    VERIFICATION_ACCURACY,
    TumourVerification,
    evaluate_closed_form,
    merge_designs,
    verify_tumour_design,
)
from probe_design.populations.design_file import Design
from probe_design.populations.tables import DesignLimits, NoiseModel, PopulationRanges, Protocol
from solver import evaluator as find_evaluator

EVALUATORS = ("axisymmetric", "equivalent-inclusion")
DEFAULT_STARTS = 8  # local searches
MAX_VERIFIED = 10
MIN_LOG_DISTANCE = 0.05  # of the logarithm of a variable: only one of two designs closer to each other is verified
REFINED_DESIGNS = 3  # of the best
MAX_REFINEMENT_STEPS, REFINEMENT_TOLERANCE = 15, 1e-3  # of IPOPT; each step costs one to a few solutions with derivatives
PRESSED_DESIGNS = 3  # of the best within the limits
OUTER_RADII_M = (1e-3, 1.6e-3, 2.5e-3, 4e-3, 6.3e-3, 10e-3, 16e-3, 25e-3)  # m: preferred numbers, R5 of ISO 3
STARTS_WITHIN_RADIUS = 2  # local searches within each
MAX_SENSITIVITY_GROWTH = 2.5  # of the log-sensitivity by load; 1.3 to 2 were observed
UNLIMITED_FORCE_N = 1e9  # N: the largest force that a scene may have
Progress = Callable[[str, int, int], None]


def optimize_for_tumour(scene: Scene, progress: Progress, **settings: Any) -> TumourOptimum:
    """Find the best probe for a single reading of a scene's target: verify the start, search, then verify the best designs.

    Settings and exceptions are those of ``TumourStudy.from_scene``.
    """
    begin = perf_counter()
    study = TumourStudy.from_scene(scene, **settings)
    start = study.verify_start(progress)
    search = search_combinations(study.objective, study.search_space, partial(progress, "searching with the closed form"))
    return study.verify_choices(start, search, progress).set_seconds(perf_counter() - begin)


@dataclass(frozen=True)
class TumourStudy:
    """Search and verification of a probe for the target of a scene.

    Attributes
    ----------
    design
        The scene as a design file: a population of its own tumour, read once; the objective is eq. DS.6.
    search_space
        The designs among which the search chooses.
    objective
        Objective of the search.
    evaluator
        Evaluator for the verification within linear elasticity.
    """

    design: Design
    search_space: SearchSpace
    objective: TumourObjective
    evaluator: str

    @classmethod
    def from_scene(
        cls,
        scene: Scene,
        outer_radius: float | None = None,
        starts: int = DEFAULT_STARTS,
        evaluator: str | None = None,
        noise: float = DEFAULT_NOISE,
    ) -> TumourStudy:
        """Return the study of a scene; its tissue, inclusions, contact and load stay.

        Parameters
        ----------
        scene
            The start.
        outer_radius
            Limit of the outer radius in m; 1.4 times the start's by default.
        starts
            Local searches.
        evaluator
            One of ``EVALUATORS``; by default the first that can model the scene.
        noise
            Relative standard deviation of one reading of the ratio.

        Raises
        ------
        InputError
            The scene has no target or a load of 0, no design fits, or evaluator or noise are not allowed.
        Refusal
            The closed form has no sensitivity, or the scene is too extreme to be solved.
        """
        if scene.target is None:
            allowed = "one inclusion, or one of several marked target = true: its modulus is to be estimated"
            raise InputError("inclusion.target", "none", allowed)
        check_load(scene)
        reading = Noise.from_scene(scene, noise)
        design = Design.model_construct(
            scene=scene,
            population=PopulationRanges(samples=1),
            protocol=Protocol(positions=(0.0,), stiffness=False),
            noise=NoiseModel().model_copy(update={"white": noise, "charge": reading.charge}),
            limits=DesignLimits().model_copy(update={"outer_radius": outer_radius}),
        )
        try:
            search_space = build_search_space(design)
        except InputError as fault:
            raise InputError("outer-radius", fault.value, fault.allowed) from None
        name = _select_evaluator(scene, evaluator)
        return cls(design, search_space, TumourObjective.from_scene(PressingRule.from_scene(design), reading, starts), name)

    @property
    def scene(self) -> Scene:
        """The start."""
        return self.design.scene

    @property
    def noise(self) -> Noise:
        """The noise of the reading."""
        return self.objective.noise

    def verify(self, scene: Scene, accuracy: float = VERIFICATION_ACCURACY) -> TumourVerification:
        """Verify a scene's probe within linear elasticity.

        Raises
        ------
        Refusal
            The evaluator cannot model the scene.
        """
        return verify_tumour_design(scene, self.noise, self.evaluator, accuracy)

    def verify_start(self, progress: Progress) -> TumourVerification:
        """Verify the start."""
        progress("verifying the start", 0, 1)
        start = self.verify(self.scene)
        progress("verifying the start", 1, 1)
        return start

    def verify_choices(self, start: TumourVerification, search: ChoiceSearch, progress: Progress) -> TumourOptimum:
        """Verify and refine the best designs of a search, and compare them with the start.

        If the scene's load is beyond linear elasticity, start and designs are also verified by ``contact`` under larger loads.
        If errors hide a gain within linear elasticity, start and best design are verified more accurately.
        """
        finalists = self._verify_best(search, progress)
        if any(map(needs_contact, (start, *finalists))):
            finalists = merge_designs((*finalists, *self._search_loaded(progress)))
            progress("pressing the start by contact", 0, 1)
            loaded = optimize_load(start, self.noise)
            if loaded is start and finalists and finalists[0].evaluator == CONTACT_EVALUATOR:
                loaded = evaluate_by_contact(start, self.noise)  # so that both have errors of the same model
            start = loaded
            progress("pressing the start by contact", 1, 1)
        hidden = finalists and finalists[0].value < start.value and not finalists[0].is_better_than(start)
        if hidden and start.linear is None and finalists[0].linear is None:
            with suppress(Refusal):  # errors hide the gain: verify start and best more accurately
                start, best = (self.verify(item.scene, FINER_ACCURACY) for item in (start, finalists[0]))
                finalists = merge_designs((best, *finalists[1:]))
        return TumourOptimum(self.design, self.search_space, start, finalists, search, self.noise, self.evaluator)

    def replace_scene(self, scene: Scene) -> TumourStudy:
        """Return the study of another scene within the same limits."""
        design = self.design.model_copy(update={"scene": scene})
        space = replace(self.search_space, scene=scene)
        objective = replace(self.objective, rule=replace(self.objective.rule, design=design))
        return replace(self, design=design, search_space=space, objective=objective)

    def _verify_best(self, search: ChoiceSearch, progress: Progress) -> tuple[TumourVerification, ...]:
        """Verify the best designs of a search and refine the best of these; best first."""
        scenes = [
            scene for _, scene in islice(iterate_distinct(search.choices, self.search_space, MIN_LOG_DISTANCE), MAX_VERIFIED)
        ]
        verified = merge_designs(self._verify_scenes(scenes, partial(progress, f"verifying candidates by {self.evaluator}")))
        refined = self._refine(verified[:REFINED_DESIGNS], partial(progress, f"refining by {self.evaluator}"))
        return merge_designs((*verified, *refined))

    def _verify_scenes(self, scenes: list[Scene], advance: Callable[[int, int], None]) -> Iterator[TumourVerification]:
        """Yield the verified designs of scenes, without those that the evaluator cannot model."""
        for k, (scene, formula) in enumerate(zip(scenes, evaluate_closed_form(scenes), strict=True)):
            advance(k, len(scenes))
            with suppress(Refusal):  # a design that cannot be verified is no candidate
                yield verify_tumour_design(scene, self.noise, self.evaluator, formula=formula)
        advance(len(scenes), len(scenes))

    def _refine(
        self, verified: tuple[TumourVerification, ...], advance: Callable[[int, int], None]
    ) -> Iterator[TumourVerification]:
        """Refine designs by finite elements, and yield those for which that succeeds, verified."""
        for k, item in enumerate(verified):
            advance(k, len(verified))
            with suppress(Refusal, SolveError):  # a design without derivatives stays unchanged
                scene = self.refine_scene(item.scene)
                if scene is not None:
                    yield self.verify(scene)
        advance(len(verified), len(verified))

    def refine_scene(self, scene: Scene) -> Scene | None:
        """Return the local optimum near a scene's probe by finite elements, rounded for a workshop; None where that fails.

        Raises
        ------
        Refusal
            The evaluator cannot model the scene.
        """
        space = self.search_space
        optimum = refine_by_ipopt(
            FiniteElementObjective(self.objective, space, scene, self.evaluator),
            space,
            read_vector(scene, space.names),
            poisson=self.search_space.start_poisson,
            steps=MAX_REFINEMENT_STEPS,
            tolerance=REFINEMENT_TOLERANCE,
        )
        return space.build_scene(optimum)

    def _search_loaded(self, progress: Progress) -> Iterator[TumourVerification]:
        """Yield designs from searches without a limit of the load, each under its best load up to the scene's."""
        study = self.replace_scene(remove_load_limit(self.scene))

        def report_unlimited(stage: str, done: int, total: int) -> None:
            """Report progress, with the stage marked as one without a limit of the load."""
            progress(f"{stage}, at any load", done, total)

        advance = partial(report_unlimited, "searching with the closed form")
        unlimited = study._verify_best(search_combinations(study.objective, study.search_space, advance), report_unlimited)
        for item in unlimited:
            with suppress(Refusal):
                yield self.restore_load(item)
        stage, best = "pressing finalists by contact", math.inf
        radii = [radius for radius in OUTER_RADII_M[::-1] if radius < self.search_space.outer_radius]
        finalists: tuple[TumourVerification | float, ...] = (*unlimited[:PRESSED_DESIGNS], *radii)
        for k, source in enumerate(finalists):
            progress(stage, k, PRESSED_DESIGNS + len(radii))
            with suppress(Refusal, InputError):  # no probe fits within a radius, or a design cannot be verified
                verified = self.restore_load(source if isinstance(source, TumourVerification) else self._find_best_within(source))
                if needs_contact(verified) and self._can_improve(verified, best):
                    verified = optimize_load(verified, self.noise)
                best = min(best, verified.value)
                yield verified
        progress(stage, PRESSED_DESIGNS + len(radii), PRESSED_DESIGNS + len(radii))

    def restore_load(self, unlimited: TumourVerification) -> TumourVerification:
        """Return a design of a search without load limit under the scene's load, or the largest within linear elasticity.

        Raises
        ------
        Refusal
            See ``verify``.
        """
        scene = unlimited.scene.model_copy(update={"load": self.scene.load})
        if scene.load.force is None or scene.load.force < unlimited.pressing.force:
            return self.verify(scene)
        return replace(unlimited, scene=scene)  # linear elasticity limits the load, as before: the results hold

    def _find_best_within(self, radius: float) -> TumourVerification:
        """Return the best design no wider than a radius, by a search without a limit of the load."""
        scene = remove_load_limit(self.scene)
        study = TumourStudy.from_scene(scene, radius, STARTS_WITHIN_RADIUS, self.evaluator, self.noise.ratio)
        search = search_combinations(study.objective, study.search_space, lambda done, total: None)
        for _, best in iterate_distinct(search.choices, study.search_space, MIN_LOG_DISTANCE):
            return self.verify(best)
        raise InputError("outer-radius", radius, "a limit within which a design fits")

    def _can_improve(self, verified: TumourVerification, best: float) -> bool:
        """Return whether a design could become better than the best standard deviation so far under more load.

        Under more load the charge noise becomes negligible and the log-sensitivity grows by ``MAX_SENSITIVITY_GROWTH`` at most.
        """
        abs_sensitivity = abs(verified.result.reading.log_sensitivity or 0.0)
        return abs_sensitivity > 0 and self.noise.ratio / (MAX_SENSITIVITY_GROWTH * abs_sensitivity) < best


def remove_load_limit(scene: Scene) -> Scene:
    """Return a scene under a load beyond linear elasticity for any probe."""
    return scene.model_copy(update={"load": Load(force=UNLIMITED_FORCE_N)})


def _select_evaluator(scene: Scene, name: str | None) -> str:
    """Return the name of the evaluator; by default the first that can model the scene."""
    if name is None:
        return next((known for known in EVALUATORS if find_evaluator(known).refusal(scene) is None), EVALUATORS[0])
    if name not in EVALUATORS:
        raise InputError("evaluator", name, f"to verify designs {describe_choices(name, EVALUATORS)}")
    return name
