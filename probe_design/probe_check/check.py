"""Check a built probe: compare ratios measured on blocks of tissue with the predicted ones.

d_k = ln rho_k measured - ln rho_k predicted, rho_k the films' force ratio on block k, has the covariance C: the sum of those of
noise, the blocks' moduli, the solver, the gains, G C_M G^T, and the workshop's tolerances. C_M is the covariance of the gain
matrix, G the derivatives of ln rho_k with respect to its entries. If the probe is within these,
d^T C^-1 d is a chi-square (PC.1). ``probe_design.probe_check.verdicts`` looks for the cause of a deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from hw.signal.measurement import Measurement
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import BlockPredictions, compute_inner_fractions, predict_blocks
from probe_design.built_probe.calibration import ReferenceReadings
from probe_design.built_probe.film_forces import compute_film_forces
from probe_design.built_probe.gains import Gains
from probe_design.built_probe.reference_charges import scale_bonds
from probe_design.built_probe.swapped_connections import Swap, check_films, compute_max_fraction_error, find_swaps
from probe_design.probe_check.coverage import VariableCoverage, compute_coverage
from probe_design.probe_check.deviation import SIGNIFICANCE_LEVEL, CancellingPair, Deviation, find_cancelling_pairs
from probe_design.probe_check.explanations import Explanation, VariablePair
from probe_design.probe_check.verdicts import VERDICT_WITHIN, decide_verdict
from solver.results.evaluator import ProgressCallback, ignore_progress
from solver.results.record import Record

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


@dataclass(frozen=True, repr=False)
class Check(Record):
    """The result of a check.

    Attributes
    ----------
    verdict
        "within workshop tolerance as far as tested", "out of workshop tolerance", "undetermined" or "nothing could be tested".
    reason
        What is out of tolerance, or why no verdict is possible; empty if within.
    blocks
        One comparison for each block.
    chi_square, degrees_of_freedom, p_value
        For a probe within the workshop's tolerances, eq. PC.1.
    level
        Significance level: the p-value below which a probe fails, and the rate at which good probes fail.
    passed
        Whether at least one variable was tested, and nothing deviates.
    failed
        Whether the readings contradict a probe within tolerance.
    calibrated
        Whether gains come from a calibration.
    explanations
        The variables that the readings determine, best explanation first.
    alike
        The best explanation and those that the readings do not distinguish from it; empty if nothing deviates.
    pairs
        Pairs of variables, best first, if no single one explains the deviation.
    unresolved
        Variables that the readings do not determine, or that the calibration has absorbed.
    tested
        The variables whose deviation by ``DETECTED_TOLERANCES`` this check detects, each with its detection limit.
    untested
        The other variables, each with the reason.
    cancelling
        Pairs whose joint deviation it does not detect, although it detects at least one of them alone.
    warnings
        Of the readings, one line each.
    serial
        Serial number of the board, if all readings have the same one.
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


def check(
    scene: Scene,
    bench: Bench,
    measurements: Sequence[Measurement],
    gains: Gains | None = None,
    *,
    variables: Sequence[str] = (),
    predictions: BlockPredictions | None = None,
    linear: bool = False,
    progress: ProgressCallback = ignore_progress,
) -> Check:
    """Compare a probe with its prediction.

    Parameters
    ----------
    scene
        The probe as drawn.
    bench
        Blocks and tolerances.
    measurements
        By ``film_forces.measure_strict_reading``, one on each of the bench's blocks of tissue, in their order.
    gains
        Of a calibration; None: nominal, with the bench's tolerances.
    variables
        Names of the variables of ``gains.slopes``.
    predictions
        For the blocks of tissue, if they are known already.
    linear
        See ``BlockPredictions.apply_forces``.
    progress
        Called with a line of text at each step.

    Raises
    ------
    InputError
        There are no blocks, or not one reading for each; a film is dead or of reversed polarity.
    Refusal
        ``contact`` does not reach a load.
    """
    built = scale_bonds(scene, gains.bonds.log_factor) if gains is not None and gains.bonds is not None else scene
    predictions = predict_blocks(built, bench.blocks) if predictions is None else predictions
    readings = ReferenceReadings.from_measurements(scene, bench, bench.blocks, measurements, predictions, linear=linear)
    used_gains = Gains.from_bench(bench) if gains is None else gains.add_warming(bench.channels.warming)
    films = [compute_film_forces(item, scene, tolerance=gains is None) for item in measurements]
    comparison = Comparison(bench, used_gains, tuple(variables), readings.predictions)
    deviation, swaps = comparison.compute_deviation(films), comparison.find_swaps(films)
    tolerances = readings.predictions.compute_tolerances(bench.workshop, comparison.knows_bonds).tolist()
    coverage = compute_coverage(deviation, dict(zip(readings.predictions.variables, tolerances, strict=True)))
    verdict = decide_verdict(
        built, bench, deviation, readings.predictions, [swap.describe(bench.blocks) for swap in swaps],
        coverage=coverage, progress=progress,
    )  # fmt: skip
    return Check(
        **vars(verdict),
        blocks=_build_blocks(scene, bench, deviation),
        chi_square=deviation.chi_square,
        degrees_of_freedom=len(films),
        p_value=deviation.p_value,
        level=SIGNIFICANCE_LEVEL,
        passed=verdict.verdict == VERDICT_WITHIN,
        failed=deviation.p_value < SIGNIFICANCE_LEVEL,
        calibrated=gains is not None,
        tested=tuple(entry for entry in coverage if entry.tested),
        untested=tuple(entry for entry in coverage if not entry.tested),
        cancelling=find_cancelling_pairs(deviation),
        warnings=readings.warnings,
    )


