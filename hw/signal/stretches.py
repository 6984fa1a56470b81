"""Fit a reading in stretches: parts between gaps of unknown length, or pieces of a long reading that fit into memory.

The time between two stretches is unknown, so that each is fitted with its own phase. The results are rotated to the phase of the
first one, the longest, and averaged.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hw.common.samples import Complexes, Floats, Samples
from hw.signal.sine_fit import NoSine, SineFit, TooShort, fit_stretch

FREQUENCY_TOLERANCE = 0.01  # largest relative difference of the stretches' frequencies


def fit_sine(samples: Samples, frequency: float | None = None) -> SineFit:
    """Fit a sinusoidal load to all channels, stretch by stretch.

    Parameters
    ----------
    samples
        Of one reading.
    frequency
        Of the load, Hz, within a tenth and 1 Hz; None: searched in the whole spectrum.

    Raises
    ------
    NoSine
        The reading is too short, too slowly sampled, or has no sinusoid.
    """
    parts = sorted(split_stretches(samples), key=len, reverse=True)
    fits = [fit_stretch(parts[0] if parts else samples, frequency)]
    left_out = 0
    for part in parts[1:]:
        try:
            fits.append(fit_stretch(part, fits[0].frequency))
        except TooShort:
            left_out += len(part)
    return replace(combine_fits(fits), left_out=left_out)


def split_stretches(samples: Samples) -> Iterator[Samples]:
    """Yield the parts between gaps of unknown length, without empty ones."""
    unknown = [gap.first for gap in samples.gaps if gap.count < 0]
    bounds = [0, *np.searchsorted(samples.index, unknown).tolist(), len(samples)]
    for low, high in pairwise(bounds):
        if high > low:
            rows = {name: getattr(samples, name)[low:high] for name in ("index", "volts", "saturated")}
            yield replace(samples, **rows)


def combine_fits(fits: Sequence[SineFit]) -> SineFit:
    """Combine the fits of several stretches: means weighted by rows, in the phase of the first.

    Raises
    ------
    NoSine
        Their frequencies differ by more than 1 %.
    """
    if len(fits) == 1:
        return fits[0]
    frequencies = np.array([fit.frequency for fit in fits])
    if np.ptp(frequencies) > FREQUENCY_TOLERANCE * frequencies.mean():
        bounds = f"from {frequencies.min():.5g} to {frequencies.max():.5g} Hz"
        raise NoSine(f"the load's frequency changes {bounds} during the reading: hold it")
    rows = np.array([fit.rows for fit in fits], dtype=float)
    shares = rows / rows.sum()
    turns = [_compute_phase_factor(fits[0], fit) for fit in fits]
    noise = np.einsum("p,pab->ab", shares, [fit.density for fit in fits])
    mains = [(fit.rows, fit.mains) for fit in fits if fit.mains is not None]
    return replace(
        fits[0],
        frequency=float(shares @ frequencies),
        frequency_sd=float(np.sqrt(sum((w * fit.frequency_sd) ** 2 for w, fit in zip(shares, fits, strict=True)))),
        amplitudes=_sum_arrays(w * turn * fit.amplitudes for w, turn, fit in zip(shares, turns, fits, strict=True)),
        covariance=_sum_arrays(w**2 * fit.covariance for w, fit in zip(shares, fits, strict=True)),
        offsets=_sum_arrays(w * fit.offsets for w, fit in zip(shares, fits, strict=True)),
        offsets_sd=np.sqrt(_sum_arrays((w * fit.offsets_sd) ** 2 for w, fit in zip(shares, fits, strict=True))),
        drift=np.ptp([fit.offsets for fit in fits], axis=0) + np.max([fit.drift for fit in fits], axis=0),
        noise=np.sqrt(_sum_arrays(w * fit.noise**2 for w, fit in zip(shares, fits, strict=True))),
        density=noise,
        variance=float(sum(w**2 * fit.variance for w, fit in zip(shares, fits, strict=True))),
        harmonics=_combine_harmonics(fits, shares, turns),
        spikes=np.sqrt(_sum_arrays((w * fit.spikes) ** 2 for w, fit in zip(shares, fits, strict=True))),
        bending=_sum_arrays(w * fit.bending for w, fit in zip(shares, fits, strict=True)),
        blocks=np.concatenate([turn * fit.blocks for turn, fit in zip(turns, fits, strict=True)]),
        blocks_variance=np.concatenate([fit.blocks_variance for fit in fits]),
        mains=max(mains, default=(0, None))[1],
        seconds=sum(fit.seconds for fit in fits),
        rows=int(rows.sum()),
    )


def _compute_phase_factor(first: SineFit, second: SineFit) -> complex:
    """Return the factor of modulus 1 that rotates a stretch to the phase of the first; channels are weighted by noise."""
    weights = 1 / np.maximum(np.diag(first.density), np.finfo(float).tiny)
    product = complex((np.conj(second.amplitudes) * first.amplitudes * weights).sum())
    return product / abs(product) if product else 1.0


def _combine_harmonics(fits: Sequence[SineFit], shares: Floats, turns: Sequence[complex]) -> Complexes:
    """Average the harmonics that all stretches have; the h-th is rotated by h times the phase."""
    count = min(len(fit.harmonics) for fit in fits)
    orders = np.arange(2, 2 + count)[:, None]
    return _sum_arrays(w * turn**orders * fit.harmonics[:count] for w, turn, fit in zip(shares, turns, fits, strict=True))


def _sum_arrays(parts: Iterable[NDArray[Any]]) -> NDArray[Any]:
    return np.asarray(np.sum(list(parts), axis=0))
