"""The result of an optimisation for a population: its gain, verdict, active limits and warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from geometry.scenes.scene import Scene
from probe_design.design_search.judging import JudgedDesign
from probe_design.design_search.room import Room
from probe_design.design_search.workshop import Robustness
from probe_design.optimisation.design_space import CLOSE, Limit
from probe_design.optimisation.optimum import NO_GAIN
from probe_design.populations.design_file import Design
from probe_design.populations.judgement import Judgement

SURE = 2.0  # times the combined error of judge and sample: a gain beyond it counts
LINEAR = ("linearity", "gap_closure")  # limits of the force that are linear elasticity's
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
    room: Room
    start: JudgedDesign
    single: JudgedDesign | None
    finalists: tuple[JudgedDesign, ...]
    robust: tuple[Robustness, ...]
    how: str
    exhaustive: bool
    best_of: dict[str, float]
    seconds: dict[str, float]
    why_no_single: str = ""

    @property
    def found(self) -> JudgedDesign:
        """The best design tried, whether it is verified to be better than the start or not; the start where there is none."""
        return self.finalists[0] if self.finalists else self.start

    @property
    def gain(self) -> tuple[float, float]:
        """By how much the design found is better than the start, and one standard error of that, judge and sample together."""
        return self.found.gain_over(self.start, self.design)

    @property
    def status(self) -> Literal["improved", "no-gain"]:
        """``improved`` where the gain is verified: beyond twice its error."""
        gain, error = self.gain
        return "improved" if gain > SURE * error and gain > 0 else "no-gain"

    @property
    def best(self) -> JudgedDesign:
        """The recommended design, of which everything speaks that is written: the start where no gain is verified."""
        return self.found if self.status == "improved" else self.start

    @property
    def scene(self) -> Scene:
        """The scene of the design to build, under its force."""
        return self.best.scene

    @property
    def limits(self) -> tuple[Limit, ...]:
        """All limits and which of them the recommended design lies on."""
        scene, pressed = self.best.scene, self.best.pressed
        rows = [_renamed(one) for one in self.room.space.limits(scene) if not (self.room.shelf and "modulus" in one.name)]
        given = self.design.limits
        rows += [Limit(name, _value(given, name, pressed.allowed[name]), pressed.by == name) for name in pressed.allowed]
        if given.charge is not None:
            rows.append(
                Limit("least charge", given.charge[0], abs(pressed.charge[0] - given.charge[0]) <= CLOSE * given.charge[0])
            )
        return tuple(rows)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings to the user, one line each."""
        told = dict.fromkeys(self.start.judgement.warnings + self.best.judgement.warnings)
        start, limit = self.design.scene.probe.tube_radius, self.room.space.outer_radius
        if start > limit * (1 + CLOSE):
            told[f"the start's outer radius of {start * 1e3:.4g} mm is above the limit of {limit * 1e3:.4g} mm"] = None
        for text in self._force_unused():
            told[text] = None
        if (hardly := hardly_detected(self.best.judgement)) is not None:
            told[hardly] = None
        told |= dict.fromkeys(self._not_judged())
        if self.why_no_single:
            told[f"no design for one tumour to compare with: {self.why_no_single}"] = None
        return tuple(told)

    def _not_judged(self) -> Iterator[str]:
        """Yield a warning that names the channels without results because their noise is too small."""
        missing = [name for name, one in self.best.judgement.by_observable.items() if one is None]
        if missing:
            named = " and ".join(missing)
            yield f"no results for {named}: [noise] gives this channel less noise than any instrument has"

    def _force_unused(self) -> Iterator[str]:
        """Yield a warning if linear elasticity limits the force below the allowed one; ``contact`` takes no off-axis tumours."""
        pressed = self.best.pressed
        key = next(name for name in ("scene", "force") if name in pressed.allowed)
        if pressed.by in LINEAR:
            named = "limits.force" if key == "force" else "the scene's load"
            yield (
                f"{named} of {pressed.allowed[key]:.3g} N is more than linear elasticity answers for: searched and judged under "
                f"{pressed.force:.3g} N (limited by {pressed.by}); contact, which knows more, takes no tumours beside the axis"
            )

    @property
    def verdict(self) -> str:
        """What was found, in one sentence."""
        kind, (gain, error) = self.design.objective.maximise, self.gain
        start, found = (_told(*one.value(self.design)) for one in (self.start, self.found))
        change = f"a gain of {gain:.3g}; twice its error is {SURE * error:.2g}"
        if self.status == "improved":
            return f"improved: {kind} {found} of the recommended design, {start} of the start, {change}"
        if not self.finalists:
            return f"{NO_GAIN}; no other design within the limits could be verified, {kind} of the start is {start}"
        return f"{NO_GAIN}; {kind} {found} of the best design tried, {start} of the start, {change}"

    def summary(self, files: list[str]) -> dict[str, Any]:
        """Return the JSON object of ``probe-design optimize DESIGN``."""
        from geometry.scenes.scene_file import scene_to_dict

        gain, error = self.gain
        named = {"start": self.start, "single": self.single, "optimum": self.best, "found": self.found}
        return {
            "design": scene_to_dict(self.scene),
            "objective": self.best.value(self.design)[0],
            "objective_error": self.best.value(self.design)[1],
            "baseline_objective": self.start.value(self.design)[0],
            "baseline_objective_error": self.start.value(self.design)[1],
            "maximise": self.design.objective.maximise,
            "statistic": self.design.objective.statistic,
            "gain": gain,
            "gain_error": error,
            "evaluator": self.best.judgement.evaluator,
            "status": self.status,
            "recommended": "start" if self.best is self.start else "optimum",
            "verdict": self.verdict,
            "population": {name: None if one is None else one.judgement.as_dict() for name, one in named.items()},
            "single_reason": self.why_no_single or None,
            "pressing": {name: None if one is None else _pressing(one) for name, one in named.items()},
            "designs": {name: None if one is None else scene_to_dict(one.scene) for name, one in named.items()},
            "materials": list(self.best.materials),
            "limits": [{"name": one.name, "value": one.value, "active": one.active} for one in self.limits],
            "search": {"how": self.how, "exhaustive": self.exhaustive, "combinations": self.best_of},
            "tolerances": [one.as_dict() for one in self.robust],
            "seconds": self.seconds,
            "warnings": list(self.warnings),
            "files": files,
        }


