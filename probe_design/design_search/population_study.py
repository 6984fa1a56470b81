"""Design a probe for a design file's population; verify it by finite elements on tumours that were not used in the search."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from time import perf_counter

from geometry.common.errors import InputError, Refusal
from geometry.scenes.scene import Scene
from geometry.scenes.scene_tables import Inclusion, Load
from probe_design.design_search.choices import Choice, ChoiceSearch, iterate_distinct, search_combinations
from probe_design.design_search.film_choices import FilmChoice
from probe_design.design_search.loaded_pressing import press_design
from probe_design.design_search.loads import PressingRule, check_load
from probe_design.design_search.optimum import PopulationOptimum
from probe_design.design_search.population_objective import MAX_SEARCH_TUMOURS, PopulationObjective
from probe_design.design_search.refinement import refine_design
from probe_design.design_search.robustness import Robustness, compute_robustness
from probe_design.design_search.scan_choices import ScanChoice
from probe_design.design_search.scan_trials import ScanTrials
from probe_design.design_search.search_space import SearchSpace, build_search_space
from probe_design.design_search.tumour_objective import Noise, TumourObjective
from probe_design.design_search.variables import SAME_DESIGN_TOLERANCE_RELATIVE
from probe_design.design_search.verification import PopulationVerification
from probe_design.populations.design_file import Design
from probe_design.populations.examination import examine
from probe_design.populations.population import ScenePopulation

Progress = Callable[[str, int, int], None]  # called with the name of a stage, the number of steps done and their total
MAX_VERIFIED = 2  # designs that are verified, besides start and single-tumour optimum
MAX_TRIED = 100  # best designs among which these are selected
SINGLE_STARTS = 4  # local searches for one tumour
MAX_SINGLE_VERIFIED = 3  # of their designs that are verified at most: the first that contact presses counts
MIN_SINGLE_NOISE = 1e-6


def optimize_for_population(design: Design, progress: Progress) -> PopulationOptimum:
    """Find the best probe for a design file's population: verify the start, search with the closed form, verify the best.

    Raises
    ------
    InputError
        A load of 0, no allowed design, or a population that does not fit the tissue.
    Refusal
        The evaluators cannot model the scene.
    """
    begin = perf_counter()
    check_load(design.scene)
    study = PopulationStudy.from_design(design, progress)
    start = study.verify_start(progress)
    search = search_combinations(study.objective, study.search_space, partial(progress, "searching with the closed form"))
    return study.verify_choices(start, search, progress).set_seconds(perf_counter() - begin)


@dataclass(frozen=True)
class PopulationStudy:
    """Search and verification of a probe for a population.

    Attributes
    ----------
    design
        The design file.
    search_space
        The designs among which the search chooses.
    objective
        Objective of the search, over some of the population's tumours.
    """

    design: Design
    search_space: SearchSpace
    objective: PopulationObjective

    @classmethod
    def from_design(cls, design: Design, progress: Progress, max_tumours: int = MAX_SEARCH_TUMOURS) -> PopulationStudy:
        """Prepare the search, with at most ``max_tumours`` tumours in its objective.

        Raises
        ------
        InputError
            The file allows no design, or its population does not fit the tissue.
        Refusal
            The closed form cannot model the scene.
        """
        search_space = build_search_space(design)
        progress("drawing the population", 0, 1)
        objective = PopulationObjective.from_design(
            design, max(search_space.outer_radius, design.scene.probe.tube_radius), max_tumours
        )
        progress("drawing the population", 1, 1)
        return cls(design, search_space, objective)

    def verify(self, scene: Scene, advance: Callable[[int, int], None], choice: Choice | None = None) -> PopulationVerification:
        """Verify a scene's probe under its allowed force, on tumours that the search did not use.

        ``advance`` is called with the number of tissues done and of all; the design of ``choice``, if any, gives the materials.

        Raises
        ------
        InputError
            The population does not fit the tissue, or the probe would leave it.
        Refusal
            The evaluators cannot model the scene.
        """
        population = ScenePopulation.from_scene(scene, self.design.population)
        scan = None if choice is None else choice.combination.scan
        design = self.design if scan is None else self.design.model_copy(update={"protocol": scan.protocol})
        loaded, pressed, pressed_tissues = press_design(self.objective.rule, scene, population.draw_tumours(unseen=True).tissues)
        examined = examine(loaded, design, unseen=True, pressed=pressed_tissues, progress=advance)
        performance = examined.evaluate_all_channels(design)
        trials = ScanTrials.from_design(design, loaded, performance.draw) if design.objective.is_located else None
        materials = () if choice is None else choice.combination.materials
        return PopulationVerification(loaded, pressed, performance, design.objective, design.protocol, trials, materials)

    def verify_start(self, progress: Progress) -> PopulationVerification:
        """Verify the start."""
        return self.verify(self.design.scene, partial(progress, "verifying the start"))

    def verify_choices(self, start: PopulationVerification, search: ChoiceSearch, progress: Progress) -> PopulationOptimum:
        """Refine the best design of a search, and verify the best that differ and one for a single tumour."""
        finalists, verified = self._select_finalists(search, progress), list[tuple[PopulationVerification, Robustness]]()
        single, reason = self._design_for_one_tumour(search.choices[0].combination.scan, progress)
        for k, (choice, scene) in enumerate(finalists):
            with suppress(Refusal):  # a design that cannot be verified is left out
                stage = f"verifying candidate {k + 1} of {len(finalists)}"
                verified.append(self._verify_choice(choice, scene, partial(progress, stage)))
        verified += [] if single is None else [single]
        sign = self.design.objective.sign
        # the best objective first, after the loss that workshop tolerances cause
        verified.sort(key=lambda pair: -sign * (pair[0].objective[0] + pair[1].expected - pair[1].nominal))
        return PopulationOptimum(
            self.design,
            self.search_space,
            start,
            tuple(design for design, _ in verified),
            search,
            None if single is None else single[0],
            (compute_robustness(self.objective, self.design.scene), *(robustness for _, robustness in verified)),
            reason,
        )

    def _select_finalists(self, search: ChoiceSearch, progress: Progress) -> list[tuple[Choice, Scene]]:
        """Select the best designs that differ, the first one refined, rounded for the workshop."""
        advance = partial(progress, "refining by equivalent-inclusion")
        better = refine_design(self.objective, self.search_space, search.choices[0], advance)
        order = [*([] if better is None else [better]), *search.choices][:MAX_TRIED]
        finalists: list[tuple[Choice, Scene]] = []
        films = list[FilmChoice | None]()
        for choice, scene in iterate_distinct(order, self.search_space, SAME_DESIGN_TOLERANCE_RELATIVE):
            film = choice.combination.film
            if film is not None and films.count(film) == 1:
                continue  # of several films and bonds, the best design of each
            with suppress(Refusal):  # by finite elements a film is in tension, or the solution fails
                self.objective.rule.compute_pressed_design(scene)
                finalists.append((choice, scene))
                films.append(film)
            if len(finalists) == MAX_VERIFIED:
                break
        return finalists

    def _verify_choice(
        self, choice: Choice, scene: Scene, advance: Callable[[int, int], None]
    ) -> tuple[PopulationVerification, Robustness]:
        """Return the verification of a design, and the effect of workshop tolerances on it."""
        objective = self.objective.set_choices(choice.combination)
        return self.verify(scene, advance, choice), compute_robustness(objective, scene)

    def _design_for_one_tumour(
        self, scan: ScanChoice | None, progress: Progress
    ) -> tuple[tuple[PopulationVerification, Robustness] | None, str]:
        """Design a probe for one tumour in the middle of the population, verify it by a scan; return it, or None and the reason.

        It is a candidate like those of the search: if it is verified to be the best, it is recommended.
        """
        if not self.search_space.free:
            return None, "no variable left to choose"
        try:
            scene = build_middle_scene(self.design)
            rule = PressingRule.from_scene(self.design.model_copy(update={"scene": scene}))
            rule = replace(rule, loaded=self.objective.rule.loaded)
            noise = Noise.from_scene(scene, max(self.design.noise.white, MIN_SINGLE_NOISE))
            objective = TumourObjective.from_scene(rule, noise, SINGLE_STARTS)
            space = replace(self.search_space, scan_choices=())  # one reading has none
            search = search_combinations(objective, space, partial(progress, "designing for one tumour"))
            distinct = iterate_distinct(search.choices, self.search_space, SAME_DESIGN_TOLERANCE_RELATIVE)
            verified = list[tuple[PopulationVerification, Robustness]]()
            for alone, best in islice(distinct, MAX_SINGLE_VERIFIED):
                choice = replace(alone, combination=replace(alone.combination, scan=scan))
                verified.append(self._verify_choice(choice, best, partial(progress, "verifying the design for one tumour")))
                if verified[-1][0].pressed.loaded or not rule.loaded:
                    break  # otherwise contact does not press this design to the load that the search estimated
            if verified:
                return max(verified, key=lambda pair: self.design.objective.sign * pair[0].objective[0]), ""
        except (Refusal, InputError) as fault:
            return None, str(fault)
        return None, "no design for one tumour within the limits"


def build_middle_scene(design: Design) -> Scene:
    """Return the scene with one tumour in the middle of the population's ranges, under the probe's axis."""
    population = ScenePopulation.from_scene(design.scene, design.population)
    middle = {key: population.ranges[key].middle for key in ("depth", "diameter", "object", "x")}
    inclusion = design.scene.inclusion[0] if design.scene.inclusion else None
    nu = inclusion.poisson_ratio if inclusion else design.scene.tissue.poisson_ratio
    placement = design.scene.placement
    # the depth keeps a cover of at least a tenth of the diameter over the tumour
    body = Inclusion(
        diameter=middle["diameter"], depth=max(middle["depth"], 0.6 * middle["diameter"]), x=placement.x, y=placement.y,
        youngs_modulus=middle["object"], poisson_ratio=nu, target=True,
    )  # fmt: skip
    load = design.scene.load if design.scene.load.force or design.scene.load.indentation else Load(force=0.1)
    return design.scene.model_copy(update={"inclusion": (body,), "load": load})
