"""Verdicts of checks: probes within tolerances pass; of others the deviation is named, of mistaken readings the cause."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from geometry import InputError
from geometry.common.arrays import Floats
from geometry.scenes.variables import list_values
from hw.common.samples import Samples
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import BLOCK_MODULI, predict_blocks
from probe_design.built_probe.gains import Gains
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from probe_design.probe_check.changed_designs import GAIN_NAME
from probe_design.probe_check.check import Check
from probe_design.probe_check.coverage import VariableCoverage, compute_coverage
from probe_design.probe_check.deviation import (
    DETECTED_TOLERANCES,
    MIN_POWER,
    SIGNIFICANCE_LEVEL,
    Deviation,
    compute_power,
    find_cancelling_pairs,
    list_undetected,
)
from probe_design.probe_check.verdicts import (
    VERDICT_OUT,
    VERDICT_UNKNOWN,
    VERDICT_UNTESTED,
    VERDICT_WITHIN,
    Verdict,
    decide_verdict,
)
from tests.support.hw.benches import BENCH, check, films, sampled, scene, shares

EXACT = BuiltProperties(gains=((1.0, 0.0), (0.0, 1.0)), resistance=(1.0, 1.0), capacitance=(1.0, 1.0))
NOISE = 1e-3  # of ln rho: a good reading's


def gains() -> Gains:
    """Perfectly known."""
    return replace(Gains.from_bench(BENCH), covariance=np.zeros((4, 4)))


@cache
def deviation(logs: tuple[float, ...] | None = None, noise: float = NOISE) -> Deviation:
    """Blocks as delivered, read with little noise; ``logs``: as read."""
    known = shares()
    allowed = zip(known.variables, known.derivatives.T, known.compute_tolerances(BENCH.workshop), strict=True)
    model = np.array([share.compute_variance(block) for share, block in zip(known.blocks, BENCH.blocks, strict=True)])
    read = np.array(known.log_ratios if logs is None else logs)
    workshop = {name: slope * tolerance for name, slope, tolerance in allowed}
    return Deviation(read, known.log_ratios, np.full(len(read), noise**2), np.zeros((len(read), 0)), model, {}, workshop)


def built(**factors: float) -> tuple[float, ...]:
    """What a probe off its drawing does; two underscores stand for a point."""
    new = {f"probe.{name.replace('__', '.')}": factor for name, factor in factors.items()}
    nominal = list_values(scene())
    return tuple(
        predict_blocks(scene().replace({name: nominal[name] * turn for name, turn in new.items()}), BENCH.reference).log_ratios
    )


def coverage_of(deviation_found: Deviation) -> tuple[VariableCoverage, ...]:
    return compute_coverage(
        deviation_found, dict(zip(shares().variables, shares().compute_tolerances(BENCH.workshop).tolist(), strict=True))
    )


def verdict(logs: tuple[float, ...]) -> Verdict:
    return decide_verdict(scene(), BENCH, deviation(logs), shares(), (), coverage=coverage_of(deviation(logs)))


def readings(logs: Floats) -> list[Samples]:
    forces = films(logs)[2:]
    return [sampled(build_signals(EXACT, BENCH, scene(), force, [31, k]), rows=850, rate=200.0) for k, force in enumerate(forces)]


def checked(samples: list[Samples], bench: Bench = BENCH) -> Check:
    return check(scene(), bench, samples, gains(), predictions=shares())


@pytest.mark.slow
def test_probes_within_tolerance_fail_as_often_as_stated() -> None:
    """2000 probes drawn within the workshop's tolerances, on blocks within theirs, linearly; 1 in 100 fails."""
    random, probe_deviation = np.random.default_rng(7), deviation()
    columns = np.array(list(probe_deviation.workshop.values()))
    errors = random.standard_normal((2000, len(columns))) @ columns
    noise = np.sqrt(probe_deviation.model + NOISE**2) * random.standard_normal((2000, len(probe_deviation.drawn)))
    failed = sum(
        replace(probe_deviation, logs=probe_deviation.drawn + error).p_value < SIGNIFICANCE_LEVEL for error in errors + noise
    )
    assert abs(failed - 20) < 4 * np.sqrt(20)
    strict = replace(probe_deviation, workshop={})  # what the workshop may do left out, nearly all would fail
    assert (
        sum(replace(strict, logs=probe_deviation.drawn + error).p_value < SIGNIFICANCE_LEVEL for error in errors + noise) > 1800
    )


