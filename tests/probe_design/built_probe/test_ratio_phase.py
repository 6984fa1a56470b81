"""The phase of a reading's ratio: against the angle that was put in, and error budgets done by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from geometry.common.arrays import Floats
from hw.signal.measurement import Measurement
from probe_design.built_probe.bench import Bench, Sampling
from probe_design.built_probe.film_forces import measure_samples
from probe_design.built_probe.gains import Gains
from probe_design.built_probe.ratio_phase import add_ratio_phase, compare_ratio_phase, compute_ratio_phase
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from solver.results.result import Result
from tests.support.hw.benches import BENCH, LOAD, sampled, scene

EXACT = BuiltProperties(resistance=(1.0, 1.0), capacitance=(1.0, 1.0), noise=2e-7)
KNOWN = Gains(np.array(EXACT.gains), np.zeros((4, 4)), np.zeros((4, 0)), np.zeros(0), True, (True, True))
TURN = 2 * math.pi * BENCH.load.frequency * EXACT.frequency
PUT_IN = 0.03
FORCES = LOAD * np.array([0.4 * np.exp(1j * PUT_IN), 0.6])


def measured(forces: Floats = FORCES, built: BuiltProperties = EXACT, calibrated_at: float | None = None) -> Measurement:
    return measure_samples(sampled(build_signals(built, BENCH, scene(), forces, 1)), BENCH, calibrated_at)


def of_parts(share: float) -> Bench:
    amplifier = BENCH.amplifier.model_copy(update={"resistance_tolerance": share, "capacitance_tolerance": share})
    return BENCH.model_copy(update={"amplifier": amplifier, "sampling": Sampling(skew_tolerance=0.0)})


def test_the_angle_put_in_is_read_through_cross_talk() -> None:
    value, spread = compute_ratio_phase(measured(), BENCH, KNOWN)
    assert value == pytest.approx(PUT_IN, abs=3e-4)
    assert abs(value - PUT_IN) < spread


def test_a_calibration_takes_no_time_constants_out() -> None:
    """Gains are real: at the frequency that they were calibrated at, channels still differ by their time constants."""
    slow = replace(EXACT, resistance=(1.05, 0.95), capacitance=(1.02, 0.98))
    value, spread = compute_ratio_phase(measured(built=slow, calibrated_at=BENCH.load.frequency), BENCH, KNOWN)
    tau = BENCH.amplifier.resistance * BENCH.amplifier.capacitance
    inner, outer = (math.atan(1 / (TURN * tau * r * c)) for r, c in zip(slow.resistance, slow.capacitance, strict=True))
    assert value - PUT_IN == pytest.approx(inner - outer, abs=3e-4)
    assert abs(value - PUT_IN) < 4 * spread
    assert spread > 1e-3


@pytest.mark.parametrize("share", [0.01, 0.02])
def test_the_budget_of_time_constants_by_hand(share: float) -> None:
    """Four parts, each of which moves arg H by its share times w tau / (1 + (w tau)^2)."""
    measurement = measured()
    turns = 2 * math.pi * measurement.fit.frequency * BENCH.amplifier.resistance * BENCH.amplifier.capacitance
    straight = replace(KNOWN, matrix=np.eye(2))
    without_parts, all_parts = (
        compute_ratio_phase(measurement, of_parts(part_share), straight)[1] for part_share in (0.0, share)
    )
    assert math.sqrt(all_parts**2 - without_parts**2) == pytest.approx(2 * share * turns / (1 + turns**2), rel=1e-3)


def test_skew_is_corrected_and_its_tolerance_counted() -> None:
    late, measurement = 200e-6, measured()
    plain = compute_ratio_phase(measurement, BENCH, KNOWN)
    bench = BENCH.model_copy(update={"sampling": Sampling(skew=late, skew_tolerance=late)})
    value, spread = compute_ratio_phase(measurement, bench, KNOWN)
    turn = 2 * math.pi * measurement.fit.frequency * late
    assert value - plain[0] == pytest.approx(turn, rel=1e-9)
    assert math.sqrt(spread**2 - plain[1] ** 2) == pytest.approx(turn, rel=1e-3)


def test_uncertain_gains_turn_little() -> None:
    loose = replace(KNOWN, covariance=1e-4 * np.eye(4))
    measurement = measured()
    tight, spread = (compute_ratio_phase(measurement, of_parts(0.0), gains)[1] for gains in (KNOWN, loose))
    assert 0 < math.sqrt(spread**2 - tight**2) < 0.02 * PUT_IN


def test_a_negative_ratio_is_counted_from_its_own_sign() -> None:
    forces = LOAD * np.array([-0.4 * np.exp(1j * PUT_IN), 1.4])
    assert compute_ratio_phase(measured(forces), BENCH, KNOWN)[0] == pytest.approx(PUT_IN, abs=1e-3)


def test_what_the_scene_does_not_explain_is_warned_of() -> None:
    prediction = Result("none", 0.0, ratio_phase=0.01, ratio_phase_error=0.001)
    z, warnings = compare_ratio_phase(PUT_IN, 0.002, prediction)
    assert z == pytest.approx(0.02 / math.hypot(0.002, 0.001 / math.sqrt(3)))
    assert len(warnings) == 1
    assert compare_ratio_phase(0.012, 0.002, prediction)[1] == []
    assert compare_ratio_phase(PUT_IN, 0.002, Result("none", 0.0)) == (None, [])


def test_nothing_is_solved_for_where_nothing_is_lossy_and_nothing_refused() -> None:
    plain = Result("none", 0.0, ratio=0.6, error_estimate=1e-3)
    assert add_ratio_phase(plain, scene(), 0.01, 5.0).ratio_phase == 0
    fast = add_ratio_phase(plain, scene().replace({"tissue.loss_factor": 0.2}), 0.01, 9e3)
    assert fast.ratio_phase is None
    assert any("inertia" in text for text in fast.warnings)
