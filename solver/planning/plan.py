"""The cheapest model of a scene that meets an accuracy: what is modelled, what is left out, and what that may change.

Every estimate comes from one coarse solution of the probe on its tissue (``coarse_model.py``); what is left out is bounded, what
is modelled or beyond every evaluator is estimated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from geometry.common.errors import Refusal
from geometry.common.limits import least
from geometry.scenes.scene import Scene
from solver.axisymmetric.converged_forces import NEGLIGIBLE
from solver.axisymmetric.level import Axisymmetric
from solver.axisymmetric.omitted_details import BEYOND, IN_PLANE, Change
from solver.contact.level import ContactLevel
from solver.equivalent_inclusion.level import EquivalentInclusion
from solver.planning.coarse_model import CoarseModel
from solver.planning.layers import forgotten_skin, layer_decisions
from solver.planning.load_check import LoadChanges, budget, check_load, load_notes, with_error, with_load
from solver.planning.load_limits import limits_of
from solver.planning.loads import LoadRule
from solver.planning.negligible_inclusions import SHARE, reduced
from solver.planning.nonlinear_effects import unmodelled
from solver.results.kinds import needs_solid, unsupported
from solver.results.load_limits import LargestLoad, LoadLimits, limits_dict
from solver.results.notebook import Notebook
from solver.results.result import Curve, Decision, Effect, Result
from solver.results.warnings import Note, null_sensitivity
from solver.solid.domain import domain, reach
from solver.solid.level import BEST, SolidLevel

AXISYMMETRIC, HARMONICS, SOLID, CONTACT = "axisymmetric", "equivalent-inclusion", "solid", "contact"


@dataclass(frozen=True)
class Plan(Notebook):
    """How a scene is best answered.

    Attributes:
        evaluator: the level that ``auto`` begins with; None where none built yet takes the scene.
        dimension: of the model, in words.
        scene: what that level is given: without inclusions that do not matter.
        accuracy: what that level is asked for.
        left_out: bound on what the inclusions left out change together of ln(ratio) or of a stress or the stiffness.
        decisions: one for each feature that could be left out.
        rule: for loads, see ``CoarseModel.rule``.
        load_limits: up to which load linear elasticity holds, by the rule or, where loads are asked for, by ``contact``.
        warnings: one line each.
    """

    evaluator: str | None
    dimension: str
    scene: Scene
    accuracy: float
    left_out: float
    decisions: tuple[Decision, ...]
    rule: LoadRule
    load_limits: LoadLimits
    warnings: tuple[Note, ...] = ()

    @property
    def linear_limit_load(self) -> LargestLoad | None:
        """Up to which linear elasticity holds at the accuracy that was asked for."""
        return self.load_limits.linear

    @property
    def gap_closure_load(self) -> LargestLoad | None:
        """Up to which the gap stays open; None at any load."""
        return self.load_limits.gap_closure

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
            **limits_dict(self.load_limits),
            "warnings": list(self.warnings),
        }

    def check_reach(self, accuracy: float) -> None:
        """Raise ``Refusal`` where the load takes so much of the accuracy that ``solid`` does not reach the rest."""
        if self.evaluator == SOLID and self.accuracy < BEST <= accuracy:
            enough = least(BEST * accuracy / self.accuracy, 2)
            raise Refusal(
                "accuracy", accuracy, f"{enough} or more at this load, or a smaller load: it leaves {self.accuracy:.2g} to solid"
            )

    def check_load(self, scene: Scene, accuracy: float) -> None:
        """Raise ``Refusal`` where the load is beyond what ``auto`` answers linearly."""
        if self.evaluator != CONTACT:
            check_load(scene, self.rule, accuracy, scene.target is not None)

    def completed(self, result: Result, scene: Scene, accuracy: float, linear: bool) -> Result:
        """Return a level's answer to the reduced scene as one to the whole, what load and left-out bodies change in its error.

        Raises:
            Refusal: the error is above the accuracy, unless ``linear``.
        """
        result = replace(result, plan=self._with(result.plan), warnings=(*result.warnings, *self.warnings))
        if len(self.scene.inclusion) < len(scene.inclusion):
            result = replace(result, error_estimate=with_error(result.error_estimate, float(np.expm1(self.left_out))))
            result = result if scene.target is not None else _untargeted(result)
        if self.evaluator == CONTACT:
            result = replace(result, load_limits=self.load_limits)
        else:
            result = with_load(result, scene, self.rule, accuracy, scene.target is not None)
        if not linear and result.error_estimate is not None and result.error_estimate > accuracy * (1 + 1e-9):
            reached = f"{result.error_estimate:.2g} or more at this load; a smaller load allows less"
            raise Refusal("accuracy", accuracy, reached)
        return result

    def completed_curve(self, curve: Curve, scene: Scene, accuracy: float, linear: bool) -> Curve:
        """Return a level's curve of the reduced scene as one of the whole; see ``completed``."""
        left = float(np.expm1(self.left_out))
        if self.evaluator == CONTACT:
            errors = tuple(with_error(one, left) for one in curve.error_estimate)
            return replace(curve, error_estimate=errors, plan=self._with(curve.plan), load_limits=self.load_limits)
        changes = LoadChanges.of(scene, self.rule, np.array(curve.stiffness))
        if not linear:
            check_load(scene, changes.weakest, accuracy, True)
        pairs = zip(curve.error_estimate, changes.ratio.tolist(), strict=True)
        errors = tuple(with_error(with_error(one, left), load) for one, load in pairs)
        notes = load_notes(scene, changes.weakest, accuracy, True)
        told = replace(curve, error_estimate=errors, plan=self._with(curve.plan), load_limits=self.load_limits)
        return replace(told, warnings=(*curve.warnings, *notes))

    def _with(self, decisions: tuple[Decision, ...]) -> tuple[Decision, ...]:
        """The level's own decisions in the place of what was planned of the same features."""
        own = {one.feature for one in decisions}
        return (*(one for one in self.decisions if one.feature not in own), *decisions)


