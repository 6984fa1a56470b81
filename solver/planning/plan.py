"""The cheapest model of a scene that meets an accuracy: what is modelled, what is left out, and the effect of each.

Every estimate comes from one coarse solution of the probe on its tissue (``coarse_model.py``); what is left out is bounded, what
is modelled or beyond every evaluator is estimated.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from geometry.common.errors import InputError, Refusal
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
from solver.results.evaluator import OutOfReach
from solver.results.kinds import needs_solid, unsupported
from solver.results.load_limits import LargestLoad, LoadLimits, limits_dict
from solver.results.notebook import Notebook
from solver.results.result import Curve, Decision, Effect, Result
from solver.results.warnings import Note, null_sensitivity
from solver.solid.domain import domain, reach
from solver.solid.level import BEST, SolidLevel

AXISYMMETRIC, HARMONICS, SOLID, CONTACT = "axisymmetric", "equivalent-inclusion", "solid", "contact"
MESHED = "inclusion", "groove", "sides"  # features whose effects have a relative error on meshes of tetrahedra
MESH_SHARE = 0.015  # that relative error of ``solid``, at most, where it meshes half by symmetry
WHOLE_MESH_SHARE = 0.06  # likewise without symmetry: twice the tetrahedra for the same memory; 2 GB reach 0.034 to 0.045


@dataclass(frozen=True)
class Plan(Notebook):
    """The evaluator for a scene, with what it models and leaves out.

    Attributes:
        evaluator: with which ``auto`` begins; None where no evaluator takes the scene.
        dimension: of the model, in words.
        scene: the scene for that evaluator: without negligible inclusions.
        accuracy: requested of that evaluator.
        allowed: its largest allowed error: what load and left-out inclusions leave of the accuracy; at least ``accuracy``.
        left_out: bound on what the inclusions left out change together of ln(ratio) or of a stress or the stiffness.
        decisions: one for each feature that could be left out.
        rule: for loads, see ``CoarseModel.build_rule``.
        load_limits: up to which load linear elasticity holds, by the rule or, where loads are asked for, by ``contact``.
        warnings: one line each.
        refusal: why ``auto`` refuses the scene; None where an evaluator is named.
    """

    evaluator: str | None
    dimension: str
    scene: Scene
    accuracy: float
    allowed: float
    left_out: float
    decisions: tuple[Decision, ...]
    rule: LoadRule
    load_limits: LoadLimits
    warnings: tuple[Note, ...] = ()
    refusal: InputError | None = None

    @property
    def linear_limit_load(self) -> LargestLoad | None:
        """The largest load at which linear elasticity meets the requested accuracy."""
        return self.load_limits.linear

    @property
    def gap_closure_load(self) -> LargestLoad | None:
        """The largest load at which the gap stays open; None if it does at any load."""
        return self.load_limits.gap_closure

    @property
    def curve_evaluator(self) -> str | None:
        """The evaluator for a curve: those cheaper than ``solid`` compute curves of spheres only."""
        return SOLID if any(body.diameter is None for body in self.scene.inclusion) else self.evaluator

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design plan``."""
        return {
            "evaluator": self.evaluator,
            "dimension": self.dimension,
            "plan": [asdict(one) for one in self.decisions],
            **limits_dict(self.load_limits),
            "warnings": list(self.warnings),
            "refusal": None if self.refusal is None else str(self.refusal),
        }

    def refused(self, fault: InputError) -> Plan:
        """Return the plan of a scene that ``auto`` refuses."""
        return replace(self, evaluator=None, dimension=_model(self.scene, None), refusal=fault)

    def sure(self) -> bool:
        """Return whether the evaluator is ``solid``, which takes tens of seconds, and surely meets the allowed error."""
        if self.evaluator != SOLID:
            return False
        changed = (max(one.effect, one.effect_on_stresses or 0.0) for one in self.decisions if one.feature.startswith(MESHED))
        return self.allowed >= BEST + (MESH_SHARE if _half(self.scene) else WHOLE_MESH_SHARE) * sum(changed)

    def reached(self, error: float, accuracy: float) -> float:
        """Return the error of a result for the whole scene, given the evaluator's own error."""
        return (1 + error) * (1 + accuracy) / (1 + self.allowed) - 1

    def check_load(self, scene: Scene, accuracy: float) -> None:
        """Raise ``Refusal`` where the load is above the linear limit of ``auto``."""
        if self.evaluator != CONTACT:
            check_load(scene, self.rule, accuracy, scene.target is not None)

    def completed(self, result: Result, scene: Scene, accuracy: float, linear: bool) -> Result:
        """Complete a result for the reduced scene to one for the whole: load and left-out inclusions add to its error.

        Raises:
            Refusal: the error is above the accuracy, unless ``linear``.
        """
        notes = tuple(note for note in result.warnings if note.kind != "accuracy")  # of a share of what was asked, which is met
        result = replace(result, plan=self._with(result.plan), warnings=(*notes, *self.warnings))
        if len(self.scene.inclusion) < len(scene.inclusion):
            result = replace(result, error_estimate=with_error(result.error_estimate, float(np.expm1(self.left_out))))
            result = result if scene.target is not None else _untargeted(result)
        if self.evaluator == CONTACT:
            result = replace(result, load_limits=self.load_limits)
        else:
            result = with_load(result, scene, self.rule, accuracy, scene.target is not None)
        error = result.error_estimate
        if not linear and error is not None and error > accuracy * (1 + 1e-9):
            raise OutOfReach(
                str(self.evaluator), self.scene, self.accuracy, (1 + error) * (1 + self.allowed) / (1 + accuracy) - 1
            )
        return result

    def completed_curve(self, curve: Curve, scene: Scene, accuracy: float, linear: bool) -> Curve:
        """Complete an evaluator's curve of the reduced scene to one of the whole; see ``complete_result``."""
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
        """Replace planned decisions by the evaluator's own on the same features."""
        own = {one.feature for one in decisions}
        return (*(one for one in self.decisions if one.feature not in own), *decisions)


