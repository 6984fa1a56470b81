"""Fit a reading of any length while it comes: memory holds two pieces of it and the results of earlier fits."""

from __future__ import annotations

from dataclasses import replace

from hw.common.errors import HardwareError
from hw.common.samples import Samples, join_samples
from hw.signal.fingerprint import FINGERPRINT_ROWS as FIRST_ROWS
from hw.signal.fingerprint import Fingerprint
from hw.signal.measure import Losses, choose_channels
from hw.signal.sine_fit import NoSine, SineFit, TooShort, fit_stretch
from hw.signal.stretches import combine_fits, split_stretches

MIN_PIECE_ROWS = 1 << 16  # minimum rows in a piece
MIN_PIECE_CYCLES = 30.0  # minimum periods of the load in a piece


class RunningFit:
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
        self._frequency, self._force, self._rows = frequency, force, rows
        self._waiting: list[Samples] = []
        self._begin: list[Samples] = []  # the first rows, for the fingerprint
        self._count, self._piece = 0, rows
        self._fits: list[SineFit] = []
        self._left_out = 0
        self._fault: HardwareError | None = None
        self.losses = Losses()

    def add(self, block: Samples) -> None:
        """Add the next samples. Faults are raised by ``fit`` only, so that the reading continues."""
        used = block.select_channels(choose_channels(block, self._force)) if self._fault is None else block
        if sum(map(len, self._begin)) < FIRST_ROWS:
            self._begin.append(used)
        self.losses += Losses.from_samples(used)
        if self._fault is not None:
            return
        self._waiting.append(used)
        self._count += len(used)
        self._piece = max(self._rows, round(MIN_PIECE_CYCLES / self._frequency * block.rate))
        while self._count >= 2 * self._piece:
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
        return replace(combine_fits(ordered), left_out=self._left_out)

    def _fit_remaining(self) -> None:
        """Fit the waiting samples: in two halves if they exceed a piece, so that no fit needs more memory than the others."""
        if self._fits and self._count > self._piece:
            self._fit_first(self._count // 2)
        self._try_fit(join_samples(self._waiting))
        self._waiting, self._count = [], 0

    def _fit_first(self, piece: int) -> None:
        samples = join_samples(self._waiting)
        first, remaining = samples.select_before(int(samples.index[piece])), samples.select_from(int(samples.index[piece]))
        self._waiting, self._count = [remaining], len(remaining)
        self._try_fit(first)

    def _try_fit(self, samples: Samples) -> None:
        """Fit each stretch between gaps of unknown length; a stretch that is too short is left out unless it is the only one."""
        for part in sorted(split_stretches(samples), key=len, reverse=True):
            try:
                self._fits.append(fit_stretch(part, self._fits[0].frequency if self._fits else self._frequency))
            except TooShort as fault:
                self._left_out += len(part)
                self._fault = None if self._fits else fault
            except HardwareError as fault:
                self._fault = self._fault or fault
