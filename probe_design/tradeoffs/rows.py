"""Errors and times of one setting on one scene, and what follows from many: true errors, Pareto front, cheapest setting."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from geometry.common.percent import format_percent
from geometry.scenes.scene_tables import Observable
from solver.results.result import ErrorKind

Error = Literal["stated_error", "true_error_most"]
MIN_LOG_SENSITIVITY = 1e-5  # smaller values are compared with this: no evaluator states a smaller error, see README


@dataclass(frozen=True)
class Setting:
    """An evaluator and its requested accuracy.

    Attributes
    ----------
    accuracy
        Relative; None for an evaluator that ignores it.
    """

    evaluator: str
    accuracy: float | None

    def __str__(self) -> str:
        """Name the setting, such as "axisymmetric at 1 %"."""
        return self.evaluator if self.accuracy is None else f"{self.evaluator} at {format_percent(self.accuracy, 6)}"


@dataclass(frozen=True)
class Row:
    """Result, time and errors of one setting on one scene; None where there is no result, see ``reason``.

    Attributes
    ----------
    scene
        Name of the scene.
    evaluator, accuracy
        See ``Setting``.
    ratio, log_sensitivity
        Those of the property ``reading`` of ``solver.Result``: what the scene reads.
    stated_error
        Relative error of the ratio, as stated by the result.
    error_kind
        See ``solver.Result``; a row of ``closed-form``, whose error is no bound, is not chosen for its stated error.
    seconds_first
        Wall clock of the first evaluation of the scene; includes what a process computes only once.
    seconds_probe
        Median for a new probe and mesh, with nothing cached; that of the first evaluation if there is no other.
    seconds_tumour
        Median for another tumour under the same probe; None without a tumour.
    reason
        Reason why there is no result.
    reference
        Whether this is the result with which the others of the scene are compared.
    same_level
        Whether the reference is of the same evaluator: the comparison then shows its convergence, but no error that all its
        settings share.
    true_error
        Relative difference of the ratio from the reference's.
    true_error_least, true_error_most
        Limits of the true error, as the reference has a stated error itself.
    log_sensitivity_error
        Difference of the log-sensitivity from the reference's, relative to the larger of that and ``MIN_LOG_SENSITIVITY``. The
        error of the reference's log-sensitivity is not stated, and so not counted.
    observable
        What the ratio is of, by the scene: "charge" or "stress".
    charge_per_force_inner, charge_per_force_outer
        See ``solver.Result``; None where there are no charges.
    """

    scene: str
    evaluator: str
    accuracy: float | None
    ratio: float | None = None
    log_sensitivity: float | None = None
    stated_error: float | None = None
    error_kind: ErrorKind = "bound"
    seconds_first: float | None = None
    seconds_probe: float | None = None
    seconds_tumour: float | None = None
    reason: str | None = None
    reference: bool = False
    same_level: bool = False
    true_error: float | None = None
    true_error_least: float | None = None
    true_error_most: float | None = None
    log_sensitivity_error: float | None = None
    observable: Observable = "stress"
    charge_per_force_inner: float | None = None
    charge_per_force_outer: float | None = None

    @property
    def setting(self) -> Setting:
        """The evaluator and its requested accuracy."""
        return Setting(self.evaluator, self.accuracy)

    @property
    def is_error_covered(self) -> bool:
        """Whether the stated error may cover the true one: it is at least ``true_error_least``, or one of both is unknown."""
        return self.true_error_least is None or self.stated_error is None or self.true_error_least <= self.stated_error

    @property
    def is_resolved(self) -> bool:
        """Whether the true error is larger than the error of the reference."""
        return self.true_error is not None and bool(self.true_error_least)


def compare_with_reference(rows: Sequence[Row], converging: Iterable[str]) -> tuple[Row, ...]:
    """Return the rows of one scene with true errors: differences from a reference.

    The reference is the row of a ``converging`` evaluator with the smallest stated error; without one the rows are unchanged.

    With d the relative difference from the reference, e the reference's stated error and e' its unknown true one,

        result / truth = (1 + d) (1 + e'), |e'| <= e,   |d| - e |1 + d| <= true error <= |d| + e |1 + d|   (TR.1)
    """
    candidates = [row for row in rows if row.evaluator in set(converging) and row.stated_error is not None]
    if not candidates:
        return tuple(rows)
    reference = min(candidates, key=lambda row: row.stated_error or 0.0)
    return tuple(_compare_row(row, reference) for row in rows)


def _compare_row(row: Row, reference: Row) -> Row:
    """Return a row with its true error, eq. TR.1."""
    reference_error = reference.stated_error or 0.0
    if row is reference:
        return replace(row, reference=True, same_level=True, true_error_least=0.0, true_error_most=reference_error)
    if row.ratio is None or reference.ratio is None:
        return row
    difference = row.ratio / reference.ratio - 1
    error, slack = abs(difference), reference_error * abs(1 + difference)
    sensitivity_error = None
    if row.log_sensitivity is not None and reference.log_sensitivity is not None:
        size = max(abs(reference.log_sensitivity), MIN_LOG_SENSITIVITY)
        sensitivity_error = abs(row.log_sensitivity - reference.log_sensitivity) / size
    return replace(
        row, same_level=row.evaluator == reference.evaluator, true_error=error, true_error_least=max(0.0, error - slack),
        true_error_most=error + slack, log_sensitivity_error=sensitivity_error,
    )  # fmt: skip


def remove_duplicates(rows: Iterable[Row]) -> tuple[Row, ...]:
    """Return the rows with a result, without those with the same ratio as an earlier, coarser setting of their evaluator.

    Times of such rows differ only by chance.
    """
    first: dict[tuple[str, str, float | None], Row] = {}  # first row of each scene, evaluator and ratio
    for row in rows:
        if row.ratio is not None:
            first.setdefault((row.scene, row.evaluator, row.ratio), row)
    return tuple(first.values())


def find_pareto_front(rows: Iterable[Row], error: Error = "stated_error") -> tuple[Row, ...]:
    """Return the Pareto front of time and error, fastest first: rows with a smaller error than all faster ones.

    The time is ``seconds_probe``; ``error`` names the attribute of the error. Stated errors count only if they are bounds.
    """
    costs = [
        (row.seconds_probe, getattr(row, error), row) for row in rows if error != "stated_error" or row.error_kind == "bound"
    ]
    front: list[Row] = []
    min_error = math.inf
    for seconds, value, row in sorted(costs, key=lambda cost: (cost[0] or 0.0, cost[1] or 0.0)):
        if seconds is not None and value is not None and value < min_error:
            front.append(row)
            min_error = value
    return tuple(front)


def find_cheapest(rows: Iterable[Row], tolerance: float, error: Error = "stated_error") -> Row | None:
    """Return the fastest row whose error is at most ``tolerance``, or None."""
    return next((row for row in find_pareto_front(rows, error) if getattr(row, error) <= tolerance), None)
