"""What a cell of the matrix of extremes is: right within its own bounds, refused or null with a reason, or wrong."""

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
PATIENCE = 300  # s of the processor: what takes longer is no answer
MARKS = ("right", "refused", "null", "wrong")
REACHED = re.compile(r"(?:error bounds?|95 % errors) of ([0-9.e+-]+)")
TOLD = re.compile(r"log_sensitivity is good to about ([0-9.e+-]+) of itself only")
NOTHING = ("log_sensitivity is smaller than its own error", "log_sensitivity is null")
QUANTILE_MARGIN = 4  # an error stated as a 95 % quantile is wrong where the true one is so many times as large
ROUNDED, ROUGHLY = 1.05, 1.5  # what rounding to two digits, or to one, may take off a bound in words


@dataclass(frozen=True)
class Answer:
    """What an evaluator said of a scene, before it is judged.

    Attributes
    ----------
    row, evaluator
        which.
    values
        The JSON object of ``probe-design evaluate``, or None.
    refusal
        The line that a refusal says, or None.
    fault
        What else left the evaluator: a warning, another exception, a NaN; or None.
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
    """A judged answer.

    Attributes
    ----------
    row, evaluator, seconds
        See ``Answer``.
    mark
        One of ``MARKS``.
    why
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
    why: str = ""
    true: float | None = None
    stated: float | None = None
    doubt: float = 0.0

    @property
    def share(self) -> float:
        """What the true value's own uncertainty cannot explain of the error, over the bound on it."""
        return max(0.0, (self.true or 0.0) - self.doubt) / (self.stated or 1.0)


def answer(row: Row, evaluator: str) -> Answer:
    """Evaluate a scene, with every warning an error."""
    row = _route_evaluator(row, evaluator)
    start = time.process_time()

    def make_answer(**outcome: Any) -> Answer:
        return Answer(row.key, evaluator, round(time.process_time() - start, 3), **outcome)

    try:
        with warnings.catch_warnings(), patience(PATIENCE):
            warnings.simplefilter("error")
            values = evaluate(row.scene, evaluator, ACCURACY).as_dict()
        json.dumps(values, allow_nan=False)  # ValueError for NaN and infinity anywhere in it
    except InputError as refused:
        return make_answer(refusal=str(refused))
    except Exception as fault:  # whatever else leaves an evaluator
        return make_answer(fault=f"{type(fault).__name__}: {fault}")
    return make_answer(values=values)


def _route_evaluator(row: Row, evaluator: str) -> Row:
    """What an evaluator is asked: ``auto``, which goes to ``contact`` under loads, lightly where linear values are true."""
    return lightened(row) if evaluator == "auto" and row.group != "loads" else row


def judged(row: Row, answer: Answer) -> Cell:
    """Compare an answer with the true values."""
    row = _route_evaluator(row, answer.evaluator)
    name = (answer.row, answer.evaluator, answer.seconds)
    if answer.values is None:
        return Cell(*name, "refused", answer.refusal) if answer.refusal else Cell(*name, "wrong", answer.fault or "no answer")
    values = answer.values
    errors = (relative(values["ratio"], row.truth.ratio), values["error_estimate"], row.truth.uncertainty)
    faults = list(flaws(values, row.truth))
    if faults:
        return Cell(*name, "wrong", "; ".join(faults), *errors)
    if values["ratio"] is None:
        return Cell(*name, "null", next(text for text in values["warnings"] if text.startswith("ratio")))
    return Cell(*name, "right", "", *errors)


@contextmanager
def patience(seconds: int) -> Iterator[None]:
    """Raise ``TimeoutError`` after so many seconds of the processor."""

    def late(*_: Any) -> None:
        raise TimeoutError(f"no answer in {seconds} s")

    previous = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, previous)


def flaws(values: dict[str, Any], truth: Truth) -> Iterator[str]:
    """Yield what is silently wrong in an answer."""
    notes, ratio, stated = values["warnings"], values["ratio"], values["error_estimate"]
    if ratio is None or stated is None:
        if not any(text.startswith("ratio") and " null: " in text for text in notes):
            yield "ratio is null without a reason"
        return
    quantile = values.get("error_kind") == "95 %"
    stated = QUANTILE_MARGIN * stated if quantile else stated
    deviation = relative(ratio, truth.ratio)
    if deviation is not None and not deviation <= stated + truth.uncertainty:
        yield f"ratio off by {deviation:.2g}, stated {stated:.2g}"
    bound = max(ACCURACY, stated, (QUANTILE_MARGIN if quantile else 1) * reached(notes))
    for key in ("stress_inner", "stress_outer", "stiffness"):
        deviation = relative(values[key], getattr(truth, key))
        if deviation is not None and not deviation <= bound + truth.uncertainty:
            yield f"{key} off by {deviation:.2g}, stated {bound:.2g}"
    yield from sensitivity_flaws(values["log_sensitivity"], truth, notes, QUANTILE_MARGIN if quantile else 1)


def reached(notes: Sequence[str]) -> float:
    """The largest bound that a warning tells."""
    if any("no smaller than the values themselves" in text for text in notes):
        return math.inf
    return max((ROUNDED * float(match[1]) for text in notes if (match := REACHED.search(text))), default=0.0)


def sensitivity_flaws(log_sensitivity: float | None, truth: Truth, notes: Sequence[str], margin: int) -> Iterator[str]:
    """Yield what is wrong with a log-sensitivity: off by more than 5 times the accuracy, 1e-5, or what a warning says.

    The larger of these is multiplied by ``margin``.
    """
    if any(start in text for text in notes for start in NOTHING):
        return
    if log_sensitivity is None:
        yield "log_sensitivity is null without a reason"
    elif truth.log_sensitivity is not None:
        words = [float(match[1]) for text in notes if (match := TOLD.search(text))]
        floor = max(abs(log_sensitivity), 2e-6 / ACCURACY)  # small ones are judged by this size
        bound = max(5 * ACCURACY * abs(truth.log_sensitivity), 1e-5, ROUGHLY * max(words, default=0.0) * floor)
        bound *= margin
        if not abs(log_sensitivity - truth.log_sensitivity) <= bound + truth.doubt:
            yield f"log_sensitivity {log_sensitivity:.3g}, true {truth.log_sensitivity:.3g} +- {bound:.1g} stated"


def relative(value: float | None, true: float | None) -> float | None:
    """Return the relative error, the absolute one where the true value is zero; None where either is unknown."""
    if value is None or true is None:
        return None
    return abs(value / true - 1) if true != 0 else abs(value)
