"""The prediction of a long reading leaves no memory behind, and gives the same result as a prediction in this process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from geometry.common.errors import Refusal
from geometry.processes.child import Failure
from probe_design.built_probe.reading import predict_scene
from probe_design.commands.reference_readings import choose_prediction
from probe_design.measuring import prediction_process
from tests.support.hw.benches import scene


@pytest.mark.slow
def test_it_is_the_prediction() -> None:
    separate, direct = (
        function(scene(), 0.01, False, 5.0) for function in (prediction_process.predict_in_process, predict_scene)
    )
    assert separate.as_dict() | {"seconds": 0} == direct.as_dict() | {"seconds": 0}


def test_what_is_refused_there_is_refused_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the error's own name, which decides the exit code."""

    def fails(program: Path, arrays: Any, seconds: float) -> Any:
        raise Failure("load = ...: allowed: ...")

    def refuses(*question: Any) -> Any:
        raise Refusal("load", 1.0, "less")

    monkeypatch.setattr(prediction_process, "run_program", fails)
    monkeypatch.setattr(prediction_process, "predict_scene", refuses)
    with pytest.raises(Refusal, match=r"load = 1\.0: allowed: less"):
        prediction_process.predict_in_process(scene(), 0.01, False, 5.0)


def test_long_readings_are_predicted_apart() -> None:
    assert choose_prediction(3600.0) is prediction_process.predict_in_process
    assert choose_prediction(10.0) is predict_scene
    assert choose_prediction(None) is predict_scene


def test_reading_loads_no_library_that_it_does_not_use() -> None:
    """23 and 15 MB of statistics and optimisation, held for hours."""
    modules = "probe_design.built_probe.reading, probe_design.commands.hardware_sources, probe_design.terminal.hardware_tables"
    program = f"import sys, {modules}; print({{'scipy.stats', 'scipy.optimize'}} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout == "set()\n"
