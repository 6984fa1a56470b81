"""The check: right probes pass as often as they should, wrong ones are found with the right variable and size."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from geometry import InputError
from geometry.common.arrays import Floats
from geometry.scenes.variables import list_values
from hw.common.samples import Samples
from probe_design.built_probe.bench import Reference, Workshop
from probe_design.built_probe.block_predictions import predict_blocks
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals, draw_delivered
from probe_design.probe_check.check import Check
from probe_design.probe_check.deviation import Deviation
from probe_design.probe_check.explanations import Explanation, build_explanation, compute_explanations, fit_variables
from probe_design.probe_check.verdicts import VERDICT_OUT, VERDICT_UNTESTED
from tests.support.hw.benches import BENCH, calibrate, check, films, sampled, scene, shares

BUILT = BuiltProperties()
DRAWN = {"workshop": Workshop(length=1e-9, modulus=0.0, poisson_ratio=0.0)}  # a probe as drawn, whatever the workshop says
STRICT = BENCH.model_copy(update={**DRAWN, "channels": BENCH.channels.model_copy(update={"warming": 1e-6})})
DRY = tuple(
    reference if reference.on == "tissue" else reference.model_copy(update={"leak": 0.0}) for reference in BENCH.reference
)
TIGHT = BENCH.model_copy(update={"reference": DRY})  # pin and ring leak nothing, as virtual ones do, and are taken as such
BLOCKS = BENCH.model_copy(update={"reference": BENCH.blocks})


def loop(logs: Floats, seed: int) -> Check:
    """Calibrate and check one virtual probe whose blocks give ``logs``."""
    forces = films(logs)
    read = [sampled(build_signals(BUILT, BENCH, scene(), force, [seed, k])) for k, force in enumerate(forces)]
    repeated = [sampled(build_signals(BUILT, BENCH, scene(), force, [seed, 10 + k])) for k, force in enumerate(forces[2:])]
    calibration = calibrate(scene(), TIGHT, read, shares())
    return check(scene(), STRICT, repeated, calibration.gains, variables=calibration.variables, predictions=shares())


def delivered(seed: int) -> tuple[Reference, ...]:
    random = np.random.default_rng(seed)
    return tuple(draw_delivered(reference, random) for reference in BENCH.reference)


@cache
def built(name: str, turn: float) -> Check:
    """The loop with a probe that is off its drawing in one variable, on blocks that deviate by their tolerances."""
    true = scene().replace({name: list_values(scene())[name] * turn})
    return loop(predict_blocks(true, delivered(3)).log_ratios, 3)


def test_a_probe_as_drawn_passes() -> None:
    checked_probe = loop(predict_blocks(scene(), delivered(4)).log_ratios, 4)
    assert checked_probe.p_value >= checked_probe.level
    assert checked_probe.alike == ()
    assert np.abs([block.z for block in checked_probe.blocks]).max() < 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "turn"),
    [("probe.outer.youngs_modulus", 1.15), ("probe.inner_radius", 1.01), ("probe.gap", 2.0), ("probe.height", 0.9)],
)
def test_a_probe_off_its_drawing_is_found(name: str, turn: float) -> None:
    """15 % in a modulus, 1 % in a radius, a double gap: the variable is among those that explain it, at its true size."""
    checked_probe = built(name, turn)
    assert checked_probe.verdict == VERDICT_OUT
    assert name in checked_probe.alike
    explanation = next(explanation for explanation in checked_probe.explanations if explanation.variable == name)
    assert explanation.explains
    truth = (turn - 1) * list_values(scene())[name]
    assert abs(explanation.change - truth) < 3 * explanation.uncertainty
    assert explanation.uncertainty < 0.2 * abs(truth)


@pytest.mark.slow
def test_what_cannot_be_told_apart_is_said() -> None:
    """A softer block and a higher one are nearly the same thing; a gap is not."""
    assert {"probe.outer.youngs_modulus", "probe.height"} <= set(built("probe.height", 0.9).alike)
    assert "probe.gap" not in built("probe.height", 0.9).alike
    assert built("probe.gap", 2.0).alike == ("probe.gap",)


def test_large_changes_need_the_refined_fit() -> None:
    """Linear in 20 % the modulus would be 3 standard deviations off."""
    name, known = "probe.outer.youngs_modulus", shares()
    logs = predict_blocks(scene().replace({name: 1.2 * list_values(scene())[name]}), BENCH.reference).log_ratios
    read = np.full(len(logs), 0.0027**2)  # what the loop above leaves
    model = np.array([share.compute_variance(block) for share, block in zip(known.blocks, BENCH.blocks, strict=True)])
    deviation = Deviation(logs, known.log_ratios, read, np.zeros((len(logs), 0)), model, {})
    linear = _find_explanation("probe.outer.youngs_modulus", compute_explanations(deviation, known)[0])
    (fit,) = fit_variables(scene(), BLOCKS, deviation, known, ["probe.outer.youngs_modulus"])
    repeated = build_explanation(fit, deviation)
    assert abs(linear.change - 16e3) > 3 * linear.uncertainty
    assert abs(repeated.change - 16e3) < 3 * repeated.uncertainty


@pytest.mark.slow
def test_nothing_to_explain_is_explained_by_no_change() -> None:
    name, known = "probe.outer.youngs_modulus", shares()
    read = np.full(len(known.log_ratios), 0.0027**2)
    gains = np.full((len(read), 1), 1e-3)
    deviation = Deviation(known.log_ratios, known.log_ratios, read, gains, np.zeros_like(read), {}, {"probe.gap": read})
    (fit,) = fit_variables(scene(), BLOCKS, deviation, known, [name])
    assert fit.changes.values[0] == list_values(scene())[name]
    assert fit.chi_square == 0
    assert fit.uncertainties.shape == (1,)


def _find_explanation(name: str, explained: tuple[Explanation, ...]) -> Explanation:
    return next(explanation for explanation in explained if explanation.variable == name)


@pytest.mark.slow
def test_coverage_of_chi_square_and_sizes() -> None:
    """30 probes as drawn, blocks and noise drawn anew: p-values are uniform, z has unit variance, one in a hundred fails."""
    known, z, p, sizes = shares(), [], [], []
    for seed in range(30):
        random = np.random.default_rng(seed)
        spreads = [share.compute_variance(block) ** 0.5 for share, block in zip(known.blocks, BENCH.blocks, strict=True)]
        result = _quick(known.log_ratios + spreads * random.standard_normal(len(spreads)), seed)
        z.append([block.z for block in result.blocks])
        p.append(result.p_value)
        sizes.append(
            [
                explanation.change / explanation.uncertainty
                for explanation in result.explanations
                if result.p_value >= result.level
            ]
        )
    assert np.mean(np.square(z)) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 150))
    # each variable's size is 0 here; they go together, so that 30 probes are 30 numbers
    assert np.mean([np.mean(np.square(explanation)) for explanation in sizes if explanation]) == pytest.approx(
        1.0, abs=4 * np.sqrt(2 / 30)
    )
    assert np.mean(p) == pytest.approx(0.5, abs=4 / np.sqrt(12 * 30))
    assert sum(explanation < 0.01 for explanation in p) <= 3  # 0.3 expected


def _quick(logs: Floats, seed: int) -> Check:
    """The loop with as few samples as a calibration takes."""
    bench = TIGHT.model_copy(update={"load": BENCH.load.model_copy(update={"least_cycles": 10.0})})
    forces = films(logs)
    runs = ([sampled(build_signals(BUILT, bench, scene(), film, [seed, run, k]), rows=450, rate=200.0)
             for k, film in enumerate(forces)]
            for run in (0, 1))  # fmt: skip
    read, repeated = runs
    calibration = calibrate(scene(), bench, read, shares())
    strict = STRICT.model_copy(update={"load": bench.load})
    return check(scene(), strict, repeated[2:], calibration.gains, variables=calibration.variables, predictions=shares())


@pytest.mark.slow
def test_what_the_calibration_has_absorbed_is_not_told() -> None:
    """Gains from blocks alone, no force channel: three free entries take up what a variable does to five blocks."""
    forces = films(shares().log_ratios, BLOCKS)
    read = [sampled(build_signals(BUILT, BLOCKS, scene(), item, [5, k]), channels=2) for k, item in enumerate(forces)]
    alone = calibrate(scene(), BLOCKS, read, shares())
    strict = BLOCKS.model_copy(update=DRAWN)
    result = check(scene(), strict, read, alone.gains, variables=alone.variables, predictions=shares())
    spread = {item.variable: item.uncertainty / item.nominal for item in result.explanations}
    known = {item.variable: item.uncertainty / item.nominal for item in built("probe.gap", 2.0).explanations}
    for name in ("probe.outer.youngs_modulus", "probe.height"):
        assert spread.get(name, np.inf) > 5 * known[name]


def on_blocks(seed: int) -> list[Samples]:
    forces = films(shares().log_ratios)[2:]
    return [sampled(build_signals(BUILT, BENCH, scene(), force, [seed, k])) for k, force in enumerate(forces)]


def test_reversed_polarity_is_refused() -> None:
    samples = [replace(reading, volts=reading.volts * [-1.0, 1.0, 1.0]) for reading in on_blocks(6)]
    with pytest.raises(InputError, match="leads are exchanged"):
        check(scene(), BENCH, samples, predictions=shares())


def test_uncalibrated_gains_leave_a_wide_check() -> None:
    samples = on_blocks(7)
    result = check(scene(), BENCH, samples, predictions=shares())
    assert not result.calibrated
    assert result.blocks[0].ratio_uncertainty / result.blocks[0].ratio > 0.05
    assert result.verdict == VERDICT_UNTESTED
    assert (result.passed, result.failed, result.tested) == (False, False, ())  # nothing contradicts the drawing: it says nothing
    assert all(variable.reason for variable in result.untested)
    with pytest.raises(InputError, match="one for each"):
        check(scene(), BENCH, samples[:2], predictions=shares())
