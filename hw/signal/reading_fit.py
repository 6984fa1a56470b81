"""Fit a whole reading while it comes: in pieces that fit into memory, and in stretches between gaps of unknown length.

The time between two stretches is unknown, so that each is fitted with its own phase. The results are rotated to the phase of the
first one, the longest, and averaged. Memory holds two pieces of a long reading and the results of earlier fits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hw.common.errors import HardwareError
from hw.common.samples import FILM_NAMES, FORCE_CHANNEL, Floats, Samples, join_samples
from hw.signal.fingerprint import FINGERPRINT_ROWS, Fingerprint
from hw.signal.sine_fit import NoSine, SineFit, TooShort, fit_stretch
from hw.signal.waveform import Flawed

MIN_PIECE_ROWS = 1 << 16  # minimum rows in a piece
MIN_PIECE_CYCLES = 30.0  # minimum periods of the load in a piece
FREQUENCY_TOLERANCE = 0.01  # largest relative difference of the stretches' frequencies


@dataclass(frozen=True)
class Losses:
    """The losses of a reading.

    Attributes
    ----------
    saturated
        Number of saturated rows, which are left out.
    gaps
        Number of gaps.
    overruns
        Number of overflows of the device's buffer.
    notes
        Other remarks on the source.
    """

    saturated: int = 0
    gaps: int = 0
    overruns: int = 0
    notes: tuple[str, ...] = ()

    @classmethod
    def from_samples(cls, samples: Samples) -> Losses:
        """Count the losses of samples."""
        return cls(int(samples.saturated.any(axis=1).sum()), len(samples.gaps), samples.overruns, samples.notes)

    def __add__(self, other: Losses) -> Losses:
        """Return the losses of two consecutive parts; the second part's notes include the first's."""
        counts = (self.saturated + other.saturated, self.gaps + other.gaps, self.overruns + other.overruns)
        return Losses(*counts, other.notes)


class ReadingFit:
    """Fit samples piece by piece, in order, each piece with its own phase.

    A reading that is shorter than two pieces is fitted as one.

    Parameters
    ----------
    frequency
        Of the load, Hz.
    force
        Whether the force channel is used if there is one.
    rows
        Minimum rows in a piece.
    """

    def __init__(self, frequency: float, force: bool, rows: int = MIN_PIECE_ROWS) -> None:
        """Start without samples."""
        self._frequency, self._force, self._rows = frequency, force, rows
        self._waiting: list[Samples] = []  # samples that are not fitted yet, ``_count`` rows
        self._begin: list[Samples] = []  # the first rows, for the fingerprint
        self._count, self._piece = 0, rows
        self._fits: list[SineFit] = []
        self._left_out = 0  # rows in stretches too short to be fitted
        self._fault: HardwareError | None = None
        self.losses = Losses()

    @classmethod
    def from_samples(cls, samples: Samples, frequency: float, force: bool) -> Self:
        """Take the samples of a whole reading, which is then fitted as one piece."""
        reading = cls(frequency, force, len(samples))
        reading.add(samples)
        return reading

    def add(self, block: Samples) -> None:
        """Add the next samples. Faults are raised by ``fit`` only, so that the reading continues."""
        used = block.select_channels(_choose_channels(block, self._force)) if self._fault is None else block
        if sum(map(len, self._begin)) < FINGERPRINT_ROWS:
            self._begin.append(used)
        self.losses += Losses.from_samples(used)
        if self._fault is not None:
            return
        self._waiting.append(used)
        self._count += len(used)
        self._piece = max(self._rows, round(MIN_PIECE_CYCLES / self._frequency * block.rate))
        while self._count >= 2 * self._piece:  # a whole piece stays, so that the last fit is not too short
            self._fit_first(self._piece)

    @property
    def fingerprint(self) -> Fingerprint:
        """Fingerprint of the reading; samples must have been added."""
        return Fingerprint.from_samples(join_samples(self._begin))

    def fit(self) -> SineFit:
        """Return the fit of all samples.

        Raises
        ------
        HardwareError
            The fault of the first piece that could not be fitted.
        """
        if self._waiting:
            self._fit_remaining()
        if self._fault is not None:
            raise self._fault
        if not self._fits:
            raise NoSine("no samples: is the source empty?")
        longest = max(range(len(self._fits)), key=lambda k: self._fits[k].rows)
        ordered = [self._fits[longest], *self._fits[:longest], *self._fits[longest + 1 :]]
        return replace(_combine_fits(ordered), left_out=self._left_out)

    def _fit_remaining(self) -> None:
        """Fit the waiting samples, in two halves if they exceed a piece, so that no fit needs more memory than the others."""
        if self._fits and self._count > self._piece:
            self._fit_first(self._count // 2)
        self._try_fit(join_samples(self._waiting))
        self._waiting, self._count = [], 0

    def _fit_first(self, piece: int) -> None:
        """Fit the first ``piece`` rows of the waiting samples."""
        samples = join_samples(self._waiting)
        first, remaining = samples.select_before(int(samples.index[piece])), samples.select_from(int(samples.index[piece]))
        self._waiting, self._count = [remaining], len(remaining)
        self._try_fit(first)

    def _try_fit(self, samples: Samples) -> None:
        """Fit each stretch between gaps of unknown length; a stretch that is too short is left out unless it is the only one."""
        for part in sorted(_split_stretches(samples), key=len, reverse=True):
            try:
                # the frequency of an earlier fit is a better start than the nominal one
                self._fits.append(fit_stretch(part, self._fits[0].frequency if self._fits else self._frequency))
            except TooShort as fault:
                self._left_out += len(part)
                self._fault = None if self._fits else fault
            except HardwareError as fault:
                self._fault = self._fault or fault


def _choose_channels(samples: Samples, force: bool) -> tuple[str, ...]:
    """Choose the channels that a measurement uses: both films', and the force channel if ``force`` is true and it exists.

    Raises
    ------
    Flawed
        A film's channel is missing.
    """
    missing = [name for name in FILM_NAMES if name not in samples.channels]
    if missing:
        raise Flawed(f"no channel {missing[0]!r} among {', '.join(samples.channels)}: both films are needed")
    return (*FILM_NAMES, FORCE_CHANNEL) if force and FORCE_CHANNEL in samples.channels else FILM_NAMES


def _split_stretches(samples: Samples) -> Iterator[Samples]:
    """Yield the parts between gaps of unknown length, without empty ones."""
    unknown = [gap.first for gap in samples.gaps if gap.count < 0]
    bounds = [0, *np.searchsorted(samples.index, unknown).tolist(), len(samples)]
    for low, high in pairwise(bounds):
        if high > low:
            rows = {name: getattr(samples, name)[low:high] for name in ("index", "volts", "saturated")}
            yield replace(samples, **rows)


def _combine_fits(fits: Sequence[SineFit]) -> SineFit:
    """Combine the fits of several stretches: means weighted by rows, in the phase of the first.

    Raises
    ------
    NoSine
        Their frequencies differ by more than FREQUENCY_TOLERANCE.
    """
    if len(fits) == 1:
        return fits[0]
    frequencies = np.array([fit.frequency for fit in fits])
    if np.ptp(frequencies) > FREQUENCY_TOLERANCE * frequencies.mean():
        bounds = f"from {frequencies.min():.5g} to {frequencies.max():.5g} Hz"
        raise NoSine(f"the load's frequency changes {bounds} during the reading: hold it")
    rows = np.array([fit.rows for fit in fits])
    weights, turns = rows / rows.sum(), np.array([_compute_phase_factor(fits[0], fit) for fit in fits])
    mains = [(fit.rows, fit.mains) for fit in fits if fit.mains is not None]
    harmonic_count = min(len(fit.harmonics) for fit in fits)
    orders = np.arange(2, 2 + harmonic_count)[:, None]  # the h-th harmonic is rotated by h times the phase
    harmonics = [turn**orders * fit.harmonics[:harmonic_count] for turn, fit in zip(turns, fits, strict=True)]

    def stack(name: str) -> NDArray[Any]:
        """Stack an attribute of all fits."""
        return np.stack([getattr(fit, name) for fit in fits])

    def add_independent_sds(name: str) -> Floats:
        """Return the standard deviation of the weighted mean of an attribute."""
        return np.asarray(np.sqrt(np.tensordot(weights**2, stack(name) ** 2, 1)))

    return replace(
        fits[0],
        frequency=float(weights @ frequencies),
        frequency_sd=float(add_independent_sds("frequency_sd")),
        amplitudes=np.tensordot(weights * turns, stack("amplitudes"), 1),
        covariance=np.tensordot(weights**2, stack("covariance"), 1),
        offsets=np.tensordot(weights, stack("offsets"), 1),
        offsets_sd=add_independent_sds("offsets_sd"),
        drift=np.ptp(stack("offsets"), axis=0) + stack("drift").max(axis=0),  # an upper bound: between and within stretches
        noise=np.sqrt(np.tensordot(weights, stack("noise") ** 2, 1)),
        density=np.tensordot(weights, stack("density"), 1),
        variance=float(weights**2 @ stack("variance")),
        harmonics=np.tensordot(weights, harmonics, 1),
        spikes=add_independent_sds("spikes"),
        bending=np.tensordot(weights, stack("bending"), 1),
        blocks=np.concatenate([turn * fit.blocks for turn, fit in zip(turns, fits, strict=True)]),
        blocks_variance=np.concatenate([fit.blocks_variance for fit in fits]),
        mains=max(mains, default=(0, None))[1],
        hum=np.tensordot(weights, stack("hum"), 1),
        seconds=sum(fit.seconds for fit in fits),
        rows=int(rows.sum()),
    )


def _compute_phase_factor(first: SineFit, second: SineFit) -> complex:
    """Return the complex factor of modulus 1 that rotates the second stretch's amplitudes to the phase of the first.

    Channels are weighted by the inverse of their noise; without amplitudes the factor is 1.
    """
    weights = 1 / np.maximum(np.diag(first.density), np.finfo(float).tiny)
    product = complex((np.conj(second.amplitudes) * first.amplitudes * weights).sum())
    return product / abs(product) if product else 1.0
