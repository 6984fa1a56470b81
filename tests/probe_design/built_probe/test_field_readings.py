"""Readings as data for an estimate: errors against covariances written out, files that are none refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry.common.errors import InputError
from hw.signal.measurement import Measurement
from probe_design.built_probe.field_readings import (
    FieldReading,
    compute_ratio_noise,
    compute_spreads,
    parse_field_reading,
    read_result,
)
from probe_design.built_probe.film_forces import measure_samples
from probe_design.built_probe.probe_identity import list_probe_numbers
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from tests.support.hw.benches import BENCH, films, sampled, scene, shares

TOLD = {"ratio": 0.5, "ratio_uncertainty": 0.01, "ratio_noise": 0.012, "force": 0.01, "reference_force": 0.0101,
        "placement": [0.001, -0.002], "calibration_sha256": "ab",
        "ratio_phase": 0.01, "ratio_phase_uncertainty": 0.002,
        "probe": list_probe_numbers(scene()), "fingerprint": {"noise": ["ab" * 16], "volts": [[0.1, 0.2]]}}  # fmt: skip
NARROW = list_probe_numbers(scene()) | {"probe.gap": 5e-5}


@pytest.mark.parametrize("seed", range(5))
def test_no_combination_is_understated(seed: int) -> None:
    """Whatever correlates what readings share, the diagonal that stands for it is at least as large in every direction."""
    random = np.random.default_rng(seed)
    factors, noise = random.normal(size=(4, 1 + seed)), random.uniform(0.0, 0.5, 4)
    common = factors @ factors.T
    readings = [FieldReading(1.0, noise[k], np.sqrt(common[k, k]), "ab", 0.01, None) for k in range(4)]
    remainder = np.diag(np.square(compute_spreads(readings))) - np.diag(noise**2) - common
    assert np.linalg.eigvalsh(remainder).min() > -1e-9


def test_what_all_share_does_not_average_out() -> None:
    same_readings = [FieldReading(1.0, 0.0, 0.01, None, 0.01, None)] * 9
    assert np.sqrt(1 / np.sum(1 / np.square(compute_spreads(same_readings)))) == pytest.approx(0.01)
    separate = [replace(reading, calibration=str(k)) for k, reading in enumerate(same_readings)]
    assert compute_spreads(separate) == pytest.approx([0.01] * 9)


@pytest.mark.slow
def test_noise_is_what_seeds_scatter_by() -> None:
    """Ratios of the same load with other noise differ by as much as each states; 60 draws determine a spread to 9 %."""
    forces = films(shares().log_ratios)[4]

    def measure_once(seed: int) -> Measurement:
        return measure_samples(sampled(build_signals(BuiltProperties(noise=2e-4), BENCH, scene(), forces, seed)), BENCH)

    measured = [measure_once(seed) for seed in range(60)]
    logs = [np.log(measurement.in_phase[0] / measurement.in_phase[1]) for measurement in measured]
    stated = np.mean([compute_ratio_noise(measurement, scene(), BENCH, None) for measurement in measured])
    assert np.std(logs) == pytest.approx(stated, rel=0.3)


def test_json_of_read() -> None:
    reading = parse_field_reading(TOLD, "a.json", scene())
    assert (reading.noise, reading.shared) == pytest.approx((0.012, 0.016))  # 0.02 in all
    assert (reading.force, reading.placement, reading.calibration) == (0.0101, (0.001, -0.002), "ab")
    assert parse_field_reading({k: v for k, v in TOLD.items() if k != "ratio_noise"}, "a.json", scene()).shared == pytest.approx(
        0.02
    )


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("ratio", None, "ratio = null"), ("ratio", "0.5", "ratio = '0.5'"), ("ratio", 0.0, "above 0"), ("ratio", -1.0, "above 0"),
        ("ratio", True, "ratio = true"), ("ratio_uncertainty", -1.0, "above 0"), ("ratio_uncertainty", float("nan"), "nan"),
        ("placement", [1.0], "placement"), ("placement", ["a", 2], "placement"), ("force", None, "force"),
        ("placement", [-1e308, 0.0], "placement"), ("placement", [10**400, 0.0], "placement"), ("force", 10**400, "force"),
        ("ratio_uncertainty", 1e200, "uncertainty"), ("calibration_sha256", ["a"], "calibration_sha256"),
        ("fingerprint", None, "fingerprint"), ("fingerprint", {"noise": ["xy"], "volts": [[1, 1]]}, "fingerprint"),
        ("probe", [1], "probe"),
        ("probe", {"probe.gap": 10**400}, "is missing there"), ("probe", NARROW, "probe.gap is 5e-05 there"),
    ],
)  # fmt: skip
def test_what_read_never_prints_is_refused(key: str, value: object, words: str) -> None:
    with pytest.raises(InputError, match=f"a.json.*{words}"):
        parse_field_reading(TOLD | {key: value}, "a.json", scene())


@pytest.mark.parametrize("text", ["", "{", "[1]", '{"gain": 1}', "nonsense", '{"a":' * 100_000])
def test_json_that_is_none_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(InputError, match="read --json"):
        read_result(tmp_path / "a.json")


def test_kind_is_told_by_content(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(json.dumps(TOLD))
    (tmp_path / "a.probe").write_bytes(b'{"format": "probe-design recording"}\nREAD')
    assert read_result(tmp_path / "a.txt") == TOLD
    assert read_result(tmp_path / "a.probe") is None
