"""Loads on references of another unit: refused or reported in calibration and check, with a force channel or without."""

from __future__ import annotations

from dataclasses import replace

import pytest

from geometry import InputError, Scene
from geometry.scenes.scene_tables import Load
from hw.common.samples import Samples
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.load_plausibility import check_expected, describe_remedy
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from tests.support.hw.benches import BENCH, LOAD, calibrate, check, films, sampled, scene, shares

STILL = BuiltProperties(drift=0.0, offsets=(0.0, 0.0, 0.0))
ALONE = BENCH.model_copy(update={"force": None})


def pressed(load: float = LOAD) -> Scene:
    return scene().model_copy(update={"load": Load(force=load)})


def readings(factor: float, bench: Bench = BENCH, channels: int = 3) -> list[Samples]:
    """On the bench's references, with the films' volts ``factor`` times what they are."""
    samples = [
        sampled(build_signals(STILL, bench, scene(), sample, [9, k]), channels=channels)
        for k, sample in enumerate(films(shares().log_ratios, bench))
    ]
    turn = [factor, factor, 1.0][:channels]
    return [replace(sample, volts=sample.volts * turn) for sample in samples]


@pytest.mark.parametrize(
    ("factor", "slip"), [(1e3, "millivolts taken as volts"), (1e-3, "volts taken as millivolts"), (100.0, "Check the")]
)
@pytest.mark.parametrize("channels", [2, 3])
def test_a_calibration_in_another_unit_is_refused(factor: float, slip: str, channels: int) -> None:
    bench = BENCH if channels == 3 else ALONE
    with pytest.raises(InputError, match=slip) as refused:
        calibrate(pressed(), bench, readings(factor, bench, channels), shares())
    assert refused.value.exit_code == 2


def test_a_check_in_another_unit_is_refused() -> None:
    with pytest.raises(InputError, match="millivolts taken as volts"):
        check(pressed(), ALONE, readings(1e3, ALONE, 2)[2:], predictions=shares())


def test_a_calibration_off_by_ten_is_told() -> None:
    fitted = calibrate(pressed(), ALONE, readings(0.1, ALONE, 2), shares())
    (warning,) = (text for text in fitted.warnings if "to be pressed" in text)
    assert "1:10 probe factor" in warning
    assert "block of 60 kPa" in warning


@pytest.mark.parametrize("load", [0.6 * LOAD, LOAD, 1.7 * LOAD])
def test_a_calibration_at_about_the_scene_s_load_is_not_remarked_on(load: float) -> None:
    fitted = calibrate(pressed(load), ALONE, readings(1.0, ALONE, 2), shares())
    assert not any("to be pressed" in warning for warning in fitted.warnings)


def test_bounds_of_what_is_doubtful_and_what_is_refused() -> None:
    """A load twice as large is reported where the reading is exact; 5 % of uncertainty leave 2.3 times."""
    assert check_expected(1.9, 0.0, 1.0, 1.0, "") == []
    assert len(check_expected(2.1, 0.0, 1.0, 1.0, "")) == 1
    assert check_expected(2.2, 0.05, 1.0, 1.0, "") == []
    assert len(check_expected(29.0, 0.05, 1.0, 1.0, "")) == 1
    assert check_expected(0.3, 0.0, 0.2, 1.0, "") == []
    for load in (31.0, 1 / 31, 0.0, -1.0):
        with pytest.raises(InputError):
            check_expected(load, 0.0, 1.0, 1.0, "")


@pytest.mark.parametrize("factor", [0.0, -3.0, 1e300, 1e-300, float("inf")])
def test_a_remedy_for_any_factor(factor: float) -> None:
    assert describe_remedy(factor).startswith("Check the units")
