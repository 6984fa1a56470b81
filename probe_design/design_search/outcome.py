"""The result of an optimisation for a population: its gain, verdict, active limits and warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from geometry.scenes.scene import Scene
from probe_design.design_search.search_space import SearchSpace
from probe_design.design_search.verification import VerifiedDesign
from probe_design.design_search.workshop import Robustness
from probe_design.optimisation.design_space import SAME_DESIGN_TOLERANCE_RELATIVE, Limit
from probe_design.optimisation.optimum import NO_GAIN
from probe_design.populations.design_file import Design
from probe_design.populations.judgement import Judgement

GAIN_SIGNIFICANCE = 2.0  # times the combined error of judge and sample: a gain beyond it counts
LINEARITY_LIMITS = ("linearity", "gap_closure")  # limits of the force that are linear elasticity's
OF_FORCE = ("scene", "force", "linearity", "indentation", "tissue_strain", "gap_closure", "charge")


@dataclass(frozen=True)
class PopulationOptimum:
    """What was found.

    Attributes:
        design: the question.
        search_space: the designs that were to choose from.
        start: the scene's probe, judged.
        single: the optimum for one tumour in the middle of the population, judged; None where there is none, ``why_no_single``.
        finalists: designs found, judged, best first.
        robust: what workshop tolerances do to start and finalists, by the closed form.
        how: what was done with steps, choices and materials.
        exhaustive: whether every combination was tried.
        best_of: the best closed-form objective of every combination tried.
        seconds: of search and judgement.
        why_no_single: in words.
    """

    design: Design
    search_space: SearchSpace
    start: VerifiedDesign
    single: VerifiedDesign | None
    finalists: tuple[VerifiedDesign, ...]
    robust: tuple[Robustness, ...]
    how: str
    exhaustive: bool
    best_of: dict[str, float]
    seconds: dict[str, float]
    why_no_single: str = ""

    @property
    def best_tried(self) -> VerifiedDesign:
        """The best design tried, whether it is verified to be better than the start or not; the start where there is none."""
        return self.finalists[0] if self.finalists else self.start

    @property
    def gain(self) -> tuple[float, float]:
        """By how much the design found is better than the start, and one standard error of that, judge and sample together."""
        return self.best_tried.compute_gain(self.start, self.design)

    @property
    def status(self) -> Literal["improved", "no-gain"]:
        """``improved`` where the gain is verified: beyond twice its error."""
        gain, error = self.gain
        return "improved" if gain > GAIN_SIGNIFICANCE * error and gain > 0 else "no-gain"

    @property
    def best(self) -> VerifiedDesign:
        """The recommended design, of which everything speaks that is written: the start where no gain is verified."""
        return self.best_tried if self.status == "improved" else self.start

    @property
    def scene(self) -> Scene:
        """The scene of the design to build, under its force."""
        return self.best.scene

    @property
    def limits(self) -> tuple[Limit, ...]:
        """All limits and which of them the recommended design lies on."""
        scene, pressed = self.best.scene, self.best.pressed
        rows = [
            _rename_limit(limit)
            for limit in self.search_space.space.list_limits(scene)
            if not (self.search_space.shelf and "modulus" in limit.name)
        ]
        given = self.design.limits
        rows += [
            Limit(name, _get_limit_value(given, name, pressed.allowed[name]), pressed.limited_by == name)
            for name in pressed.allowed
        ]
        if given.charge is not None:
            rows.append(
                Limit(
                    "least charge",
                    given.charge[0],
                    abs(pressed.charge[0] - given.charge[0]) <= SAME_DESIGN_TOLERANCE_RELATIVE * given.charge[0],
                )
            )
        return tuple(rows)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings to the user, one line each."""
        texts = dict.fromkeys(self.start.judgement.warnings + self.best.judgement.warnings)
        start, limit = self.design.scene.probe.tube_radius, self.search_space.space.outer_radius
        if start > limit * (1 + SAME_DESIGN_TOLERANCE_RELATIVE):
            texts[f"the start's outer radius of {start * 1e3:.4g} mm is above the limit of {limit * 1e3:.4g} mm"] = None
        for text in self._warn_unused_force():
            texts[text] = None
        if (warning := explain_low_detection(self.best.judgement)) is not None:
            texts[warning] = None
        texts |= dict.fromkeys(self._warn_missing_channels())
        if self.why_no_single:
            texts[f"no design for one tumour to compare with: {self.why_no_single}"] = None
        return tuple(texts)

    def _warn_missing_channels(self) -> Iterator[str]:
        """Yield a warning that names the channels without results because their noise is too small."""
        missing = [name for name, judgement in self.best.judgement.by_observable.items() if judgement is None]
        if missing:
            named = " and ".join(missing)
            yield f"no results for {named}: [noise] gives this channel less noise than any instrument has"

    def _warn_unused_force(self) -> Iterator[str]:
        """Yield a warning if linear elasticity limits the force below the allowed one; ``contact`` takes no off-axis tumours."""
        pressed = self.best.pressed
        key = next(name for name in ("scene", "force") if name in pressed.allowed)
        if pressed.limited_by in LINEARITY_LIMITS:
            named = "limits.force" if key == "force" else "the scene's load"
            yield (
                f"{named} of {pressed.allowed[key]:.3g} N is more than linear elasticity answers for: searched and judged under "
                f"{pressed.force:.3g} N (limited by {pressed.limited_by}); contact, which knows more, takes no tumours "
                "beside the axis"
            )

    @property
    def verdict(self) -> str:
        """What was found, in one sentence."""
        kind, (gain, error) = self.design.objective.maximise, self.gain
        start, best = (_format_with_error(*verified.get_objective(self.design)) for verified in (self.start, self.best_tried))
        change = f"a gain of {gain:.3g}; twice its error is {GAIN_SIGNIFICANCE * error:.2g}"
        if self.status == "improved":
            return f"improved: {kind} {best} of the recommended design, {start} of the start, {change}"
        if not self.finalists:
            return f"{NO_GAIN}; no other design within the limits could be verified, {kind} of the start is {start}"
        return f"{NO_GAIN}; {kind} {best} of the best design tried, {start} of the start, {change}"

    def build_summary(self, files: list[str]) -> dict[str, Any]:
        """Return the JSON object of ``probe-design optimize DESIGN``."""
        from geometry.scenes.scene_file import scene_to_dict

        gain, error = self.gain
        named = {"start": self.start, "single": self.single, "optimum": self.best, "found": self.best_tried}
        return {
            "design": scene_to_dict(self.scene),
            "objective": self.best.get_objective(self.design)[0],
            "objective_error": self.best.get_objective(self.design)[1],
            "baseline_objective": self.start.get_objective(self.design)[0],
            "baseline_objective_error": self.start.get_objective(self.design)[1],
            "maximise": self.design.objective.maximise,
            "statistic": self.design.objective.statistic,
            "gain": gain,
            "gain_error": error,
            "evaluator": self.best.judgement.evaluator,
            "status": self.status,
            "recommended": "start" if self.best is self.start else "optimum",
            "verdict": self.verdict,
            "population": {name: None if item is None else item.judgement.as_dict() for name, item in named.items()},
            "single_reason": self.why_no_single or None,
            "pressing": {name: None if item is None else _summarize_pressing(item) for name, item in named.items()},
            "designs": {name: None if item is None else scene_to_dict(item.scene) for name, item in named.items()},
            "materials": list(self.best.materials),
            "limits": [{"name": item.name, "value": item.value, "active": item.active} for item in self.limits],
            "search": {"how": self.how, "exhaustive": self.exhaustive, "combinations": self.best_of},
            "tolerances": [item.as_dict() for item in self.robust],
            "seconds": self.seconds,
            "warnings": list(self.warnings),
            "files": files,
        }


