"""What a result warns of: gains of another probe or calibration, tumours at the edge of the population's places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from probe_design.locating.report import list_lines
from tests.probe_design.locating.test_inference import CLEAR, clear, result, scan


def test_gains_beyond_their_noise_are_named() -> None:
    """Those of another probe or calibration: ln gain of 0.3 with a standard deviation of 0.07."""
    data = scan(CLEAR)
    notes = result(replace(data, values=data.values + np.array([0.3, 0.0])), tumours=1).warnings
    assert any("all readings are off alike" in line for line in notes)
    assert not clear().warnings


def test_a_tumour_beyond_the_population_s_places_is_said_to_lie_at_their_edge() -> None:
    """It lies 4 mm outside x = 16 mm: a margin of 6 mm holds it, and without one a warning names the edge."""
    outside = CLEAR.copy()
    outside[..., 0] = 20e-3
    narrow, wide = (result(scan(outside), tumours=1, **margin) for margin in ({}, {"margin": 6e-3}))
    assert any("within 1 mm of x = 16 mm" in line and "margin" in line for line in narrow.warnings)
    assert not any("margin" in line for line in wide.warnings)
    low, high = wide.tumours[0].quantities["x"].interval_90
    assert low < 20e-3 < high


def test_every_answer_says_which_probe_and_places_it_assumes() -> None:
    """Readings do not tell another probe, nor a weak tumour beyond the margin: with 6 mm of it places end at 22 mm."""
    (line,) = (text for text in list_lines(result(scan(CLEAR), tumours=1, margin=6e-3)) if "Conditional" in text)
    assert "the probe as drawn" in line
    assert "x = -22 to 22 mm, y = -22 to 22 mm only" in line
