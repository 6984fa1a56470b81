"""Fit the amplitudes of a sinusoidal load in all channels by linear least squares, with their covariance.

The model is eq. SI.3 of ``hw.signal.sine_model``: harmonics of the load, mains lines if there are any, a drift polynomial. The
frequencies of load and mains are corrected by Gauss-Newton steps. Phases count from the middle of the record, so that the
amplitudes are uncorrelated with these frequencies to first order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from hw.common.errors import HardwareError
from hw.common.samples import Complexes, Floats, Samples
from hw.signal.sine_model import DRIFT_COEFFICIENTS, Lines, Solution, compute_residual, solve
from hw.signal.spectrum import MAINS_HZ, MAINS_TOLERANCE_HZ, estimate_density, find_mains, find_strongest
from hw.signal.steadiness import estimate_bending_error, estimate_spike_error, fit_blocks

MAX_HARMONICS = 3  # of the load, the fundamental included
MAX_MAINS_HARMONICS = 3  # harmonics of the mains, the fundamental included
MIN_CYCLES = 3.0  # periods of the load: a shorter record cannot be distinguished from the drift polynomial
MIN_SAMPLE_FRACTION = 0.1  # of a record's samples that must be there and not saturated
MAX_CONDITION = 1e10  # of the normal matrix: 1e6 with three cycles, beyond 1e10 where most of each cycle is cut off
MIN_SWING_V = 1e-18  # no converter resolves less: a channel that changes by less shows nothing, and its squares underflow
SEARCH_RANGE_HZ = 1.0  # Hz about the nominal frequency in which the load is searched
MAX_NEWTON_STEPS = 8  # of Gauss-Newton; two or three are enough from a good start
STEP_TOLERANCE_SD = 0.02  # of a frequency's standard deviation: smaller corrections end the iteration


class NoSine(HardwareError):  # noqa: N818 - says what is missing
    """The record does not allow a fit of a sinusoidal load."""


class TooShort(NoSine):
    """The record has too few periods of the load, or too few rows."""


@dataclass(frozen=True)
class SineFit:
    """The fitted amplitudes a of v(t) = Re(a e^(j 2 pi f t)), t from the middle of the record.

    Attributes
    ----------
    frequency
        f, Hz.
    frequency_sd
        Standard deviation of ``frequency``, Hz.
    amplitudes
        (channels,), V.
    covariance
        Of (re, im) of each channel in turn, V^2, shape (2 channels, 2 channels).
    offsets
        (channels,) constant term of the drift polynomial, V.
    offsets_sd
        (channels,) standard deviations of ``offsets``, V.
    drift
        (channels,) difference of the drift polynomial's maximum and minimum, V.
    noise
        (channels,) standard deviation of the residual, V.
    density
        Covariance of the noise near f, as that of white noise of equal density at f, V^2, shape (channels, channels);
        ``covariance`` is built from it.
    variance
        Of re or im of an amplitude, relative to the variance of a sample's noise.
    harmonics
        (h, channels) harmonics of the load from the second on, V, with phases as ``amplitudes``.
    spikes
        (channels,) error of an amplitude that outliers may cause, V.
    bending
        (channels,) error that a curved characteristic may cause, from products of load and mains, V.
    blocks
        (k, channels) amplitudes of consecutive blocks, V.
    blocks_variance
        (k,) variance of their re and im, relative to that of a sample's noise.
    mains
        Frequency of the mains, Hz, or None if not detected.
    hum
        (channels,) amplitude of the mains, V; 0 if not detected.
    seconds
        Time from the first to the last sample, summed over stretches between gaps of unknown length.
    rows
        Number of samples used.
    left_out
        Number of samples in stretches too short to be fitted.
    """

    frequency: float
    frequency_sd: float
    amplitudes: Complexes
    covariance: Floats
    offsets: Floats
    offsets_sd: Floats
    drift: Floats
    noise: Floats
    density: Floats
    variance: float
    harmonics: Complexes
    spikes: Floats
    bending: Floats
    blocks: Complexes
    blocks_variance: Floats
    mains: float | None
    hum: Floats
    seconds: float
    rows: int
    left_out: int = 0

    @property
    def cycles(self) -> float:
        """Number of periods of the load in the record."""
        return self.seconds * self.frequency


def fit_stretch(samples: Samples, frequency: float) -> SineFit:
    """Fit a sinusoidal load to all channels of a stretch without a gap of unknown length.

    Rows that are saturated in any channel are left out. Neither these nor gaps are filled in.

    Parameters
    ----------
    samples
        Of one stretch.
    frequency
        Of the load, Hz, within a tenth and 1 Hz.

    Raises
    ------
    NoSine
        The record is too short, too slowly sampled, or has no sinusoid.
    """
    clean = _drop_saturated(samples)
    begin, end = (int(samples.index[k]) for k in (0, -1)) if len(samples.index) else (0, 0)
    span = (end - begin) / clean.rate
    _check_samples(clean, end - begin + 1)
    load = _find_load_frequency(clean, span, frequency)
    t = np.asarray((clean.index - begin - (end - begin) / 2) / clean.rate, dtype=float)  # exact for large indices, too
    lines = Lines(load, _count_below_nyquist(load, clean.rate, MAX_HARMONICS), None, 0, span / 2)
    lines, solved = _fit_frequencies(lines, t, clean.volts)
    lines = _add_mains(lines, clean, t, solved)
    if lines.mains is not None:
        lines, solved = _fit_frequencies(lines, t, clean.volts)
    return _build_fit(lines, solved, clean, t)


def _check_samples(samples: Samples, requested: int) -> None:
    """Refuse samples that are too few, dead channels, and films with equal numbers.

    ``requested`` is the number of samples that the stretch would have without gaps and saturation.
    """
    # 4 times the unknowns: two for each harmonic, and the drift polynomial
    min_samples = 4 * (2 * (MAX_HARMONICS + MAX_MAINS_HARMONICS) + DRIFT_COEFFICIENTS)
    if len(samples.index) < max(min_samples, MIN_SAMPLE_FRACTION * requested):
        needed = f"at least {min_samples} and a fraction of {MIN_SAMPLE_FRACTION:g} are needed"
        raise TooShort(f"{len(samples.index)} of {requested} samples arrived and are not saturated: {needed}")
    dead = [name for name, swing in zip(samples.channels, np.ptp(samples.volts, axis=0), strict=True) if not swing > MIN_SWING_V]
    if dead or not np.all(np.isfinite(samples.volts)):
        raise NoSine(f"channel {dead[0] if dead else 'of some film'} shows no change, or no numbers: is it connected?")
    if samples.volts.shape[1] > 1 and np.array_equal(samples.volts[:, 0], samples.volts[:, 1]):
        raise NoSine(f"channels {samples.channels[0]} and {samples.channels[1]} hold the same numbers: two films never do")


def _find_load_frequency(samples: Samples, span: float, nominal: float) -> float:
    """Return a first estimate of the load's frequency, Hz: the strongest line near ``nominal``, Hz; ``span`` is in s."""
    _check_frequency(nominal, span, samples.rate)
    search_range = min(0.1 * nominal, SEARCH_RANGE_HZ)
    frequency = find_strongest(samples, nominal - search_range, nominal + search_range) or nominal
    _check_frequency(frequency, span, samples.rate)
    return frequency


