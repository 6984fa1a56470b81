"""What all sides of ``solid.py`` share: results, and their seconds by the clock and of the processor."""

from __future__ import annotations

import json
import os
import resource
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

_ROOT = Path(__file__).resolve().parents[2]
FOLDERS = (_ROOT / "tests" / "reference" / "solid", _ROOT.parent / "shared" / "reference" / "solid")
SCENES = ("flank", "groove-over-tumour", "two-tumours-on-large-tumour")
ACCURACIES = (0.02, 0.007)


def folder() -> Path:
    """Return the folder of the scenes and their true values."""
    given = os.environ.get("SOLID_REFERENCE")
    return next(path for path in ([Path(given)] if given else FOLDERS) if (path / "expected.json").exists())


def scene_file(name: str) -> Path:
    """Return a scene's file."""
    return folder() / f"{name}.toml"


def read_expected(name: str) -> dict[str, float]:
    """Return a scene's true values."""
    values: dict[str, float] = json.loads((folder() / "expected.json").read_text(encoding="utf-8"))[name]
    return values


@dataclass(frozen=True)
class SolidAnswer:
    """The ratio by one code on one mesh.

    Attributes
    ----------
    ratio
        Of the mean stresses.
    stiffness
        Force over indentation, N over the code's unit of length.
    unknowns
        Of the system.
    elements
        Of the mesh.
    wall, process
        Seconds of each stage, by the clock and of the processor, those of other programs started included.
    details
        What else the code reports.
    """

    ratio: float
    stiffness: float
    unknowns: int
    elements: int
    wall: dict[str, float]
    process: dict[str, float]
    details: dict[str, Any] = field(default_factory=dict)


def processor() -> float:
    """Return the processor's seconds of this process and of those it waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


class Laps:
    """Splits a run into stages: ``lap`` books the time since the last lap."""

    def __init__(self) -> None:
        self.wall: dict[str, float] = {}
        self.process: dict[str, float] = {}
        self._last = perf_counter(), processor()

    def lap(self, stage: str) -> None:
        """Book the time since the last lap to a stage."""
        now = perf_counter(), processor()
        for laps, new, old in zip((self.wall, self.process), now, self._last, strict=True):
            laps[stage] = new - old
        self._last = now
