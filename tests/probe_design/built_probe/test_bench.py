"""Bench files: what a user may write in them."""

from __future__ import annotations

import pytest

from geometry import InputError
from probe_design.built_probe.bench import bench_from_dict


def test_fractions_may_be_percentages() -> None:
    bench = bench_from_dict(
        {
            "force": {"sensitivity": "1 V/N"},
            "reference": [{"on": "inner"}],
            "channels": {"gain": "7 %"},
            "workshop": {"modulus": "3%"},
        }
    )
    assert (bench.channels.gain, bench.workshop.modulus) == (0.07, 0.03)
    with pytest.raises(InputError, match=r"channels\.gain = '7 x%': allowed: a number from 0 to 1, such as 0\.02 or 2 %"):
        bench_from_dict({"force": {"sensitivity": "1 V/N"}, "reference": [{"on": "inner"}], "channels": {"gain": "7 x%"}})