def plan(
    scene: Scene,
    accuracy: float,
    level: str | None = None,
    skin: bool = False,
    linear: bool = False,
    *,
    rough: CoarseModel | None = None,
) -> Plan:
    """Plan how to solve a scene; see ``solver.answers.plan``.

    Args:
        scene: as there.
        accuracy: as there.
        evaluator: the evaluator to plan for; None for the cheapest that may do.
        skin: whether to warn about the effect of a skin on soft tissue without layers.
        linear: whether to use linear elasticity at any load.
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
    limits = limits_of(rule, accuracy, promise)
    if level is None:
        level = _level(fewer.scene, rough, asked)
        beyond = level == AXISYMMETRIC and rule.force(scene) > limits.auto.force
        if not linear and (beyond or unsupported(scene) is not None) and ContactLevel().refusal(fewer.scene) is None:
            level = CONTACT
    if level == CONTACT:
        asked = accuracy if len(scene.inclusion) < 2 else float((1 + accuracy) * np.exp(-SHARE * accuracy) - 1)
    whole = accuracy if level == CONTACT else budget(rule, rule.force(scene), accuracy, promise=False)
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
        max(asked, float((1 + whole) * np.exp(-fewer.left_out) - 1)),
        fewer.left_out,
        decisions,
        rule=rule,
        load_limits=limits,
        warnings=warnings,
    )


def following(
    planned: Plan, tried: Collection[str], fault: Refusal, scene: Scene, *, accuracy: float, linear: bool
) -> str | None:
    """Return the next evaluator that may solve the scene where those tried refuse, else None.

    Args:
        planned: for the last of them.
        tried: their names.
        fault: the last one's refusal.
        scene: whole.
        accuracy: of the whole.
        linear: whether to use linear elasticity at any load.
    """
    fewer = planned.scene
    if fault.key.startswith("load."):
        takes = {CONTACT: not linear and ContactLevel().refusal(fewer) is None}
    elif planned.evaluator in (SOLID, CONTACT):
        takes = {}
    else:
        takes = {
            AXISYMMETRIC: Axisymmetric().refusal(fewer) is None,
            HARMONICS: EquivalentInclusion().refusal(fewer) is None,
            SOLID: SolidLevel().may_help(scene, max(accuracy, BEST)),
        }
    return next((level for level, may in takes.items() if may and level not in tried), None)


def _level(scene: Scene, rough: CoarseModel, accuracy: float) -> str | None:
    """Return the cheapest evaluator that takes a scene and leaves out no more than the accuracy allows."""
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


def _half(scene: Scene) -> bool:
    """Whether ``solid`` meshes half of a scene."""
    return domain(scene, reach(scene), scene.probe.tube_radius).half


def _model(scene: Scene, level: str | None) -> str:
    if level == SOLID:
        return "three dimensions" + (", half by symmetry" if _half(scene) else "")
    return {
        AXISYMMETRIC: "the meridian plane",
        CONTACT: "the meridian plane, pressed at finite strain",
        HARMONICS: "the meridian plane, tumours by harmonics about the axis",
    }.get(level or "", "none: no evaluator")


def _dimension(scene: Scene, rough: CoarseModel, level: str | None, accuracy: float) -> Decision:
    """Decide on the third dimension: features other than tumours that are not axisymmetric."""
    flat = [change.decision(accuracy) for change in rough.changes if change.feature not in (*IN_PLANE, BEYOND)]
    effect = Effect(
        sum((one.effect for one in flat), 0.0),
        sum((one.effect_on_stresses or 0.0 for one in flat), 0.0),
        sum((one.effect_on_stiffness or 0.0 for one in flat), 0.0),
    )
    why = needs_solid(scene) or ", ".join(one.feature for one in flat) or "the scene is axisymmetric except for tumours"
    return Decision.of("third dimension", level == SOLID, effect, accuracy, f"{_model(scene, level)}: {why}")


def _edges(rough: CoarseModel, accuracy: float) -> Iterator[Decision]:
    """Yield the decision on the tissue's sides and floor, against an unbounded tissue."""
    effect = rough.edges
    if effect is not None:
        yield Decision.of("far edges", True, effect, accuracy, f"modelled: they change the ratio by about {effect.ratio:.2g}")


def _detail(change: Change, level: str | None, accuracy: float) -> Decision:
    """Decide on a detail: groove, sides that are not round, films or base."""
    in_plane = change.feature in IN_PLANE
    modelled = change.effect > NEGLIGIBLE * accuracy if in_plane else level == SOLID and change.feature != BEYOND
    return replace(change, modelled=modelled).decision(accuracy)


def _untargeted(result: Result) -> Result:
    """Remove the log-sensitivity of a result whose whole scene has no target."""
    others = tuple(note for note in result.warnings if note.kind != "sensitivity")
    return replace(result, log_sensitivity=None, warnings=(null_sensitivity(2), *others))
