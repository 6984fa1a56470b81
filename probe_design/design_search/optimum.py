"""Define the result of an optimisation: start, verified designs, and the recommended one with the reason."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Generic, Literal, TypeVar

from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from geometry.scenes.scene_file import scene_to_dict
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
        """All limits by their keys in a design file, bounds such as ``least gap``, and which are active."""
        return tuple(
            Limit(LIMIT_KEYS.get(limit.name, limit.name), limit.value, limit.active)
            for limit in self.search_space.space.list_limits(self.best.loaded_scene)
        )

    @property
    @abstractmethod
    def verdict(self) -> str:
        """The result in one sentence, with the reason why a gain counts or does not."""

    @property
    @abstractmethod
    def warnings(self) -> tuple[str, ...]:
        """Warnings to the user, one line each."""

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

    def warn_wide_start(self) -> Iterator[str]:
        """Yield a warning if the start is wider than the limit."""
        start, limit = self.design.scene.probe.tube_radius, self.search_space.space.outer_radius
        if start > limit * (1 + SAME_DESIGN_TOLERANCE_RELATIVE):
            yield f"the start's outer radius of {start * 1e3:.4g} mm is above the limit of {limit * 1e3:.4g} mm"

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
            "search": {"how": self.search.how, "exhaustive": self.search.exhaustive, "combinations": self.search.best},
            "seconds": self.seconds,
            "files": files,
        }
