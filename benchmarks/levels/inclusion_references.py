"""``equivalent-inclusion`` on scenes whose true values independent codes have found: errors, bounds on them, seconds."""

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
from solver.equivalent_inclusion.level import EquivalentInclusion
from solver.equivalent_inclusion.probe_on_tissue import Undisturbed, solve_undisturbed
from solver.equivalent_inclusion.readings import Readings, compute_readings
from solver.inclusions.tumours import Tumours

REFERENCE = Path(__file__).parents[2] / "tests" / "reference"
FOLDERS = ("axisymmetric", "solid", "off-axis", "extra", "extreme", "layers", "half-space")
ACCURACIES = (0.01, 0.003)
WARM = 3  # runs, of which the median counts
_number = count(1)


@dataclass(frozen=True)
class Known:
    """A scene with its true ratio and log-sensitivity; ``None``: not computed.

    Attributes:
        uncertainty: of the ratio, relative.
        doubt: of the log-sensitivity, absolute.
    """

    name: str
    scene: Scene
    ratio: float
    log_sensitivity: float | None
    uncertainty: float
    doubt: float


@dataclass(frozen=True)
class Told:
    """One answer; ``None``: no ratio or no log-sensitivity.

    Attributes:
        true, stated: relative error of the ratio and the bound on it.
        sensitivity: relative error of the log-sensitivity.
        excess: its absolute error less the true value's own, over the bound on it.
    """

    true: float | None
    stated: float | None
    sensitivity: float | None
    excess: float | None

    def right(self, one: Known) -> bool:
        """Whether the bound holds, the true value's own error allowed for."""
        return self.true is None or self.stated is None or self.true <= self.stated + one.uncertainty


@dataclass(frozen=True)
class Answers:
    """What one scene got: both tiers, and seconds of ``evaluate``, which chooses between them."""

    first: Told
    reflected: Told
    cold: float
    warm: float


def known(folder: str) -> list[Known]:
    """Return a folder's scenes but those with a groove, which this level leaves out and counts."""
    found = json.loads((REFERENCE / folder / "expected.json").read_text(encoding="utf-8"))
    scenes = [(name, read_scene(REFERENCE / folder / f"{name}.toml"), values) for name, values in found.items()]
    return [
        Known(name, scene, values["ratio"], values.get("log_sensitivity"), values["relative_uncertainty"], _doubt(values))
        for name, scene, values in scenes
        if scene.probe.groove is None
    ]


def _doubt(values: dict[str, float]) -> float:
    """Of a log-sensitivity: as stated, or that of a central difference of the ratio with a step of a tenth."""
    given = values.get("log_sensitivity_uncertainty")
    return 10 * values["relative_uncertainty"] if given is None else given


def answers(one: Known, accuracy: float) -> Answers:
    """Answer by both tiers and time ``evaluate`` with the probe not yet solved (once) and solved (median)."""
    level = EquivalentInclusion()
    unheard = accuracy * (1 - 1e-9 * next(_number))  # of which no probe is kept

    def seconds() -> float:
        start = perf_counter()
        level.evaluate(one.scene, unheard)
        return perf_counter() - start

    cold, warm = seconds(), median(seconds() for _ in range(WARM))
    base = solve_undisturbed(one.scene, unheard)
    first, reflected = (told(one, answer(base, one.scene, reflect)) for reflect in (False, True))
    return Answers(first, reflected, cold, warm)


def answer(base: Undisturbed, scene: Scene, reflect: bool) -> Readings:
    """One tier's answer for a scene's bodies."""
    found = compute_readings(base, Tumours.from_scene(scene), scene.target or 0, reflect=reflect)
    return correct_for_ellipsoids(base, scene, found, scene.inclusion)


def told(one: Known, found: Readings) -> Told:
    """Compare with what is known."""
    if not found.resolved[0]:
        return Told(None, None, None, None)
    slope = excess = None
    if one.log_sensitivity and found.derivatives:
        off = abs(float(found.log_sensitivity[0]) - one.log_sensitivity)
        slope, excess = off / abs(one.log_sensitivity), max(0.0, off - one.doubt) / float(found.sensitivity_error[0])
    return Told(abs(float(found.ratio[0]) / one.ratio - 1), float(found.error_estimate[0]), slope, excess)


def references(folders: Sequence[str], single: bool, tell: Callable[[str], None]) -> Iterator[MeasuredTable]:
    """Yield a table over folders and, if asked, one of single scenes for each accuracy."""
    level, summary = EquivalentInclusion(), _summary()
    for accuracy in ACCURACIES:
        table = _scenes(accuracy)
        for folder in folders:
            rows: list[tuple[Known, Answers]] = []
            for one in known(folder):
                tell(f"references: {folder}/{one.name}, accuracy {accuracy:g}")
                if level.refusal(one.scene) is None:
                    rows.append((one, answers(one, accuracy)))
                    table.add(one.name, *_row(*rows[-1]))
            _summarise(summary, folder, accuracy, rows)
        if single:
            yield table
    yield summary


def _scenes(accuracy: float) -> MeasuredTable:
    columns = ("true, error", "stated, error", "of log-sensitivity, error", "over its bound")
    both = [f"{tier}: {column}" for tier in ("first order", "reflections") for column in columns]
    return MeasuredTable(f"accuracy {accuracy:g}", ("scene", *both, "evaluate, ms", "probe known, ms"))


def _row(one: Known, found: Answers) -> Iterator[float | str | None]:
    for tier in (found.first, found.reflected):
        yield from (tier.true, tier.stated, tier.sensitivity, None if tier.excess is None else f"{tier.excess:.2g}")
    yield from (found.cold, found.warm)


def _summary() -> MeasuredTable:
    columns = (
        "worst true, error",
        "worst stated, error",
        "worst log-sensitivity, error",
        "median evaluate, ms",
        "probe known, ms",
    )
    return MeasuredTable(
        "worst of each folder", ("scenes", "asked", "tier", "number", "told", "wrong", "log-sensitivities wrong", *columns)
    )


def _summarise(table: MeasuredTable, folder: str, accuracy: float, rows: Sequence[tuple[Known, Answers]]) -> None:
    for tier in ("first order", "reflections"):
        each = [(one, found.first if tier == "first order" else found.reflected) for one, found in rows]
        right = [told for _, told in each if told.true is not None]
        wrong = sum(not told.right(one) for one, told in each)
        doubtful = sum((told.excess or 0) > 1 for told in right)
        worst = (max((v for t in right if (v := getattr(t, key)) is not None), default=None) for key in ("true", "stated"))
        slopes = [told.sensitivity for told in right if told.sensitivity is not None]
        seconds = (float(np.median([getattr(found, key) for _, found in rows])) for key in ("cold", "warm"))
        times = tuple(seconds) if tier == "reflections" else (None, None)
        table.add(
            folder, f"{accuracy:g}", tier, len(rows), len(right), wrong, doubtful, *worst, max(slopes, default=None), *times
        )
