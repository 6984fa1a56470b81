"""What would help most: single improvements of the readings, and their picture."""

from __future__ import annotations

from pathlib import Path

import pytest

from geometry.common.errors import InputError
from probe_design.design_report.improvements import Improvement, compute_improvements
from probe_design.design_report.pictures import draw_improvements
from probe_design.populations.design_file import Design
from probe_design.populations.objective import Objective
from tests.support.designs import SUPERFICIAL, example_design

NOISE = {"white": 0.05, "stiffness_white": 0.05}
PNG = b"\x89PNG"


def small(**protocol: object) -> Design:
    table = {"positions": ["-4 mm", "4 mm"], **protocol}
    return example_design(population={**SUPERFICIAL, "samples": 8}, protocol=table, noise=NOISE)


@pytest.mark.slow
def test_every_lever_helps_and_is_named() -> None:
    design = small(stiffness=False, blank=False)
    improvements = compute_improvements(design.scene, design)
    names = ["as it is", "white halved", "gain halved", "charge halved", "stiffness read", "blank read", "3 positions"]
    names.append("force doubled")
    assert [item.name for item in improvements] == names
    assert improvements[0].gain == 0.0
    for item in improvements[1:]:
        if item.name != "blank read":  # which takes gains away and doubles white noise
            assert item.gain > -2 * item.error, item


@pytest.mark.slow
def test_gains_that_cancel_are_no_lever() -> None:
    design = small(stiffness=False)
    assert not any("gain" in item.name for item in compute_improvements(design.scene, design))


def test_their_picture_is_written(tmp_path: Path) -> None:
    bars = [Improvement("as it is", 0.4, 0.0, 0.0), Improvement("white halved", 0.5, 0.1, 0.02)]
    assert draw_improvements(bars, Objective(), tmp_path / "levers.png").read_bytes().startswith(PNG)
    with pytest.raises(InputError, match="a file name that ends in"):
        draw_improvements(bars, Objective(), tmp_path / "levers.txt")
