"""Calibration: predictions against finite differences, gains against the truth, coverage, refusals, the record."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from geometry import InputError, Refusal, Scene
from geometry.common.arrays import Floats
from geometry.scenes.variables import list_values
from geometry.workshop.tolerance import find_length_sd
from hw.common.errors import HardwareError
from hw.common.samples import Gap, Samples
from probe_design.built_probe.bench import Bench, Reference, Workshop, bench_from_dict, read_bench
from probe_design.built_probe.block_predictions import BLOCK_MODULI, build_block_scene, predict_blocks
from probe_design.built_probe.calibration import Calibration
from probe_design.built_probe.calibration_record import CalibrationRecord, Raw, build_record, read_record, write_record
from probe_design.built_probe.gain_fit import estimate_gains
from probe_design.built_probe.gains import Gains, Observation
from probe_design.built_probe.virtual_probe import BuiltProperties, build_signals
from solver import evaluate
from tests.support.hw.benches import BENCH, LOAD, calibrate, films, sampled, scene, shares
from tests.support.slow import slow_unless

BUILT = BuiltProperties()


def readings(logs: Floats, seed: int, bench: Bench = BENCH, built: BuiltProperties = BUILT, channels: int = 3) -> list[Samples]:
    forces = films(logs, bench)
    return [sampled(build_signals(built, bench, scene(), force, [seed, k]), channels=channels) for k, force in enumerate(forces)]


def true_matrix() -> Floats:
    """Return M as a calibration at the bench's frequency should find it, amplifiers included, shape (2, 2)."""
    nominal, frequency = BENCH.amplifier.build_films()[0], BUILT.frequency * BENCH.load.frequency
    responses = [amplifier.response(frequency) for amplifier in BUILT.build_amplifiers((nominal, nominal))]
    return np.asarray(np.abs(responses)[:, None] / abs(nominal.response(frequency)) * np.array(BUILT.gains))


@cache
def calibration(channels: int = 3) -> Calibration:
    return calibrate(scene(), BENCH, readings(shares().log_ratios, 1, channels=channels), shares())


def test_predicted_ratio_is_the_evaluator_s() -> None:
    block = build_block_scene(scene(), BENCH.blocks[1])
    assert block.inclusion == ()
    ratio = evaluate(block, "axisymmetric", 1e-4).ratio or math.nan
    areas = block.probe.inner_area / block.probe.outer_area
    assert shares().log_ratios[1] == pytest.approx(math.log(ratio * areas), abs=shares().blocks[1].bound)


def test_slopes_are_finite_differences_of_the_film_forces() -> None:
    """By every variable; the films' forces follow from stresses and true areas, not from the drawing's."""
    step, block = 1e-3, BENCH.blocks[1]
    for k, name in enumerate(shares().variables):
        if name in (BLOCK_MODULI, "probe.inner.poisson_ratio", "probe.outer.poisson_ratio"):
            continue
        logs = [_log_force_ratio(_changed(scene(), name, turn), block) for turn in (1 + step, 1 - step)]
        slope = shares().blocks[1].derivatives[k] * shares().nominal[k]
        assert slope == pytest.approx((logs[0] - logs[1]) / (2 * step), rel=2e-3, abs=2e-5), name


def test_slope_by_the_block_s_modulus() -> None:
    logs = [_log_force_ratio(scene(), _softer(BENCH.blocks[1], turn)) for turn in (1.001, 0.999)]
    assert shares().blocks[1].modulus_derivative == pytest.approx((logs[0] - logs[1]) / 0.002, rel=2e-3)
    assert shares().blocks[1].derivatives[-1] == shares().blocks[1].modulus_derivative


def _changed(drawn: Scene, name: str, turn: float) -> Scene:
    return drawn.replace({name: list_values(drawn)[name] * turn})


def _softer(block: Reference, turn: float) -> Reference:
    return block.model_copy(update={"youngs_modulus": (block.youngs_modulus or 0.0) * turn})


def _log_force_ratio(drawn: Scene, block: Reference) -> float:
    result = evaluate(build_block_scene(drawn, block), "axisymmetric", 1e-3)
    assert result.stress_inner
    assert result.stress_outer
    return math.log(result.stress_inner * drawn.probe.inner_area / (result.stress_outer * drawn.probe.outer_area))


