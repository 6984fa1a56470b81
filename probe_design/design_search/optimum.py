"""Define the result of an optimisation: start, verified designs, and the recommended one with the reason and warnings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Generic, Literal, Self, TypeVar

from geometry.common.json_types import JsonObject
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_dict
from probe_design.design_search.choices import ChoiceSearch
from probe_design.design_search.optimum_tables import OptimumTables
from probe_design.design_search.robustness import Robustness
from probe_design.design_search.scan_choices import compute_pitch
from probe_design.design_search.search_space import SearchSpace
from probe_design.design_search.tumour_objective import Noise
from probe_design.design_search.variables import SAME_DESIGN_TOLERANCE_RELATIVE, Limit
from probe_design.design_search.verification import (
    GAIN_SIGNIFICANCE,
    PopulationVerification,
    TumourVerification,
    replace_non_finite,
)
from probe_design.populations.design_file import Design
from probe_design.populations.performance import Performance
from probe_design.populations.tables import DesignLimits
from solver.contact.tumours_anywhere import SEARCHED_X
from solver.results.film_charges import warn_of_read_bonds

NO_GAIN = "no gain: no design better than the start was verified: the start is exported"
LIMIT_KEYS = {"largest outer_radius": "outer_radius", "least wall": "wall", "largest height": "height"}
FORCE_SOURCES = {
    "scene": "the scene's load", "loads": "protocol.loads", "force": "limits.force", "largest force": "variables.force",
}  # fmt: skip
FORCE_LIMIT_REASONS = {  # limits of the force that no number of the design file states
    "linearity": "the largest at which linear elasticity is accurate enough; contact models more with bonded faces alone",
    "gap_closure": "as the gap closes under more: a wider gap, or stiffer blocks, help",
    "contact": f"which indents by {SEARCHED_X:g} outer radii, the most to which designs are searched",
    "last_converged": "the largest that contact computes for this probe",
    "indentation_per_depth": "which limits.indentation_per_depth allows",
}
Verified = TypeVar("Verified", PopulationVerification, TumourVerification)


@dataclass(frozen=True, repr=False)
class Optimum(OptimumTables, Generic[Verified]):
    """The result of an optimisation.

    Attributes
    ----------
    design
        The design file.
    search_space
        The designs among which the search chose.
    start
        The scene's probe, verified.
    finalists
        Verified designs, best first.
    search
        Designs of the closed-form search.
    seconds
        Time of search and verification, s.
    """

    design: Design
    search_space: SearchSpace
    start: Verified
    finalists: tuple[Verified, ...]
    search: ChoiceSearch
    seconds: dict[str, float] = field(default_factory=dict, kw_only=True)

    @property
    def winner(self) -> Verified | None:
        """The first design that is better than the start beyond the errors of both."""
        return next((finalist for finalist in self.finalists if finalist.is_better_than(self.start)), None)

    @property
    def status(self) -> Literal["improved", "no-gain"]:
        """``improved``, or ``no-gain`` if no design is better than the start beyond the errors of both."""
        return "no-gain" if self.winner is None else "improved"

    @property
    def best(self) -> Verified:
        """The recommended design, which all files describe; the start if no gain is verified."""
        return self.winner or self.start

    @property
    def best_tried(self) -> Verified:
        """The best verified design, even if it is not better than the start; the start if there is none."""
        return self.winner or next(iter(self.finalists), self.start)

    @property
    def scene(self) -> Scene:
        """The scene of the design to build, under its load."""
        return self.best.loaded_scene

    @property
    def gain(self) -> tuple[float, float]:
        """The gain of the best design tried over the start, and its standard error."""
        return self.best_tried.compute_gain(self.start)

    @property
    def limits(self) -> tuple[Limit, ...]:
        """All limits, named by their keys in a design file, or as bounds such as ``least gap``, and whether each is active."""
        return tuple(
            Limit(LIMIT_KEYS.get(limit.name, limit.name), limit.value, limit.active)
            for limit in self.search_space.list_limits(self.best.loaded_scene)
        )

    @property
    def combination_values(self) -> dict[str, float]:
        """The best value by the closed form of each combination tried, by its description."""
        return self.search.best

    @property
    def title(self) -> str:
        """A title that states the gain, if any, and the recommended design."""
        return f"optimize: {'improved' if self.winner is not None else 'no gain, the start is exported'}"

    @property
    def others(self) -> dict[str, Verified]:
        """Designs to compare with, by their headings."""
        return {}

    def list_columns(self) -> dict[str, Verified]:
        """Return the verified designs by their headings, the recommended one last."""
        if self.winner is not None:
            return {"start": self.start, **self.others, "recommended": self.best}
        tried = {"best tried, no gain": self.best_tried} if self.finalists else {}
        return {**tried, **self.others, "start, recommended": self.best}

    def list_scenes(self) -> dict[str, Scene]:
        """See ``OptimumTables``."""
        return {heading: verified.loaded_scene for heading, verified in self.list_columns().items()}

    def warn_wide_start(self) -> Iterator[str]:
        """Yield a warning if the start's outer radius is above the limit, so that the search could not choose it."""
        start, limit = self.design.scene.probe.tube_radius, self.search_space.outer_radius
        if start > limit * (1 + SAME_DESIGN_TOLERANCE_RELATIVE):
            yield f"the start's outer radius of {start * 1e3:.4g} mm is above the limit of {limit * 1e3:.4g} mm"

    def set_seconds(self, total: float) -> Self:
        """Return the optimum with the times of search and verification, given the total, s."""
        return replace(self, seconds={"search": self.search.seconds, "judge": total - self.search.seconds, "all": total})

    def build_summary(self, files: list[str]) -> JsonObject:
        """Return the JSON object of ``probe-design optimize``; a number is null where it is unknown."""
        pairs = {"objective": self.best.objective, "baseline_objective": self.start.objective, "gain": self.gain}
        numbers: dict[str, float | None] = {}
        for name, (value, error) in pairs.items():
            numbers |= {name: replace_non_finite(value), f"{name}_error": replace_non_finite(error)}
        force, force_limit = self.best.force
        return {
            "design": scene_to_dict(self.scene),
            **numbers,
            "evaluator": self.best.evaluator,
            "baseline_evaluator": self.start.evaluator,
            "status": self.status,
            "recommended": "start" if self.winner is None else "optimum",
            "verdict": self.verdict,
            "warnings": list(self.warnings),
            "limits": [vars(limit) for limit in self.limits],
            "force": force,
            "force_limited_by": force_limit,
            "search": {"how": self.search.how, "exhaustive": self.search.exhaustive, "combinations": self.combination_values},
            "seconds": self.seconds,
            "files": files,
        }