def _drop_saturated(samples: Samples) -> Samples:
    """Return the rows that are saturated in no channel."""
    good = ~samples.saturated.any(axis=1)
    if good.all():
        return samples
    return replace(samples, index=samples.index[good], volts=samples.volts[good], saturated=samples.saturated[good])


def check_rate(frequency: float, rate: float) -> None:
    """Raise ``NoSine`` if a mains line, or its alias at this sampling rate, is at the load's frequency (both in Hz)."""
    for nominal, k in product(MAINS_HZ, range(1, MAX_MAINS_HARMONICS + 1)):
        line = k * nominal
        if abs(frequency - line) < k * MAINS_TOLERANCE_HZ:
            raise NoSine(f"a load of {frequency:.4g} Hz is too close to the mains at {line:g} Hz: load at another frequency")
        alias = abs(line - rate * round(line / rate))
        if line > 0.5 * rate and abs(frequency - alias) < MAINS_TOLERANCE_HZ * max(1.0, line / MAINS_HZ[0]):
            raise NoSine(
                f"at {rate:.6g} samples a second the mains at {line:g} Hz look like {alias:.4g} Hz, the load's "
                f"{frequency:.4g} Hz: read at another rate, above {2 * MAINS_HZ[1] * MAX_MAINS_HARMONICS:g} samples a second"
            )


def _check_frequency(frequency: float, span: float, rate: float) -> None:
    """Refuse a load at the mains, with too few periods in ``span`` (s), or sampled too slowly; frequency and rate in Hz."""
    check_rate(frequency, rate)
    if frequency * span < MIN_CYCLES:
        raise TooShort(f"{frequency * span:.3g} cycles of {frequency:.4g} Hz in {span:.3g} s: at least {MIN_CYCLES:g} are needed")
    if frequency > 0.4 * rate:
        raise NoSine(f"a load of {frequency:.4g} Hz needs more than {rate:.4g} samples a second: 2.5 a period at least")


def _count_below_nyquist(frequency: float, rate: float, max_count: int) -> int:
    """Return how many harmonics of a frequency the sampling rate allows, from 1 to ``max_count``; 0.45: below Nyquist's 0.5."""
    return max(1, min(max_count, int(0.45 * rate / frequency)))


