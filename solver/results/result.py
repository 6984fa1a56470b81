"""The results that evaluators return."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, Literal, TypeVar

from geometry.common.json_types import JsonObject
from geometry.provenance.block import Provenance
from geometry.scenes.scene_tables import Observable
from solver.results.load_limits import LoadedRecord, LoadLimits
from solver.results.record import ERROR_FIELDS
from solver.results.warnings import Note

ErrorKind = Literal["bound", "95 %"]
"""What a stated error is: a bound, or a quantile, which the true error is below in 95 % of scenes."""
Column = tuple[float | None, ...]  # of a curve
T = TypeVar("T")
MAX_EFFECT = 1e9  # larger effects are cut to this, as JSON has no infinity


def combine_errors(error: float | None, change: float) -> float | None:
    """Return the relative error after a further relative change: (1 + error) (1 + change) - 1.

    It is None where the error is None or the change infinite, that is unknown.
    """
    return None if error is None or math.isinf(change) else math.expm1(math.log1p(error) + math.log1p(change))


@dataclass(frozen=True)
class Effect:
    """Relative changes of ratio, stresses (the larger of both) and stiffness, >= 0."""

    ratio: float
    stresses: float
    stiffness: float

    @property
    def maximum(self) -> float:
        """The largest of the three changes."""
        return max(self.ratio, self.stresses, self.stiffness)


@dataclass(frozen=True)
class Decision:
    """One line of the plan: a feature of the scene, whether it is modelled and why.

    Attributes
    ----------
    effect
        Estimated relative change of the ratio by the feature; a bound where it is left out.
    tolerance
        The relative change that the requested accuracy allows.
    effect_on_stresses
        Effect on the stress that changes more, at the same indentation; None where it is not known separately.
    effect_on_stiffness
        Effect on the stiffness; None where it is not known separately.
    """

    feature: str
    modelled: bool
    effect: float
    tolerance: float
    reason: str
    effect_on_stresses: float | None = None
    effect_on_stiffness: float | None = None

    @classmethod
    def from_effect(cls, feature: str, modelled: bool, effect: Effect, tolerance: float, reason: str) -> Decision:
        """Return the line of the plan for an effect; effects above ``MAX_EFFECT`` are cut to it."""
        ratio, stresses, stiffness = (min(change, MAX_EFFECT) for change in (effect.ratio, effect.stresses, effect.stiffness))
        return cls(feature, modelled, ratio, tolerance, reason, stresses, stiffness)


@dataclass(frozen=True)
class ReadRatio(Generic[T]):
    """The ratio that readings are, by the scene's observable: its value, its relative error and its log-sensitivity."""

    ratio: T
    error: T
    log_sensitivity: T


