"""Amplifiers that differ from film to film: charges worked out by hand, and a reading that comes out the same."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.common.errors import InputError
from hw.signal.reading_fit import ReadingFit
from hw.signal.waveform import Flawed
from probe_design.built_probe.bench import bench_from_dict
from probe_design.built_probe.film_forces import bound_warming, measure_reading, measure_samples
from probe_design.built_probe.reference_charges import compute_charge_units
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from tests.support.hw.benches import BENCH, sampled, scene
from tests.support.hw.fits import measure_samples as measure_fit

OWN = {"resistance": "1 Gohm", "capacitance": "1 nF", "inner": {"capacitance": "2 nF"}, "outer": {"resistance": "100 Mohm"}}
EXACT = BuiltProperties(gains=((1.0, 0.0), (0.0, 1.0)), resistance=(1.0, 1.0), capacitance=(1.0, 1.0), force=1.0, frequency=1.0)
FORCES = np.array([0.03, 0.07])


def test_charges_behind_each_film_s_own_amplifier() -> None:
    own_bench = bench_from_dict({"amplifier": OWN, "force": {"sensitivity": "0.1 V/N"}, "reference": [{"on": "inner"}]})
    samples = sampled(build_signals(EXACT, own_bench, scene(), FORCES, 1))
    measurement, common = (
        measure_samples(samples, own_bench),
        measure_fit(samples, BENCH.load.frequency, 0.1),
    )
    with pytest.raises(Flawed, match="amplifiers that are not the bench's"):
        measure_samples(samples, BENCH)
    np.testing.assert_allclose(measurement.in_phase / abs(compute_charge_units(scene())), FORCES, rtol=2e-3)
    # V = -Q / Cf * jwt / (1 + jwt): twice the capacitance is twice the charge; a tenth of the resistance ten times the corner
    turn = 2j * np.pi * measurement.fit.frequency
    charge_per_volt = [c * (1 + turn * tau) / (turn * tau) for c, tau in ((2e-9, 2.0), (1e-9, 0.1))]
    by_hand = np.array(charge_per_volt) / (1e-9 * (1 + turn) / turn)
    np.testing.assert_allclose(measurement.charges / common.charges, by_hand, rtol=1e-9)
    spread = np.sqrt(np.diag(measurement.covariance)[::2] / np.diag(measurement.fit.covariance)[:4:2])
    np.testing.assert_allclose(spread, np.abs(charge_per_volt), rtol=0.05)
    running = ReadingFit(own_bench.load.frequency, force=True)
    running.add(samples)
    np.testing.assert_allclose(measure_reading(running, own_bench).charges, measurement.charges, rtol=1e-9)
    assert measurement.tolerance[2, 2] > common.tolerance[2, 2]  # nearer to its corner
    assert bound_warming(measurement, own_bench, scene().probe)[1] > bound_warming(common, BENCH, scene().probe)[1]


def test_alike_is_as_it_was() -> None:
    samples = sampled(build_signals(EXACT, BENCH, scene(), FORCES, 1))
    assert "inner" not in BENCH.model_dump(mode="json", exclude_none=True)["amplifier"]
    alike_table = OWN | {"inner": {}, "outer": {}}
    alike_bench = bench_from_dict({"amplifier": alike_table, "force": {"sensitivity": "0.1 V/N"}, "reference": [{"on": "inner"}]})
    np.testing.assert_array_equal(measure_samples(samples, alike_bench).charges, measure_samples(samples, BENCH).charges)


def test_bad_parts_are_refused() -> None:
    with pytest.raises(InputError, match=r"amplifier\.inner\.capacitance"):
        bench_from_dict({"amplifier": {"inner": {"capacitance": "2"}}, "reference": [{"on": "inner"}]})
