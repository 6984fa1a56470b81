"""Find the cheapest model of a scene that meets an accuracy, with the features modelled and neglected and their effects.

Every estimate comes from one coarse solution of the probe on its tissue (``coarse_model.py``); what is left out is bounded, what
is modelled or beyond every evaluator is estimated.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np

from geometry.common.errors import InputError, Refusal
from geometry.common.json_types import JsonObject
from geometry.common.percent import format_percent
from geometry.scenes.scene import Scene
from solver.axisymmetric.converged_forces import NEGLIGIBLE_SHARE
from solver.axisymmetric.evaluator import Axisymmetric
from solver.axisymmetric.omitted_details import IN_PLANE_DETAILS, OUTER_TISSUE, Change
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.planning.coarse_model import CoarseModel
from solver.planning.decisions import decide_layers, decide_nonlinear_effects, warn_of_missing_skin
from solver.planning.load_check import LoadChanges, add_load_effect, build_load_notes, check_load, compute_budget
from solver.planning.load_limits import build_limits
from solver.planning.loads import LoadRule
from solver.planning.negligible_inclusions import LEFT_OUT_ACCURACY_SHARE, leave_out_negligible
from solver.results.evaluator import OutOfReach
from solver.results.load_limits import LoadedRecord, LoadLimits
from solver.results.refusals import GEOMETRY_KINDS, find_refusal, is_round
from solver.results.result import Curve, Decision, Effect, Result
from solver.results.warnings import Note, explain_null_sensitivity

AXISYMMETRIC, HARMONICS, SOLID, CONTACT = "axisymmetric", "equivalent-inclusion", "solid", "contact"
MESHED_FEATURES = "inclusion", "groove", "sides"  # features whose effects have a relative error on meshes of tetrahedra
MESH_SHARE = 0.015  # that relative error of ``solid``, at most, where it meshes half by symmetry
WHOLE_MESH_SHARE = 0.06  # likewise without symmetry: twice the tetrahedra for the same memory; 2 GB reach 0.034 to 0.045


@dataclass(frozen=True, repr=False)
class Plan(LoadedRecord):
    """The evaluator for a scene, with the features that it models and neglects.

    Attributes
    ----------
    evaluator
        Name of the evaluator with which ``auto`` begins; None where no evaluator takes the scene.
    dimension
        Dimension of the evaluator's model, in words.
    scene
        The scene for that evaluator: without negligible inclusions.
    accuracy
        The accuracy requested of that evaluator.
    allowed
        Its largest allowed error: what load and left-out inclusions leave of the scene's accuracy; at least ``accuracy``.
    left_out
        Bound on what the inclusions left out change together of ln(ratio) or of a stress or the stiffness.
    decisions
        One for each feature that could be left out.
    rule
        The rule for loads, see ``CoarseModel.build_rule``.
    load_limits
        Loads up to which linear elasticity holds, by the rule or, where loads are requested, by ``contact``.
    warnings
        Warnings, one line each.
    refusal
        Error with which ``auto`` refuses the scene; None where an evaluator is named.
    """

    INTERNAL = ("scene", "accuracy", "allowed", "left_out", "rule", "refusal")
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

    def as_dict(self) -> JsonObject:
        """Return the JSON object of ``probe-design plan``."""
        entries = super().as_dict()
        entries["plan"] = entries.pop("decisions")
        return entries | {"refusal": None if self.refusal is None else str(self.refusal)}

    def with_refusal(self, fault: InputError) -> Plan:
        """Return the plan for a scene that ``auto`` refuses with an error, ``fault``."""
        return replace(self, evaluator=None, dimension=_describe_model(self.scene, None), refusal=fault)

    def is_sure(self) -> bool:
        """Return whether the chosen evaluator surely meets the allowed error: known of ``solid`` alone, as it is slow to try."""
        if self.evaluator != SOLID:
            return False
        from solver.solid.evaluator import BEST_ACCURACY

        changed = (
            max(decision.effect, decision.effect_on_stresses or 0.0)
            for decision in self.decisions
            if decision.feature.startswith(MESHED_FEATURES)
        )
        # its error: a part that no scene escapes, and a fraction of the effects of the features that it meshes
        return self.allowed >= BEST_ACCURACY + (MESH_SHARE if _is_halved(self.scene) else WHOLE_MESH_SHARE) * sum(changed)

    def compute_reached_error(self, error: float, accuracy: float) -> float:
        """Return the error of a result for the whole scene, given the evaluator's own error.

        Load and left-out inclusions add to it what the requested accuracy and ``allowed`` differ by.
        """
        return (1 + error) * (1 + accuracy) / (1 + self.allowed) - 1

    def check_load(self, scene: Scene, accuracy: float) -> None:
        """Raise ``Refusal`` where the load is above the linear limit of ``auto``."""
        if self.evaluator != CONTACT:
            check_load(scene, self.rule, accuracy, scene.target is not None)

    def complete_result(self, result: Result, scene: Scene, accuracy: float, linear: bool) -> Result:
        """Complete a result for the reduced scene to one for the whole: load and left-out inclusions add to its error.

        Raises
        ------
        Refusal
            The error is above the accuracy, unless ``linear``.
        """
        notes = tuple(
            note for note in result.warnings if note.kind != "accuracy"
        )  # about the reduced accuracy, whose total is checked below
        result = replace(result, plan=self._merge_decisions(result.plan), warnings=(*notes, *self.warnings))
        if len(self.scene.inclusion) < len(scene.inclusion):
            result = result.add_error(float(np.expm1(self.left_out)))
            result = result if scene.target is not None else _remove_sensitivity(result)
        if self.evaluator == CONTACT:
            result = replace(result, load_limits=self.load_limits)
        else:
            result = add_load_effect(result, scene, self.rule, accuracy, scene.target is not None)
        errors = (result.error_estimate, result.charge_ratio_error if result.observable == "charge" else None)
        error = max((error for error in errors if error is not None), default=None)
        if not linear and error is not None and error > accuracy * (1 + 1e-9):
            raise OutOfReach(
                str(self.evaluator), self.scene, self.accuracy, (1 + error) * (1 + self.allowed) / (1 + accuracy) - 1
            )
        return result

    def complete_curve(self, curve: Curve, scene: Scene, accuracy: float, linear: bool) -> Curve:
        """Complete an evaluator's curve of the reduced scene to one of the whole; see ``complete_result``."""
        completed = curve.add_errors([float(np.expm1(self.left_out))] * len(curve.youngs_modulus))
        completed = replace(completed, plan=self._merge_decisions(curve.plan), load_limits=self.load_limits)
        if self.evaluator == CONTACT:
            return completed
        changes = LoadChanges.from_stiffness(scene, self.rule, np.array(curve.stiffness))
        if not linear:
            check_load(scene, changes.weakest, accuracy, True)
        completed = completed.add_errors(changes.ratio.tolist())
        notes = build_load_notes(scene, changes.weakest, accuracy, True)
        return replace(completed, warnings=(*curve.warnings, *notes))

    def _merge_decisions(self, decisions: tuple[Decision, ...]) -> tuple[Decision, ...]:
        """Replace planned decisions by the evaluator's own on the same features."""
        replaced_features = {decision.feature for decision in decisions}
        return (*(decision for decision in self.decisions if decision.feature not in replaced_features), *decisions)


