"""The check of a built probe: ratios measured on blocks of tissue against the predicted ones.

d_k = ln rho_k measured - ln rho_k predicted has the covariance C: noise, the blocks' moduli, the solver, and G C_M G^T, G the
derivatives of ln rho_k by the entries of the gain matrix. If the design is as drawn, d^T C^-1 d is a chi-square (BP.4).
Which variable would explain a deviation is for ``probe_design.built_probe.explanations`` to say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from geometry.common.arrays import Floats
from geometry.common.errors import InputError, Words
from geometry.scenes.scene import Scene
from hw.common.samples import Samples
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.block_predictions import Shares, predicted
from probe_design.built_probe.explanations import LEVEL, Deviation, Explanation, alike, explanations, refined
from probe_design.built_probe.film_forces import newtons, observed, strict_reading
from probe_design.built_probe.gain_matrix import Gains


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
    """What a check found.

    Attributes:
        blocks: one line for each.
        chi_square, degrees_of_freedom, p_value: of the probe as drawn, eq. BP.4.
        level: the p-value below which it fails.
        passed: whether it does not.
        calibrated: whether gains come from a calibration.
        explanations: the variables that the readings tell, best first.
        alike: the best and those that the readings do not tell apart from it; empty if the check is passed.
        unresolved: variables of which the readings tell nothing, or that the calibration has absorbed.
    """

    blocks: tuple[BlockDeviation, ...]
    chi_square: float
    degrees_of_freedom: int
    p_value: float
    level: float
    passed: bool
    calibrated: bool
    explanations: tuple[Explanation, ...]
    alike: tuple[str, ...]
    unresolved: tuple[str, ...]

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
        gains: a calibration's; None: nominal, with the bench's tolerances.
        variables: that ``gains.slopes`` refers to.
        shares: the predictions, where they are known already.
        linear: whether to take loads whose finite strain may change a prediction by more than 0.8 %; it is counted anyway.

    Raises:
        HardwareError: a reading has gaps, is saturated, too short or drifts.
        InputError: no blocks, or not one reading for each.
        Refusal: a load is beyond what linear elasticity allows.
    """
    if not bench.blocks or len(samples) != len(bench.blocks):
        raise InputError(
            "readings", len(samples), f"one for each of the bench's {len(bench.blocks)} blocks of tissue, at least one"
        )
    predictions = predicted(scene, bench.reference) if shares is None else shares
    effective = Gains.nominal(bench) if gains is None else gains
    measurements = [strict_reading(one, bench, scene) for one in samples]
    loads = [observed(one, block, scene).load for one, block in zip(measurements, bench.blocks, strict=True)]
    predictions = predictions.under(loads, bench.blocks, linear)
    films = [newtons(one, scene, tolerance=gains is None) for one in measurements]
    deviation = _deviation(bench, films, effective, variables, predictions)
    p_value = float(chi2.sf(deviation.chi_square, len(deviation.logs)))
    explained, unresolved = explanations(deviation, predictions)
    names: tuple[str, ...] = ()
    if p_value < LEVEL and explained:
        explained = refined(scene, bench, deviation, explained)
        names = alike(explained)
    return Check(
        blocks=_blocks(scene, bench, deviation, predictions),
        chi_square=deviation.chi_square,
        degrees_of_freedom=len(bench.blocks),
        p_value=p_value,
        level=LEVEL,
        passed=p_value >= LEVEL,
        calibrated=gains is not None,
        explanations=explained,
        alike=names,
        unresolved=unresolved,
    )


def _deviation(
    bench: Bench, films: Sequence[tuple[Floats, Floats]], gains: Gains, variables: Sequence[str], shares: Shares
) -> Deviation:
    parts = [_log_ratio(gains, *one) for one in films]
    logs, noise, by_gain = (np.array(part) for part in zip(*parts, strict=True))
    model = np.array([share.variance(block) for share, block in zip(shares.blocks, bench.blocks, strict=True)])
    read = np.diag(noise) + by_gain @ gains.as_drawn @ by_gain.T
    columns = {name: by_gain @ gains.slopes[:, k] for k, name in enumerate(variables)}
    return Deviation(logs, shares.log_ratios, read, model, columns)


def _log_ratio(gains: Gains, films: Floats, covariance: Floats) -> tuple[float, float, Floats]:
    """ln(F_inner / F_outer), its variance by noise, and its derivatives by the entries of M, shape (4,)."""
    forces = gains.forces(films)
    if not np.all(forces > 0):
        measured = Words(f"{forces[0]:.3g} N on the inner, {forces[1]:.3g} N on the outer film")
        raise InputError("reading", measured, "pressure on both films: are the channels exchanged?")
    slope = np.array([1.0, -1.0]) / forces
    by_films = slope @ np.linalg.inv(gains.matrix)
    return float(np.log(forces[0] / forces[1])), float(by_films @ covariance @ by_films), slope @ gains.by_entries(films)


def _blocks(scene: Scene, bench: Bench, deviation: Deviation, shares: Shares) -> tuple[BlockDeviation, ...]:
    areas = scene.probe.outer_area / scene.probe.inner_area
    ratios, predictions = np.exp(deviation.logs) * areas, np.exp(shares.log_ratios) * areas
    read, model = np.diag(deviation.read), deviation.model
    z = (deviation.logs - deviation.drawn) / np.sqrt(read + model)
    columns = (ratios, ratios * np.sqrt(read), predictions, predictions * np.sqrt(model), z)
    rows = np.stack(columns, axis=1).tolist()
    return tuple(BlockDeviation(block.name, *row) for block, row in zip(bench.blocks, rows, strict=True))
