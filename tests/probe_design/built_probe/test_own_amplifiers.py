"""Amplifiers that differ from film to film: charges worked out by hand, and a reading that comes out the same."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.common.errors import InputError
from hw.signal.measure import measure
from hw.signal.running import RunningFit
from hw.signal.waveform import Flawed
from probe_design.built_probe.bench import bench_from_dict
from probe_design.built_probe.film_forces import reading, running_reading, warming
from probe_design.built_probe.virtual_probe import Built, charge_per_force, signals
from tests.support.hw.benches import BENCH, sampled, scene

OWN = {"resistance": "1 Gohm", "capacitance": "1 nF", "inner": {"capacitance": "2 nF"}, "outer": {"resistance": "100 Mohm"}}
EXACT = Built(gains=((1.0, 0.0), (0.0, 1.0)), resistance=(1.0, 1.0), capacitance=(1.0, 1.0), force=1.0, frequency=1.0)
FORCES = np.array([0.03, 0.07])


def test_charges_behind_each_film_s_own_amplifier() -> None:
    own = bench_from_dict({"amplifier": OWN, "force": {"sensitivity": "0.1 V/N"}, "reference": [{"on": "inner"}]})
    samples = sampled(signals(EXACT, own, scene(), FORCES, 1))
    found, common = reading(samples, own), measure(samples, BENCH.amplifier.built(), BENCH.load.frequency, 0.1)
    with pytest.raises(Flawed, match="amplifiers that are not the bench's"):
        reading(samples, BENCH)
    np.testing.assert_allclose(found.in_phase / abs(charge_per_force(scene())), FORCES, rtol=2e-3)
    # V = -Q / Cf * jwt / (1 + jwt): twice the capacitance is twice the charge; a tenth of the resistance ten times the corner
    turn = 2j * np.pi * found.fit.frequency
    charge_per_volt = [c * (1 + turn * tau) / (turn * tau) for c, tau in ((2e-9, 2.0), (1e-9, 0.1))]
    by_hand = np.array(charge_per_volt) / (1e-9 * (1 + turn) / turn)
    np.testing.assert_allclose(found.charges / common.charges, by_hand, rtol=1e-9)
    spread = np.sqrt(np.diag(found.covariance) / np.diag(common.covariance))
    np.testing.assert_allclose(spread[::2], np.abs(by_hand), rtol=0.05)
    running = RunningFit(own.load.frequency, force=True)
    running.add(samples)
    np.testing.assert_allclose(running_reading(running, own).charges, found.charges, rtol=1e-9)
    assert found.tolerance[2, 2] > common.tolerance[2, 2]  # nearer to its corner
    assert warming(found, own, scene().probe)[1] > warming(common, BENCH, scene().probe)[1]


def test_alike_is_as_it_was() -> None:
    samples = sampled(signals(EXACT, BENCH, scene(), FORCES, 1))
    assert "inner" not in BENCH.model_dump(mode="json", exclude_none=True)["amplifier"]
    alike = OWN | {"inner": {}, "outer": {}}
    again = bench_from_dict({"amplifier": alike, "force": {"sensitivity": "0.1 V/N"}, "reference": [{"on": "inner"}]})
    np.testing.assert_array_equal(reading(samples, again).charges, reading(samples, BENCH).charges)


def test_bad_parts_are_refused() -> None:
    with pytest.raises(InputError, match=r"amplifier\.inner\.capacitance"):
        bench_from_dict({"amplifier": {"inner": {"capacitance": "2"}}, "reference": [{"on": "inner"}]})
