"""Verify designs by an evaluator more accurate than the search's closed form, each design under its own load."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Self

from geometry.common.json_types import JsonObject
from geometry.scenes.scene import Scene
from probe_design.design_search.loads import PressedDesign
from probe_design.populations.performance import Performance
from probe_design.populations.tables import Objective

GAIN_SIGNIFICANCE = 2.0  # times the combined error: a gain beyond it counts


class VerifiedDesign(ABC):
    """A design with the results of a more accurate evaluator."""

    @property
    @abstractmethod
    def loaded_scene(self) -> Scene:
        """The scene under the load that it is verified with."""

    @property
    @abstractmethod
    def evaluator(self) -> str:
        """Name of the evaluator."""

    @property
    @abstractmethod
    def objective(self) -> tuple[float, float]:
        """The quantity that the search improves, and its error."""

    @property
    @abstractmethod
    def force(self) -> tuple[float, str]:
        """The force, N, and what limits it."""

    @abstractmethod
    def compute_gain(self, reference: Self) -> tuple[float, float]:
        """Return the gain over another design, and its error."""

    def is_better_than(self, reference: Self) -> bool:
        """Return whether this is better than another design by more than twice the error of the gain."""
        gain, error = self.compute_gain(reference)
        return gain > GAIN_SIGNIFICANCE * error and gain > 0


@dataclass(frozen=True)
class PopulationVerification(VerifiedDesign):
    """A design verified on tumours that the search did not use.

    Attributes
    ----------
    scene
        The whole scene, with the force as its load.
    pressed
        The force with its limits.
    performance
        Performance on tumours not used in the search.
    aim
        The quantity that the design file maximises.
    materials
        Materials of the inner and the outer block, empty if none were requested.
    """

    scene: Scene
    pressed: PressedDesign
    performance: Performance
    aim: Objective
    materials: tuple[str, ...] = ()

    @property
    def loaded_scene(self) -> Scene:
        """See ``VerifiedDesign``."""
        return self.scene

    @property
    def evaluator(self) -> str:
        """See ``VerifiedDesign``."""
        return self.performance.evaluator

    @property
    def objective(self) -> tuple[float, float]:
        """The quantity that the design file maximises, and its error."""
        kind = self.aim.maximise
        return self.performance.means[kind], self.performance.errors[kind].total

    @property
    def force(self) -> tuple[float, str]:
        """See ``VerifiedDesign``."""
        return self.pressed.force, self.pressed.limited_by

    def compute_gain(self, reference: PopulationVerification) -> tuple[float, float]:
        """Return the gain in the objective over another design for the same tumours, and its error by model and sample."""
        if self.scene == reference.scene:
            return 0.0, 0.0
        return self.performance.compute_gain(reference.performance, self.aim)

    def summarize_pressing(self) -> JsonObject:
        """Return the load as a JSON object."""
        pressed = self.pressed
        return {
            "force": pressed.force, "indentation": pressed.indentation, "tissue_strain": pressed.tissue_strain,
            "charge": list(pressed.charge), "limited_by": pressed.limited_by,
        }  # fmt: skip
