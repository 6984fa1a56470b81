"""Compare ``equivalent-inclusion`` with independent codes' reference values: errors, bounds, seconds."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np

from benchmarks.tables import MeasuredTable
from geometry import Scene, read_scene
from solver.equivalent_inclusion.ellipsoids import correct_for_ellipsoids
from solver.equivalent_inclusion.evaluator import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed, solve_undisturbed
from solver.equivalent_inclusion.readings import Readings, compute_readings
from solver.inclusions.tumours import Tumours

REFERENCE = Path(__file__).parents[2] / "tests" / "reference"
FOLDERS = ("axisymmetric", "solid", "off-axis", "extra", "extreme", "layers", "half-space")
ACCURACIES = (0.01, 0.003)
WARM_RUNS = 3  # runs, of which the median counts
_number = count(1)


@dataclass(frozen=True)
class Known:
    """A scene with its true ratio and log-sensitivity; ``None``: not computed.

    Attributes
    ----------
    uncertainty
        Of the ratio, relative.
    doubt
        Of the log-sensitivity, absolute.
    """

    name: str
    scene: Scene
    ratio: float
    log_sensitivity: float | None
    uncertainty: float
    doubt: float


@dataclass(frozen=True)
class AnswerErrors:
    """One result; ``None``: no ratio or no log-sensitivity.

    Attributes
    ----------
    true, stated
        Relative error of the ratio and the bound on it.
    sensitivity
        Relative error of the log-sensitivity.
    excess
        Its absolute error less the true value's own, over the bound on it.
    """

    true: float | None
    stated: float | None
    sensitivity: float | None
    excess: float | None

    def is_right(self, reference: Known) -> bool:
        """Whether the bound holds, the true value's own error allowed for."""
        return self.true is None or self.stated is None or self.true <= self.stated + reference.uncertainty


@dataclass(frozen=True)
class Answers:
    """What one scene got: both tiers, and seconds of ``evaluate``, which chooses between them."""

    first: AnswerErrors
    reflected: AnswerErrors
    cold: float
    warm: float


def read_known(folder: str) -> list[Known]:
    """Return a folder's scenes but those with a groove, which this evaluator leaves out and counts."""
    expected = json.loads((REFERENCE / folder / "expected.json").read_text(encoding="utf-8"))
    scenes = [(name, read_scene(REFERENCE / folder / f"{name}.toml"), values) for name, values in expected.items()]
    return [
        Known(name, scene, values["ratio"], values.get("log_sensitivity"), values["relative_uncertainty"], _doubt(values))
        for name, scene, values in scenes
        if scene.probe.groove is None
    ]


def _doubt(values: dict[str, float]) -> float:
    """Of a log-sensitivity: as stated, or that of a central difference of the ratio with a step of a tenth."""
    given = values.get("log_sensitivity_uncertainty")
    return 10 * values["relative_uncertainty"] if given is None else given


def answers(reference: Known, accuracy: float) -> Answers:
    """Evaluate by both tiers and time ``evaluate`` with the probe not yet solved (once) and solved (median)."""
    level = EquivalentInclusion()
    unheard = accuracy * (1 - 1e-9 * next(_number))  # of which no probe is kept

    def seconds() -> float:
        start = perf_counter()
        level.evaluate(reference.scene, unheard)
        return perf_counter() - start

    cold, warm = seconds(), median(seconds() for _ in range(WARM_RUNS))
    base = solve_undisturbed(reference.scene, unheard)
    first, reflected = (compare_with_reference(reference, answer(base, reference.scene, reflect)) for reflect in (False, True))
    return Answers(first, reflected, cold, warm)


def answer(base: Undisturbed, scene: Scene, reflect: bool) -> Readings:
    """One tier's result for a scene's bodies."""
    readings = compute_readings(base, Tumours.from_scene(scene), scene.target or 0, reflect=reflect)
    return correct_for_ellipsoids(base, scene, readings)


def compare_with_reference(reference: Known, readings: Readings) -> AnswerErrors:
    """Compare with what is known."""
    if not readings.resolved[0]:
        return AnswerErrors(None, None, None, None)
    derivative = excess = None
    if reference.log_sensitivity and readings.derivatives:
        difference = abs(float(readings.log_sensitivity[0]) - reference.log_sensitivity)
        derivative, excess = (
            difference / abs(reference.log_sensitivity),
            max(0.0, difference - reference.doubt) / float(readings.sensitivity_error[0]),
        )
    return AnswerErrors(
        abs(float(readings.ratio[0]) / reference.ratio - 1), float(readings.error_estimate[0]), derivative, excess
    )


def references(folders: Sequence[str], single: bool, progress: Callable[[str], None]) -> Iterator[MeasuredTable]:
    """Yield a table over folders and, if asked, one of single scenes for each accuracy."""
    level, summary = EquivalentInclusion(), _summary()
    for accuracy in ACCURACIES:
        table = _scenes(accuracy)
        for folder in folders:
            rows: list[tuple[Known, Answers]] = []
            for reference in read_known(folder):
                progress(f"references: {folder}/{reference.name}, accuracy {accuracy:g}")
                if level.refusal(reference.scene) is None:
                    rows.append((reference, answers(reference, accuracy)))
                    table.add(reference.name, *_row(*rows[-1]))
            _summarise(summary, folder, accuracy, rows)
        if single:
            yield table
    yield summary


def _scenes(accuracy: float) -> MeasuredTable:
    columns = ("true, error", "stated, error", "of log-sensitivity, error", "over its bound")
    tier_columns = [f"{tier}: {column}" for tier in ("first order", "reflections") for column in columns]
    return MeasuredTable(f"accuracy {accuracy:g}", ("scene", *tier_columns, "evaluate, ms", "probe known, ms"))


def _row(reference: Known, reply: Answers) -> Iterator[float | str | None]:
    for tier in (reply.first, reply.reflected):
        yield from (tier.true, tier.stated, tier.sensitivity, None if tier.excess is None else f"{tier.excess:.2g}")
    yield from (reply.cold, reply.warm)


def _summary() -> MeasuredTable:
    columns = (
        "worst true, error",
        "worst stated, error",
        "worst log-sensitivity, error",
        "median evaluate, ms",
        "probe known, ms",
    )
    return MeasuredTable(
        "worst of each folder",
        ("scenes", "accuracy", "tier", "number", "with a ratio", "wrong", "log-sensitivities wrong", *columns),
    )


def _summarise(table: MeasuredTable, folder: str, accuracy: float, rows: Sequence[tuple[Known, Answers]]) -> None:
    for tier in ("first order", "reflections"):
        pairs = [(reference, reply.first if tier == "first order" else reply.reflected) for reference, reply in rows]
        right = [errors for _, errors in pairs if errors.true is not None]
        wrong = sum(not errors.is_right(reference) for reference, errors in pairs)
        doubtful = sum((errors.excess or 0) > 1 for errors in right)
        worst = (max((v for t in right if (v := getattr(t, key)) is not None), default=None) for key in ("true", "stated"))
        derivatives = [errors.sensitivity for errors in right if errors.sensitivity is not None]
        seconds = (float(np.median([getattr(reply, key) for _, reply in rows])) for key in ("cold", "warm"))
        times = tuple(seconds) if tier == "reflections" else (None, None)
        table.add(
            folder, f"{accuracy:g}", tier, len(rows), len(right), wrong, doubtful, *worst, max(derivatives, default=None), *times
        )
