"""What every evaluator takes and returns."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Protocol

from geometry.common.errors import Refusal
from geometry.scenes.scene import Scene

LARGEST = 1e9  # effects are cut there: all the same, and JSON knows no infinity


@dataclass(frozen=True)
class Effect:
    """Relative changes of ratio, stresses (the larger of both) and stiffness, >= 0."""

    ratio: float
    stresses: float
    stiffness: float

    @property
    def largest(self) -> float:
        """Of the three."""
        return max(self.ratio, self.stresses, self.stiffness)


@dataclass(frozen=True)
class Decision:
    """One line of the plan: a feature of the scene, whether it is modelled and why.

    Attributes:
        effect: estimated relative change of the ratio by the feature; a bound where it is left out.
        tolerance: the relative change that the accuracy asked for allows.
        effect_on_stresses: on the stress that changes more, at the same indentation; None where it is not told apart.
        effect_on_stiffness: likewise.
    """

    feature: str
    modelled: bool
    effect: float
    tolerance: float
    reason: str
    effect_on_stresses: float | None = None
    effect_on_stiffness: float | None = None

    @classmethod
    def of(cls, feature: str, modelled: bool, effect: Effect, tolerance: float, reason: str) -> Decision:
        """Return the line for an effect; infinite effects are cut at LARGEST."""
        ratio, stresses, stiffness = (min(one, LARGEST) for one in (effect.ratio, effect.stresses, effect.stiffness))
        return cls(feature, modelled, ratio, tolerance, reason, stresses, stiffness)


@dataclass(frozen=True)
class Result:
    """What an evaluator says of a scene, at the scene's load; ``None`` where a warning gives the reason.

    Attributes:
        stress_inner, stress_outer: force on each film over the block's nominal end area, Pa, compression positive.
        ratio: ``stress_inner / stress_outer``; at zero load its limit.
        log_sensitivity: d ln(ratio) / d ln(E_object) of the target inclusion.
        stiffness: force on the base per indentation, N/m.
        charge_inner, charge_outer: film charges by the paper's eq. (12), C.
        error_estimate: bound on the relative error of ``ratio``.
        evaluator: the level that answered.
        seconds: what the answer cost.
        equivalent_modulus: Pa; of ``published`` alone.
        residual: relative, the largest of the solutions that answer; None where none is solved for.
        plan: what was modelled and what was left out.
        warnings: one line each.
    """

    evaluator: str
    seconds: float
    stress_inner: float | None = None
    stress_outer: float | None = None
    ratio: float | None = None
    log_sensitivity: float | None = None
    stiffness: float | None = None
    charge_inner: float | None = None
    charge_outer: float | None = None
    error_estimate: float | None = None
    equivalent_modulus: float | None = None
    residual: float | None = None
    plan: tuple[Decision, ...] = ()
    warnings: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design evaluate``."""
        return asdict(self)


def unsupported(scene: Scene) -> str | None:
    """Say which kind of thing in the scene no level knows yet, or None."""
    if scene.contact.interface == "unilateral":
        return "none built yet for contact.interface = 'unilateral' (planned: contact)"
    return None


def needs_solid(scene: Scene) -> str | None:
    """Say which kind of thing in the scene no level, or only ``solid``, knows; or None."""
    if unsupported(scene) is not None:
        return unsupported(scene)
    if scene.placement.tilt != 0:
        return "solid for placement.tilt other than 0"
    if any(body.surface is not None for body in scene.inclusion):
        return "solid for an inclusion that is neither sphere nor ellipsoid"
    return None


def within(result: Result, reached: float, accuracy: float) -> Result:
    """Return a result whose largest error bound is ``reached``, or refuse it.

    Raises:
        Refusal: it is above ``accuracy``.
    """
    if reached > accuracy:
        why = f"{reached:.2g} or more for this scene (--evaluator {result.evaluator} answers with that error)"
        if reached >= 1:
            why = f"none for this scene: errors are no smaller than the values (--evaluator {result.evaluator} tells which)"
        raise Refusal("accuracy", accuracy, why)
    return result


@dataclass(frozen=True)
class Curve:
    """What an evaluator says of a scene for many Young's moduli of its target inclusion; arrays of one length.

    Attributes:
        youngs_modulus: of the target, Pa.
        ratio, log_sensitivity: see ``Result``; None where ``stress_outer`` is below its own error.
        error_estimate: bound on the relative error of each ratio.
        evaluator, seconds, plan, warnings: see ``Result``.
    """

    evaluator: str
    seconds: float
    youngs_modulus: tuple[float, ...]
    ratio: tuple[float | None, ...]
    log_sensitivity: tuple[float | None, ...]
    error_estimate: tuple[float | None, ...]
    plan: tuple[Decision, ...] = ()
    warnings: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design curve``."""
        return asdict(self)


class Evaluator(Protocol):
    """One level of fidelity.

    Attributes:
        name: as on the command line.
        summary: one line for ``--help``: what it models, its usual error and cost.
    """

    @property
    def name(self) -> str: ...  # noqa: D102

    @property
    def summary(self) -> str: ...  # noqa: D102

    def refusal(self, scene: Scene) -> str | None:
        """Say which evaluator can take what in the scene is of a *kind* that this level cannot, or None if it can."""
        ...

    def evaluate(self, scene: Scene, accuracy: float) -> Result:
        """Answer to within ``accuracy`` (relative, on ratio, stresses and stiffness), or as well as possible with a warning.

        Raises:
            Refusal: the scene is of a kind that this level cannot take.
        """
        ...
