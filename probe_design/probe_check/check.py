"""Check a built probe: compare ratios measured on blocks of tissue with the predicted ones.

d_k = ln rho_k measured - ln rho_k predicted, rho_k the films' force ratio on block k, has the covariance C: the sum of those of
noise, the blocks' moduli, the solver, the gains, G C_M G^T, and the workshop's tolerances. C_M is the covariance of the gain
matrix, G the derivatives of ln rho_k with respect to its entries. If the probe is within these,
d^T C^-1 d is a chi-square (PC.1). ``probe_design.probe_check.verdicts`` looks for the cause of a deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from hw.common.samples import Samples
from hw.signal.measure import Measurement
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import Shares, inner_shares, predicted
from probe_design.built_probe.calibration import waveform_warnings
from probe_design.built_probe.exchanges import Misplacement, check_films, explaining, share_doubt
from probe_design.built_probe.film_forces import newtons, observed, strict_reading
from probe_design.built_probe.gain_matrix import Gains
from probe_design.built_probe.load_checks import check_reference_loads, within_limits
from probe_design.built_probe.phase_lags import lag_warnings
from probe_design.probe_check.coverage import VariableCoverage, coverage
from probe_design.probe_check.deviation import LEVEL, CancellingPair, Deviation, cancelling
from probe_design.probe_check.explanations import Explanation, VariablePair
from probe_design.probe_check.verdicts import WITHIN, Verdict, judged
from solver.results.evaluator import Tell, silent

Films = Sequence[tuple[Floats, Floats]]  # both films' readings of each block, N, (2,), and their covariance, (2, 2)


@dataclass(frozen=True)
class BlockDeviation:
    """One block: stress ratios measured and predicted, their standard deviations, and their difference over its own."""

    name: str
    ratio: float
    ratio_uncertainty: float
    predicted: float
    predicted_uncertainty: float
    z: float


@dataclass(frozen=True)
class Check:
    """The result of a check.

    Attributes:
        verdict: "within workshop tolerance as far as tested", "out of workshop tolerance", "cannot tell" or "nothing could be
            tested".
        reason: what is out of tolerance, or why no verdict is possible; empty if within.
        blocks: one comparison for each block.
        chi_square, degrees_of_freedom, p_value: for a probe within the workshop's tolerances, eq. PC.1.
        level: significance level: the p-value below which a probe fails, and the rate at which good probes fail.
        passed: whether at least one variable was tested, and nothing deviates.
        failed: whether the readings contradict a probe within tolerance.
        calibrated: whether gains come from a calibration.
        explanations: the variables that the readings determine, best explanation first.
        alike: the best explanation and those that the readings do not distinguish from it; empty if nothing deviates.
        pairs: pairs of variables, best first, if no single one explains the deviation.
        unresolved: variables that the readings do not determine, or that the calibration has absorbed.
        tested: the variables of which this check detects a deviation of five tolerances, each with its detection limit.
        untested: the other variables, each with the reason.
        cancelling: pairs whose joint deviation it does not detect, although it detects at least one of them alone.
        warnings: of the readings, one line each.
        serial: serial number of the board, if all readings have the same one.
    """

    verdict: str
    reason: str
    blocks: tuple[BlockDeviation, ...]
    chi_square: float
    degrees_of_freedom: int
    p_value: float
    level: float
    passed: bool
    failed: bool
    calibrated: bool
    explanations: tuple[Explanation, ...]
    alike: tuple[str, ...]
    pairs: tuple[VariablePair, ...]
    unresolved: tuple[str, ...]
    tested: tuple[VariableCoverage, ...]
    untested: tuple[VariableCoverage, ...]
    cancelling: tuple[CancellingPair, ...]
    warnings: tuple[str, ...] = ()
    serial: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of ``probe-design check``."""
        return asdict(self)