@dataclass(frozen=True, repr=False)
class Result(LoadedRecord):
    """The result of an evaluator for a scene at its load; values are ``None`` where a warning gives the reason.

    Attributes
    ----------
    stress_inner, stress_outer
        Force on each film over the block's nominal end area, Pa, compression positive.
    ratio
        ``stress_inner / stress_outer``; at zero load its limit.
    log_sensitivity
        d ln(ratio) / d ln(E_object) of the target inclusion.
    film_log_sensitivities
        Log-sensitivities of the forces on inner and outer film at a given indentation; ``log_sensitivity`` is their difference.
    stiffness
        Force on the base per indentation, N/m.
    charge_inner, charge_outer
        Charges of the films at the scene's load, C, with the sign of d33 where a film is pressed.
    charge_per_force_inner, charge_per_force_outer
        Charge of each film over the compressive force on its block, C/N.
    charge_ratio
        Ratio of inner to outer charge, each over the block's nominal end area.
    charge_log_sensitivity
        d ln(charge_ratio) / d ln(E_object) of the target inclusion.
    charge_log_sensitivity_error
        Estimate of its absolute error.
    observable
        What a reading of the scene is: the ratio of "charge" or of "stress".
    response
        What films answer to, in words: one press from zero to the peak, or the change about a preload; see ``Load``.
    charge_inner_error, charge_outer_error, charge_per_force_inner_error, charge_per_force_outer_error, charge_ratio_error
        Relative errors of these, like ``error_estimate``.
    error_estimate
        Relative error of ``ratio``; against linear elasticity if the evaluator was named.
    error_kind
        Kind of all errors here: bounds, or of ``closed-form`` 95 % quantiles.
    stress_inner_error, stress_outer_error, stiffness_error
        Like ``error_estimate``; inertia is not counted in them.
    evaluator
        Name of the evaluator that computed it.
    seconds
        How long it took.
    equivalent_modulus
        Pa; from ``published`` alone.
    residual
        Largest relative residual of the linear systems solved; None where none is solved.
    load_limits
        Loads up to which linear elasticity holds, by a cautious rule or, with ``loads=True``, by ``contact``; None where they are
        not known.
    frequency
        Frequency of a sinusoidal load, Hz; None where none was given.
    ratio_phase
        Phase by which ``stress_inner`` leads ``stress_outer``, rad, from the loss factors of materials and bonds; where charges
        are read, by which ``charge_inner`` leads ``charge_outer``.
    ratio_phase_error
        Bound on its absolute error, rad.
    ratio_phase_derivatives
        Derivatives of ``ratio_phase`` by the scene's numbers and loss factors, rad per SI unit.
    plan
        Features that were modelled or left out.
    warnings
        Warnings, one line each.
    provenance
        See ``geometry.provenance.block``; None where an evaluator was called directly.
    """

    evaluator: str
    seconds: float
    stress_inner: float | None = None
    stress_outer: float | None = None
    ratio: float | None = None
    log_sensitivity: float | None = None
    film_log_sensitivities: tuple[float, float] | None = None
    stiffness: float | None = None
    charge_inner: float | None = None
    charge_outer: float | None = None
    charge_per_force_inner: float | None = None
    charge_per_force_outer: float | None = None
    charge_ratio: float | None = None
    charge_log_sensitivity: float | None = None
    charge_log_sensitivity_error: float | None = None
    charge_inner_error: float | None = None
    charge_outer_error: float | None = None
    charge_per_force_inner_error: float | None = None
    charge_per_force_outer_error: float | None = None
    charge_ratio_error: float | None = None
    observable: Observable = "stress"
    response: str | None = None
    error_estimate: float | None = None
    error_kind: ErrorKind = "bound"
    stress_inner_error: float | None = None
    stress_outer_error: float | None = None
    stiffness_error: float | None = None
    equivalent_modulus: float | None = None
    residual: float | None = None
    load_limits: LoadLimits | None = None
    frequency: float | None = None
    ratio_phase: float | None = None
    ratio_phase_error: float | None = None
    ratio_phase_derivatives: dict[str, float] | None = None
    plan: tuple[Decision, ...] = ()
    warnings: tuple[Note, ...] = ()
    provenance: Provenance | None = field(default=None, compare=False, repr=False)

    @property
    def reading(self) -> ReadRatio[float | None]:
        """The ratio that readings of the scene are."""
        if self.observable == "stress":
            return ReadRatio(self.ratio, self.error_estimate, self.log_sensitivity)
        return ReadRatio(self.charge_ratio, self.charge_ratio_error, self.charge_log_sensitivity)

    def add_error(self, change: float) -> Result:
        """Return the result with all its errors increased by a further relative change; None where that is infinite."""
        errors: JsonObject = {name: combine_errors(getattr(self, name), change) for name in ERROR_FIELDS}
        return replace(self, **errors)


@dataclass(frozen=True, repr=False)
class Curve(LoadedRecord):
    """Results for many Young's moduli of the scene's target inclusion; tuples of one length.

    Attributes
    ----------
    youngs_modulus
        Young's moduli of the target, Pa.
    ratio, log_sensitivity
        See ``Result``; None where ``stress_outer`` is below its own error.
    error_estimate
        Relative error of each ratio.
    error_kind
        See ``Result``.
    stiffness
        Force on the base per indentation, N/m.
    charge_ratio, charge_ratio_error, charge_log_sensitivity, charge_log_sensitivity_error
        Each like ``ratio``, see ``Result``; None without charges.
    observable, response
        See ``Result``.
    evaluator, seconds, load_limits, plan, warnings, provenance
        See ``Result``.
    """

    DIMENSIONS = ("youngs_modulus",)
    evaluator: str
    seconds: float
    youngs_modulus: tuple[float, ...]
    ratio: tuple[float | None, ...]
    log_sensitivity: tuple[float | None, ...]
    error_estimate: tuple[float | None, ...]
    stiffness: tuple[float, ...]
    charge_ratio: Column | None = None
    charge_ratio_error: Column | None = None
    charge_log_sensitivity: Column | None = None
    charge_log_sensitivity_error: Column | None = None
    observable: Observable = "stress"
    response: str | None = None
    error_kind: ErrorKind = "bound"
    load_limits: LoadLimits | None = None
    plan: tuple[Decision, ...] = ()
    warnings: tuple[Note, ...] = ()
    provenance: Provenance | None = field(default=None, compare=False, repr=False)

    @property
    def reading(self) -> ReadRatio[Column]:
        """The ratio that readings of the scene are, at each modulus."""
        return _choose_columns(self)

    def add_errors(self, changes: Sequence[float]) -> Curve:
        """Return the curve with the errors of both ratios increased by a further relative change at each modulus."""

        def combine(column: Column) -> Column:
            """Return errors with the changes added."""
            return tuple(combine_errors(error, change) for error, change in zip(column, changes, strict=True))

        charge_errors = None if self.charge_ratio_error is None else combine(self.charge_ratio_error)
        return replace(self, error_estimate=combine(self.error_estimate), charge_ratio_error=charge_errors)