def plan(
    scene: Scene,
    accuracy: float,
    solid: bool = False,
    skin: bool = False,
    linear: bool = False,
    *,
    rough: CoarseModel | None = None,
) -> Plan:
    """Plan how to answer a scene; see ``solver.answers.plan``.

    Args:
        scene: as there.
        accuracy: as there.
        solid: as there.
        skin: whether to say what a skin would change of soft tissue without layers.
        linear: whether to answer linearly at any load.
        rough: the scene's coarse model, where it is known: scenes without their tumours and loads may share it.

    Raises:
        InputError: a surface file that cannot be used.
        Refusal: so extreme that not even the coarsest mesh can be solved in double precision.
    """
    rough = CoarseModel.of(scene) if rough is None else rough
    fewer = reduced(scene, rough, accuracy)
    rule, promise = rough.rule(scene), scene.target is not None
    rest = budget(rule, rule.force(scene), accuracy, promise)
    asked = rest if len(scene.inclusion) < 2 else float((1 + rest) * np.exp(-SHARE * accuracy) - 1)
    level = SOLID if solid else _level(fewer.scene, rough, asked)
    limits = limits_of(rule, accuracy, promise)
    beyond = level == AXISYMMETRIC and rule.force(scene) > limits.auto.force
    if not linear and (beyond or unsupported(scene) is not None) and ContactLevel().refusal(fewer.scene) is None:
        level, asked = CONTACT, accuracy if len(scene.inclusion) < 2 else float((1 + accuracy) * np.exp(-SHARE * accuracy) - 1)
    decisions = (
        _dimension(fewer.scene, rough, level, accuracy),
        *fewer.decisions,
        *_edges(rough, accuracy),
        *layer_decisions(rough, accuracy),
        *(_detail(change, level, accuracy) for change in rough.changes),
        *unmodelled(scene, rough, accuracy, level == CONTACT),
    )
    warnings = tuple(forgotten_skin(scene, rough)) if skin else ()
    return Plan(
        level,
        _model(fewer.scene, level),
        fewer.scene,
        asked,
        fewer.left_out,
        decisions,
        rule=rule,
        load_limits=limits,
        warnings=warnings,
    )


def second_try(planned: Plan, scene: Scene, accuracy: float) -> Plan | None:
    """Return the plan for ``solid`` where that may reach what the level planned did not, else None.

    Raises:
        InputError, Refusal: see ``plan``.
    """
    if planned.evaluator in (SOLID, CONTACT) or not SolidLevel().may_help(scene, accuracy):
        return None
    return plan(scene, accuracy, solid=True)


def _level(scene: Scene, rough: CoarseModel, accuracy: float) -> str | None:
    """The cheapest level that takes a scene and leaves out of it no more than the accuracy allows."""
    if unsupported(scene) is not None:
        return None
    if needs_solid(scene) is not None:
        return SOLID
    flat = sum(change.effect for change in rough.changes if change.feature not in (*IN_PLANE, BEYOND))
    if flat > accuracy and SolidLevel().may_help(scene, accuracy):
        return SOLID
    if Axisymmetric().refusal(scene) is None:
        return AXISYMMETRIC
    return HARMONICS if EquivalentInclusion().refusal(scene) is None else SOLID


def _model(scene: Scene, level: str | None) -> str:
    if level == SOLID:
        half = domain(scene, reach(scene), scene.probe.tube_radius).half
        return "three dimensions" + (", half by symmetry" if half else "")
    return {
        AXISYMMETRIC: "the meridian plane",
        CONTACT: "the meridian plane, pressed at finite strain",
        HARMONICS: "the meridian plane, tumours by harmonics about the axis",
    }.get(level or "", "none: no evaluator")


def _dimension(scene: Scene, rough: CoarseModel, level: str | None, accuracy: float) -> Decision:
    """What the third dimension holds beyond tumours, which harmonics carry."""
    flat = [change.decision(accuracy) for change in rough.changes if change.feature not in (*IN_PLANE, BEYOND)]
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
    in_plane = change.feature in IN_PLANE
    modelled = change.effect > NEGLIGIBLE * accuracy if in_plane else level == SOLID and change.feature != BEYOND
    return replace(change, modelled=modelled).decision(accuracy)


def _untargeted(result: Result) -> Result:
    """Without a target there is no log_sensitivity, however many inclusions are left."""
    others = tuple(note for note in result.warnings if note.kind != "sensitivity")
    return replace(result, log_sensitivity=None, warnings=(null_sensitivity(2), *others))