def check(
    scene: Scene,
    bench: Bench,
    samples: Sequence[Samples],
    gains: Gains | None = None,
    *,
    variables: Sequence[str] = (),
    shares: Shares | None = None,
    linear: bool = False,
) -> Check:
    """Compare a probe with its prediction.

    Args:
        scene: the probe as drawn.
        bench: blocks and tolerances.
        samples: one reading for each of the bench's blocks of tissue, in their order.
        gains: of a calibration; None: nominal, with the bench's tolerances.
        variables: names of the variables of ``gains.slopes``.
        shares: the predictions, if they are known already.
        linear: whether to accept loads whose finite strain may change a prediction by more than 0.8 %; it is counted anyway.

    Raises:
        HardwareError: a reading has gaps, is saturated, too short or drifts.
        InputError: there are no blocks, or not one reading for each; a film is dead or of reversed polarity.
        Refusal: a load is above the limit of linear elasticity.
    """
    _check_count(samples, bench)
    measurements = [strict_reading(one, bench, scene) for one in samples]
    return checked(scene, bench, measurements, gains, variables=variables, shares=shares, linear=linear)


def checked(
    scene: Scene,
    bench: Bench,
    measurements: Sequence[Measurement],
    gains: Gains | None = None,
    *,
    variables: Sequence[str] = (),
    shares: Shares | None = None,
    linear: bool = False,
    tell: Tell = silent,
) -> Check:
    """Compare measurements by ``film_forces.measure_strict_reading``; otherwise as ``check``. ``tell`` reports progress."""
    _check_count(measurements, bench)
    predictions = predicted(scene, bench.reference) if shares is None else shares
    effective = Gains.nominal(bench) if gains is None else gains.warmed(bench.channels.warming)
    seen = [observed(one, block, scene) for one, block in zip(measurements, bench.blocks, strict=True)]
    of_signals = (*waveform_warnings(measurements, bench.blocks), *lag_warnings(measurements, bench.blocks, bench))
    of_loads = check_reference_loads(seen, predictions, scene)
    predictions = within_limits(predictions, seen, of_loads, linear)
    films = [newtons(one, scene, tolerance=gains is None) for one in measurements]
    known = Comparison(bench, effective, tuple(variables), predictions)
    deviation, exchanges = known.deviation(films), known.exchanges(films)
    tolerances = dict(zip(predictions.variables, predictions.tolerances(bench.workshop).tolist(), strict=True))
    tested, names = coverage(deviation, tolerances), [one.told(bench.blocks) for one in exchanges]
    verdict = judged(scene, bench, deviation, predictions, names, tested=tested, tell=tell)
    found = _told(verdict, deviation, _blocks(scene, bench, deviation), tested, calibrated=gains is not None)
    return replace(found, warnings=(*of_loads, *of_signals))


def _check_count(readings: Sequence[Samples] | Sequence[Measurement], bench: Bench) -> None:
    if not bench.blocks or len(readings) != len(bench.blocks):
        raise InputError(
            "readings", len(readings), f"one for each of the bench's {len(bench.blocks)} blocks of tissue, at least one"
        )


def _told(
    verdict: Verdict, deviation: Deviation, blocks: tuple[BlockDeviation, ...], tested: Sequence[VariableCoverage],
    *, calibrated: bool,
) -> Check:  # fmt: skip
    return Check(
        verdict=verdict.verdict,
        reason=verdict.reason,
        blocks=blocks,
        chi_square=deviation.chi_square,
        degrees_of_freedom=len(blocks),
        p_value=deviation.p_value,
        level=LEVEL,
        passed=verdict.verdict == WITHIN,
        failed=deviation.p_value < LEVEL,
        calibrated=calibrated,
        explanations=verdict.explanations,
        alike=verdict.alike,
        pairs=verdict.pairs,
        unresolved=verdict.unresolved,
        tested=tuple(one for one in tested if one.tested),
        untested=tuple(one for one in tested if not one.tested),
        cancelling=cancelling(deviation),
    )


