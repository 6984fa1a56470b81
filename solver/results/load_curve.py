"""Hold the results of a scene under rising loads."""

from __future__ import annotations

from dataclasses import dataclass, field

from geometry.provenance.block import Provenance
from solver.results.load_limits import LoadedRecord, LoadLimits
from solver.results.warnings import Note


@dataclass(frozen=True)
class LoadRange:
    """Forces between which the ratio stays within ``share`` of a value between its extremes, N."""

    share: float
    low: float
    high: float


@dataclass(frozen=True)
class LoadCurve(LoadedRecord):
    """A scene under rising loads; tuples of one length.

    Attributes
    ----------
    evaluator, seconds
        The evaluator that computed the curve, and its time.
    force
        N.
    indentation
        m.
    ratio
        Of the film stresses.
    log_sensitivity
        d ln(ratio) / d ln(E_object) at that force; None without a target.
    stiffness
        Force over indentation, N/m.
    tangent_stiffness
        Derivative of force by indentation, N/m.
    stress_inner, stress_outer
        Pa.
    closest_walls
        Minimum distance between the gap's walls, m.
    contact_radius
        Outer radius of the contact between probe and tissue, m.
    largest_strain
        |stretch - 1| of the line element that changes most.
    error_estimate
        Bound on the relative error of each ratio.
    load_limits
        Up to which load linear elasticity holds within ``accuracy`` and the gap stays open, by ``contact``.
    constant_ratio
        The widest range of forces in which the ratio stays within ``accuracy``; None with a single point.
    accuracy
        The accuracy that was requested, relative.
    stopped
        Why the curve ends before the requested load; None where it does not.
    warnings
        One line each.
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
    load_limits: LoadLimits | None = None
    warnings: tuple[Note, ...] = ()
    provenance: Provenance | None = field(default=None, compare=False, repr=False)
