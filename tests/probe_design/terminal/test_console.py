"""What tables print of limits."""

from __future__ import annotations

from dataclasses import replace
from io import StringIO

import pytest
from rich.console import Console

from geometry import read_scene
from probe_design.terminal.console import plan_lines, result_table
from solver import Result, plan
from solver.results.result import LargestLoad
from tests.support.paths import SCENE


@pytest.mark.parametrize("exact", [(0.035949, 0.00023751), (0.035951, 0.00023749)])
def test_a_load_that_is_printed_is_allowed(exact: tuple[float, float]) -> None:
    """To three digits the nearest number may lie above the limit, and would be refused."""
    limit = LargestLoad(*exact, "ratio")
    said = plan_lines(replace(plan(read_scene(SCENE)), linear_limit_load=limit))[-1]
    assert "up to 0.0359 N, an indentation of 0.237 mm" in said
    out = StringIO()
    Console(file=out).print(result_table(Result("closed-form", 0.1, linear_limit_load=limit)))
    assert " 0.0359 " in out.getvalue()