def build_plan(
    scene: Scene,
    accuracy: float,
    evaluator: str | None = None,
    skin: bool = False,
    linear: bool = False,
    *,
    coarse: CoarseModel | None = None,
) -> Plan:
    """Plan how to solve a scene; see ``solver.evaluation.plan``.

    Parameters
    ----------
    scene
        See ``solver.evaluation.plan``.
    accuracy
        Likewise.
    evaluator
        The evaluator to plan for; None for the cheapest that may do.
    skin
        Whether to warn about the effect of a skin on soft tissue without layers.
    linear
        Whether to use linear elasticity at any load.
    coarse
        The scene's coarse model, where it is known: scenes without their tumours and loads may share it.

    Raises
    ------
    InputError
        A surface file that cannot be used.
    Refusal
        So extreme that not even the coarsest mesh can be solved in double precision.
    """
    coarse = CoarseModel.from_scene(scene) if coarse is None else coarse
    reduced = leave_out_negligible(scene, coarse, accuracy)
    rule, promise = coarse.build_rule(scene), scene.target is not None

    def reserve_for_inclusions(available: float) -> float:
        """Return the part of an accuracy that remains for the evaluator where inclusions may be left out."""
        several = len(scene.inclusion) > 1
        return float((1 + available) * np.exp(-LEFT_OUT_ACCURACY_SHARE * accuracy) - 1) if several else available

    requested_accuracy = reserve_for_inclusions(compute_budget(rule, rule.compute_force(scene), accuracy, promise))
    limits = build_limits(rule, accuracy, promise)
    if evaluator is None:
        evaluator = _choose_evaluator(reduced.scene, coarse, requested_accuracy)
        is_beyond_limit = evaluator is not None and rule.compute_force(scene) > limits.auto.force
        if (
            not linear
            and (is_beyond_limit or find_refusal(scene, ("contact",)) is not None)
            and _is_taken_by_contact(reduced.scene)
        ):
            evaluator = CONTACT
    if evaluator == CONTACT:
        requested_accuracy = reserve_for_inclusions(accuracy)
    max_error = accuracy if evaluator == CONTACT else compute_budget(rule, rule.compute_force(scene), accuracy, promise=False)
    decisions = (
        _decide_dimension(reduced.scene, coarse, evaluator, accuracy),
        *reduced.decisions,
        *_decide_edges(coarse, accuracy),
        *decide_layers(coarse, accuracy),
        *(_decide_detail(change, evaluator, accuracy) for change in coarse.changes),
        *decide_nonlinear_effects(scene, coarse, accuracy, evaluator == CONTACT),
    )
    warnings = tuple(warn_of_missing_skin(scene, coarse)) if skin else ()
    return Plan(
        evaluator,
        _describe_model(reduced.scene, evaluator),
        reduced.scene,
        requested_accuracy,
        max(requested_accuracy, float((1 + max_error) * np.exp(-reduced.left_out) - 1)),
        reduced.left_out,
        decisions,
        rule=rule,
        load_limits=limits,
        warnings=warnings,
    )