def test_true_gains_are_found() -> None:
    fitted = calibration()
    error = (fitted.gains.matrix - true_matrix()).ravel()
    assert np.all(np.abs(error) < 3.5 * np.sqrt(np.diag(fitted.gains.covariance)))
    assert np.all(np.abs(error[[1, 2]]) < 0.003)  # cross-talk, which pin and ring show but for what they leak
    assert fitted.gains.absolute
    assert fitted.gains.cross_talk_resolved == (True, True)
    assert fitted.frequency == pytest.approx(BUILT.frequency * 5.0, abs=1e-3)
    # the true offsets, and what the slow drift has become in the middle of the 5 s
    drifted = BUILT.drift * np.array([1.0, 0.6]) * (1 - math.exp(-2.5 / 60))
    assert fitted.offsets == pytest.approx(np.array(BUILT.offsets[:2]) + drifted, abs=5e-6)


def test_without_a_force_channel_only_ratios_are_told() -> None:
    fitted = calibration(channels=2)
    truth = true_matrix()
    error = (fitted.gains.matrix - truth / truth[1, 1]).ravel()
    common = BENCH.channels.gain**2 * np.outer(fitted.gains.matrix.ravel(), fitted.gains.matrix.ravel())
    spread = np.sqrt(np.maximum(np.diag(fitted.gains.covariance - common), 1e-30))
    assert fitted.gains.matrix[1, 1] == 1.0
    assert np.all(np.abs(error[:3]) < 3.5 * spread[:3])
    assert not fitted.gains.absolute
    assert np.sqrt(fitted.gains.covariance[3, 3]) == pytest.approx(BENCH.channels.gain)
    assert any("no force channel" in warning for warning in fitted.warnings)


@pytest.mark.parametrize(
    ("blocks_alone", "force"), slow_unless((True, False).__eq__, [(True, False), (True, True), (False, True), (False, False)])
)
def test_coverage_of_the_gains(blocks_alone: bool, force: bool) -> None:
    """100 probes off their drawings with 100 gain matrices: errors over their standard deviations have unit variance."""
    references = BENCH.blocks if blocks_alone else BENCH.reference
    z, chi_squares = [], []
    for seed in range(100):
        random = np.random.default_rng([seed, force, blocks_alone])
        matrix = np.eye(2) + np.array([[0.05, 0.01], [0.01, 0.05]]) * random.standard_normal((2, 2))
        matrix = matrix if force else matrix / matrix[1, 1]
        gains = estimate_gains(_observed(matrix, references, force, random), shares(), BENCH)
        spread = gains.covariance - (0.0 if force else BENCH.channels.gain**2 * np.outer(gains.matrix, gains.matrix))
        entries = slice(None) if force else slice(3)
        z.append(((gains.matrix - matrix).ravel() / np.sqrt(np.maximum(np.diag(spread), 1e-30)))[entries])
        chi_squares.append(gains.chi_square / gains.degrees_of_freedom)
    assert np.mean(np.square(z), axis=0) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 100))
    assert np.mean(chi_squares) == pytest.approx(1.0, abs=4 * np.sqrt(2 / (100 * gains.degrees_of_freedom)))


def _observed(matrix: Floats, references: tuple[Reference, ...], force: bool, random: np.random.Generator) -> list[Observation]:
    """Readings of a probe and blocks that deviate by their tolerances, with a force sensor of any scale."""
    known, noise = shares(), 2e-5
    design = known.derivatives @ (known.compute_tolerances(BENCH.workshop) * random.standard_normal(len(known.variables)))
    spreads = [share.compute_variance(block) ** 0.5 for share, block in zip(known.blocks, BENCH.blocks, strict=True)]
    logs = known.log_ratios + design + spreads * random.standard_normal(len(spreads))
    sensor = np.exp(0.05 * random.standard_normal())
    bench = BENCH.model_copy(update={"reference": references})
    leaks = [observed_reference.leak_sd * random.standard_normal() for observed_reference in references]
    pressed = [film + LOAD * leak * np.array([1, -1]) for leak, film in zip(leaks, films(logs, bench), strict=True)]
    return [
        Observation(
            reference, matrix @ film + noise * random.standard_normal(2), noise**2 * np.eye(2),
            LOAD * sensor + 1e-5 * random.standard_normal() if force else None, 1e-5 if force else None,
        )
        for reference, film in zip(references, pressed, strict=True)
    ]  # fmt: skip


