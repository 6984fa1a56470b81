"""The channels' test: each fault that is put in is named, and a sound probe has none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from geometry.common.arrays import Floats
from hw.common.samples import Gap, Samples
from hw.signal.sine_fit import fit_stretch
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from probe_design.doctor.self_test import run_self_test
from tests.support.hw.benches import BENCH, sampled, scene

FORCES = np.array([0.03, 0.07])  # N


AS_DRAWN = BuiltProperties()


def volts(built: BuiltProperties = AS_DRAWN, forces: Floats = FORCES, rate: float = 1000.0, seconds: float = 5.0) -> Samples:
    made = sampled(build_signals(built, BENCH, scene(), forces, 1), round(seconds * rate), rate)
    return replace(made, volts=np.rint(made.volts / 2e-6) * 2e-6)


def states(samples: Samples) -> dict[str, str]:
    return {finding.name: finding.state for finding in run_self_test(samples, scene(), BENCH)}


def changed(change: Callable[[Floats], Floats]) -> Samples:
    good = volts()
    return replace(good, volts=change(good.volts))


def test_a_sound_probe_has_no_fault() -> None:
    assert set(states(volts()).values()) == {"good"}


def test_the_fit_finds_what_was_put_in() -> None:
    """Amplitudes written down here: 3 and 1 mV at 5.3 Hz, 0.2 mV of hum at 59.9 Hz, noise of 20 uV."""
    times = np.arange(8000) / 1000.0
    random = np.random.default_rng(2)
    load = np.cos(2 * np.pi * 5.3 * times + 0.4)
    hum = 2e-4 * np.sin(2 * np.pi * 59.9 * times)
    made = replace(
        volts(seconds=8.0), channels=("inner", "outer"), volts=np.column_stack([3e-3 * load + hum, -1e-3 * load + hum])
    )
    made = replace(made, saturated=np.zeros((8000, 2), bool), volts=made.volts + 2e-5 * random.standard_normal((8000, 2)) + 0.5)
    fit = fit_stretch(made, 5.0)
    assert fit.frequency == pytest.approx(5.3, abs=1e-3)
    assert fit.mains == pytest.approx(59.9, abs=5e-3)
    np.testing.assert_allclose(np.abs(fit.amplitudes), [3e-3, 1e-3], rtol=2e-3)
    np.testing.assert_allclose(fit.hum, 2e-4, rtol=0.02)
    np.testing.assert_allclose(fit.noise, 2e-5, rtol=0.03)
    assert np.angle(-fit.amplitudes[1] / fit.amplitudes[0]) == pytest.approx(0, abs=5e-3)


FAULTS: dict[str, tuple[Callable[[], Samples], str, str]] = {
    "leads of one film exchanged": (lambda: changed(lambda v: v * [1, -1, 1]), "polarity, outer", "fault"),
    "no force channel, leads exchanged": (
        lambda: replace(changed(lambda v: v[:, :2] * [1, -1]), channels=("inner", "outer"), saturated=np.zeros((5000, 2), bool)),
        "polarity, inner", "fault",
    ),
    "clipped": (lambda: changed(lambda v: np.minimum(v, 0.6 * v.max(axis=0))), "clipping, inner", "fault"),
    "clipped below": (lambda: changed(lambda v: np.maximum(v, [-9, 0.8 * v[:, 1].min(), -9])), "clipping, outer", "fault"),
    "no load": (lambda: volts(forces=np.zeros(2)), "load, inner", "fault"),
    "film torn off": (lambda: volts(BuiltProperties(gains=((1, 0), (0, 1))), FORCES * [1, 0]), "load, outer", "fault"),
    "dead channel": (lambda: changed(lambda v: v * [1, 0, 1]), "outer channel", "fault"),
    "noisy": (lambda: volts(BuiltProperties(noise=1e-4)), "noise, inner", "doubtful"),
    "hum": (lambda: volts(BuiltProperties(hum=0.05)), "mains", "doubtful"),
    "mains on the load": (lambda: volts(rate=45.0, seconds=30.0), "mains", "fault"),
    "overtones of the mains on the load": (lambda: volts(rate=155.0, seconds=30.0), "mains", "fault"),
    "too short": (lambda: volts(seconds=0.3), "load", "fault"),
    "another clock": (lambda: replace(volts(), source={"clock": "time stamps tell 900"}), "samples", "doubtful"),
    "lost samples": (lambda: replace(volts(), gaps=(Gap(3, 1, "lost"),)), "samples", "doubtful"),
}  # fmt: skip


@pytest.mark.parametrize("what", FAULTS)
def test_faults_are_named(what: str) -> None:
    make, name, state = FAULTS[what]
    assert states(make())[name] == state


def test_saturation_that_the_device_flags_is_clipping() -> None:
    good = volts()
    flagged = good.saturated.copy()
    flagged[10:13, 1] = True
    assert states(replace(good, saturated=flagged))["clipping, outer"] == "fault"


def test_averaged_samples_are_too_quiet() -> None:
    smooth = np.ones(200) / 200
    quiet = changed(lambda v: np.column_stack([np.convolve(column, smooth, "same") for column in 0.01 * v.T]))
    assert states(quiet)["noise, inner"] == "fault"
