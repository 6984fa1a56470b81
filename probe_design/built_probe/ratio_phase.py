"""Compute the phase of the ratio from a measurement: the phase by which the inner film's stress leads the outer's.

Gains are real, so that a calibration does not remove time differences between the channels. With complex charges q of both films
at frequency f, over the nominal charge per force, the gain matrix M and the outer channel sampled later than the inner by s,

    forces = M^-1 q,     phase = arg(forces_inner / forces_outer) + 2 pi f s                                (BP.4)

counted from the sign of the ratio. Its variance adds those of noise, of gains, of each amplifier's time constant, eq. SI.2, which
the calibration does not determine, and of s.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from geometry.scenes.variables import list_loss_factors
from hw.common.samples import Complexes
from hw.signal.amplifier import compute_parts_covariance
from hw.signal.covariance import propagate_complex_covariance, propagate_covariance
from hw.signal.measurement import Measurement
from probe_design.built_probe.bench import CONTRADICTION_SD, Bench
from probe_design.built_probe.gains import Gains
from solver.evaluation import add_phase
from solver.phase.inertia import add_inertia_error
from solver.results.result import Result
from solver.results.warnings import Note

SD_PER_BOUND = 3**-0.5  # standard deviation of an even distribution within a bound of 1: GUM 4.3.7


def add_ratio_phase(result: Result, scene: Scene, accuracy: float, frequency: float | None) -> Result:
    """Return a scene's result with the phase of its ratio at a frequency (Hz) added; unchanged if ``frequency`` is None.

    If the phase is null, a warning gives the reason. Without lossy materials it is 0 and nothing is solved; nothing is refused.
    """
    if frequency is None:
        return result
    moving = replace(result, frequency=frequency, error_estimate=add_inertia_error(result.error_estimate, scene, frequency))
    if not any(list_loss_factors(scene).values()):
        return replace(moving, ratio_phase=0.0, ratio_phase_error=0.0)
    try:
        return add_phase(result, scene, accuracy, frequency)
    except InputError as fault:  # a load too fast for the phase's model may still be read
        return replace(moving, warnings=(*result.warnings, Note("null", f"predicted_ratio_phase is null: {fault}")))


def compute_ratio_phase(measurement: Measurement, bench: Bench, gains: Gains) -> tuple[float, float]:
    """Return the phase of eq. BP.4 and its standard deviation, rad."""
    charges, frequency = measurement.charges, measurement.fit.frequency
    # a calibration does not determine the amplifiers' phases
    charges_covariance = measurement.covariance + compute_parts_covariance(charges, bench.amplifier.build_films(), frequency)
    angular_frequency = 2 * math.pi * frequency
    variance = (
        propagate_complex_covariance(lambda values: _compute_phase(values, gains.matrix), charges, charges_covariance)[0, 0]
        + propagate_covariance(
            lambda entries: _compute_phase(charges, entries.reshape(2, 2)), gains.matrix.ravel(), gains.covariance[:4, :4]
        )[0, 0]
        + (angular_frequency * bench.sampling.skew_tolerance) ** 2
    )
    phase = float(_compute_phase(charges, gains.matrix)[0]) + angular_frequency * bench.sampling.skew
    return phase, math.sqrt(variance)


def compare_ratio_phase(value: float, value_sd: float, predicted: Result) -> tuple[float | None, list[str]]:
    """Return the difference of a phase from its prediction in standard deviations, and a warning if it is significant.

    Parameters
    ----------
    value, value_sd
        The phase as read and its standard deviation, rad.
    predicted
        Result with the predicted phase; without one, None and no warning are returned.
    """
    expected, error = predicted.ratio_phase, predicted.ratio_phase_error
    if expected is None or error is None:
        return None, []
    z = (value - expected) / math.hypot(value_sd, SD_PER_BOUND * error)
    if abs(z) <= CONTRADICTION_SD:
        return z, []
    text = f"the ratio's phase is {value:.2g} rad, and {expected:.2g} by the scene's loss factors"
    return z, [f"{text}: tissue or blocks that lose more than the scene says, or channels that differ in time"]


def _compute_phase(charges: Complexes, matrix: Floats) -> Floats:
    """Return the phase of the ratio of both films' forces, counted from the ratio's sign, rad, shape (1,)."""
    inner, outer = np.linalg.solve(matrix, charges)
    # its phase is that of inner / outer; a negative ratio is not counted as a phase of pi
    product = inner * np.conj(outer)
    return np.array([np.angle(product if product.real >= 0 else -product)])