def test_a_probe_within_tolerance_is_within() -> None:
    """Wall and modulus two tolerances off."""
    probe_deviation = deviation()
    result = checked(
        readings(
            probe_deviation.drawn
            + 2 * probe_deviation.workshop["probe.outer_radius"]
            - 2 * probe_deviation.workshop["probe.outer.youngs_modulus"]
        )
    )
    assert (result.verdict, result.reason, result.passed, result.failed) == (VERDICT_WITHIN, "", True, False)
    assert "probe.inner.poisson_ratio" in {variable.variable for variable in result.untested}
    assert "probe.inner_radius" in {variable.variable for variable in result.tested}
    assert result.cancelling[0].variables == ("probe.inner_radius", "probe.outer_radius")


def test_exchanged_channels_and_blocks_are_named() -> None:
    right = readings(shares().log_ratios)
    cables = checked([replace(reading, volts=reading.volts[:, [1, 0, 2]]) for reading in right])
    blocks = checked([right[k] for k in (0, 3, 2, 1, 4)])
    assert cables.verdict == blocks.verdict == VERDICT_UNKNOWN
    assert cables.reason.startswith("exchanged are: the films' channels (cables);")
    assert blocks.reason.startswith("exchanged are: the block of 6 kPa and the block of 24 kPa;")
    assert (cables.passed, cables.failed) == (False, True)


@pytest.mark.parametrize(("factors", "words"), [((1e-4, 1.0, 1.0), "inner"), ((1.0, 1e-4, 1.0), "outer")])
def test_a_dead_film_is_named(factors: tuple[float, float, float], words: str) -> None:
    dead = [replace(reading, volts=reading.volts * factors) for reading in readings(shares().log_ratios)]
    with pytest.raises(InputError, match=f"nothing on the {words} film"):
        checked(dead)


@pytest.mark.slow
def test_an_inner_block_far_too_soft_explains_itself() -> None:
    """A factor 0.3, of which linear theory sees nothing: it asks for a modulus below 0."""
    result = verdict(built(inner__youngs_modulus=0.3))
    assert result.verdict == VERDICT_OUT
    assert result.alike == ("probe.inner.youngs_modulus",)
    assert result.explanations[0].nominal + result.explanations[0].change == pytest.approx(0.3e6, rel=0.05)


@pytest.mark.slow
def test_two_causes_are_told_as_two() -> None:
    """A gap three times too wide and an outer modulus of 0.7: nothing alone does that."""
    result = verdict(built(gap=3.0, outer__youngs_modulus=0.7))
    assert result.verdict == VERDICT_OUT
    assert not any(explanation.explains for explanation in result.explanations)
    best = result.pairs[0]
    assert set(best.variables) == {"probe.gap", "probe.outer.youngs_modulus"}
    by_name = {explanation.variable: explanation for explanation in (best.first, best.second)}
    assert abs(by_name["probe.outer.youngs_modulus"].change + 24e3) < 3 * by_name["probe.outer.youngs_modulus"].uncertainty
    assert abs(by_name["probe.gap"].change - 0.2e-3) < 3 * by_name["probe.gap"].uncertainty
    assert "two together: " in result.reason


@pytest.mark.slow
def test_the_bench_s_own_faults_are_not_the_probe_s() -> None:
    """A film half plugged since the calibration shifts all blocks alike; one dried block stands alone."""
    half = verdict(tuple(shares().log_ratios + np.log(0.5)))
    assert (half.verdict, half.alike) == (VERDICT_UNKNOWN, (GAIN_NAME,))
    assert half.explanations[0].change == pytest.approx(-0.5, abs=0.02)
    assert "gain" in half.reason
    dried = verdict(tuple(np.add(shares().log_ratios, [0.0, 0.15, 0.0, 0.0, 0.0])))
    assert dried.verdict == VERDICT_UNKNOWN
    assert "without the reading on the block of 6 kPa the others agree" in dried.reason


def test_what_cancels_is_what_cannot_be_seen() -> None:
    """Along the named pair a chi-square stays below what is found half the time, far less than either variable's own."""
    probe_deviation = deviation()
    pair = find_cancelling_pairs(probe_deviation)[0]
    errors = probe_deviation.build_errors(*pair.variables)
    columns = [probe_deviation.workshop[name] * size for name, size in zip(pair.variables, pair.tolerances, strict=True)]
    total, *alone = (float(errors.compute_chi_square(column)) for column in (np.sum(columns, axis=0), *columns))
    assert total < 0.2 * min(alone)
    assert max(abs(size) for size in pair.tolerances) == DETECTED_TOLERANCES
    assert not set(pair.variables) <= set(list_undetected(probe_deviation))
    assert compute_power(probe_deviation, dict(zip(pair.variables, pair.tolerances, strict=True))) < 0.05
    assert BLOCK_MODULI not in list_undetected(probe_deviation)  # which has no tolerance of its own


def test_readings_too_poor_for_any_verdict_say_so() -> None:
    probe_deviation = deviation(noise=1.0)
    result = decide_verdict(scene(), BENCH, probe_deviation, shares(), (), coverage=coverage_of(probe_deviation))
    assert result.verdict == VERDICT_UNTESTED
    assert "do not confirm the probe" in result.reason
    assert all(
        "not observable at this noise" in coverage.reason or "hide it together" in coverage.reason
        for coverage in coverage_of(probe_deviation)[:4]
    )