def _fit_frequencies(lines: Lines, t: Floats, volts: Floats) -> tuple[Lines, Solution]:
    """Correct the frequencies of ``lines`` by Gauss-Newton steps until they converge; return them and the solution.

    Parameters
    ----------
    lines
        The model's, at first estimates of the frequencies.
    t
        (n,) times from the middle of the record, s.
    volts
        (n, channels).

    Raises
    ------
    NoSine
        A frequency leaves the neighbourhood of its start.
    """
    start = lines.load
    for _ in range(MAX_NEWTON_STEPS):
        solved = _solve(lines, t, volts)
        if np.all(np.abs(solved.step) <= STEP_TOLERANCE_SD * solved.step_sd):
            return lines, solved
        hum = None if lines.mains is None else lines.mains + float(solved.step[-1])
        lines = replace(lines, load=lines.load + float(solved.step[0]), mains=hum)
        if abs(lines.load - start) * 2 * lines.half > 1:  # by more than a line's width, 1 over the record's length
            raise NoSine(f"no sinusoid near {start:.6g} Hz: the fit leaves that frequency; is the load on, its frequency right?")
    return lines, _solve(lines, t, volts)


def _solve(lines: Lines, t: Floats, volts: Floats) -> Solution:
    """Solve the model at fixed frequencies. Raises ``NoSine`` where the samples do not determine a sinusoid."""
    try:
        solved = solve(lines, t, volts)
    except np.linalg.LinAlgError:
        solved = None
    if solved is None or not np.linalg.cond(solved.inverse) < MAX_CONDITION:
        raise NoSine(
            f"the {len(t)} samples that arrived and are not saturated do not determine a sinusoid of {lines.load:.4g} Hz: "
            "lower the load or the amplification, so that less is cut off"
        )
    return solved


def _add_mains(lines: Lines, samples: Samples, t: Floats, solved: Solution) -> Lines:
    """Return the model's lines, with the mains and its harmonics added if they stand out of the residuals.

    Parameters
    ----------
    lines
        The model's, without mains.
    samples
        Not saturated.
    t
        (n,) times from the middle of the record, s.
    solved
        Solution for these lines.

    Raises
    ------
    NoSine
        The load or one of its harmonics is too close to the mains to be separated.
    """
    frequency = find_mains(samples, compute_residual(lines, t, samples.volts, solved.coefficients), lines.frequencies)
    if frequency is None:
        return lines
    hums = _count_below_nyquist(frequency, samples.rate, MAX_MAINS_HARMONICS)
    multiples = frequency * np.arange(1, hums + 1)
    if np.min(np.abs(multiples[:, None] - lines.frequencies)) < 1 / lines.half:
        raise NoSine(f"the load's {lines.load:.4g} Hz or its harmonics fall on the mains: load at another frequency")
    return replace(lines, mains=frequency, hums=hums)


def _build_fit(lines: Lines, solved: Solution, samples: Samples, t: Floats) -> SineFit:
    """Build the result of a fit from its solution and residuals; parameters as in ``_add_mains``, with mains if detected."""
    coefficients, width = solved.coefficients, 2 * len(lines.frequencies)
    residuals = compute_residual(lines, t, samples.volts, coefficients)
    density = estimate_density(samples, residuals, lines.load, lines.frequencies, solved.noise)
    drift_columns = np.polynomial.legendre.legvander(np.linspace(-1, 1, 101), DRIFT_COEFFICIENTS - 1)  # at 101 times
    # coefficients alternate between real and imaginary parts of the amplitudes, those of the load first
    waves = coefficients[0 : 2 * lines.harmonics : 2] + 1j * coefficients[1 : 2 * lines.harmonics : 2]
    hums = coefficients[2 * lines.harmonics : 2 * lines.harmonics + 2]  # cosine and sine of the mains
    block_amplitudes, block_variances = fit_blocks(lines, t, samples.volts)
    return SineFit(
        frequency=lines.load,
        frequency_sd=float(solved.step_sd[0]),
        amplitudes=waves[0],
        covariance=np.asarray(np.kron(density, solved.inverse[:2, :2]), dtype=float),
        offsets=coefficients[width],
        offsets_sd=np.sqrt(np.diag(density) * solved.inverse[width, width]),
        drift=np.ptp(drift_columns @ coefficients[width:], axis=0),
        noise=np.sqrt(np.diag(solved.noise)),
        density=density,
        variance=float(max(solved.inverse[0, 0], solved.inverse[1, 1])),
        harmonics=waves[1:],
        spikes=estimate_spike_error(residuals, samples.rate / lines.load),
        bending=estimate_bending_error(lines, t, samples.volts - residuals, residuals),
        blocks=block_amplitudes,
        blocks_variance=block_variances,
        mains=lines.mains,
        hum=np.zeros(samples.volts.shape[1]) if lines.mains is None else np.hypot(*hums),
        seconds=2 * lines.half,
        rows=len(t),
    )