def hardly_detected(judgement: Judgement) -> str | None:
    """Return a warning if no more tumours are detected than false alarms would give, else None."""
    sure = judgement.detection - SURE * judgement.detection_error
    if sure > judgement.false_alarm:
        return None
    told = f"{100 * judgement.detection:.3g} ± {100 * judgement.detection_error:.2g} of 100 tumours"
    alarms = f"{100 * judgement.false_alarm:g} of 100"
    return (
        f"the recommended design detects {told}, no more than false alarms alone may, {alarms}; "
        "the report's 'What would help most' says what to change"
    )


def _pressing(one: JudgedDesign) -> dict[str, Any]:
    pressed = one.pressed
    return {
        "force": pressed.force, "indentation": pressed.indentation, "tissue_strain": pressed.tissue_strain,
        "charge": list(pressed.charge), "limited_by": pressed.by,
    }  # fmt: skip


def _told(value: float, error: float) -> str:
    return f"{value:.3f} ± {error:.2g}"


def _renamed(limit: Limit) -> Limit:
    """Return a limit under the name of its key in the design file; bounds of variables keep theirs, such as ``least gap``."""
    names = {"largest outer_radius": "outer_radius", "least wall": "wall", "largest height": "height"}
    return Limit(names.get(limit.name, limit.name), limit.value, limit.active)


def _value(given: Any, name: str, force: float) -> float:
    """Return the value of a limit in the design file; for a limit without a number, the force that it allows, N."""
    stated = getattr(given, name, None)
    if stated is None or isinstance(stated, bool):
        return force
    return float(stated[1] if name == "charge" else stated)