@dataclass(frozen=True)
class Comparison:
    """The gains and predictions that readings are compared with.

    Attributes
    ----------
    bench
        Blocks and tolerances.
    gains
        With their uncertainty at the temperature of the readings.
    variables
        Names of the variables of ``gains.slopes``.
    predictions
        For the probe as drawn.
    """

    bench: Bench
    gains: Gains
    variables: tuple[str, ...]
    predictions: BlockPredictions

    def compute_deviation(self, films: Films) -> Deviation:
        """Return the deviation of readings, one of each block, from the predictions.

        Raises
        ------
        InputError
            A film is dead or reversed.
        """
        film_forces = np.array([self.gains.compute_forces(reading) for reading, _ in films])
        force_sds = np.sqrt([np.diag(self.gains.compute_forces_covariance(*reading)) for reading in films])
        check_films(film_forces, self._expected_fractions, force_sds)
        parts = [_compute_log_ratio(self.gains, *reading) for reading in films]
        logs, noise, entry_derivatives = (np.array(part) for part in zip(*parts, strict=True))
        if self.gains.bonds is not None:  # the last entry: exactly for each block, in place of the blocks' mean
            entry_derivatives[:, -1] = [-block.bond_derivative for block in self.predictions.blocks]
        blocks = zip(self.predictions.blocks, self.bench.blocks, strict=True)
        model = np.array([prediction.compute_variance(block) for prediction, block in blocks])
        bias = {name: entry_derivatives @ self.gains.slopes[:, k] for k, name in enumerate(self.variables)}
        tolerances = self.predictions.compute_tolerances(self.bench.workshop, self.knows_bonds)
        workshop = {
            name: (derivatives - bias.get(name, 0.0)) * tolerance
            for name, derivatives, tolerance in zip(
                self.predictions.variables, self.predictions.derivatives.T, tolerances, strict=True
            )
        }
        load_errors = self.predictions.load_errors[: len(logs)]
        gain_errors = np.column_stack([entry_derivatives @ self.gains.errors_as_drawn, load_errors])
        return Deviation(logs, self.predictions.log_ratios, noise, gain_errors, model, bias, workshop)

    def find_swaps(self, films: Films) -> tuple[Swap, ...]:
        """Find the swaps that explain readings outside the workshop's tolerances."""
        if self.compute_deviation(films).p_value >= SIGNIFICANCE_LEVEL:
            return ()
        film_forces = np.array([self.gains.compute_forces(reading) for reading, _ in films])
        max_error = compute_max_fraction_error(self.bench)
        return find_swaps(film_forces, self._expected_fractions, max_error, lambda swap: self._agrees(films, swap))

    @property
    def knows_bonds(self) -> bool:
        """Whether a calibration has determined the modulus of the films' bonds."""
        return self.gains.bonds is not None

    @property
    def _expected_fractions(self) -> Floats:
        """The inner film's expected fraction of the load on each block."""
        return compute_inner_fractions(self.predictions.log_ratios, self.bench.blocks)

    def _agrees(self, films: Films, swap: Swap) -> bool:
        """Whether the readings are within the workshop's tolerances once a swap is undone."""
        reading_by_block = {
            k: (swap.restore_channels(reading), swap.restore_channels(covariance))
            for k, (reading, covariance) in zip(swap.order, films, strict=True)
        }
        try:
            return self.compute_deviation([reading_by_block[k] for k in range(len(films))]).p_value >= SIGNIFICANCE_LEVEL
        except InputError:
            return False


def _compute_log_ratio(gains: Gains, films: Floats, covariance: Floats) -> tuple[float, float, Floats]:
    """Return ln(F_inner / F_outer), its variance due to noise, and its derivatives with respect to M's entries, shape (4,)."""
    forces = gains.compute_forces(films)
    force_derivatives = np.array([1.0, -1.0]) / forces
    film_derivatives = force_derivatives @ np.linalg.inv(gains.matrix)
    return (
        float(np.log(forces[0] / forces[1])),
        float(film_derivatives @ covariance @ film_derivatives),
        force_derivatives @ gains.differentiate_by_entries(films),
    )


def _build_blocks(scene: Scene, bench: Bench, deviation: Deviation) -> tuple[BlockDeviation, ...]:
    """Build the comparison of each block, as ratios of stresses: a ratio of forces times the outer area over the inner."""
    areas = scene.probe.outer_area / scene.probe.inner_area
    ratios, predictions = np.exp(deviation.logs) * areas, np.exp(deviation.drawn) * areas
    read_sd, variance = deviation.reading_sd, np.diag(deviation.build_errors().covariance)
    z = deviation.difference / np.sqrt(variance)
    columns = (ratios, ratios * read_sd, predictions, predictions * np.sqrt(variance - read_sd**2), z)
    rows = np.stack(columns, axis=1).tolist()
    return tuple(BlockDeviation(block.name, *row) for block, row in zip(bench.blocks, rows, strict=True))
