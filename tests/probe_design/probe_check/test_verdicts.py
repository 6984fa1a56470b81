"""Verdicts of checks: probes within the workshop's tolerances pass, others are told by what; careless readings by their cause."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from geometry import InputError
from geometry.common.arrays import Floats
from geometry.scenes.variables import changed, values
from hw.common.samples import Samples
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import MODULI, predicted
from probe_design.built_probe.gain_matrix import Gains
from probe_design.built_probe.virtual_probe import Built, signals
from probe_design.probe_check.changed_designs import GAIN
from probe_design.probe_check.check import Check, check
from probe_design.probe_check.coverage import VariableCoverage, coverage
from probe_design.probe_check.deviation import FAR, LEVEL, POWER, Deviation, cancelling, power, unseen
from probe_design.probe_check.verdicts import OUT, UNKNOWN, UNTESTED, WITHIN, Verdict, judged
from tests.support.hw.benches import BENCH, films, sampled, scene, shares

EXACT = Built(gains=((1.0, 0.0), (0.0, 1.0)), resistance=(1.0, 1.0), capacitance=(1.0, 1.0))
NOISE = 1e-3  # of ln rho: a good reading's


def gains() -> Gains:
    """Perfectly known."""
    return replace(Gains.nominal(BENCH), covariance=np.zeros((4, 4)))


@cache
def deviation(logs: tuple[float, ...] | None = None, noise: float = NOISE) -> Deviation:
    """Blocks as delivered, read with little noise; ``logs``: as read."""
    known = shares()
    allowed = zip(known.variables, known.slopes.T, known.tolerances(BENCH.workshop), strict=True)
    model = np.array([share.variance(block) for share, block in zip(known.blocks, BENCH.blocks, strict=True)])
    read = np.array(known.log_ratios if logs is None else logs)
    workshop = {name: slope * tolerance for name, slope, tolerance in allowed}
    return Deviation(read, known.log_ratios, noise**2 * np.eye(len(read)), model, {}, workshop)


def built(**factors: float) -> tuple[float, ...]:
    """What a probe off its drawing does; two underscores stand for a point."""
    new = {f"probe.{name.replace('__', '.')}": factor for name, factor in factors.items()}
    at = values(scene())
    return tuple(predicted(changed(scene(), {name: at[name] * turn for name, turn in new.items()}), BENCH.reference).log_ratios)


def coverage_of(at: Deviation) -> tuple[VariableCoverage, ...]:
    return coverage(at, dict(zip(shares().variables, shares().tolerances(BENCH.workshop).tolist(), strict=True)))


def verdict(logs: tuple[float, ...]) -> Verdict:
    return judged(scene(), BENCH, deviation(logs), shares(), (), tested=coverage_of(deviation(logs)))


def readings(logs: Floats) -> list[Samples]:
    forces = films(logs)[2:]
    return [sampled(signals(EXACT, BENCH, scene(), one, [31, k]), rows=850, rate=200.0) for k, one in enumerate(forces)]


def checked(samples: list[Samples], bench: Bench = BENCH) -> Check:
    return check(scene(), bench, samples, gains(), shares=shares())


def test_probes_within_tolerance_fail_as_often_as_stated() -> None:
    """2000 probes drawn within the workshop's tolerances, on blocks within theirs, linearly; 1 in 100 fails."""
    random, at = np.random.default_rng(7), deviation()
    columns = np.array(list(at.workshop.values()))
    off = random.standard_normal((2000, len(columns))) @ columns
    own = np.sqrt(at.model + NOISE**2) * random.standard_normal((2000, len(at.drawn)))
    failed = sum(replace(at, logs=at.drawn + one).p_value < LEVEL for one in off + own)
    assert abs(failed - 20) < 4 * np.sqrt(20)
    strict = replace(at, workshop={})  # what the workshop may do left out, nearly all would fail
    assert sum(replace(strict, logs=at.drawn + one).p_value < LEVEL for one in off + own) > 1800


