"""What all sides of ``axisymmetric.py`` share: the scenes with their true values, results and their times."""

from __future__ import annotations

import json
import math
import os
import resource
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import ClassVar, Protocol, TypeVar

import numpy as np

from geometry import Scene, read_scene
from geometry.common.arrays import Floats

FOLDER = Path(__file__).parents[2] / "tests" / "reference" / "axisymmetric"
NAMES = ("published-materials", "shallow", "equal-areas-small", "nearly-incompressible", "soft-cyst")
CONTRASTS = (0.1, 1000.0)  # of inclusion to tissue, at the ends of a curve


@dataclass(frozen=True)
class KnownScene:
    """A scene and its true ratio and log-sensitivity, by a code of high order; see tests/reference/README.md."""

    name: str
    scene: Scene
    ratio: float
    log_sensitivity: float

    def error(self, ratio: float) -> float:
        """Return the true relative error of a ratio."""
        return abs(ratio / self.ratio - 1)

    def moduli(self, points: int) -> Floats:
        """Return moduli of the inclusion, evenly spread in their logarithm."""
        return np.asarray(self.scene.tissue.youngs_modulus * np.geomspace(*CONTRASTS, points))


@dataclass(frozen=True)
class RatioCurve:
    """Ratio and its log-sensitivity at moduli of the inclusion (Pa); arrays of one shape."""

    youngs_modulus: Floats
    ratio: Floats
    log_sensitivity: Floats

    def largest_difference(self, other: RatioCurve) -> tuple[float, float]:
        """Return the largest differences: of the ratio, relative; of the log-sensitivity, relative to its largest value."""
        derivative = np.abs(self.log_sensitivity - other.log_sensitivity) / np.max(np.abs(other.log_sensitivity))
        return float(np.max(np.abs(self.ratio / other.ratio - 1))), float(np.max(derivative))


@dataclass(frozen=True)
class PeerAnswer:
    """The ratio by one code on one mesh, the unknowns of its system, and the seconds of each of its stages."""

    ratio: float
    unknowns: int
    stages: dict[str, float] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """All stages together."""
        return sum(self.stages.values())


class PeerClock:
    """By which all is measured: wall time, or what a program puts in its place, the processor's on a machine that others use."""

    now: ClassVar[Callable[[], float]] = perf_counter


class Stopwatch:
    """Splits a run into stages: ``lap`` books the time since the last lap."""

    def __init__(self) -> None:
        self.stages: dict[str, float] = {}
        self._last = PeerClock.now()

    def lap(self, stage: str) -> None:
        """Book the time since the last lap to a stage."""
        now = PeerClock.now()
        self.stages[stage] = self.stages.get(stage, 0.0) + now - self._last
        self._last = now


T = TypeVar("T")


class HasSeconds(Protocol):
    """What ``typical`` chooses by."""

    @property
    def seconds(self) -> float:
        """Time of the run."""


S = TypeVar("S", bound=HasSeconds)


def typical(run: Callable[[], S], repeats: int) -> S:
    """Run several times and return the run of median time (the lower of the two middle ones)."""
    runs = sorted((run() for _ in range(repeats)), key=lambda result: result.seconds)
    return runs[(len(runs) - 1) // 2]


def time_runs(run: Callable[[], T], repeats: int, clock: Callable[[], float] | None = None) -> tuple[T, float]:
    """Run several times; return the last result and the median of the seconds by a clock, or that of all measurements."""
    seconds, clock = [], clock or PeerClock.now
    for _ in range(repeats):
        start = clock()
        result = run()
        seconds.append(clock() - start)
    return result, median(seconds)


@contextmanager
def limit_memory(share: float = 0.7) -> Iterator[None]:
    """Let allocations fail beyond a share of the machine's memory, before the system ends the process."""
    old_limits = resource.getrlimit(resource.RLIMIT_AS)
    max_bytes = int(share * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    resource.setrlimit(resource.RLIMIT_AS, (max_bytes, old_limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, old_limits)


def cases(names: Sequence[str] = NAMES) -> list[KnownScene]:
    """Read the scenes and their true values."""
    expected = json.loads((FOLDER / "expected.json").read_text(encoding="utf-8"))
    return [
        KnownScene(
            name, read_scene(FOLDER / f"{name}.toml"), expected[name]["ratio"], expected[name].get("log_sensitivity", math.nan)
        )
        for name in names
    ]