def test_slopes_of_the_estimate_are_what_other_predictions_do() -> None:
    """Gains.slopes: the estimate that predictions for a changed drawing give, from the same readings."""
    known, name = shares(), "probe.outer.youngs_modulus"
    k = known.variables.index(name)
    seen = _observed(np.eye(2), BENCH.blocks, True, np.random.default_rng(3))
    bench = BENCH.model_copy(update={"reference": BENCH.blocks})
    step = 0.01 * known.nominal[k]
    blocks = tuple(replace(block, log_ratio=block.log_ratio + block.derivatives[k] * step) for block in known.blocks)
    moved = replace(known, blocks=blocks)
    estimate, moved_estimate = (estimate_gains(seen, variant, bench) for variant in (known, moved))
    assert (moved_estimate.matrix - estimate.matrix).ravel() == pytest.approx(estimate.slopes[:, k] * step, rel=0.05, abs=2e-5)
    assert np.abs(moved_estimate.matrix - estimate.matrix).max() > 1e-3


@pytest.mark.parametrize(
    ("first", "last", "force", "is_determined"),
    [
        (0, 2, True, True),
        (0, 2, False, False),
        (0, 3, False, True),
        (2, 3, False, False),
        (2, 3, True, False),
        (2, 4, True, True),
    ],
)
def test_what_references_can_tell(first: int, last: int, force: bool, is_determined: bool) -> None:
    """The table in docs/guides/calibrate.md; references 0 and 1 are pin and ring, the others blocks."""
    known = replace(shares(), blocks=shares().blocks[: max(last - 2, 0)])
    seen = _observed(np.eye(2), BENCH.reference, force, np.random.default_rng(0))[first:last]
    if is_determined:
        assert estimate_gains(seen, known, BENCH).matrix == pytest.approx(np.eye(2), abs=0.1)
    else:
        with pytest.raises(InputError, match="a pin on the inner and a ring on the outer"):
            estimate_gains(seen, known, BENCH)


@pytest.mark.slow
def test_readings_that_contradict_the_predictions_are_told() -> None:
    logs = shares().log_ratios + np.array([0.3, 0.0, -0.3, 0.0, 0.3])
    fitted = calibrate(scene(), BENCH, readings(logs, 2), shares())
    assert any("contradict" in warning for warning in fitted.warnings)
    assert not any("contradict" in warning for warning in calibration().warnings)


def _spoiled(change: str) -> list[Samples]:
    whole = readings(shares().log_ratios, 1)
    first = whole[0]
    marked = first.saturated.copy()
    marked[5] = True
    warm = 0.5 * np.linspace(0, 1, len(first.index))[:, None] * [1.0, 1.0, 0.0]
    spoiled = {
        "lost": replace(first, gaps=(Gap(5, 1, "lost"),)),
        "overran": replace(first, overruns=1),
        "saturated": replace(first, saturated=marked),
        "cycles": replace(first, index=first.index[:1500], volts=first.volts[:1500], saturated=first.saturated[:1500]),
        "warmed": replace(first, volts=first.volts + warm),
    }[change]
    return [spoiled, *whole[1:]]


@pytest.mark.parametrize(
    ("change", "words"),
    [("lost", "lost"), ("overran", "ran over"), ("saturated", "saturated"), ("cycles", "cycles"), ("warmed", "K during")],
)
def test_flawed_readings_are_refused(change: str, words: str) -> None:
    with pytest.raises(HardwareError, match=words) as refused:
        calibrate(scene(), BENCH, _spoiled(change), shares())
    assert "\n" not in str(refused.value)


def test_a_reading_for_each_reference() -> None:
    with pytest.raises(InputError, match="one for each of the bench's 7"):
        calibrate(scene(), BENCH, readings(shares().log_ratios, 1)[:3], shares())


def test_pyroelectric_equivalent_is_that_of_the_literature() -> None:
    """PHYSICS section 6: 91 N per kelvin on 1 cm^2 at 33 pC/N, 150 at 20 pC/N."""
    from probe_design.built_probe.film_forces import compute_newtons_per_kelvin

    areas = np.array([scene().probe.inner_area, scene().probe.outer_area])
    assert compute_newtons_per_kelvin(scene()) * 1e-4 / areas == pytest.approx(150.0)


