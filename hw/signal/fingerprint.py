"""What tells one reading from another, whatever file it stands in: a fingerprint of its first samples.

The noise of a film is what its last samples do not predict. The signs of its projections on fixed random vectors are a similarity
hash (M. S. Charikar, STOC 2002, 380): of two noises at an angle a the share a / pi of all signs differs, a half where they have
nothing in common. Rounding to fewer digits, another unit and another file format change few signs or none; a second press of the
same place changes half of them. Only the beginning is looked at, so that a copy that ends earlier is recognised, too.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hw.common.samples import Floats, Samples
from hw.signal.measure import FILMS

ROWS = 1 << 13  # samples of each film that are looked at: 0.8 s at 10 kS/s
MEMORY = 12  # samples that predict the next: enough for the load, its harmonics and the mains
BITS = 128
DIFFERENT = 32  # signs: a quarter, 5.7 standard deviations below the half of two independent noises
SAME_VOLTS = 5e-4  # relative: rounding and the full range of a sound file change less
FEWEST = 4 * MEMORY  # rows


@dataclass(frozen=True)
class Fingerprint:
    """Of a reading's first samples.

    Attributes:
        noise: 128 signs in hexadecimal; "" where there are too few samples, or no noise.
        volts: standard deviation of each film's voltage, V, inner and outer.
    """

    noise: str
    volts: tuple[float, float]

    @classmethod
    def from_samples(cls, samples: Samples) -> Self:
        """Return the fingerprint of samples that begin with the reading; they must have both films."""
        films = np.nan_to_num(samples.of(FILMS).volts[:ROWS], posinf=0.0, neginf=0.0)
        inner, outer = (float(one) for one in films.std(axis=0)) if len(films) else (0.0, 0.0)
        return cls(_signs(films) if len(films) >= FEWEST else "", (inner, outer))

    @classmethod
    def from_dict(cls, told: Any) -> Self | None:
        """Return what ``as_dict`` gave; None where it is something else."""
        try:
            noise, (inner, outer) = told["noise"], told["volts"]
            signs = bytes.fromhex(noise)
            return cls(noise, (float(inner), float(outer))) if len(signs) in (0, BITS // 8) else None
        except (KeyError, TypeError, ValueError, OverflowError):
            return None

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return asdict(self)

    def is_same(self, other: Fingerprint) -> bool:
        """Whether both are of the same samples."""
        if not self.noise or not other.noise:
            return False
        if not np.allclose(self.volts, other.volts, rtol=SAME_VOLTS, atol=0):
            return False
        return (int(self.noise, 16) ^ int(other.noise, 16)).bit_count() < DIFFERENT


def _signs(films: Floats) -> str:
    """Return the signs of the films' noise along fixed vectors; "" where there is none."""
    noise = np.concatenate([_unpredicted(film) for film in films.T])
    if not noise.any():
        return ""
    return np.packbits(_vectors(len(noise)) @ noise > 0).tobytes().hex()


def _unpredicted(volts: Floats) -> Floats:
    """Return what linear prediction leaves of a film's voltage, over its standard deviation, shape (n - MEMORY,)."""
    spread = volts.std()
    if spread == 0:
        return np.zeros(len(volts) - MEMORY)
    scaled = (volts - volts.mean()) / spread
    past = np.lib.stride_tricks.sliding_window_view(scaled, MEMORY)[:-1]
    rest = scaled[MEMORY:] - past @ np.linalg.lstsq(past, scaled[MEMORY:], rcond=None)[0]
    size = rest.std()
    return np.asarray(rest / size if size > 0 else np.zeros_like(rest))


@cache
def _vectors(length: int) -> NDArray[np.float32]:
    """Return the vectors of +1 and -1, shape (BITS, length), by a hash function: the same on every computer and for ever."""
    bits = np.frombuffer(hashlib.shake_128(b"probe-design").digest(BITS * length // 8 + 1), dtype=np.uint8)
    return np.unpackbits(bits)[: BITS * length].reshape(length, BITS).T.astype(np.float32) * 2 - 1
