"""Scans of known truth in ``examples/scans``: simulated by ``equivalent-inclusion`` with reflections, gain and noise."""

from __future__ import annotations

import pytest

from probe_design import locate
from tests.support.paths import EXAMPLES

TRUTHS_MM = {  # x and y, from the programs that simulated the scans
    "one-deep": [(-6.3, 2.2)],
    "one-other-probe": [(13.0, 9.7)],
    "two-apart": [(8.3, 7.2), (-9.2, -6.1)],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TRUTHS_MM)
def test_tumours_of_known_scans_lie_in_their_intervals(name: str) -> None:
    scan, truths = EXAMPLES / "scans" / name, TRUTHS_MM[name]
    result = locate(scan.with_suffix(".toml"), readings=scan.with_suffix(".csv"))
    assert sum(result.probability[: len(truths)]) < 0.1
    assert len(result.tumours) >= len(truths)
    for tumour, truth in zip(result.tumours, truths, strict=False):  # the clearest come first
        for axis, place in zip("xy", truth, strict=True):
            low, high = tumour.quantities[axis].interval_90
            assert low < 1e-3 * place < high, axis
