"""Results of a scene under rising loads."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from geometry.provenance.block import Provenance
from solver.results.load_limits import LargestLoad, LoadLimits, build_limits_dict
from solver.results.notebook import Notebook
from solver.results.warnings import Note

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class LoadRange:
    """Forces between which the ratio stays within ``share`` of a value between its extremes, N."""

    share: float
    low: float
    high: float


@dataclass(frozen=True)
class LoadCurve(Notebook):
    """A scene under rising loads; tuples of one length.

    Attributes:
        evaluator, seconds: what computed the curve, and how long it took.
        force: N.
        indentation: m.
        ratio: of the film stresses.
        log_sensitivity: d ln(ratio) / d ln(E_object) at that force; None without a target.
        stiffness: force over indentation, N/m.
        tangent_stiffness: derivative of force by indentation, N/m.
        stress_inner, stress_outer: Pa.
        closest_walls: smallest distance between the gap's walls, m.
        contact_radius: outer radius of the contact between probe and tissue, m.
        largest_strain: |stretch - 1| of the line element that changes most.
        error_estimate: bound on the relative error of each ratio.
        load_limits: up to which load linear elasticity holds within ``accuracy`` and the gap stays open, by ``contact``.
        constant_ratio: the widest range of forces in which the ratio stays within ``accuracy``; None with a single point.
        accuracy: the accuracy that was requested, relative.
        stopped: why the curve ends before the requested load; None where it does not.
        warnings: one line each.
        provenance: see ``geometry.provenance.block``.
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

    @property
    def linear_limit_load(self) -> LargestLoad | None:
        """Load up to which linear elasticity holds; None where no limit is known."""
        return None if self.load_limits is None else self.load_limits.linear

    @property
    def gap_closure_load(self) -> LargestLoad | None:
        """Load at which the gap's walls touch; None where no such load is known."""
        return None if self.load_limits is None else self.load_limits.gap_closure

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design load``."""
        return asdict(self) | build_limits_dict(self.load_limits)

    def plot(self) -> Figure:
        """Draw ratio, log-sensitivity and the gap's walls against force; returns the figure, whose ``savefig`` writes it."""
        from solver.results.figures import draw_load_curve

        return draw_load_curve(self)
