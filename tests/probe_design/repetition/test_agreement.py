"""Which numbers of two results agree."""

from __future__ import annotations

import math
from typing import Any

import pytest

from probe_design.repetition.agreement import count_numbers, find_differences


@pytest.mark.parametrize(
    ("previous", "now", "places"),
    [
        ({"ratio": 0.5}, {"ratio": 0.5 * (1 + 1e-7)}, []),
        ({"ratio": 0.5}, {"ratio": 0.501}, ["ratio"]),
        # 1.5 % apart, with errors of 1 % each, and of 0.5 % each
        ({"ratio": 0.5, "error_estimate": 0.01}, {"ratio": 0.5075, "error_estimate": 0.01}, []),
        ({"ratio": 0.5, "error_estimate": 0.005}, {"ratio": 0.5075, "error_estimate": 0.005}, ["ratio"]),
        # a log-sensitivity is promised five times as widely
        ({"log_sensitivity": 0.04, "error_estimate": 0.01}, {"log_sensitivity": 0.043, "error_estimate": 0.01}, []),
        (
            {"log_sensitivity": 0.04, "error_estimate": 0.01},
            {"log_sensitivity": 0.045, "error_estimate": 0.01},
            ["log_sensitivity"],
        ),
        # of an array each entry has its own error
        (
            {"ratio": [1.0, 1.0], "error_estimate": [0.1, 0.001]},
            {"ratio": [1.1, 1.1], "error_estimate": [0.1, 0.001]},
            ["ratio[1]"],
        ),
        ({"ratio": None}, {"ratio": 0.5}, ["ratio"]),
        # errors and numbers that no answer states
        ({"ratio": 0.5, "error_estimate": math.inf}, {"ratio": 0.6}, ["ratio"]),
        ({"ratio": 0.5, "error_estimate": -1.0}, {"ratio": 0.5}, []),
        ({"ratio": 0.5, "error_estimate": 10**400}, {"ratio": 10**400}, ["ratio"]),
        ({"ratio": 0.5}, {}, ["ratio"]),
        ({"seconds": 1.0, "files": ["a"], "warnings": ["b"]}, {"seconds": 2.0, "files": [], "warnings": []}, []),
        ({"a": [1.0, 2.0]}, {"a": [1.0, 2.1]}, ["a[1]"]),
        ({"a": [1.0, 2.0]}, {"a": [1.0]}, ["a"]),
        ({"seen": True}, {"seen": False}, ["seen"]),
        ({"seen": True}, {"seen": 1}, []),
        ({"gap": "0.1 mm"}, {"gap": "0.10000000001 mm"}, []),
        ({"gap": "0.1 mm"}, {"gap": "0.1 um"}, ["gap"]),
        ({"evaluator": "solid"}, {"evaluator": "contact"}, ["evaluator"]),
        ({"result": {"ratio": 1.0, "error_estimate": 0.1}}, {"result": {"ratio": 1.1, "error_estimate": 0.1}}, []),
    ],
)
def test_differences(previous: dict[str, Any], now: dict[str, Any], places: list[str]) -> None:
    differing = find_differences(previous, now)
    assert [difference.place for difference in differing] == places
    assert all("\n" not in str(difference) for difference in differing)
    assert len(differing) <= count_numbers(previous, now)
