"""Hold the loads up to which linear elasticity holds, one for each output, with the method by which each was determined."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from typing import Literal

from geometry.common.errors import Words
from geometry.common.json_types import JsonObject
from geometry.common.limits import format_maximum
from geometry.common.percent import format_percent
from geometry.scenes.probe import format_mm
from geometry.scenes.scene import Scene
from solver.results.record import Record

Basis = Literal["bound", "formulas", "contact"]

GAP_OPEN = "the gap stays open"
BASIS_TEXTS: dict[Basis, str] = {"bound": "bound", "formulas": "bound by formulas", "contact": "computed by contact"}


@dataclass(frozen=True)
class LargestLoad:
    """The largest load for which one statement about the scene is true.

    Attributes
    ----------
    force
        Force, N.
    indentation
        Indentation at that force, m.
    by
        What limits the load: "ratio" or "log_sensitivity", which finite strain changes by more than the accuracy above it;
        "strain limit" or "gap closure", above which nothing is known.
    question
        The statement, in words.
    known
        The method by which the load was determined: "bound", by a conservative rule that is never above the true limit;
        "formulas", by that rule without a mesh; or "contact", computed with finite strain and contact.
    """

    force: float
    indentation: float
    by: str
    question: str = ""
    known: Basis = "bound"

    @property
    def basis_text(self) -> str:
        """The method by which the load was determined, in words."""
        return BASIS_TEXTS[self.known]

    def __str__(self) -> str:
        """Return the load, rounded down so that it is itself allowed, with its cause and the method that determined it."""
        return (
            f"{format_maximum(self.force, 3)} N, an indentation of {format_maximum(1e3 * self.indentation, 3)} mm "
            f"(limited by {self.by}, {self.basis_text})"
        )


def describe_ratio_limit(accuracy: float) -> str:
    """Return the statement that limits the load by ratio, stresses and stiffness."""
    return f"ratio, stresses and stiffness within {format_percent(accuracy, 4)} of linear elasticity"


def describe_sensitivity_limit(accuracy: float) -> str:
    """Return the statement that limits the load by the log-sensitivity; its tolerance is five times the accuracy."""
    return f"log_sensitivity within {format_percent(5 * accuracy, 4)} of linear elasticity"


def describe_auto_limit(accuracy: float) -> str:
    """Return the statement that limits the load up to which ``auto`` uses linear elasticity."""
    return f"auto uses linear elasticity within {format_percent(accuracy, 4)}, its own error included"


@dataclass(frozen=True)
class LoadLimits:
    """The largest loads for one scene at one accuracy; all outputs take them from here.

    Attributes
    ----------
    ratio
        Finite strain changes ratio, stresses and stiffness by at most the accuracy; None where ``contact`` finds no limit.
    log_sensitivity
        Finite strain changes the log-sensitivity by at most five accuracies; None where ``contact`` finds no limit, and without a
        target.
    gap_closure
        The gap's walls do not touch; None where ``contact`` finds that they do not at any load.
    auto
        ``auto`` uses linear elasticity: the effect of the load plus the evaluator's own error is within the accuracy.
    """

    ratio: LargestLoad | None
    log_sensitivity: LargestLoad | None
    gap_closure: LargestLoad | None
    auto: LargestLoad

    @property
    def linear(self) -> LargestLoad | None:
        """The smallest of ``ratio``, ``log_sensitivity`` and ``gap_closure``: linear elasticity holds up to it."""
        limits = [limit for limit in (self.ratio, self.log_sensitivity, self.gap_closure) if limit is not None]
        return min(limits, key=lambda limit: limit.force, default=None)

    @property
    def available_limits(self) -> tuple[LargestLoad, ...]:
        """All limits that are not None."""
        return tuple(limit for limit in (getattr(self, field.name) for field in fields(self)) if limit is not None)

    @property
    def sentences(self) -> Iterator[str]:
        """Each limit in a sentence."""
        return (f"{limit.question}: up to {limit}" for limit in self.available_limits)


class LoadedRecord(Record):
    """Base of results at a load, which have the limits of the load as ``load_limits``."""

    load_limits: LoadLimits | None

    @property
    def linear_limit_load(self) -> LargestLoad | None:
        """Load up to which linear elasticity holds at the requested accuracy; None where that is not known."""
        return None if self.load_limits is None else self.load_limits.linear

    @property
    def gap_closure_load(self) -> LargestLoad | None:
        """Load up to which the gap stays open; None where that is not known, or where it stays open at any load."""
        return None if self.load_limits is None else self.load_limits.gap_closure

    def as_dict(self) -> JsonObject:
        """Return the JSON object of the command: all fields, and at its top the two limits used most."""
        limits = {"linear_limit_load": self.linear_limit_load, "gap_closure_load": self.gap_closure_load}
        return super().as_dict() | {name: None if limit is None else asdict(limit) for name, limit in limits.items()}


def describe_load(scene: Scene) -> tuple[str, Words]:
    """Return the key of a scene's load and its value, for messages."""
    if scene.load.indentation is not None:
        return "load.indentation", format_mm(scene.load.indentation)
    if scene.load.preload:
        return "load.preload", Words(f"{scene.load.preload:g} N")
    return "load.force", Words(f"{scene.load.force:g} N")