@dataclass(frozen=True, repr=False)
class TumourOptimum(Optimum[TumourVerification]):
    """The result of an optimisation for one tumour.

    Attributes
    ----------
    noise
        Noise of a reading.
    linear_evaluator
        Evaluator for verification within linear elasticity; beyond it ``contact`` is used.
    """

    noise: Noise
    linear_evaluator: str

    @property
    def evaluators(self) -> tuple[str, ...]:
        """The evaluators of the best design tried and of the start."""
        return tuple(dict.fromkeys(verified.evaluator for verified in (self.best_tried, self.start)))

    @property
    def verdict(self) -> str:
        """See ``Optimum``."""
        best_value, start = _format_objective(self.best_tried), f"the start's {_format_objective(self.start)}"
        evaluators = f"by {' and '.join(self.evaluators)}"
        if self.winner is not None:
            return (
                f"improved: standard deviation of ln E_object {best_value} of the recommended design in place of "
                f"{start}, {evaluators}"
            )
        reduction = 1 - self.best_tried.value / self.start.value
        if not reduction > 0:
            best = f": the best tried has {best_value}" if self.finalists else ""
            comparison = f"none of {len(self.finalists)} designs has a standard deviation of ln E_object"
            return f"{NO_GAIN}; {comparison} below {start}, {evaluators}{best}"
        return (
            f"{NO_GAIN}; the standard deviation of ln E_object of the best design tried is {best_value}, "
            f"{format_percent(reduction)} less than "
            f"{start}, {evaluators}, which is within its errors"
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """See ``Optimum``."""
        return tuple(self._iterate_warnings())

    def _iterate_warnings(self) -> Iterator[str]:
        """Yield the warnings on the load, the closed form and the start."""
        yield from warn_of_read_bonds((self.winner or self.start).scene)
        recommended = () if self.winner is None else (("the recommended design", self.winner),)
        for name, verified in (*recommended, ("the start", self.start)):
            if verified.linear_design is not None:
                yield f"{name} {_describe_load_gain(verified, verified.linear_design)}"
        refused = self.start.refused or self.best.refused
        if refused is not None:
            yield (
                f"closed-form refuses this scene, which is one for {refused}; the search used its formulas all the same: "
                f"only the results of {self.linear_evaluator} are valid"
            )
        if self.winner is None:
            yield from self.warn_wide_start()

    def build_summary(self, files: list[str]) -> JsonObject:
        """See ``Optimum``."""
        best, start = self.best, self.start
        return super().build_summary(files) | {
            "linear_evaluator": self.linear_evaluator,
            "noise": self.noise.ratio,
            "charge_noise": self.noise.charge,
            "searched_objective": replace_non_finite(best.formula_value),
            "baseline_searched_objective": replace_non_finite(start.formula_value),
            "result": best.result.as_dict(),
            "baseline_result": start.result.as_dict(),
            "under_load": best.summarize_load_gain(),
            "baseline": start.as_dict(),
            "candidates": [finalist.as_dict() for finalist in self.finalists],
        }


@dataclass(frozen=True, repr=False)
class PopulationOptimum(Optimum[PopulationVerification]):
    """The result of an optimisation for a population.

    Attributes
    ----------
    single
        The verified optimum for one tumour in the middle of the population; None if there is none.
    robust
        Effect of workshop tolerances on start and finalists, by the closed form.
    why_no_single
        The reason why there is no ``single``, in words.
    """

    single: PopulationVerification | None
    robust: tuple[Robustness, ...]
    why_no_single: str = ""

    @property
    def combination_values(self) -> dict[str, float]:
        """See ``Optimum``; in the objective's own unit."""
        return {name: self.design.objective.convert_searched(value) for name, value in self.search.best.items()}

    @property
    def others(self) -> dict[str, PopulationVerification]:
        """See ``Optimum``."""
        return {} if self.single is None else {"one tumour": self.single}

    @property
    def limits(self) -> tuple[Limit, ...]:
        """See ``Optimum``; with the limits of the force and of the charge, and without bounds of moduli if materials set them."""
        pressed, given = self.best.pressed, self.design.limits
        rows = [limit for limit in super().limits if not (self.search_space.shelf and "modulus" in limit.name)]
        rows += [
            Limit(name, _get_limit_value(given, name, pressed.allowed[name]), pressed.limited_by == name)
            for name in pressed.allowed
        ]
        if given.charge is not None:
            min_charge = given.charge[0]
            active = abs(pressed.charge[0] - min_charge) <= SAME_DESIGN_TOLERANCE_RELATIVE * min_charge
            rows.append(Limit("least charge", min_charge, active))
        return tuple(rows)

    @property
    def warnings(self) -> tuple[str, ...]:
        """See ``Optimum``."""
        texts: list[str] = [*warn_of_read_bonds(self.best.scene)]
        texts += [note for item in (self.start, self.best) if (note := item.performance.draw.note)]
        texts += self.warn_wide_start()
        texts += self._warn_unused_force()
        if (warning := explain_low_detection(self.best.performance)) is not None:
            texts.append(warning)
        texts += self._warn_missing_channels()
        if self.why_no_single:
            texts.append(f"no design for one tumour to compare with: {self.why_no_single}")
        return tuple(dict.fromkeys(texts))

    def _warn_missing_channels(self) -> Iterator[str]:
        """Yield a warning that names the channels without results because their noise is too small."""
        missing = [name for name, performance in self.best.performance.by_channels.items() if performance is None]
        if missing:
            named = " and ".join(missing)
            yield f"no results for {named}: [noise] gives this channel less noise than any instrument has"

    def _warn_unused_force(self) -> Iterator[str]:
        """Yield a warning that names the limit of the force, if it is below the one that the design file allows."""
        pressed = self.best.pressed
        key = next(name for name in FORCE_SOURCES if name in pressed.allowed)
        if (reason := FORCE_LIMIT_REASONS.get(pressed.limited_by)) is not None:
            yield (
                f"{FORCE_SOURCES[key]} of {pressed.allowed[key]:.3g} N is more than the recommended design allows: verified "
                f"under {pressed.force:.3g} N, {reason}"
            )

    @property
    def verdict(self) -> str:
        """See ``Optimum``."""
        aim = self.design.objective
        gain, error = (aim.scale * number for number in self.gain)
        kind = aim.maximise.replace("_", " ")
        start, best = (aim.format_value(*verified.objective) for verified in (self.start, self.best_tried))
        by_trials = f", of {len(trials.distances)} simulated scans" if (trials := self.best_tried.trials) else ""
        change = f"a gain of {gain:.3g} {aim.unit}; twice its error is {GAIN_SIGNIFICANCE * error:.2g} {aim.unit}{by_trials}"
        if self.winner is not None:
            return f"improved: {kind} {best} of the recommended design, {start} of the start, {change}"
        if not self.finalists:
            return f"{NO_GAIN}; no other design within the limits could be verified, {kind} of the start is {start}"
        return f"{NO_GAIN}; {kind} {best} of the best design tried, {start} of the start, {change}"

    def build_summary(self, files: list[str]) -> JsonObject:
        """See ``Optimum``."""
        named = {"start": self.start, "single": self.single, "optimum": self.best, "found": self.best_tried}
        return super().build_summary(files) | {
            "maximise": self.design.objective.maximise,
            "statistic": self.design.objective.statistic,
            "population": {name: None if item is None else item.performance.as_dict() for name, item in named.items()},
            "scan_trials": {name: item and item.trials and item.trials.as_dict() for name, item in named.items()},
            "scan": {"presses": self.best.protocol.count, "pitch": compute_pitch(self.best.protocol)},
            "single_reason": self.why_no_single or None,
            "pressing": {name: None if item is None else item.summarize_pressing() for name, item in named.items()},
            "designs": {name: None if item is None else scene_to_dict(item.scene) for name, item in named.items()},
            "materials": list(self.best.materials),
            "tolerances": [item.as_dict() for item in self.robust],
        }


def _format_objective(verified: TumourVerification) -> str:
    """Return the standard deviation of ln E_object of a design as text, with its bounds by errors."""
    ends = f"above {verified.lower:.3g}" if math.isinf(verified.upper) else f"{verified.lower:.3g} to {verified.upper:.3g}"
    return f"{verified.value:.3g} ({ends} within its errors)"


def _describe_load_gain(verified: TumourVerification, linear: TumourVerification) -> str:
    """Describe what a design gains under a load beyond linear elasticity over ``linear``, the same under less load."""
    gain, error = verified.compute_gain(linear)
    return (
        f"under {verified.pressing.force:.3g} N (limited by {verified.pressing.limited_by}): "
        f"{_format_objective(verified)} in place of {_format_objective(linear)} under "
        f"{linear.pressing.force:.3g} N, where linear elasticity ends ({linear.pressing.limited_by}): a gain of "
        f"{format_percent(gain)}, "
        f"error {format_percent(error)}"
    )


def explain_low_detection(performance: Performance) -> str | None:
    """Return a warning if no more tumours are detected than false alarms would give, else None."""
    lower_limit = performance.means["detection"] - GAIN_SIGNIFICANCE * performance.errors["detection"].total
    if lower_limit > performance.false_alarm:
        return None
    detected = f"{100 * performance.means['detection']:.3g} ± {100 * performance.errors['detection'].total:.2g} of 100 tumours"
    alarms = f"{100 * performance.false_alarm:g} of 100"
    return (
        f"the recommended design detects {detected}, no more than false alarms alone may, {alarms}; "
        "the report's 'What would help most' says what to change"
    )


def _get_limit_value(given: DesignLimits, name: str, force: float) -> float:
    """Return the value of a limit in the design file; for a limit without a number, the force that it allows, N."""
    stated = getattr(given, name, None)
    if stated is None or isinstance(stated, bool):
        return force
    return float(stated[1] if name == "charge" else stated)
