"""Verification of designs: each under its own force, all on the same tumours, which the search did not use."""

from __future__ import annotations

from dataclasses import dataclass

from geometry.scenes.scene import Scene
from probe_design.design_search.choices import Progress
from probe_design.design_search.loads import PressedDesign, PressingRule
from probe_design.populations.design_file import Design
from probe_design.populations.judge import verify
from probe_design.populations.judgement import Judgement


@dataclass(frozen=True)
class VerifiedDesign:
    """A design with its force and its verification on tumours that the search did not use.

    Attributes:
        scene: the whole scene, its load the force.
        pressed: what sets that.
        judgement: on unseen tumours.
        combination: what was chosen for it from steps and shelf, in words.
        materials: of the inner and the outer block, empty where none were asked for.
    """

    scene: Scene
    pressed: PressedDesign
    judgement: Judgement
    combination: str = ""
    materials: tuple[str, ...] = ()

    def get_objective(self, design: Design) -> tuple[float, float]:
        """Return the quantity that the design file maximises, and its error."""
        kind = design.objective.maximise
        return getattr(self.judgement, kind), getattr(self.judgement, f"{kind}_error")

    def compute_gain(self, reference: VerifiedDesign, design: Design) -> tuple[float, float]:
        """Return the gain in the objective over another design for the same tumours, and the error of the gain."""
        if self.scene == reference.scene:
            return 0.0, 0.0
        return self.judgement.compute_gain(reference.judgement, design.objective)


def verify_design(
    design: Design,
    rule: PressingRule,
    scene: Scene,
    *,
    progress: Progress,
    combination: str = "",
    materials: tuple[str, ...] = (),
) -> VerifiedDesign:
    """Verify a scene's probe under its allowed force, on tumours that the search did not use.

    Raises:
        InputError: the population does not fit the tissue, or the probe would leave it.
        Refusal: the evaluators cannot take the scene.
    """
    loaded, pressed = rule.apply_force(scene)
    verification = verify(loaded, design, progress=progress)
    return VerifiedDesign(loaded, pressed, verification, combination, materials)
