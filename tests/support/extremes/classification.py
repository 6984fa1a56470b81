"""Classify a cell of the matrix of extremes: right within its own bounds, refused or null with a reason, or wrong."""

from __future__ import annotations

import json
import math
import re
import signal
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from geometry import InputError
from solver import evaluate
from tests.support.extremes.rows import Row, Truth, lightened

ACCURACY = 0.01
PATIENCE = 300  # s of processor time; longer counts as no result
MARKS = ("right", "refused", "null", "wrong")
REACHED = re.compile(r"(?:error bounds?|95 % errors) of ([0-9.e+-]+)")
STATED_SENSITIVITY = re.compile(r"log_sensitivity is known within ([0-9.]+) % of its value")
NOTHING = ("log_sensitivity is smaller than its own error", "log_sensitivity is null")
QUANTILE_MARGIN = 4  # an error stated as a 95 % quantile is wrong where the true one is so many times as large
ROUNDED, ROUGHLY = 1.05, 1.5  # what rounding to two digits, or to one, may take off a bound in words


@dataclass(frozen=True)
class Outcome:
    """What an evaluator returned for a scene.

    Attributes
    ----------
    row, evaluator
        The cell.
    values
        The JSON object of ``probe-design evaluate``, or None.
    refusal
        The line of a refusal, or None.
    fault
        A warning, another exception or a NaN; or None.
    seconds
        Of the processor.
    """

    row: str
    evaluator: str
    seconds: float
    values: dict[str, Any] | None = None
    refusal: str | None = None
    fault: str | None = None


@dataclass(frozen=True)
class Cell:
    """A classified outcome.

    Attributes
    ----------
    row, evaluator, seconds
        See ``Outcome``.
    mark
        One of ``MARKS``.
    reason
        The reason given, or what is wrong.
    true, stated
        Relative error of the ratio and the bound on it.
    doubt
        The true value's own relative uncertainty.
    """

    row: str
    evaluator: str
    seconds: float
    mark: str
    reason: str = ""
    true: float | None = None
    stated: float | None = None
    doubt: float = 0.0

    @property
    def share(self) -> float:
        """The part of the error that the true value's own uncertainty cannot explain, over the bound on it."""
        return max(0.0, (self.true or 0.0) - self.doubt) / (self.stated or 1.0)


def evaluate_row(row: Row, evaluator: str) -> Outcome:
    """Evaluate a scene, with every warning an error."""
    row = _route_evaluator(row, evaluator)
    start = time.process_time()

    def make_outcome(**outcome: Any) -> Outcome:
        return Outcome(row.key, evaluator, round(time.process_time() - start, 3), **outcome)

    try:
        with warnings.catch_warnings(), limit_time(PATIENCE):
            warnings.simplefilter("error")
            values = evaluate(row.scene, evaluator, ACCURACY).as_dict()
        json.dumps(values, allow_nan=False)  # ValueError for NaN and infinity anywhere in it
    except InputError as refused:
        return make_outcome(refusal=str(refused))
    except Exception as fault:  # whatever else leaves an evaluator
        return make_outcome(fault=f"{type(fault).__name__}: {fault}")
    return make_outcome(values=values)


def _route_evaluator(row: Row, evaluator: str) -> Row:
    """Return the row to evaluate: with a small load for ``auto`` where the true values are linear."""
    return lightened(row) if evaluator == "auto" and row.group != "loads" else row


def classify(row: Row, outcome: Outcome) -> Cell:
    """Compare an outcome with the true values."""
    row = _route_evaluator(row, outcome.evaluator)
    name = (outcome.row, outcome.evaluator, outcome.seconds)
    if outcome.values is None:
        return Cell(*name, "refused", outcome.refusal) if outcome.refusal else Cell(*name, "wrong", outcome.fault or "no result")
    values = outcome.values
    errors = (compute_relative_error(values["ratio"], row.truth.ratio), values["error_estimate"], row.truth.uncertainty)
    faults = list(find_flaws(values, row.truth))
    if faults:
        return Cell(*name, "wrong", "; ".join(faults), *errors)
    if values["ratio"] is None:
        return Cell(*name, "null", next(text for text in values["warnings"] if text.startswith("ratio")))
    return Cell(*name, "right", "", *errors)


@contextmanager
def limit_time(seconds: int) -> Iterator[None]:
    """Raise ``TimeoutError`` after some seconds of processor time."""

    def late(*_: Any) -> None:
        raise TimeoutError(f"no result in {seconds} s")

    previous = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, previous)


def find_flaws(values: dict[str, Any], truth: Truth) -> Iterator[str]:
    """Yield what is silently wrong in a result."""
    notes, ratio, stated = values["warnings"], values["ratio"], values["error_estimate"]
    if ratio is None or stated is None:
        if not any(text.startswith("ratio") and " null: " in text for text in notes):
            yield "ratio is null without a reason"
        return
    quantile = values.get("error_kind") == "95 %"
    stated = QUANTILE_MARGIN * stated if quantile else stated
    deviation = compute_relative_error(ratio, truth.ratio)
    if deviation is not None and not deviation <= stated + truth.uncertainty:
        yield f"ratio in error by {deviation:.2g}, stated {stated:.2g}"
    bound = max(ACCURACY, stated, (QUANTILE_MARGIN if quantile else 1) * find_reached_bound(notes))
    for key in ("stress_inner", "stress_outer", "stiffness"):
        deviation = compute_relative_error(values[key], getattr(truth, key))
        if deviation is not None and not deviation <= bound + truth.uncertainty:
            yield f"{key} in error by {deviation:.2g}, stated {bound:.2g}"
    yield from find_sensitivity_flaws(values["log_sensitivity"], truth, notes, QUANTILE_MARGIN if quantile else 1)


def find_reached_bound(notes: Sequence[str]) -> float:
    """Return the largest bound that a warning states."""
    if any("no smaller than the values themselves" in text for text in notes):
        return math.inf
    return max((ROUNDED * float(match[1]) for text in notes if (match := REACHED.search(text))), default=0.0)


def find_sensitivity_flaws(log_sensitivity: float | None, truth: Truth, notes: Sequence[str], margin: int) -> Iterator[str]:
    """Yield what is wrong with a log-sensitivity: an error above 5 times the accuracy, 1e-5, and what a warning states.

    The larger of these is multiplied by ``margin``.
    """
    if any(start in text for text in notes for start in NOTHING):
        return
    if log_sensitivity is None:
        yield "log_sensitivity is null without a reason"
    elif truth.log_sensitivity is not None:
        stated_errors = [float(match[1]) / 100 for text in notes if (match := STATED_SENSITIVITY.search(text))]
        reference_size = max(abs(log_sensitivity), 2e-6 / ACCURACY)  # small ones are compared with this size
        bound = max(5 * ACCURACY * abs(truth.log_sensitivity), 1e-5, ROUGHLY * max(stated_errors, default=0.0) * reference_size)
        bound *= margin
        if not abs(log_sensitivity - truth.log_sensitivity) <= bound + truth.doubt:
            yield f"log_sensitivity {log_sensitivity:.3g}, true {truth.log_sensitivity:.3g} +- {bound:.1g} stated"


def compute_relative_error(value: float | None, true: float | None) -> float | None:
    """Return the relative error, the absolute one where the true value is zero; None where either is unknown."""
    if value is None or true is None:
        return None
    return abs(value / true - 1) if true != 0 else abs(value)