def explain_low_detection(judgement: Judgement) -> str | None:
    """Return a warning if no more tumours are detected than false alarms would give, else None."""
    lower_limit = judgement.detection - GAIN_SIGNIFICANCE * judgement.detection_error
    if lower_limit > judgement.false_alarm:
        return None
    detected = f"{100 * judgement.detection:.3g} ± {100 * judgement.detection_error:.2g} of 100 tumours"
    alarms = f"{100 * judgement.false_alarm:g} of 100"
    return (
        f"the recommended design detects {detected}, no more than false alarms alone may, {alarms}; "
        "the report's 'What would help most' says what to change"
    )


def _summarize_pressing(verified: VerifiedDesign) -> dict[str, Any]:
    pressed = verified.pressed
    return {
        "force": pressed.force, "indentation": pressed.indentation, "tissue_strain": pressed.tissue_strain,
        "charge": list(pressed.charge), "limited_by": pressed.limited_by,
    }  # fmt: skip


def _format_with_error(value: float, error: float) -> str:
    return f"{value:.3f} ± {error:.2g}"


def _rename_limit(limit: Limit) -> Limit:
    """Return a limit under the name of its key in the design file; bounds of variables keep theirs, such as ``least gap``."""
    names = {"largest outer_radius": "outer_radius", "least wall": "wall", "largest height": "height"}
    return Limit(names.get(limit.name, limit.name), limit.value, limit.active)


def _get_limit_value(given: Any, name: str, force: float) -> float:
    """Return the value of a limit in the design file; for a limit without a number, the force that it allows, N."""
    stated = getattr(given, name, None)
    if stated is None or isinstance(stated, bool):
        return force
    return float(stated[1] if name == "charge" else stated)