@dataclass(frozen=True)
class Comparison:
    """The gains and predictions that readings are compared with.

    Attributes:
        bench: blocks and tolerances.
        gains: with their uncertainty at the temperature of the readings.
        variables: names of the variables of ``gains.slopes``.
        shares: predictions for the probe as drawn.
    """

    bench: Bench
    gains: Gains
    variables: tuple[str, ...]
    shares: Shares

    def deviation(self, films: Films) -> Deviation:
        """Compare readings, one of each block, with the predictions. Raises ``InputError``: a film is dead or reversed."""
        parts = [_log_ratio(self.gains, *one) for one in self._pressed(films)]
        logs, noise, by_gain = (np.array(part) for part in zip(*parts, strict=True))
        blocks = zip(self.shares.blocks, self.bench.blocks, strict=True)
        model = np.array([share.variance(block) for share, block in blocks])
        read = np.diag(noise) + by_gain @ self.gains.as_drawn @ by_gain.T
        bias = {name: by_gain @ self.gains.slopes[:, k] for k, name in enumerate(self.variables)}
        return Deviation(logs, self.shares.log_ratios, read, model, bias, self._workshop(bias))

    def exchanges(self, films: Films) -> tuple[Misplacement, ...]:
        """Find the exchanges that explain readings outside the workshop's tolerances."""
        if self.deviation(films).p_value >= LEVEL:
            return ()
        forces = np.array([self.gains.forces(one) for one, _ in films])
        return explaining(forces, self._expected, share_doubt(self.bench), lambda one: self._agrees(films, one))

    @property
    def _expected(self) -> Floats:
        return inner_shares(self.shares.log_ratios, self.bench.blocks)

    def _agrees(self, films: Films, exchange: Misplacement) -> bool:
        at = {k: (exchange.mended(y), exchange.mended(spread)) for k, (y, spread) in zip(exchange.order, films, strict=True)}
        try:
            return self.deviation([at[k] for k in range(len(films))]).p_value >= LEVEL
        except InputError:
            return False

    def _pressed(self, films: Films) -> Films:
        forces = np.array([self.gains.forces(one) for one, _ in films])
        deviations = np.sqrt([np.diag(self.gains.forces_covariance(one, noise)) for one, noise in films])
        check_films(forces, self._expected, deviations)
        return films

    def _workshop(self, bias: dict[str, Floats]) -> dict[str, Floats]:
        slopes = zip(self.shares.variables, self.shares.slopes.T, self.shares.tolerances(self.bench.workshop), strict=True)
        return {name: (slope - bias.get(name, 0.0)) * tolerance for name, slope, tolerance in slopes}


def _log_ratio(gains: Gains, films: Floats, covariance: Floats) -> tuple[float, float, Floats]:
    """Return ln(F_inner / F_outer), its variance due to noise, and its derivatives with respect to M's entries, shape (4,)."""
    forces = gains.forces(films)
    slope = np.array([1.0, -1.0]) / forces
    by_films = slope @ np.linalg.inv(gains.matrix)
    return float(np.log(forces[0] / forces[1])), float(by_films @ covariance @ by_films), slope @ gains.by_entries(films)


def _blocks(scene: Scene, bench: Bench, deviation: Deviation) -> tuple[BlockDeviation, ...]:
    areas = scene.probe.outer_area / scene.probe.inner_area
    ratios, predictions = np.exp(deviation.logs) * areas, np.exp(deviation.drawn) * areas
    read, whole = np.diag(deviation.read), np.diag(deviation.covariance())
    z = (deviation.logs - deviation.drawn) / np.sqrt(whole)
    columns = (ratios, ratios * np.sqrt(read), predictions, predictions * np.sqrt(whole - read), z)
    rows = np.stack(columns, axis=1).tolist()
    return tuple(BlockDeviation(block.name, *row) for block, row in zip(bench.blocks, rows, strict=True))
