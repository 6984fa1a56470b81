"""Up to which load linear elasticity holds, question by question, and how each of these loads is known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal

from geometry.common.limits import most

Known = Literal["bound", "formulas", "contact"]

GAP_OPEN = "the gap stays open"
HOW: dict[Known, str] = {"bound": "bound", "formulas": "bound by formulas", "contact": "computed by contact"}


@dataclass(frozen=True)
class LargestLoad:
    """The largest load for which the answer to one question is yes.

    Attributes:
        force: N.
        indentation: m, at that force.
        by: what sets it: "ratio" or "log_sensitivity", which finite strain puts beyond the accuracy; "strain limit" or "gap
            closure", beyond which nothing is known.
        question: that it answers, in words.
        known: "bound", by a cautious rule that is never above the truth; "formulas", by that rule without a mesh; or
            "contact", computed with finite strain and contact.
    """

    force: float
    indentation: float
    by: str
    question: str = ""
    known: Known = "bound"

    @property
    def how(self) -> str:
        """How it is known, in words."""
        return HOW[self.known]

    def __str__(self) -> str:
        """Return the load, rounded down so that it is allowed itself, with what sets it and how it is known."""
        return (
            f"{most(self.force, 3)} N, an indentation of {most(1e3 * self.indentation, 3)} mm (limited by {self.by}, {self.how})"
        )


def ratio_question(accuracy: float) -> str:
    """Return the question about the ratio."""
    return f"ratio, stresses and stiffness within {accuracy:.4g} of linear elasticity"


def sensitivity_question(accuracy: float) -> str:
    """Return the question about the log-sensitivity, which is promised to five accuracies."""
    return f"log_sensitivity within {5 * accuracy:.4g} of linear elasticity"


def auto_question(accuracy: float) -> str:
    """Return the question about what ``auto`` answers linearly."""
    return f"auto answers linearly within {accuracy:.4g}, its own error included"


@dataclass(frozen=True)
class LoadLimits:
    """The loads that answer each question about one scene at one accuracy; the only place from which they are taken.

    Attributes:
        ratio: finite strain changes ratio, stresses and stiffness by at most the accuracy; None where ``contact`` finds no limit.
        log_sensitivity: it changes the log-sensitivity by at most five accuracies; None likewise, and without a target.
        gap_closure: the gap's walls do not touch; None where ``contact`` found that they do not at any load.
        auto: ``auto`` answers linearly: the load takes no more of both than the evaluator's own error leaves.
    """

    ratio: LargestLoad | None
    log_sensitivity: LargestLoad | None
    gap_closure: LargestLoad | None
    auto: LargestLoad

    @property
    def linear(self) -> LargestLoad | None:
        """The smallest of the first three: up to it linear elasticity holds."""
        known = [one for one in (self.ratio, self.log_sensitivity, self.gap_closure) if one is not None]
        return min(known, key=lambda one: one.force, default=None)

    @property
    def known(self) -> tuple[LargestLoad, ...]:
        """Those that there are."""
        return tuple(one for one in (getattr(self, field.name) for field in fields(self)) if one is not None)

    @property
    def lines(self) -> Iterator[str]:
        """Each limit in a sentence."""
        return (f"{limit.question}: up to {limit}" for limit in self.known)


def limits_dict(limits: LoadLimits | None) -> dict[str, Any]:
    """Return limits as every JSON object has them: the two that are asked for most, and all of them."""
    linear, closure = (None, None) if limits is None else (limits.linear, limits.gap_closure)
    named = {"linear_limit_load": linear, "gap_closure_load": closure, "load_limits": limits}
    return {name: None if one is None else asdict(one) for name, one in named.items()}
