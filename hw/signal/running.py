"""A reading of any length, fitted as it comes: memory holds two pieces of it, and what the fits told."""

from __future__ import annotations

from dataclasses import replace

from hw.common.errors import HardwareError
from hw.common.samples import Samples, joined
from hw.signal.fingerprint import ROWS as FIRST
from hw.signal.fingerprint import Fingerprint
from hw.signal.measure import Losses, film_channels
from hw.signal.sine_fit import NoSine, SineFit, TooShort, fit_stretch
from hw.signal.stretches import combined, stretches

ROWS = 1 << 16  # in a piece, at least
CYCLES = 30.0  # of the load in a piece, at least


class RunningFit:
    """Takes samples in order and fits them piece by piece, each with a phase of its own.

    A reading that is no longer than two pieces is fitted as one.

    Args:
        frequency: of the load, Hz.
        force: whether the force channel is used where there is one.
        rows: in a piece, at least.
    """

    def __init__(self, frequency: float, force: bool, rows: int = ROWS) -> None:
        self._frequency, self._force, self._rows = frequency, force, rows
        self._waiting: list[Samples] = []
        self._begin: list[Samples] = []  # as many rows as a fingerprint looks at
        self._count, self._piece = 0, rows
        self._fits: list[SineFit] = []
        self._left_out = 0
        self._fault: HardwareError | None = None
        self.losses = Losses()

    def add(self, block: Samples) -> None:
        """Take the next samples; what is wrong with them is said by ``fit``, so that the reading goes on."""
        used = block.of(film_channels(block, self._force)) if self._fault is None else block
        if sum(map(len, self._begin)) < FIRST:
            self._begin.append(used)
        self.losses += Losses.of(used)
        if self._fault is not None:
            return
        self._waiting.append(used)
        self._count += len(used)
        self._piece = max(self._rows, round(CYCLES / self._frequency * block.rate))
        while self._count >= 2 * self._piece:
            self._fit_first(self._piece)

    @property
    def fingerprint(self) -> Fingerprint:
        """Return what tells this reading from others; there must have been samples."""
        return Fingerprint.from_samples(joined(self._begin))

    def fit(self) -> SineFit:
        """Return the fit of all that came.

        Raises:
            HardwareError: what a piece was refused for.
        """
        if self._waiting:
            self._fit_rest()
        if self._fault is not None:
            raise self._fault
        if not self._fits:
            raise NoSine("no samples: is the source empty?")
        longest = max(range(len(self._fits)), key=lambda k: self._fits[k].rows)
        ordered = [self._fits[longest], *self._fits[:longest], *self._fits[longest + 1 :]]
        return replace(combined(ordered), left_out=self._left_out)

    def _fit_rest(self) -> None:
        """Of a long reading in two halves, where more than a piece waits: no fit then takes more memory than the others."""
        if self._fits and self._count > self._piece:
            self._fit_first(self._count // 2)
        self._try(joined(self._waiting))
        self._waiting, self._count = [], 0

    def _fit_first(self, piece: int) -> None:
        whole = joined(self._waiting)
        first, rest = whole.before(int(whole.index[piece])), whole.after(int(whole.index[piece]))
        self._waiting, self._count = [rest], len(rest)
        self._try(first)

    def _try(self, samples: Samples) -> None:
        """Fit what lies between gaps of unknown length; a stretch too short is left out unless there is nothing else."""
        for part in sorted(stretches(samples), key=len, reverse=True):
            try:
                self._fits.append(fit_stretch(part, self._fits[0].frequency if self._fits else self._frequency))
            except TooShort as fault:
                self._left_out += len(part)
                self._fault = None if self._fits else fault
            except HardwareError as fault:
                self._fault = self._fault or fault