def find_next_evaluator(
    planned: Plan, tried: Collection[str], fault: Refusal, scene: Scene, *, accuracy: float, linear: bool
) -> str | None:
    """Return the next evaluator that may solve the scene after those tried have refused; None where there is no other.

    Parameters
    ----------
    planned
        The plan for the last evaluator tried.
    tried
        Names of the evaluators tried.
    fault
        The refusal of the last.
    scene
        The whole scene, with the inclusions that the plan leaves out.
    accuracy
        Requested for the whole scene.
    linear
        Whether to use linear elasticity at any load.
    """
    reduced_scene = planned.scene
    if fault.key.startswith("load."):
        takes = {CONTACT: not linear and _is_taken_by_contact(reduced_scene)}
    elif planned.evaluator in (SOLID, CONTACT):
        takes = {}
    else:
        from solver.solid.evaluator import BEST_ACCURACY, SolidEvaluator

        takes = {
            AXISYMMETRIC: Axisymmetric().refusal(reduced_scene) is None,
            HARMONICS: EquivalentInclusion().refusal(reduced_scene) is None,
            SOLID: SolidEvaluator().may_help(scene, max(accuracy, BEST_ACCURACY)),
        }
    return next((evaluator for evaluator, may in takes.items() if may and evaluator not in tried), None)


