"""Fingerprints: the same samples are known in other units, digits and lengths; other noise is not taken for them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hw.common.samples import Samples
from hw.signal.fingerprint import FINGERPRINT_ROWS, HASH_BITS, Fingerprint
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from tests.support.hw.benches import BENCH, films, sampled, scene, shares


def virtual(seed: int, rows: int = 10_000, **built: float) -> Samples:
    forces = films(shares().log_ratios)[4]
    return sampled(build_signals(BuiltProperties(**built), BENCH, scene(), forces, seed), rows)  # type: ignore[arg-type]


def differing(first: Fingerprint, second: Fingerprint) -> int:
    return (int(first.noise[-1], 16) ^ int(second.noise[-1], 16)).bit_count()


FIRST = virtual(1)


@pytest.mark.parametrize("digits", [9, 6, 5])
def test_rounded_samples_are_the_same(digits: int) -> None:
    rounded = replace(FIRST, volts=np.round(FIRST.volts, digits))
    assert Fingerprint.from_samples(rounded).is_same(Fingerprint.from_samples(FIRST))


def test_a_copy_that_ends_earlier_is_the_same() -> None:
    assert Fingerprint.from_samples(FIRST.select_before(FINGERPRINT_ROWS)) == Fingerprint.from_samples(FIRST)


@pytest.mark.parametrize("rows", [64, 500, 6000])
def test_a_copy_shorter_than_a_fingerprint_is_the_same(rows: int) -> None:
    """Fewer samples than a fingerprint looks at are compared with as many of the other reading."""
    early = Fingerprint.from_samples(FIRST.select_before(rows))
    assert early.is_same(Fingerprint.from_samples(FIRST))
    assert not early.is_same(Fingerprint.from_samples(virtual(2)))


@pytest.mark.parametrize("seed", range(2, 12))
def test_other_presses_are_others(seed: int) -> None:
    """The load, its phase, hum, drift and offsets are the same: only the noise differs."""
    assert not Fingerprint.from_samples(virtual(seed)).is_same(Fingerprint.from_samples(FIRST))


def test_equal_noise_on_another_load_is_another_press() -> None:
    louder = replace(FIRST, volts=1.01 * FIRST.volts)
    assert not Fingerprint.from_samples(louder).is_same(Fingerprint.from_samples(FIRST))


@pytest.mark.parametrize("angle", [0.2, 0.5, 1.0, np.pi / 2])
def test_share_of_signs_that_differ(angle: float) -> None:
    """Charikar's theorem: a / pi, with the binomial's scatter over 40 pairs of 128 signs."""
    random = np.random.default_rng(3)
    shares = []
    for _ in range(40):
        first, two = random.normal(size=(2, 1024, 3))
        pair = (replace(FIRST, volts=volts) for volts in (first, np.cos(angle) * first + np.sin(angle) * two))
        shares.append(differing(*(Fingerprint.from_samples(samples) for samples in pair)) / HASH_BITS)
    expected = angle / np.pi
    assert np.mean(shares) == pytest.approx(expected, abs=5 * np.sqrt(expected * (1 - expected) / HASH_BITS / 40))


def test_json_and_back() -> None:
    fingerprint = Fingerprint.from_samples(FIRST)
    assert Fingerprint.from_dict(fingerprint.as_dict()) == fingerprint
    wrong: list[Any] = [
        None,
        [],
        {"noise": ["ab"], "volts": [[1, 2]]},
        {"noise": [3], "volts": [[1, 2]]},
        {"noise": ["ab" * 16], "volts": [[1]]},
        {"noise": ["ab" * 16], "volts": [[1, 2], [1, 2]]},
        {"noise": ["ab" * 16] * 9, "volts": [[1, 2]] * 9},
        {"noise": "ab" * 16, "volts": [1, 2]},
    ]
    for one in wrong:
        assert Fingerprint.from_dict(one) is None


def test_silence_is_like_nothing() -> None:
    silent = Fingerprint.from_samples(replace(FIRST, volts=np.zeros_like(FIRST.volts)))
    assert not silent.is_same(silent)
