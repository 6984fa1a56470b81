"""The cheapest model of a scene that meets an accuracy: what is modelled, what is left out, and what that may change.

Every estimate comes from one coarse solution of the probe on its tissue (``coarse_model.py``); what is left out is bounded, what
is modelled or beyond every evaluator is estimated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from geometry.scenes.scene import Scene
from solver.axisymmetric.converged_forces import NEGLIGIBLE
from solver.axisymmetric.level import Axisymmetric
from solver.axisymmetric.omitted_details import BEYOND, LAYERS, Change
from solver.planning.coarse_model import CoarseModel
from solver.planning.negligible_inclusions import SHARE, reduced
from solver.planning.nonlinear_effects import unmodelled
from solver.results.film_forces import LINEAR_STRAIN
from solver.results.kinds import needs_solid, unsupported
from solver.results.result import Curve, Decision, Effect, Result
from solver.results.warnings import Note, null_sensitivity
from solver.solid.domain import domain, reach
from solver.solid.level import SolidLevel

AXISYMMETRIC, HARMONICS, SOLID = "axisymmetric", "equivalent-inclusion", "solid"


@dataclass(frozen=True)
class Plan:
    """How a scene is best answered.

    Attributes:
        evaluator: the level that ``auto`` begins with; None where none built yet takes the scene.
        dimension: of the model, in words.
        scene: what that level is given: without inclusions that do not matter.
        accuracy: what that level is asked for.
        left_out: bound on what the inclusions left out change together of ln(ratio) or of a stress or the stiffness.
        decisions: one for each feature that could be left out.
        warnings: one line each.
    """

    evaluator: str | None
    dimension: str
    scene: Scene
    accuracy: float
    left_out: float
    decisions: tuple[Decision, ...]
    warnings: tuple[Note, ...]

    @property
    def curve_evaluator(self) -> str | None:
        """The level that answers a curve: those cheaper than ``solid`` know curves of spheres only."""
        return SOLID if any(body.diameter is None for body in self.scene.inclusion) else self.evaluator

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design plan``."""
        return {
            "evaluator": self.evaluator,
            "dimension": self.dimension,
            "plan": [asdict(one) for one in self.decisions],
            "warnings": list(self.warnings),
        }

    def completed(self, result: Result, scene: Scene) -> Result:
        """Return a level's answer to the reduced scene as one to the whole, what was left out counted in its error."""
        result = replace(result, plan=self._with(result.plan), warnings=(*result.warnings, *self.warnings))
        if len(self.scene.inclusion) == len(scene.inclusion):
            return result
        if result.error_estimate is not None:
            result = replace(result, error_estimate=float(np.expm1(np.log1p(result.error_estimate) + self.left_out)))
        return result if scene.target is not None else _untargeted(result)

    def completed_curve(self, curve: Curve) -> Curve:
        """Return a level's curve of the reduced scene as one of the whole."""
        errors = tuple(
            None if error is None else float(np.expm1(np.log1p(error) + self.left_out)) for error in curve.error_estimate
        )
        return replace(curve, error_estimate=errors, plan=self._with(curve.plan))

    def _with(self, decisions: tuple[Decision, ...]) -> tuple[Decision, ...]:
        """The level's own decisions in the place of what was planned of the same features."""
        own = {one.feature for one in decisions}
        return (*(one for one in self.decisions if one.feature not in own), *decisions)


def plan(scene: Scene, accuracy: float, solid: bool = False) -> Plan:
    """Plan how to answer a scene; see ``solver.levels.plan``.

    Raises:
        InputError: a surface file that cannot be used.
        Refusal: so extreme that not even the coarsest mesh can be solved in double precision.
    """
    rough = CoarseModel.of(scene)
    fewer = reduced(scene, rough, accuracy)
    asked = accuracy if len(scene.inclusion) < 2 else (1 - SHARE) * accuracy
    level = SOLID if solid else _level(fewer.scene, rough, asked)
    beyond = tuple(unmodelled(scene, rough, accuracy))
    decisions = (
        _dimension(fewer.scene, rough, level, accuracy),
        *fewer.decisions,
        *_edges(rough, accuracy),
        *(_detail(change, level, accuracy) for change in rough.changes),
        *beyond,
    )
    worth = (one for one in beyond if accuracy < one.effect and _worth_a_warning(one))
    notes = tuple(Note("linear", f"{one.feature}: {one.reason}") for one in worth)
    return Plan(level, _model(fewer.scene, level), fewer.scene, asked, fewer.left_out, decisions, notes)


