"""The result of an optimisation: start and verified designs, which of them is recommended, and why."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, TypeVar

from geometry.scenes.scene import Scene
from probe_design.design_search.choices import ChoiceSearch
from probe_design.design_search.search_space import SearchSpace
from probe_design.design_search.tumour_verification import replace_non_finite
from probe_design.design_search.variables import SAME_DESIGN_TOLERANCE_RELATIVE, Limit
from probe_design.design_search.verification import VerifiedDesign
from probe_design.populations.design_file import Design

NO_GAIN = "no gain: no design better than the start was verified: the start is exported"
LIMIT_KEYS = {"largest outer_radius": "outer_radius", "least wall": "wall", "largest height": "height"}
Verified = TypeVar("Verified", bound=VerifiedDesign)


@dataclass(frozen=True)
class Optimum(ABC, Generic[Verified]):
    """What was found.

    Attributes:
        design: the question.
        search_space: the designs that were to choose from.
        start: the scene's probe, verified.
        finalists: verified designs, best first.
        search: by formulas.
        seconds: of search and verification.
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
        """``improved``, or ``no-gain`` where no design is better than the start beyond the errors of both."""
        return "no-gain" if self.winner is None else "improved"

    @property
    def best(self) -> Verified:
        """The recommended design, of which everything speaks that is written: the start where no gain is verified."""
        return self.winner or self.start

    @property
    def best_tried(self) -> Verified:
        """The best design tried, whether it is verified to be better than the start or not; the start where there is none."""
        return self.winner or next(iter(self.finalists), self.start)

    @property
    def scene(self) -> Scene:
        """The scene of the design to build, under its load."""
        return self.best.loaded_scene

    @property
    def gain(self) -> tuple[float, float]:
        """By how much the best design tried is better than the start, and one standard error of that."""
        return self.best_tried.compute_gain(self.start)

    @property
    def limits(self) -> tuple[Limit, ...]:
        """All limits by their keys in a design file, bounds such as ``least gap``, and which the recommended design lies on."""
        return tuple(
            Limit(LIMIT_KEYS.get(limit.name, limit.name), limit.value, limit.active)
            for limit in self.search_space.space.list_limits(self.best.loaded_scene)
        )

    @property
    @abstractmethod
    def verdict(self) -> str:
        """What was found, and why it counts or does not, in one sentence."""

    @property
    @abstractmethod
    def warnings(self) -> tuple[str, ...]:
        """Warnings to the user, one line each."""

    @property
    def title(self) -> str:
        """Whether there is a gain, and which design is recommended."""
        return f"optimize: {'improved' if self.winner is not None else 'no gain, the start is exported'}"

    @property
    def others(self) -> dict[str, Verified]:
        """Designs to compare with, by their headings."""
        return {}

    def list_columns(self) -> dict[str, Verified]:
        """Return the verified designs by their headings, the recommended one, of which everything else speaks, last."""
        if self.winner is not None:
            return {"start": self.start, **self.others, "recommended": self.best}
        tried = {"best tried, no gain": self.best_tried} if self.finalists else {}
        return {**tried, **self.others, "start, recommended": self.best}

    def warn_wide_start(self) -> Iterator[str]:
        """Yield a warning if the start is wider than the limit."""
        start, limit = self.design.scene.probe.tube_radius, self.search_space.space.outer_radius
        if start > limit * (1 + SAME_DESIGN_TOLERANCE_RELATIVE):
            yield f"the start's outer radius of {start * 1e3:.4g} mm is above the limit of {limit * 1e3:.4g} mm"

    def build_summary(self, files: list[str]) -> dict[str, Any]:
        """Return the JSON object of ``probe-design optimize``; a number is null where nothing is known of it."""
        from geometry.scenes.scene_file import scene_to_dict

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
            "search": {"how": self.search.how, "exhaustive": self.search.exhaustive, "combinations": self.search.best},
            "seconds": self.seconds,
            "files": files,
        }