def _choose_evaluator(scene: Scene, coarse: CoarseModel, accuracy: float) -> str | None:
    """Return the cheapest evaluator that takes a scene and leaves out no more than the accuracy allows."""
    if find_refusal(scene, ("contact",)) is not None:
        return None
    if find_refusal(scene, GEOMETRY_KINDS) is not None:
        return SOLID
    # details that are not axisymmetric, which only a three-dimensional mesh models
    flat = sum(change.effect for change in coarse.changes if change.feature not in (*IN_PLANE_DETAILS, OUTER_TISSUE))
    if flat > accuracy:
        from solver.solid.evaluator import SolidEvaluator

        if SolidEvaluator().may_help(scene, accuracy):
            return SOLID
    if Axisymmetric().refusal(scene) is None:
        return AXISYMMETRIC
    return HARMONICS if EquivalentInclusion().refusal(scene) is None else SOLID


def _is_taken_by_contact(scene: Scene) -> bool:
    """Return whether ``contact`` takes a scene."""
    from solver.contact.evaluator import ContactEvaluator

    return ContactEvaluator().refusal(scene) is None


def _is_halved(scene: Scene) -> bool:
    """Return whether ``solid`` meshes only half of a scene, by symmetry."""
    from solver.solid.domain import choose_domain, compute_reach

    return choose_domain(scene, compute_reach(scene), scene.probe.tube_radius).half


def _describe_model(scene: Scene, evaluator: str | None) -> str:
    """Describe the model of an evaluator in words."""
    if evaluator == SOLID:
        return "three dimensions" + (", half by symmetry" if _is_halved(scene) else "")
    return {
        AXISYMMETRIC: "the meridian plane",
        CONTACT: "the meridian plane, pressed at finite strain"
        + ("" if is_round(scene) else ", tumours by first-order effects under load"),
        HARMONICS: "the meridian plane, tumours by harmonics about the axis",
    }.get(evaluator or "", "none: no evaluator")


def _decide_dimension(scene: Scene, coarse: CoarseModel, evaluator: str | None, accuracy: float) -> Decision:
    """Decide on the third dimension: features other than tumours that are not axisymmetric, such as flat sides."""
    flat = [
        change.build_decision(accuracy) for change in coarse.changes if change.feature not in (*IN_PLANE_DETAILS, OUTER_TISSUE)
    ]
    effect = Effect(
        sum((decision.effect for decision in flat), 0.0),
        sum((decision.effect_on_stresses or 0.0 for decision in flat), 0.0),
        sum((decision.effect_on_stiffness or 0.0 for decision in flat), 0.0),
    )
    reason = (
        find_refusal(scene, GEOMETRY_KINDS)
        or ", ".join(decision.feature for decision in flat)
        or "the scene is axisymmetric except for tumours"
    )
    return Decision.from_effect(
        "third dimension", evaluator == SOLID, effect, accuracy, f"{_describe_model(scene, evaluator)}: {reason}"
    )


def _decide_edges(coarse: CoarseModel, accuracy: float) -> Iterator[Decision]:
    """Yield the decision on the tissue's sides and bottom, against an unbounded tissue."""
    effect = coarse.edge_effect
    if effect is not None:
        yield Decision.from_effect(
            "far edges", True, effect, accuracy, f"modelled: they change the ratio by about {format_percent(effect.ratio)}"
        )


def _decide_detail(change: Change, evaluator: str | None, accuracy: float) -> Decision:
    """Decide on a detail: groove, sides that are not round, films or base.

    Details in the meridian plane are modelled where they are not negligible; the others by ``solid`` alone.
    """
    in_plane = change.feature in IN_PLANE_DETAILS
    modelled = change.effect > NEGLIGIBLE_SHARE * accuracy if in_plane else evaluator == SOLID and change.feature != OUTER_TISSUE
    modelled = modelled or change.modelled  # films whose stress gives the charge are modelled however small their effect is
    return replace(change, modelled=modelled).build_decision(accuracy)


def _remove_sensitivity(result: Result) -> Result:
    """Remove the log-sensitivity of a result for a reduced scene, whose only inclusion counts as target, unlike in the whole."""
    notes = tuple(note for note in result.warnings if note.kind != "sensitivity")
    no_sensitivity: JsonObject = dict.fromkeys(("log_sensitivity", "charge_log_sensitivity", "charge_log_sensitivity_error"))
    return replace(result, **no_sensitivity, warnings=(explain_null_sensitivity(2), *notes))
