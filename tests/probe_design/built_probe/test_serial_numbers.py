"""Serial numbers: whose they are, and what is refused, allowed or warned of where they differ or are not known."""

from __future__ import annotations

from typing import Any

import pytest

from geometry import InputError
from probe_design.built_probe.probe_identity import check_serials, find_common_serial, read_board_serial


@pytest.mark.parametrize(
    ("source", "serial"),
    [
        ({"transport": "usb", "serial": "A17"}, "A17"),
        ({"transport": "daq", "serial": " A17 "}, "A17"),
        ({"transport": "serial", "serial": "A17", "port": "/dev/ttyACM0"}, "A17"),
        ({"transport": "serial", "serial": "/dev/ttyACM0"}, None),  # an older recording, which has the port's name there
        ({"transport": "visa", "serial": "DS1ZA1"}, None),  # the oscilloscope's own
        ({"transport": "csv"}, None),
        ({"transport": "usb", "serial": ""}, None),
        ({"transport": "usb", "serial": "A\n17"}, None),
        ({"transport": "usb", "serial": 17}, None),
        ({"transport": "usb", "serial": "A" * 101}, None),
    ],
)
def test_a_board_s_serial_number(source: dict[str, Any], serial: str | None) -> None:
    assert read_board_serial(source) == serial


def test_another_probe_is_refused_unless_allowed() -> None:
    boards = {"the calibration": "A17", "the reading": "B2"}
    with pytest.raises(InputError, match=r"A17 of the calibration; B2 of the reading.*--any-probe") as refused:
        check_serials(boards, any_probe=False)
    assert refused.value.exit_code == 2
    (warning,) = check_serials(boards, any_probe=True)
    assert "A17 of the calibration" in warning


def test_one_probe_is_not_remarked_on_and_an_unknown_one_is() -> None:
    assert check_serials({"the calibration": "A17", "the reading": "A17"}, any_probe=False) == []
    assert check_serials({"the reading": None}, any_probe=False) == []
    for known in ("A17", None):
        (warning,) = check_serials({"the calibration": known, "scope.csv": None}, any_probe=False)
        assert "scope.csv" in warning


def test_what_several_readings_have_in_common() -> None:
    assert find_common_serial({"1": "A17", "2": "A17"}) == "A17"
    assert find_common_serial({"1": "A17", "2": None}) is None
    assert find_common_serial({"1": "A17", "2": "B2"}) is None
