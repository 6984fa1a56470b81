"""Readings as data for an estimate: errors against covariances written out, files that are none refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geometry.common.errors import InputError
from hw.signal.measure import Measurement
from probe_design.built_probe.field_readings import FieldReading, field_reading, noise_of, read_result, spreads
from probe_design.built_probe.film_forces import reading
from probe_design.built_probe.probe_identity import probe_numbers
from probe_design.built_probe.virtual_probe import Built, signals
from tests.support.hw.benches import BENCH, films, sampled, scene, shares

TOLD = {"ratio": 0.5, "ratio_uncertainty": 0.01, "ratio_noise": 0.012, "force": 0.01, "reference_force": 0.0101,
        "placement": [0.001, -0.002], "calibration_sha256": "ab",
        "ratio_phase": 0.01, "ratio_phase_uncertainty": 0.002,
        "probe": probe_numbers(scene()), "fingerprint": {"noise": ["ab" * 16], "volts": [[0.1, 0.2]]}}  # fmt: skip
NARROW = probe_numbers(scene()) | {"probe.gap": 5e-5}


@pytest.mark.parametrize("seed", range(5))
def test_no_combination_is_understated(seed: int) -> None:
    """Whatever correlates what readings share, the diagonal that stands for it is at least as large in every direction."""
    random = np.random.default_rng(seed)
    factors, noise = random.normal(size=(4, 1 + seed)), random.uniform(0.0, 0.5, 4)
    common = factors @ factors.T
    readings = [FieldReading(1.0, noise[k], np.sqrt(common[k, k]), "ab", 0.01, None) for k in range(4)]
    rest = np.diag(np.square(spreads(readings))) - np.diag(noise**2) - common
    assert np.linalg.eigvalsh(rest).min() > -1e-9


def test_what_all_share_does_not_average_out() -> None:
    same = [FieldReading(1.0, 0.0, 0.01, None, 0.01, None)] * 9
    assert np.sqrt(1 / np.sum(1 / np.square(spreads(same)))) == pytest.approx(0.01)
    others = [replace(one, calibration=str(k)) for k, one in enumerate(same)]
    assert spreads(others) == pytest.approx([0.01] * 9)


@pytest.mark.slow
def test_noise_is_what_seeds_scatter_by() -> None:
    """Ratios of the same load with other noise differ by as much as each says; 60 draws tell a spread to 9 %."""
    forces = films(shares().log_ratios)[4]

    def one(seed: int) -> Measurement:
        return reading(sampled(signals(Built(noise=2e-4), BENCH, scene(), forces, seed)), BENCH)

    measured = [one(seed) for seed in range(60)]
    logs = [np.log(each.in_phase[0] / each.in_phase[1]) for each in measured]
    stated = np.mean([noise_of(each, scene(), BENCH, None) for each in measured])
    assert np.std(logs) == pytest.approx(stated, rel=0.3)


def test_json_of_read() -> None:
    found = field_reading(TOLD, "a.json", scene())
    assert (found.noise, found.shared) == pytest.approx((0.012, 0.016))  # 0.02 in all
    assert (found.force, found.placement, found.calibration, found.phase) == (0.0101, (0.001, -0.002), "ab", (0.01, 0.002))
    assert field_reading({k: v for k, v in TOLD.items() if k != "ratio_noise"}, "a.json", scene()).shared == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("ratio", None, "ratio = null"), ("ratio", "0.5", "ratio = '0.5'"), ("ratio", 0.0, "other than 0"),
        ("ratio", True, "ratio = true"), ("ratio_uncertainty", -1.0, "above 0"), ("ratio_uncertainty", float("nan"), "nan"),
        ("placement", [1.0], "placement"), ("placement", ["a", 2], "placement"), ("force", None, "force"),
        ("placement", [-1e308, 0.0], "placement"), ("placement", [10**400, 0.0], "placement"), ("force", 10**400, "force"),
        ("ratio_uncertainty", 1e200, "uncertainty"), ("calibration_sha256", ["a"], "calibration_sha256"),
        ("fingerprint", None, "fingerprint"), ("fingerprint", {"noise": ["xy"], "volts": [[1, 1]]}, "fingerprint"),
        ("probe", [1], "probe"),
        ("probe", {"probe.gap": 10**400}, "not told"), ("probe", NARROW, "probe.gap is 5e-05 there"),
    ],
)  # fmt: skip
def test_what_read_never_prints_is_refused(key: str, value: object, words: str) -> None:
    with pytest.raises(InputError, match=f"a.json.*{words}"):
        field_reading(TOLD | {key: value}, "a.json", scene())


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
