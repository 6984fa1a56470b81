"""The phase of the ratio as it was read: by how much the inner film's stress leads the outer's.

Gains are real, so that calibrating them leaves what differs between the channels in time. With complex charges q of both films
at frequency f, over the nominal charge per force, and the outer channel sampled later than the inner by s,

    forces = M^-1 q,     phase = arg(forces_inner / forces_outer) + 2 pi f s                                (BP.4)

counted from the sign of the ratio. Its variance adds that of noise, of gains, of each amplifier's time constant, eq. SI.2, which
no reading on an elastic reference is asked for, and of s.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from geometry.common.arrays import Floats
from geometry.common.errors import InputError
from geometry.scenes.scene import Scene
from geometry.scenes.variables import loss_factors
from hw.signal.amplifier import of_parts
from hw.signal.measure import Measurement, carried
from probe_design.built_probe.bench import Bench
from probe_design.built_probe.gain_matrix import Gains
from solver.answers import with_phase
from solver.phase.inertia import with_inertia
from solver.results.result import Result
from solver.results.warnings import Note

SPREAD = 3**-0.5  # standard deviation of what lies anywhere within a bound of 1: GUM 4.3.7
SURPRISING = 5.0  # standard deviations from what is predicted, beyond which a reading warns


def phased(result: Result, scene: Scene, accuracy: float, frequency: float | None) -> Result:
    """Return an answer to a scene with the phase of its ratio at a frequency, Hz, that is asked for.

    Where that is null a warning says why. Nothing is solved for where nothing is lossy, and nothing refused.
    """
    if frequency is None:
        return result
    moving = replace(result, frequency=frequency, error_estimate=with_inertia(result.error_estimate, scene, frequency))
    if not any(loss_factors(scene).values()):
        return replace(moving, ratio_phase=0.0, ratio_phase_error=0.0)
    try:
        return with_phase(result, scene, accuracy, frequency)
    except InputError as fault:  # a load too fast for what the phase knows is read all the same
        return replace(moving, warnings=(*result.warnings, Note("null", f"predicted_ratio_phase is null: {fault}")))


def ratio_phase(measurement: Measurement, bench: Bench, gains: Gains) -> tuple[float, float]:
    """Return the phase of eq. BP.4 and its standard deviation, rad."""
    charges, frequency = measurement.charges, measurement.fit.frequency
    turn = 2 * math.pi * frequency
    scale = float(np.abs(charges).max())
    parts = np.stack([charges.real, charges.imag], axis=1).ravel() / scale
    of_charges = measurement.covariance + of_parts(
        charges, bench.amplifier.of_films(), frequency
    )  # a calibration has not seen them
    variance = carried(lambda moved: _phase(moved, gains.matrix), parts, of_charges / scale**2)
    variance = variance + carried(lambda moved: _phase(parts, moved.reshape(2, 2)), gains.matrix.ravel(), gains.covariance)
    value = float(_phase(parts, gains.matrix)[0]) + turn * bench.sampling.skew
    return value, math.hypot(math.sqrt(float(variance[0, 0])), turn * bench.sampling.skew_tolerance)


def surprises(value: float, spread: float, predicted: Result) -> tuple[float | None, list[str]]:
    """Return by how many standard deviations a phase differs from the predicted one, and a warning where it is too many."""
    expected, error = predicted.ratio_phase, predicted.ratio_phase_error
    if expected is None or error is None:
        return None, []
    z = (value - expected) / math.hypot(spread, SPREAD * error)
    if abs(z) <= SURPRISING:
        return z, []
    text = f"the ratio's phase is {value:.2g} rad, and {expected:.2g} by the scene's loss factors"
    return z, [f"{text}: tissue or blocks that lose more than the scene says, or channels that differ in time"]


def _phase(parts: Floats, matrix: Floats) -> Floats:
    inner, outer = np.linalg.solve(matrix, parts[0::2] + 1j * parts[1::2])
    leads = inner * np.conj(outer)
    return np.array([np.angle(leads if leads.real >= 0 else -leads)])