def test_tilted_or_unilateral_probes_are_refused() -> None:
    data = scene().model_dump(exclude_unset=True)
    tied = Scene.model_validate(data | {"contact": {"interface": "unilateral"}})
    with pytest.raises(Refusal):
        predict_blocks(tied, BENCH.reference)


def _record(path: Path) -> CalibrationRecord:
    fitted = calibration()
    entry = build_record(fitted, [Raw("ab" * 32, f"run-{k}.probe") for k in range(7)], "virtual")
    write_record(path, entry)
    return entry


def test_record_reads_back_and_is_never_overwritten(tmp_path: Path) -> None:
    written = _record(tmp_path / "probe.toml")
    restored = read_record(tmp_path / "probe.toml")
    assert restored == written
    assert restored.build_gains().covariance == pytest.approx(calibration().gains.covariance, rel=1e-12)
    assert restored.build_scene() == scene()
    assert restored.build_bench() == BENCH
    assert restored.reading[2].sha256 == "ab" * 32
    content = (tmp_path / "probe.toml").read_bytes()
    with pytest.raises(InputError, match="not taken"):
        write_record(tmp_path / "probe.toml", written)
    assert (tmp_path / "probe.toml").read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == ["probe.toml"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("version = 2", "version = 3", "version 3"),
        ("probe-design calibration", "another thing", "another thing"),
        ("absolute = true", "absolute = 3", "absolute"),
        ("frequency = 5", "frequency = -5", "frequency"),
    ],
)
def test_damaged_records_are_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    _record(tmp_path / "probe.toml")
    text = (tmp_path / "probe.toml").read_text()
    assert f'"{old}"' in text or f"\n{old}" in text
    (tmp_path / "bad.toml").write_text(text.replace(f'"{old}"', f'"{new}"') if '"' + old in text else text.replace(old, new, 1))
    with pytest.raises(InputError, match=words):
        read_record(tmp_path / "bad.toml")


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"reference": [{"on": "tissue"}]}, "youngs_modulus"),
        ({"reference": [{"on": "inner", "youngs_modulus": "3 kPa"}]}, "nothing else"),
        ({"reference": [{"on": "floor"}]}, r"reference\[0\]\.on"),
        ({"reference": [{"on": "inner"}], "load": {"frequency": 5.0}}, "unit is missing"),
        ({"reference": []}, "reference"),
        ({"reference": [{"on": "inner"}], "amplifier": {"gain": 2}}, "amplifier.gain"),
    ],
)
def test_bad_benches_are_refused(tables: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        bench_from_dict(tables)


def test_bench_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="bench file"):
        read_bench(tmp_path / "absent.toml")


def test_nominal_gains_carry_the_bench_s_tolerances() -> None:
    nominal = Gains.from_bench(BENCH)
    covariance = nominal.compute_forces_covariance(np.array([0.1, 0.1]), np.zeros((2, 2)))
    assert np.sqrt(covariance[0, 0]) == pytest.approx(0.1 * math.hypot(0.05, 0.01))


def test_workshop_tolerances_by_kind() -> None:
    tolerances = dict(zip(shares().variables, shares().compute_tolerances(Workshop(length=20e-6)), strict=True))
    assert tolerances["probe.gap"] == 20e-6
    assert tolerances["probe.outer.youngs_modulus"] == pytest.approx(0.02 * 80e3)
    assert tolerances["probe.inner.poisson_ratio"] == 0.003
    assert tolerances[BLOCK_MODULI] == 0.0


def test_lengths_without_a_stated_tolerance_have_the_tightest_of_their_block_s_process() -> None:
    """ISO 3302-1 M2 of cast blocks, as their drawings state: 0.2 mm of a diameter; half of IT7 of turned ones is less."""
    cast = dict(zip(shares().variables, shares().compute_tolerances(Workshop()), strict=True))
    assert cast["probe.gap"] == pytest.approx(0.1e-3 / math.sqrt(3))
    assert cast["probe.height"] == pytest.approx(0.15e-3 / math.sqrt(3))
    hard = scene().probe.model_copy(update={"inner": scene().probe.inner.model_copy(update={"youngs_modulus": 70e9})})
    assert find_length_sd(hard, "probe.inner_radius") == 20e-6
    assert find_length_sd(hard, "probe.outer_radius") == cast["probe.outer_radius"]