@dataclass(frozen=True)
class LoadRange:
    """Forces between which the ratio stays within ``share`` of a value between its extremes, N."""

    share: float
    low: float
    high: float


@dataclass(frozen=True, repr=False)
class LoadCurve(LoadedRecord):
    """A scene under rising loads; tuples of one length.

    Attributes
    ----------
    evaluator, seconds
        The evaluator that computed the curve, and its time.
    force
        Forces, N.
    indentation
        Indentations, m.
    ratio
        Ratio of the film stresses.
    log_sensitivity
        d ln(ratio) / d ln(E_object) at that force; None without a target.
    stiffness
        Force over indentation, N/m.
    tangent_stiffness
        Derivative of force by indentation, N/m.
    stress_inner, stress_outer
        Stresses on the films, Pa.
    closest_walls
        Minimum distance between the gap's walls, m.
    contact_radius
        Outer radius of the contact between probe and tissue, m.
    largest_strain
        |stretch - 1| of the line element that changes most.
    error_estimate
        Bound on the relative error of each ratio.
    load_limits
        Loads up to which linear elasticity holds within ``accuracy`` and the gap stays open, by ``contact``, for the ratio that
        is read.
    constant_ratio
        The widest range of forces in which the ratio stays within ``accuracy``; None with a single point.
    charge_inner, charge_outer
        Charges of the films, C; None without charges, as are the next.
    charge_inner_error, charge_outer_error
        Bounds on their relative errors at the given indentation.
    charge_ratio, charge_ratio_error, charge_log_sensitivity, charge_log_sensitivity_error
        See ``Result``, at each load.
    observable
        See ``Result``; ``constant_ratio`` is that of what is read.
    accuracy
        The accuracy that was requested, relative.
    stopped
        Reason why the curve ends before the requested load; None where it does not.
    warnings
        Warnings, one line each.
    provenance
        See ``geometry.provenance.block``.
    """

    DIMENSIONS = ("force",)
    LABELS = ("indentation",)
    evaluator: str
    seconds: float
    force: tuple[float, ...]
    indentation: tuple[float, ...]
    ratio: tuple[float, ...]
    log_sensitivity: tuple[float | None, ...]
    stiffness: tuple[float, ...]
    tangent_stiffness: tuple[float, ...]
    stress_inner: tuple[float, ...]
    stress_outer: tuple[float, ...]
    closest_walls: tuple[float, ...]
    contact_radius: tuple[float, ...]
    largest_strain: tuple[float, ...]
    error_estimate: tuple[float, ...]
    constant_ratio: LoadRange | None
    accuracy: float
    stopped: str | None
    charge_inner: tuple[float, ...] | None = None
    charge_outer: tuple[float, ...] | None = None
    charge_inner_error: tuple[float, ...] | None = None
    charge_outer_error: tuple[float, ...] | None = None
    charge_ratio: Column | None = None
    charge_ratio_error: Column | None = None
    charge_log_sensitivity: Column | None = None
    charge_log_sensitivity_error: Column | None = None
    observable: Observable = "stress"
    load_limits: LoadLimits | None = None
    warnings: tuple[Note, ...] = ()
    provenance: Provenance | None = field(default=None, compare=False, repr=False)

    @property
    def reading(self) -> ReadRatio[Column]:
        """The ratio that readings of the scene are, at each load."""
        return _choose_columns(self)


def _choose_columns(curve: Curve | LoadCurve) -> ReadRatio[Column]:
    """Return the columns of the ratio that readings are, each null where a curve has no charges."""
    if curve.observable == "stress":
        return ReadRatio(curve.ratio, curve.error_estimate, curve.log_sensitivity)
    null: Column = (None,) * len(curve.ratio)
    return ReadRatio(curve.charge_ratio or null, curve.charge_ratio_error or null, curve.charge_log_sensitivity or null)