def test_a_probe_within_tolerance_is_within() -> None:
    """Wall and modulus two tolerances off."""
    at = deviation()
    found = checked(readings(at.drawn + 2 * at.workshop["probe.outer_radius"] - 2 * at.workshop["probe.outer.youngs_modulus"]))
    assert (found.verdict, found.reason, found.passed, found.failed) == (WITHIN, "", True, False)
    assert "probe.inner.poisson_ratio" in {one.variable for one in found.untested}
    assert "probe.inner_radius" in {one.variable for one in found.tested}
    assert found.cancelling[0].variables == ("probe.inner_radius", "probe.outer_radius")


def test_exchanged_channels_and_blocks_are_named() -> None:
    right = readings(shares().log_ratios)
    cables = checked([replace(one, volts=one.volts[:, [1, 0, 2]]) for one in right])
    blocks = checked([right[k] for k in (0, 3, 2, 1, 4)])
    assert cables.verdict == blocks.verdict == UNKNOWN
    assert cables.reason.startswith("exchanged are: the films' channels (cables);")
    assert blocks.reason.startswith("exchanged are: the block of 6 kPa and the block of 24 kPa;")
    assert (cables.passed, cables.failed) == (False, True)


@pytest.mark.parametrize(("factors", "words"), [((1e-4, 1.0, 1.0), "inner"), ((1.0, 1e-4, 1.0), "outer")])
def test_a_dead_film_is_named(factors: tuple[float, float, float], words: str) -> None:
    dead = [replace(one, volts=one.volts * factors) for one in readings(shares().log_ratios)]
    with pytest.raises(InputError, match=f"nothing on the {words} film"):
        checked(dead)


@pytest.mark.slow
def test_an_inner_block_far_too_soft_explains_itself() -> None:
    """A factor 0.3, of which linear theory sees nothing: it asks for a modulus below 0."""
    found = verdict(built(inner__youngs_modulus=0.3))
    assert found.verdict == OUT
    assert found.alike == ("probe.inner.youngs_modulus",)
    assert found.explanations[0].nominal + found.explanations[0].change == pytest.approx(0.3e6, rel=0.05)


@pytest.mark.slow
def test_two_causes_are_told_as_two() -> None:
    """A gap three times too wide and an outer modulus of 0.7: nothing alone does that."""
    found = verdict(built(gap=3.0, outer__youngs_modulus=0.7))
    assert found.verdict == OUT
    assert not any(one.explains for one in found.explanations)
    best = found.pairs[0]
    assert set(best.variables) == {"probe.gap", "probe.outer.youngs_modulus"}
    by_name = {one.variable: one for one in (best.first, best.second)}
    assert abs(by_name["probe.outer.youngs_modulus"].change + 24e3) < 3 * by_name["probe.outer.youngs_modulus"].uncertainty
    assert abs(by_name["probe.gap"].change - 0.2e-3) < 3 * by_name["probe.gap"].uncertainty
    assert "two together: " in found.reason


@pytest.mark.slow
def test_the_bench_s_own_faults_are_not_the_probe_s() -> None:
    """A film half plugged since the calibration shifts all blocks alike; one dried block stands alone."""
    half = verdict(tuple(shares().log_ratios + np.log(0.5)))
    assert (half.verdict, half.alike) == (UNKNOWN, (GAIN,))
    assert half.explanations[0].change == pytest.approx(-0.5, abs=0.02)
    assert "gain" in half.reason
    dried = verdict(tuple(np.add(shares().log_ratios, [0.0, 0.15, 0.0, 0.0, 0.0])))
    assert dried.verdict == UNKNOWN
    assert "without the reading on the block of 6 kPa the others agree" in dried.reason


def test_what_cancels_is_what_cannot_be_seen() -> None:
    """Along the named pair a chi-square stays below what is found half the time, far less than either variable's own."""
    at = deviation()
    pair = cancelling(at)[0]
    weight = at.weight(*pair.variables)
    columns = [at.workshop[name] * size for name, size in zip(pair.variables, pair.tolerances, strict=True)]
    both, *alone = (float(one @ weight @ one) for one in (sum(columns), *columns))
    assert both < 0.2 * min(alone)
    assert max(abs(size) for size in pair.tolerances) == FAR
    assert not set(pair.variables) <= set(unseen(at))
    assert power(at, dict(zip(pair.variables, pair.tolerances, strict=True))) < 0.05
    assert MODULI not in unseen(at)  # which has no tolerance of its own