def second_try(planned: Plan, scene: Scene, accuracy: float) -> Plan | None:
    """Return the plan for ``solid`` where that may reach what the level planned did not, else None.

    Raises:
        InputError, Refusal: see ``plan``.
    """
    if planned.evaluator == SOLID or not SolidLevel().may_help(scene, accuracy):
        return None
    return plan(scene, accuracy, solid=True)


def _level(scene: Scene, rough: CoarseModel, accuracy: float) -> str | None:
    """The cheapest level that takes a scene and leaves out of it no more than the accuracy allows."""
    if unsupported(scene) is not None:
        return None
    if needs_solid(scene) is not None:
        return SOLID
    flat = sum(change.effect for change in rough.changes if change.feature not in (*LAYERS, BEYOND))
    if flat > accuracy and SolidLevel().may_help(scene, accuracy):
        return SOLID
    return AXISYMMETRIC if Axisymmetric().refusal(scene) is None else HARMONICS


def _model(scene: Scene, level: str | None) -> str:
    if level == SOLID:
        half = domain(scene, reach(scene), scene.probe.tube_radius).half
        return "three dimensions" + (", half by symmetry" if half else "")
    return {AXISYMMETRIC: "the meridian plane", HARMONICS: "the meridian plane, tumours by harmonics about the axis"}.get(
        level or "", "none: no evaluator"
    )


def _dimension(scene: Scene, rough: CoarseModel, level: str | None, accuracy: float) -> Decision:
    """What the third dimension holds beyond tumours, which harmonics carry."""
    flat = [change.decision(accuracy) for change in rough.changes if change.feature not in (*LAYERS, BEYOND)]
    effect = Effect(
        sum((one.effect for one in flat), 0.0),
        sum((one.effect_on_stresses or 0.0 for one in flat), 0.0),
        sum((one.effect_on_stiffness or 0.0 for one in flat), 0.0),
    )
    why = (
        needs_solid(scene)
        or ", ".join(one.feature for one in flat)
        or "the scene is round about the probe's axis but for tumours"
    )
    return Decision.of("third dimension", level == SOLID, effect, accuracy, f"{_model(scene, level)}: {why}")


def _edges(rough: CoarseModel, accuracy: float) -> Iterator[Decision]:
    """What the tissue's sides and floor change against tissue without an end."""
    effect = rough.edges
    if effect is not None:
        yield Decision.of("far edges", True, effect, accuracy, f"modelled: they change the ratio by about {effect.ratio:.2g}")


def _detail(change: Change, level: str | None, accuracy: float) -> Decision:
    """Groove, sides that are not round, films and base."""
    layer = change.feature in LAYERS
    modelled = change.effect > NEGLIGIBLE * accuracy if layer else level == SOLID and change.feature != BEYOND
    return replace(change, modelled=modelled).decision(accuracy)


def _worth_a_warning(decision: Decision) -> bool:
    """Whether no other line says so: the scene ties a contact that pulls, and every level tells of larger strains."""
    return decision.feature == "gap contact" or (decision.feature == "finite strain" and decision.effect <= LINEAR_STRAIN)


def _untargeted(result: Result) -> Result:
    """Without a target there is no log_sensitivity, however many inclusions are left."""
    others = tuple(note for note in result.warnings if note.kind != "sensitivity")
    return replace(result, log_sensitivity=None, warnings=(null_sensitivity(2), *others))
