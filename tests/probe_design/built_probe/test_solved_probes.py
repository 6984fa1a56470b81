"""A study that was interrupted goes on from what it has solved, whatever a kill has left of the last line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.built_probe.solved_probes import SolvedProbes
from geometry.common.arrays import Floats


def never() -> Floats:
    raise AssertionError("solved once more")


def test_an_interrupted_study_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "solved.jsonl"
    first = SolvedProbes(path, None)
    first.get(0, None, lambda: np.array([0.1, -0.3]))
    first.get(1, "probe.gap", lambda: np.array([0.2]))
    path.write_text(path.read_text()[:-5])
    reopened = SolvedProbes(path, None)
    assert reopened.get(0, None, never).tolist() == [0.1, -0.3]
    assert reopened.get(1, "probe.gap", lambda: np.array([0.2])).tolist() == [0.2]
    assert SolvedProbes(path, None).get(1, "probe.gap", never).tolist() == [0.2]
    with pytest.raises(AssertionError):
        SolvedProbes(path, 0.05).get(0, None, never)