def test_what_is_tested_is_what_would_be_found() -> None:
    """By simulation of the check's own chi-square, 2000 probes each: off by ``found_from``, every second one fails."""
    random, probe_deviation = np.random.default_rng(5), deviation()
    for covered in coverage_of(probe_deviation):
        assert (
            covered.tested
            == (covered.found_from is not None and covered.found_from <= DETECTED_TOLERANCES * covered.tolerance)
            == (covered.power >= MIN_POWER)
        )
        if covered.found_from is None:
            continue
        other_columns = np.array([column for name, column in probe_deviation.workshop.items() if name != covered.variable])
        errors = (
            random.standard_normal((2000, len(other_columns))) @ other_columns
            + covered.found_from / covered.tolerance * probe_deviation.workshop[covered.variable]
        )
        errors += np.sqrt(probe_deviation.model + NOISE**2) * random.standard_normal((2000, len(probe_deviation.drawn)))
        share = np.mean(
            chi2.sf(probe_deviation.build_errors().compute_chi_square(errors), len(probe_deviation.drawn)) < SIGNIFICANCE_LEVEL
        )
        assert share == pytest.approx(MIN_POWER, abs=0.05)


def test_the_reason_is_what_would_have_to_be_better() -> None:
    """Without the named source of doubt the variable would be found; a variable that moves nothing says so."""
    probe_deviation = deviation(noise=2e-2)
    surer = {
        "not observable at this noise": deviation(noise=1e-9),
        "the blocks' moduli": replace(probe_deviation, model=1e-12 * probe_deviation.model),
    }
    said = {coverage.variable: coverage.reason for coverage in coverage_of(probe_deviation) if not coverage.tested}
    assert any(reason.startswith("not observable at this noise") for reason in said.values())
    for name, reason in said.items():
        for start, better in surer.items():
            if reason.startswith(start):
                assert compute_power(better, {name: DETECTED_TOLERANCES}) >= MIN_POWER
    still = replace(probe_deviation, workshop={**probe_deviation.workshop, "probe.gap": np.zeros(len(probe_deviation.drawn))})
    (gap,) = (coverage for coverage in coverage_of(still) if coverage.variable == "probe.gap")
    assert (gap.power, gap.found_from, gap.reason) == (0.0, None, "it hardly changes these ratios")


def test_gains_drift_with_temperature() -> None:
    """2 K: 1 % of each film's gain, with which its cross-talk entry goes; forces of 1 % more on either."""
    warm = Gains.from_bench(BENCH)
    cold = replace(warm, covariance=np.zeros((4, 4)), matrix=np.array([[1.02, 0.01], [0.02, 0.97]]))
    warm = cold.add_warming(2.0)
    assert np.sqrt(warm.covariance[0, 0]) == pytest.approx(0.01 * 1.02)
    assert warm.covariance[0, 1] == pytest.approx(1e-4 * 1.02 * 0.01)
    assert warm.covariance[0, 3] == 0.0
    force = np.array([0.04, 0.06])
    spread = warm.compute_forces_covariance(cold.matrix @ force, np.zeros((2, 2)))
    drifted = [np.linalg.solve(cold.matrix, np.diag(turn) @ cold.matrix @ force) - force for turn in ([1.01, 1.0], [1.0, 1.01])]
    assert spread == pytest.approx(np.array(drifted).T @ np.array(drifted), rel=1e-6)


@pytest.mark.parametrize("turns", [{"probe.outer.youngs_modulus": 5.0}, {"probe.gap": 9.0, "probe.height": 5.0}])
def test_power_is_how_often_the_check_s_own_chi_square_finds_it(turns: dict[str, float]) -> None:
    """4000 probes off by so many tolerances, linearly. The check allows a variable its tolerance: that hides part of it."""
    random, probe_deviation = np.random.default_rng(11), deviation(noise=5e-3)
    other_columns = np.array([column for name, column in probe_deviation.workshop.items() if name not in turns])
    errors = random.standard_normal((4000, len(other_columns))) @ other_columns + sum(
        turn * probe_deviation.workshop[name] for name, turn in turns.items()
    )
    errors += np.sqrt(probe_deviation.model + 5e-3**2) * random.standard_normal((4000, len(probe_deviation.drawn)))
    share = np.mean(
        chi2.sf(probe_deviation.build_errors().compute_chi_square(errors), len(probe_deviation.drawn)) < SIGNIFICANCE_LEVEL
    )
    assert 0.1 < share < 0.9
    assert compute_power(probe_deviation, turns) == pytest.approx(share, abs=0.03)