def test_readings_too_poor_for_any_verdict_say_so() -> None:
    at = deviation(noise=1.0)
    found = judged(scene(), BENCH, at, shares(), (), tested=coverage_of(at))
    assert found.verdict == UNTESTED
    assert "do not confirm the probe" in found.reason
    assert all("not observable at this noise" in one.reason or "hide it together" in one.reason for one in coverage_of(at)[:4])


def test_what_is_tested_is_what_would_be_found() -> None:
    """By simulation of the check's own chi-square, 2000 probes each: off by ``found_from``, every second one fails."""
    random, at = np.random.default_rng(5), deviation()
    for one in coverage_of(at):
        assert one.tested == (one.found_from is not None and one.found_from <= FAR * one.tolerance) == (one.power >= POWER)
        if one.found_from is None:
            continue
        others = np.array([column for name, column in at.workshop.items() if name != one.variable])
        off = random.standard_normal((2000, len(others))) @ others + one.found_from / one.tolerance * at.workshop[one.variable]
        off += np.sqrt(at.model + NOISE**2) * random.standard_normal((2000, len(at.drawn)))
        found = np.mean(chi2.sf(np.einsum("ni,ij,nj->n", off, at.weight(), off), len(at.drawn)) < LEVEL)
        assert found == pytest.approx(POWER, abs=0.05)


def test_the_reason_is_what_would_have_to_be_better() -> None:
    """Without the named source of doubt the variable would be found; a variable that moves nothing says so."""
    at = deviation(noise=2e-2)
    surer = {
        "not observable at this noise": deviation(noise=1e-9),
        "the blocks' moduli": replace(at, model=1e-12 * at.model),
    }
    said = {one.variable: one.reason for one in coverage_of(at) if not one.tested}
    assert any(reason.startswith("not observable at this noise") for reason in said.values())
    for name, reason in said.items():
        for start, better in surer.items():
            if reason.startswith(start):
                assert power(better, {name: FAR}) >= POWER
    still = replace(at, workshop={**at.workshop, "probe.gap": np.zeros(len(at.drawn))})
    (gap,) = (one for one in coverage_of(still) if one.variable == "probe.gap")
    assert (gap.power, gap.found_from, gap.reason) == (0.0, None, "it hardly changes these ratios")


def test_gains_drift_with_temperature() -> None:
    """2 K: 1 % of each film's gain, with which its cross-talk entry goes; forces of 1 % more on either."""
    warm = Gains.nominal(BENCH)
    cold = replace(warm, covariance=np.zeros((4, 4)), matrix=np.array([[1.02, 0.01], [0.02, 0.97]]))
    warm = cold.warmed(2.0)
    assert np.sqrt(warm.covariance[0, 0]) == pytest.approx(0.01 * 1.02)
    assert warm.covariance[0, 1] == pytest.approx(1e-4 * 1.02 * 0.01)
    assert warm.covariance[0, 3] == 0.0
    force = np.array([0.04, 0.06])
    spread = warm.forces_covariance(cold.matrix @ force, np.zeros((2, 2)))
    drifted = [np.linalg.solve(cold.matrix, np.diag(turn) @ cold.matrix @ force) - force for turn in ([1.01, 1.0], [1.0, 1.01])]
    assert spread == pytest.approx(np.array(drifted).T @ np.array(drifted), rel=1e-6)


@pytest.mark.parametrize("turns", [{"probe.outer.youngs_modulus": 5.0}, {"probe.gap": 9.0, "probe.height": 5.0}])
def test_power_is_how_often_the_check_s_own_chi_square_finds_it(turns: dict[str, float]) -> None:
    """4000 probes off by so many tolerances, linearly. The check allows a variable its tolerance: that hides part of it."""
    random, at = np.random.default_rng(11), deviation(noise=5e-3)
    others = np.array([column for name, column in at.workshop.items() if name not in turns])
    off = random.standard_normal((4000, len(others))) @ others + sum(turn * at.workshop[name] for name, turn in turns.items())
    off += np.sqrt(at.model + 5e-3**2) * random.standard_normal((4000, len(at.drawn)))
    found = np.mean(chi2.sf(np.einsum("ni,ij,nj->n", off, at.weight(), off), len(at.drawn)) < LEVEL)
    assert 0.1 < found < 0.9
    assert power(at, turns) == pytest.approx(found, abs=0.03)
