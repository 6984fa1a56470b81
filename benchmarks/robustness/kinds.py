"""List all kinds of robustness tests by name: each a function that draws one test and writes its files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from benchmarks.robustness import bodies, questions, special_files
from benchmarks.robustness.attempt import Attempt
from benchmarks.robustness.damage import Random
from benchmarks.robustness.resource_limits import little_memory

Kind = Callable[[Random, Path], Attempt]
KINDS: dict[str, Kind] = {
    "step": bodies.step,
    "stl": bodies.stl,
    "special": special_files.special,
    "scenes": questions.scene,
    "tables": questions.other_tables,
    "bytes": questions.other_bytes,
    "options": questions.options,
    "limits": little_memory,
}
