"""What tells one reading from another, whatever file it stands in: a fingerprint of its first samples.

The noise of a film is what its last samples do not predict. The signs of its projections on fixed random vectors are a similarity
hash (M. S. Charikar, STOC 2002, 380): of two noises at an angle a the share a / pi of all signs differs, a half where they have
nothing in common. Rounding to fewer digits, another unit and another file format change few signs or none; a second press of the
same place changes half of them. Beginnings of several lengths are looked at, and the longest that both readings have is
compared, so that a copy that ends earlier is recognised, too.
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
LENGTHS = tuple(1 << k for k in range(6, 14))  # of the beginnings, samples: from as few as a fit takes to ROWS
MEMORY = 12  # samples that predict the next: enough for the load, its harmonics and the mains
BITS = 128
DIFFERENT = 32  # signs: a quarter, 5.7 standard deviations below the half of two independent noises
SAME_VOLTS = 5e-4  # relative: rounding and the full range of a sound file change less


@dataclass(frozen=True)
class Fingerprint:
    """Of a reading's first samples.

    Attributes:
        noise: of its beginnings of ``LENGTHS``, as many as it has: 128 signs in hexadecimal; "" where there is no noise.
        volts: standard deviation of each film's voltage in each of them, V, inner and outer.
    """

    noise: tuple[str, ...]
    volts: tuple[tuple[float, float], ...]

    @classmethod
    def from_samples(cls, samples: Samples) -> Self:
        """Return the fingerprint of samples that begin with the reading; they must have both films."""
        films = np.nan_to_num(samples.of(FILMS).volts[:ROWS], posinf=0.0, neginf=0.0)
        beginnings = [films[:length] for length in LENGTHS if length <= len(films)]
        deviations = (one.std(axis=0) for one in beginnings)
        return cls(tuple(map(_signs, beginnings)), tuple((float(inner), float(outer)) for inner, outer in deviations))

    @classmethod
    def from_dict(cls, told: Any) -> Self | None:
        """Return what ``as_dict`` gave; None where it is something else."""
        try:
            noise = tuple(told["noise"])
            volts = tuple((float(inner), float(outer)) for inner, outer in told["volts"])
            sizes = {len(bytes.fromhex(signs)) for signs in noise}
            return cls(noise, volts) if len(noise) == len(volts) <= len(LENGTHS) and sizes <= {0, BITS // 8} else None
        except (KeyError, TypeError, ValueError, OverflowError):
            return None

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return asdict(self)

    def is_same(self, other: Fingerprint) -> bool:
        """Whether both are of the same samples."""
        beginnings = list(zip(self.noise, other.noise, self.volts, other.volts, strict=False))
        if not beginnings:
            return False
        one, two, volts, others = beginnings[-1]
        if not one or not two or not np.allclose(volts, others, rtol=SAME_VOLTS, atol=0):
            return False
        return (int(one, 16) ^ int(two, 16)).bit_count() < DIFFERENT


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
